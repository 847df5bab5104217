//! Where in a text somebody writes: under which keys, at a key or at a value, and which word. It works on texts that are no
//! YAML yet.

use armarium_source::{Layout, Source, Span};

/// A step from the whole file inward.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PathStep {
    /// Under a key.
    Key(String),
    /// An item of a list.
    Item,
}

/// What is written at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CursorPlace {
    /// A key of the map under the path.
    Key,
    /// The value under the path.
    Value,
}

/// A place in a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TextCursor {
    /// The keys that it is under; at a value the value's own key is the last.
    pub(crate) path: Vec<PathStep>,
    pub(crate) place: CursorPlace,
    /// The entry that the path leads to.
    pub(crate) entry: Option<usize>,
    /// The letters, digits and underscores around the place.
    pub(crate) word: Span,
    /// The value's text before the place.
    pub(crate) before: Span,
    /// Whether it is between brackets.
    pub(crate) flow: bool,
}

impl TextCursor {
    /// The place of a byte; none in a comment.
    pub(crate) fn at(source: &Source, offset: usize) -> Option<Self> {
        let (text, layout) = (source.text.as_str(), source.layout());
        if layout.comments.iter().any(|comment| comment.start < offset && offset <= comment.end) {
            return None;
        }
        let found = flow(text, layout, offset).unwrap_or_else(|| block(text, layout, offset));
        let (entry, place, flow, from) = found;
        let word = word(text, offset);
        let from = from.min(offset);
        let path = path(text, layout, entry);
        Some(Self { path, place, entry, word, before: Span { start: from, end: offset }, flow })
    }

    /// The name of the last key of the path.
    pub(crate) fn key(&self) -> Option<&str> {
        self.path.iter().rev().find_map(|step| match step {
            PathStep::Key(key) => Some(key.as_str()),
            PathStep::Item => None,
        })
    }

    /// The keys in the map that the place is in.
    pub(crate) fn siblings<'t>(&self, source: &'t Source) -> Vec<&'t str> {
        let layout = source.layout();
        let others = layout.children(self.entry).filter(|at| {
            layout.entries[*at].key.end < self.word.start || layout.entries[*at].key.start > self.word.end
        });
        others.map(|at| layout.key(&source.text, at)).collect()
    }

    /// The names of the states that the place is in, outermost first.
    pub(crate) fn states(&self) -> Vec<&str> {
        let mut names = Vec::new();
        let mut steps = self.path.iter();
        while let Some(step) = steps.next() {
            if matches!(step, PathStep::Key(key) if key == "states" || key == "parallel")
                && let Some(PathStep::Key(name)) = steps.next()
            {
                names.push(name.as_str());
            }
        }
        names
    }
}

/// The keys down to an entry.
pub(crate) fn path(text: &str, layout: &Layout, entry: Option<usize>) -> Vec<PathStep> {
    let outward = entry.into_iter().flat_map(|entry| layout.outward(entry));
    let step = |at: usize| match layout.entries[at].item {
        true => PathStep::Item,
        false => PathStep::Key(layout.key(text, at).to_owned()),
    };
    let mut path: Vec<PathStep> = outward.map(step).collect();
    path.reverse();
    path
}

/// The entry, what is written there, whether between brackets, and where a value begins.
type Found = (Option<usize>, CursorPlace, bool, usize);

fn flow(text: &str, layout: &Layout, offset: usize) -> Option<Found> {
    let around = |b: &&armarium_source::Brackets| b.open < offset && offset <= b.close.unwrap_or(b.end);
    let brackets = layout.brackets.iter().rfind(around)?;
    let mut inside = layout.entries.iter().enumerate().filter(|(_, entry)| {
        entry.flow && entry.parent == brackets.entry && (brackets.open..offset).contains(&entry.key.start)
    });
    let last = inside.next_back();
    let fresh = |from| {
        let place = if brackets.map { CursorPlace::Key } else { CursorPlace::Value };
        Some((brackets.entry, place, true, from))
    };
    let Some((at, entry)) = last else { return fresh(brackets.open + 1) };
    let after = text.get(entry.end.min(offset)..offset).unwrap_or("");
    if let Some(comma) = after.find(',') {
        let from = entry.end + comma + 1;
        return fresh(from + text[from..offset].len() - text[from..offset].trim_start().len());
    }
    if entry.item {
        return Some((Some(at), CursorPlace::Value, true, entry.key.start));
    }
    let colon = text.get(entry.key.end..offset).and_then(|rest| rest.find(':'));
    match colon {
        Some(colon) => {
            let from = entry.key.end + colon + 1;
            let blank = text[from..offset].len() - text[from..offset].trim_start().len();
            Some((Some(at), CursorPlace::Value, true, entry.value.unwrap_or(from + blank)))
        }
        None => Some((entry.parent, CursorPlace::Key, true, entry.key.start)),
    }
}

