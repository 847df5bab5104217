//! Every name in a chart and in the charts inside it, with what it stands for. The compiler finds it, so that an editor never
//! takes a name for something else than a run does.

use std::collections::{BTreeMap, BTreeSet};

use armarium_source::on_a_large_stack;
use armarium_source::yaml::Named;

use super::catalog::{ChannelSchema, Registry};
use super::channels::channels;
use super::compile::compile;
use super::flatten::{Inside, Tree, flatten};
use super::library::Library;
use super::model::{Chart, WrittenKind};
use super::scoped::{Scoped, scoped};
use super::symbols::{Collector, NameReference, SkillPart, Symbol, parts};
use crate::program::{Kind, Program, StateId};

/// Every name in the charts of a library that are used, ordered by file and place. What stands for nothing is left out.
#[must_use]
pub fn index(library: &Library, registry: &Registry, schema: &ChannelSchema) -> Vec<NameReference> {
    on_a_large_stack(|| {
        let collector = Collector::default();
        if let Some(root) = library.charts.get(&library.root) {
            let (tree, _) = flatten(root, library, registry);
            let (channels, _) = channels(library, schema);
            let (program, _) = compile(root, &tree, library, &channels, Some(&collector));
            let mut indexing = Indexing { tree: &tree, program: &program, collector: &collector };
            library.charts.values().for_each(|chart| indexing.head(chart));
            indexing.states();
            indexing.events(library);
        }
        collector.into_references()
    })
}

struct Indexing<'i, 't> {
    tree: &'i Tree<'t>,
    program: &'i Program,
    collector: &'i Collector,
}

impl Indexing<'_, '_> {
    /// What a chart declares.
    fn head(&mut self, chart: &Chart) {
        let add = |at: &Named, definition: bool, symbol| {
            self.collector.add(&chart.source, at.span, definition, symbol);
        };
        let declared = |section, name: &str| {
            let (chart, name) = (chart.name.clone(), name.to_owned());
            Symbol::Declared { chart, section, name }
        };
        for (section, name) in &chart.declared {
            add(name, true, declared(*section, &name.text));
        }
        for name in &chart.type_uses {
            add(name, false, declared(super::symbols::HeadSection::Types, &name.text));
        }
        for (event, _) in &chart.events {
            add(event, true, Symbol::Event { name: event.text.clone() });
        }
        for channel in &chart.channels {
            let symbol = |fields| Symbol::Channel { channel: channel.name.text.clone(), fields };
            add(&channel.name, true, symbol(Vec::new()));
            for field in &channel.fields {
                add(field, true, symbol(vec![field.text.clone()]));
            }
        }
        for (name, _) in chart.profiles.values().flatten() {
            add(name, false, declared(super::symbols::HeadSection::Inputs, &name.text));
        }
    }

    fn add(&self, state: StateId, at: &Named, definition: bool, symbol: Symbol) {
        let source = &self.tree.sources[self.tree.state(state).source as usize];
        self.collector.add(source, at.span, definition, symbol);
    }

    /// The names of states, of what they run, of their watches, and of how they end.
    fn states(&self) {
        for (id, flat) in (0..).zip(&self.tree.states).skip(1) {
            self.add(id, &flat.model.name, true, self.tree.symbol(id));
            match &flat.model.kind {
                WrittenKind::Skill(name) | WrittenKind::Remote(name) => {
                    self.add(id, name, false, Symbol::Skill { skill: name.text.clone() });
                }
                WrittenKind::Chart(name) => {
                    self.add(id, name, false, Symbol::Chart { chart: name.text.clone() })
                }
                _ => {}
            }
            for watch in &flat.model.watch {
                let symbol = self.watch(id, &watch.name.text);
                self.add(id, &watch.name, true, symbol);
            }
        }
    }

    fn watch(&self, state: StateId, name: &str) -> Symbol {
        let chart = self.tree.chart_of(state).to_owned();
        Symbol::Watch { chart, state: self.tree.state(state).path.clone(), name: name.to_owned() }
    }

    /// What an event of its own that a state gives is.
    fn symbol(&self, scoped: &Scoped<'_>) -> Symbol {
        let name = scoped.name.to_owned();
        if scoped.watch {
            return self.watch(scoped.state, &name);
        }
        match (&self.tree.state(scoped.state).inside, &self.program.state(scoped.state).kind) {
            (Inside::Chart { chart, .. }, _) => {
                Symbol::Outcome { chart: chart.name.clone(), state: String::new(), name }
            }
            (_, Kind::Skill { manifest }) => {
                Symbol::OfSkill { skill: manifest.name.clone(), part: SkillPart::Outcome, name }
            }
            _ => {
                let chart = self.tree.chart_of(scoped.state).to_owned();
                Symbol::Outcome { chart, state: self.tree.state(scoped.state).path.clone(), name }
            }
        }
    }

    /// The events that transitions answer, and the outcomes that final states give.
    fn events(&self, library: &Library) {
        let scoped = scoped(self.program);
        let mut taken: BTreeMap<(StateId, &str), BTreeSet<Symbol>> = BTreeMap::new();
        for one in &scoped {
            let symbol = self.symbol(one);
            if let Some(at) = one.at {
                let end = match &self.tree.state(at).model.kind {
                    WrittenKind::Final(outcome) => Some(outcome),
                    _ => None,
                };
                end.into_iter().for_each(|outcome| self.add(at, outcome, true, symbol.clone()));
            }
            let around = if one.own_only { 1 } else { usize::MAX };
            for state in self.program.outward(one.state).take(around) {
                taken.entry((state, one.name)).or_default().insert(symbol.clone());
            }
        }
        let mut by_skill: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        let mut by_name: BTreeMap<&str, BTreeSet<Symbol>> = BTreeMap::new();
        for (id, state) in (0..).zip(&self.program.states).skip(1) {
            if let Kind::Skill { manifest } = &state.kind {
                for event in &manifest.events {
                    by_skill.entry(event).or_default().insert(&manifest.name);
                }
            }
            by_name.entry(&state.name).or_default().insert(self.tree.symbol(id));
        }
        let declared: BTreeSet<&str> = library
            .charts
            .values()
            .flat_map(|chart| &chart.events)
            .map(|(event, _)| event.text.as_str())
            .collect();
        for (id, flat) in (0..).zip(&self.tree.states).skip(1) {
            for event in flat.model.transitions.iter().filter_map(|transition| transition.event.as_ref()) {
                let name = event.text.as_str();
                if let Some(state) = name.strip_prefix("done.state.") {
                    let source = &self.tree.sources[flat.source as usize];
                    let place = parts(&source.text, event.span, name).pop().unwrap_or(event.span);
                    for symbol in by_name.get(state).into_iter().flatten() {
                        self.collector.add(source, place, false, symbol.clone());
                    }
                    continue;
                }
                if name.contains('*') || name.starts_with("error.") {
                    continue;
                }
                let own = taken.get(&(id, name));
                own.into_iter().flatten().for_each(|symbol| self.add(id, event, false, symbol.clone()));
                let skills = by_skill.get(name);
                for skill in skills.into_iter().flatten() {
                    let (skill, name) = ((*skill).to_owned(), name.to_owned());
                    self.add(id, event, false, Symbol::OfSkill { skill, part: SkillPart::Event, name });
                }
                if declared.contains(name) || own.is_none() && skills.is_none() {
                    self.add(id, event, false, Symbol::Event { name: name.to_owned() });
                }
            }
        }
    }
}
