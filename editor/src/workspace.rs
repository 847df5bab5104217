//! The documents that are open, the files below them, and what is known of each: analysed once a text, answered from then on.

use std::cell::{OnceCell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use armarium_runtime::chart::{self, Chart, Library, NameReference, Outline};
use armarium_source::yaml::{self, Node};
use armarium_source::{Disk, Files, Finding, Findings, Source, code, is_yaml};
use lsp_types::{TextDocumentContentChangeEvent, TextEdit, Uri};

use crate::cases;
use crate::kind::{Catalog, FileKind, check_as};
use crate::schemas::Schemas;
use crate::text::{Lines, Shift, changed};
use crate::uri;

/// Most files of a workspace that are looked through for references.
const MAX_FILES: usize = 2000;
/// Deepest folder that is looked into.
const MAX_DEPTH: usize = 8;

/// Everything that the editor has open or may look at.
#[derive(Debug)]
pub struct Workspace {
    pub(crate) catalog: Catalog,
    pub(crate) schemas: Schemas,
    /// Where charts find other charts besides their own folder.
    pub(crate) folders: Vec<PathBuf>,
    roots: Vec<PathBuf>,
    documents: BTreeMap<PathBuf, Document>,
}

/// An open document.
#[derive(Debug)]
pub(crate) struct Document {
    pub(crate) uri: Uri,
    pub(crate) version: i32,
    pub(crate) source: Arc<Source>,
    pub(crate) lines: Lines,
    /// The kind that its text said last: a file that is being written does not lose it.
    pub(crate) kind: Option<FileKind>,
    analysis: Option<Rc<Analysis>>,
    /// The newest analysis of a text that was YAML.
    readable: Option<Rc<Analysis>>,
}

/// What is known of a text.
#[derive(Debug)]
pub(crate) struct Analysis {
    pub(crate) source: Arc<Source>,
    pub(crate) kind: FileKind,
    /// Everything that is wrong with it and with what it names.
    pub(crate) findings: Vec<Finding>,
    /// A chart with those that it names.
    pub(crate) library: Option<Library>,
    uses: Uses,
    tree: OnceCell<Option<Arc<Node>>>,
    outline: OnceCell<Option<Outline>>,
    references: OnceCell<Vec<NameReference>>,
}

/// What an analysis has looked at besides its text.
#[derive(Clone, Debug, Default)]
struct Uses {
    files: BTreeSet<PathBuf>,
    folders: BTreeSet<PathBuf>,
}

/// The open documents above the disk.
pub(crate) struct Overlay<'w> {
    documents: &'w BTreeMap<PathBuf, Document>,
    uses: RefCell<Uses>,
}

impl Files for Overlay<'_> {
    fn read(&self, path: &Path) -> Result<Arc<Source>, Box<Finding>> {
        self.uses.borrow_mut().files.insert(path.to_owned());
        self.documents.get(path).map_or_else(|| Disk.read(path), |document| Ok(Arc::clone(&document.source)))
    }

    fn head(&self, path: &Path) -> Option<String> {
        self.documents
            .get(path)
            .map_or_else(|| Disk.head(path), |document| Some(document.source.text.clone()))
    }

    fn list(&self, folder: &Path) -> Vec<PathBuf> {
        self.uses.borrow_mut().folders.insert(folder.to_owned());
        let mut files = Disk.list(folder);
        let unsaved = self.documents.keys().filter(|path| path.parent() == Some(folder) && is_yaml(path));
        files.extend(unsaved.cloned());
        files.sort();
        files.dedup();
        files
    }
}

impl Workspace {
    /// A workspace without documents. Charts find others in `folders` besides their own.
    #[must_use]
    pub fn new(catalog: Catalog, folders: &[PathBuf]) -> Self {
        let schemas = Schemas::new(&catalog.registry);
        let mut workspace =
            Self { catalog, schemas, folders: Vec::new(), roots: Vec::new(), documents: BTreeMap::new() };
        workspace.set_folders(folders.iter().cloned());
        workspace
    }

    /// Folders that are looked through for references.
    pub fn set_roots(&mut self, roots: impl IntoIterator<Item = PathBuf>) {
        self.roots = roots.into_iter().map(|root| absolute(&root)).collect();
    }

    /// Sets the folders where charts find others; everything is analysed again.
    pub(crate) fn set_folders(&mut self, folders: impl IntoIterator<Item = PathBuf>) {
        self.folders = folders.into_iter().map(|folder| absolute(&folder)).collect();
        self.documents.values_mut().for_each(|document| document.analysis = None);
    }

