//! What is wrong with a file, for people and for programs: the text under a caret with code and help, or JSON.
//!
//! Rooms give findings as data of their own; [`Shown`] is what the program makes of any of them. Nothing is printed
//! here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_runtime::chart::Finding;
use armarium_simulator::WorldError;
use miette::{
    Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, MietteError, MietteSpanContents,
    NamedSource, SourceCode, SourceSpan, SpanContents,
};
use serde::Serialize;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Severity {
    /// The file cannot be used.
    Error,
    /// The file can be used, but probably does not say what is meant.
    Warning,
}

/// One finding with its place.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Shown {
    /// How much it matters.
    pub(crate) severity: Severity,
    /// A stable code, for instance `world::unknown_key`.
    pub(crate) code: String,
    /// The file.
    pub(crate) file: PathBuf,
    /// Line from 1; 0 when the file as a whole is meant.
    pub(crate) line: usize,
    /// Column from 1, in characters.
    pub(crate) column: usize,
    /// Byte offset and length in the file's text.
    pub(crate) span: (usize, usize),
    /// What is wrong.
    pub(crate) message: String,
    /// What to do about it; may be empty.
    pub(crate) help: String,
}

impl From<&WorldError> for Shown {
    fn from(error: &WorldError) -> Self {
        Self {
            severity: Severity::Error,
            code: error.code.to_owned(),
            file: error.file.clone(),
            line: error.line,
            column: error.column,
            span: error.span,
            message: error.message.clone(),
            help: error.help.clone(),
        }
    }
}

impl From<&Finding> for Shown {
    fn from(finding: &Finding) -> Self {
        let (line, column) = finding.position();
        // A finding about a file without text is about the file as a whole.
        let whole = finding.source.text.is_empty();
        Self {
            severity: if finding.is_error() { Severity::Error } else { Severity::Warning },
            code: finding.code.to_owned(),
            file: finding.source.path.clone(),
            line: if whole { 0 } else { line },
            column: if whole { 0 } else { column },
            span: (finding.span.start, finding.span.end.saturating_sub(finding.span.start)),
            message: finding.message.clone(),
            help: finding.help.clone().unwrap_or_default(),
        }
    }
}

/// How many findings are rendered; the others are counted.
const MOST: usize = 50;

/// Findings as text for a terminal, `width` columns wide, each with its line of the file; files are read once.
pub(crate) fn render(findings: &[Shown], colour: bool, width: usize) -> String {
    let theme = if colour { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
    let handler = GraphicalReportHandler::new_themed(theme).with_links(false).with_width(width.max(40));
    let mut sources: BTreeMap<&Path, Option<Arc<str>>> = BTreeMap::new();
    let mut out = String::new();
    for finding in findings.iter().take(MOST) {
        let read = || std::fs::read_to_string(&finding.file).ok().map(Into::into);
        let text = sources.entry(&finding.file).or_insert_with(read).clone();
        let diagnostic = Rendered::new(finding, text);
        if handler.render_report(&mut out, &diagnostic).is_err() {
            out.push_str(&plain(finding));
        }
        out.push('\n');
    }
    if findings.len() > MOST {
        out.push_str(&format!("... and {} more\n", findings.len() - MOST));
    }
    out
}

/// Longest line that is shown whole, and how much of a longer one is shown before the place, bytes.
const LONGEST_LINE: usize = 200;
const BEFORE: usize = 80;

/// A text with the same number of lines whose long ones near a place are cut, and the place in it; nothing where none is.
fn shortened(text: &str, (start, length): (usize, usize)) -> Option<(String, (usize, usize))> {
    let first = text.get(..start)?.matches('\n').count();
    let near = |line: usize| line.abs_diff(first) <= 1;
    if !text.split('\n').enumerate().any(|(at, line)| near(at) && line.len() > LONGEST_LINE) {
        return None;
    }
    let column = start - text[..start].rfind('\n').map_or(0, |at| at + 1);
    let (mut short, mut place) = (String::new(), (start, length));
    for (at, line) in text.split('\n').enumerate() {
        if at > 0 {
            short.push('\n');
        }
        if !near(at) {
            continue;
        }
        let from = line.floor_char_boundary(if at == first { column.saturating_sub(BEFORE) } else { 0 });
        let to = line.floor_char_boundary(from + LONGEST_LINE);
        if from > 0 {
            short.push_str("... ");
        }
        if at == first {
            place = (short.len() + column - from, length.min(to.saturating_sub(column)));
        }
        short.push_str(&line[from..to]);
        if to < line.len() {
            short.push_str(" ...");
        }
    }
    Some((short, place))
}

/// A finding on one line.
fn plain(finding: &Shown) -> String {
    let Shown { file, line, column, message, .. } = finding;
    format!("{}:{line}:{column}: {message}\n", file.display())
}

/// `3 errors, 1 warning`.
pub(crate) fn summary(findings: &[Shown]) -> String {
    let count = |severity| findings.iter().filter(|finding| finding.severity == severity).count();
    let plural = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    format!("{}, {}", plural(count(Severity::Error), "error"), plural(count(Severity::Warning), "warning"))
}

/// Whether a run is out of the question.
pub(crate) fn any_error(findings: &[Shown]) -> bool {
    findings.iter().any(|finding| finding.severity == Severity::Error)
}

/// A file's text, or what is left of it where its lines are very long.
#[derive(Debug)]
struct Cut {
    text: NamedSource<Arc<str>>,
    /// How many columns the place has lost.
    columns: usize,
}

impl SourceCode for Cut {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        lines_before: usize,
        lines_after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let found = self.text.read_span(span, lines_before, lines_after)?;
        if self.columns == 0 || lines_before + lines_after > 0 {
            return Ok(found);
        }
        // What the head of a finding says is the place in the file.
        let (line, column) = (found.line(), found.column() + self.columns);
        let name = found.name().unwrap_or_default().to_owned();
        let (data, span, lines) = (found.data(), *found.span(), found.line_count());
        Ok(Box::new(MietteSpanContents::new_named(name, data, span, line, column, lines)))
    }
}

