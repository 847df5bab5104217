//! The tree of a text after an edit. Where the edit lies inside one entry of block maps, only that entry is read again, and the rest
//! is the tree from before at its new places. It gives what reading the whole text gives, or nothing.

use std::path::PathBuf;
use std::sync::Arc;

use super::events::read;
use crate::span::Span;
use crate::text::{KeptTree, Source};
use crate::tree::{Named, Node, Yaml};

/// A text that is being edited, and what it was before: its tree is kept, and what the edit left as it was is not read again.
#[must_use]
pub fn edited(path: impl Into<PathBuf>, text: impl Into<String>, before: Option<&Source>) -> Source {
    let text = text.into();
    let tree = before.and_then(|before| {
        let kept = before.tree().filter(|kept| kept.divisible)?;
        let root = Arc::new(after_edit(&before.text, &kept.root, &text)?);
        Some(KeptTree { root, divisible: true })
    });
    Source::with_tree(path, text, tree)
}

/// The tree of `text`, if it can be made from that of the text `before` the edit, each entry of which can be read by
/// itself.
pub(crate) fn after_edit(before: &str, tree: &Node, text: &str) -> Option<Node> {
    let edit = differing(before, text);
    let (way, lines) = entry_around(before, tree, edit)?;
    let end = lines.end.checked_add(text.len())?.checked_sub(before.len())?;
    let (entry, divisible) = read(text.get(lines.start..end)?, way.len()).ok()?;
    let Yaml::Map(entries) = entry.value else { return None };
    let [(key, value)] = <[(Named, Node); 1]>::try_from(entries).ok()?;
    let mut root = tree.clone();
    let by = text.len() as isize - before.len() as isize;
    moved(&mut root, edit.end, by);
    let (last, around) = way.split_last()?;
    let mut map = &mut root;
    for step in around {
        map = &mut map.entries_mut()?.get_mut(*step)?.1;
    }
    let old = map.entries_mut()?.get_mut(*last)?;
    let start = lines.start as isize;
    let key = Named { span: moved_span(key.span, 0, start), ..key };
    if !divisible || key != old.0 {
        return None;
    }
    old.1 = value;
    moved(&mut old.1, 0, start);
    Some(root)
}

/// What of `before` is not in `text`, where both begin and end in the same way.
fn differing(before: &str, text: &str) -> Span {
    let (a, b) = (before.as_bytes(), text.as_bytes());
    let start = a.iter().zip(b).take_while(|(a, b)| a == b).count();
    let same_end = a[start..].iter().rev().zip(b[start..].iter().rev()).take_while(|(a, b)| a == b).count();
    Span { start, end: a.len() - same_end }
}

/// The innermost entry of block maps whose value an edit is in: the way to it through the tree, and its lines.
fn entry_around(text: &str, tree: &Node, edit: Span) -> Option<(Vec<usize>, Span)> {
    let (mut way, mut lines) = (Vec::new(), None);
    let (mut node, mut end) = (tree, text.len());
    // Before the first key, and between a key and a map below it, nothing stands but comments.
    let mut between = text.get(..first_line(text, node)?)?;
    while let Yaml::Map(entries) = &node.value
        && between.lines().all(|line| line.trim().is_empty() || line.trim_start().starts_with('#'))
    {
        let Some(at) = entries.partition_point(|(key, _)| key.span.start <= edit.start).checked_sub(1) else {
            break;
        };
        let (key, value) = &entries[at];
        let start = line_of(text, key.span.start)?;
        let next = match entries.get(at + 1) {
            Some((next, _)) => line_of(text, next.span.start)?,
            None => end,
        };
        if edit.start <= key.span.end || edit.end >= next && next < text.len() {
            break;
        }
        way.push(at);
        (lines, node, end) = (Some(Span { start, end: next }), value, next);
        let Some(first) = first_line(text, value) else { break };
        let Some(after) =
            text.get(key.span.end..first).and_then(|after| after.trim_start().strip_prefix(':'))
        else {
            break;
        };
        between = after;
    }
    Some((way, lines?))
}

/// Where the line of a map's first key begins, if only its indentation stands before it.
fn first_line(text: &str, node: &Node) -> Option<usize> {
    match &node.value {
        Yaml::Map(entries) => line_of(text, entries.first()?.0.span.start),
        _ => None,
    }
}

/// Where the line of a key begins, if only its indentation stands before it.
fn line_of(text: &str, key: usize) -> Option<usize> {
    let start = text.get(..key)?.rfind('\n').map_or(0, |newline| newline + 1);
    text[start..key].bytes().all(|byte| byte == b' ').then_some(start)
}

/// Moves what begins at `from` or later.
fn moved(node: &mut Node, from: usize, by: isize) {
    node.span = moved_span(node.span, from, by);
    match &mut node.value {
        Yaml::List(items) => items.iter_mut().for_each(|item| moved(item, from, by)),
        Yaml::Map(entries) => {
            for (key, node) in entries {
                key.span = moved_span(key.span, from, by);
                moved(node, from, by);
            }
        }
        _ => {}
    }
}

fn moved_span(span: Span, from: usize, by: isize) -> Span {
    match span.start >= from {
        true => Span { start: span.start.saturating_add_signed(by), end: span.end.saturating_add_signed(by) },
        false => span,
    }
}
