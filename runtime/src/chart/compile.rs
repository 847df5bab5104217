//! From a tree of states to the program: names resolved, expressions compiled, and everything that is wrong
//! collected on the way. What concerns the whole is in `lint`.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_source::on_a_large_stack;
use armarium_source::yaml::{Named, Node};
use armarium_source::{Finding, Findings, Remedy, Severity, code};
use armarium_values::{Type, Value};

use super::catalog::{ChannelSchema, Registry};
use super::channels::{KnownChannels, channels};
use super::expressions;
use super::flatten::{Inside, Tree, flatten, number};
use super::library::Library;
use super::lint::lint;
use super::literals::negative_time;
use super::model::{self, Chart};
use super::names::unknown_names;
use super::scope::{ChartNames, ExprSite, Scope};
use super::suspicious::suspicious;
use super::symbols::{Collector, HeadSection, SkillPart, Symbol};
use crate::observed::{MemoryPattern, ObservedPattern};
use crate::program::{
    Binding, ChannelSource, Code, Entry, EventNames, Kind, NamedChannel, Program, SourcePlace, State,
    StateId, Term, Transition, Watch,
};
use crate::skill::Parameter;

/// What checking a chart gave.
#[derive(Clone, Debug)]
pub struct Checked {
    /// Everything that is wrong, ordered by file and place.
    pub findings: Vec<Finding>,
    /// The chart ready to run; none when a finding is an error.
    pub program: Option<Arc<Program>>,
}

/// Finds everything that is wrong with a chart and compiles it.
pub fn check(library: &Library, registry: &Registry, schema: &ChannelSchema) -> Checked {
    on_a_large_stack(|| checked(library, registry, schema))
}

fn checked(library: &Library, registry: &Registry, schema: &ChannelSchema) -> Checked {
    let mut findings = library.findings.clone();
    let mut program = None;
    if let Some(root) = library.charts.get(&library.root) {
        let (tree, found) = flatten(root, library, registry);
        findings.extend(found);
        let (channels, found) = channels(library, schema);
        findings.extend(found);
        let (mut compiled, found) = compile(root, &tree, library, &channels, None);
        findings.extend(found);
        findings.extend(unknown_names(&mut compiled, &tree, root, registry));
        findings.extend(missing_inputs(&tree, &compiled));
        // Where keys are wrong or states are missing, findings about the whole chart would only repeat it.
        let any = |codes: &[&str]| findings.iter().any(|f| codes.contains(&f.code));
        let misread = any(&[code::KEY, code::FORM, code::MISSING_KEY, code::KIND]);
        let unknown = misread || any(&[code::STATE, code::SKILL, code::CHART]);
        if !misread {
            findings.extend(lint(&compiled, &tree, library, unknown));
        }
        if !unknown {
            findings.extend(suspicious(&compiled, &tree, library));
        }
        program = Some(compiled);
    }
    if findings.iter().any(|f| f.code == code::LIMIT) {
        // States that a limit cuts off are missed by others: that is no mistake of its own.
        findings.retain(|f| f.is_error() && f.code != code::STATE);
    }
    findings.sort_by(|a, b| {
        let key = |f: &'_ Finding| (f.span.start, f.code);
        a.source.by_path(&b.source).then_with(|| key(a).cmp(&key(b)))
    });
    explain(&mut findings);
    // A chart that is used twice is compiled twice; what is wrong with it is said once.
    findings.dedup();
    let failed = findings.iter().any(Finding::is_error);
    let program = program.filter(|_| !failed).map(Arc::new);
    Checked { findings, program }
}

/// A text that looks like an expression and is wrong as a text is one mistake: the error stays, with what to do about it.
/// The findings are in the order of their places.
fn explain(findings: &mut Vec<Finding>) {
    let place = |finding: &Finding| (finding.source.path.clone(), finding.span.start);
    let seems = |finding: &Finding| finding.code == code::SUSPICIOUS;
    let meant: BTreeMap<_, Finding> =
        findings.iter().filter(|f| seems(f)).map(|f| (place(f), f.clone())).collect();
    let mut explained = BTreeSet::new();
    for error in findings.iter_mut().filter(|f| matches!(f.code, code::TYPE | code::REFERENCE)) {
        let at = place(error);
        if let Some(meant) = meant.get(&at).filter(|m| m.remedy.is_some() || error.code == code::REFERENCE) {
            (error.help, error.remedy) = (meant.help.clone(), meant.remedy.clone());
            explained.insert(at);
        }
    }
    findings.retain(|f| !seems(f) || !explained.contains(&place(f)));
}

