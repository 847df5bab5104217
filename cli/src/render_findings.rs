//! What is wrong with a file, for people: the text under a caret, with code and help. Nothing is printed here.

use annotate_snippets::renderer::DecorStyle;
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use armarium_source::Finding;

/// Findings one a line, for messages of another kind.
pub(crate) fn lines(findings: &[Finding]) -> String {
    findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

/// How many findings are rendered; the others are counted.
const MAX_RENDERED: usize = 50;

/// Findings as text for a terminal, `width` columns wide, each with its line of the file.
pub(crate) fn render(findings: &[Finding], colour: bool, width: usize) -> String {
    let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
    let renderer = renderer.decor_style(DecorStyle::Unicode).term_width(width.max(40));
    let mut out = String::new();
    for finding in findings.iter().take(MAX_RENDERED) {
        out.push_str(&renderer.render(&[report(finding)]));
        out.push_str("\n\n");
    }
    if findings.len() > MAX_RENDERED {
        out.push_str(&format!("... and {} more\n", findings.len() - MAX_RENDERED));
    }
    out
}

/// `3 errors, 1 warning`.
pub(crate) fn summary(findings: &[Finding]) -> String {
    let errors = findings.iter().filter(|finding| finding.is_error()).count();
    let plural = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    format!("{}, {}", plural(errors, "error"), plural(findings.len() - errors, "warning"))
}

/// A finding with the lines around its place, unless it is about the file as a whole.
fn report(finding: &Finding) -> Group<'_> {
    let level = if finding.is_error() { Level::ERROR } else { Level::WARNING };
    let (text, span) = (&finding.source.text, finding.span);
    let path = finding.source.path.display().to_string();
    let shown = !finding.is_about_the_file() && text.is_char_boundary(span.start);
    let group = if shown {
        // Only three lines are handed over: a file of a hundred thousand lines would be searched for each finding.
        let line_start = |at: usize| text[..at].rfind('\n').map_or(0, |newline| newline + 1);
        let here = line_start(span.start);
        let from = line_start(here.saturating_sub(1));
        let rest =
            text[span.start..].match_indices('\n').nth(1).map_or(text.len(), |(at, _)| span.start + at);
        let window = &text[from..rest];
        let start = span.start - from;
        let next = window[start..].chars().next().map_or(0, char::len_utf8);
        let end = window.floor_char_boundary(span.end.saturating_sub(from)).max(start + next);
        let snippet = Snippet::source(window)
            .line_start(finding.source.position(from).0)
            .path(path)
            .fold(false)
            .annotation(AnnotationKind::Primary.span(start..end));
        level.primary_title(finding.message.as_str()).id(finding.code).element(snippet)
    } else {
        Group::with_title(level.primary_title(format!("{path}: {}", finding.message)).id(finding.code))
    };
    match &finding.help {
        Some(help) => group.element(Level::HELP.message(help.as_str())),
        None => group,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

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
            remedy: None,
        }
    }

    #[test]
    fn a_finding_has_file_line_column_caret_code_and_help() {
        let text = render(&[finding("states:\n  A: {skill: MoveJonts}\n", (21, 9))], false, 200);
        for part in ["a.yaml:2:14", "E012", "no skill `MoveJonts`", "did you mean `MoveJoints`?"] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        let marked = text.lines().skip_while(|line| !line.contains("{skill: MoveJonts}")).nth(1);
        assert!(marked.is_some_and(|line| line.contains('━')), "{text}");
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
        assert_eq!(marked.matches('━').count(), 9, "{text}");
    }

    #[test]
    fn many_findings_are_counted() {
        let many = vec![finding("", (0, 0)); 60];
        assert!(render(&many, false, 80).ends_with("... and 10 more\n"));
        assert_eq!(summary(&many), "60 errors, 0 warnings");
        assert_eq!(summary(&many[..1]), "1 error, 0 warnings");
    }
}
