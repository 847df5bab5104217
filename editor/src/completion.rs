//! What may be written at a place.

use std::path::Path;

use armarium_runtime::chart::OutlineKind;
use armarium_runtime::skill::{Parameter, SkillManifest};
use armarium_source::{Source, Span};
use armarium_values::{Fit, Type, Unit, expr};
use lsp_types::{
    CompletionItem, CompletionItemKind as Icon, CompletionTextEdit, Documentation, InsertTextFormat,
    MarkupContent, MarkupKind, Position, TextEdit, Uri,
};

use crate::cursor::{Cursor, Place, Step};
use crate::kind::FileKind;
use crate::schemas::Forms;
use crate::scope::{Scope, shown};
use crate::symbols::describe;
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
        let Some(cursor) = Cursor::at(source, offset) else { return Vec::new() };
        // A file that does not say yet what it is begins like a chart, or with the key of another kind.
        let kind = document.kind.unwrap_or(FileKind::Chart);
        let nothing_else = cursor.path.is_empty() && cursor.siblings(source).is_empty();
        if document.kind.is_none() && !(nothing_else && cursor.place == Place::Key) {
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
    fn at(&self, cursor: &Cursor) -> Vec<CompletionItem> {
        let (proposals, span) = match cursor.place {
            Place::Key => {
                let mut proposals = self.keys(cursor);
                // An item of a list may be a value, too.
                if cursor.path.last() == Some(&Step::Item) {
                    proposals.extend(self.values(cursor).0);
                }
                (proposals, self.key_span(cursor))
            }
            Place::Value => self.values(cursor),
        };
        proposals.into_iter().take(MAX_ITEMS).map(|proposal| self.item(proposal, span)).collect()
    }

    /// The key that is being written, with a dot in it.
    fn key_span(&self, cursor: &Cursor) -> Span {
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
    fn scoped<T>(&self, cursor: &Cursor, work: impl FnOnce(&Scope<'_>) -> T) -> Option<T> {
        let analysis = self.readable?;
        let tested;
        let (library, outline);
        if self.kind == FileKind::Test {
            tested = self.workspace.tested(analysis)?;
            let chart = tested.charts.get(&tested.root)?;
            let outline = armarium_runtime::chart::Outline::of(chart);
            let registry = &self.workspace.catalog.registry;
            return Some(work(&Scope { library: &tested, registry, chart, outline: &outline, state: 0 }));
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
        Some(work(&Scope { library, registry, chart: analysis.chart()?, outline, state }))
    }

    // Keys.

    fn keys(&self, cursor: &Cursor) -> Vec<Proposal> {
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
    fn names_as_keys(&self, cursor: &Cursor) -> Vec<Proposal> {
        let under = match cursor.path.last() {
            Some(Step::Key(key)) => key.as_str(),
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
    fn entered(&self, cursor: &Cursor, scope: &Scope<'_>) -> Vec<usize> {
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
    fn answers(&self, scope: &Scope<'_>) -> Vec<Proposal> {
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
    fn events(&self, scope: &Scope<'_>) -> Vec<(String, String)> {
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

    // Values.

    fn values(&self, cursor: &Cursor) -> (Vec<Proposal>, Span) {
        let text = &self.source.text;
        let before = &text[cursor.before.start..cursor.before.end];
        let condition = self.forms.is("condition");
        if let Some(written) = expression_before(before, condition) {
            return self.expression(cursor, written);
        }
        let quoted = before.trim_start().starts_with(['"', '\'']);
        let dotted = |c: char| c.is_alphanumeric() || matches!(c, '_' | '.' | '/' | '-' | '<');
        let start =
            self.offset - before.chars().rev().take_while(|c| dotted(*c)).map(char::len_utf8).sum::<usize>();
        let span = Span { start, end: cursor.word.end };
        let mut proposals = self.domain(cursor);
        proposals.extend(
            self.forms.words().into_iter().map(|(word, doc)| Proposal::new(word, Icon::ENUM_MEMBER).doc(doc)),
        );
        proposals.extend(self.given(cursor, quoted));
        let mut seen = std::collections::BTreeSet::new();
        proposals.retain(|proposal| seen.insert(proposal.label.clone()));
        (proposals, span)
    }

    /// Names that a value may be, by what the form says that it is.
    fn domain(&self, cursor: &Cursor) -> Vec<Proposal> {
        let forms = &self.forms;
        let mut proposals = Vec::new();
        if forms.is("skill") {
            let skills = self.workspace.catalog.registry.manifests();
            proposals.extend(skills.map(|manifest| self.skill_state(cursor, manifest)));
        }
        if forms.is("chart") || self.kind == FileKind::Test && cursor.key() == Some("test") {
            let charts = self.workspace.charts(self.path);
            proposals.extend(charts.into_iter().map(|(name, files)| {
                let file = files
                    .first()
                    .and_then(|f| f.file_name())
                    .map_or_else(String::new, |f| f.to_string_lossy().into());
                let insert = if self.kind == FileKind::Test { file.clone() } else { name.clone() };
                Proposal::new(name, Icon::CLASS).detail(file).insert(insert)
            }));
        }
        if forms.is("unit") {
            proposals.extend(Unit::symbols().map(|symbol| Proposal::new(symbol, Icon::UNIT)));
        }
        if forms.is("type") {
            let known = Type::NAMES.iter().map(|name| Proposal::new(*name, Icon::CLASS));
            proposals.extend(known);
            let declared =
                self.scoped(cursor, |scope| scope.chart.types().map(str::to_owned).collect::<Vec<_>>());
            proposals
                .extend(declared.into_iter().flatten().map(|name| Proposal::new(name, Icon::ENUM).rank(1)));
        }
        let scoped = self.scoped(cursor, |scope| {
            let mut proposals = Vec::new();
            if forms.is("targets") || forms.is("transition_list") || forms.is("entry") {
                proposals.extend(self.targets(cursor, scope));
            }
            if forms.is("event") || self.kind == FileKind::Test && cursor.key() == Some("event") {
                proposals.extend(
                    self.events(scope)
                        .into_iter()
                        .map(|(name, from)| Proposal::new(name, Icon::EVENT).detail(from)),
                );
            }
            if forms.is("outcome") {
                proposals.extend(["success", "failure"].map(|name| Proposal::new(name, Icon::EVENT)));
            }
            if self.kind == FileKind::Test {
                proposals.extend(self.in_test(cursor, scope));
            }
            proposals
        });
        proposals.extend(scoped.unwrap_or_default());
        proposals
    }

    fn skill(&self, name: &str) -> Proposal {
        let manifest = self.workspace.catalog.registry.manifest(name);
        let doc = manifest.map_or_else(String::new, |manifest| crate::hover::skill(manifest));
        Proposal::new(name, Icon::FUNCTION).doc(doc)
    }

    /// A skill, with places for the inputs that it must have.
    fn skill_state(&self, cursor: &Cursor, manifest: &SkillManifest) -> Proposal {
        let proposal = self.skill(&manifest.name);
        let required: Vec<&Parameter> =
            manifest.inputs.iter().filter(|input| input.default.is_none()).collect();
        let layout = self.source.layout();
        let state = cursor.entry.and_then(|skill| layout.entries[skill].parent);
        let has_with = layout.child(&self.source.text, state, "with").is_some();
        let (Some(skill), false) = (cursor.entry, required.is_empty() || has_with || !self.snippets) else {
            return proposal;
        };
        let places = required.iter().enumerate().map(|(at, input)| {
            format!("{}: ${{{}:{}}}", input.name, at + 1, snippet_text(&placeholder(input)))
        });
        let with = format!("with: {{{}}}", places.collect::<Vec<_>>().join(", "));
        let entry = &layout.entries[skill];
        let join = if entry.flow { ", ".to_owned() } else { format!("\n{}", " ".repeat(entry.column)) };
        proposal.snippet(format!("{}{join}{with}", manifest.name))
    }

    fn targets(&self, cursor: &Cursor, scope: &Scope<'_>) -> Vec<Proposal> {
        // `initial` leads inside, a transition to what can be seen from its state.
        let inside = cursor.path.iter().any(|step| matches!(step, Step::Key(key) if key == "initial"));
        let states = &scope.outline.states;
        let visible = match inside {
            true => states[scope.state].children.iter().map(|c| (*c, states[*c].name.clone())).collect(),
            false => scope.visible(),
        };
        let shown = |(state, name): (usize, String)| {
            Proposal::new(name, Icon::VALUE)
                .detail(describe(&states[state].kind))
                .doc(&states[state].description)
        };
        visible.into_iter().map(shown).collect()
    }

    fn in_test(&self, cursor: &Cursor, scope: &Scope<'_>) -> Vec<Proposal> {
        let states = || {
            let all = scope
                .library
                .charts
                .values()
                .flat_map(|chart| armarium_runtime::chart::Outline::of(chart).states);
            let names: std::collections::BTreeSet<String> = all.map(|state| state.name).collect();
            names.into_iter().map(|name| Proposal::new(name, Icon::VALUE)).collect()
        };
        match cursor.key() {
            Some("active" | "from") => states(),
            Some("channel") => {
                let channels = scope.library.channels(&self.workspace.catalog.channels);
                let shown = |name: &str| channels.get(name).map_or_else(String::new, ToString::to_string);
                channels.names().map(|name| Proposal::new(name, Icon::FIELD).detail(shown(name))).collect()
            }
            Some("outcome") => {
                ["success", "failure", "never"].map(|name| Proposal::new(name, Icon::EVENT)).into()
            }
            _ => Vec::new(),
        }
    }

    /// What may be given to an input: its words, and variables that fit.
    fn given(&self, cursor: &Cursor, quoted: bool) -> Vec<Proposal> {
        let under = |key: &str| cursor.path.iter().any(|step| matches!(step, Step::Key(name) if name == key));
        if self.kind == FileKind::Chart && under("assign") {
            let assigned = self.scoped(cursor, |scope| {
                let (section, name) = cursor.key()?.split_once('.')?;
                let of = match section {
                    "locals" => &scope.chart.locals,
                    _ => &scope.chart.outputs,
                };
                of.iter().find(|variable| variable.name == name).map(|variable| words(Some(&variable.ty)))
            });
            return assigned.flatten().unwrap_or_default();
        }
        if self.kind != FileKind::Chart || !under("with") {
            return Vec::new();
        }
        let with = Cursor {
            entry: cursor.entry.and_then(|e| self.source.layout().entries[e].parent),
            ..cursor.clone()
        };
        let found = self.scoped(cursor, |scope| {
            let states = self.entered(&with, scope);
            let input = states
                .iter()
                .flat_map(|s| scope.inputs(*s))
                .find(|i| Some(i.name.as_str()) == cursor.key())?;
            let registry = &self.workspace.catalog.registry;
            let names = input.names.and_then(|kind| registry.names(kind, self.path));
            let mut proposals = match names {
                Some(names) => words(Some(&Type::Enum(names.into_iter().collect()))),
                None => words(Some(&input.ty)),
            };
            let channels = scope.library.channels(&self.workspace.catalog.channels);
            for (root, ty, _) in scope.roots(&channels, Type::Any) {
                let Type::Record(fields) = ty else { continue };
                let fitting = fields.iter().filter(|(_, ty)| {
                    matches!(input.ty.fit(ty), Fit::Yes) && root != "channels" && root != "event"
                });
                proposals.extend(fitting.map(|(name, ty)| {
                    let text = format!("${{{root}.{name}}}");
                    let insert = if quoted { text.clone() } else { format!("\"{text}\"") };
                    Proposal::new(text, Icon::VARIABLE).detail(ty.to_string()).insert(insert).rank(1)
                }));
            }
            Some(proposals)
        });
        found.flatten().unwrap_or_default()
    }

    // Expressions.

    /// What an expression may go on with; `written` is its text before the place.
    fn expression(&self, cursor: &Cursor, written: &str) -> (Vec<Proposal>, Span) {
        let span = cursor.word;
        let in_quotes = |function: &str| {
            let at = written.rfind(&format!("{function}("))?;
            let inner = written[at + function.len() + 1..].trim_start().strip_prefix(['\'', '"'])?;
            (!inner.contains(['\'', '"'])).then_some(inner)
        };
        let event = self.event_type(cursor);
        let proposals = self.scoped(cursor, |scope| {
            if in_quotes("active").is_some() {
                return self.targets(&Cursor { path: Vec::new(), ..cursor.clone() }, scope);
            }
            let channels = scope.library.channels(&self.workspace.catalog.channels);
            let roots = scope.roots(&channels, event);
            if in_quotes("age").is_some() {
                return channels.names().map(|name| Proposal::new(name, Icon::FIELD)).collect();
            }
            let of_chain = |chain: &[&str]| {
                let (root, fields) = chain.split_first()?;
                let ty = roots.iter().find(|(name, ..)| name == root).map(|(_, ty, _)| ty.clone());
                fields.iter().fold(ty, |ty, part| {
                    ty?.fields().into_iter().find(|(name, _)| name == part).map(|(_, ty)| ty)
                })
            };
            if let Some(compared) = compared_before(written) {
                return words(of_chain(&chain_before(compared)).as_ref());
            }
            let chain = chain_before(written);
            let field = |(name, ty): (&str, Type)| Proposal::new(name, Icon::FIELD).detail(ty.to_string());
            match chain.split_last() {
                Some((_, chain)) if !chain.is_empty() => {
                    of_chain(chain).map_or_else(Vec::new, |ty| ty.fields().into_iter().map(field).collect())
                }
                _ => {
                    let root = |(name, _, doc): (String, Type, String)| {
                        Proposal::new(name, Icon::VARIABLE).detail(doc).rank(1)
                    };
                    let mut all: Vec<Proposal> = roots.into_iter().map(root).collect();
                    all.extend(expr::functions().map(|function| self.function(&function)));
                    all.extend(["true", "false"].map(|word| Proposal::new(word, Icon::KEYWORD)));
                    all
                }
            }
        });
        (proposals.unwrap_or_default(), span)
    }

    fn function(&self, function: &expr::Signature) -> Proposal {
        let proposal =
            Proposal::new(function.name, Icon::FUNCTION).detail(function.form).doc(function.doc).rank(4);
        match self.snippets {
            true => proposal.snippet(format!("{}($1)", function.name)),
            false => proposal,
        }
    }

    /// What comes with the event that the place's transition answers.
    fn event_type(&self, cursor: &Cursor) -> Type {
        let mut path = cursor.path.iter();
        let event = path
            .find(|step| matches!(step, Step::Key(key) if key == "transitions"))
            .and_then(|_| path.next());
        let Some(Step::Key(event)) = event else { return Type::Any };
        let declared = self.scoped(cursor, |scope| {
            let all = scope.library.charts.values().flat_map(|chart| chart.events());
            all.filter(|(name, _)| name == event).find_map(|(_, ty)| ty.cloned())
        });
        declared.flatten().unwrap_or(Type::Any)
    }
}

/// The text of the expression that a value's text ends in, up to there; none where it ends outside of one.
fn expression_before(text: &str, condition: bool) -> Option<&str> {
    if let Some(open) = text.rfind("${").filter(|at| !text[..*at].ends_with('$')) {
        let inner = &text[open + 2..];
        let (mut depth, mut quote) = (0_i32, None);
        for c in inner.chars() {
            match (quote, c) {
                (None, '\'' | '"') => quote = Some(c),
                (Some(open), c) if open == c => quote = None,
                (None, '{') => depth += 1,
                (None, '}') => depth -= 1,
                _ => {}
            }
        }
        return (depth >= 0).then_some(inner);
    }
    condition.then(|| text.trim_start().trim_start_matches(['"']))
}

/// What a text compares with the text in quotes that it ends in: `hand.gesture` of `hand.gesture == 'fi`.
fn compared_before(text: &str) -> Option<&str> {
    let open = text.rfind(['\'', '"'])?;
    // A quote that closes another is the second of its kind.
    let mark = &text[open..=open];
    if text.matches(mark).count().is_multiple_of(2) {
        return None;
    }
    let before = text[..open].trim_end();
    let before = before.strip_suffix("==").or_else(|| before.strip_suffix("!="))?;
    Some(before.trim_end())
}

/// The values of a type that has few, as they are written.
fn words(ty: Option<&Type>) -> Vec<Proposal> {
    let words = match ty {
        Some(Type::Enum(words)) => words.clone(),
        Some(Type::Bool) => vec!["true".into(), "false".into()],
        _ => Vec::new(),
    };
    words.into_iter().map(|word| Proposal::new(word, Icon::ENUM_MEMBER).rank(0)).collect()
}

/// The dotted name that a text ends in, part by part; the last may be empty.
fn chain_before(text: &str) -> Vec<&str> {
    let part = |c: char| c.is_alphanumeric() || matches!(c, '_' | '.');
    let len: usize = text.chars().rev().take_while(|c| part(*c)).map(char::len_utf8).sum();
    text[text.len() - len..].split('.').collect()
}

/// A value that an input takes, as it is written; to be replaced by a person.
pub(crate) fn placeholder(input: &Parameter) -> String {
    input.example().unwrap_or_else(|| format!("\"${{{}}}\"", input.name))
}

/// A text inside of a snippet.
fn snippet_text(text: &str) -> String {
    text.replace('\\', "\\\\").replace('$', "\\$").replace('}', "\\}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_expression_that_is_being_written_is_found() {
        assert_eq!(expression_before("\"${inputs.", false), Some("inputs."));
        assert_eq!(expression_before("\"${a} and ${b + ", false), Some("b + "));
        assert_eq!(expression_before("\"${a}", false), None);
        assert_eq!(expression_before("\"$${a", false), None);
        assert_eq!(expression_before("\"norm(ch", true), Some("norm(ch"));
        assert_eq!(chain_before("1 + channels.wrist.p"), ["channels", "wrist", "p"]);
        assert_eq!(chain_before("f("), [""]);
    }
}
