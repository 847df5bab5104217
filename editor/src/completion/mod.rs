//! What may be written at a place: keys here, `values`, `expressions`.

mod expressions;
mod values;

use std::path::Path;

use armarium_runtime::chart::OutlineKind;
use armarium_runtime::skill::Parameter;
use armarium_source::{Source, Span};
use lsp_types::{
    CompletionItem, CompletionItemKind as Icon, CompletionTextEdit, Documentation, InsertTextFormat,
    MarkupContent, MarkupKind, Position, TextEdit, Uri,
};

use crate::cursor::{CursorPlace, PathStep, TextCursor};
use crate::kind::FileKind;
use crate::schemas::Forms;
use crate::scope::{StateScope, shown};
use crate::uri;
use crate::workspace::{Analysis, Document, Workspace};

/// Most proposals; a chart may have more states.
const MAX_ITEMS: usize = 2000;

/// Something that may be written.
struct Proposal {
    label: String,
    icon: Icon,
    detail: String,
    doc: String,
    insert: String,
    snippet: bool,
    /// What is listed first.
    rank: u8,
}

impl Proposal {
    fn new(label: impl Into<String>, icon: Icon) -> Self {
        let label = label.into();
        let insert = label.clone();
        Self { label, icon, detail: String::new(), doc: String::new(), insert, snippet: false, rank: 5 }
    }

    fn detail(self, detail: impl Into<String>) -> Self {
        Self { detail: detail.into(), ..self }
    }

    fn doc(self, doc: impl Into<String>) -> Self {
        Self { doc: doc.into(), ..self }
    }

    fn insert(self, insert: impl Into<String>) -> Self {
        Self { insert: insert.into(), ..self }
    }

    fn snippet(self, insert: impl Into<String>) -> Self {
        Self { insert: insert.into(), snippet: true, ..self }
    }

    fn rank(self, rank: u8) -> Self {
        Self { rank, ..self }
    }
}

impl Workspace {
    /// What may be written at a place of an open document; with places to fill in where the client knows such `snippets`.
    pub fn completion(&mut self, uri: &Uri, position: Position, snippets: bool) -> Vec<CompletionItem> {
        let path = uri::path(uri);
        let readable = self.readable(&path).map(|(analysis, _)| analysis);
        let Some(document) = self.document(&path) else { return Vec::new() };
        let source = &document.source;
        let offset = document.lines.offset(&source.text, position);
        let Some(cursor) = TextCursor::at(source, offset) else { return Vec::new() };
        // A file that does not say yet what it is begins like a chart, or with the key of another kind.
        let kind = document.kind.unwrap_or(FileKind::Chart);
        let nothing_else = cursor.path.is_empty() && cursor.siblings(source).is_empty();
        if document.kind.is_none() && !(nothing_else && cursor.place == CursorPlace::Key) {
            return Vec::new();
        }
        let completing = Completing {
            workspace: self,
            path: &path,
            document,
            kind,
            forms: self.schemas.at(kind, &cursor.path),
            readable: readable.as_deref(),
            source,
            offset,
            snippets,
        };
        completing.at(&cursor)
    }
}

struct Completing<'w> {
    workspace: &'w Workspace,
    path: &'w Path,
    document: &'w Document,
    kind: FileKind,
    forms: Forms<'w>,
    readable: Option<&'w Analysis>,
    source: &'w Source,
    offset: usize,
    snippets: bool,
}

