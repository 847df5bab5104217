//! YAML as a tree of places: the text is parsed once, and everything else reads this tree.
//!
//! Only the form is known here. Limits on size, nodes, depth and aliases hold against hostile files.

use std::fmt;

use armarium_values::Value;
use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_saphyr::budget::BudgetBreach;
use serde_saphyr::granit_parser::ErrorKind;
use serde_saphyr::{ExternalMessageSource, Location, Spanned};

use crate::code;
use crate::finding::{Findings, MAX_BYTES, too_large};
use crate::remedy::{Edit, Remedy};
use crate::span::Span;
use crate::stack::on_a_large_stack;
use crate::text::Source;
use crate::yaml_errors::slip_near;

/// Deepest nesting of YAML; 60 levels of states are within it.
const MAX_DEPTH: usize = 190;
/// Most nodes: 200 000 states of ten nodes.
const MAX_NODES: usize = 4_000_000;

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

fn span(location: Location) -> Span {
    let start = location.span().byte_offset().unwrap_or(0) as usize;
    let len = location.span().byte_len().unwrap_or(0) as usize;
    Span { start, end: start + len.max(1) }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let spanned = Spanned::<Yaml>::deserialize(deserializer)?;
        let mut span = span(spanned.referenced);
        if let Yaml::Map(entries) = &spanned.value
            && let Some((first, _)) = entries.first()
            && first.span.start >= span.start
        {
            span.end = first.span.end;
        }
        Ok(Self { span, value: spanned.value })
    }
}

impl<'de> Deserialize<'de> for Yaml {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(YamlVisitor)
    }
}

struct YamlVisitor;

impl<'de> Visitor<'de> for YamlVisitor {
    type Value = Yaml;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a YAML value")
    }
    fn visit_unit<E: Error>(self) -> Result<Yaml, E> {
        Ok(Yaml::Null)
    }
    fn visit_none<E: Error>(self) -> Result<Yaml, E> {
        Ok(Yaml::Null)
    }
    fn visit_bool<E: Error>(self, v: bool) -> Result<Yaml, E> {
        Ok(Yaml::Bool(v))
    }
    fn visit_i64<E: Error>(self, v: i64) -> Result<Yaml, E> {
        Ok(Yaml::Int(v))
    }
    fn visit_u64<E: Error>(self, v: u64) -> Result<Yaml, E> {
        Ok(i64::try_from(v).map_or(Yaml::Float(v as f64), Yaml::Int))
    }
    fn visit_f64<E: Error>(self, v: f64) -> Result<Yaml, E> {
        Ok(Yaml::Float(v))
    }
    fn visit_str<E: Error>(self, v: &str) -> Result<Yaml, E> {
        Ok(Yaml::String(v.to_owned()))
    }
    fn visit_string<E: Error>(self, v: String) -> Result<Yaml, E> {
        Ok(Yaml::String(v))
    }
    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Yaml, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = seq.next_element::<Node>()? {
            items.push(item);
        }
        Ok(Yaml::List(items))
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Yaml, A::Error> {
        let mut entries = Vec::new();
        while let Some(key) = map.next_key::<Spanned<String>>()? {
            let key = Named { span: span(key.referenced), text: key.value };
            entries.push((key, map.next_value::<Node>()?));
        }
        Ok(Yaml::Map(entries))
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
    let parsed = on_a_large_stack(|| {
        let mut budget = serde_saphyr::Budget::default();
        budget.max_depth = MAX_DEPTH;
        budget.max_nodes = MAX_NODES;
        budget.max_events = 3 * MAX_NODES;
        let options = serde_saphyr::options! {
            strict_booleans: true,
            with_snippet: false,
            budget: Some(budget),
        };
        serde_saphyr::from_str_with_options::<Node>(&source.text, options)
    });
    match parsed {
        Ok(node) => Some(node),
        Err(error) => {
            let at = error.location().map_or(everything, |location| place(location, &source.text));
            let said = match explained(&error, at) {
                Explained::Said(message, help, remedy) => (at, message, help, remedy),
                Explained::Syntax(message) => match slip_near(&source.text, at.start) {
                    Some(slip) => (slip.span, slip.message, Some(slip.help), None),
                    None => (at, format!("this cannot be read as YAML: {message}"), None, None),
                },
            };
            findings.error_help(code::YAML, said.0, said.1, said.2);
            let remedy =
                unquoted_expressions(&source, at.start).or_else(|| spaces_for_tabs(said.0, &source.text));
            if let Some(remedy) = said.3.or(remedy) {
                findings.remedy(remedy);
            }
            None
        }
    }
}

