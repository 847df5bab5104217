//! The names in a file of test cases, and what they stand for in the chart that is tested.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_runtime::chart::{HeadSection, Library, NameReference, Symbol};
use armarium_runtime::observed::ALL;
use armarium_source::yaml::{Entries, Node, Yaml};
use armarium_source::{Source, Span};

/// The references of a file of test cases. `known` are those of its chart.
pub(crate) fn references(
    source: &Arc<Source>,
    tree: &Node,
    library: &Library,
    known: &[NameReference],
) -> Vec<NameReference> {
    let mut states: BTreeMap<&str, BTreeSet<&Symbol>> = BTreeMap::new();
    let mut ends: BTreeMap<(&str, &str), BTreeSet<&Symbol>> = BTreeMap::new();
    for reference in known.iter().filter(|reference| reference.definition) {
        match &reference.symbol {
            symbol @ Symbol::State { path, .. } => {
                states.entry(symbol.name()).or_default().insert(symbol);
                states.entry(path).or_default().insert(symbol);
            }
            symbol @ (Symbol::Watch { state, name, .. } | Symbol::Outcome { state, name, .. }) => {
                ends.entry((state, name)).or_default().insert(symbol);
            }
            _ => {}
        }
    }
    let root = library.charts.get(&library.root);
    let observed = root.into_iter().flat_map(|chart| chart.observes()).map(|(name, _)| name).collect();
    let (root, skills, found) = (&library.root, skills(known), Vec::new());
    let mut cases = Cases { source, root, states, ends, skills, observed, found };
    cases.file(tree);
    cases.found
}

fn skills(known: &[NameReference]) -> BTreeMap<&str, &Symbol> {
    let skill = |reference: &'_ NameReference| matches!(reference.symbol, Symbol::Skill { .. });
    known.iter().filter(|r| skill(r)).map(|r| (r.symbol.name(), &r.symbol)).collect()
}

struct Cases<'c> {
    source: &'c Arc<Source>,
    root: &'c str,
    /// States by name and by path; a name that several have stands for none.
    states: BTreeMap<&'c str, BTreeSet<&'c Symbol>>,
    /// Watches and outcomes by their state's path and their name.
    ends: BTreeMap<(&'c str, &'c str), BTreeSet<&'c Symbol>>,
    skills: BTreeMap<&'c str, &'c Symbol>,
    /// What the chart observes of memory, by the names that it gives.
    observed: BTreeSet<&'c str>,
    found: Vec<NameReference>,
}

fn entries<'n>(node: &'n Node, key: &str) -> &'n Entries {
    match node.get(key).map(|node| &node.value) {
        Some(Yaml::Map(entries)) => entries,
        _ => &[],
    }
}

impl Cases<'_> {
    fn add(&mut self, span: Span, symbol: Symbol) {
        let source = Arc::clone(self.source);
        let text = source.text.get(span.start..span.end).unwrap_or("");
        let quotes = text.len() > 2 && text.starts_with(['"', '\'']);
        let inner = if quotes { Span { start: span.start + 1, end: span.end - 1 } } else { span };
        let exact = source.text.get(inner.start..inner.end) == Some(symbol.name());
        let span = if exact { inner } else { span };
        self.found.push(NameReference { source, span, exact, definition: false, symbol });
    }

    fn text(node: Option<&Node>) -> Option<(&str, Span)> {
        match node.map(|node| (&node.value, node.span)) {
            Some((Yaml::String(text), span)) => Some((text, span)),
            _ => None,
        }
    }

    fn file(&mut self, tree: &Node) {
        if let Some((_, span)) = Self::text(tree.get("test")) {
            self.add(span, Symbol::Chart { chart: self.root.to_owned() });
        }
        self.scripts(tree);
        for case in tree.get("cases").map_or(&[][..], Node::items) {
            self.declared(case, "given", HeadSection::Inputs);
            self.scripts(case);
            for step in case.get("steps").map_or(&[][..], Node::items) {
                self.step(step);
            }
        }
    }

    fn declared(&mut self, node: &Node, key: &str, section: HeadSection) {
        for (name, _) in entries(node, key) {
            let (chart, text) = (self.root.to_owned(), name.text.clone());
            self.add(name.span, Symbol::Declared { chart, section, name: text });
        }
    }

    fn scripts(&mut self, node: &Node) {
        for (name, _) in entries(node, "skills") {
            match self.skills.get(name.text.as_str()) {
                Some(skill) if !self.states.contains_key(name.text.as_str()) => {
                    let skill = (*skill).clone();
                    self.add(name.span, skill);
                }
                _ => self.state(&name.text, name.span),
            }
        }
    }

    /// A state by its path, each part of it; or by its name, if one state alone has it.
    fn state(&mut self, path: &str, span: Span) {
        let text = self.source.text.get(span.start..span.end).unwrap_or("");
        let Some(start) = text.find(path).map(|at| span.start + at) else { return };
        let mut end = 0;
        for part in path.split('.') {
            let place = Span { start: start + end, end: start + end + part.len() };
            end += part.len();
            let symbols = self.states.get(&path[..end]);
            if let Some(symbol) = symbols.filter(|symbols| symbols.len() == 1).and_then(|s| s.first()) {
                let symbol = (*symbol).clone();
                self.add(place, symbol);
            }
            end += 1;
        }
    }

    /// What the chart observes, as it names it; or a channel that all charts share.
    fn channel(&mut self, channel: &str, span: Span) {
        let (name, all) = match channel.strip_suffix(ALL) {
            Some(name) if self.observed.contains(name) => (name, true),
            _ => (channel, false),
        };
        if !self.observed.contains(name) {
            return self.add(span, Symbol::Channel { channel: channel.to_owned(), fields: Vec::new() });
        }
        let text = self.source.text.get(span.start..span.end).unwrap_or("");
        let start = span.start + text.find(name).unwrap_or(0);
        let span = if all { Span { start, end: start + name.len() } } else { span };
        let (chart, section) = (self.root.to_owned(), HeadSection::Observe);
        self.add(span, Symbol::Declared { chart, section, name: name.to_owned() });
    }

    fn step(&mut self, step: &Node) {
        let from = Self::text(step.get("from"));
        if let Some((path, span)) = from {
            self.state(path, span);
        }
        if let Some((event, span)) = Self::text(step.get("event")) {
            match from {
                None => self.add(span, Symbol::Event { name: event.to_owned() }),
                Some((path, _)) => {
                    let states = self.states.get(path).into_iter().flatten();
                    let paths = states.filter_map(|s| match s {
                        Symbol::State { path, .. } => Some(path.as_str()),
                        _ => None,
                    });
                    let ends: Vec<Symbol> = paths
                        .filter_map(|p| self.ends.get(&(p, event)))
                        .flatten()
                        .map(|s| (*s).clone())
                        .collect();
                    ends.into_iter().for_each(|symbol| self.add(span, symbol));
                }
            }
        }
        if let Some((channel, span)) = Self::text(step.get("channel")) {
            self.channel(channel, span);
        }
        let Some(expect) = step.get("expect") else { return };
        for state in expect.get("active").map_or(&[][..], Node::items) {
            if let Some((path, span)) = Self::text(Some(state)) {
                self.state(path, span);
            }
        }
        self.declared(expect, "locals", HeadSection::Locals);
        self.declared(expect, "outputs", HeadSection::Outputs);
        if let Some((outcome, span)) = Self::text(expect.get("outcome")) {
            let (chart, name) = (self.root.to_owned(), outcome.to_owned());
            self.add(span, Symbol::Outcome { chart, state: String::new(), name });
        }
    }
}
