//! What is wrong with a chart as a whole: events that nobody raises, outcomes that nobody handles, states that
//! cannot be reached, transitions that cannot fire, limbs with two commanders.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use armarium_source::{Finding, Findings, Remedy, Severity, Span, code};
use armarium_values::expr::nearest;

use super::early::early;
use super::flatten::{Inside, Tree};
use super::library::Library;
use super::model::{self, ActionKind};
use super::scope::{MAX_HELP, MAX_NAMES};
use super::scoped::{Scoped, can_end, reached, scoped};
use crate::program::limbs::Limbs;
use crate::program::{Kind, Pattern, Program, State, StateId};

/// What is wrong with a program as a whole. Where names of states are `unknown`, what cannot be reached is not known
/// either.
pub(super) fn lint(program: &Program, tree: &Tree<'_>, library: &Library, unknown: bool) -> Vec<Finding> {
    let mut lint = Lint { program, tree, findings: Vec::new() };
    let scoped = scoped(program);
    let reached = if unknown { vec![true; program.states.len()] } else { reached(program) };
    let misspelt = lint.unknown_events(&scoped, &reached, library);
    lint.unhandled(&scoped, &misspelt);
    if !unknown {
        lint.unreachable(&reached);
        lint.findings.extend(early(program));
    }
    lint.shadowed();
    lint.limbs();
    lint.findings
}

/// What other languages call outcomes.
const OUTCOMES: [(&str, &[&str]); 2] = [
    ("failure", &["failed", "fail", "error", "aborted", "abort", "Failure", "FAILURE", "onError"]),
    ("success", &["succeeded", "done", "ok", "finished", "completed", "Success", "SUCCESS", "onDone"]),
];

struct Lint<'a, 'l> {
    program: &'a Program,
    tree: &'a Tree<'l>,
    findings: Vec<Finding>,
}

impl Lint<'_, '_> {
    fn add(
        &mut self,
        severity: Severity,
        code: &'static str,
        state: StateId,
        span: Span,
        text: String,
        help: Option<String>,
    ) {
        let source = Arc::clone(&self.program.sources[self.program.state(state).place.source as usize]);
        let mut findings = Findings::new(source);
        findings.add(severity, code, span, text, help);
        self.findings.append(&mut findings.list);
    }

    /// How the finding that was added last is put right.
    fn remedy(&mut self, remedy: Option<Remedy>) {
        if let Some(finding) = self.findings.last_mut() {
            finding.remedy = remedy;
        }
    }

    fn name_span(&self, state: StateId) -> Span {
        self.tree.state(state).model.name.span
    }

