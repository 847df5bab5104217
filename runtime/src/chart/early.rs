//! Outputs that are read too early: `Sibling.output` where no way through the chart has let the sibling end before.
//!
//! What is said is certain. A state may have ended before another is entered if some transition leads from it, or from
//! a state around it, to the other, whatever the conditions on the way; only where none does it is an error. What this
//! does not prove is an `error.execution` when it runs.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::{Finding, Findings, Span, code};

use crate::program::{Action, Binding, Code, Kind, Program, State, StateId, Term};

/// States that all searches together may visit; after that nothing more is proven.
const MAX_VISITS: usize = 4_000_000;

/// When an expression is evaluated.
#[derive(Clone, Copy, PartialEq)]
enum When {
    Entering,
    Active,
}

/// An error for each expression that cannot have the output that it reads.
pub(super) fn early(program: &Program) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut owners = BTreeMap::new();
    for (id, state) in (0..).zip(&program.states) {
        owners.extend(state.outputs.iter().map(|(name, slot)| (*slot, (id, name.as_str()))));
    }
    if owners.is_empty() {
        return findings;
    }
    let marked = vec![0; program.states.len()];
    let followed = marked.clone();
    let mut search = EndSearch { program, marked, followed, mark: 0, visits: 0, waiting: Vec::new() };
    for (id, state) in (0..).zip(&program.states) {
        let mut reads = Vec::new();
        collect(program, state, &mut |code, when| {
            let slots = code.expr.reads().slots.iter();
            reads.extend(slots.filter_map(|slot| Some((owners.get(slot)?, code.place, when))));
        });
        for ((owner, output), place, when) in reads {
            let possible = match when {
                When::Entering => *owner != id && search.may_end_before(*owner, id),
                When::Active => search.related(*owner, id) || search.may_end_before(*owner, id),
            };
            if possible {
                continue;
            }
            let source = Arc::clone(&program.sources[place.source as usize]);
            let name = format!("{}.{output}", program.name_of(*owner));
            let start = place.byte as usize;
            let line = source.text[start..].lines().next().unwrap_or("");
            let start = start + line.find(&name).unwrap_or(0);
            let span = Span { start, end: start + name.len() };
            let message =
                format!("`{name}` has no value here: nothing lets `{}` end before", program.name_of(*owner));
            let help =
                format!("a state that `{}` leads to when it has ended can read it", program.name_of(*owner));
            let mut found = Findings::new(source);
            found.error_help(code::EARLY, span, message, Some(help));
            findings.append(&mut found.list);
        }
    }
    findings
}

struct EndSearch<'p> {
    program: &'p Program,
    /// The newest search that has visited a state.
    marked: Vec<u32>,
    /// The newest search that has followed the transitions of a state.
    followed: Vec<u32>,
    mark: u32,
    visits: usize,
    /// States that may be entered, to be looked at.
    waiting: Vec<StateId>,
}

