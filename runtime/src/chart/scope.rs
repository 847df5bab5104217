//! What names in expressions stand for: looked up from a state outward.

use std::cell::{Cell, RefCell};
use std::collections::BTreeSet;

use armarium_source::Span;
use armarium_values::Type;
use armarium_values::expr::{Environment, Found, Slot, Unknown, Unresolved, Variable, nearest};

use super::channels::{KnownChannels, ObservedChannel};
use super::flatten::{Inside, Tree, number};
use super::symbols::{Collector, HeadSection, SkillPart, Symbol, parts};
use crate::program::{SourcePlace, StateId};

/// Mistakes for which the nearest name is looked for.
pub(super) const MAX_HELP: usize = 200;
/// Names of one state that are compared.
pub(super) const MAX_NAMES: usize = 1000;

/// Everything that names can stand for.
#[derive(Debug)]
pub(super) struct ChartNames<'c> {
    pub(super) tree: &'c Tree<'c>,
    known: &'c KnownChannels,
    /// The channels that expressions read so far; their numbers are their places.
    channels: RefCell<Vec<String>>,
    /// What was read of that which charts observe of memory: the chart, and the name that it gives.
    observed: RefCell<BTreeSet<(String, String)>>,
    /// How often somebody asked for what might be meant.
    asked: Cell<usize>,
    /// What the names that were found stand for, where somebody wants to know.
    collector: Option<&'c Collector>,
}

impl<'c> ChartNames<'c> {
    pub(super) fn new(
        tree: &'c Tree<'c>,
        known: &'c KnownChannels,
        collector: Option<&'c Collector>,
    ) -> Self {
        let (channels, observed, asked) = (RefCell::default(), RefCell::default(), Cell::default());
        Self { tree, known, channels, observed, asked, collector }
    }

    /// Says what a name in a file stands for.
    pub(super) fn refer(&self, source: u32, at: Span, symbol: impl FnOnce() -> Option<Symbol>) {
        if let Some(collector) = self.collector
            && let Some(symbol) = symbol()
        {
            collector.add(&self.tree.sources[source as usize], at, false, symbol);
        }
    }

    /// Says that the parts of a path name the states down to `last`.
    pub(super) fn refer_path(&self, source: u32, at: Span, path: &str, last: StateId) {
        if self.collector.is_some() {
            let places = parts(&self.tree.sources[source as usize].text, at, path);
            for (place, state) in places.into_iter().rev().zip(self.tree.outward(last)) {
                self.refer(source, place, || Some(self.tree.symbol(state)));
            }
        }
    }

    /// Says that `section.name`, as it is written in a file, is what the chart around declares.
    pub(super) fn refer_declared(&self, site: &ExprSite<'_>, at: Span, written: &str, name: &str) {
        self.refer(site.source, self.last_part(site, at, written), || {
            let (section, _) = written.split_once('.')?;
            let chart = self.tree.chart_of(site.state).to_owned();
            Some(Symbol::Declared { chart, section: HeadSection::of(section)?, name: name.to_owned() })
        });
    }

    fn last_part(&self, site: &ExprSite<'_>, at: Span, written: &str) -> Span {
        if self.collector.is_none() {
            return at;
        }
        parts(&self.tree.sources[site.source as usize].text, at, written).pop().unwrap_or(at)
    }

    /// The channels that expressions read, and what of that which charts observe: the chart, and the name that it gives.
    pub(super) fn into_channels(self) -> (Vec<String>, BTreeSet<(String, String)>) {
        (self.channels.into_inner(), self.observed.into_inner())
    }

    /// Whether what might be meant is still looked for: a file with very many mistakes is not searched again and again.
    pub(super) fn helps(&self) -> bool {
        self.asked.get() < MAX_HELP
    }

    /// The names that can be looked up from `from`, nearest first, to suggest one.
    pub(super) fn visible(&self, from: StateId) -> Vec<&str> {
        if !self.helps() {
            return Vec::new();
        }
        self.asked.set(self.asked.get() + 1);
        self.tree.visible(from).flat_map(|state| self.tree.child_names(state, MAX_NAMES)).collect()
    }