/// The place of an error; some errors know only their line and column, which count from 1.
fn place(location: Location, text: &str) -> Span {
    if location.span().byte_offset().is_some_and(|offset| offset > 0) {
        return span(location);
    }
    let before = |n: u64| usize::try_from(n).unwrap_or(usize::MAX).saturating_sub(1);
    let line = before(location.line());
    let start: usize = text.split_inclusive('\n').take(line).map(str::len).sum();
    let here = text[start..].lines().next().unwrap_or("");
    let column: usize = here.chars().take(before(location.column())).map(char::len_utf8).sum();
    Span { start: start + column, end: start + column + 1 }
}

/// What the parser says of a file that it cannot read.
enum Explained {
    /// What is wrong, and what can be done about it, in words and as data.
    Said(String, Option<String>, Option<Remedy>),
    /// That it is no YAML, in the parser's words.
    Syntax(String),
}

fn explained(error: &serde_saphyr::Error, at: Span) -> Explained {
    use serde_saphyr::Error as E;
    let deep = ("this is nested too deep", "states may be nested 60 levels deep");
    let aliases = ("its aliases make it too large", "write out what they stand for, or use fewer of them");
    let mut error = error.without_snippet();
    while let E::AliasError { error: inner, .. } = error {
        error = inner.without_snippet();
    }
    let (message, help) = match error {
        E::DuplicateMappingKey { key: Some(key), .. } => {
            let message = format!("the key `{key}` is there twice");
            let help = "remove one of them, or give it another name".to_owned();
            return Explained::Said(message, Some(help), Some(Remedy::Remove(at)));
        }
        E::MultipleDocuments { .. } => (
            "a second document begins here",
            "a file holds one document: write the other in a file of its own",
        ),
        E::NonFiniteFloat { .. } => ("this is no finite number", "write a number, or a text in quotes"),
        E::AliasReplayLimitExceeded { .. }
        | E::AliasExpansionLimitExceeded { .. }
        | E::AliasReplayStackDepthExceeded { .. } => aliases,
        E::Budget { breach, .. } => match breach {
            BudgetBreach::Depth { .. } => deep,
            BudgetBreach::Aliases { .. }
            | BudgetBreach::Anchors { .. }
            | BudgetBreach::RecordedAnchorEvents { .. }
            | BudgetBreach::RecordedAnchorBytes { .. }
            | BudgetBreach::AliasAnchorRatio { .. } => aliases,
            _ => ("it has too many parts", "put parts of it in files of their own"),
        },
        other => {
            let parser = match other {
                E::ExternalMessage { source, .. } => match source.as_ref() {
                    ExternalMessageSource::Parser(error) => Some(error.kind()),
                    _ => None,
                },
                _ => None,
            };
            if matches!(parser, Some(ErrorKind::RecursionLimitExceeded)) {
                deep
            } else {
                let said = other.to_string();
                let first = said.lines().next().unwrap_or("").trim_start_matches("error: ");
                // The place is said by the finding.
                let first = first.split(" at line ").next().unwrap_or(first).to_owned();
                return Explained::Syntax(first);
            }
        }
    };
    Explained::Said(message.to_owned(), Some(help.to_owned()), None)
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
