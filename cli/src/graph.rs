//! `armarium graph CHART -o FILE`: draws the chart as SVG or PNG, or writes it for other tools.

use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_runtime::chart::{self, Outline};
use armarium_source::Finding;
use armarium_viewer::chart::{Format, Theme, Unfold, fold, levels, levels_that_fit, render, unfold};

use crate::{changes, console};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct GraphArgs {
    /// The chart.
    #[arg(value_name = "CHART")]
    pub(crate) chart: PathBuf,
    /// The output file; its ending gives the format. `-` is the standard output.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// The format, whatever the file's ending.
    #[arg(long, value_enum)]
    pub(crate) format: Option<FormatArg>,
    /// Show a chart that this chart uses in its place, by the name of the chart or of the state; `all` shows all. May be
    /// repeated.
    #[arg(long, value_name = "NAME")]
    pub(crate) unfold: Vec<String>,
    /// Levels of states to show; what is further inside is counted. SVG and PNG show as many as fit two screens, unless it is said.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) depth: Option<u16>,
    /// Colours of SVG and PNG.
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) theme: ThemeArg,
    /// Additional folders in which charts find other charts by name.
    #[arg(long, value_name = "FOLDER")]
    pub(crate) charts: Vec<PathBuf>,
    /// Draw again whenever the chart changes.
    #[arg(long)]
    pub(crate) watch: bool,
}

/// A format by its name on the command line.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum FormatArg {
    Svg,
    Png,
    /// Graphviz.
    Dot,
    Mermaid,
    #[value(name = "plantuml")]
    PlantUml,
    /// States and transitions as data.
    Json,
}

/// Colours by their name on the command line.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum ThemeArg {
    /// SVG: what its reader prefers; PNG: light.
    Auto,
    Light,
    Dark,
}

/// Draws the chart; with `watch`, after each change. Returns the exit status: 2 when the chart cannot be read or the
/// file cannot be written.
pub(crate) fn run(args: &GraphArgs, out: &mut dyn Write) -> io::Result<u8> {
    if args.watch {
        let charts = std::slice::from_ref(&args.chart);
        return changes::follow(charts, &args.charts, out, |out| draw(args, out));
    }
    draw(args, out)
}

fn draw(args: &GraphArgs, out: &mut dyn Write) -> io::Result<u8> {
    let Some(format) = args.format.map(format).or_else(|| by_ending(&args.output)) else {
        let file = args.output.display();
        writeln!(
            out,
            "error: `{file}` does not end in .svg, .png, .dot, .mmd, .puml or .json; or use --format"
        )?;
        return Ok(2);
    };
    let library = chart::load(&args.chart, &args.charts);
    let Some(chart) = library.charts.get(&library.root) else {
        console::show(&library.findings, out)?;
        return Ok(2);
    };
    let is_folder = |finding: &Finding| args.charts.contains(&finding.source.path);
    if library.findings.iter().any(is_folder) {
        console::show(&library.findings, out)?;
        return Ok(2);
    }
    let mut outline = Outline::of(chart);
    // The charts and skills that a chart names need not exist, unless they are to be shown.
    let which = match args.unfold.iter().any(|name| name == "all") {
        true => Unfold::All,
        false => Unfold::Named(args.unfold.iter().cloned().collect()),
    };
    let unknown = unfold(&mut outline, &library.charts, &which);
    if !unknown.is_empty() {
        return refuse(&library, &unknown, out);
    }
    let picture = matches!(format, Format::Svg | Format::Png) && args.unfold.is_empty();
    let fitting = if picture && args.depth.is_none() { levels_that_fit(&outline) } else { None };
    let all = levels(&outline);
    if let Some(depth) = args.depth.map(usize::from).or(fitting) {
        outline = fold(&outline, depth);
    }
    let theme = match args.theme {
        ThemeArg::Auto => Theme::Auto,
        ThemeArg::Light => Theme::Light,
        ThemeArg::Dark => Theme::Dark,
    };
    let drawn = match render(&outline, format, theme) {
        Ok(drawn) => drawn,
        Err(error) => return writeln!(out, "error: {}: {error}", args.output.display()).map(|()| 2),
    };
    if args.output == Path::new("-") {
        return out.write_all(&drawn).map(|()| 0);
    }
    match std::fs::write(&args.output, drawn) {
        Ok(()) => {
            write!(out, "wrote {}", args.output.display())?;
            if let Some(shown) = fitting {
                write!(out, ", {shown} of {all} levels of states; `--depth {all}` shows all")?;
            }
            writeln!(out).map(|()| 0)
        }
        Err(error) => writeln!(out, "error: {}: {error}", args.output.display()).map(|()| 2),
    }
}