    /// The number of a channel that expressions at a state see.
    fn channel_number(&self, at: StateId, name: &str) -> Result<u32, Unresolved> {
        let chart = self.tree.chart_of(at);
        if self.known.ty(chart, name).is_none() {
            let message = format!("there is no channel `{name}`");
            let names = self.known.names(chart);
            let near = nearest(name, names.iter().copied()).map(str::to_owned);
            let elsewhere = self.known.all_observed().find(|(_, observed, _)| *observed == name);
            let help = match elsewhere {
                Some((other, _, channel)) => format!(
                    "`{other}` observes it; here, too: `observe: {{{}: \"{}\"}}`",
                    channel.declared, channel.pattern
                ),
                None => format!("channels are: {}", names.join(", ")),
            };
            return Err(Unresolved::new(Unknown::Channel, message, near, Some(help)));
        }
        let key = match self.known.observed(chart, name) {
            Some(observed) => {
                self.observed.borrow_mut().insert((chart.to_owned(), observed.declared.clone()));
                observed.pattern.channel(observed.all)
            }
            None => name.to_owned(),
        };
        let mut channels = self.channels.borrow_mut();
        let at = channels.iter().position(|c| *c == key).unwrap_or_else(|| {
            channels.push(key);
            channels.len() - 1
        });
        Ok(u32::try_from(at).unwrap_or(u32::MAX))
    }
}

/// Where an expression stands: its state, the event that it answers, the loops around it.
#[derive(Clone, Debug)]
pub(super) struct ExprSite<'t> {
    pub(super) state: StateId,
    pub(super) source: u32,
    /// Loop variables, innermost last.
    pub(super) bound: Vec<(String, u32)>,
    /// The type of `event.data`, where the event is one that declares it.
    pub(super) event_data: Option<&'t Type>,
}

impl ExprSite<'_> {
    /// `span` in the site's file.
    pub(super) fn place(&self, span: Span) -> SourcePlace {
        SourcePlace { source: self.source, byte: number(span.start) }
    }
}

/// The scope of one expression.
pub(super) struct Scope<'s, 'c> {
    pub(super) names: &'s ChartNames<'c>,
    pub(super) site: &'s ExprSite<'s>,
    /// What the names of the expression stand for, each with its place in the expression.
    pub(super) found: RefCell<Vec<(usize, usize, Symbol)>>,
}

impl<'s, 'c> Scope<'s, 'c> {
    pub(super) fn new(names: &'s ChartNames<'c>, site: &'s ExprSite<'s>) -> Self {
        Self { names, site, found: RefCell::default() }
    }
}

/// Where the letters of a symbol end that begins at a place: `cup_all` names `cup` and what stands behind it.
fn end_of(place: (usize, usize), symbol: &Symbol) -> usize {
    match symbol {
        Symbol::Declared { section: HeadSection::Observe, name, .. } => place.1.min(place.0 + name.len()),
        _ => place.1,
    }
}

fn unresolved<T>(message: String, near: Option<String>, help: Option<String>) -> Result<T, Unresolved> {
    Err(Unresolved::new(Unknown::Name, message, near, help))
}

impl Environment for Scope<'_, '_> {
    fn variable(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        let names = self.names;
        let instance = names.tree.instance(self.site.state);
        let found = |slot, ty, used| Ok(Variable { slot, ty, used });
        if let Some((_, slot)) = self.site.bound.iter().rev().find(|(name, _)| name == path[0]) {
            return found(Slot::Data(*slot), Type::Any, 1);
        }
        let declared = match path[0] {
            "inputs" => Some(&instance.inputs),
            "locals" => Some(&instance.locals),
            "outputs" => Some(&instance.outputs),
            _ => None,
        };
        if let Some(variables) = declared {
            let Some(name) = path.get(1) else {
                return unresolved(format!("`{}` needs a name after it", path[0]), None, None);
            };
            if let Some(v) = variables.iter().find(|v| v.declaration.name == **name) {
                return found(Slot::Data(v.slot), v.declaration.ty.clone(), 2);
            }
            let near = nearest(name, variables.iter().map(|v| v.declaration.name.as_str()));
            let near = near.map(|near| format!("{}.{near}", path[0]));
            let help = format!("declare it: `{}: {{{name}: {{type: ...}}}}`", path[0]);
            return unresolved(format!("the chart has no `{}.{name}`", path[0]), near, Some(help));
        }
        match (path[0], path.get(1)) {
            ("event", Some(&"name")) => return found(Slot::EventName, Type::String, 2),
            ("event", Some(&"data")) => {
                return found(Slot::EventData, self.site.event_data.cloned().unwrap_or(Type::Any), 2);
            }
            ("event", _) => {
                return unresolved("an event has `event.name` and `event.data`".into(), None, None);
            }
            ("channels", Some(name)) => {
                let number = names.channel_number(self.site.state, name).map_err(|error| Unresolved {
                    near: error.near.map(|near| format!("channels.{near}")),
                    ..error
                })?;
                let chart = names.tree.chart_of(self.site.state);
                let ty = names.known.ty(chart, name).cloned().unwrap_or(Type::Any);
                return found(Slot::Channel(number), ty, 2);
            }
            ("channels", None) => {
                let message = "`channels` needs a name after it".into();
                return Err(Unresolved::new(Unknown::Channel, message, None, None));
            }
            _ => {}
        }
        self.output(path)
    }

