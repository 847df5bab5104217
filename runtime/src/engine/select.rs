//! Selects the transitions that an event takes: inner states first, then the order in the file. Also handles events
//! that no transition takes.

use armarium_values::Value;

use super::event::{Event, Origin};
use super::state::{Microstep, RunContext, Turn};
use super::{Engine, TraceItem};
use crate::program::{EventNumber, FAILURE, Pattern, Program, StateId};

impl Engine {
    /// Handles one event: selects transitions, or applies the rule for events that no transition takes.
    pub(super) fn dispatch(&mut self, event: Event, turn: &mut Turn<'_>) {
        if let Some((state, entry)) = event.scope() {
            let run = &self.runs[state as usize];
            if !run.active || run.entry != entry {
                turn.trace(|p| TraceItem::Dropped {
                    name: event.name(p).to_owned(),
                    reason: format!("`{}` has been left meanwhile", p.path(state)),
                });
                return;
            }
        }
        turn.trace(|p| TraceItem::Event {
            name: event.name(p).to_owned(),
            from: event.scope().map(|(state, _)| p.path(state).to_owned()),
            data: event.data().clone(),
        });
        let (number, origin) = (event.number, event.origin);
        let ended = self.note_outcome(&event, turn.program);
        let served = self.store.event.insert(event).take_served();
        match origin {
            Origin::Retry { state, .. } => self.begin_again(state, turn),
            Origin::Broadcast | Origin::Error(_) => {
                let taken = self.select(Some(number), &served, turn);
                if taken.is_empty() {
                    self.enabled = taken;
                    self.unhandled(origin, turn);
                } else {
                    self.begin_unless_held(Microstep::Take(taken), turn);
                }
            }
            Origin::After { transition, .. } => {
                if self.guard(transition, turn) {
                    self.begin_unless_held(Microstep::Take(vec![transition]), turn);
                }
            }
            Origin::Outcome { state, .. } | Origin::Watch { state, .. } => {
                match self.select_outward(number, origin, state, turn) {
                    Some(step) => self.begin_unless_held(step, turn),
                    None => self.unhandled(origin, turn),
                }
            }
        }
        if ended {
            self.release_held();
        }
    }

    /// Records an outcome. Returns whether an unbreakable state has ended by itself.
    fn note_outcome(&mut self, event: &Event, program: &Program) -> bool {
        let Origin::Outcome { state, .. } = event.origin else { return false };
        if event.is_failure() {
            self.last_failure = Some((event.data().clone(), state));
        }
        let unbreakable = program.state(state).unbreakable;
        if unbreakable {
            self.extra(state).ended = true;
        }
        unbreakable
    }

    /// Searches the transitions of the state that an event belongs to, then of the states around it. A failure
    /// first restarts a state with retries left.
    fn select_outward(
        &mut self,
        number: EventNumber,
        origin: Origin,
        from: StateId,
        turn: &mut Turn<'_>,
    ) -> Option<Microstep> {
        let failure = number == FAILURE && matches!(origin, Origin::Outcome { .. });
        // The end of a region is not offered to the states around it: the parallel state ends when all its regions
        // have ended. Only a failure that did not come from a final state of the region goes outward.
        let own_only = match origin {
            Origin::Outcome { region_end, .. } => turn.program.state(from).region && (region_end || !failure),
            _ => false,
        };
        let program = turn.program;
        for state in program.outward(from) {
            if failure && self.retry_left(state, program) {
                return Some(Microstep::Restart(state));
            }
            for (_, t) in program.tables.exact(state, number) {
                if self.guard(*t, turn) {
                    return Some(Microstep::Take(vec![*t]));
                }
            }
            if own_only {
                break;
            }
        }
        None
    }

    fn retry_left(&self, state: StateId, program: &Program) -> bool {
        let retry = program.state(state).retry;
        retry.is_some_and(|(times, _)| self.extra_of(state).map_or(0, |e| e.retries) < times)
    }

    fn unhandled(&mut self, origin: Origin, turn: &mut Turn<'_>) {
        match origin {
            Origin::Error(state) => {
                // The failed action may itself have left the state that the error came from.
                let here = turn.program.outward(state).find(|s| self.runs[*s as usize].active);
                let data = self.store.event.as_ref().map(|e| e.data().clone()).unwrap_or_default();
                self.push_failure(here.unwrap_or(0), data, turn.program);
            }
            Origin::Outcome { state, region_end, .. } => {
                let Some(event) = self.store.event.clone() else { return };
                if !event.is_failure() || region_end {
                    return self.mark_done(state, &event, turn);
                }
                match self.unbreakable_inside(0, state, turn.program) {
                    Some(holder) => self.hold(event, holder, state, turn),
                    None => self.fail_run(&event, state, turn),
                }
            }
            Origin::Broadcast => {
                let Some(event) = &self.store.event else { return };
                // Every end raises one of these, for those who wait for it.
                if !event.name(turn.program).starts_with("done.state.") {
                    turn.trace(|p| {
                        let why = event.data().get("reason").and_then(Value::as_str);
                        let why = why.map_or_else(String::new, |why| format!(": {why}"));
                        let reason = format!("no active state takes it{why}");
                        TraceItem::Dropped { name: event.name(p).to_owned(), reason }
                    });
                }
            }
            Origin::Watch { .. } | Origin::After { .. } | Origin::Retry { .. } => {}
        }
    }