/// A finding with the text that it points into.
#[derive(Debug)]
struct Rendered<'a> {
    finding: &'a Shown,
    source: Option<Cut>,
    span: (usize, usize),
}

impl<'a> Rendered<'a> {
    fn new(finding: &'a Shown, text: Option<Arc<str>>) -> Self {
        let mut span = finding.span;
        let source = text.filter(|text| finding.line > 0 && span.0 <= text.len()).map(|text| {
            let column = |text: &str, at: usize| at - text[..at].rfind('\n').map_or(0, |line| line + 1);
            let (text, columns) = match shortened(&text, span) {
                None => (text, 0),
                Some((short, place)) => {
                    let lost = column(&text, span.0).saturating_sub(column(&short, place.0));
                    span = place;
                    (short.into(), lost)
                }
            };
            Cut { text: NamedSource::new(finding.file.display().to_string(), text), columns }
        });
        Self { finding, source, span }
    }
}

impl std::fmt::Display for Rendered<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.source {
            Some(_) => f.write_str(&self.finding.message),
            None => write!(f, "{}: {}", self.finding.file.display(), self.finding.message),
        }
    }
}

impl std::error::Error for Rendered<'_> {}

impl Diagnostic for Rendered<'_> {
    fn code<'a>(&'a self) -> Option<Box<dyn std::fmt::Display + 'a>> {
        Some(Box::new(&self.finding.code))
    }

    fn severity(&self) -> Option<miette::Severity> {
        Some(match self.finding.severity {
            Severity::Error => miette::Severity::Error,
            Severity::Warning => miette::Severity::Warning,
        })
    }

    fn help<'a>(&'a self) -> Option<Box<dyn std::fmt::Display + 'a>> {
        (!self.finding.help.is_empty()).then(|| Box::new(&self.finding.help) as Box<dyn std::fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.source.as_ref().map(|source| source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let source = self.source.as_ref()?;
        let (start, length) = self.span;
        let length = length.clamp(1, source.text.inner().len().saturating_sub(start).max(1));
        Some(Box::new(std::iter::once(LabeledSpan::underline((start, length)))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(file: &Path, line: usize, span: (usize, usize)) -> Shown {
        Shown {
            severity: Severity::Error,
            code: "chart::unknown_skill".into(),
            file: file.to_owned(),
            line,
            column: 10,
            span,
            message: "there is no skill `MoveJonts`".into(),
            help: "did you mean `MoveJoints`?".into(),
        }
    }

    #[test]
    fn a_finding_has_file_line_column_caret_code_and_help() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.yaml");
        std::fs::write(&file, "states:\n  A: {skill: MoveJonts}\n").expect("the folder can be written");
        let text = render(&[finding(&file, 2, (21, 9))], false, 200);
        for part in
            ["a.yaml:2:14", "chart::unknown_skill", "no skill `MoveJonts`", "did you mean `MoveJoints`?"]
        {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        let marked = text.lines().skip_while(|line| !line.contains("{skill: MoveJonts}")).nth(1);
        assert!(marked.is_some_and(|line| line.contains('─')), "{text}");
    }

    #[test]
    fn a_place_outside_of_the_file_and_a_missing_file_are_still_said() {
        let missing = Path::new("nowhere.yaml");
        let text = render(&[finding(missing, 2, (3, 4)), finding(missing, 0, (0, 0))], false, 80);
        assert_eq!(text.matches("nowhere.yaml").count(), 2, "{text}");
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.yaml");
        std::fs::write(&file, "é\n").expect("the folder can be written");
        for span in [(0, 1), (1, 1), (3, 0), (3, 900), (900, 1)] {
            assert!(render(&[finding(&file, 1, span)], true, 80).contains("MoveJonts"), "{span:?}");
        }
    }

    #[test]
    fn a_very_long_line_is_cut_and_its_place_kept() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.yaml");
        let line = format!("{}MoveJonts{}", "é".repeat(1000), "y".repeat(1000));
        std::fs::write(&file, format!("a\n{line}\n{line}\n")).expect("the folder can be written");
        let text = render(&[finding(&file, 2, (2002, 9))], false, 200);
        assert!(text.contains("a.yaml:2:") && text.lines().all(|line| line.chars().count() < 260), "{text}");
        let at = |mark: &str| text.lines().position(|line| line.contains(mark)).expect(mark);
        let marked = text.lines().nth(at("éMoveJonts") + 1).expect("there is a line for the caret");
        assert_eq!(marked.matches('─').count(), 9, "{text}");
    }

    #[test]
    fn many_findings_are_counted() {
        let many = vec![finding(Path::new("x"), 0, (0, 0)); 60];
        assert!(render(&many, false, 80).ends_with("... and 10 more\n"));
        assert_eq!(summary(&many), "60 errors, 0 warnings");
        assert_eq!(summary(&many[..1]), "1 error, 0 warnings");
    }
}