fn block(text: &str, layout: &Layout, offset: usize) -> Found {
    let line = text[..offset].rfind('\n').map_or(0, |newline| newline + 1);
    let entries = &layout.entries;
    let before = entries.partition_point(|entry| entry.key.start < offset);
    let last = (0..before).rev().find(|at| !entries[*at].flow);
    // A text of several lines is one value.
    let in_text = layout.texts.iter().any(|text| text.start < line && offset <= text.end);
    if let Some(at) = last.filter(|at| entries[*at].key.start >= line || in_text) {
        let entry = &entries[at];
        if !entry.item && offset <= entry.key.end {
            return (entry.parent, CursorPlace::Key, false, entry.key.start);
        }
        let from = entry.value.unwrap_or_else(|| {
            let after = if entry.item { entry.key.end } else { entry.key.end + 1 };
            after + text.get(after..offset).map_or(0, |rest| rest.len() - rest.trim_start().len())
        });
        // After a dash a map may begin.
        let place = if entry.item { CursorPlace::Key } else { CursorPlace::Value };
        return (Some(at), place, false, from);
    }
    let column = text[line..].bytes().take_while(|byte| *byte == b' ').count().min(offset - line);
    let parent = last.and_then(|last| {
        // A list may stand in the column of its key.
        let dash = text[line + column..].starts_with('-');
        layout.outward(last).find(|at| {
            let entry = &entries[*at];
            !entry.flow && (entry.column < column || dash && entry.column == column && !entry.item)
        })
    });
    (parent, CursorPlace::Key, false, line + column)
}

/// The letters, digits and underscores around a byte.
pub(crate) fn word(text: &str, offset: usize) -> Span {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    let before: usize = text[..offset].chars().rev().take_while(|c| part(*c)).map(char::len_utf8).sum();
    let after: usize = text[offset..].chars().take_while(|c| part(*c)).map(char::len_utf8).sum();
    Span { start: offset - before, end: offset + after }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The path and place of the `|` in a text.
    fn at(text: &str) -> String {
        let offset = text.find('|').expect("the text has a mark");
        let source = Source::new("t.yaml", text.replacen('|', "", 1));
        let Some(cursor) = TextCursor::at(&source, offset) else { return "nowhere".into() };
        let step = |step: &PathStep| match step {
            PathStep::Key(key) => key.clone(),
            PathStep::Item => "-".into(),
        };
        let path: Vec<String> = cursor.path.iter().map(step).collect();
        format!(
            "{} {:?} `{}`",
            path.join("/"),
            cursor.place,
            &source.text[cursor.before.start..cursor.before.end]
        )
    }

    #[test]
    fn places_are_found_in_whole_and_in_broken_texts() {
        for (text, found) in [
            ("sk|", " Key `sk`"),
            ("a:\n  b: 1\n  c|\n  d: 2\n", "a Key `c`"),
            ("a:\n  b: |\n  d: 2\n", "a/b Value ``"),
            ("a:\n  b: wo|rd\n", "a/b Value `wo`"),
            ("a:\n  b: 1\n|\n", " Key ``"),
            ("a:\n  b: 1\n  |\nc: 1", "a Key ``"),
            ("a:\n  b|: 1\n", "a Key `b`"),
            ("a: {b: 1, |", "a Key ``"),
            ("a: {b: 1, c: x|}\nd: 1\n", "a/c Value `x`"),
            ("a: {b: {c: |\nd: 1\n", "a/b/c Value ``"),
            ("a: [x, y|]", "a/- Value `y`"),
            ("a:\n  - b: 1\n    |", "a/- Key ``"),
            ("a:\n  - |", "a/- Key ``"),
            ("a:\n- b: 1\n- |\n", "a/- Key ``"),
            ("a: \"${inputs.|}\"", "a Value `\"${inputs.`"),
            ("a: 1 # no|", "nowhere"),
            ("a: >\n  te|xt\n", "a Value `>\n  te`"),
            ("a: [{b: 1, c|}, {d: 2}]", "a/- Key `c`"),
        ] {
            assert_eq!(at(text), found, "{text}");
        }
    }
}
