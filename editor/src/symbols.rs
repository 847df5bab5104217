//! The parts of a document as a tree, what of it can be folded, and where commands stand.

use armarium_runtime::chart::{Outline, OutlineKind};
use armarium_source::{Layout, Source, Span};
use lsp_types::{
    CodeLens, Command, DocumentSymbol, FoldingRange, FoldingRangeKind, Position, SymbolKind, Uri,
};
use serde_json::json;

use crate::kind::FileKind;
use crate::text::Lines;
use crate::uri;
use crate::workspace::Workspace;

impl Workspace {
    /// The states of a chart below its sections; of other files the sections and the named things in them.
    pub fn symbols(&mut self, uri: &Uri) -> Vec<DocumentSymbol> {
        let path = uri::path(uri);
        let readable = self.readable(&path).map(|(analysis, _)| analysis);
        let Some(document) = self.document(&path) else { return Vec::new() };
        let same = readable.as_ref().filter(|analysis| analysis.source.text == document.source.text);
        let outline = same.and_then(|analysis| analysis.outline());
        let parts = Parts {
            source: &document.source,
            layout: document.source.layout(),
            lines: &document.lines,
            outline,
        };
        parts.below(None, 0)
    }

    /// What can be folded: entries over several lines, and runs of comments.
    pub fn folding(&self, uri: &Uri) -> Vec<FoldingRange> {
        let Some(document) = self.document(&uri::path(uri)) else { return Vec::new() };
        let (text, layout) = (&document.source.text, document.source.layout());
        let line = |at: usize| document.lines.position(text, at).line;
        let fold = |start: u32, end: u32, kind: Option<FoldingRangeKind>| {
            let range = FoldingRange { start_line: start, end_line: end, kind, ..FoldingRange::default() };
            (end > start).then_some(range)
        };
        let entries = layout.entries.iter().filter(|entry| !entry.flow);
        let mut folds: Vec<FoldingRange> =
            entries.filter_map(|entry| fold(line(entry.key.start), line(entry.end), None)).collect();
        let mut run: Option<(u32, u32)> = None;
        let alone = |comment: &&Span| {
            let start = text[..comment.start].rfind('\n').map_or(0, |newline| newline + 1);
            text[start..comment.start].trim().is_empty()
        };
        for comment in layout.comments.iter().filter(alone).map(|comment| line(comment.start)) {
            run = match run {
                Some((start, end)) if end + 1 == comment => Some((start, comment)),
                other => {
                    folds.extend(
                        other.and_then(|(start, end)| fold(start, end, Some(FoldingRangeKind::Comment))),
                    );
                    Some((comment, comment))
                }
            };
        }
        folds.extend(run.and_then(|(start, end)| fold(start, end, Some(FoldingRangeKind::Comment))));
        folds.sort_by_key(|fold| (fold.start_line, std::cmp::Reverse(fold.end_line)));
        folds.dedup_by_key(|fold| fold.start_line);
        folds
    }

    /// Commands that the client executes: run, test and draw a chart; play a case.
    pub fn lenses(&mut self, uri: &Uri) -> Vec<CodeLens> {
        let path = uri::path(uri);
        let Some(document) = self.document(&path) else { return Vec::new() };
        let (source, layout) = (&document.source, document.source.layout());
        let lens = |at: usize, title: &str, command: &str, more: Option<&str>| {
            let position = document.lines.position(&source.text, at);
            let mut arguments = vec![json!(uri.as_str())];
            arguments.extend(more.map(|more| json!(more)));
            let command =
                Command { title: title.to_owned(), command: command.to_owned(), arguments: Some(arguments) };
            CodeLens { range: lsp_types::Range::new(position, position), command: Some(command), data: None }
        };
        let top = |key: &str| layout.child(&source.text, None, key).map(|at| layout.entries[at].key.start);
        match document.kind {
            Some(FileKind::Chart) => top("statechart").map_or_else(Vec::new, |at| {
                let mut lenses =
                    vec![lens(at, "Run", "armarium.run", None), lens(at, "Graph", "armarium.graph", None)];
                let cases = path.with_extension("test.yaml");
                if cases.is_file() || self.document(&cases).is_some() {
                    lenses.insert(1, lens(at, "Test", "armarium.test", None));
                }
                lenses
            }),
            Some(FileKind::Test) => {
                let all = top("test").map(|at| lens(at, "Test", "armarium.test", None));
                all.into_iter().collect()
            }
            _ => Vec::new(),
        }
    }

    /// The path of the state that a place of a chart is in; empty at the chart's head.
    pub fn state_at(&mut self, uri: &Uri, position: Position) -> Option<String> {
        let document =
            self.document(&uri::path(uri)).filter(|document| document.kind == Some(FileKind::Chart))?;
        let source = &document.source;
        let offset = document.lines.offset(&source.text, position);
        let cursor = crate::cursor::TextCursor::at(source, offset)?;
        let mut names: Vec<&str> = cursor.states();
        // The name of a state belongs to the state.
        let layout = source.layout();
        let on_name =
            layout.entries.iter().rfind(|e| e.key.start <= offset && offset <= e.key.end && !e.item);
        let of_states = matches!(cursor.key(), Some("states" | "parallel"));
        if let Some(entry) = on_name.filter(|_| of_states) {
            names.extend(layout.at(entry.key.start).map(|at| layout.key(&source.text, at)));
        }
        Some(names.join("."))
    }
}

