//! Charts that are valid but probably not meant so: ends that cannot come, outputs that nothing sets, events that nobody takes, texts that look
//! like expressions, states that nothing leads out of, and `always` transitions that never rest.

use std::collections::BTreeSet;
use std::sync::Arc;

use armarium_source::yaml::{Named, Node, Yaml};
use armarium_source::{Finding, Findings, Severity, Span, code};
use armarium_values::{Type, Value};

use super::flatten::Tree;
use super::library::Library;
use super::model::{self, Action, ActionKind, Chart};
use super::symbols::Section;
use crate::program::{Kind, Pattern, Program, StateId};

/// What is suspicious in charts that can be compiled.
pub(super) fn suspicious(program: &Program, tree: &Tree<'_>, library: &Library) -> Vec<Finding> {
    let mut search = Search { program, tree, findings: Vec::new() };
    search.never_ends();
    search.dead_ends();
    search.loose_limits();
    search.restless();
    let mut findings = search.findings;
    let taken = Taken::of(program);
    for chart in library.charts.values() {
        findings.extend(written(chart, &taken));
    }
    findings
}

/// The events that transitions take.
#[derive(Default)]
struct Taken<'p> {
    exact: BTreeSet<&'p str>,
    prefixes: Vec<&'p Pattern>,
}

impl<'p> Taken<'p> {
    fn of(program: &'p Program) -> Self {
        let mut taken = Self::default();
        for transition in &program.transitions {
            match &transition.pattern {
                Pattern::None => {}
                Pattern::Exact(name) => {
                    taken.exact.insert(name);
                }
                pattern if taken.prefixes.contains(&pattern) => {}
                pattern => taken.prefixes.push(pattern),
            }
        }
        taken
    }

    fn takes(&self, event: &str) -> bool {
        self.exact.contains(event) || self.prefixes.iter().any(|pattern| pattern.matches(event))
    }
}

struct Search<'a, 'l> {
    program: &'a Program,
    tree: &'a Tree<'l>,
    findings: Vec<Finding>,
}

impl Search<'_, '_> {
    fn add(&mut self, severity: Severity, code: &'static str, state: StateId, text: String, help: &str) {
        let flat = self.tree.state(state);
        let mut findings = Findings::new(Arc::clone(&self.tree.sources[flat.source as usize]));
        findings.add(severity, code, flat.model.name.span, text, Some(help.to_owned()));
        self.findings.append(&mut findings.list);
    }

    fn ids(&self) -> std::ops::Range<StateId> {
        1..u32::try_from(self.program.states.len()).unwrap_or(u32::MAX)
    }

    /// Regions without an end, where the end of the parallel state around them is waited for.
    fn never_ends(&mut self) {
        for id in self.ids() {
            let state = self.program.state(id);
            let waited =
                |t: &model::Transition| t.event.as_ref().is_some_and(|event| event.text == "success");
            let waits = self.tree.state(id).model.transitions.iter().find(|t| waited(t));
            if waits.is_none() || !matches!(state.kind, Kind::Parallel) {
                continue;
            }
            for region in state.children.clone() {
                let of = self.program.state(region);
                let is_final =
                    |child: &StateId| matches!(self.program.state(*child).kind, Kind::Final { .. });
                if matches!(of.kind, Kind::Composite { .. } | Kind::Atomic)
                    && !of.children.iter().any(is_final)
                {
                    let message = format!(
                        "the region `{}` never ends, so that `success` of `{}` never comes",
                        of.name, state.name
                    );
                    let help = "give the region a final state, or leave the parallel state by another event";
                    self.add(Severity::Warning, code::ENDLESS, region, message, help);
                }
            }
        }
    }