    fn found(&self, name: Found<'_>) {
        if self.names.collector.is_none() {
            return;
        }
        let mut found = self.found.borrow_mut();
        match name {
            Found::Variable { parts, places, variable } => {
                for (place, symbol) in places.iter().zip(self.symbols(parts, variable)) {
                    found.extend(symbol.map(|symbol| (place.0, end_of(*place, &symbol), symbol)));
                }
            }
            Found::Channel { name, place } => {
                let symbol = self.channel_symbol(name);
                found.push((place.0, end_of(place, &symbol), symbol));
            }
            Found::State { path, place } => {
                let parts: Vec<&str> = path.split('.').collect();
                let Some(last) = self.names.tree.find(self.site.state, &parts) else { return };
                let mut end = place.1;
                for (part, state) in parts.iter().rev().zip(self.names.tree.outward(last)) {
                    found.push((end - part.len(), end, self.names.tree.symbol(state)));
                    end -= part.len() + 1;
                }
            }
            Found::Function { name, place } => {
                found.push((place.0, place.1, Symbol::Function { name: name.to_owned() }));
            }
        }
    }

    fn channel(&self, name: &str) -> Result<u32, Unresolved> {
        // How old a list of matches is: as old as the best.
        let observed = self.names.known.observed(self.names.tree.chart_of(self.site.state), name);
        let name = observed.map_or(name, |observed| observed.declared.as_str());
        self.names.channel_number(self.site.state, name)
    }

    fn state(&self, path: &str) -> Result<u32, Unresolved> {
        let parts: Vec<&str> = path.split('.').collect();
        self.names.tree.find(self.site.state, &parts).ok_or_else(|| {
            let near = nearest(path, self.names.visible(self.site.state)).map(str::to_owned);
            Unresolved::new(Unknown::State, format!("there is no state `{path}` here"), near, None)
        })
    }
}

