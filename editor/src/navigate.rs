//! From a name to where it is defined, and to everywhere it is used.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use armarium_runtime::chart::{Library, NameReference, Symbol};
use armarium_source::{Source, Span};
use lsp_types::{Location, Position, Range, Uri};

use crate::text::{Lines, Shift};
use crate::uri;
use crate::workspace::{Analysis, Workspace};

/// The names of a file and of those that it names, with the files of its charts.
pub(crate) struct FileNames<'a> {
    pub(crate) references: &'a [NameReference],
    charts: BTreeMap<String, PathBuf>,
}

impl Workspace {
    /// What the name at a place stands for, and the name's place in the present text. A name may stand for several things:
    /// an outcome is that of all states that end so.
    pub(crate) fn symbols_at(&mut self, path: &Path, position: Position) -> Option<(Span, Vec<Symbol>)> {
        let (analysis, shift) = self.readable(path)?;
        let document = self.document(path)?;
        let offset = document.lines.offset(&document.source.text, position);
        let there = shift.map(offset)?;
        let at = |reference: &&NameReference| {
            reference.source.path == path && reference.span.start <= there && there <= reference.span.end
        };
        let found: Vec<&NameReference> = self.references(&analysis).iter().filter(at).collect();
        // Of names that touch, the one after the place; of one inside of the other, the inner.
        let best = found
            .iter()
            .max_by_key(|r| (there < r.span.end, std::cmp::Reverse(r.span.end - r.span.start)))?;
        let symbols = found.iter().filter(|r| r.span == best.span).map(|r| r.symbol.clone()).collect();
        Some((shift.back().span(best.span)?, symbols))
    }

    /// Where the name at a place is defined.
    pub fn definition(&mut self, uri: &Uri, position: Position) -> Vec<Location> {
        let path = uri::path(uri);
        let Some((_, symbols)) = self.symbols_at(&path, position) else { return Vec::new() };
        let Some((analysis, _)) = self.readable(&path) else { return Vec::new() };
        let defines = |r: &&NameReference| r.definition && symbols.contains(&r.symbol);
        let found: Vec<NameReference> = self.references(&analysis).iter().filter(defines).cloned().collect();
        let found = self.locations(&found);
        if found.is_empty() {
            symbols.iter().filter_map(|symbol| self.declaration(symbol)).collect()
        } else {
            found
        }
    }

    /// Where the program declares a skill, if its text is in the workspace.
    fn declaration(&self, symbol: &Symbol) -> Option<Location> {
        let (Symbol::Skill { skill } | Symbol::OfSkill { skill, .. }) = symbol else { return None };
        let (file, line) = self.catalog.registry.manifest(skill)?.declared_at.line()?;
        let file = self.roots().iter().map(|root| root.join(file)).find(|file| file.is_file())?;
        let at = Position::new(line.saturating_sub(1), 0);
        Some(Location::new(uri::of(&file)?, Range::new(at, at)))
    }

    /// Everywhere that the name at a place is used, in all files of the workspace.
    pub fn find_references(&mut self, uri: &Uri, position: Position, with_definition: bool) -> Vec<Location> {
        let path = uri::path(uri);
        let Some((_, symbols)) = self.symbols_at(&path, position) else { return Vec::new() };
        let found = self.uses(&path, &symbols.into_iter().collect());
        let wanted: Vec<NameReference> =
            found.into_iter().filter(|r| with_definition || !r.definition).collect();
        self.locations(&wanted)
    }

    /// The uses of symbols that a file knows, in the whole workspace, ordered by file and place, each once.
    pub(crate) fn uses(&mut self, path: &Path, symbols: &BTreeSet<Symbol>) -> Vec<NameReference> {
        let Some((from, _)) = self.readable(path) else { return Vec::new() };
        let everything = self.all(&from);
        let names: Vec<FileNames<'_>> = everything.iter().map(|analysis| self.names(analysis)).collect();
        let Some(own) = names.iter().zip(&everything).find(|(_, a)| a.source.path == path) else {
            return Vec::new();
        };
        let connected = connected(own.0, &names, symbols);
        let mut found: Vec<NameReference> = Vec::new();
        for names in names.iter().filter(|names| names.reaches(&connected)) {
            let same = |r: &&NameReference| {
                let chart = |chart: &str| {
                    own.0.charts.get(chart).is_none_or(|file| names.charts.get(chart) == Some(file))
                };
                symbols.contains(&r.symbol) && r.symbol.chart().is_none_or(chart)
            };
            found.extend(names.references.iter().filter(same).cloned());
        }
        found.sort_by(|a, b| {
            let by_place = || (a.span.start, b.definition).cmp(&(b.span.start, a.definition));
            a.source.by_path(&b.source).then_with(by_place)
        });
        found.dedup_by(|a, b| a.span == b.span && a.source.by_path(&b.source).is_eq());
        found
    }

