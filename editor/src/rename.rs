//! Renaming with all references. It is refused where the name is not ours, cannot be, or would come to stand for something
//! else: the files are read again with the new name, and every other name must still stand for what it did.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use armarium_runtime::chart::{HeadSection, NameReference, SkillPart, Symbol, is_name};
use armarium_source::{Edit, Source, applied};
use lsp_types::{
    DocumentChanges, OneOf, OptionalVersionedTextDocumentIdentifier, Position, Range, TextDocumentEdit,
    TextEdit, Uri, WorkspaceEdit,
};

use crate::text::Lines;
use crate::uri;
use crate::workspace::{Analysis, Workspace};

/// Why a name is not changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RenameError {
    /// Nothing that has a name stands at the place.
    #[error("there is no name here")]
    Nothing,
    /// The name belongs to the program or the language.
    #[error("`{name}` is {what}: its name is not given in a file")]
    NotOurs {
        /// The name.
        name: String,
        /// What it is.
        what: &'static str,
    },
    /// The new name is not allowed.
    #[error("`{name}` {why}")]
    Invalid {
        /// The new name.
        name: String,
        /// Why not.
        why: &'static str,
    },
    /// The new name has a meaning already where the old one is used.
    #[error("`{name}` stands for something else already: {place}")]
    Taken {
        /// The new name.
        name: String,
        /// Where that shows.
        place: String,
    },
    /// The name is written in a way in which it cannot be changed.
    #[error("the name is written with escapes or over several lines: {place}")]
    Unclear {
        /// Where.
        place: String,
    },
    /// A file cannot be read as it is now.
    #[error("{place} cannot be read: put it right first")]
    Unreadable {
        /// The file.
        place: String,
    },
}

/// The edits of a rename, by file.
type Edits = BTreeMap<PathBuf, Vec<Edit>>;

impl Workspace {
    /// The name at a place, if it can be changed.
    ///
    /// # Errors
    /// [`RenameError`] when there is none, or it is not given in a file.
    pub fn prepare_rename(&mut self, uri: &Uri, position: Position) -> Result<Range, RenameError> {
        let (span, symbols) = self.symbols_at(&uri::path(uri), position).ok_or(RenameError::Nothing)?;
        symbols.iter().try_for_each(ours)?;
        let document = self.document(&uri::path(uri)).ok_or(RenameError::Nothing)?;
        Ok(document.lines.range(&document.source.text, span))
    }

    /// The edits that give what stands at a place a new name, wherever it is used.
    ///
    /// # Errors
    /// [`RenameError`] with the reason why it is not done; then nothing is to be changed.
    pub fn rename(
        &mut self,
        uri: &Uri,
        position: Position,
        name: &str,
    ) -> Result<WorkspaceEdit, RenameError> {
        let path = uri::path(uri);
        let (_, symbols) = self.symbols_at(&path, position).ok_or(RenameError::Nothing)?;
        let (symbols, uses) = self.together(&path, symbols.into_iter().collect())?;
        if let Some(why) = symbols.iter().find_map(|symbol| unfit(symbol, name)) {
            return Err(RenameError::Invalid { name: name.to_owned(), why });
        }
        let mut edits: Edits = BTreeMap::new();
        for (reference, span) in self.present(&uses) {
            let place = || reference.source.place(reference.span.start);
            if !reference.exact {
                // Test cases name a chart by its file, which keeps its name.
                if matches!(reference.symbol, Symbol::Chart { .. }) {
                    continue;
                }
                return Err(RenameError::Unclear { place: place() });
            }
            if span != Some(reference.span) {
                return Err(RenameError::Unreadable { place: place() });
            }
            let edit = Edit { span: reference.span, text: name.to_owned() };
            edits.entry(reference.source.path.clone()).or_default().push(edit);
        }
        self.still_the_same(&path, &symbols, name, &edits)?;
        Ok(self.for_client(edits))
    }

    /// All symbols that share a place with these, and their uses: one text cannot become two.
    fn together(
        &mut self,
        path: &Path,
        mut symbols: BTreeSet<Symbol>,
    ) -> Result<(BTreeSet<Symbol>, Vec<NameReference>), RenameError> {
        loop {
            symbols.iter().try_for_each(ours)?;
            let uses = self.uses(path, &symbols);
            let places: BTreeSet<(&Path, usize)> =
                uses.iter().map(|r| (r.source.path.as_path(), r.span.start)).collect();
            let (analysis, _) = self.readable(path).ok_or(RenameError::Nothing)?;
            let everything = self.all(&analysis);
            let mut more = BTreeSet::new();
            for analysis in &everything {
                let shared = self.references(analysis).iter().filter(|r| {
                    places.contains(&(r.source.path.as_path(), r.span.start)) && !symbols.contains(&r.symbol)
                });
                more.extend(shared.map(|r| r.symbol.clone()));
            }
            if more.is_empty() {
                return Ok((symbols, uses));
            }
            symbols.extend(more);
        }
    }

