//! The form of a file: two spaces a level, lines of readable length, nothing at their ends. Comments stay, and what the file
//! says stays: both texts are read and their trees compared.

use std::path::Path;
use std::sync::Arc;

use armarium_source::yaml::{self, Node, Yaml};
use armarium_source::{Edit, Finding, Findings, Layout, LayoutEntry, Source, Span, applied};

/// Lines that are longer are broken, if they hold a map between brackets.
const MAX_WIDTH: usize = 120;
/// Most rounds of breaking lines: a map inside of a map inside of a map.
const MAX_ROUNDS: usize = 60;

/// A text in the form that all files have. A text that has it comes back as it is.
///
/// # Errors
/// What is wrong with the text, if it is no YAML.
pub fn format(path: &Path, text: &str) -> Result<String, Vec<Finding>> {
    let before = tree(path, text)?;
    let same = |candidate: &str| {
        tree(path, candidate).is_ok_and(|after| match (&before, &after) {
            (Some(before), Some(after)) => equal(before, after),
            (before, after) => before.is_none() && after.is_none(),
        })
    };
    let indented = settled(text, indented);
    // A file whose form carries meaning in a way that is not known here stays as it is.
    if !same(&indented) {
        return Ok(text.to_owned());
    }
    let mut result = indented;
    for _ in 0..MAX_ROUNDS {
        let Some(broken) = shorter(&result).map(|text| settled(&text, self::indented)) else { break };
        if !same(&broken) {
            break;
        }
        result = broken;
    }
    Ok(result)
}

/// Changes a text until it stays the same.
fn settled(text: &str, change: fn(&str) -> String) -> String {
    let mut text = change(text);
    for _ in 0..3 {
        let again = change(&text);
        if again == text {
            break;
        }
        text = again;
    }
    text
}

fn tree(path: &Path, text: &str) -> Result<Option<Arc<Node>>, Vec<Finding>> {
    if text.lines().all(|line| line.trim().is_empty() || line.trim_start().starts_with('#')) {
        return Ok(None);
    }
    let mut findings = Findings::new(Arc::new(Source::new(path, text)));
    yaml::parse(&mut findings).map(Some).ok_or(findings.list)
}

/// Whether two trees say the same, wherever it stands.
fn equal(a: &Node, b: &Node) -> bool {
    match (&a.value, &b.value) {
        (Yaml::List(a), Yaml::List(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| equal(a, b)),
        (Yaml::Map(a), Yaml::Map(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|((k, a), (l, b))| k.text == l.text && equal(a, b))
        }
        (a, b) => a == b,
    }
}

/// A line of a text.
struct Line<'t> {
    start: usize,
    /// Without its end.
    text: &'t str,
}

fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
    let mut start = 0;
    text.split_inclusive('\n').map(move |line| {
        let this = Line { start, text: line.trim_end_matches(['\n', '\r']) };
        start += line.len();
        this
    })
}

/// What a line is to the form.
enum Role {
    /// Entries begin in it.
    Entries(usize),
    /// It goes on with what an entry began in another line.
    Inside(Option<usize>),
    /// A part of a text, in which spaces count.
    Text(Option<usize>),
    Comment,
    Blank,
    /// A marker or directive of YAML.
    Marker,
}