/// Compiles what is written at the states of a tree. Names that were found are added to `collector`.
pub(super) fn compile(
    root: &Chart,
    tree: &Tree<'_>,
    library: &Library,
    known: &KnownChannels,
    collector: Option<&Collector>,
) -> (Program, Vec<Finding>) {
    let event_types = event_types(library);
    let mut compiler = Compiler {
        tree,
        names: ChartNames::new(tree, known, collector),
        event_types: &event_types,
        findings: Vec::new(),
        event_names: EventNames::default(),
        slots: tree.slots,
    };
    let mut program = Program::default();
    program.states.reserve_exact(tree.states.len());
    for id in 0..number(tree.states.len()) {
        let state = compiler.state(id, &mut program.transitions, &mut program.watches);
        if let Some(parent) = state.parent {
            let parent = &mut program.states[parent as usize];
            let history = matches!(state.kind, Kind::History { .. });
            if history { parent.histories.push(id) } else { parent.children.push(id) }
        }
        program.states.push(state);
    }
    let Compiler { names, mut findings, event_names, slots, .. } = compiler;
    let (channels, read) = names.into_channels();
    // Where an expression is wrong, it is not known what it was to read.
    if !findings.iter().any(Finding::is_error) {
        findings.extend(unread(tree, library, known, &read));
    }
    let observed = observed_patterns(known, &channels);
    let held: Vec<String> =
        observed.iter().flat_map(|o| [false, true].map(|all| o.pattern.channel(all))).collect();
    let numbers = (0..).zip(&channels).filter(|(_, name)| held.contains(name));
    let observed_channels = numbers.map(|(number, _)| number).collect();
    let program = Program {
        name: root.name.clone(),
        sources: tree.sources.clone(),
        instances: tree.instances.clone(),
        observed,
        observed_channels,
        channels,
        named_channels: named_channels(root, tree, known),
        slots,
        event_names,
        profiles: profiles(root),
        event_types,
        declared_events: declared_events(library),
        ..program
    };
    (program.linked(), findings)
}

/// What compiling states works with.
pub(super) struct Compiler<'t> {
    pub(super) tree: &'t Tree<'t>,
    pub(super) names: ChartNames<'t>,
    /// What comes with the events that declare it.
    pub(super) event_types: &'t BTreeMap<String, Type>,
    pub(super) findings: Vec<Finding>,
    /// The names of events so far.
    pub(super) event_names: EventNames,
    /// The places for data so far: those of the tree, and those of loops.
    pub(super) slots: u32,
}

/// The inputs that a state takes, by name; none where it takes anything.
fn accepted<'t>(tree: &'t Tree<'_>, state: StateId) -> Option<&'t [Parameter]> {
    match &tree.state(state).inside {
        Inside::Skill(manifest) if !manifest.open => Some(&manifest.inputs),
        Inside::Chart { chart, .. } => Some(&chart.inputs),
        _ => None,
    }
}

impl<'t> Compiler<'t> {
    /// Calls `work` with the findings of one file, and keeps what it added.
    pub(super) fn reporting<T>(
        &mut self,
        source: u32,
        work: impl FnOnce(&mut Self, &mut Findings) -> T,
    ) -> T {
        let mut findings = Findings::new(Arc::clone(&self.tree.sources[source as usize]));
        let result = work(self, &mut findings);
        self.findings.append(&mut findings.list);
        result
    }

    pub(super) fn error(
        &mut self,
        site: &ExprSite<'_>,
        code: &'static str,
        at: &Named,
        message: String,
        help: Option<String>,
    ) {
        self.reporting(site.source, |_, findings| findings.error_help(code, at.span, message, help));
    }