    /// Reads every file with the new name: all names must stand for what they stood for, and nothing new be wrong.
    fn still_the_same(
        &mut self,
        path: &Path,
        symbols: &BTreeSet<Symbol>,
        name: &str,
        edits: &Edits,
    ) -> Result<(), RenameError> {
        let (analysis, _) = self.readable(path).ok_or(RenameError::Nothing)?;
        let after = self.with(edits);
        for before in self.all(&analysis) {
            let uses = self.references(&before);
            if !uses.iter().any(|r| edits.contains_key(&r.source.path)) {
                continue;
            }
            let file = &before.source.path;
            let now = after.reopened(&before);
            let again = after.references(&now);
            let errors = |a: &Analysis| a.findings.iter().filter(|f| f.is_error()).count();
            // Paths begin at the chart that is read: what is renamed has another one where it is used.
            let named: BTreeSet<&Symbol> = uses.iter().map(|r| &r.symbol).collect();
            let here: BTreeSet<&Symbol> = symbols.iter().filter(|symbol| named.contains(symbol)).collect();
            let expected = uses.iter().map(|r| {
                let at = moved(edits, &r.source.path, r.span.start);
                (&*r.source, at, renamed(&r.symbol, &here, name))
            });
            let found = again.iter().map(|r| (&*r.source, r.span.start, r.symbol.clone()));
            let (expected, found) = (ordered(expected), ordered(found));
            let differs = |(a, b): &(&Occurrence<'_>, &Occurrence<'_>)| order(a, b).is_ne();
            let other = expected
                .iter()
                .zip(&found)
                .find(differs)
                .map(|(expected, found)| if order(expected, found).is_lt() { expected } else { found })
                .or_else(|| expected.get(found.len()))
                .or_else(|| found.get(expected.len()));
            // The other thing of that name: in this file and of the same kind if there is one.
            let others = || uses.iter().filter(|r| r.definition && r.symbol.name() == name);
            let kinds: Vec<_> = symbols.iter().map(std::mem::discriminant).collect();
            let elsewhere = |r: &&NameReference| {
                (r.source.path != path, !kinds.contains(&std::mem::discriminant(&r.symbol)))
            };
            let declared = others().min_by_key(elsewhere).map(|r| r.source.place(r.span.start));
            let taken = |place: String| RenameError::Taken {
                name: name.to_owned(),
                place: declared.clone().unwrap_or(place),
            };
            if let Some((source, at, _)) = other {
                let renamed = again.iter().find(|r| r.source.path == source.path);
                return Err(taken(renamed.map_or(*source, |r| &*r.source).place(*at)));
            }
            if errors(&now) > errors(&before) {
                let new = now
                    .findings
                    .iter()
                    .find(|f| f.is_error() && !before.findings.iter().any(|b| b.message == f.message));
                return Err(taken(new.map_or_else(|| file.display().to_string(), ToString::to_string)));
            }
        }
        Ok(())
    }

    /// A workspace in which the edits are made.
    fn with(&self, edits: &Edits) -> Self {
        let mut copy = Self::new(self.catalog.clone(), &self.folders);
        for (_, document) in self.documents() {
            copy.open(document.uri.clone(), document.version, document.source.text.clone());
        }
        for (path, edits) in edits {
            let text = self.text_of(path);
            if let (Some(text), Some(uri)) = (text, uri::of(path)) {
                copy.open(uri, 0, applied(&text, edits));
            }
        }
        copy
    }

    fn text_of(&self, path: &Path) -> Option<String> {
        match self.document(path) {
            Some(document) => Some(document.source.text.clone()),
            None => Source::read(path).ok().map(|source| source.text.clone()),
        }
    }

    fn for_client(&self, edits: Edits) -> WorkspaceEdit {
        let one = |(path, edits): (PathBuf, Vec<Edit>)| {
            let text = self.text_of(&path)?;
            let lines = Lines::of(&text);
            let document = self.document(&path);
            let uri = document.map(|document| document.uri.clone()).or_else(|| uri::of(&path))?;
            let version = document.map(|document| document.version);
            let edit = |edit: Edit| OneOf::Left(TextEdit::new(lines.range(&text, edit.span), edit.text));
            let text_document = OptionalVersionedTextDocumentIdentifier { uri, version };
            Some(TextDocumentEdit { text_document, edits: edits.into_iter().map(edit).collect() })
        };
        let changes = edits.into_iter().filter_map(one).collect();
        WorkspaceEdit { document_changes: Some(DocumentChanges::Edits(changes)), ..WorkspaceEdit::default() }
    }
}