/// Every line in its column, without spaces at the end, and at most one blank line after another.
fn indented(text: &str) -> String {
    let layout = Layout::of(text);
    let columns = columns(&layout);
    let newline = if text.contains("\r\n") { "\r\n" } else { "\n" };
    let mut result = String::with_capacity(text.len());
    let mut blank = true;
    // Comments wait for the line that they are about.
    let mut waiting: Vec<(usize, &str)> = Vec::new();
    let put = |result: &mut String, column: usize, text: &str| {
        result.extend(std::iter::repeat_n(' ', column));
        result.push_str(text);
        result.push_str(newline);
    };
    for line in lines(text) {
        let content = line.text.trim();
        let old = line.text.len() - line.text.trim_start().len();
        let role = role(text, &layout, &line);
        if !matches!(role, Role::Blank | Role::Comment) && !waiting.is_empty() {
            let next = if let Role::Entries(first) = role { Some(first) } else { None };
            for (comment_column, comment) in waiting.drain(..) {
                let column = comment_place(&layout, &columns, next, comment_column, old);
                put(&mut result, if comment.is_empty() { 0 } else { column }, comment);
            }
        }
        match role {
            Role::Blank if blank => {}
            Role::Blank if waiting.is_empty() => put(&mut result, 0, ""),
            Role::Blank => waiting.push((0, "")),
            Role::Comment => waiting.push((old, content)),
            Role::Marker => put(&mut result, 0, content),
            Role::Entries(first) => put(&mut result, columns[first], &dashes(content)),
            Role::Inside(owner) => {
                let column = owner.map_or(old, |owner| shifted(old, &layout.entries[owner], columns[owner]));
                put(&mut result, column, content);
            }
            Role::Text(owner) => {
                let column = owner.map_or(old, |owner| shifted(old, &layout.entries[owner], columns[owner]));
                // Spaces at the end of a line of text are text, and so are those beyond the indentation of a block.
                let content = line.text.trim_start_matches(' ');
                let empty = content.is_empty() && !is_beyond_block(text, &layout, &line);
                put(&mut result, if empty { 0 } else { column }, content);
            }
        }
        blank = matches!(role, Role::Blank);
    }
    while waiting.last().is_some_and(|(_, line)| line.is_empty()) {
        waiting.pop();
    }
    for (old, comment) in waiting {
        let column = comment_place(&layout, &columns, None, old, 0);
        put(&mut result, if comment.is_empty() { 0 } else { column }, comment);
    }
    let end = result.trim_end_matches(['\n', '\r']).len();
    let kept = text_end(&layout, text);
    if kept {
        return result;
    }
    result.truncate(end);
    if end > 0 {
        result.push_str(newline);
    }
    result
}

/// The column of a comment: that of the entry before or around it that began in the comment's old column, and otherwise of
/// the next one.
fn comment_place(layout: &Layout, columns: &[usize], next: Option<usize>, old: usize, other: usize) -> usize {
    let following = next.map(|next| (layout.entries[next].column, columns[next]));
    let before = next.unwrap_or(layout.entries.len()).checked_sub(1);
    match following {
        Some((column, new)) if column >= old => new,
        following => {
            let outward = before.into_iter().flat_map(|before| layout.outward(before));
            let same = outward.filter(|at| !layout.entries[*at].flow && layout.entries[*at].column == old);
            same.map(|at| columns[at]).next().or(following.map(|(_, new)| new)).unwrap_or(other)
        }
    }
}

/// Whether a line of spaces is longer than the indentation of the block of text around it.
fn is_beyond_block(text: &str, layout: &Layout, line: &Line<'_>) -> bool {
    let before = layout.texts.partition_point(|text| text.start < line.start);
    let Some(block) = layout.texts[..before].last().filter(|block| line.start < block.end) else {
        return false;
    };
    let mut inside = text[block.start..block.end].lines().skip(1);
    let first = inside.find(|line| !line.trim().is_empty());
    first.is_some_and(|first| line.text.len() > first.len() - first.trim_start().len())
}

/// Whether a text of several lines ends the file, of which blank lines may be a part.
fn text_end(layout: &Layout, text: &str) -> bool {
    layout
        .texts
        .last()
        .is_some_and(|last| text[last.start..].starts_with(['|', '>']) && text[last.end..].trim().is_empty())
}

