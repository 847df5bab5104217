//! Unbreakable states hold back transitions that would leave them from outside, until they have ended.

use super::event::{Event, Origin};
use super::state::{Microstep, Turn};
use super::{Engine, MAX_HELD, TraceItem};
use crate::program::{ERROR_QUEUE, Program, StateId};

impl Engine {
    /// Queues the held events again, so that they are matched anew.
    pub(super) fn release_held(&mut self) {
        self.internal.extend(self.held.drain(..));
    }

    /// Begins the part of a step that may begin. If a transition would leave an unbreakable state, it is held
    /// together with its event. Transitions for the same event in other regions are not held.
    pub(super) fn begin_unless_held(&mut self, step: Microstep, turn: &mut Turn<'_>) {
        if self.unbreakable == 0 {
            return self.begin(step, turn);
        }
        let program = turn.program;
        match step {
            Microstep::Take(transitions) => {
                let (held, free): (Vec<u32>, Vec<u32>) =
                    transitions.into_iter().partition(|t| self.holder(*t, program).is_some());
                if let Some(first) = held.first().copied() {
                    let holder = self.holder(first, program).unwrap_or(0);
                    self.hold_current(holder, program.transitions[first as usize].source, &free, turn);
                }
                if !free.is_empty() {
                    self.begin(Microstep::Take(free), turn);
                }
            }
            Microstep::Restart(state) => match self.unbreakable_inside(state, state, program) {
                Some(holder) => self.hold_current(holder, state, &[], turn),
                None => self.begin(step, turn),
            },
            Microstep::Finish { .. } => self.begin(step, turn),
        }
    }

    /// Holds the current event. It is not offered again to the states that the `free` transitions leave.
    fn hold_current(&mut self, holder: StateId, source: StateId, free: &[u32], turn: &mut Turn<'_>) {
        let Some(mut event) = self.store.event.clone() else { return };
        let moved =
            |t: &u32| self.domain(*t, turn.program).unwrap_or(turn.program.transitions[*t as usize].source);
        event.set_served(free.iter().map(moved).collect());
        self.hold(event, holder, source, turn);
    }

    /// Keeps an event until the unbreakable state `holder` has ended. `source` is the state where it would have
    /// acted.
    pub(super) fn hold(&mut self, event: Event, holder: StateId, source: StateId, turn: &mut Turn<'_>) {
        // A failure is never dropped; there is at most one per state.
        if self.held.len() < MAX_HELD || event.is_failure() {
            turn.trace(|p| TraceItem::Held {
                name: event.name(p).to_owned(),
                state: p.path(holder).to_owned(),
            });
            self.held.push_back(event);
            return;
        }
        let path = turn.program.path(holder);
        let reason = format!("`{path}` holds {MAX_HELD} events back");
        turn.trace(|p| TraceItem::Dropped { name: event.name(p).to_owned(), reason: reason.clone() });
        if !event.is_error(turn.program) {
            let data = armarium_values::Value::record([
                ("reason", reason.into()),
                ("event", event.name(turn.program).into()),
            ]);
            self.internal.push_back(Event::new(ERROR_QUEUE, data, Origin::Error(source)));
        }
    }

    /// The unbreakable state that a transition would leave from outside, if there is one.
    pub(super) fn holder(&self, transition: u32, program: &Program) -> Option<StateId> {
        let source = program.transitions[transition as usize].source;
        self.unbreakable_inside(self.domain(transition, program)?, source, program)
    }

    /// An active unbreakable state inside `domain` that has not ended and does not contain `source`.
    pub(super) fn unbreakable_inside(
        &self,
        domain: StateId,
        source: StateId,
        program: &Program,
    ) -> Option<StateId> {
        if self.unbreakable == 0 {
            return None;
        }
        let (from, to) = self.inside(domain, program);
        let holds =
            |s: &StateId| program.state(*s).unbreakable && !self.extra_of(*s).is_some_and(|e| e.ended);
        self.configuration[from..to].iter().copied().filter(holds).find(|s| !program.within(source, *s))
    }
}