struct Parts<'p> {
    source: &'p Source,
    layout: &'p Layout,
    lines: &'p Lines,
    outline: Option<&'p Outline>,
}

impl Parts<'_> {
    fn below(&self, of: Option<usize>, depth: usize) -> Vec<DocumentSymbol> {
        // Deeper than states are nested nothing is of interest.
        if depth > 130 {
            return Vec::new();
        }
        self.layout.children(of).filter_map(|at| self.symbol(at, depth)).collect()
    }

    fn symbol(&self, at: usize, depth: usize) -> Option<DocumentSymbol> {
        let entry = &self.layout.entries[at];
        let text = &self.source.text;
        let parent = entry.parent.map(|parent| self.layout.key(text, parent));
        let (name, kind, detail) = if entry.item {
            let named = ["name", "case", "agent"]
                .into_iter()
                .find_map(|key| self.layout.child(text, Some(at), key))?;
            let named = &self.layout.entries[named];
            (text.get(named.value?..named.end)?.trim_matches(['"', '\'']), SymbolKind::OBJECT, String::new())
        } else {
            let name = self.layout.key(text, at);
            let state = self.state(entry.key);
            let kind = match (parent, state) {
                (_, Some(kind)) => return self.state_symbol(at, name, kind, depth),
                (None, _) | (Some("states" | "parallel"), _) => SymbolKind::NAMESPACE,
                (Some("inputs" | "outputs" | "locals"), _) => SymbolKind::VARIABLE,
                (Some("events"), _) => SymbolKind::EVENT,
                (Some("types"), _) => SymbolKind::ENUM,
                _ => return None,
            };
            (name, kind, String::new())
        };
        let children = self.below(Some(at), depth + 1);
        // At the outermost level only what holds something is of interest.
        let shown = parent.is_some() || entry.item || !children.is_empty();
        shown.then(|| self.make(at, name, kind, detail, children)).flatten()
    }

    fn state(&self, key: Span) -> Option<&OutlineKind> {
        let states = &self.outline?.states;
        let at = states.binary_search_by_key(&key.start, |state| state.span.start).ok()?;
        (at > 0).then(|| &states[at].kind)
    }

    fn state_symbol(
        &self,
        at: usize,
        name: &str,
        kind: &OutlineKind,
        depth: usize,
    ) -> Option<DocumentSymbol> {
        let icon = match kind {
            OutlineKind::Skill(_) | OutlineKind::Remote(_) => SymbolKind::FUNCTION,
            OutlineKind::Chart(_) => SymbolKind::CLASS,
            OutlineKind::Final(_) => SymbolKind::ENUM_MEMBER,
            OutlineKind::Composite | OutlineKind::Parallel => SymbolKind::MODULE,
            _ => SymbolKind::OBJECT,
        };
        let text = &self.source.text;
        let inside =
            ["states", "parallel"].into_iter().filter_map(|key| self.layout.child(text, Some(at), key));
        let children = inside.flat_map(|inside| self.below(Some(inside), depth + 2)).collect();
        self.make(at, name, icon, describe(kind), children)
    }

    fn make(
        &self,
        at: usize,
        name: &str,
        kind: SymbolKind,
        detail: String,
        children: Vec<DocumentSymbol>,
    ) -> Option<DocumentSymbol> {
        let entry = &self.layout.entries[at];
        let span = Span { start: entry.key.start, end: entry.end };
        let range = |span| self.lines.range(&self.source.text, span);
        #[expect(deprecated, reason = "the field has no default and must be given")]
        (!name.is_empty()).then(|| DocumentSymbol {
            name: name.to_owned(),
            detail: (!detail.is_empty()).then_some(detail),
            kind,
            tags: None,
            deprecated: None,
            range: range(span),
            selection_range: range(entry.key),
            children: (!children.is_empty()).then_some(children),
        })
    }
}

/// What a state is, in a few words.
pub(crate) fn describe(kind: &OutlineKind) -> String {
    match kind {
        OutlineKind::Skill(name) => format!("skill {name}"),
        OutlineKind::Chart(name) => format!("chart {name}"),
        OutlineKind::Remote(name) => format!("remote {name}"),
        OutlineKind::Composite => "state with states inside".into(),
        OutlineKind::Parallel => "parallel regions".into(),
        OutlineKind::Final(outcome) => format!("final: {outcome}"),
        OutlineKind::History { deep: true } => "deep history".into(),
        OutlineKind::History { deep: false } => "shallow history".into(),
        _ => "waits".into(),
    }
}