    /// Adds an error about a name that stands for nothing, with the nearest of `known` as its remedy.
    pub(super) fn unknown<'n>(
        &mut self,
        site: &ExprSite<'_>,
        code: &'static str,
        at: &Named,
        message: String,
        known: impl IntoIterator<Item = &'n str>,
    ) {
        self.reporting(site.source, |_, findings| {
            findings.unknown(code, (at.span, &at.text), message, known, None);
        });
    }

    /// Compiles a state; what is written at it goes to `transitions` and `watches`.
    fn state(&mut self, id: StateId, transitions: &mut Vec<Transition>, watches: &mut Vec<Watch>) -> State {
        let tree = self.tree;
        let flat = tree.state(id);
        let model = flat.model;
        let mut state = State {
            name: flat.name().to_owned(),
            path: if flat.path.is_empty() { flat.name().to_owned() } else { flat.path.clone() },
            kind: Kind::Atomic,
            parent: flat.parent,
            last: flat.last,
            depth: flat.depth,
            children: Vec::new(),
            histories: Vec::new(),
            region: tree.is_region(id),
            chart_root: flat.chart_root,
            transitions: Vec::new(),
            always: Vec::new(),
            after: Vec::new(),
            watches: Vec::new(),
            enter: Vec::new(),
            exit: Vec::new(),
            with: Vec::new(),
            retry: model.retry.map(|r| (r.times, r.wait_s)),
            limits: flat.limits,
            unbreakable: model.unbreakable,
            outputs: flat.outputs.iter().map(|(name, slot, _)| (name.clone(), *slot)).collect(),
            done: self.event_names.intern(&format!("done.state.{}", flat.name())),
            place: SourcePlace { source: flat.source, byte: number(model.name.span.start) },
        };
        if id == 0 {
            state.kind = Kind::Chart { instance: 0 };
            (state.retry, state.unbreakable) = (None, false);
            return state;
        }
        let site = &ExprSite { state: id, source: flat.source, bound: Vec::new(), event_data: None };
        state.kind = self.kind(site, &flat.inside, &model.kind);
        state.with = self.bindings(site, id, &model.with);
        state.enter = self.actions(site, &model.enter);
        state.exit = self.actions(site, &model.exit);
        for watch in &model.watch {
            if let Some(compiled) = self.watch(site, watch) {
                state.watches.push(number(watches.len()));
                watches.push(compiled);
            }
        }
        let mut compiled = |list: &'t [model::WrittenTransition]| -> Vec<u32> {
            let one = |transition| {
                transitions.push(self.transition(site, transition));
                number(transitions.len() - 1)
            };
            list.iter().map(one).collect()
        };
        state.transitions = compiled(&model.transitions);
        state.always = compiled(&model.always);
        state.after = compiled(&model.after);
        state
    }

    fn kind(&mut self, site: &ExprSite<'t>, inside: &Inside<'_>, model: &'t model::WrittenKind) -> Kind {
        match (inside, model) {
            (Inside::Skill(manifest), _) => {
                manifest.outcomes.iter().for_each(|outcome| {
                    self.event_names.intern(outcome);
                });
                Kind::Skill { manifest: Arc::clone(manifest) }
            }
            (Inside::Chart { instance, .. }, _) => Kind::Chart { instance: *instance },
            (Inside::Nothing, model::WrittenKind::Composite { initial, .. }) => {
                let targets = self.initial(site, initial);
                Kind::Composite { initial: Entry { targets, actions: self.actions(site, &initial.actions) } }
            }
            (Inside::Nothing, model::WrittenKind::Parallel(_)) => Kind::Parallel,
            (Inside::Nothing, model::WrittenKind::Final(outcome)) => {
                Kind::Final { outcome: self.event_names.intern(&outcome.text) }
            }
            (Inside::Nothing, model::WrittenKind::History { deep, default }) => {
                let targets = self.history_default(site, default);
                let default = Entry { targets, actions: self.actions(site, &default.actions) };
                Kind::History { deep: *deep, default }
            }
            (Inside::Nothing, _) => Kind::Atomic,
        }
    }

    pub(super) fn value(&mut self, site: &ExprSite<'_>, node: &Node, ty: &Type) -> Option<Term> {
        self.reporting(site.source, |this, findings| {
            expressions::value(node, ty, &Scope::new(&this.names, site), findings)
        })
    }

    pub(super) fn condition(&mut self, site: &ExprSite<'_>, node: &Node) -> Option<Code> {
        self.reporting(site.source, |this, findings| {
            expressions::condition(node, &Scope::new(&this.names, site), findings)
        })
    }

    /// Compiles a value that is given to a parameter; a literal must be within its bounds.
    pub(super) fn given(&mut self, site: &ExprSite<'_>, node: &Node, to: &Parameter) -> Option<Term> {
        let term = self.value(site, node, &to.ty)?;
        if let Term::Literal(value) = &term
            && let Err(error) = to.accept(value.clone())
        {
            let message = error.to_string();
            self.reporting(site.source, |_, findings| findings.error(code::TYPE, node.span, message));
        }
        Some(term)
    }

    /// Refuses a time below 0, also one that an expression gives whatever happens.
    pub(super) fn not_negative(&mut self, site: &ExprSite<'_>, node: &Node, term: &Term) {
        let seconds = match term {
            Term::Literal(value) => value.as_f64(),
            Term::Expr(code) => code.expr.constant().and_then(|value| value.as_f64()),
            _ => None,
        };
        if seconds.is_some_and(|seconds| seconds < 0.0) {
            self.reporting(site.source, |_, findings| negative_time(node, findings));
        }
    }

    /// Compiles a `with` that is written at `site` and given to `target`.
    pub(super) fn bindings(
        &mut self,
        site: &ExprSite<'_>,
        target: StateId,
        with: &[(Named, Node)],
    ) -> Vec<Binding> {
        let tree = self.tree;
        let accepted = accepted(tree, target);
        // What could not be found, or is not known yet, takes anything; so does a final state.
        let anything = matches!(
            tree.state(target).model.kind,
            model::WrittenKind::Final(_)
                | model::WrittenKind::Skill(_)
                | model::WrittenKind::Chart(_)
                | model::WrittenKind::Remote(_)
        );
        let mut bindings = Vec::new();
        for (name, node) in with {
            let parameter = match accepted {
                Some(inputs) => match inputs.iter().find(|input| input.name == name.text) {
                    Some(parameter) => parameter.clone(),
                    None => {
                        let known = inputs.iter().map(|input| input.name.as_str());
                        let message = format!("there is no input `{}`", name.text);
                        self.unknown(site, code::INPUT, name, message, known);
                        self.findings.last_mut().into_iter().for_each(|finding| {
                            finding.remedy.get_or_insert(Remedy::Remove(name.span));
                        });
                        continue;
                    }
                },
                None if anything => Parameter::new(&name.text, Type::Any, ""),
                None => {
                    let message = "this state takes no inputs: only skills and charts do".into();
                    self.error(site, code::INPUT, name, message, None);
                    continue;
                }
            };
            self.names.refer(site.source, name.span, || {
                let name = name.text.clone();
                match &tree.state(target).inside {
                    Inside::Chart { chart, .. } => {
                        let section = HeadSection::Inputs;
                        Some(Symbol::Declared { chart: chart.name.clone(), section, name })
                    }
                    Inside::Skill(manifest) => {
                        let (skill, part) = (manifest.name.clone(), SkillPart::Input);
                        Some(Symbol::OfSkill { skill, part, name })
                    }
                    Inside::Nothing => None,
                }
            });
            if let Some(term) = self.given(site, node, &parameter) {
                if parameter.ty == Type::Duration {
                    self.not_negative(site, node, &term);
                }
                bindings.push(Binding { parameter, term, place: site.place(node.span) });
            }
        }
        bindings
    }

    fn watch(&mut self, site: &ExprSite<'_>, watch: &model::WrittenWatch) -> Option<Watch> {
        let condition = self.condition(site, &watch.condition);
        let until = watch.until.as_ref().and_then(|node| self.condition(site, node));
        let name = self.event_names.intern(&watch.name.text);
        Some(Watch { state: site.state, name, condition: condition?, until, hold_s: watch.hold_s })
    }
}