    /// Opens a document; one of the same address is replaced.
    pub fn open(&mut self, uri: Uri, version: i32, text: String) {
        let path = uri::path(&uri);
        let before = self.documents.remove(&path);
        let (kind, readable) = before.map_or((None, None), |before| (before.kind, before.readable));
        let source = edited(&path, text, readable.as_deref());
        let kind = FileKind::of(&path, &source.text).or(kind);
        let lines = Lines::of(&source.text);
        let document = Document { uri, version, source, lines, kind, analysis: None, readable };
        self.documents.insert(path.clone(), document);
        self.touched(&path);
    }

    /// Changes the text of an open document.
    pub fn change(&mut self, uri: &Uri, version: i32, changes: Vec<TextDocumentContentChangeEvent>) {
        let path = uri::path(uri);
        let Some(document) = self.documents.get_mut(&path) else { return };
        let (text, lines) = changed((&document.source.text, &document.lines), changes);
        (document.version, document.lines) = (version, lines);
        document.kind = FileKind::of(&path, &text).or(document.kind);
        document.source = edited(&path, text, document.readable.as_deref());
        document.analysis = None;
        self.touched(&path);
    }

    /// The text of an open document.
    #[must_use]
    pub fn text(&self, uri: &Uri) -> Option<&str> {
        self.documents.get(&uri::path(uri)).map(|document| document.source.text.as_str())
    }

    /// Closes a document: from now on its file counts.
    pub fn close(&mut self, uri: &Uri) {
        let path = uri::path(uri);
        self.documents.remove(&path);
        self.touched(&path);
    }

    /// Forgets what was found with the old text of a file.
    pub(crate) fn touched(&mut self, path: &Path) {
        for document in self.documents.values_mut() {
            let uses = document.analysis.as_ref().map(|analysis| &analysis.uses);
            let uses_it = |uses: &Uses| {
                uses.files.contains(path) || path.parent().is_some_and(|folder| uses.folders.contains(folder))
            };
            if document.kind == Some(FileKind::Test) || uses.is_some_and(uses_it) {
                document.analysis = None;
            }
        }
    }

    /// The addresses of open documents that have not been analysed since they, or what they name, were changed.
    pub fn stale(&self) -> impl Iterator<Item = &Uri> {
        let stale = self.documents.values().filter(|d| d.kind.is_some() && d.analysis.is_none());
        stale.map(|document| &document.uri)
    }

    /// Everything that is wrong with a document and with what it names; none of a document that is not of a known kind.
    pub fn findings(&mut self, uri: &Uri) -> Vec<Finding> {
        let analysis = self.analysis(&uri::path(uri));
        analysis.map_or_else(Vec::new, |analysis| analysis.findings.clone())
    }

    pub(crate) fn document(&self, path: &Path) -> Option<&Document> {
        self.documents.get(path)
    }

    pub(crate) fn documents(&self) -> impl Iterator<Item = (&PathBuf, &Document)> {
        self.documents.iter()
    }

    pub(crate) fn roots(&self) -> &[PathBuf] {
        &self.roots
    }

