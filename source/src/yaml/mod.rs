//! YAML as a tree of places: the text is parsed once, and everything else reads this tree.
//!
//! Only the form is known here. Limits on size, nodes, depth and aliases hold against hostile files.

mod edited;
mod errors;
mod events;
mod scalars;

use std::sync::Arc;

use crate::code;
use crate::finding::{Findings, MAX_BYTES, too_large};
use crate::remedy::{Edit, Remedy, applied};
use crate::span::Span;
use crate::text::{KeptTree, Source};
use errors::slip_near;
use events::{Unreadable, read};

pub use crate::tree::{Entries, Named, Node, Yaml};
#[cfg(test)]
pub(crate) use edited::after_edit;
pub use edited::edited;

/// Parses a file's text. What is wrong is added to `findings`.
pub fn parse(findings: &mut Findings) -> Option<Arc<Node>> {
    let source = Arc::clone(&findings.source);
    if let Some(tree) = source.tree() {
        return Some(Arc::clone(&tree.root));
    }
    let everything = Span { start: 0, end: 1 };
    if source.text.len() > MAX_BYTES {
        let (message, help) = too_large();
        findings.error_help(code::FILE, everything, message, Some(help.into()));
        return None;
    }
    let refusal = match read(&source.text, 0) {
        Ok((root, divisible)) => {
            let tree = KeptTree { root: Arc::new(root), divisible };
            source.keep(&tree);
            return Some(tree.root);
        }
        Err(refusal) => refusal,
    };
    let (at, message, help, mut remedy) = match *refusal {
        Unreadable::Content { at, message, help, remedy } => (at, message, Some(help), remedy),
        Unreadable::Syntax { at } => match slip_near(&source.text, at.start) {
            Some(slip) => {
                let remedy = (!slip.edits.is_empty()).then_some(Remedy::Replace(slip.edits));
                (slip.span, slip.message, Some(slip.help), remedy)
            }
            None => {
                let help = "look at this line and at the one before: a bracket, a quote, a `:` or the space after it \
                    may be missing, or be one too many";
                (at, "this cannot be read as YAML".to_owned(), Some(help.to_owned()), None)
            }
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

/// Spaces for the tabs before the text of a line: as many as the lines around it have.
fn spaces_for_tabs(at: Span, text: &str) -> Option<Remedy> {
    let start = text.get(..at.start)?.rfind('\n').map_or(0, |newline| newline + 1);
    let indent = |line: &str| line.find(|c| c != ' ' && c != '\t').unwrap_or(0);
    let span = Span { start, end: start + indent(&text[start..]) };
    if !text[span.start..span.end].contains('\t') {
        return None;
    }
    let written = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with('#');
    let before = text[..start].lines().rev().find(written).unwrap_or("");
    let after = text[start..].lines().skip(1).find(written).unwrap_or("");
    let spaces = match before.trim_end().ends_with(':') {
        true if !after[..indent(after)].contains('\t') && indent(after) > indent(before) => indent(after),
        true => indent(before) + 2,
        false => indent(before),
    };
    Some(Remedy::replace(span, " ".repeat(spaces)))
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
    let (last, _) = edits.split_last()?;
    if read(&applied(text, &edits), 0).is_err() {
        // The brace that the expression took was that of the map around it.
        let mut closed = edits.clone();
        closed.push(Edit { span: last.span, text: "}".to_owned() });
        if read(&applied(text, &closed), 0).is_ok() {
            return Some(Remedy::Replace(closed));
        }
    }
    Some(Remedy::Replace(edits))
}