    /// Events that nobody raises. Returns those that are misspelt: where a transition has them, and what was probably meant.
    fn unknown_events(
        &mut self,
        scoped: &[Scoped<'_>],
        reached: &[bool],
        library: &Library,
    ) -> BTreeSet<(StateId, String)> {
        let mut misspelt = BTreeSet::new();
        // What another agent raises is not known before it was asked.
        let open = |state: &State| matches!(&state.kind, Kind::Skill { manifest } if manifest.open);
        if self.program.states.iter().any(open) {
            return misspelt;
        }
        // A skill or chart that could not be found may end in any way, and raise anything.
        let missing: BTreeSet<StateId> = self.program.ids().filter(|id| self.is_missing(*id)).collect();
        let around: BTreeSet<StateId> = missing.iter().flat_map(|id| self.program.outward(*id)).collect();
        // Sorted in the end: it has an entry for each outcome at each state around.
        let mut seen: Vec<(StateId, &str)> = Vec::new();
        for s in scoped.iter().filter(|s| s.at.is_none_or(|end| reached[end as usize])) {
            let around = if s.own_only { 1 } else { usize::MAX };
            for state in self.program.outward(s.state).take(around) {
                seen.push((state, s.name));
            }
        }
        // A watch whose condition is wrong is not in the program; that its event never comes follows from that.
        let models = self.program.ids().map(|id| (id, self.tree.state(id).model));
        for (id, watch) in models.flat_map(|(id, model)| model.watch.iter().map(move |watch| (id, watch))) {
            seen.extend(self.program.outward(id).map(|state| (state, watch.name.text.as_str())));
        }
        seen.sort_unstable();
        seen.dedup();
        let seen_at = |state: StateId, name: &str| seen.binary_search(&(state, name)).is_ok();
        let errors = ["error.execution", "error.queue", "error.communication", "error.channel"];
        let mut broadcast: BTreeSet<String> = errors.map(str::to_owned).into();
        for chart in library.charts.values() {
            broadcast.extend(chart.events.iter().map(|(event, _)| event.text.clone()));
            raised(&chart.root, &mut broadcast);
        }
        let ends_matter = self.program.transitions.iter().any(|transition| match &transition.pattern {
            Pattern::Exact(event) | Pattern::Prefix(event) => event.starts_with("done"),
            _ => false,
        });
        for id in self.program.ids() {
            let state = self.program.state(id);
            let ends = || missing.contains(&id) || can_end(self.program, id, &|end| reached[end as usize]);
            if ends_matter && ends() {
                broadcast.insert(format!("done.state.{}", state.name));
            }
            if let Kind::Skill { manifest } = &state.kind {
                broadcast.extend(manifest.events.iter().cloned());
            }
        }
        let mut unknown = 0;
        for id in self.program.ids() {
            let model = self.tree.state(id).model;
            for transition in &model.transitions {
                let Some(event) = &transition.event else { continue };
                let text = event.text.as_str();
                let known = match text.strip_suffix(".*") {
                    _ if text == "*" || text == "failure" => true,
                    Some(prefix) => {
                        let longer = format!("{prefix}.");
                        let next = broadcast.range(longer.clone()..).next();
                        broadcast.contains(prefix) || next.is_some_and(|name| name.starts_with(&longer))
                    }
                    None => broadcast.contains(text) || seen_at(id, text),
                };
                if known || around.contains(&id) {
                    continue;
                }
                if let Some((message, help)) = self.end_that_never_comes(id, text) {
                    // A transition may stand there for an end that must not come.
                    let (severity, code) = match text {
                        "success" => (Severity::Error, code::EVENT),
                        _ => (Severity::Warning, code::ENDLESS),
                    };
                    self.add(severity, code, id, event.span, message, Some(help));
                    continue;
                }
                unknown += 1;
                let few = if unknown <= MAX_HELP { MAX_NAMES } else { 0 };
                let (from, to) = (seen.partition_point(|s| s.0 < id), seen.partition_point(|s| s.0 <= id));
                let near = seen[from..to].iter().map(|(_, name)| *name);
                let candidates = near.chain(broadcast.iter().map(String::as_str)).take(few);
                let near = nearest(text, candidates.chain(["failure"])).map(str::to_owned);
                let said =
                    OUTCOMES.iter().find(|(_, words)| words.contains(&text)).map(|(outcome, _)| *outcome);
                let comes = |outcome: &&str| *outcome == "failure" || seen_at(id, outcome);
                let near = said.filter(comes).map(str::to_owned).or(near);
                let message = format!("nobody raises the event `{text}` here");
                let (help, remedy) = match near {
                    Some(near) => {
                        misspelt.insert((id, near.clone()));
                        (format!("did you mean `{near}`?"), Remedy::replace(event.span, near))
                    }
                    None => {
                        let (key, value) = (text.to_owned(), "{}".to_owned());
                        let declare = Remedy::Add { owner: None, sections: vec!["events"], key, value };
                        ("events from outside are declared under `events:`".to_owned(), declare)
                    }
                };
                self.add(Severity::Error, code::EVENT, id, event.span, message, Some(help));
                // A pattern names no event that could be declared.
                self.remedy((!text.contains('*')).then_some(remedy));
            }
        }
        misspelt
    }

    /// What is said of an event that only the end of a state raises, where that end cannot come; and what to do about it.
    fn end_that_never_comes(&self, at: StateId, event: &str) -> Option<(String, String)> {
        let program = self.program;
        let done = event.strip_prefix("done.state.");
        let of = match done {
            Some(name) => self.program.ids().find(|id| program.state(*id).name == name)?,
            None if event == "success" => at,
            None => return None,
        };
        let name = &program.state(of).name;
        let ends = |id: StateId| matches!(program.state(id).kind, Kind::Final { .. });
        // The inside of a state that uses a chart is the chart's.
        let inside = match program.state(of).kind {
            Kind::Chart { .. } => program.state(of).children.first().copied().unwrap_or(of),
            _ => of,
        };
        let (why, help) = match program.state(inside).kind {
            Kind::Parallel => (
                "has a region that never ends",
                "give each region a final state, or leave it by another event",
            ),
            Kind::Atomic => (
                "runs nothing that could end",
                "give it a `skill`, or leave it by `after`, a `watch` or an event",
            ),
            _ if program.state(inside).children.iter().any(|child| ends(*child)) => (
                "has no final state that gives it and can be reached",
                "lead a transition to a state `{final: success}` inside, or leave it by another event",
            ),
            _ => (
                "has no final state",
                "give it one, as `Done: {final: success}`, or leave it by another event",
            ),
        };
        Some((format!("`{name}` {why}, so `{event}` never comes"), help.to_owned()))
    }

    /// Whether a state names a skill or a chart that could not be found.
    fn is_missing(&self, state: StateId) -> bool {
        let flat = self.tree.state(state);
        let names = matches!(
            flat.model.kind,
            model::WrittenKind::Skill(_) | model::WrittenKind::Chart(_) | model::WrittenKind::Remote(_)
        );
        names && matches!(flat.inside, Inside::Nothing)
    }

    fn unhandled(&mut self, scoped: &[Scoped<'_>], misspelt: &BTreeSet<(StateId, String)>) {
        let mut said = BTreeSet::new();
        for s in scoped {
            if s.state == 0 || s.own_only || s.name == "failure" {
                continue;
            }
            let Program { tables, event_names, .. } = self.program;
            let taken = event_names.find(s.name).is_some_and(|number| {
                self.program.outward(s.state).any(|state| !tables.exact(state, number).is_empty())
            });
            let meant = || {
                let named = |state| misspelt.contains(&(state, s.name.to_owned()));
                !misspelt.is_empty() && self.program.outward(s.state).any(named)
            };
            if taken || !said.insert((s.state, s.name)) || meant() {
                continue;
            }
            let name = &self.program.state(s.state).name;
            let (code, message, help, remedy) = if s.watch {
                let watches = &self.tree.state(s.state).model.watch;
                let watch = watches.iter().find(|watch| watch.name.text == s.name);
                let remedy = watch.map(|watch| Remedy::Remove(watch.name.span));
                let message = format!("nobody takes what the watch `{}` of `{name}` sees", s.name);
                (code::UNUSED, message, None, remedy)
            } else {
                let help =
                    format!("`{name}` stays active when it ends so; add `transitions: {{{}: ...}}`", s.name);
                let message = format!("nobody handles the outcome `{}` of `{name}`", s.name);
                (code::UNHANDLED, message, Some(help), self.handler(s))
            };
            self.add(Severity::Warning, code, s.state, self.name_span(s.state), message, help);
            self.remedy(remedy);
        }
    }

    /// A transition for an outcome: to where a failure of the state leads, or else to a final state beside it.
    fn handler(&self, outcome: &Scoped<'_>) -> Option<Remedy> {
        let model = self.tree.state(outcome.state).model;
        let failure =
            model.transitions.iter().find(|t| t.event.as_ref().is_some_and(|e| e.text == "failure"));
        let to = failure.and_then(|t| t.targets.first()).map(|target| target.text.clone()).or_else(|| {
            let beside = &self.program.state(self.program.state(outcome.state).parent?).children;
            let is_final = |id: &&StateId| matches!(self.program.state(**id).kind, Kind::Final { .. });
            let mut finals = beside.iter().filter(is_final).map(|id| &self.program.state(*id).name);
            let first = finals.next()?;
            let wanted =
                if outcome.name == "success" { Some(first) } else { finals.next_back().or(Some(first)) };
            wanted.cloned()
        })?;
        let (key, sections) = (outcome.name.to_owned(), vec!["transitions"]);
        Some(Remedy::Add { owner: Some(model.name.span), sections, key, value: to })
    }

    fn unreachable(&mut self, reached: &[bool]) {
        for id in self.program.ids() {
            let parent = self.program.state(id).parent.unwrap_or(0);
            if !reached[id as usize] && reached[parent as usize] {
                let message = format!("the state `{}` cannot be reached", self.program.state(id).name);
                self.add(Severity::Warning, code::UNREACHABLE, id, self.name_span(id), message, None);
                self.remedy(Some(Remedy::Remove(self.name_span(id))));
            }
        }
    }

    fn shadowed(&mut self) {
        for id in self.program.ids() {
            let model = self.tree.state(id).model;
            let lists = [&model.transitions, &model.always];
            for list in lists {
                // Events that a transition without a condition takes; outcomes and watches are taken by name only.
                let (mut exact, mut prefixes) = (BTreeSet::new(), BTreeSet::new());
                for transition in list {
                    let text = transition.event.as_ref().map_or("", |e| e.text.as_str());
                    let plain = text.strip_suffix(".*").unwrap_or(text);
                    let mut starts = plain.match_indices('.').map(|(at, _)| &plain[..at]).chain([plain]);
                    if exact.contains(text)
                        || !text.is_empty() && starts.any(|start| prefixes.contains(start))
                    {
                        let message = "this transition cannot fire: one before it always does".into();
                        self.add(Severity::Warning, code::SHADOWED, id, transition.span, message, None);
                        self.remedy(transition.event.as_ref().map(|event| Remedy::Remove(event.span)));
                    }
                    if transition.guard.is_none() && text != "*" {
                        let names = if plain == text { &mut exact } else { &mut prefixes };
                        names.insert(plain);
                    }
                }
            }
        }
    }

    fn limbs(&mut self) {
        let limbs = Limbs::new(self.program, true);
        for id in self.program.ids() {
            let state = self.program.state(id);
            if !matches!(state.kind, Kind::Parallel) {
                continue;
            }
            let mut commander: BTreeMap<&str, (StateId, StateId)> = BTreeMap::new();
            for region in state.children.clone() {
                for inner in region..=self.program.state(region).last {
                    for limb in limbs.of(inner) {
                        let (other_region, other) = *commander.entry(limb).or_insert((region, inner));
                        if other_region == region {
                            continue;
                        }
                        let (a, b) = (&self.program.state(inner).path, &self.program.state(other).path);
                        let message = format!(
                            "`{a}` and `{b}` can command `{limb}` at the same time, from two regions"
                        );
                        self.add(Severity::Error, code::LIMB, inner, self.name_span(inner), message, None);
                    }
                }
            }
        }
    }
}

/// The events that the actions of a state and of those inside raise or send to the chart itself.
pub(super) fn raised(state: &model::WrittenState, names: &mut BTreeSet<String>) {
    let of_transitions = state.transitions.iter().chain(&state.always).chain(&state.after);
    of_transitions.for_each(|t| raised_by(&t.actions, names));
    raised_by(&state.enter, names);
    raised_by(&state.exit, names);
    if let model::WrittenKind::Composite { initial: entry, .. }
    | model::WrittenKind::History { default: entry, .. } = &state.kind
    {
        raised_by(&entry.actions, names);
    }
    state.kind.children().iter().for_each(|child| raised(child, names));
}

fn raised_by(actions: &[model::WrittenAction], names: &mut BTreeSet<String>) {
    for action in actions {
        match &action.kind {
            ActionKind::Raise { event, .. } | ActionKind::Send { event, to: None, .. } => {
                names.insert(event.text.clone());
            }
            ActionKind::If { then, otherwise, .. } => {
                raised_by(then, names);
                raised_by(otherwise, names);
            }
            ActionKind::Foreach { body, .. } => raised_by(body, names),
            _ => {}
        }
    }
}
