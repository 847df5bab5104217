//! A file's text, with its lines and the places of its entries.

use std::cmp::Ordering;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use crate::layout::Layout;
use crate::yaml::{self, Node};

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
#[derive(Debug)]
struct KeptTree {
    root: Arc<Node>,
    /// Whether each entry of its maps can be read by itself.
    divisible: bool,
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

    /// A text that is being edited, and what it was before: its tree is kept, and what the edit left as it was is not read again.
    #[must_use]
    pub fn edited(path: impl Into<PathBuf>, text: impl Into<String>, before: Option<&Self>) -> Self {
        let mut source = Self::new(path, text);
        let tree = before.and_then(|before| {
            let kept = before.tree.as_ref()?.get().filter(|kept| kept.divisible)?;
            let root = yaml::after_edit(&before.text, &kept.root, &source.text)?;
            Some(KeptTree { root: Arc::new(root), divisible: true })
        });
        source.tree = Some(tree.map_or_else(OnceLock::new, OnceLock::from));
        source
    }

    /// The tree, if it is kept and was read.
    pub(crate) fn tree(&self) -> Option<Arc<Node>> {
        self.tree.as_ref()?.get().map(|kept| Arc::clone(&kept.root))
    }

    /// Keeps the tree if the text is being edited.
    pub(crate) fn keep(&self, root: &Arc<Node>, divisible: bool) {
        if let Some(kept) = &self.tree {
            // Another reader may have been first, with the same tree.
            let _ = kept.set(KeptTree { root: Arc::clone(root), divisible });
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
