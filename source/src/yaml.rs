//! YAML as a tree of places: the text is parsed once, and everything else reads this tree.
//!
//! Only the form is known here. Limits on size, nodes, depth and aliases hold against hostile files.

use armarium_values::Value;

use crate::code;
use crate::finding::{Findings, MAX_BYTES, too_large};
use crate::remedy::{Edit, Remedy};
use crate::span::Span;
use crate::text::Source;
use crate::yaml_errors::slip_near;
use crate::yaml_events::{Refusal, read};

/// A value with its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Where it stands; of a map, its first key.
    pub span: Span,
    /// What it is.
    pub value: Yaml,
}

/// A name with its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// Where it stands.
    pub span: Span,
    /// The name.
    pub text: String,
}

/// The entries of a map, in the order of the file.
pub type Entries = [(Named, Node)];

/// What a node is.
#[derive(Clone, Debug, PartialEq)]
pub enum Yaml {
    /// `null`, `~` or nothing.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A whole number.
    Int(i64),
    /// Another number.
    Float(f64),
    /// Text.
    String(String),
    /// A list.
    List(Vec<Node>),
    /// A map; no key is there twice.
    Map(Vec<(Named, Node)>),
}

impl Node {
    /// The node under a key of a map.
    pub fn get(&self, key: &str) -> Option<&Self> {
        match &self.value {
            Yaml::Map(entries) => entries.iter().find(|(k, _)| k.text == key).map(|(_, node)| node),
            _ => None,
        }
    }

    /// The place of what stands under a key; of the node itself where the key is not there.
    pub fn place(&self, key: &str) -> Span {
        self.get(key).unwrap_or(self).span
    }

    /// The items of a list.
    pub fn items(&self) -> &[Self] {
        match &self.value {
            Yaml::List(items) => items,
            _ => &[],
        }
    }

    /// The node as a literal; `${` is not looked at.
    pub fn literal(&self) -> Value {
        match &self.value {
            Yaml::Null => Value::Null,
            Yaml::Bool(b) => Value::Bool(*b),
            Yaml::Int(i) => Value::Int(*i),
            Yaml::Float(f) => Value::Float(*f),
            Yaml::String(s) => Value::String(s.clone()),
            Yaml::List(items) => Value::List(items.iter().map(Self::literal).collect()),
            Yaml::Map(entries) => {
                Value::Map(entries.iter().map(|(k, v)| (k.text.clone(), v.literal())).collect())
            }
        }
    }
}

impl Yaml {
    /// What it is, for messages.
    pub fn describe(&self) -> &'static str {
        match self {
            Self::Null => "nothing",
            Self::Bool(_) => "a bool",
            Self::Int(_) | Self::Float(_) => "a number",
            Self::String(_) => "text",
            Self::List(_) => "a list",
            Self::Map(_) => "a map",
        }
    }
}

/// Parses a file's text. What is wrong is added to `findings`.
pub fn parse(findings: &mut Findings) -> Option<Node> {
    let source = std::sync::Arc::clone(&findings.source);
    let everything = Span { start: 0, end: 1 };
    if source.text.len() > MAX_BYTES {
        let (message, help) = too_large();
        findings.error_help(code::FILE, everything, message, Some(help.into()));
        return None;
    }
    let refusal = match read(&source.text) {
        Ok(node) => return Some(node),
        Err(refusal) => refusal,
    };
    let (at, message, help, mut remedy) = match *refusal {
        Refusal::Content { at, message, help, remedy } => (at, message, Some(help.to_owned()), remedy),
        Refusal::Syntax { at, message } => match slip_near(&source.text, at.start) {
            Some(slip) => (slip.span, slip.message, Some(slip.help), None),
            None => (at, format!("this cannot be read as YAML: {message}"), None, None),
        },
    };
    remedy = remedy.or_else(|| unquoted_expressions(&source, at.start));
    remedy = remedy.or_else(|| spaces_for_tabs(at, &source.text));
    findings.error_help(code::YAML, at, message, help);
    if let Some(remedy) = remedy {
        findings.remedy(remedy);
    }
    None
}

/// Two spaces for each tab before the text of a line.
fn spaces_for_tabs(at: Span, text: &str) -> Option<Remedy> {
    let start = text.get(..at.start)?.rfind('\n').map_or(0, |newline| newline + 1);
    let indent = text[start..].find(|c| c != ' ' && c != '\t').unwrap_or(0);
    let span = Span { start, end: start + indent };
    let before = &text[span.start..span.end];
    before.contains('\t').then(|| Remedy::replace(span, before.replace('\t', "  ")))
}

/// Quotes for the values of a line that are expressions without them.
fn unquoted_expressions(source: &Source, at: usize) -> Option<Remedy> {
    let text = &source.text;
    let start = text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
    let end = text[start..].find('\n').map_or(text.len(), |newline| start + newline);
    let layout = source.layout();
    let quoted =
        |at: usize| layout.texts.iter().chain(&layout.comments).any(|t| (t.start..t.end).contains(&at));
    let mut edits = Vec::new();
    for (found, _) in text[start..end].match_indices("${") {
        let from = start + found;
        let begins = text[start..from].trim_end().ends_with([':', ',', '[', '{']);
        if quoted(from) || !begins {
            continue;
        }
        let to = from + text[from..end].find('}')? + 1;
        let inner = &text[from..to];
        let ends = text[to..end].trim_start();
        let quote = if inner.contains('"') { "'" } else { "\"" };
        if inner.contains(quote) || !(ends.is_empty() || ends.starts_with([',', '}', ']', '#'])) {
            return None;
        }
        let edit = |at| Edit { span: Span { start: at, end: at }, text: quote.to_owned() };
        edits.extend([edit(from), edit(to)]);
    }
    (!edits.is_empty()).then_some(Remedy::Replace(edits))
}