    /// Every file of the workspace, and one that may lie elsewhere.
    pub(crate) fn all(&self, one: &Rc<Analysis>) -> Vec<Rc<Analysis>> {
        let mut everything = self.everything();
        everything.retain(|analysis| analysis.source.path != one.source.path);
        everything.push(Rc::clone(one));
        everything
    }

    pub(crate) fn names<'a>(&self, analysis: &'a Analysis) -> FileNames<'a> {
        let references = self.references(analysis);
        let files = |library: &Library| -> BTreeMap<String, PathBuf> {
            library.charts.iter().map(|(name, chart)| (name.clone(), chart.source.path.clone())).collect()
        };
        let charts = match &analysis.library {
            Some(library) => files(library),
            None => self.tested(analysis).as_ref().map_or_else(BTreeMap::new, files),
        };
        FileNames { references, charts }
    }

    fn locations(&self, references: &[NameReference]) -> Vec<Location> {
        let mut found = Vec::new();
        let mut seen = BTreeSet::new();
        let mut on_disk: Option<(&Path, Lines)> = None;
        for (reference, span) in self.present(references) {
            let (path, Some(span)) = (reference.source.path.as_path(), span) else { continue };
            if !seen.insert((path, span.start, span.end)) {
                continue;
            }
            if let Some(document) = self.document(path) {
                let range = document.lines.range(&document.source.text, span);
                found.push(Location::new(document.uri.clone(), range));
            } else if let Some(uri) = uri::of(path) {
                let text = &reference.source.text;
                let (_, lines) = match on_disk.take() {
                    Some(last) if last.0 == path => on_disk.insert(last),
                    _ => on_disk.insert((path, Lines::of(text))),
                };
                found.push(Location::new(uri, lines.range(text, span)));
            }
        }
        found
    }

    /// Where references are in the present texts of their files: none where that was changed.
    pub(crate) fn present<'r>(
        &self,
        references: &'r [NameReference],
    ) -> Vec<(&'r NameReference, Option<Span>)> {
        // Texts are compared once for all references to one.
        let mut last: Option<(&Arc<Source>, Option<Shift>)> = None;
        let mut place = |reference: &'r NameReference| {
            let shift = match last {
                Some((source, shift)) if Arc::ptr_eq(source, &reference.source) => shift,
                _ => self.document(&reference.source.path).and_then(|document| {
                    let (then, now) = (&reference.source.text, &document.source.text);
                    (then != now).then(|| Shift::between(then, now))
                }),
            };
            last = Some((&reference.source, shift));
            (reference, shift.map_or(Some(reference.span), |shift| shift.span(reference.span)))
        };
        references.iter().map(&mut place).collect()
    }
}

impl FileNames<'_> {
    fn reaches(&self, files: &BTreeSet<&Path>) -> bool {
        self.charts.values().any(|file| files.contains(file.as_path()))
    }
}

/// The files that a symbol is used in, from one library to the next: an event is one only where charts use each other.
fn connected<'n>(
    own: &'n FileNames<'n>,
    all: &'n [FileNames<'n>],
    symbols: &BTreeSet<Symbol>,
) -> BTreeSet<&'n Path> {
    let using = |names: &'n FileNames<'n>| {
        let uses = names.references.iter().filter(|r| symbols.contains(&r.symbol));
        uses.map(|r| r.source.path.as_path()).collect::<BTreeSet<&Path>>()
    };
    let mut files = using(own);
    files.extend(own.charts.iter().filter_map(|(chart, file)| {
        symbols.iter().any(|s| s.chart() == Some(chart)).then_some(file.as_path())
    }));
    let libraries: Vec<BTreeSet<&Path>> = all.iter().map(using).collect();
    loop {
        let before = files.len();
        for library in &libraries {
            if library.iter().any(|file| files.contains(file)) {
                files.extend(library);
            }
        }
        if files.len() == before {
            return files;
        }
    }
}