    /// States that wait for nothing, beside states with which their composite can end. (Where nothing ends, that is meant.)
    fn dead_ends(&mut self) {
        let finals = self.ids().filter(|id| matches!(self.program.state(*id).kind, Kind::Final { .. }));
        let ending: BTreeSet<StateId> = finals.filter_map(|id| self.program.state(id).parent).collect();
        for id in self.ids() {
            let state = self.program.state(id);
            let leads_on = |id: StateId| {
                let of = self.program.state(id);
                !(of.transitions.is_empty() && of.always.is_empty() && of.after.is_empty())
            };
            let others_end = state.parent.is_some_and(|parent| ending.contains(&parent));
            let alone = matches!(state.kind, Kind::Atomic) && !self.program.outward(id).any(leads_on);
            if alone && others_end {
                let message =
                    format!("nothing leads out of `{}`: a run that comes there stays for ever", state.name);
                let help = "give it a transition, or make it a `final` state";
                self.add(Severity::Warning, code::ENDLESS, id, message, help);
            }
        }
    }

    /// Limits that are looser than those around them.
    fn loose_limits(&mut self) {
        for id in self.ids() {
            let flat = self.tree.state(id);
            let Some(around) = flat.parent.map(|parent| self.tree.state(parent).limits) else { continue };
            let (own, held) = (flat.model.limits, flat.limits);
            let loose =
                |own: Option<f64>, held: Option<f64>| own.filter(|own| held.is_some_and(|held| held < *own));
            let found = [
                loose(own.force_n, held.force_n).map(|own| ("force", own, around.force_n, "N")),
                loose(own.speed_m_s, held.speed_m_s).map(|own| ("speed", own, around.speed_m_s, "m/s")),
            ];
            for (what, own, around, unit) in found.into_iter().flatten() {
                let (around, name) = (around.unwrap_or(own), self.program.state(id).name.clone());
                let message = format!(
                    "the {what} of {own} {unit} in `{name}` has no effect: around it {around} {unit} holds"
                );
                self.add(
                    Severity::Warning,
                    code::UNUSED,
                    id,
                    message,
                    "an inner state can only tighten limits",
                );
            }
        }
    }

    /// `always` transitions without a condition that lead back to where they began.
    fn restless(&mut self) {
        let mut told = BTreeSet::new();
        let mut followed = vec![false; self.program.states.len()];
        for id in self.ids() {
            let mut way = vec![id];
            while let Some(next) = way.last().and_then(|at| self.at_once(*at)) {
                if let Some(from) = way.iter().position(|s| *s == next) {
                    if told.insert(next) {
                        let names: Vec<&str> =
                            way[from..].iter().map(|s| &*self.program.state(*s).name).collect();
                        let message = match names.as_slice() {
                            [name] => format!("`always` leads from `{name}` to itself without a condition"),
                            _ => format!(
                                "`always` leads in a circle without a condition: {}",
                                names.join(" -> ")
                            ),
                        };
                        self.add(
                            Severity::Error,
                            code::RESTLESS,
                            next,
                            message,
                            "add `if`, or wait with `after`",
                        );
                    }
                    break;
                }
                if followed[next as usize] {
                    break;
                }
                way.push(next);
            }
            way.iter().for_each(|state| followed[*state as usize] = true);
        }
    }

    /// The state that is active at once after `state` was entered, where that is certain.
    fn at_once(&self, state: StateId) -> Option<StateId> {
        let [always] = self.program.state(state).always[..] else { return None };
        let transition = &self.program.transitions[always as usize];
        let ([target], None) = (&transition.targets[..], &transition.guard) else { return None };
        let mut at = *target;
        // A composite is entered at its initial state, unless it leaves at once itself.
        while let Kind::Composite { initial } = &self.program.state(at).kind {
            let [inner] = initial.targets[..] else { break };
            at = inner;
        }
        Some(at)
    }
}

/// What is suspicious in a chart as it is written.
fn written(chart: &Chart, taken: &Taken<'_>) -> Vec<Finding> {
    let mut found =
        Written { findings: Findings::new(Arc::clone(&chart.source)), assigned: BTreeSet::new(), taken };
    found.state(&chart.root);
    for time in chart.inputs.iter().chain(&chart.locals).filter(|declared| declared.ty == Type::Duration) {
        if time.default.as_ref().and_then(Value::as_f64).is_some_and(|seconds| seconds < 0.0) {
            let at = place_of(chart, &[Section::Inputs, Section::Locals], &time.name);
            let message = format!("`{}` is a time and begins below 0", time.name);
            let help = Some("times are 0 or more".to_owned());
            found.findings.add(Severity::Warning, code::SUSPICIOUS, at, message, help);
        }
    }
    for output in &chart.outputs {
        if output.default.is_none() && !found.assigned.contains(&output.name) {
            let at = place_of(chart, &[Section::Outputs], &output.name);
            let message = format!("nothing sets the output `{}`", output.name);
            let help = format!("set it with `assign: {{outputs.{}: ...}}`", output.name);
            found.findings.add(Severity::Warning, code::UNSET, at, message, Some(help));
        }
    }
    found.findings.list
}

