//! Why a text is no YAML, in words for people: the parser says what it did not expect, and mostly a line too late. The usual slips
//! are looked for in the text around that place; nothing is parsed here.

use crate::remedy::Edit;
use crate::span::Span;

/// What is wrong, where, and what to do about it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Slip {
    pub(crate) span: Span,
    pub(crate) message: String,
    pub(crate) help: String,
    /// What puts it right; nothing where a person has to decide.
    pub(crate) edits: Vec<Edit>,
}

impl Slip {
    /// The same, put right by another text in its place.
    fn rewritten(mut self, text: impl Into<String>) -> Self {
        self.edits = vec![Edit { span: self.span, text: text.into() }];
        self
    }

    /// The same, put right by texts at some places.
    fn completed(mut self, insertions: impl IntoIterator<Item = (usize, String)>) -> Self {
        let edit = |(at, text)| Edit { span: Span { start: at, end: at }, text };
        self.edits = insertions.into_iter().map(edit).collect();
        self
    }
}

fn slip(start: usize, len: usize, message: impl Into<String>, help: impl Into<String>) -> Option<Slip> {
    let span = Span { start, end: start + len.max(1) };
    Some(Slip { span, message: message.into(), help: help.into(), edits: Vec::new() })
}

/// The slip in `text` that made the parser stop at byte `at`; `None` where none is recognised.
pub(crate) fn slip_near(text: &str, at: usize) -> Option<Slip> {
    let lines = lines(text);
    let here = lines.iter().rposition(|line| line.start <= at)?;
    tab(&lines, here)
        .or_else(|| unquoted_expression(&lines, here))
        .or_else(|| inside_a_line(text, &lines, here))
        .or_else(|| unclosed(text, at))
        .or_else(|| missing_space(&lines, here))
        .or_else(|| missing_colon(&lines, here))
        .or_else(|| indentation(&lines, here))
}

/// A line and where it begins.
struct Line<'t> {
    start: usize,
    text: &'t str,
}

impl<'t> Line<'t> {
    fn indent(&self) -> usize {
        self.text.len() - self.text.trim_start().len()
    }

    /// Without indentation, comment and trailing space.
    fn content(&self) -> &'t str {
        let text = self.text.trim();
        if text.starts_with('#') { "" } else { text.split(" #").next().unwrap_or(text).trim_end() }
    }
}

fn lines(text: &str) -> Vec<Line<'_>> {
    let mut start = 0;
    let one = |line| {
        let begins = start;
        start += str::len(line);
        Line { start: begins, text: line.trim_end_matches(['\n', '\r']) }
    };
    text.split_inclusive('\n').map(one).collect()
}

