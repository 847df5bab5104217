//! `armarium graph CHART -o FILE`: draws the chart as SVG, or writes it for Mermaid or PlantUML, by the file's
//! ending.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_runtime::chart::{self, Outline};
use armarium_viewer::chart::{mermaid, plantuml, svg};

use crate::{changes, console};

/// Arguments of `graph`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct GraphArgs {
    /// The chart.
    #[arg(value_name = "CHART")]
    pub(crate) chart: PathBuf,
    /// The output file: `.svg`, `.mmd` (Mermaid) or `.puml` (PlantUML).
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Draw again whenever the chart changes.
    #[arg(long)]
    pub(crate) watch: bool,
}

/// Draws the chart; with `watch`, after each change. Returns the exit status: 2 when the chart cannot be read or the
/// file cannot be written.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(args: &GraphArgs, out: &mut dyn Write) -> io::Result<u8> {
    if args.watch {
        return changes::follow(std::slice::from_ref(&args.chart), &[], out, |out| draw(args, out));
    }
    draw(args, out)
}

fn draw(args: &GraphArgs, out: &mut dyn Write) -> io::Result<u8> {
    let Some(render) = renderer(&args.output) else {
        writeln!(out, "error: `{}` ends in neither .svg, .mmd nor .puml", args.output.display())?;
        return Ok(2);
    };
    // Only this chart is loaded: the charts and skills that it names need not exist.
    let library = chart::load(&args.chart, &[]);
    let Some(chart) = library.charts.get(&library.root) else {
        console::show(&library.findings, out)?;
        return Ok(2);
    };
    match std::fs::write(&args.output, render(&Outline::of(chart))) {
        Ok(()) => writeln!(out, "wrote {}", args.output.display()).map(|()| 0),
        Err(error) => writeln!(out, "error: {}: {error}", args.output.display()).map(|()| 2),
    }
}

fn renderer(file: &Path) -> Option<fn(&Outline) -> String> {
    match file.extension()?.to_str()? {
        "svg" => Some(svg),
        "mmd" | "mermaid" => Some(mermaid),
        "puml" | "plantuml" => Some(plantuml),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_says_what_is_written() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let chart = folder.path().join("c.yaml");
        std::fs::write(&chart, "statechart: C\ninitial: A\nstates: {A: {}}\n").expect("it can be written");
        for (ending, start, status) in
            [("svg", "<svg", 0), ("mmd", "stateDiagram-v2", 0), ("puml", "@startuml", 0), ("png", "", 2)]
        {
            let output = folder.path().join(format!("c.{ending}"));
            let args = GraphArgs { chart: chart.clone(), output: output.clone(), watch: false };
            assert_eq!(run(&args, &mut Vec::new()).expect("memory can be written"), status, "{ending}");
            let text = std::fs::read_to_string(&output).unwrap_or_default();
            assert!(text.starts_with(start), "{ending}: {text}");
        }
    }
}
