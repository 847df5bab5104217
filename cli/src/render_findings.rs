//! What is wrong with a file, for people: the text under a caret, with code and help. Nothing is printed here.

use std::sync::Arc;

use armarium_source::Finding;
use miette::{
    Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, MietteError, MietteSpanContents,
    NamedSource, SourceCode, SourceSpan, SpanContents,
};

/// Findings one a line, for messages of another kind.
pub(crate) fn lines(findings: &[Finding]) -> String {
    findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

/// How many findings are rendered; the others are counted.
const MOST: usize = 50;

/// Findings as text for a terminal, `width` columns wide, each with its line of the file.
pub(crate) fn render(findings: &[Finding], colour: bool, width: usize) -> String {
    let theme = if colour { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
    let handler = GraphicalReportHandler::new_themed(theme).with_links(false).with_width(width.max(40));
    let mut out = String::new();
    for finding in findings.iter().take(MOST) {
        if handler.render_report(&mut out, &Rendered::new(finding)).is_err() {
            out.push_str(&format!("{finding}\n"));
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

/// `3 errors, 1 warning`.
pub(crate) fn summary(findings: &[Finding]) -> String {
    let errors = findings.iter().filter(|finding| finding.is_error()).count();
    let plural = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    format!("{}, {}", plural(errors, "error"), plural(findings.len() - errors, "warning"))
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

/// A finding with the text that it points into, unless it is about the file as a whole.
#[derive(Debug)]
struct Rendered<'a> {
    finding: &'a Finding,
    source: Option<Cut>,
    /// First byte and length in the text that is shown.
    span: (usize, usize),
}

impl<'a> Rendered<'a> {
    fn new(finding: &'a Finding) -> Self {
        let whole = &finding.source.text;
        let mut span = (finding.span.start, finding.span.end.saturating_sub(finding.span.start));
        let shown = !finding.is_about_the_file() && whole.is_char_boundary(span.0);
        let source = shown.then(|| {
            let column = |text: &str, at: usize| at - text[..at].rfind('\n').map_or(0, |line| line + 1);
            let (text, columns) = match shortened(whole, span) {
                None => (whole.as_str().into(), 0),
                Some((short, place)) => {
                    let lost = column(whole, span.0).saturating_sub(column(&short, place.0));
                    span = place;
                    (short.into(), lost)
                }
            };
            Cut { text: NamedSource::new(finding.source.path.display().to_string(), text), columns }
        });
        Self { finding, source, span }
    }
}

impl std::fmt::Display for Rendered<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.source {
            Some(_) => f.write_str(&self.finding.message),
            None => write!(f, "{}: {}", self.finding.source.path.display(), self.finding.message),
        }
    }
}

impl std::error::Error for Rendered<'_> {}

impl Diagnostic for Rendered<'_> {
    fn code<'a>(&'a self) -> Option<Box<dyn std::fmt::Display + 'a>> {
        Some(Box::new(self.finding.code))
    }

    fn severity(&self) -> Option<miette::Severity> {
        Some(if self.finding.is_error() { miette::Severity::Error } else { miette::Severity::Warning })
    }

    fn help<'a>(&'a self) -> Option<Box<dyn std::fmt::Display + 'a>> {
        self.finding.help.as_ref().map(|help| Box::new(help) as Box<dyn std::fmt::Display>)
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
    use armarium_source::{Severity, Source, Span, code};

    use super::*;

    fn finding(text: &str, (start, length): (usize, usize)) -> Finding {
        Finding {
            severity: Severity::Error,
            code: code::SKILL,
            source: Arc::new(Source::new("a.yaml", text)),
            span: Span { start, end: start + length },
            message: "there is no skill `MoveJonts`".into(),
            help: Some("did you mean `MoveJoints`?".into()),
        }
    }

    #[test]
    fn a_finding_has_file_line_column_caret_code_and_help() {
        let text = render(&[finding("states:\n  A: {skill: MoveJonts}\n", (21, 9))], false, 200);
        for part in ["a.yaml:2:14", "E012", "no skill `MoveJonts`", "did you mean `MoveJoints`?"] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        let marked = text.lines().skip_while(|line| !line.contains("{skill: MoveJonts}")).nth(1);
        assert!(marked.is_some_and(|line| line.contains('─')), "{text}");
    }

    #[test]
    fn a_place_outside_of_the_file_and_a_missing_file_are_still_said() {
        let text = render(&[finding("", (3, 4)), finding("", (0, 0))], false, 80);
        assert_eq!(text.matches("a.yaml").count(), 2, "{text}");
        for span in [(0, 1), (1, 1), (3, 0), (3, 900), (900, 1)] {
            assert!(render(&[finding("é\n", span)], true, 80).contains("MoveJonts"), "{span:?}");
        }
    }

    #[test]
    fn a_very_long_line_is_cut_and_its_place_kept() {
        let line = format!("{}MoveJonts{}", "é".repeat(1000), "y".repeat(1000));
        let text = render(&[finding(&format!("a\n{line}\n{line}\n"), (2002, 9))], false, 200);
        assert!(text.contains("a.yaml:2:") && text.lines().all(|line| line.chars().count() < 260), "{text}");
        let at = |mark: &str| text.lines().position(|line| line.contains(mark)).expect(mark);
        let marked = text.lines().nth(at("éMoveJonts") + 1).expect("there is a line for the caret");
        assert_eq!(marked.matches('─').count(), 9, "{text}");
    }

    #[test]
    fn many_findings_are_counted() {
        let many = vec![finding("", (0, 0)); 60];
        assert!(render(&many, false, 80).ends_with("... and 10 more\n"));
        assert_eq!(summary(&many), "60 errors, 0 warnings");
        assert_eq!(summary(&many[..1]), "1 error, 0 warnings");
    }
}