impl EndSearch<'_> {
    /// Whether one is inside the other, or both may be active together.
    fn related(&self, a: StateId, b: StateId) -> bool {
        let meet = self.program.outward(a).find(|s| self.program.within(b, *s)).unwrap_or(0);
        meet == a || meet == b || matches!(self.program.state(meet).kind, Kind::Parallel)
    }

    /// Whether `then` may be entered after `owner` has ended.
    fn may_end_before(&mut self, owner: StateId, then: StateId) -> bool {
        let program = self.program;
        if owner != then && self.related(owner, then) {
            return true;
        }
        self.mark += 1;
        self.waiting.clear();
        let mut found = program.outward(owner).any(|around| self.leads_to(around, then));
        while let Some(state) = self.waiting.pop() {
            if found || self.visits > MAX_VISITS {
                return true;
            }
            if std::mem::replace(&mut self.marked[state as usize], self.mark) == self.mark {
                continue;
            }
            self.visits += 1;
            // A state of another region may be entered while `state` is active.
            let beside =
                |s: StateId| matches!(program.state(s).kind, Kind::Parallel) && program.within(then, s);
            found = state == then
                || program.outward(state).any(beside)
                || self.inside(state, then)
                || program.outward(state).any(|around| self.leads_to(around, then));
        }
        found
    }

    /// Follows the transitions of a state, and its next try. Gives whether `then` is entered on the way.
    fn leads_to(&mut self, state: StateId, then: StateId) -> bool {
        let program = self.program;
        if std::mem::replace(&mut self.followed[state as usize], self.mark) == self.mark {
            return false;
        }
        let of = program.state(state);
        self.visits += 1 + of.transitions.len();
        let mut found = false;
        for t in of.transitions.iter().chain(&of.always).chain(&of.after) {
            let t = &program.transitions[*t as usize];
            let domain = t.domain.unwrap_or(0);
            t.targets.iter().for_each(|target| found |= self.entered(*target, domain, then));
        }
        found || of.retry.is_some() && self.inside(state, then)
    }

    /// A target is entered, with the states around it up to `domain`.
    fn entered(&mut self, target: StateId, domain: StateId, then: StateId) -> bool {
        let program = self.program;
        self.waiting.push(target);
        let mut found = false;
        for around in program.outward(target).skip(1).take_while(|s| *s != domain) {
            found |= around == then;
            if matches!(program.state(around).kind, Kind::Parallel) {
                self.waiting.extend(&program.state(around).children);
            }
        }
        found
    }

    /// What is entered with a state.
    fn inside(&mut self, state: StateId, then: StateId) -> bool {
        let program = self.program;
        let of = program.state(state);
        match &of.kind {
            Kind::Composite { initial } => {
                let mut found = false;
                initial.targets.iter().for_each(|target| found |= self.entered(*target, state, then));
                found
            }
            Kind::Parallel | Kind::Chart { .. } => {
                self.waiting.extend(&of.children);
                false
            }
            Kind::History { default, .. } => {
                self.waiting.extend(&default.targets);
                let parent = of.parent.unwrap_or(0);
                self.waiting.extend(parent + 1..=program.tables.last(parent));
                false
            }
            _ => false,
        }
    }
}

/// All expressions of a state, and when they are evaluated.
fn collect(program: &Program, state: &State, take: &mut dyn FnMut(&Code, When)) {
    let entering = &mut |code: &Code| take(code, When::Entering);
    in_bindings(&state.with, entering);
    in_actions(&state.enter, entering);
    for t in &state.after {
        program.transitions[*t as usize].delay.iter().for_each(|delay| in_term(delay, entering));
    }
    let active = &mut |code: &Code| take(code, When::Active);
    in_actions(&state.exit, active);
    for watch in &state.watches {
        let watch = &program.watches[*watch as usize];
        active(&watch.condition);
        watch.until.iter().for_each(&mut *active);
    }
    for t in state.transitions.iter().chain(&state.always).chain(&state.after) {
        let t = &program.transitions[*t as usize];
        t.guard.iter().for_each(&mut *active);
        in_actions(&t.actions, active);
        in_bindings(&t.with, active);
    }
}

fn in_bindings(bindings: &[Binding], take: &mut dyn FnMut(&Code)) {
    bindings.iter().for_each(|binding| in_term(&binding.term, take));
}

fn in_term(term: &Term, take: &mut dyn FnMut(&Code)) {
    match term {
        Term::Literal(_) => {}
        Term::Expr(code) => take(code),
        Term::Text(terms) | Term::List(terms) => terms.iter().for_each(|term| in_term(term, take)),
        Term::Map(entries) => entries.iter().for_each(|(_, term)| in_term(term, take)),
    }
}

fn in_actions(actions: &[Action], take: &mut dyn FnMut(&Code)) {
    for action in actions {
        match action {
            Action::Assign { term, .. } | Action::Log { term } => in_term(term, take),
            Action::Raise { data, .. } => data.iter().for_each(|term| in_term(term, take)),
            Action::Send(send) => {
                let terms = [&send.to, &send.data, &send.delay];
                terms.into_iter().flatten().for_each(|term| in_term(term, take));
            }
            Action::Cancel { .. } => {}
            // What is behind a condition, or repeated, may never be evaluated.
            Action::If { condition, .. } => take(condition),
            Action::Foreach { items, .. } => in_term(items, take),
        }
    }
}