impl<'c> Scope<'_, 'c> {
    /// The constants of other languages.
    fn constant(name: &str) -> Option<&'static str> {
        match name {
            "True" | "TRUE" | "yes" | "on" => Some("true"),
            "False" | "FALSE" | "no" | "off" => Some("false"),
            "None" | "nil" | "undefined" | "NULL" => Some("null"),
            _ => None,
        }
    }

    /// The symbol of each part of a name that was resolved to `variable`: none for a loop variable and for parts that only
    /// name a section.
    fn symbols(&self, parts: &[&str], variable: &Variable) -> Vec<Option<Symbol>> {
        let (names, state) = (self.names, self.site.state);
        let mut symbols: Vec<Option<Symbol>> = vec![None; parts.len()];
        if self.site.bound.iter().any(|(name, _)| name == parts[0]) {
            return symbols;
        }
        if let Some(section) = HeadSection::of(parts[0]) {
            let (chart, name) = (names.tree.chart_of(state).to_owned(), parts[1].to_owned());
            symbols[1] = Some(Symbol::Declared { chart, section, name });
        } else if let Some(of) = self.observed(parts) {
            symbols[1] = Some(self.channel_symbol(parts[1]));
            if let (Some(name), false) = (parts.get(2), of.all) {
                let (segment, name) = (of.pattern.segment.clone(), (*name).to_owned());
                symbols[2] = Some(Symbol::Attribute { segment, name });
            }
        } else if parts[0] == "channels" {
            for (at, symbol) in symbols.iter_mut().enumerate().skip(1) {
                let fields = parts[2..=at.max(1)].iter().map(|part| (*part).to_owned()).collect();
                *symbol = Some(Symbol::Channel { channel: parts[1].to_owned(), fields });
            }
        } else if let Some((last, used)) = names.tree.find_prefix(state, parts) {
            let around = names.tree.outward(last).take(used).collect::<Vec<_>>();
            for (symbol, state) in symbols.iter_mut().zip(around.into_iter().rev()) {
                *symbol = Some(names.tree.symbol(state));
            }
            if variable.used > used
                && let Some(name) = parts.get(used).map(|name| (*name).to_owned())
            {
                symbols[used] = match &names.tree.state(last).inside {
                    Inside::Chart { chart, .. } => {
                        let (chart, section) = (chart.name.clone(), HeadSection::Outputs);
                        Some(Symbol::Declared { chart, section, name })
                    }
                    Inside::Skill(manifest) => {
                        let (skill, part) = (manifest.name.clone(), SkillPart::Output);
                        Some(Symbol::OfSkill { skill, part, name })
                    }
                    Inside::Nothing => None,
                };
            }
        }
        symbols
    }

    /// What of memory a dotted name reads: `channels.cup.pose`.
    fn observed(&self, parts: &[&str]) -> Option<&'c ObservedChannel> {
        let ["channels", name, ..] = parts else { return None };
        self.names.known.observed(self.names.tree.chart_of(self.site.state), name)
    }

    /// What the name of a channel stands for: what the chart declares under `observe`, or a channel that all charts share.
    fn channel_symbol(&self, name: &str) -> Symbol {
        let chart = self.names.tree.chart_of(self.site.state);
        match self.names.known.observed(chart, name) {
            Some(observed) => {
                let (chart, name) = (chart.to_owned(), observed.declared.clone());
                Symbol::Declared { chart, section: HeadSection::Observe, name }
            }
            None => Symbol::Channel { channel: name.to_owned(), fields: Vec::new() },
        }
    }

    /// Where a name is known that was written without what is before it.
    fn section_of(&self, name: &str) -> Option<&'static str> {
        let instance = self.names.tree.instance(self.site.state);
        let sections =
            [("inputs", &instance.inputs), ("locals", &instance.locals), ("outputs", &instance.outputs)];
        let has = |variables: &[crate::program::ChartVariable]| {
            variables.iter().any(|v| v.declaration.name == name)
        };
        let declared = sections.into_iter().find(|(_, variables)| has(variables)).map(|(section, _)| section);
        let chart = self.names.tree.chart_of(self.site.state);
        declared.or_else(|| self.names.known.ty(chart, name).map(|_| "channels"))
    }

    fn output(&self, path: &[&str]) -> Result<Variable, Unresolved> {
        let names = self.names;
        let Some((state, used)) = names.tree.find_prefix(self.site.state, path) else {
            let known = ["inputs", "locals", "outputs", "event", "channels"];
            let near = Self::constant(path[0])
                .map(str::to_owned)
                .or_else(|| self.section_of(path[0]).map(|section| format!("{section}.{}", path[0])))
                .or_else(|| {
                    // A state alone is no value.
                    let states = if path.len() > 1 { names.visible(self.site.state) } else { Vec::new() };
                    nearest(path[0], known.into_iter().chain(states)).map(str::to_owned)
                });
            let message = format!("there is no `{}` here", path[0]);
            return match path {
                [name] if near.is_none() => {
                    let help = Some(format!("a text stands in quotes: `'{name}'`"));
                    Err(Unresolved { kind: Unknown::Name, message, help, near: Some(format!("'{name}'")) })
                }
                _ => unresolved(message, near, None),
            };
        };
        let found = names.tree.state(state);
        let outputs = &found.outputs;
        let shown = path[..used].join(".");
        let Some(name) = path.get(used) else {
            return unresolved(format!("`{shown}` is a state; its outputs are `{shown}.name`"), None, None);
        };
        if let (true, Some((_, slot, ty))) = (found.open(), outputs.first()) {
            return Ok(Variable { slot: Slot::Data(*slot), ty: ty.clone(), used });
        }
        match outputs.iter().find(|(output, ..)| output == name) {
            Some((_, slot, ty)) => Ok(Variable { slot: Slot::Data(*slot), ty: ty.clone(), used: used + 1 }),
            None => {
                let known: Vec<&str> = outputs.iter().map(|(name, ..)| name.as_str()).collect();
                let near = nearest(name, known.iter().copied()).map(|near| format!("{shown}.{near}"));
                let help = match known.is_empty() {
                    true => format!("`{shown}` gives nothing"),
                    false => format!("it gives: {}", known.join(", ")),
                };
                unresolved(format!("`{shown}` has no output `{name}`"), near, Some(help))
            }
        }
    }
}
