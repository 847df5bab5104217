//! What is wrong with a file, and where: data that the program renders. Nothing is printed here.

use std::fmt;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::ser::{Serialize, SerializeStruct as _, Serializer};

use crate::code;

/// Largest file, bytes.
pub(crate) const MAX_BYTES: usize = 10_000_000;

/// A file's text, kept so that findings can show it.
#[derive(Debug, PartialEq, Eq)]
pub struct Source {
    /// Where it was read from.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
    lines: Vec<usize>,
}

impl Source {
    /// A text and where it came from.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>, text: impl Into<String>) -> Self {
        let text = text.into();
        let starts = text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i + 1);
        let lines = std::iter::once(0).chain(starts).collect();
        Self { path: path.into(), text, lines }
    }

    /// Reads a file of UTF-8 text, 10 MB at most.
    ///
    /// # Errors
    /// A finding about the file as a whole.
    pub fn read(path: &Path) -> Result<Arc<Self>, Box<Finding>> {
        let refuse = |message: String, help: &str| {
            let help = (!help.is_empty()).then(|| help.to_owned());
            let source = Arc::new(Self::new(path, ""));
            Box::new(Finding::error(source, code::FILE, Span::default(), message, help))
        };
        let mut bytes = Vec::new();
        std::fs::File::open(path)
            .and_then(|file| file.take(MAX_BYTES as u64 + 1).read_to_end(&mut bytes))
            .map_err(|error| refuse(format!("the file cannot be read: {error}"), "is the path right?"))?;
        if bytes.len() > MAX_BYTES {
            let (message, help) = too_large();
            return Err(refuse(message, help));
        }
        match String::from_utf8(bytes) {
            Ok(text) => Ok(Arc::new(Self::new(path, text))),
            Err(error) => {
                let utf16 = matches!(error.as_bytes(), [0xff, 0xfe, ..] | [0xfe, 0xff, ..]);
                let what = if utf16 { "UTF-16" } else { "not UTF-8 text" };
                let at = error.utf8_error().valid_up_to();
                Err(refuse(format!("the file is {what} (byte {at}): save it as UTF-8"), ""))
            }
        }
    }

    /// Line and column of a byte, both from 1; columns count characters.
    #[must_use]
    pub fn position(&self, byte: usize) -> (usize, usize) {
        let line = self.lines.partition_point(|start| *start <= byte).max(1);
        let start = self.lines[line - 1];
        let before = self.text.get(start..byte.min(self.text.len())).unwrap_or("");
        (line, before.chars().count() + 1)
    }

    /// `file:line:column` of a byte.
    #[must_use]
    pub fn place(&self, byte: usize) -> String {
        let (line, column) = self.position(byte);
        format!("{}:{line}:{column}", self.path.display())
    }
}

/// A range of bytes in a source.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// First byte.
    pub start: usize,
    /// End, exclusive.
    pub end: usize,
}

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The file can be used, but probably does not say what is meant.
    Warning,
    /// The file cannot be used.
    Error,
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// Its stable code, see [`code`].
    pub code: &'static str,
    /// The file that it is in.
    pub source: Arc<Source>,
    /// Where it is.
    pub span: Span,
    /// What is wrong, one sentence.
    pub message: String,
    /// What to do about it.
    pub help: Option<String>,
}

impl Finding {
    /// An error.
    #[must_use]
    pub fn error(
        source: Arc<Source>,
        code: &'static str,
        span: Span,
        message: impl Into<String>,
        help: Option<String>,
    ) -> Self {
        Self { severity: Severity::Error, code, source, span, message: message.into(), help }
    }

    /// Line and column, both from 1.
    #[must_use]
    pub fn position(&self) -> (usize, usize) {
        self.source.position(self.span.start)
    }

    /// Whether it keeps the file from being used.
    #[must_use]
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }

    /// Whether no place in the file is meant: its text is not there.
    #[must_use]
    pub fn is_about_the_file(&self) -> bool {
        self.source.text.is_empty()
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.is_error() { "error" } else { "warning" };
        write!(f, "{}: {kind}[{}]: {}", self.source.place(self.span.start), self.code, self.message)?;
        self.help.as_ref().map_or(Ok(()), |help| write!(f, " ({help})"))
    }
}

/// For programs: `severity`, `code`, `file`, `line`, `column` (0 where the file as a whole is meant), `span` (first byte and
/// length), `message` and `help`.
impl Serialize for Finding {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (line, column) = if self.is_about_the_file() { (0, 0) } else { self.position() };
        let mut fields = serializer.serialize_struct("Finding", 8)?;
        fields.serialize_field("severity", if self.is_error() { "error" } else { "warning" })?;
        fields.serialize_field("code", self.code)?;
        fields.serialize_field("file", &self.source.path)?;
        fields.serialize_field("line", &line)?;
        fields.serialize_field("column", &column)?;
        fields.serialize_field("span", &(self.span.start, self.span.end.saturating_sub(self.span.start)))?;
        fields.serialize_field("message", &self.message)?;
        fields.serialize_field("help", self.help.as_deref().unwrap_or(""))?;
        fields.end()
    }
}

/// Collects the findings about one file.
#[derive(Clone, Debug)]
pub struct Findings {
    /// The file.
    pub source: Arc<Source>,
    /// What is wrong with it, in the order in which it was found.
    pub list: Vec<Finding>,
}

impl Findings {
    /// None yet.
    #[must_use]
    pub fn new(source: Arc<Source>) -> Self {
        Self { source, list: Vec::new() }
    }

    /// Adds a finding.
    pub fn add(
        &mut self,
        severity: Severity,
        code: &'static str,
        span: Span,
        message: impl Into<String>,
        help: Option<String>,
    ) {
        let source = Arc::clone(&self.source);
        self.list.push(Finding { severity, code, source, span, message: message.into(), help });
    }

    /// Adds an error.
    pub fn error(&mut self, code: &'static str, span: Span, message: impl Into<String>) {
        self.add(Severity::Error, code, span, message, None);
    }

    /// Adds an error with what to do about it.
    pub fn error_help(
        &mut self,
        code: &'static str,
        span: Span,
        message: impl Into<String>,
        help: Option<String>,
    ) {
        self.add(Severity::Error, code, span, message, help);
    }
}

/// `did you mean ...?`, where a candidate is near.
#[must_use]
pub fn suggest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<String> {
    armarium_values::expr::nearest(name, candidates).map(|near| format!("did you mean `{near}`?"))
}

/// What is said of a file over the limit, and what to do about it.
pub(crate) fn too_large() -> (String, &'static str) {
    (format!("the file has more than {} MB", MAX_BYTES / 1_000_000), "put parts of it in files of their own")
}
