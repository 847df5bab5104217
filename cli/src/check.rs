//! `armarium check FILE...`: everything that is wrong with charts, worlds, test cases and prior knowledge, before anything moves.

use std::io::{self, Write};
use std::path::PathBuf;

use armarium_editor::Catalog;
use armarium_source::{Disk, Finding};

use crate::render_findings::{render, summary};

#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct CheckArgs {
    /// Charts, worlds, test cases, object classes and scenes; which one a file is, it says itself.
    #[arg(required = true, value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,
    /// Folders where charts find other charts by name, besides their own.
    #[arg(long, value_name = "DIR")]
    pub(crate) charts: Vec<PathBuf>,
    /// Worlds whose objects charts may name, besides those beside the chart.
    #[arg(long = "world", value_name = "FILE")]
    pub(crate) worlds: Vec<PathBuf>,
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
    pub(crate) colour: bool,
    /// Its width in columns.
    pub(crate) width: usize,
}

/// Checks all files against the skills and channels of `catalog`, and writes what is found. Returns the exit status: 2 when there is an error, otherwise 0.
pub(crate) fn run(args: &CheckArgs, style: Style, catalog: &Catalog, out: &mut dyn Write) -> io::Result<u8> {
    if args.watch {
        return crate::changes::follow(&args.files, &args.charts, out, |out| once(args, style, catalog, out));
    }
    once(args, style, catalog, out)
}

fn once(args: &CheckArgs, style: Style, catalog: &Catalog, out: &mut dyn Write) -> io::Result<u8> {
    let mut findings = Vec::new();
    for file in &args.files {
        findings.extend(armarium_editor::check(file, &args.charts, &Disk, catalog).findings);
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use armarium_runtime::chart::{ChannelSchema, Registry};

    use super::*;

    const PLAIN: Style = Style { colour: false, width: 100 };

    fn check(files: &[&Path], json: bool) -> (u8, String) {
        let nothing = Catalog { registry: Registry::new(), channels: ChannelSchema::new() };
        let files = files.iter().map(|file| file.to_path_buf()).collect();
        let mut out = Vec::new();
        let status = run(&CheckArgs { files, json, ..Default::default() }, PLAIN, &nothing, &mut out);
        (status.expect("memory can be written"), String::from_utf8(out).expect("text is UTF-8"))
    }

    /// A file with this text, in a folder of its own.
    fn file(name: &str, text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join(name);
        std::fs::write(&file, text).expect("the folder can be written");
        (folder, file)
    }

    #[test]
    fn a_file_that_is_not_there_is_an_error_of_its_own() {
        let (status, text) = check(&[Path::new("nowhere.yaml")], false);
        assert_eq!(status, 2);
        assert!(text.contains("nowhere.yaml") && text.contains("E001"), "{text}");
    }

    #[test]
    fn warnings_do_not_change_the_exit_status_and_errors_do() {
        let (_folder, fine) = file("a.yaml", "statechart: A\ninitial: B\nstates: {B: {final: success}}\n");
        assert_eq!(check(&[&fine], false), (0, "the file is in order\n".to_owned()));
        let (_folder, odd) = file("a.yaml", "statechart: A\ninitial: B\nstates: {B: {}, C: {}}\n");
        assert_eq!(check(&[&odd], false).0, 0);
        let (status, json) = check(&[&odd], true);
        let json: serde_json::Value = serde_json::from_str(&json).expect("it is JSON");
        assert_eq!((status, json[0]["severity"].as_str()), (0, Some("warning")));
    }

    #[test]
    fn a_wrong_world_is_found_with_its_place() {
        let (_folder, file) = file("w.yaml", "world: w\ntabel: {height: 0.9}\n");
        let (status, text) = check(&[&file], false);
        assert_eq!(status, 2);
        assert!(text.contains("w.yaml:2:1") && text.contains("tabel"), "{text}");
    }

    #[test]
    fn what_is_wrong_with_test_cases_is_found_in_its_line() {
        let (_folder, file) =
            file("a.test.yaml", "test: a.yaml\ncases:\n- case: one\n  steps: [{afer: 2s}]\n");
        let (status, text) = check(&[&file], false);
        assert_eq!(status, 2);
        assert!(text.contains("a.test.yaml:4:12") && text.contains("did you mean `after`?"), "{text}");
    }

    #[test]
    fn an_edit_that_puts_it_right_is_in_the_json() {
        let (_folder, file) = file("w.yaml", "world: w\ntabel: {height: 0.9}\n");
        let (_, json) = check(&[&file], true);
        let json: serde_json::Value = serde_json::from_str(&json).expect("it is JSON");
        assert_eq!(json[0]["edits"], serde_json::json!([{"span": [9, 5], "text": "table"}]));
    }

    #[test]
    fn prior_knowledge_is_checked_with_the_files_beside_it() {
        let (folder, scene) =
            file("s.yaml", "scene: s\nobjects:\n- {name: a, class: cup, position: [0, 0, 0]}\n");
        let (status, text) = check(&[&scene], false);
        assert!(status == 2 && text.contains("E029"), "{text}");
        let class = folder.path().join("cup.yaml");
        std::fs::write(&class, "object: cup\ncolor: [1, 2, 3]\nsize: [0.1, 0.1, 0.1]\n")
            .expect("it can be written");
        assert_eq!(check(&[&scene, &class], false), (0, "all files are in order\n".to_owned()));
    }
}
