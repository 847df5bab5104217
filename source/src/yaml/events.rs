//! Builds the tree from the events of the YAML parser: bounds, aliases, merge keys and duplicate keys.
//!
//! The meaning of scalars is in `scalars`; messages for texts that are no YAML are in `errors`.

use std::collections::{BTreeMap, BTreeSet};

use granit_parser::{ErrorKind, Event, Marker, Parser, ScalarStyle, ScanError, StrInput, Tag};

use super::scalars::{Resolved, resolve};
use crate::remedy::Remedy;
use crate::span::Span;
use crate::tree::{Named, Node, Yaml};

/// Deepest nesting of YAML; 60 levels of states are within it.
const MAX_DEPTH: usize = 190;
/// Most nodes: 200 000 states of ten nodes.
const MAX_NODES: usize = 4_000_000;
/// Most nodes that anchors keep and aliases repeat.
const MAX_ALIASED: usize = 200_000;
/// Maps with more keys look up duplicates in a set.
const FEW_KEYS: usize = 12;

/// Why a text gives no tree.
pub(crate) enum Unreadable {
    /// The text is YAML, but not what a file here may hold.
    Content { at: Span, message: String, help: String, remedy: Option<Remedy> },
    /// The text is no YAML.
    Syntax { at: Span },
}

fn refuse<T>(at: Span, message: impl Into<String>, help: &str) -> Result<T, Box<Unreadable>> {
    Err(Box::new(Unreadable::Content { at, message: message.into(), help: help.to_owned(), remedy: None }))
}

fn too_deep<T>(at: Span) -> Result<T, Box<Unreadable>> {
    refuse(at, "this is nested too deep", "states may be nested 60 levels deep")
}

/// The tree of a text with one document, which stands `depth` levels inside another, and whether each entry of its maps can be
/// read by itself.
pub(crate) fn read(text: &str, depth: usize) -> Result<(Node, bool), Box<Unreadable>> {
    let mut options = granit_parser::Options::default();
    options.emit_comments = false;
    let parser = Parser::new_from_str_with_options(text, options);
    let mut reader = TreeReader {
        text,
        parser,
        anchors: BTreeMap::new(),
        items: Vec::new(),
        entries: Vec::new(),
        nodes: 0,
        aliased: 0,
        divisible: true,
    };
    let everything = Span { start: 0, end: 1 };
    let mut tree = None;
    while let Some((event, at)) = reader.next()? {
        match event {
            Event::StreamStart | Event::DocumentEnd => {}
            Event::StreamEnd => break,
            Event::DocumentStart(..) if tree.is_some() => {
                let help = "a file holds one document: write the other in a file of its own";
                return refuse(at, "a second document begins here", help);
            }
            Event::DocumentStart(..) => {
                if let Some((event, at)) = reader.next()? {
                    tree = Some(reader.node(event, at, depth)?);
                }
            }
            _ => return Err(TreeReader::unexpected(at)),
        }
    }
    let root = tree.unwrap_or(Node { span: everything, value: Yaml::Null });
    Ok((root, reader.divisible))
}

struct TreeReader<'t> {
    text: &'t str,
    parser: Parser<'t, StrInput<'t>>,
    /// What anchors stand for, once it is complete.
    anchors: BTreeMap<usize, Node>,
    /// The items and entries of the lists and maps that are not complete yet, so that each is allocated once.
    items: Vec<Node>,
    entries: Vec<(Named, Node)>,
    nodes: usize,
    aliased: usize,
    /// Whether every entry means the same when it is read alone.
    divisible: bool,
}

impl<'t> TreeReader<'t> {
    fn next(&mut self) -> Result<Option<(Event<'t>, Span)>, Box<Unreadable>> {
        match self.parser.next_event() {
            None => Ok(None),
            Some(Ok((event, span))) => {
                let start = span.start.byte_offset().unwrap_or(0);
                let end = span.end.byte_offset().unwrap_or(start).max(start + 1);
                Ok(Some((event, Span { start, end })))
            }
            Some(Err(error)) => self.syntax(&error),
        }
    }