fn role(text: &str, layout: &Layout, line: &Line<'_>) -> Role {
    let end = line.start + line.text.len();
    let owner = || {
        let before = layout.entries.partition_point(|entry| entry.key.start < line.start);
        (0..before).rev().find(|at| !layout.entries[*at].flow)
    };
    let before = layout.texts.partition_point(|text| text.start < line.start);
    if let Some(inside) = layout.texts[..before].last().filter(|text| line.start <= text.end) {
        let quoted = text[inside.start..].starts_with(['"', '\'']);
        return if quoted && !line.text.trim().is_empty() {
            Role::Inside(owner())
        } else {
            Role::Text(owner())
        };
    }
    let content = line.text.trim_start();
    if content.is_empty() {
        // Blank lines inside of a plain text of several lines are a part of it.
        let inside = owner().is_some_and(|owner| {
            let entry = &layout.entries[owner];
            let plain =
                entry.value.is_some_and(|value| !text[value..].starts_with(['{', '[', '"', '\'', '|', '>']));
            plain && line.start < entry.end && !layout.children(Some(owner)).any(|_| true)
        });
        return if inside { Role::Text(owner()) } else { Role::Blank };
    }
    let first = layout.entries.partition_point(|entry| entry.key.start < line.start);
    if layout.entries.get(first).is_some_and(|entry| entry.key.start < end && !entry.flow) {
        return Role::Entries(first);
    }
    if content.starts_with('#') {
        return Role::Comment;
    }
    if line.text.starts_with("---") || line.text.starts_with("...") || line.text.starts_with('%') {
        return Role::Marker;
    }
    Role::Inside(owner())
}

/// The column in which each entry shall stand.
fn columns(layout: &Layout) -> Vec<usize> {
    let mut columns: Vec<usize> = Vec::with_capacity(layout.entries.len());
    for entry in &layout.entries {
        columns.push(entry.parent.map_or(0, |parent| columns[parent] + 2));
    }
    columns
}

/// The column of a line that belongs to an entry that was moved: as far right of it as before.
fn shifted(old: usize, entry: &LayoutEntry, column: usize) -> usize {
    (old + column).saturating_sub(entry.column).max(if old > entry.column { column + 1 } else { column })
}

/// One space after each dash that begins an item.
fn dashes(content: &str) -> String {
    match content.strip_prefix('-') {
        Some(rest) if rest.starts_with([' ', '\t']) && !rest.trim().starts_with('#') => {
            format!("- {}", dashes(rest.trim_start()))
        }
        _ => content.to_owned(),
    }
}

/// The text with the lines that are too long broken once each; none where there is nothing to break.
fn shorter(text: &str) -> Option<String> {
    let layout = Layout::of(text);
    let newline = if text.contains("\r\n") { "\r\n" } else { "\n" };
    let long = lines(text).filter(|line| line.text.chars().count() > MAX_WIDTH);
    let edits: Vec<Edit> = long.filter_map(|line| broken(text, &layout, &line, newline)).flatten().collect();
    (!edits.is_empty()).then(|| applied(text, &edits))
}

