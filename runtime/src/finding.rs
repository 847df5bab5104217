//! What is wrong with a chart, and where: data that the program renders; nothing is printed here.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;

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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Span {
    /// First byte.
    pub start: usize,
    /// End, exclusive.
    pub end: usize,
}

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The chart runs, but probably not as meant.
    Warning,
    /// The chart does not run.
    Error,
}

/// Stable codes of findings, each with what it stands for.
pub mod code {
    /// The file cannot be read, or is too large.
    pub const FILE: &str = "E001";
    /// The file is not YAML.
    pub const YAML: &str = "E002";
    /// A key that the language does not have.
    pub const KEY: &str = "E003";
    /// A value of the wrong form, for instance a list where a name is needed.
    pub const FORM: &str = "E004";
    /// A key that must be there is missing.
    pub const MISSING_KEY: &str = "E005";
    /// A name that cannot be used.
    pub const NAME: &str = "E006";
    /// A state that is two things at once.
    pub const KIND: &str = "E007";
    /// A name that is there twice.
    pub const DUPLICATE: &str = "E008";
    /// More states or levels than are allowed.
    pub const LIMIT: &str = "E009";
    /// A target or state that does not exist.
    pub const STATE: &str = "E010";
    /// A chart that does not exist, or two of one name.
    pub const CHART: &str = "E011";
    /// A skill that does not exist.
    pub const SKILL: &str = "E012";
    /// Charts that contain each other.
    pub const CYCLE: &str = "E013";
    /// An input that the skill or chart does not have.
    pub const INPUT: &str = "E014";
    /// An input that must be given.
    pub const MISSING_INPUT: &str = "E015";
    /// A value of the wrong type.
    pub const TYPE: &str = "E016";
    /// A value in a unit of the wrong kind.
    pub const UNIT: &str = "E017";
    /// A name in an expression that stands for nothing.
    pub const VARIABLE: &str = "E018";
    /// Text that is not an expression.
    pub const EXPRESSION: &str = "E019";
    /// A channel that nobody publishes.
    pub const CHANNEL: &str = "E020";
    /// A function that does not exist.
    pub const FUNCTION: &str = "E021";
    /// An event that nobody raises.
    pub const EVENT: &str = "E022";
    /// Two regions that can command one limb at the same time.
    pub const LIMB: &str = "E023";
    /// A type that does not exist.
    pub const DECLARED_TYPE: &str = "E024";
    /// A chart or skill of another agent that cannot be used.
    pub const REMOTE: &str = "E025";
    /// Targets that cannot be entered together.
    pub const TOGETHER: &str = "E026";
    /// An output that is read before its state can have ended.
    pub const EARLY: &str = "E027";
    /// An outcome that nobody handles.
    pub const UNHANDLED: &str = "W101";
    /// A state that cannot be reached.
    pub const UNREACHABLE: &str = "W102";
    /// A transition that cannot fire.
    pub const SHADOWED: &str = "W103";
    /// A value that has no effect.
    pub const UNUSED: &str = "W104";
    /// A chart or skill of another agent that was not asked.
    pub const UNASKED: &str = "W105";
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq)]
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
    /// Line and column, both from 1.
    #[must_use]
    pub fn position(&self) -> (usize, usize) {
        self.source.position(self.span.start)
    }

    /// Whether it keeps the chart from running.
    #[must_use]
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.is_error() { "error" } else { "warning" };
        write!(f, "{}: {kind}[{}]: {}", self.source.place(self.span.start), self.code, self.message)?;
        self.help.as_ref().map_or(Ok(()), |help| write!(f, " ({help})"))
    }
}

/// Collects the findings about one file.
#[derive(Debug)]
pub(crate) struct Findings {
    pub(crate) source: Arc<Source>,
    pub(crate) list: Vec<Finding>,
}

impl Findings {
    pub(crate) fn new(source: Arc<Source>) -> Self {
        Self { source, list: Vec::new() }
    }

    pub(crate) fn add(
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

    pub(crate) fn error(&mut self, code: &'static str, span: Span, message: impl Into<String>) {
        self.add(Severity::Error, code, span, message, None);
    }

    pub(crate) fn error_help(
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
pub(crate) fn suggest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<String> {
    armarium_values::expr::nearest(name, candidates).map(|near| format!("did you mean `{near}`?"))
}
