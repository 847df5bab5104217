//! Names that are known before a run, as values of inputs: postures of the robot, classes of objects.
//!
//! A literal for such an input is one of the known names. An input of a chart that is handed on to one is one itself: its
//! default, what profiles say, and what other charts give to it are held against the names, too. What other expressions
//! give is known in a run only.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use armarium_source::{Finding, Findings, Source, Span, code};
use armarium_values::Value;

use super::catalog::Registry;
use super::flatten::{Inside, Tree};
use super::model::Chart;
use crate::program::{Action, Binding, ChartVariable, Instance, Kind, Program, StateId, Term};
use crate::skill::{NameKind, Parameter};

/// What is known of an input whose values are names.
#[derive(Clone, Copy)]
struct Named {
    kind: NameKind,
    /// Whether the skill takes an empty text for no name.
    or_none: bool,
}

impl Named {
    fn of(parameter: &Parameter) -> Option<Self> {
        let or_none = parameter.default.as_ref().and_then(Value::as_str) == Some("");
        parameter.names.map(|kind| Self { kind, or_none })
    }
}

/// Finds literals that are not among the known names, and notes at the chart's inputs what names they are.
pub(super) fn unknown_names(
    program: &mut Program,
    tree: &Tree<'_>,
    root: &Chart,
    registry: &Registry,
) -> Vec<Finding> {
    let mut check = Check { registry, chart: &root.source.path, findings: Vec::new() };
    let mut named: BTreeMap<u32, Named> = BTreeMap::new();
    // A chart's states are numbered after the state that uses it: what its inputs are is known before what they are given.
    for (target, binding) in bindings(program) {
        let to = match &program.state(target).kind {
            Kind::Skill { .. } => Named::of(&binding.parameter),
            Kind::Chart { instance } => {
                let inputs = &program.instances[*instance as usize].inputs;
                let slot = inputs.iter().find(|v| v.declaration.name == binding.parameter.name);
                slot.and_then(|variable| named.get(&variable.slot).copied())
            }
            _ => None,
        };
        let Some(to) = to else { continue };
        match &binding.term {
            Term::Literal(Value::String(name)) => {
                let source = &program.sources[binding.place.source as usize];
                let span = text_at(source, binding.place.byte as usize, name);
                check.name(source, span, name, to);
            }
            Term::Expr(code) => match (code.expr.variable(), code.expr.constant()) {
                (Some(slot), _) => {
                    named.entry(slot).or_insert(to);
                }
                (None, Some(Value::String(name))) => {
                    let source = &program.sources[binding.place.source as usize];
                    let written = source.text.get(binding.place.byte as usize..).unwrap_or("");
                    let start = binding.place.byte as usize + written.find(name.as_str()).unwrap_or(0);
                    check.name(source, Span { start, end: start + name.len() }, &name, to);
                }
                _ => {}
            },
            _ => {}
        }
    }
    let mut assigned = BTreeSet::new();
    let of_transitions = program.transitions.iter().map(|transition| &transition.actions);
    let of_states = program.states.iter().flat_map(|state| {
        let entry = match &state.kind {
            Kind::Composite { initial: entry } | Kind::History { default: entry, .. } => Some(&entry.actions),
            _ => None,
        };
        [&state.enter, &state.exit].into_iter().chain(entry)
    });
    of_transitions.chain(of_states).for_each(|actions| assigns(actions, &mut assigned));
    let used = tree.states.iter().filter_map(|state| match &state.inside {
        Inside::Chart { chart, instance } => Some((*chart, *instance)),
        _ => None,
    });
    for (chart, instance) in used.chain([(root, 0)]) {
        check.defaults(chart, &program.instances[instance as usize], &named, &assigned);
    }
    check.profiles(root, &program.instances[0], &named);
    for probe in &root.probes {
        check.name(&root.source, probe.span, &probe.text, Named { kind: NameKind::Probe, or_none: false });
    }
    for input in &mut program.instances[0].inputs {
        input.declaration.names = named.get(&input.slot).map(|to| to.kind);
    }
    check.findings
}

/// What is given to states, those inside others first.
fn bindings(program: &Program) -> Vec<(StateId, &Binding)> {
    let mut all: Vec<(StateId, &Binding)> = Vec::new();
    for (id, state) in (0..).zip(&program.states) {
        all.extend(state.with.iter().map(|binding| (id, binding)));
    }
    for transition in &program.transitions {
        if let [target] = transition.targets.as_slice() {
            all.extend(transition.with.iter().map(|binding| (*target, binding)));
        }
    }
    all.sort_by_key(|(target, _)| std::cmp::Reverse(*target));
    all
}

/// The places for data that actions set.
fn assigns(actions: &[Action], slots: &mut BTreeSet<u32>) {
    for action in actions {
        match action {
            Action::Assign { slot, .. } => {
                slots.insert(*slot);
            }
            Action::If { then, otherwise, .. } => {
                assigns(then, slots);
                assigns(otherwise, slots);
            }
            Action::Foreach { body, .. } => assigns(body, slots),
            _ => {}
        }
    }
}

struct Check<'c> {
    registry: &'c Registry,
    /// The file of the chart that is checked.
    chart: &'c Path,
    findings: Vec<Finding>,
}

impl Check<'_> {
    fn name(&mut self, source: &Arc<Source>, span: Span, name: &str, to: Named) {
        if name.is_empty() && to.or_none {
            return;
        }
        let Err(unknown) = self.registry.known_name(to.kind, name, self.chart) else { return };
        let mut findings = Findings::new(Arc::clone(source));
        let names = unknown.known.iter().map(String::as_str);
        findings.unknown(code::REFERENCE, (span, name), unknown.message(), names, None);
        self.findings.append(&mut findings.list);
    }

    fn defaults(
        &mut self,
        chart: &Chart,
        instance: &Instance,
        named: &BTreeMap<u32, Named>,
        assigned: &BTreeSet<u32>,
    ) {
        // A local that something assigns need not begin with a name, and no default is used where a run gives the input.
        let kept = |local: &&ChartVariable| !assigned.contains(&local.slot);
        let (registry, is_root) = (self.registry, chart.source.path == self.chart);
        let used = |input: &&ChartVariable| !(is_root && registry.is_given(&input.declaration.name));
        for input in instance.inputs.iter().filter(used).chain(instance.locals.iter().filter(kept)) {
            let Some(Value::String(name)) = &input.declaration.default else { continue };
            let place = chart.defaults.iter().find(|(declared, _)| *declared == input.declaration.name);
            if let (Some(to), Some((_, span))) = (named.get(&input.slot), place) {
                self.name(&chart.source, *span, name, *to);
            }
        }
    }

    fn profiles(&mut self, root: &Chart, instance: &Instance, named: &BTreeMap<u32, Named>) {
        for (name, node) in root.profiles.values().flatten() {
            let input = instance.inputs.iter().find(|input| input.declaration.name == name.text);
            let to = input.and_then(|input| named.get(&input.slot));
            if let (Some(to), Value::String(text)) = (to, node.literal()) {
                self.name(&root.source, node.span, &text, *to);
            }
        }
    }
}

/// The place of a text that begins at a byte, with its quotes.
fn text_at(source: &Source, start: usize, text: &str) -> Span {
    let quotes = source.text.get(start..).is_some_and(|rest| rest.starts_with(['"', '\'']));
    Span { start, end: start + text.len() + if quotes { 2 } else { 0 } }
}