    fn syntax<T>(&self, error: &ScanError) -> Result<T, Box<Unreadable>> {
        let start = self.offset(*error.marker());
        let at = Span { start, end: start + 1 };
        if matches!(error.kind(), ErrorKind::RecursionLimitExceeded) {
            return too_deep(at);
        }
        Err(Box::new(Unreadable::Syntax { at }))
    }

    /// The byte at a marker; some markers know only how many characters are before them.
    fn offset(&self, marker: Marker) -> usize {
        let by_characters =
            || self.text.char_indices().nth(marker.index()).map_or(self.text.len(), |(at, _)| at);
        marker.byte_offset().unwrap_or_else(by_characters)
    }

    /// For an event that the parser does not give in this place.
    fn unexpected(at: Span) -> Box<Unreadable> {
        Box::new(Unreadable::Syntax { at })
    }

    /// The node that begins with `event`.
    fn node(&mut self, event: Event<'t>, at: Span, depth: usize) -> Result<Node, Box<Unreadable>> {
        self.nodes += 1;
        if self.nodes > MAX_NODES {
            return refuse(at, "it has too many parts", "put parts of it in files of their own");
        }
        if depth > MAX_DEPTH {
            return too_deep(at);
        }
        let (node, anchor) = match event {
            Event::Scalar(text, style, anchor, tag) => {
                // A text of several lines goes to the next key by the parser.
                let block = matches!(style, ScalarStyle::Literal | ScalarStyle::Folded);
                let written = self.text.get(at.start..at.end).filter(|_| block).map(str::trim_end);
                let end = written.map_or(at.end, |written| at.start + written.len().max(1));
                // One without lines stands where the next key does.
                self.divisible &= !(block && text.trim().is_empty());
                (scalar(&text, style, tag.as_deref(), Span { end, ..at })?, anchor)
            }
            Event::SequenceStart(_, anchor, _) => (Node { span: at, value: self.list(depth)? }, anchor),
            Event::MappingStart(_, anchor, _) => (self.map(at, depth)?, anchor),
            Event::Alias(anchor) => return self.alias(anchor, at),
            _ => return Err(Self::unexpected(at)),
        };
        if anchor > 0 {
            self.divisible = false;
            self.repeat(&node, at)?;
            self.anchors.insert(anchor, node.clone());
        }
        Ok(node)
    }

    fn list(&mut self, depth: usize) -> Result<Yaml, Box<Unreadable>> {
        let first = self.items.len();
        while let Some((event, at)) = self.next()? {
            if event == Event::SequenceEnd {
                break;
            }
            let item = self.node(event, at, depth + 1)?;
            self.items.push(item);
        }
        Ok(Yaml::List(self.items.drain(first..).collect()))
    }