/// A file, a byte of it, and what the name there stands for.
type Occurrence<'s> = (&'s Source, usize, Symbol);

fn order(a: &Occurrence<'_>, b: &Occurrence<'_>) -> Ordering {
    a.0.by_path(b.0).then_with(|| (a.1, &a.2).cmp(&(b.1, &b.2)))
}

/// What stands where, in the order of the files, each once.
fn ordered<'s>(places: impl Iterator<Item = Occurrence<'s>>) -> Vec<Occurrence<'s>> {
    let mut places: Vec<Occurrence<'s>> = places.collect();
    places.sort_by(order);
    places.dedup_by(|a, b| order(a, b).is_eq());
    places
}

/// Where a byte of a file is when the edits are made, which are in the order of the text and each replace the same name.
fn moved(edits: &Edits, path: &Path, at: usize) -> usize {
    let Some(edits) = edits.get(path) else { return at };
    let before = edits.partition_point(|edit| edit.span.end <= at);
    edits
        .first()
        .map_or(at, |edit| at + before * edit.text.len() - before * (edit.span.end - edit.span.start))
}

/// Whether a name is given in files.
fn ours(symbol: &Symbol) -> Result<(), RenameError> {
    let what = match symbol {
        Symbol::Skill { .. } => "a skill",
        Symbol::OfSkill { part: SkillPart::Input, .. } => "an input of a skill",
        Symbol::OfSkill { part: SkillPart::Output, .. } => "an output of a skill",
        Symbol::OfSkill { part: SkillPart::Outcome, .. } => "an outcome of a skill",
        Symbol::OfSkill { part: SkillPart::Event, .. } => "an event of a skill",
        Symbol::Channel { .. } => "a channel",
        Symbol::Attribute { .. } => "an attribute in memory",
        Symbol::Function { .. } => "a function",
        Symbol::Outcome { name, .. } if name == "success" || name == "failure" => "a word of the language",
        _ => return Ok(()),
    };
    Err(RenameError::NotOurs { name: symbol.name().to_owned(), what })
}

/// Why a text cannot be the name of a thing.
fn unfit(symbol: &Symbol, name: &str) -> Option<&'static str> {
    let word = |part: &str, more: &str| {
        !part.is_empty() && part.chars().all(|c| c.is_alphanumeric() || c == '_' || more.contains(c))
    };
    match symbol {
        Symbol::Event { .. } | Symbol::Outcome { .. } if matches!(name, "success" | "failure") => {
            Some("is an outcome that the language gives")
        }
        Symbol::Event { .. } | Symbol::Outcome { .. } => (!name.split('.').all(|part| word(part, "-")))
            .then_some("is not the name of an event: letters, digits, `_` and `-`, in parts joined by dots"),
        _ if is_name(name) => {
            let types = matches!(symbol, Symbol::Declared { section: HeadSection::Types, .. });
            let known = types && armarium_values::Type::parse(name, &|_| None).is_some();
            known.then_some("is a type that the language gives")
        }
        _ if word(name, "") && !name.starts_with(|c: char| c.is_ascii_digit()) => {
            Some("is a word of the language")
        }
        _ => Some("is not a name: letters, digits and `_`, no digit first"),
    }
}

/// The symbol under its new name, or inside of what has one.
fn renamed(symbol: &Symbol, symbols: &BTreeSet<&Symbol>, name: &str) -> Symbol {
    let mut new = symbol.clone();
    for old in symbols {
        match (*old, &mut new) {
            (
                Symbol::Chart { chart: old },
                Symbol::Chart { chart }
                | Symbol::State { chart, .. }
                | Symbol::Declared { chart, .. }
                | Symbol::Watch { chart, .. }
                | Symbol::Outcome { chart, .. },
            ) if chart == old => name.clone_into(chart),
            (
                Symbol::State { chart: of, path: old },
                Symbol::State { chart, path }
                | Symbol::Watch { chart, state: path, .. }
                | Symbol::Outcome { chart, state: path, .. },
            ) if chart == of && path == old
                // States of a chart inside have another chart, but the path goes on.
                || path.strip_prefix(old.as_str()).is_some_and(|rest| rest.starts_with('.')) =>
            {
                let around = old.rfind('.').map_or("", |dot| &old[..=dot]);
                *path = format!("{around}{name}{}", &path[old.len()..]);
            }
            (
                old,
                Symbol::Declared { name: own, .. }
                | Symbol::Event { name: own }
                | Symbol::Watch { name: own, .. }
                | Symbol::Outcome { name: own, .. },
            ) if old == symbol => name.clone_into(own),
            _ => {}
        }
    }
    new
}
