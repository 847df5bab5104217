//! From models to tables: charts put into charts, names resolved, expressions compiled, and everything that is
//! wrong collected on the way. What concerns the whole is in `lint`.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_values::{Type, Value};

use super::catalog::{ChannelSchema, Registry};
use super::expressions::{self, Names, Scope};
use super::finding::{Finding, Findings, Source, code, suggest};
use super::library::Library;
use super::lint;
use super::model::{self, Chart, Declaration};
use super::read::literal;
use super::stack::on_a_large_stack;
use super::yaml::{Named, Node};
use crate::engine::program::{Binding, Entry, Kind, Place, Program, State, StateId, Term, Transition, Watch};
use crate::engine::tables::{Symbols, Tables};
use crate::skill::{Limits, SkillManifest};

/// What checking a chart gave.
#[derive(Clone, Debug)]
pub struct Checked {
    /// Everything that is wrong, ordered by file and place.
    pub findings: Vec<Finding>,
    /// The chart ready to run; none when a finding is an error.
    pub program: Option<Arc<Program>>,
}

/// Finds everything that is wrong with a chart and compiles it.
#[must_use]
pub fn check(library: &Library, registry: &Registry, schema: &ChannelSchema) -> Checked {
    on_a_large_stack(|| checked(library, registry, schema))
}

fn checked(library: &Library, registry: &Registry, schema: &ChannelSchema) -> Checked {
    let mut findings = library.findings.clone();
    let mut program = None;
    if let Some(root) = library.charts.get(&library.root) {
        let mut compiler = Compiler::new(library, registry, schema);
        compiler.flatten_root(root);
        program = Some(compiler.compile(root));
        findings.append(&mut compiler.findings);
    }
    if findings.iter().any(|f| f.code == code::LIMIT) {
        // States that a limit cuts off are missed by others: that is no mistake of its own.
        findings.retain(|f| f.is_error() && f.code != code::STATE);
    }
    findings.sort_by(|a, b| {
        let key = |f: &'_ Finding| (f.span.start, f.code);
        a.source.path.cmp(&b.source.path).then_with(|| key(a).cmp(&key(b)))
    });
    // A chart that is used twice is compiled twice; what is wrong with it is said once.
    findings.dedup();
    let failed = findings.iter().any(Finding::is_error);
    let program = program.filter(|_| !failed).map(Arc::new);
    Checked { findings, program }
}

/// A state of a use of a chart, before its parts are compiled.
pub(crate) struct Flat<'l> {
    pub(crate) model: &'l model::State,
    pub(crate) source: u32,
    pub(crate) depth: u16,
    pub(crate) path: String,
    pub(crate) limits: Limits,
    /// The chart inside, for a `statechart:` state.
    pub(crate) chart: Option<(&'l Chart, u32)>,
    pub(crate) skill: Option<Arc<SkillManifest>>,
}

pub(super) struct Compiler<'l> {
    pub(super) library: &'l Library,
    pub(super) registry: &'l Registry,
    pub(super) names: Names<'l>,
    pub(super) flats: Vec<Flat<'l>>,
    /// Last state inside each state.
    pub(super) last: Vec<StateId>,
    pub(super) sources: Vec<Arc<Source>>,
    pub(super) slots: u32,
    pub(super) findings: Vec<Finding>,
    pub(super) transitions: Vec<Transition>,
    pub(super) watches: Vec<Watch>,
    /// States that transitions give inputs to, for inputs that the state itself does not give.
    pub(super) given: BTreeSet<(StateId, String)>,
    pub(super) bound: Vec<(String, u32)>,
    pub(super) too_many: bool,
    pub(super) symbols: Symbols,
    /// What comes with the events that declare it.
    pub(super) event_types: BTreeMap<String, Type>,
    /// What comes with the event of the transition that is compiled.
    pub(super) event_data: Option<Type>,
}