    fn map(&mut self, at: Span, depth: usize) -> Result<Node, Box<Unreadable>> {
        let first = self.entries.len();
        let mut merged = Vec::new();
        let mut keys = BTreeSet::new();
        while let Some((event, at)) = self.next()? {
            if event == Event::MappingEnd {
                break;
            }
            let merges = matches!(&event, Event::Scalar(text, ScalarStyle::Plain, _, None) if text == "<<");
            let key = self.key(event, at)?;
            if merges {
                let (event, at) = self.next()?.ok_or_else(|| Self::unexpected(at))?;
                merged.push(self.node(event, at, depth + 1)?);
                continue;
            }
            let entries = &self.entries[first..];
            if entries.len() == FEW_KEYS {
                keys.extend(entries.iter().map(|(known, _)| known.text.clone()));
            }
            let known = match entries.len() {
                0..FEW_KEYS => entries.iter().any(|(known, _)| known.text == key.text),
                _ => !keys.insert(key.text.clone()),
            };
            if known {
                return Err(Box::new(Unreadable::Content {
                    at: key.span,
                    message: format!("the key `{}` is there twice", key.text),
                    help: "remove one of them, or give it another name".to_owned(),
                    remedy: Some(Remedy::Remove(key.span)),
                }));
            }
            let (event, at) = self.next()?.ok_or_else(|| Self::unexpected(at))?;
            let written = |at: usize| self.text.get(at..).unwrap_or("").trim_start_matches(' ');
            if matches!(&event, Event::Scalar(text, ScalarStyle::Plain, 0, None) if text == "~")
                && !written(at.start).starts_with('~')
                && !written(key.span.end).starts_with(':')
            {
                self.with_its_value_in_it(&key)?;
            }
            let node = self.node(event, at, depth + 1)?;
            self.with_a_brace_in_it(&key, &node)?;
            self.entries.push((key, node));
        }
        let mut entries: Vec<_> = self.entries.drain(first..).collect();
        for merged in merged {
            merge(&mut entries, merged)?;
        }
        let mut span = at;
        if let Some((first, _)) = entries.first()
            && first.span.start >= span.start
        {
            span.end = first.span.end;
        }
        Ok(Node { span, value: Yaml::Map(entries) })
    }

    fn key(&mut self, event: Event<'t>, at: Span) -> Result<Named, Box<Unreadable>> {
        let text = match event {
            Event::Scalar(text, _, anchor, tag) => {
                if anchor > 0 {
                    self.divisible = false;
                    let node = scalar(&text, ScalarStyle::Plain, tag.as_deref(), at)?;
                    self.anchors.insert(anchor, node);
                }
                Some(text.as_ref().to_owned())
            }
            Event::Alias(anchor) => match self.alias(anchor, at)?.value {
                Yaml::String(text) => Some(text),
                _ => None,
            },
            _ => None,
        };
        match text {
            Some(text) => Ok(Named { span: at, text }),
            None => refuse(at, "a key is a name", "a list or a map cannot be a key"),
        }
    }

    /// Refuses a key without `:` before a map in braces, which swallowed the brace: `A {skill: Act}`.
    fn with_a_brace_in_it(&self, key: &Named, node: &Node) -> Result<(), Box<Unreadable>> {
        let written = self.text.get(key.span.start..key.span.end).unwrap_or("");
        let Some((name, inside)) = written.split_once(" {").filter(|_| written == key.text) else {
            return Ok(());
        };
        let Yaml::String(value) = &node.value else { return Ok(()) };
        if !value.ends_with('}') || name.contains(['"', '\'', '$']) {
            return Ok(());
        }
        let end = key.span.start + name.trim_end().len();
        let name = name.trim();
        Err(Box::new(Unreadable::Content {
            at: Span { start: key.span.start, end },
            message: format!("a `:` is missing after `{name}`"),
            help: format!("write `{name}: {{{inside}: {value}`"),
            remedy: Some(Remedy::replace(Span { start: end, end }, ":")),
        }))
    }

