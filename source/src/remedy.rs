//! What would put a finding right, as data: said by whoever finds it, applied by editors.

use crate::layout::Layout;
use crate::span::Span;
use crate::text::Source;

/// A replacement of a part of a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Edit {
    /// What is replaced; empty where something is inserted.
    pub span: Span,
    /// What stands there then.
    pub text: String,
}

/// A text with edits in it, which are in the order of the text and do not overlap.
#[must_use]
pub fn applied(text: &str, edits: &[Edit]) -> String {
    let mut result = String::with_capacity(text.len());
    let mut at = 0;
    for Edit { span: Span { start, end }, text: new } in edits {
        if *start < at {
            continue;
        }
        result.push_str(text.get(at..*start).unwrap_or(""));
        result.push_str(new);
        at = *end;
    }
    result.push_str(text.get(at..).unwrap_or(""));
    result
}

/// What would put a finding right. It says what is meant; how that is written follows from how the file is.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Remedy {
    /// Replaces parts of the text.
    Replace(Vec<Edit>),
    /// Removes the entry whose key is at this place.
    Remove(Span),
    /// A map has one more entry.
    Add {
        /// The key whose value is or holds the map; none for the whole file.
        owner: Option<Span>,
        /// Keys down from there to the map; those that are missing are made.
        sections: Vec<&'static str>,
        /// The key.
        key: String,
        /// The value, as it is written.
        value: String,
    },
}

impl Remedy {
    /// Replaces one part of the text.
    #[must_use]
    pub fn replace(span: Span, text: impl Into<String>) -> Self {
        Self::Replace(vec![Edit { span, text: text.into() }])
    }

    /// What it is, in a few words for a menu.
    #[must_use]
    pub fn title(&self, source: &Source) -> String {
        let shown = |span: Span| source.text.get(span.start..span.end).unwrap_or("this").to_owned();
        match self {
            Self::Replace(edits) => match edits.as_slice() {
                [Edit { span, text }] if span.start == span.end => format!("Insert `{}`", text.trim()),
                [Edit { span: a, .. }, Edit { span: b, .. }] if a.start == a.end && b.start == b.end => {
                    "Put it into quotes".into()
                }
                [Edit { span, text }] => format!("Change `{}` to `{}`", shown(*span), text.trim()),
                _ => "Change these texts".into(),
            },
            Self::Remove(key) => format!("Remove `{}`", shown(*key)),
            Self::Add { sections, key, value, .. } => {
                let path: String = sections.iter().map(|section| format!("{section}: ")).collect();
                format!("Add `{path}{key}: {value}`")
            }
        }
    }

    /// The edits that do it, in the order of the text; none where the text is of a form for which it is not known how.
    #[must_use]
    pub fn edits(&self, source: &Source) -> Vec<Edit> {
        match self {
            Self::Replace(edits) => edits.clone(),
            Self::Remove(key) => remove(&source.text, source.layout(), *key).into_iter().collect(),
            Self::Add { owner, sections, key, value } => {
                let owner = match owner {
                    None => None,
                    Some(span) => match source.layout().at(span.start) {
                        Some(entry) => Some(entry),
                        None => return Vec::new(),
                    },
                };
                let place = Insertion { text: &source.text, layout: source.layout() };
                place.add(owner, sections, key, value).into_iter().collect()
            }
        }
    }
}

/// The line that a byte is in, with its end.
fn line(text: &str, at: usize) -> Span {
    let start = text[..at].rfind('\n').map_or(0, |newline| newline + 1);
    let end = text[at..].find('\n').map_or(text.len(), |newline| at + newline + 1);
    Span { start, end }
}

fn remove(text: &str, layout: &Layout, key: Span) -> Option<Edit> {
    let at = layout.at(key.start)?;
    let entry = &layout.entries[at];
    let siblings: Vec<usize> = layout.children(entry.parent).collect();
    let place = siblings.iter().position(|sibling| *sibling == at)?;
    let next = siblings.get(place + 1).map(|next| layout.entries[*next].key.start);
    let before = place.checked_sub(1).map(|before| layout.entries[siblings[before]].end);
    let begins_line = text[line(text, key.start).start..key.start].trim().is_empty();
    let span = match (next, before) {
        _ if !entry.flow && begins_line => {
            Span { start: line(text, key.start).start, end: line(text, entry.end).end }
        }
        (Some(next), _) => Span { start: key.start, end: next },
        (None, Some(before)) => Span { start: before, end: entry.end },
        (None, None) => Span { start: key.start, end: entry.end },
    };
    Some(Edit { span, text: String::new() })
}

struct Insertion<'t> {
    text: &'t str,
    layout: &'t Layout,
}

impl Insertion<'_> {
    fn add(&self, owner: Option<usize>, sections: &[&str], key: &str, value: &str) -> Option<Edit> {
        if let [section, deeper @ ..] = sections {
            return match self.layout.child(self.text, owner, section) {
                Some(found) => self.add(Some(found), deeper, key, value),
                None => {
                    let inner = deeper.iter().rev().fold(format!("{{{key}: {value}}}"), |inner, section| {
                        format!("{{{section}: {inner}}}")
                    });
                    self.add(owner, &[], section, &inner)
                }
            };
        }
        let entry = format!("{key}: {value}");
        let insert = |at: usize, text: String| Some(Edit { span: Span { start: at, end: at }, text });
        if let Some(last) = self.layout.children(owner).next_back() {
            let last = &self.layout.entries[last];
            if last.item {
                return None;
            }
            if last.flow {
                return insert(last.end, format!(", {entry}"));
            }
            let end = line(self.text, last.end).end;
            let indent = " ".repeat(last.column);
            return match self.text[..end].strip_suffix('\n') {
                Some(_) => insert(end, format!("{indent}{entry}\n")),
                None => insert(end, format!("\n{indent}{entry}")),
            };
        }
        // A map without entries.
        let Some(owner) = owner else { return insert(self.text.len(), format!("{entry}\n")) };
        let empty = self.layout.brackets.iter().find(|b| b.entry == Some(owner) && b.map);
        match (empty, self.layout.entries[owner].value) {
            (Some(brackets), _) => insert(brackets.open + 1, entry),
            (None, None) => insert(self.layout.entries[owner].end, format!(" {{{entry}}}")),
            (None, Some(_)) => None,
        }
    }
}