/// Inputs that neither a state gives to itself nor a transition to it.
fn missing_inputs(tree: &Tree<'_>, program: &Program) -> Vec<Finding> {
    let mut given: BTreeSet<(StateId, &str)> = BTreeSet::new();
    for transition in &program.transitions {
        if let [target] = transition.targets.as_slice() {
            given.extend(transition.with.iter().map(|b| (*target, b.parameter.name.as_str())));
        }
    }
    let mut found = Vec::new();
    for (id, flat) in (0..).zip(&tree.states).skip(1) {
        for input in accepted(tree, id).unwrap_or_default().iter().filter(|input| input.default.is_none()) {
            let name = input.name.as_str();
            let written = flat.model.with.iter().any(|(given, _)| given.text == name);
            if written || given.contains(&(id, name)) {
                continue;
            }
            let message = format!("`{}` needs the input `{name}`", flat.name());
            let help = Some(format!("add `with: {{{name}: ...}}`"));
            let mut findings = Findings::new(Arc::clone(&tree.sources[flat.source as usize]));
            findings.error_help(code::MISSING_INPUT, flat.model.name.span, message, help);
            if let Some(value) = input.example() {
                let (owner, key) = (Some(flat.model.name.span), name.to_owned());
                findings.remedy(Remedy::Add { owner, sections: vec!["with"], key, value });
            }
            found.append(&mut findings.list);
        }
    }
    found
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

/// The names of the charts in a tree.
fn used_charts<'t>(tree: &'t Tree<'_>) -> BTreeSet<&'t str> {
    (0..).zip(&tree.states).filter(|(_, state)| state.chart_root).map(|(id, _)| tree.chart_of(id)).collect()
}

/// Names under `observe` that no expression reads.
fn unread(
    tree: &Tree<'_>,
    library: &Library,
    known: &KnownChannels,
    read: &BTreeSet<(String, String)>,
) -> Vec<Finding> {
    let mut found = Vec::new();
    for chart in used_charts(tree).into_iter().filter_map(|name| library.charts.get(name)) {
        let mut findings = Findings::new(Arc::clone(&chart.source));
        for observed in &chart.observed {
            let name = &observed.name;
            // A name that is taken has its finding already.
            let is_known = known.observed(&chart.name, &name.text).is_some_and(|o| o.declared == name.text);
            if is_known && !read.contains(&(chart.name.clone(), name.text.clone())) {
                let message = format!("no expression of the chart reads `channels.{}`", name.text);
                let help = Some("what nobody reads is not observed".to_owned());
                findings.add(Severity::Warning, code::UNUSED, name.span, message, help);
                findings.remedy(Remedy::Remove(name.span));
            }
        }
        found.append(&mut findings.list);
    }
    found
}

/// The patterns of memory that the channels of a program stand for.
fn observed_patterns(known: &KnownChannels, channels: &[String]) -> Vec<ObservedPattern> {
    let patterns: BTreeSet<&MemoryPattern> =
        known.all_observed().map(|(.., observed)| &observed.pattern).collect();
    let is_read = |pattern: &MemoryPattern, all: bool| channels.contains(&pattern.channel(all));
    let one = |pattern: &MemoryPattern| {
        let (best, all) = (is_read(pattern, false), is_read(pattern, true));
        (best || all).then(|| ObservedPattern { pattern: pattern.clone(), best, all })
    };
    patterns.into_iter().filter_map(one).collect()
}

/// The channels as people name them who say what is on them: those that all charts share, what the chart observes, and what the
/// charts inside it observe, as `Chart.name`.
fn named_channels(root: &Chart, tree: &Tree<'_>, known: &KnownChannels) -> BTreeMap<String, NamedChannel> {
    let shared = known.shared.described().map(|channel| {
        let source = ChannelSource::Published(channel.name.clone());
        (channel.name.clone(), NamedChannel { ty: channel.ty.clone(), source })
    });
    let used = used_charts(tree);
    let observed =
        known.all_observed().filter(|(chart, ..)| used.contains(chart)).map(|(chart, name, of)| {
            let name = if chart == root.name { name.to_owned() } else { format!("{chart}.{name}") };
            let source = ChannelSource::Memory { pattern: of.pattern.clone(), all: of.all };
            (name, NamedChannel { ty: of.described.ty.clone(), source })
        });
    shared.chain(observed).collect()
}

fn declared_events(library: &Library) -> BTreeSet<String> {
    library.charts.values().flat_map(|chart| &chart.events).map(|(event, _)| event.text.clone()).collect()
}

fn profiles(root: &Chart) -> BTreeMap<String, BTreeMap<String, Value>> {
    let values = |entries: &Vec<(Named, Node)>| {
        entries.iter().map(|(name, node)| (name.text.clone(), node.literal())).collect()
    };
    root.profiles.iter().map(|(name, entries)| (name.clone(), values(entries))).collect()
}