    /// Refuses a key between brackets without `:` that swallowed its value: `{final success}`, `{posture:home}`.
    fn with_its_value_in_it(&self, key: &Named) -> Result<(), Box<Unreadable>> {
        let written = self.text.get(key.span.start..key.span.end).unwrap_or("").trim_end();
        if written != key.text {
            return Ok(());
        }
        if written.contains(['<', '>', '=', '!', '&', '|', '+', '*']) {
            let open = self.text[..key.span.start].trim_end();
            let closes = self.text[key.span.end..].find('}').map(|close| key.span.end + close + 1);
            let quote = if written.contains('"') { '\'' } else { '"' };
            let quoted = format!("{quote}{written}{quote}");
            let braces = closes.filter(|close| {
                open.ends_with('{')
                    && self.text[key.span.end..close - 1].trim().is_empty()
                    && !written.contains(quote)
            });
            return Err(Box::new(Unreadable::Content {
                at: key.span,
                message: "an expression stands in quotes, without braces".to_owned(),
                help: format!("write `{quoted}`"),
                remedy: braces.map(|end| Remedy::replace(Span { start: open.len() - 1, end }, quoted)),
            }));
        }
        let (name, value, missing) = if let Some((name, value)) = written.split_once(':') {
            (name, value, "space is missing after")
        } else if let Some((name, value)) = written.split_once(char::is_whitespace) {
            (name, value, "`:` is missing after")
        } else {
            return Ok(());
        };
        let colon = if missing.starts_with('s') { ":" } else { "" };
        let right = format!("{name}: {}", value.trim());
        Err(Box::new(Unreadable::Content {
            at: key.span,
            message: format!("a {missing} `{name}{colon}`"),
            help: format!("write `{right}`"),
            remedy: Some(Remedy::replace(key.span, right)),
        }))
    }

    /// A copy of what an anchor stands for, with the alias as its place.
    fn alias(&mut self, anchor: usize, at: Span) -> Result<Node, Box<Unreadable>> {
        let Some(node) = self.anchors.get(&anchor).cloned() else {
            return refuse(at, "this alias stands inside what it stands for", "write out what it stands for");
        };
        self.repeat(&node, at)?;
        Ok(placed(node, at))
    }

    /// Counts the nodes of a copy.
    fn repeat(&mut self, node: &Node, at: Span) -> Result<(), Box<Unreadable>> {
        self.aliased += size(node);
        if self.aliased > MAX_ALIASED {
            let help = "write out what they stand for, or use fewer of them";
            return refuse(at, "its aliases make it too large", help);
        }
        Ok(())
    }
}

/// Adds the entries of a map, or of a list of maps, under `<<`, but for keys that are there already.
fn merge(entries: &mut Vec<(Named, Node)>, merged: Node) -> Result<(), Box<Unreadable>> {
    match merged.value {
        Yaml::Map(others) => {
            for (key, node) in others {
                if !entries.iter().any(|(known, _)| known.text == key.text) {
                    entries.push((key, node));
                }
            }
            Ok(())
        }
        Yaml::List(items) => items.into_iter().try_for_each(|item| merge(entries, item)),
        _ => refuse(
            merged.span,
            "`<<` takes in the keys of a map",
            "write `<<: *name` of a map that has `&name`",
        ),
    }
}

/// How many nodes a tree has.
fn size(node: &Node) -> usize {
    1 + match &node.value {
        Yaml::List(items) => items.iter().map(size).sum::<usize>(),
        Yaml::Map(entries) => entries.iter().map(|(_, node)| size(node)).sum::<usize>(),
        _ => 0,
    }
}

fn placed(node: Node, span: Span) -> Node {
    let value = match node.value {
        Yaml::List(items) => Yaml::List(items.into_iter().map(|item| placed(item, span)).collect()),
        Yaml::Map(entries) => {
            let one = |(key, node): (Named, Node)| (Named { span, text: key.text }, placed(node, span));
            Yaml::Map(entries.into_iter().map(one).collect())
        }
        other => other,
    };
    Node { span, value }
}

fn scalar(text: &str, style: ScalarStyle, tag: Option<&Tag>, span: Span) -> Result<Node, Box<Unreadable>> {
    let core = tag.and_then(Tag::core_suffix);
    let value = match (style, core) {
        (_, Some("str")) => Yaml::String(text.to_owned()),
        (ScalarStyle::Plain, _) | (_, Some(_)) => match resolve(text) {
            Resolved::Value(value) => value,
            Resolved::Text => Yaml::String(text.to_owned()),
            Resolved::NotFinite => {
                return refuse(span, "this is no finite number", "write a number, or a text in quotes");
            }
        },
        _ => Yaml::String(text.to_owned()),
    };
    Ok(Node { span, value })
}
