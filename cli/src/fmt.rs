//! `armarium fmt FILE...`: gives files their form: two spaces a level, lines of readable length. Comments stay.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_source::{Finding, Source};

use crate::console;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct FmtArgs {
    /// Charts, worlds, test cases and files of prior knowledge.
    #[arg(required = true, value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,
    /// Change nothing; list the files that have another form, and end with status 1 if there are any.
    #[arg(long)]
    pub(crate) check: bool,
}

/// Writes the files that have another form, or lists them. Returns the exit status: 2 when a file cannot be read, is no YAML or
/// cannot be written, 1 when `--check` finds one that has another form, otherwise 0.
pub(crate) fn run(args: &FmtArgs, out: &mut dyn Write) -> io::Result<u8> {
    let mut status = 0;
    for file in &args.files {
        let one = match form(file) {
            Ok(None) => 0,
            Ok(Some(_)) if args.check => {
                writeln!(out, "{} has another form", file.display())?;
                1
            }
            Ok(Some(text)) => match std::fs::write(file, text) {
                Ok(()) => writeln!(out, "formatted {}", file.display()).map(|()| 0)?,
                Err(error) => writeln!(out, "error: {}: {error}", file.display()).map(|()| 2)?,
            },
            Err(findings) => {
                console::show(&findings, out)?;
                2
            }
        };
        status = status.max(one);
    }
    Ok(status)
}

/// The text that a file should have; none where it has it.
fn form(file: &Path) -> Result<Option<String>, Vec<Finding>> {
    let source = Source::read(file).map_err(|finding| vec![*finding])?;
    let text = armarium_editor::format(file, &source.text)?;
    Ok((text != source.text).then_some(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fmt(file: &Path, check: bool) -> (u8, String) {
        let mut out = Vec::new();
        let status =
            run(&FmtArgs { files: vec![file.to_owned()], check }, &mut out).expect("memory can be written");
        (status, String::from_utf8(out).expect("text is UTF-8"))
    }

    #[test]
    fn a_file_is_given_its_form_once() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("w.yaml");
        std::fs::write(&file, "world: w # mine\ntable:\n    height: 0.9\n").expect("it can be written");
        assert_eq!(fmt(&file, true).0, 1);
        assert_eq!(fmt(&file, false).0, 0);
        assert_eq!(
            std::fs::read_to_string(&file).expect("it is there"),
            "world: w # mine\ntable:\n  height: 0.9\n"
        );
        assert_eq!(fmt(&file, true), (0, String::new()));
        std::fs::write(&file, "a: [").expect("it can be written");
        let (status, text) = fmt(&file, false);
        assert!(status == 2 && text.contains("E002"), "{text}");
    }

    /// What ships has the form.
    #[test]
    fn the_charts_that_ship_are_formatted() {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../statecharts"));
        let template = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src/template"));
        let entries =
            [folder, template].into_iter().flat_map(|folder| std::fs::read_dir(folder).expect("it is there"));
        let files = entries
            .flatten()
            .map(|entry| entry.path())
            .filter(|path| armarium_source::is_yaml(path))
            .collect();
        let mut out = Vec::new();
        let status = run(&FmtArgs { files, check: true }, &mut out).expect("memory can be written");
        assert_eq!((status, String::from_utf8_lossy(&out).as_ref()), (0, ""));
    }
}
