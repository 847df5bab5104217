//! What is wrong with a file, and where: data that the program renders. Nothing is printed here.

use std::collections::BTreeSet;
use std::fmt;
use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;

use serde::ser::{Serialize, SerializeStruct as _, Serializer};

use crate::code;
use crate::remedy::{Edit, Remedy};
use crate::span::Span;
use crate::text::Source;

/// Most names that are listed.
const LISTED: usize = 20;

/// Largest file, bytes.
pub(crate) const MAX_BYTES: usize = 10_000_000;

impl Source {
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
    /// The same as data, where a program can do it.
    pub remedy: Option<Remedy>,
}

impl Finding {
    /// An error.
    pub fn error(
        source: Arc<Source>,
        code: &'static str,
        span: Span,
        message: impl Into<String>,
        help: Option<String>,
    ) -> Self {
        Self { severity: Severity::Error, code, source, span, message: message.into(), help, remedy: None }
    }

    /// The edits that put it right, in the order of the text; none where a person has to decide.
    #[must_use]
    pub fn edits(&self) -> Vec<Edit> {
        self.remedy.as_ref().map_or_else(Vec::new, |remedy| remedy.edits(&self.source))
    }

    /// Line and column, both from 1.
    pub fn position(&self) -> (usize, usize) {
        self.source.position(self.span.start)
    }

    /// Whether it keeps the file from being used.
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }

    /// Whether no place in the file is meant: its text is not there.
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
/// length), `message`, `help`, and `edits` that put it right, each with its `span` and the `text` that stands there then.
impl Serialize for Finding {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (line, column) = if self.is_about_the_file() { (0, 0) } else { self.position() };
        let mut fields = serializer.serialize_struct("Finding", 9)?;
        fields.serialize_field("severity", if self.is_error() { "error" } else { "warning" })?;
        fields.serialize_field("code", self.code)?;
        fields.serialize_field("file", &self.source.path)?;
        fields.serialize_field("line", &line)?;
        fields.serialize_field("column", &column)?;
        let span = |span: Span| (span.start, span.end.saturating_sub(span.start));
        let edit = |edit: &Edit| serde_json::json!({"span": span(edit.span), "text": edit.text});
        fields.serialize_field("span", &span(self.span))?;
        fields.serialize_field("message", &self.message)?;
        fields.serialize_field("help", self.help.as_deref().unwrap_or(""))?;
        fields.serialize_field("edits", &self.edits().iter().map(edit).collect::<Vec<_>>())?;
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
        self.list.push(Finding { severity, code, source, span, message: message.into(), help, remedy: None });
    }

    /// Says how the finding that was added last is put right.
    pub fn remedy(&mut self, remedy: Remedy) {
        if let Some(finding) = self.list.last_mut() {
            finding.remedy = Some(remedy);
        }
    }

    /// Adds an error about a name that stands for nothing. If one of `known` is near, the help proposes it and an edit
    /// puts it there; otherwise `help` is the help, or a list of those that are known.
    pub fn unknown<'a>(
        &mut self,
        code: &'static str,
        at: (Span, &str),
        message: impl Into<String>,
        known: impl IntoIterator<Item = &'a str>,
        help: Option<String>,
    ) {
        let known: BTreeSet<&str> = known.into_iter().collect();
        let near = armarium_values::expr::nearest(at.1, known.iter().copied());
        let help = near.map(proposed).or(help).unwrap_or_else(|| listed(&known));
        self.error_help(code, at.0, message, Some(help));
        if let Some(near) = near {
            self.remedy(Remedy::replace(at.0, near));
        }
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
pub fn suggest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<String> {
    armarium_values::expr::nearest(name, candidates).map(proposed)
}

/// `known are: ...`, with as many as one reads.
pub fn listed(known: &BTreeSet<impl AsRef<str>>) -> String {
    let names: Vec<&str> = known.iter().take(LISTED).map(AsRef::as_ref).collect();
    let more = known.len() - names.len();
    match (names.is_empty(), more) {
        (true, _) => "none is known".into(),
        (false, 0) => format!("known are: {}", names.join(", ")),
        (false, more) => format!("known are: {}, and {more} more", names.join(", ")),
    }
}

fn proposed(near: &str) -> String {
    format!("did you mean `{near}`?")
}

/// What is said of a file over the limit, and what to do about it.
pub(crate) fn too_large() -> (String, &'static str) {
    (format!("the file has more than {} MB", MAX_BYTES / 1_000_000), "put parts of it in files of their own")
}