    fn fail_run(&mut self, event: &Event, state: StateId, turn: &mut Turn<'_>) {
        let (reason, mut chain) = super::end::reason_and_chain(event.data());
        for around in turn.program.outward(state) {
            let path = turn.program.path(around);
            if !turn.program.is_root(around) && !chain.iter().any(|link| link == path) {
                chain.push(path.to_owned());
            }
        }
        chain.push(turn.program.name.clone());
        self.finish_with("failure".into(), reason, chain, turn);
    }

    /// SCXML's selectEventlessTransitions, taken at once. Returns whether there were any.
    pub(super) fn take_always(&mut self, turn: &mut Turn<'_>) -> bool {
        let mut taken = self.select(None, &[], turn);
        if self.unbreakable > 0 {
            taken.retain(|t| self.holder(*t, turn.program).is_none());
        }
        if taken.is_empty() {
            self.enabled = taken;
            return false;
        }
        self.begin(Microstep::Take(taken), turn);
        true
    }

    /// SCXML's selectTransitions, for the states that are not inside one of `served`; without an event, those that need none.
    fn select(&mut self, event: Option<EventNumber>, served: &[StateId], turn: &mut Turn<'_>) -> Vec<u32> {
        let tables = &turn.program.tables;
        let mut enabled = std::mem::take(&mut self.enabled);
        enabled.clear();
        let selection = self.next_selection();
        let mut at = 0;
        while let Some(leaf) = self.configuration.get(at).copied() {
            at += 1;
            let inner = self.configuration.get(at).is_none_or(|next| *next > tables.last(leaf));
            if !inner || served.iter().any(|s| turn.program.within(leaf, *s)) {
                continue;
            }
            let mut around = Some(leaf);
            while let Some(state) = around {
                // From here outward, an earlier leaf has already searched, with the same result.
                if std::mem::replace(&mut self.runs[state as usize].seen, selection) == selection {
                    break;
                }
                if let Some(t) = self.first_enabled(state, event, turn) {
                    enabled.push(t);
                    break;
                }
                around = tables.parent(state);
            }
        }
        if enabled.len() > 1 { self.without_conflicts(&enabled, turn.program) } else { enabled }
    }

    pub(super) fn next_selection(&mut self) -> u32 {
        if self.selection == u32::MAX {
            self.runs.iter_mut().for_each(|run| (run.seen, run.filled) = (0, 0));
            self.selection = 0;
        }
        self.selection += 1;
        self.selection
    }

    /// The first transition of a state, in the file's order, that matches and whose guard holds.
    fn first_enabled(
        &mut self,
        state: StateId,
        event: Option<EventNumber>,
        turn: &mut Turn<'_>,
    ) -> Option<u32> {
        let program = turn.program;
        let Some(number) = event else {
            return program.tables.always(state).iter().copied().find(|t| self.guard(*t, turn));
        };
        let exact = program.tables.exact(state, number);
        let wild = program.tables.wild(state);
        if wild.is_empty() {
            return exact.iter().map(|(_, t)| *t).find(|t| self.guard(*t, turn));
        }
        let (mut exact, mut wild) =
            (exact.iter().map(|(_, t)| *t).peekable(), wild.iter().copied().peekable());
        loop {
            // Transition numbers increase in the file's order.
            let next_is_exact = match (exact.peek(), wild.peek()) {
                (Some(a), Some(b)) => a < b,
                (a, _) => a.is_some(),
            };
            let t = if next_is_exact { exact.next()? } else { wild.next()? };
            if (next_is_exact || self.fits(program, t)) && self.guard(t, turn) {
                return Some(t);
            }
        }
    }

    fn fits(&self, program: &Program, transition: u32) -> bool {
        let pattern: &Pattern = &program.transitions[transition as usize].pattern;
        self.store.event.as_ref().is_some_and(|event| pattern.matches(event.name(program)))
    }

    /// SCXML's removeConflictingTransitions: of two transitions that leave the same states, the inner one wins,
    /// else the earlier one.
    fn without_conflicts(&self, enabled: &[u32], program: &Program) -> Vec<u32> {
        let mut kept: Vec<u32> = Vec::new();
        for candidate in enabled.iter().copied() {
            let c = &program.transitions[candidate as usize];
            let domain = self.domain(candidate, program);
            let conflicts = |other: u32| match (domain, self.domain(other, program)) {
                (Some(a), Some(b)) => program.within(a, b) || program.within(b, a),
                _ => false,
            };
            let in_conflict: Vec<u32> = kept.iter().copied().filter(|k| conflicts(*k)).collect();
            let inner = |k: &u32| {
                let other = program.transitions[*k as usize].source;
                c.source != other && program.within(c.source, other)
            };
            if in_conflict.iter().all(inner) {
                kept.retain(|k| !in_conflict.contains(k));
                kept.push(candidate);
            }
        }
        kept
    }

    /// Whether a transition's guard holds. A guard that fails to evaluate counts as false and raises
    /// `error.execution`.
    #[inline]
    pub(super) fn guard(&mut self, transition: u32, turn: &mut Turn<'_>) -> bool {
        if !turn.program.tables.jump(transition).guarded {
            return true;
        }
        let t = &turn.program.transitions[transition as usize];
        let Some(code) = &t.guard else { return true };
        let view =
            RunContext { program: turn.program, store: &self.store, runs: &self.runs, sensors: turn.sensors };
        match turn.program.test(code, &view) {
            Ok(holds) => holds,
            Err(error) => {
                self.error(t.source, &error.message, code.place, turn);
                false
            }
        }
    }
}