    fn overlay(&self) -> Overlay<'_> {
        Overlay { documents: &self.documents, uses: RefCell::default() }
    }

    /// The analysis of an open document's newest text.
    pub(crate) fn analysis(&mut self, path: &Path) -> Option<Rc<Analysis>> {
        let document = self.documents.get(path)?;
        if let Some(analysis) = &document.analysis {
            return Some(Rc::clone(analysis));
        }
        let analysis = Rc::new(self.analyse(document.kind?, &document.source));
        let document = self.documents.get_mut(path)?;
        document.analysis = Some(Rc::clone(&analysis));
        if analysis.is_readable() {
            document.readable = Some(Rc::clone(&analysis));
        }
        Some(analysis)
    }

    /// The newest analysis of a document whose text was YAML, and where places of the present text are in it.
    pub(crate) fn readable(&mut self, path: &Path) -> Option<(Rc<Analysis>, Shift)> {
        self.analysis(path)?;
        let document = self.documents.get(path)?;
        let analysis = document.readable.as_ref()?;
        Some((Rc::clone(analysis), Shift::between(&document.source.text, &analysis.source.text)))
    }

    fn analyse(&self, kind: FileKind, source: &Arc<Source>) -> Analysis {
        let overlay = self.overlay();
        let checked = check_as(kind, Arc::clone(source), &self.folders, &overlay, &self.catalog);
        Analysis {
            source: Arc::clone(source),
            kind,
            findings: checked.findings,
            library: checked.library,
            uses: overlay.uses.into_inner(),
            tree: OnceCell::new(),
            outline: OnceCell::new(),
            references: OnceCell::new(),
        }
    }

    /// A file of this workspace, analysed as it was in another one.
    pub(crate) fn reopened(&self, before: &Analysis) -> Analysis {
        let source = self.overlay().read(&before.source.path).unwrap_or_else(|_| Arc::clone(&before.source));
        self.analyse(before.kind, &source)
    }

    /// The chart that a file of test cases is about, with those that it names.
    pub(crate) fn tested(&self, analysis: &Analysis) -> Option<Library> {
        let chart = analysis.tree()?.get("test")?.literal();
        let file = analysis.source.path.parent()?.join(chart.as_str()?);
        let library = chart::load_from(&absolute(&file), &self.folders, &self.overlay());
        library.charts.contains_key(&library.root).then_some(library)
    }

    /// The names in a document, and in the files that it names, with what they stand for.
    pub(crate) fn references<'a>(&self, analysis: &'a Analysis) -> &'a [NameReference] {
        analysis.references.get_or_init(|| {
            let index =
                |library: &Library| chart::index(library, &self.catalog.registry, &self.catalog.channels);
            match (&analysis.library, analysis.kind) {
                (Some(library), _) => index(library),
                (None, FileKind::Test) => self.tested(analysis).map_or_else(Vec::new, |library| {
                    let mut references = index(&library);
                    if let Some(tree) = analysis.tree() {
                        references.extend(cases::references(&analysis.source, tree, &library, &references));
                    }
                    references
                }),
                _ => Vec::new(),
            }
        })
    }

    /// Every file of the workspace that is of a known kind, analysed: the open documents by their texts.
    pub(crate) fn everything(&self) -> Vec<Rc<Analysis>> {
        let mut files: BTreeSet<PathBuf> = self.documents.keys().cloned().collect();
        for root in self.roots.iter().chain(&self.folders) {
            collect(root, MAX_DEPTH, &mut files);
        }
        let beside: BTreeSet<&Path> = self.documents.keys().filter_map(|path| path.parent()).collect();
        beside.into_iter().for_each(|folder| collect(folder, 0, &mut files));
        let overlay = self.overlay();
        let one = |path: PathBuf| {
            if let Some(analysis) = self.documents.get(&path).and_then(|document| document.analysis.as_ref())
            {
                return Some(Rc::clone(analysis));
            }
            let source = overlay.read(&path).ok()?;
            let kind = FileKind::of(&path, &source.text)?;
            Some(Rc::new(self.analyse(kind, &source)))
        };
        files.into_iter().filter_map(one).collect()
    }

    /// The names of charts that a file can use, with their files.
    pub(crate) fn charts(&self, path: &Path) -> BTreeMap<String, Vec<PathBuf>> {
        let mut folders: Vec<PathBuf> = path.parent().map(Path::to_owned).into_iter().collect();
        folders.extend(self.folders.iter().cloned());
        chart::files(&folders, &self.overlay())
    }
}

impl Document {
    /// An edit of this document for the client.
    pub(crate) fn edit(&self, edit: armarium_source::Edit) -> TextEdit {
        TextEdit::new(self.lines.range(&self.source.text, edit.span), edit.text)
    }
}

impl Analysis {
    fn is_readable(&self) -> bool {
        let broken = |finding: &Finding| {
            finding.source.path == self.source.path && matches!(finding.code, code::YAML | code::FILE)
        };
        !self.findings.iter().any(broken)
    }

    /// The text as YAML.
    pub(crate) fn tree(&self) -> Option<&Node> {
        self.tree.get_or_init(|| yaml::parse(&mut Findings::new(Arc::clone(&self.source)))).as_deref()
    }

    /// The chart in the file.
    pub(crate) fn chart(&self) -> Option<&Arc<Chart>> {
        let library = self.library.as_ref()?;
        library.charts.get(&library.root)
    }

    /// The chart's states and transitions.
    pub(crate) fn outline(&self) -> Option<&Outline> {
        self.outline.get_or_init(|| self.chart().map(|chart| Outline::of(chart))).as_ref()
    }
}

/// The text of a document, of which not more is read again than was changed since it was YAML last.
fn edited(path: &Path, text: String, readable: Option<&Analysis>) -> Arc<Source> {
    Arc::new(yaml::edited(path, text, readable.map(|analysis| &*analysis.source)))
}

/// Adds the YAML files of a folder and of those inside it, but not of hidden ones and of what tools make.
fn collect(folder: &Path, depth: usize, files: &mut BTreeSet<PathBuf>) {
    let mut folders = vec![(folder.to_owned(), depth)];
    while let Some((folder, depth)) = folders.pop() {
        files.extend(Disk.list(&folder));
        if files.len() > MAX_FILES || depth == 0 {
            continue;
        }
        let Ok(entries) = std::fs::read_dir(&folder) else { continue };
        for entry in entries.flatten().filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir())) {
            let name = entry.file_name().to_string_lossy().into_owned();
            if !name.starts_with('.') && name != "target" && name != "node_modules" {
                folders.push((entry.path(), depth - 1));
            }
        }
    }
}

/// A path from the root, without `.` and `..`.
pub(crate) fn absolute(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => {
                plain.pop();
            }
            Component::CurDir => {}
            part => plain.push(part),
        }
    }
    plain
}
