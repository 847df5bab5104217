//! `armarium import FILE`: converts a chart of another language to ours, and prints it.

use std::io::{self, Read as _, Write};
use std::path::{Path, PathBuf};

use armarium_runtime::import;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ImportArgs {
    /// An SCXML document.
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
}

/// Writes the chart to `out`, and what cannot be converted to `err`. Returns the exit status: 2 if anything could not
/// be converted.
pub(crate) fn run(args: &ImportArgs, out: &mut dyn Write, err: &mut dyn Write) -> io::Result<u8> {
    let shown = args.file.display();
    let text = match read(&args.file) {
        Ok(text) => text,
        Err(message) => {
            writeln!(err, "error: {shown}: {message}")?;
            return Ok(2);
        }
    };
    let name = args.file.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    match import::scxml(&text, &name) {
        Ok(imported) => {
            write!(out, "{}", imported.yaml)?;
            Ok(0)
        }
        Err(errors) => {
            for error in errors {
                writeln!(err, "error: {shown}:{}: {}", error.line, error.message)?;
            }
            Ok(2)
        }
    }
}

/// A file's text, if it is not longer than any document may be.
fn read(file: &Path) -> Result<String, String> {
    let mut bytes = Vec::new();
    let file = std::fs::File::open(file).map_err(|e| format!("the file cannot be read: {e}"))?;
    file.take(import::MAX_BYTES as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| format!("the file cannot be read: {e}"))?;
    String::from_utf8(bytes).map_err(|_| "the file is not UTF-8 text".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn import(text: &str) -> (u8, String, String) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("demo.scxml");
        std::fs::write(&file, text).expect("the folder can be written");
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let status = run(&ImportArgs { file }, &mut out, &mut err).expect("memory can be written");
        let text = |bytes| String::from_utf8(bytes).expect("text is UTF-8");
        (status, text(out), text(err))
    }

    #[test]
    fn a_chart_goes_out_and_mistakes_go_to_err_with_file_and_line() {
        let (status, out, err) = import("<scxml><state id='a'/></scxml>");
        assert_eq!((status, err.as_str()), (0, ""));
        assert!(out.contains("statechart: demo\n"), "{out}");
        let (status, out, err) = import("<scxml><state id='a'>\n<script/></state></scxml>");
        assert_eq!((status, out.as_str()), (2, ""));
        assert!(err.contains("demo.scxml:2: `<script>`"), "{err}");
    }
}