fn tab(lines: &[Line<'_>], here: usize) -> Option<Slip> {
    let with_tab = |line: &&Line<'_>| line.text[..line.indent()].contains('\t');
    let line = lines[..=here].iter().rev().take(2).find(with_tab)?;
    let tab = line.text.find('\t').unwrap_or(0);
    slip(line.start + tab, 1, "a tab indents this line", "indent with spaces")
}

/// `{force: ${inputs.force}}`: YAML reads the second `{` as a map.
fn unquoted_expression(lines: &[Line<'_>], here: usize) -> Option<Slip> {
    lines[..=here].iter().rev().take(2).find_map(|line| {
        let mut quote = None;
        for (at, c) in line.text.char_indices() {
            match (quote, c) {
                (None, '"' | '\'') => quote = Some(c),
                (Some(open), c) if c == open => quote = None,
                (None, '$') if line.text[at..].starts_with("${") => {
                    let end = line.text[at..].find('}').map_or(line.text.len(), |end| at + end + 1);
                    let expression = &line.text[at..end];
                    let help = format!("quote it: `\"{expression}\"`");
                    return slip(
                        line.start + at,
                        expression.len(),
                        "YAML reads this `{` as the beginning of a map",
                        help,
                    );
                }
                _ => {}
            }
        }
        None
    })
}

/// One key with its value, or an item of a list, as far as it was read.
#[derive(Clone, Copy)]
struct OpenEntry {
    /// After the colon of its key.
    colon: Option<usize>,
    /// No letter of the key, or of the value, was read yet.
    begins: bool,
    /// The quote or bracket that ended its value, and where that value began.
    closed: Option<(usize, char)>,
}

const FRESH: OpenEntry = OpenEntry { colon: None, begins: true, closed: None };

/// What makes no sense within a line, in the line where the parser stopped or in the one before: `if: "a" == b`, `a: b: c`,
/// `{a: 1}}`, `a: @home`.
fn inside_a_line(text: &str, lines: &[Line<'_>], here: usize) -> Option<Slip> {
    let from = lines[here.saturating_sub(1)].start;
    let end = lines[here].start + lines[here].text.len();
    let (mut entry, mut around) = (FRESH, Vec::new());
    let mut quote: Option<(usize, char)> = None;
    let mut escaped = false;
    let mut block_text = None;
    for line in &lines[..=here] {
        if block_text.is_some_and(|outer| line.indent() > outer || line.content().is_empty()) {
            continue;
        }
        block_text = None;
        if quote.is_none() && around.is_empty() {
            entry = FRESH;
            block_text = begins_block_text(line).then(|| line.indent());
        }
        let mut before = ' ';
        for (at, c) in line.text.char_indices().map(|(at, c)| (line.start + at, c)) {
            let next = text[at + c.len_utf8()..end].chars().next().unwrap_or(' ');
            let apart = std::mem::replace(&mut before, c).is_whitespace();
            if let Some((open, mark)) = quote {
                if std::mem::take(&mut escaped) {
                } else if mark == '"' && c == '\\' {
                    escaped = true;
                } else if c == mark {
                    (quote, entry.closed) = (None, Some((open, mark)));
                }
                continue;
            }
            match c {
                '#' if apart => break,
                _ if c.is_whitespace() => {}
                '"' | '\'' if entry.begins => (quote, entry.begins) = (Some((at, c)), false),
                // The second of two single quotes is one of the text.
                '\'' if entry.closed == Some((at - 1, c)) => quote = entry.closed.take(),
                '{' | '[' if entry.begins => {
                    entry.begins = false;
                    around.push((at, entry));
                    entry = FRESH;
                }
                ',' if !around.is_empty() => entry = FRESH,
                '}' | ']' => match around.pop() {
                    Some((open, outer)) => entry = OpenEntry { closed: Some((open, c)), ..outer },
                    None if entry.closed.is_some() && at >= from => {
                        let slip = slip(at, 1, format!("there is one `{c}` too many"), "remove it");
                        return slip.map(|slip| slip.rewritten(""));
                    }
                    None => {}
                },
                ':' if next.is_whitespace() || entry.closed.is_some() => {
                    let first = entry.colon.filter(|first| *first > line.start && at >= from);
                    if let Some(first) = first {
                        let value = text[first..at].trim_start();
                        let key = value.split_whitespace().next_back().unwrap_or("");
                        let apart = if around.is_empty() {
                            "put what follows on lines of its own, further to the right"
                        } else {
                            "put a `,` between two entries"
                        };
                        let message = format!("a second `:` in one value, after `{key}`");
                        let slip = slip(at, 1, message, format!("quote the text if it is one, or {apart}"))?;
                        // `go: Done` is an entry, and `look first: then go` a text.
                        let (begins, ends) = (at - value.len(), value_end(text, at, end, !around.is_empty()));
                        let named = text[at + 1..ends].trim_start().starts_with(char::is_uppercase);
                        let (open, close) = if value == key && named { ("{", "}") } else { ("\"", "\"") };
                        let quotable = !text[begins..ends].contains(['"', '#', '{']);
                        let insertions = [(begins, open.to_owned()), (ends, close.to_owned())];
                        return Some(if quotable { slip.completed(insertions) } else { slip });
                    }
                    entry = OpenEntry { colon: Some(at + 1), ..FRESH };
                }
                _ if entry.closed.is_some_and(|(open, _)| open >= line.start) && at >= from => {
                    let close = entry.closed.map_or(c, |(_, close)| close);
                    let what = if "}]".contains(close) { format!("`{close}`") } else { "quote".to_owned() };
                    let help = "put the whole value into one pair of quotes, and texts inside of it into the other kind";
                    let rest = text[at..end].trim_end().len();
                    let ends = value_end(text, at, end, !around.is_empty());
                    let slip = slip(at, rest, format!("text goes on after the closing {what}"), help)?;
                    let (open, _) = entry.closed.unwrap_or((at, c));
                    let value = &text[open..ends];
                    let quote = if value.contains('"') { "'" } else { "\"" };
                    let whole = !value.contains('#') && !value.contains(quote);
                    let insertions = [(open, quote.to_owned()), (ends, quote.to_owned())];
                    return Some(if whole { slip.completed(insertions) } else { slip });
                }
                '-' if entry.begins && next.is_whitespace() && around.is_empty() => {}
                '@' | '`' | '%' | '!' if entry.begins && entry.colon.is_some() && at >= from => {
                    let value = text[at..end].split([',', '}', ']']).next().unwrap_or("").trim_end();
                    let message = format!("a text that begins with `{c}` needs quotes");
                    let quote = if value.contains('"') { '\'' } else { '"' };
                    let written = format!("{quote}{value}{quote}");
                    let slip = slip(at, value.len(), message, format!("write `{written}`"))?;
                    return Some(if value.contains(quote) { slip } else { slip.rewritten(written) });
                }
                _ => entry.begins = false,
            }
        }
    }
    None
}

/// Where a value ends in its line, on from a byte of it: in a map or list between brackets before what comes next there.
fn value_end(text: &str, from: usize, line_end: usize, flow: bool) -> usize {
    let mut quote = None;
    let next = text[from..line_end].find(|c| {
        match quote {
            None if c == '"' || c == '\'' => quote = Some(c),
            Some(open) if c == open => quote = None,
            None => return flow && matches!(c, ',' | '}' | ']'),
            Some(_) => {}
        }
        false
    });
    let end = next.map_or(line_end, |next| from + next);
    text[..end].trim_end().len()
}

/// Whether a text of several lines begins after this one: `log: |`.
fn begins_block_text(line: &Line<'_>) -> bool {
    let last = line.content().rsplit([' ', ':']).next().unwrap_or("");
    last.starts_with(['|', '>']) && last[1..].chars().all(|c| "+-123456789".contains(c))
}

/// A bracket or a quote that is open at the place where the parser stopped.
fn unclosed(text: &str, at: usize) -> Option<Slip> {
    let mut open: Vec<(usize, char)> = Vec::new();
    let mut quote: Option<(usize, char)> = None;
    let (mut before, mut comment) = ('\n', false);
    let mut skip = false;
    for (here, c) in text.char_indices() {
        if here > at && quote.is_none() {
            break;
        }
        let starts = before.is_whitespace() || "{[,:".contains(before);
        match (quote, c) {
            _ if skip => skip = false,
            _ if comment => comment = c != '\n',
            (Some((_, '"')), '\\') => skip = true,
            (Some((_, open)), c) if c == open => quote = None,
            (Some(_), _) => {}
            (None, '#') if before.is_whitespace() => comment = true,
            (None, '"' | '\'') if starts => quote = Some((here, c)),
            (None, '{' | '[') if starts || !open.is_empty() => open.push((here, c)),
            (None, '}' | ']') => {
                open.pop();
            }
            _ => {}
        }
        before = c;
    }
    let line_end = |start: usize| start + text[start..].lines().next().unwrap_or("").trim_end().len();
    if let Some((start, c)) = quote {
        let slip = slip(start, 1, "this quote is not closed", format!("add the second `{c}`"))?;
        // Between brackets, where the next entry begins or they close.
        let end = line_end(start);
        let next = text[start + 1..end].find([',', '}', ']']).filter(|_| !open.is_empty());
        let at = next.map_or(end, |next| start + 1 + next);
        return Some(slip.completed([(at, c.to_string())]));
    }
    let (start, c) = *open.last()?;
    let other = if c == '{' { '}' } else { ']' };
    let same_line = !text[start..at.max(start)].contains('\n');
    let line = text[start..].lines().next().unwrap_or("");
    if same_line && line.matches(other).count() >= line.matches(c).count() {
        return None;
    }
    let slip = slip(start, 1, format!("this `{c}` is not closed"), format!("add the missing `{other}`"))?;
    // What else is open in the line has the same end.
    let begun = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
    let missing = open.iter().rev().take_while(|(at, _)| *at >= begun);
    let missing: String = missing.map(|(_, c)| if *c == '{' { '}' } else { ']' }).collect();
    let end = line_end(start);
    let comment =
        text[start..end].find(" #").map_or(end, |at| start + text[start..start + at].trim_end().len());
    Some(slip.completed([(comment, missing)]))
}

/// A key without its colon makes one long text of what follows.
fn missing_colon(lines: &[Line<'_>], here: usize) -> Option<Slip> {
    let bare = |line: &Line<'_>| {
        let content = line.content();
        !content.is_empty()
            && !content.contains(':')
            && !content.starts_with(['-', '{', '[', '}', ']', '"', '\'', '|', '>'])
    };
    let line = lines[..=here].iter().rev().take(3).find(|line| bare(line))?;
    let content = line.content();
    let (key, value) = content.split_once(char::is_whitespace).unwrap_or((content, ""));
    let written = if value.is_empty() { format!("{key}:") } else { format!("{key}: {}", value.trim()) };
    let message = format!("a `:` is missing after `{key}`");
    let slip = slip(line.start + line.indent(), content.len(), message, format!("write `{written}`"))?;
    Some(slip.rewritten(written))
}

/// `skill:Name`: YAML takes it for one word.
fn missing_space(lines: &[Line<'_>], here: usize) -> Option<Slip> {
    lines[..=here].iter().rev().take(3).find_map(|line| {
        let content = line.content().trim_start_matches("- ");
        let (key, value) = content.split_once(':')?;
        let word = |c: char| c.is_alphanumeric() || c == '_' || c == '.';
        let glued =
            !key.is_empty() && key.chars().all(word) && value.starts_with(|c| word(c) || "\"'{[".contains(c));
        if !glued || content.contains(": ") {
            return None;
        }
        let start = line.start + line.text.find(content)?;
        let message = format!("a space is missing after `{key}:`");
        let slip = slip(start, content.len(), message, format!("write `{key}: {value}`"))?;
        Some(slip.completed([(start + key.len() + 1, " ".to_owned())]))
    })
}

fn indentation(lines: &[Line<'_>], here: usize) -> Option<Slip> {
    let line = &lines[here];
    let indent = line.indent();
    let previous = lines[..here].iter().rev().find(|line| !line.content().is_empty())?;
    if previous.content().ends_with([':', '-']) && indent > previous.indent() {
        // The first line of a level may be indented as it likes.
        return None;
    }
    let mut above: Vec<usize> =
        lines[..here].iter().filter(|line| !line.content().is_empty()).map(Line::indent).collect();
    above.sort_unstable();
    above.dedup();
    if line.content().is_empty() || above.contains(&indent) {
        return None;
    }
    let near: Vec<String> = above.iter().rev().take(3).rev().map(usize::to_string).collect();
    let help = format!("indent it like the lines that it belongs to: by {}", near.join(" or "));
    let slip =
        slip(line.start, indent, format!("this line is indented by {indent}, like none above it"), help)?;
    let nearest =
        above.iter().min_by_key(|column| (column.abs_diff(indent), column.abs_diff(previous.indent())));
    Some(slip.rewritten(" ".repeat(*nearest.unwrap_or(&indent))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each text, with the byte at which the parser stops marked by `^`.
    #[test]
    fn usual_slips_are_explained_at_their_place() {
        let cases = [
            ("a:\n^\tb: 1\n", "\t", "a tab indents this line"),
            ("a: {b: $^{x}}\n", "${x}", "YAML reads this `{` as the beginning of a map"),
            ("a: {b: 1\n^c: 2\n", "{", "this `{` is not closed"),
            ("a: [1, 2\nb: ^2\n", "[", "this `[` is not closed"),
            ("a: \"b\nc: 2\n^", "\"", "this quote is not closed"),
            ("a\n  b:^ 1\n", "a", "a `:` is missing after `a`"),
            ("a:\n  b 1\n  c:^ 1\n", "b 1", "a `:` is missing after `b`"),
            ("a:\n    b: 1\n   ^c: 1\n", "   ", "this line is indented by 3, like none above it"),
            ("if: \"a\" ^== b\n", "== b", "text goes on after the closing quote"),
            ("a:\n    b: {c: 'd' ^== 'd'}\n", "== 'd'}", "text goes on after the closing quote"),
            ("a:\n    b: {c: [1] ^== [2]}\n", "== [2]}", "text goes on after the closing `]`"),
            ("a:\n    b: {c: d}^}\ne: 1\n", "}", "there is one `}` too many"),
            ("a:\n    b: c: ^d\n    e: 1\n", ":", "a second `:` in one value, after `c`"),
            ("a: {b: c d: ^{e: 1}}\n", ":", "a second `:` in one value, after `d`"),
            ("a:\n    b: ^@home\n    c: 1\n", "@home", "a text that begins with `@` needs quotes"),
            ("a:\n  b:c\n  d:^ 1\n", "b:c", "a space is missing after `b:`"),
        ];
        for (marked, place, message) in cases {
            let at = marked.find('^').expect("the place is marked");
            let text = marked.replace('^', "");
            let slip = slip_near(&text, at).unwrap_or_else(|| panic!("nothing is found in {text:?}"));
            assert_eq!(
                (&text[slip.span.start..slip.span.end], slip.message.as_str()),
                (place, message),
                "{text:?}"
            );
        }
    }

    #[test]
    fn no_text_is_too_strange() {
        for text in ["", "é", "{", "'", "a: 'é", "\t", "\u{feff}a", "- - -", "${", "a: \"\\", "\r\n\r\n{"] {
            for at in 0..=text.len() {
                if let Some(slip) = slip_near(text, at) {
                    assert!(text.is_char_boundary(slip.span.start), "{text:?} at {at}: {slip:?}");
                }
            }
        }
    }
}
