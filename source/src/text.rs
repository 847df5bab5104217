//! A file's text, with its lines and the places of its entries.

use std::cmp::Ordering;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use crate::layout::Layout;
use crate::tree::Node;

/// A file's text, kept so that findings can show it.
#[derive(Debug)]
pub struct Source {
    /// Where it was read from.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
    lines: Vec<usize>,
    layout: OnceLock<Layout>,
    /// The tree, kept only where the text is edited.
    tree: Option<OnceLock<KeptTree>>,
}

/// The tree of a text.
#[derive(Clone, Debug)]
pub(crate) struct KeptTree {
    pub(crate) root: Arc<Node>,
    /// Whether each entry of its maps can be read by itself.
    pub(crate) divisible: bool,
}

impl PartialEq for Source {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path && self.text == other.text
    }
}

impl Eq for Source {}

impl Source {
    /// A text and where it came from.
    pub fn new(path: impl Into<PathBuf>, text: impl Into<String>) -> Self {
        let text = text.into();
        let starts = text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i + 1);
        let lines = std::iter::once(0).chain(starts).collect();
        Self { path: path.into(), text, lines, layout: OnceLock::new(), tree: None }
    }

    /// A text that keeps its tree once it is read, or has it already.
    pub(crate) fn with_tree(path: impl Into<PathBuf>, text: String, tree: Option<KeptTree>) -> Self {
        let tree = tree.map_or_else(OnceLock::new, OnceLock::from);
        Self { tree: Some(tree), ..Self::new(path, text) }
    }

    /// The tree, if it is kept and was read.
    pub(crate) fn tree(&self) -> Option<&KeptTree> {
        self.tree.as_ref()?.get()
    }

    /// Keeps the tree where it is to be kept.
    pub(crate) fn keep(&self, tree: &KeptTree) {
        if let Some(kept) = &self.tree {
            // Another reader may have been first, with the same tree.
            let _ = kept.set(tree.clone());
        }
    }

    /// The order of two texts by their paths.
    #[must_use]
    pub fn by_path(&self, other: &Self) -> Ordering {
        // Most often it is one text, and paths are compared part by part.
        if std::ptr::eq(self, other) { Ordering::Equal } else { self.path.cmp(&other.path) }
    }

    /// Where its entries stand.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        self.layout.get_or_init(|| Layout::of(&self.text))
    }

    /// Line and column of a byte, both from 1; columns count characters.
    pub fn position(&self, byte: usize) -> (usize, usize) {
        let line = self.lines.partition_point(|start| *start <= byte).max(1);
        let start = self.lines[line - 1];
        let before = self.text.get(start..byte.min(self.text.len())).unwrap_or("");
        (line, before.chars().count() + 1)
    }

    /// `file:line:column` of a byte.
    pub fn place(&self, byte: usize) -> String {
        let (line, column) = self.position(byte);
        format!("{}:{line}:{column}", self.path.display())
    }
}