impl Completing<'_> {
    fn at(&self, cursor: &TextCursor) -> Vec<CompletionItem> {
        let (proposals, span) = match cursor.place {
            CursorPlace::Key => {
                let mut proposals = self.keys(cursor);
                // An item of a list may be a value, too.
                if cursor.path.last() == Some(&PathStep::Item) {
                    proposals.extend(self.values(cursor).0);
                }
                (proposals, self.key_span(cursor))
            }
            CursorPlace::Value => self.values(cursor),
        };
        proposals.into_iter().take(MAX_ITEMS).map(|proposal| self.item(proposal, span)).collect()
    }

    /// The key that is being written, with a dot in it.
    fn key_span(&self, cursor: &TextCursor) -> Span {
        let text = &self.source.text;
        let part = |c: char| c.is_alphanumeric() || matches!(c, '_' | '.' | '-');
        let before =
            text[..self.offset].chars().rev().take_while(|c| part(*c)).map(char::len_utf8).sum::<usize>();
        Span { start: (self.offset - before).max(cursor.before.start.min(self.offset)), end: cursor.word.end }
    }

    fn item(&self, proposal: Proposal, span: Span) -> CompletionItem {
        let range = self.document.lines.range(&self.source.text, span);
        let doc = MarkupContent { kind: MarkupKind::Markdown, value: proposal.doc };
        let written = proposal.insert.split(['\n', ':']).next().unwrap_or("").trim_matches('"').to_owned();
        CompletionItem {
            filter_text: (!proposal.label.starts_with(&written)).then_some(written),
            sort_text: Some(format!("{}{}", proposal.rank, proposal.label)),
            label: proposal.label,
            kind: Some(proposal.icon),
            detail: (!proposal.detail.is_empty()).then_some(proposal.detail),
            documentation: (!doc.value.is_empty()).then_some(Documentation::MarkupContent(doc)),
            insert_text_format: proposal.snippet.then_some(InsertTextFormat::SNIPPET),
            text_edit: Some(CompletionTextEdit::Edit(TextEdit::new(range, proposal.insert))),
            ..CompletionItem::default()
        }
    }

    /// What the chart is that the document is, or that it tests, seen from the state that the place is in.
    fn scoped<T>(&self, cursor: &TextCursor, work: impl FnOnce(&StateScope<'_>) -> T) -> Option<T> {
        let analysis = self.readable?;
        let tested;
        let (library, outline);
        if self.kind == FileKind::Test {
            tested = self.workspace.tested(analysis)?;
            let chart = tested.charts.get(&tested.root)?;
            let outline = armarium_runtime::chart::Outline::of(chart);
            let registry = &self.workspace.catalog.registry;
            return Some(work(&StateScope {
                library: &tested,
                registry,
                chart,
                outline: &outline,
                state: 0,
            }));
        }
        (library, outline) = (analysis.library.as_ref()?, analysis.outline()?);
        let mut state = 0;
        for name in cursor.states() {
            let children = &outline.states[state].children;
            // A state that is being written is not there yet: what is around it is.
            let Some(child) = children.iter().find(|child| outline.states[**child].name == name) else {
                break;
            };
            state = *child;
        }
        let registry = &self.workspace.catalog.registry;
        Some(work(&StateScope { library, registry, chart: analysis.chart()?, outline, state }))
    }

    // Keys.

    fn keys(&self, cursor: &TextCursor) -> Vec<Proposal> {
        if self.document.kind.is_none() {
            let first = |(kind, key): (FileKind, &'static str)| {
                Proposal::new(key, Icon::FILE).detail(kind.called()).insert(format!("{key}: "))
            };
            return FileKind::ALL.into_iter().map(first).collect();
        }
        let present = cursor.siblings(self.source);
        let colon = self.source.text[cursor.word.end..].trim_start_matches(' ').starts_with(':');
        let key = |name: &str| if colon { name.to_owned() } else { format!("{name}: ") };
        let mut proposals: Vec<Proposal> = self
            .forms
            .keys()
            .into_iter()
            .filter(|form| !present.contains(&form.name))
            .map(|form| {
                let rank = if form.required { 1 } else { 3 };
                Proposal::new(form.name, Icon::PROPERTY).doc(form.doc()).insert(key(form.name)).rank(rank)
            })
            .collect();
        proposals.extend(
            self.names_as_keys(cursor).into_iter().filter(|p| !present.contains(&p.label.as_str())).map(
                |proposal| match proposal.snippet || colon {
                    true => proposal,
                    false => {
                        let insert = key(&proposal.insert);
                        proposal.insert(insert)
                    }
                },
            ),
        );
        proposals
    }

    /// Keys that are names: of events, inputs, variables, skills.
    fn names_as_keys(&self, cursor: &TextCursor) -> Vec<Proposal> {
        let under = match cursor.path.last() {
            Some(PathStep::Key(key)) => key.as_str(),
            _ => return Vec::new(),
        };
        let input = |parameter: &Parameter| {
            Proposal::new(&parameter.name, Icon::FIELD)
                .detail(shown(parameter))
                .doc(&parameter.description)
                .rank(if parameter.default.is_none() { 0 } else { 2 })
        };
        let found = self.scoped(cursor, |scope| match (self.kind, under) {
            (FileKind::Chart, "transitions") => self.answers(scope),
            (FileKind::Chart, "with") => {
                let given: Vec<&Parameter> =
                    self.entered(cursor, scope).iter().flat_map(|s| scope.inputs(*s)).collect();
                given.into_iter().map(input).collect()
            }
            (FileKind::Chart, "assign") => {
                let of = |section: &str, parameters: &[Parameter]| -> Vec<Proposal> {
                    let one = |p: &Parameter| {
                        Proposal::new(format!("{section}.{}", p.name), Icon::VARIABLE)
                            .detail(shown(p))
                            .doc(&p.description)
                    };
                    parameters.iter().map(one).collect()
                };
                let sections = [of("locals", &scope.chart.locals), of("outputs", &scope.chart.outputs)];
                sections.into_iter().flatten().collect()
            }
            (FileKind::Test, "given") => scope.chart.inputs.iter().map(input).collect(),
            (FileKind::Test, "locals") => scope.chart.locals.iter().map(input).collect(),
            (FileKind::Test, "outputs") => scope.chart.outputs.iter().map(input).collect(),
            (FileKind::Test, "skills") => {
                let skills = scope.library.charts.values().flat_map(|chart| {
                    armarium_runtime::chart::Outline::of(chart).states.into_iter().filter_map(|state| {
                        match state.kind {
                            OutlineKind::Skill(name) | OutlineKind::Remote(name) => Some(name),
                            _ => None,
                        }
                    })
                });
                let skills: std::collections::BTreeSet<String> = skills.collect();
                skills.into_iter().map(|name| self.skill(&name)).collect()
            }
            _ => Vec::new(),
        });
        found.unwrap_or_default()
    }

    /// The states whose inputs a `with` gives: that of a transition's target, or of the state itself.
    fn entered(&self, cursor: &TextCursor, scope: &StateScope<'_>) -> Vec<usize> {
        let layout = self.source.layout();
        let target = cursor.entry.and_then(|with| layout.entries[with].parent).and_then(|transition| {
            let at = layout.child(&self.source.text, Some(transition), "target")?;
            let entry = &layout.entries[at];
            self.source.text.get(entry.value?..entry.end)
        });
        match target {
            Some(name) => {
                scope.outline.find(scope.state, name.trim_matches(['"', '\''])).into_iter().collect()
            }
            None => vec![scope.state],
        }
    }

    /// The events that a state may answer: how it ends first, and of those what it does not answer yet.
    fn answers(&self, scope: &StateScope<'_>) -> Vec<Proposal> {
        let outcome = |name: String| {
            let icon = Icon::EVENT;
            Proposal::new(name, icon).detail("how this state can end").rank(0)
        };
        let mut proposals: Vec<Proposal> = scope.outcomes(scope.state).into_iter().map(outcome).collect();
        let below = scope.outline.descendants(scope.state).flat_map(|state| {
            let names = scope.outcomes(state);
            let from = scope.outline.path(state);
            names.into_iter().filter(|name| name != "success").map(move |name| (name, from.clone()))
        });
        let declared = self.events(scope).into_iter();
        for (name, from) in declared.chain(below).take(MAX_ITEMS) {
            if !proposals.iter().any(|p| p.label == name) {
                proposals.push(Proposal::new(name, Icon::EVENT).detail(from).rank(2));
            }
        }
        proposals
    }

    /// Events that charts declare and skills raise, each with where it comes from.
    fn events(&self, scope: &StateScope<'_>) -> Vec<(String, String)> {
        let mut events: Vec<(String, String)> = Vec::new();
        for chart in scope.library.charts.values() {
            events.extend(
                chart.events().map(|(name, _)| (name.to_owned(), format!("declared by {}", chart.name))),
            );
        }
        for state in 0..scope.outline.states.len() {
            let names = scope.manifest(state).map_or(&[][..], |manifest| &manifest.events);
            events.extend(
                names.iter().map(|name| (name.clone(), format!("raised by {}", scope.outline.path(state)))),
            );
        }
        events.sort();
        events.dedup_by(|a, b| a.0 == b.0);
        events
    }
}

/// A value that an input takes, as it is written; to be replaced by a person.
pub(crate) fn placeholder(input: &Parameter) -> String {
    input.example().unwrap_or_else(|| format!("\"${{{}}}\"", input.name))
}

/// A text inside of a snippet.
fn snippet_text(text: &str) -> String {
    text.replace('\\', "\\\\").replace('$', "\\$").replace('}', "\\}")
}
