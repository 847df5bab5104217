//! `armarium check FILE...`: everything that is wrong with charts and worlds, before anything moves.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_host::catalog;
use armarium_runtime::test_cases::TestFile;
use armarium_simulator::World;
use armarium_source::{Finding, Source};

use crate::render_findings::{render, summary};

/// What `check` takes.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct CheckArgs {
    /// Charts and worlds; which one a file is, it says itself.
    #[arg(required = true, value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,
    /// Folders where charts find other charts by name, besides their own.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// Write the findings as JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// Check again whenever a file changes.
    #[arg(long, conflicts_with = "json")]
    pub(crate) watch: bool,
}

/// How the output is drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Style {
    /// Whether the place shows colours.
    pub(crate) colour: bool,
    /// Its width in columns.
    pub(crate) width: usize,
}

/// Checks all files and writes what is found. `check_chart` is given a chart's file and the folders of others.
/// Returns the exit status: 2 when there is an error, otherwise 0.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn run(
    args: &CheckArgs,
    style: Style,
    check_chart: &dyn Fn(&Path, &[PathBuf]) -> Vec<Finding>,
    out: &mut dyn Write,
) -> io::Result<u8> {
    if args.watch {
        return crate::changes::follow(&args.files, &args.charts, out, |out| {
            once(args, style, check_chart, out)
        });
    }
    once(args, style, check_chart, out)
}

fn once(
    args: &CheckArgs,
    style: Style,
    check_chart: &dyn Fn(&Path, &[PathBuf]) -> Vec<Finding>,
    out: &mut dyn Write,
) -> io::Result<u8> {
    let mut findings = Vec::new();
    for file in &args.files {
        findings.extend(check_file(file, &args.charts, check_chart));
    }
    if args.json {
        serde_json::to_writer_pretty(&mut *out, &findings)?;
        writeln!(out)?;
    } else if findings.is_empty() {
        let files = if args.files.len() == 1 { "the file is" } else { "all files are" };
        writeln!(out, "{files} in order")?;
    } else {
        write!(out, "{}", render(&findings, style.colour, style.width))?;
        writeln!(out, "{}", summary(&findings))?;
    }
    Ok(if findings.iter().any(Finding::is_error) { 2 } else { 0 })
}

fn check_file(
    file: &Path,
    charts: &[PathBuf],
    check_chart: &dyn Fn(&Path, &[PathBuf]) -> Vec<Finding>,
) -> Vec<Finding> {
    let source = match Source::read(file) {
        Ok(source) => source,
        Err(finding) => return vec![*finding],
    };
    let read = if is_world(&source.text) {
        armarium_source::read::<World>(source).map(drop)
    } else if is_cases(&source.text) {
        TestFile::read(source).map(drop)
    } else {
        return check_chart(file, charts);
    };
    read.err().unwrap_or_default()
}

/// Everything that is wrong with a chart, against the skills that ship.
pub(crate) fn check_chart(file: &Path, folders: &[PathBuf]) -> Vec<Finding> {
    catalog::load_idle(file, folders).findings
}

/// Whether a file says that it is a world: it has the key `world` and not the key `statechart` at its outermost level.
fn is_world(text: &str) -> bool {
    has_key(text, "world:") && !has_key(text, "statechart:")
}

/// Whether a file holds test cases of a chart.
fn is_cases(text: &str) -> bool {
    has_key(text, "test:") && !has_key(text, "statechart:")
}

fn has_key(text: &str, key: &str) -> bool {
    text.lines().any(|line| line.starts_with(key))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use armarium_source::{Findings, Severity, Span, code};

    use super::*;

    const PLAIN: Style = Style { colour: false, width: 100 };

    fn check(files: &[&Path], json: bool, chart: &dyn Fn(&Path, &[PathBuf]) -> Vec<Finding>) -> (u8, String) {
        let files = files.iter().map(|file| file.to_path_buf()).collect();
        let mut out = Vec::new();
        let status = run(&CheckArgs { files, json, ..Default::default() }, PLAIN, chart, &mut out);
        (status.expect("memory can be written"), String::from_utf8(out).expect("text is UTF-8"))
    }

    #[test]
    fn a_world_is_told_from_a_chart() {
        assert!(is_world("# a comment\nworld: kitchen\n"));
        assert!(!is_world("statechart: A\ninputs:\n  world: {type: string}\n"));
        assert!(!is_world("statechart: A\nworld: odd\n"));
    }

    #[test]
    fn a_file_that_is_not_there_is_an_error_of_its_own() {
        let (status, text) = check(&[Path::new("nowhere.yaml")], false, &|_, _| Vec::new());
        assert_eq!(status, 2);
        assert!(text.contains("nowhere.yaml") && text.contains("E001"), "{text}");
    }

    #[test]
    fn warnings_do_not_change_the_exit_status_and_errors_do() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.yaml");
        std::fs::write(&file, "statechart: A\n").expect("the folder can be written");
        let warn = |file: &Path, _: &[PathBuf]| {
            let mut findings = Findings::new(Arc::new(Source::new(file, "")));
            findings.add(Severity::Warning, code::UNUSED, Span::default(), "odd", None);
            findings.list
        };
        assert_eq!(check(&[&file], false, &warn).0, 0);
        assert_eq!(check(&[&file], false, &|_, _| Vec::new()), (0, "the file is in order\n".to_owned()));
        let (status, json) = check(&[&file], true, &warn);
        let json: serde_json::Value = serde_json::from_str(&json).expect("it is JSON");
        assert_eq!((status, json[0]["severity"].as_str()), (0, Some("warning")));
    }

    #[test]
    fn a_wrong_world_is_found_with_its_place() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("w.yaml");
        std::fs::write(&file, "world: w\ntabel: {height: 0.9}\n").expect("the folder can be written");
        let (status, text) = check(&[&file], false, &|_, _| Vec::new());
        assert_eq!(status, 2);
        assert!(text.contains("w.yaml:2:1") && text.contains("tabel"), "{text}");
    }
    #[test]
    fn what_is_wrong_with_test_cases_is_found_in_its_line() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.test.yaml");
        std::fs::write(&file, "test: a.yaml\ncases:\n- case: one\n  steps: [{afer: 2s}]\n")
            .expect("it can be written");
        let (status, text) = check(&[&file], false, &|_, _| Vec::new());
        assert_eq!(status, 2);
        assert!(text.contains("a.test.yaml:4:12") && text.contains("did you mean `after`?"), "{text}");
    }
}