/// Says which charts cannot be unfolded, and what is wrong with the files.
fn refuse(library: &chart::Library, unknown: &BTreeSet<String>, out: &mut dyn Write) -> io::Result<u8> {
    console::show(&library.findings, out)?;
    let names: Vec<String> = unknown.iter().map(|name| format!("`{name}`")).collect();
    writeln!(
        out,
        "error: --unfold {}: the chart uses no chart of this name that can be read, and no state of this name has one",
        names.join(", ")
    )?;
    let others: Vec<&str> =
        library.charts.keys().filter(|name| **name != library.root).map(String::as_str).collect();
    if !others.is_empty() {
        writeln!(out, "help: it uses {}; `--unfold all` shows them all", others.join(", "))?;
    }
    Ok(2)
}

fn format(arg: FormatArg) -> Format {
    match arg {
        FormatArg::Svg => Format::Svg,
        FormatArg::Png => Format::Png,
        FormatArg::Dot => Format::Dot,
        FormatArg::Mermaid => Format::Mermaid,
        FormatArg::PlantUml => Format::PlantUml,
        FormatArg::Json => Format::Json,
    }
}

fn by_ending(file: &Path) -> Option<Format> {
    match file.extension()?.to_str()? {
        "svg" => Some(Format::Svg),
        "png" => Some(Format::Png),
        "dot" | "gv" => Some(Format::Dot),
        "mmd" | "mermaid" => Some(Format::Mermaid),
        "puml" | "plantuml" => Some(Format::PlantUml),
        "json" => Some(Format::Json),
        _ => None,
    }
}
#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        graph: GraphArgs,
    }

    const OUTER: &str = "statechart: C\ninitial: A\nstates: {A: {statechart: Inner}}\n";
    const INNER: &str = "statechart: Inner\ninitial: Deep\nstates: {Deep: {}}\n";

    /// Runs `graph` on a chart that uses another, with the arguments; gives the status, what it prints, and the file.
    fn graph(arguments: &[&str], file: &str) -> (u8, String, String) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let chart = folder.path().join("c.yaml");
        std::fs::write(&chart, OUTER).expect("it can be written");
        std::fs::write(folder.path().join("inner.yaml"), INNER).expect("it can be written");
        let output = if file == "-" { PathBuf::from(file) } else { folder.path().join(file) };
        let all = ["graph".as_ref(), chart.as_os_str(), "-o".as_ref(), output.as_os_str()];
        let all = all.into_iter().chain(arguments.iter().map(|a| a.as_ref()));
        let args = Program::try_parse_from(all).expect("the arguments are right").graph;
        let mut out = Vec::new();
        let status = run(&args, &mut out).expect("memory can be written");
        let written = std::fs::read(&output).unwrap_or_default();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (status, text(&out), text(&written))
    }

    #[test]
    fn the_ending_or_the_format_says_what_is_written() {
        for (file, start) in [
            ("c.svg", "<svg"),
            ("c.png", "\u{fffd}PNG"),
            ("c.dot", "digraph"),
            ("c.mmd", "stateDiagram-v2"),
            ("c.puml", "@startuml"),
            ("c.json", "{"),
        ] {
            let (status, _, written) = graph(&[], file);
            assert!(status == 0 && written.starts_with(start), "{file}: {written}");
        }
        assert!(graph(&["--format", "dot"], "c.txt").2.starts_with("digraph"));
        let (status, out, _) = graph(&["--format", "mermaid"], "-");
        assert!(status == 0 && out.starts_with("stateDiagram-v2"), "{out}");
        let (status, out, _) = graph(&[], "c.jpg");
        assert!(status == 2 && out.contains("use --format"), "{out}");
    }

    #[test]
    fn inner_charts_are_shown_where_that_is_asked_for_and_levels_are_counted() {
        let deep = "s_A__Deep";
        assert!(!graph(&[], "c.mmd").2.contains(deep));
        for name in ["all", "Inner", "A"] {
            assert!(graph(&["--unfold", name], "c.mmd").2.contains(deep), "{name}");
        }
        assert!(!graph(&["--unfold", "all", "--depth", "1"], "c.mmd").2.contains(deep));
        let (status, out, _) = graph(&["--unfold", "Inne"], "c.mmd");
        assert!(status == 2 && out.contains("`Inne`") && out.contains("it uses Inner"), "{out}");
    }
}