/// The edits that give each entry of a line's outermost map, or list of maps, a line of its own; none where the brackets are
/// not the whole value of an entry in block form.
fn broken(text: &str, layout: &Layout, line: &Line<'_>, newline: &str) -> Option<Vec<Edit>> {
    let end = line.start + line.text.len();
    let first = layout.brackets.partition_point(|brackets| brackets.open < line.start);
    let brackets = layout.brackets.get(first).filter(|brackets| brackets.open < end)?;
    let owner = &layout.entries[brackets.entry?];
    let close = brackets.close.filter(|close| *close < end)?;
    let children: Vec<usize> = layout.children(brackets.entry).collect();
    let whole = !owner.flow && owner.value == Some(brackets.open) && text[close + 1..end].trim().is_empty();
    // A list of plain values is read along the line.
    let is_map = |child: &usize| text[layout.entries[*child].key.start..].starts_with('{');
    if !whole || children.is_empty() || !brackets.map && !children.iter().any(is_map) {
        return None;
    }
    // A map that is an item begins in the line of its dash.
    let in_line = owner.item && brackets.map;
    if in_line && owner.key.start < line.start {
        return None;
    }
    let indent = " ".repeat(owner.column + 2);
    // A space before the break would be left at the end of the key's line.
    let mut at = if in_line { brackets.open } else { text[..brackets.open].trim_end_matches(' ').len() };
    let mut edits = Vec::new();
    for (number, child) in children.into_iter().enumerate() {
        let entry = &layout.entries[child];
        let lead = match (in_line && number == 0, entry.item) {
            (true, false) => String::new(),
            (_, false) => format!("{newline}{indent}"),
            (_, true) => format!("{newline}{indent}- "),
        };
        edits.push(Edit { span: Span { start: at, end: entry.key.start }, text: lead });
        at = entry.end;
        // A key without a value needs its colon.
        if !entry.item && !text[entry.key.end..entry.end].contains(':') {
            edits.push(Edit { span: Span { start: at, end: at }, text: ":".into() });
        }
    }
    edits.push(Edit { span: Span { start: at, end: close + 1 }, text: String::new() });
    Some(edits)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn formatted(text: &str) -> String {
        let once = format(Path::new("t.yaml"), text).expect("it is YAML");
        assert_eq!(format(Path::new("t.yaml"), &once).as_deref(), Ok(once.as_str()), "a second time");
        once
    }

    #[test]
    fn every_line_gets_its_column() {
        for (given, wanted) in [
            ("a:\n    b: 1   \n    c:\n        d: 2\n\n\n\ne: 3", "a:\n  b: 1\n  c:\n    d: 2\n\ne: 3\n"),
            ("a:\n- b: 1\n  c: 2\n-   d\n", "a:\n  - b: 1\n    c: 2\n  - d\n"),
            (
                "# top\na:\n      # about b\n      b: 1 # one\n# about c\nc: 2\n",
                "# top\na:\n  # about b\n  b: 1 # one\n# about c\nc: 2\n",
            ),
            ("a: |\n     x\n       y  \n\n\n     z\nb: 1\n", "a: |\n     x\n       y  \n\n\n     z\nb: 1\n"),
            ("a:\n    b: >\n        x\n        y\n", "a:\n  b: >\n      x\n      y\n"),
            (
                "a:\n    b: one\n      two\n    c: {x: 1,\n        y: 2}\n",
                "a:\n  b: one\n    two\n  c: {x: 1,\n      y: 2}\n",
            ),
            ("\n\na: 1\n\n", "a: 1\n"),
            ("a:   {x: 1}   # aligned\n", "a:   {x: 1}   # aligned\n"),
            ("- - a\n  -   b\n", "- - a\n  - b\n"),
            ("# only a comment\n", "# only a comment\n"),
            ("a: \"one\n   two\"\nb: é😀\n", "a: \"one\n   two\"\nb: é😀\n"),
            ("a:\r\n    b: 1 \r\n", "a:\r\n  b: 1\r\n"),
        ] {
            assert_eq!(formatted(given), wanted, "{given}");
        }
    }

    #[test]
    fn long_maps_become_lines() {
        let long = "x".repeat(60);
        let text = format!("a:\n  b: {{c: {long}, d: [1, 2], e: {{f: {long}}}}}\n");
        assert_eq!(
            formatted(&text),
            format!("a:\n  b:\n    c: {long}\n    d: [1, 2]\n    e: {{f: {long}}}\n")
        );
        let text = format!("s:\n  - {{c: {long}, d: {long}}}\n");
        assert_eq!(formatted(&text), format!("s:\n  - c: {long}\n    d: {long}\n"));
        let text = format!("s: [{{c: {long}}}, {{d: {long}}}]\n");
        assert_eq!(formatted(&text), format!("s:\n  - {{c: {long}}}\n  - {{d: {long}}}\n"));
        let text = format!("n: [{}]\n", vec!["1000"; 40].join(", "));
        assert_eq!(formatted(&text), text, "a list of numbers");
    }

    #[test]
    fn what_is_no_yaml_is_not_touched() {
        assert!(format(Path::new("t.yaml"), "a: [").is_err());
    }
}