/// Where an input, local or output is declared.
fn place_of(chart: &Chart, sections: &[Section], name: &str) -> Span {
    let is_it = |(section, declared): &&(Section, Named)| sections.contains(section) && declared.text == name;
    chart.declared.iter().find(is_it).map_or_else(Span::default, |(_, at)| at.span)
}

struct Written<'p> {
    findings: Findings,
    /// Outputs that some action sets.
    assigned: BTreeSet<String>,
    taken: &'p Taken<'p>,
}

impl Written<'_> {
    fn state(&mut self, state: &model::State) {
        self.values(&state.with);
        self.actions(&state.enter);
        self.actions(&state.exit);
        for transition in state.transitions.iter().chain(&state.always).chain(&state.after) {
            self.values(&transition.with);
            self.actions(&transition.actions);
        }
        if let model::Kind::Composite { initial: entry, .. } | model::Kind::History { default: entry, .. } =
            &state.kind
        {
            self.actions(&entry.actions);
        }
        state.kind.children().iter().for_each(|child| self.state(child));
    }

    fn actions(&mut self, actions: &[Action]) {
        for action in actions {
            match &action.kind {
                ActionKind::Assign(entries) => {
                    for (name, _) in entries {
                        let output = name.text.strip_prefix("outputs.").unwrap_or(&name.text);
                        self.assigned.insert(output.split('.').next().unwrap_or(output).to_owned());
                    }
                    self.values(entries);
                }
                ActionKind::Raise { event, data } => {
                    self.heard(event);
                    data.iter().for_each(|node| self.value(node));
                }
                ActionKind::Send { event, to, data, .. } => {
                    if to.is_none() {
                        self.heard(event);
                    }
                    data.iter().for_each(|node| self.value(node));
                }
                ActionKind::If { then, otherwise, .. } => {
                    self.actions(then);
                    self.actions(otherwise);
                }
                ActionKind::Foreach { body, .. } => self.actions(body),
                ActionKind::Cancel(_) | ActionKind::Log(_) => {}
            }
        }
    }

    /// An event that is raised here must be taken by someone.
    fn heard(&mut self, event: &Named) {
        if !self.taken.takes(&event.text) {
            let message = format!("nobody takes the event `{}`", event.text);
            let help = format!("add `transitions: {{{}: ...}}` where it matters", event.text);
            self.findings.add(Severity::Warning, code::UNHEARD, event.span, message, Some(help));
        }
    }

    fn values(&mut self, entries: &[(Named, Node)]) {
        entries.iter().for_each(|(_, node)| self.value(node));
    }

    /// A text that looks like an expression without its `${}`.
    fn value(&mut self, node: &Node) {
        match &node.value {
            Yaml::String(text) => {
                let text = text.trim();
                let braces = text.strip_prefix("{{").and_then(|inner| inner.strip_suffix("}}"));
                let inner = braces.map(str::trim).or_else(|| is_path(text).then_some(text));
                if let Some(inner) = inner {
                    let message = format!("`{text}` is a text here, not an expression");
                    let help = format!("write `\"${{{inner}}}\"` if its value is meant");
                    self.findings.add(Severity::Warning, code::SUSPICIOUS, node.span, message, Some(help));
                }
            }
            Yaml::List(items) => items.iter().for_each(|item| self.value(item)),
            Yaml::Map(entries) => self.values(entries),
            _ => {}
        }
    }
}

/// `inputs.force`, `channels.wrist.push`.
fn is_path(text: &str) -> bool {
    let Some((first, rest)) = text.split_once('.') else { return false };
    matches!(first, "inputs" | "locals" | "outputs" | "channels" | "event")
        && rest.split('.').all(super::read::is_name)
}