pub(super) fn number(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

impl<'l> Compiler<'l> {
    fn new(library: &'l Library, registry: &'l Registry, schema: &'l ChannelSchema) -> Self {
        Self {
            library,
            registry,
            names: Names {
                outlines: Vec::new(),
                children: BTreeMap::new(),
                instances: Vec::new(),
                schema,
                channels: RefCell::new(Vec::new()),
                asked: Cell::new(0),
            },
            flats: Vec::new(),
            last: Vec::new(),
            sources: Vec::new(),
            slots: 0,
            findings: Vec::new(),
            transitions: Vec::new(),
            watches: Vec::new(),
            given: BTreeSet::new(),
            bound: Vec::new(),
            too_many: false,
            symbols: Symbols::default(),
            event_types: event_types(library),
            event_data: None,
        }
    }

    pub(super) fn source(&mut self, source: &Arc<Source>) -> u32 {
        let known = self.sources.iter().position(|s| Arc::ptr_eq(s, source));
        number(known.unwrap_or_else(|| {
            self.sources.push(Arc::clone(source));
            self.sources.len() - 1
        }))
    }

    /// Calls `work` with the findings of one file, and keeps what it added.
    pub(super) fn reporting<T>(
        &mut self,
        source: u32,
        work: impl FnOnce(&mut Self, &mut Findings) -> T,
    ) -> T {
        let mut findings = Findings::new(Arc::clone(&self.sources[source as usize]));
        let result = work(self, &mut findings);
        self.findings.append(&mut findings.list);
        result
    }

    pub(super) fn error(
        &mut self,
        source: u32,
        code: &'static str,
        at: &Named,
        message: String,
        help: Option<String>,
    ) {
        self.reporting(source, |_, findings| findings.error_help(code, at.span, message, help));
    }

    fn compile(&mut self, root: &'l Chart) -> Program {
        let mut states: Vec<State> = Vec::with_capacity(self.flats.len());
        for id in 0..number(self.flats.len()) {
            let state = self.compile_state(id);
            if let Some(parent) = state.parent {
                let parent = &mut states[parent as usize];
                let history = matches!(state.kind, Kind::History { .. });
                if history { parent.histories.push(id) } else { parent.children.push(id) }
            }
            states.push(state);
        }
        self.missing_inputs(&states);
        let transitions = std::mem::take(&mut self.transitions);
        let tables = Tables::new(std::mem::take(&mut self.symbols), &states, &transitions);
        let mut program = Program {
            name: root.name.clone(),
            sources: std::mem::take(&mut self.sources),
            states,
            transitions,
            watches: std::mem::take(&mut self.watches),
            instances: std::mem::take(&mut self.names.instances),
            channels: Vec::new(),
            slots: self.slots,
            tables,
            profiles: profiles(root),
            event_types: std::mem::take(&mut self.event_types),
        };
        set_domains(&mut program);
        lint::lint(&program, &self.flats, self.library, &mut self.findings);
        program.channels = self.names.channels.take();
        program
    }

    fn compile_state(&mut self, id: StateId) -> State {
        let flat = &self.flats[id as usize];
        let (model, source, depth, limits) = (flat.model, flat.source, flat.depth, flat.limits);
        let outline = &self.names.outlines[id as usize];
        let (parent, chart_root, instance) = (outline.parent, outline.chart_root, outline.instance);
        let region = parent.is_some_and(|p| {
            matches!(self.flats[p as usize].model.kind, model::Kind::Parallel(_)) && p != 0 && !chart_root
        });
        let path = if flat.path.is_empty() { model.name.text.clone() } else { flat.path.clone() };
        let mut state = State {
            name: outline.name.clone(),
            path,
            kind: Kind::Atomic,
            parent,
            last: self.last[id as usize],
            depth,
            children: Vec::new(),
            histories: Vec::new(),
            region,
            chart_root,
            transitions: Vec::new(),
            always: Vec::new(),
            after: Vec::new(),
            watches: Vec::new(),
            enter: Vec::new(),
            exit: Vec::new(),
            with: Vec::new(),
            retry: model.retry.map(|r| (r.times, r.wait_s)),
            limits,
            unbreakable: model.unbreakable,
            outputs: outline.outputs.iter().map(|(name, slot, _)| (name.clone(), *slot)).collect(),
            done: self.symbols.intern(&format!("done.state.{}", outline.name)),
            place: Place { source, byte: number(model.name.span.start) },
        };
        if id == 0 {
            state.kind = Kind::Chart { instance };
            (state.retry, state.unbreakable) = (None, false);
            return state;
        }
        if let Some(manifest) = self.flats[id as usize].skill.clone() {
            manifest.outcomes.iter().for_each(|outcome| {
                self.symbols.intern(outcome);
            });
        }
        state.kind = self.kind(id, model, source);
        state.with = self.bindings(id, id, &model.with, source);
        state.enter = self.actions(id, &model.enter, source);
        state.exit = self.actions(id, &model.exit, source);
        self.compile_watches(id, model, source, &mut state);
        for (list, to) in [(&model.transitions, 0), (&model.always, 1), (&model.after, 2)] {
            for transition in list {
                let number = self.transition(id, transition, source);
                match to {
                    0 => state.transitions.push(number),
                    1 => state.always.push(number),
                    _ => state.after.push(number),
                }
            }
        }
        state
    }

    fn kind(&mut self, id: StateId, model: &'l model::State, source: u32) -> Kind {
        match &model.kind {
            model::Kind::Atomic => Kind::Atomic,
            model::Kind::Skill(_) | model::Kind::Remote(_) => self.flats[id as usize]
                .skill
                .clone()
                .map_or(Kind::Atomic, |manifest| Kind::Skill { manifest }),
            model::Kind::Chart(_) => {
                let chart = self.flats[id as usize].chart;
                chart.map_or(Kind::Atomic, |(_, instance)| Kind::Chart { instance })
            }
            model::Kind::Composite { initial, .. } => {
                let targets = self.initial(id, initial, source);
                Kind::Composite {
                    initial: Entry { targets, actions: self.actions(id, &initial.actions, source) },
                }
            }
            model::Kind::Parallel(_) => Kind::Parallel,
            model::Kind::Final(outcome) => Kind::Final { outcome: self.symbols.intern(&outcome.text) },
            model::Kind::History { deep, default } => {
                let targets = self.history_default(id, default, source);
                let default = Entry { targets, actions: self.actions(id, &default.actions, source) };
                Kind::History { deep: *deep, default }
            }
        }
    }

    fn scope(&self, state: StateId) -> Scope<'_, 'l> {
        Scope { names: &self.names, state, bound: &self.bound, event_data: self.event_data.as_ref() }
    }

    pub(super) fn value(&mut self, state: StateId, node: &Node, ty: &Type, source: u32) -> Option<Term> {
        self.reporting(source, |this, findings| {
            expressions::value(node, ty, &this.scope(state), source, findings)
        })
    }

    pub(super) fn condition(
        &mut self,
        state: StateId,
        node: &Node,
        source: u32,
    ) -> Option<crate::engine::program::Code> {
        self.reporting(source, |this, findings| {
            expressions::condition(node, &this.scope(state), source, findings)
        })
    }

    /// What may be given to a state: the inputs of its skill or chart, or anything for a final state.
    fn accepted(&self, state: StateId) -> Option<Vec<(String, Type, bool)>> {
        let flat = &self.flats[state as usize];
        if let Some(manifest) = flat.skill.as_ref().filter(|manifest| !manifest.open) {
            let one = |p: &crate::skill::Parameter| (p.name.clone(), p.ty.clone(), p.default.is_none());
            return Some(manifest.inputs.iter().map(one).collect());
        }
        if let Some((chart, _)) = flat.chart {
            let one = |d: &Declaration| (d.name.clone(), d.ty.clone(), d.default.is_none());
            return Some(chart.inputs.iter().map(one).collect());
        }
        None
    }

    /// Compiles a `with` that is written at `scope` and given to `target`.
    pub(super) fn bindings(
        &mut self,
        scope: StateId,
        target: StateId,
        with: &[(Named, Node)],
        source: u32,
    ) -> Vec<Binding> {
        let accepted = self.accepted(target);
        let is_final = matches!(self.flats[target as usize].model.kind, model::Kind::Final(_));
        let broken = matches!(
            self.flats[target as usize].model.kind,
            model::Kind::Skill(_) | model::Kind::Chart(_) | model::Kind::Remote(_)
        ) && accepted.is_none();
        let mut bindings = Vec::new();
        for (name, node) in with {
            let ty = match &accepted {
                Some(inputs) => match inputs.iter().find(|(input, ..)| *input == name.text) {
                    Some((_, ty, _)) => ty.clone(),
                    None => {
                        let help = suggest(&name.text, inputs.iter().map(|(input, ..)| input.as_str()));
                        let message = format!("there is no input `{}`", name.text);
                        self.error(source, code::INPUT, name, message, help);
                        continue;
                    }
                },
                None if is_final || broken => Type::Any,
                None => {
                    let message = "this state takes no inputs: only skills and charts do".into();
                    self.error(source, code::INPUT, name, message, None);
                    continue;
                }
            };
            if let Some(term) = self.value(scope, node, &ty, source) {
                let place = Place { source, byte: number(node.span.start) };
                bindings.push(Binding { name: name.text.clone(), ty, term, place });
            }
        }
        bindings
    }

    fn missing_inputs(&mut self, states: &[State]) {
        for (id, state) in states.iter().enumerate().skip(1) {
            let Some(accepted) = self.accepted(number(id)) else { continue };
            let model = self.flats[id].model;
            for (name, _, required) in accepted {
                let written = model.with.iter().any(|(given, _)| given.text == name);
                let given = written || self.given.contains(&(number(id), name.clone()));
                if required && !given {
                    let source = state.place.source;
                    let message = format!("`{}` needs the input `{name}`", state.name);
                    let help = Some(format!("add `with: {{{name}: ...}}`"));
                    self.error(source, code::MISSING_INPUT, &model.name, message, help);
                }
            }
        }
    }

    fn compile_watches(&mut self, id: StateId, model: &'l model::State, source: u32, state: &mut State) {
        for watch in &model.watch {
            let condition = self.condition(id, &watch.condition, source);
            let until = watch.until.as_ref().and_then(|node| self.condition(id, node, source));
            let Some(condition) = condition else { continue };
            let name = self.symbols.intern(&watch.name.text);
            state.watches.push(number(self.watches.len()));
            self.watches.push(Watch { state: id, name, condition, until, hold_s: watch.hold_s });
        }
    }
}

/// What comes with the events that charts declare. All active states see an event, whichever chart declares it; one that
/// two charts declare differently may hold anything.
fn event_types(library: &Library) -> BTreeMap<String, Type> {
    let mut types: BTreeMap<String, Type> = BTreeMap::new();
    for (event, data) in library.charts.values().flat_map(|chart| &chart.events) {
        let Some(data) = data else { continue };
        let known = types.entry(event.text.clone()).or_insert_with(|| data.clone());
        if known != data {
            *known = Type::Any;
        }
    }
    types
}

fn profiles(root: &Chart) -> BTreeMap<String, BTreeMap<String, Value>> {
    let values = |entries: &Vec<(Named, Node)>| {
        entries.iter().map(|(name, node)| (name.text.clone(), literal(node))).collect()
    };
    root.profiles.iter().map(|(name, entries)| (name.clone(), values(entries))).collect()
}

fn set_domains(program: &mut Program) {
    for at in 0..program.transitions.len() {
        let t = &program.transitions[at];
        let domain = (!t.targets.is_empty()).then(|| program.domain(t.source, t.internal, &t.targets));
        program.transitions[at].domain = domain;
    }
    program.tables.set_jumps(&program.transitions);
}
