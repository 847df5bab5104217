//! Which transitions an event takes: inner states first, then the order in the file; what unbreakable states hold
//! back; what happens to events that nobody takes.

use super::program::{Pattern, StateId};
use super::{Engine, Event, MAX_HELD, Origin, Step, TraceItem, Turn};

/// Why a state's event goes the way it goes.
enum Found {
    Nothing,
    Step(Step),
}

impl Engine {
    /// Takes one event: chooses transitions, or does with it what happens to events that nobody takes.
    pub(super) fn dispatch(&mut self, event: Event, turn: &mut Turn<'_>) {
        if let Some((state, entry)) = event.scope() {
            let run = &self.runs[state as usize];
            if !run.active || run.entry != entry {
                let reason = format!("`{}` has been left meanwhile", self.program.state(state).path);
                turn.trace(TraceItem::Dropped { name: event.name.to_string(), reason });
                return;
            }
        }
        let from = event.scope().map(|(state, _)| self.program.state(state).path.clone());
        turn.trace(TraceItem::Event { name: event.name.to_string(), from, data: event.data.clone() });
        self.store.event = Some(event.clone());
        if let Origin::Retry { state, .. } = event.origin {
            self.begin_again(state, turn);
            return;
        }
        let ended = match event.origin {
            Origin::Outcome { state, .. } => {
                self.runs[state as usize].ended = true;
                if event.is_failure() {
                    self.last_failure = Some((event.data.clone(), state));
                }
                self.program.state(state).unbreakable
            }
            _ => false,
        };
        let found = match event.origin {
            Origin::Broadcast | Origin::Error(_) => {
                let taken = self.select_broadcast(&event, turn);
                if taken.is_empty() { Found::Nothing } else { Found::Step(Step::Take(taken)) }
            }
            Origin::After { transition, .. } => {
                if self.guard(transition, turn) {
                    Found::Step(Step::Take(vec![transition]))
                } else {
                    Found::Nothing
                }
            }
            Origin::Outcome { state, .. } | Origin::Watch { state, .. } => {
                self.select_outward(&event, state, turn)
            }
            Origin::Retry { .. } => Found::Nothing,
        };
        match found {
            Found::Step(step) => self.begin_unless_held(step, event, turn),
            Found::Nothing => self.unhandled(event, turn),
        }
        if ended {
            self.release_held();
        }
    }

    /// What unbreakable states held back is matched again.
    pub(super) fn release_held(&mut self) {
        self.internal.extend(self.held.drain(..));
    }

    fn begin_unless_held(&mut self, step: Step, event: Event, turn: &mut Turn<'_>) {
        let (step, holder) = match step {
            Step::Take(transitions) => {
                let holders: Vec<Option<StateId>> = transitions.iter().map(|t| self.holder(*t)).collect();
                let holder = holders.iter().flatten().next().copied();
                let free = transitions.iter().zip(&holders).filter(|(_, h)| h.is_none());
                let free: Vec<u32> = free.map(|(t, _)| *t).collect();
                ((!free.is_empty()).then_some(Step::Take(free)), holder)
            }
            Step::Restart(state) => match self.unbreakable_inside(state, state) {
                Some(holder) => (None, Some(holder)),
                None => (Some(Step::Restart(state)), None),
            },
            finish @ Step::Finish { .. } => (Some(finish), None),
        };
        if let Some(holder) = holder {
            self.hold(event.clone(), holder, turn);
        }
        if let Some(step) = step {
            self.begin(step, Some(event), turn);
        }
    }

    fn hold(&mut self, event: Event, holder: StateId, turn: &mut Turn<'_>) {
        let (name, state) = (event.name.to_string(), self.program.state(holder).path.clone());
        if self.held.len() >= MAX_HELD {
            turn.trace(TraceItem::Dropped {
                name,
                reason: format!("`{state}` holds {MAX_HELD} events back"),
            });
            let origin = Origin::Error(holder);
            self.internal.push_back(Event { name: "error.queue".into(), data: event.data, origin });
        } else {
            turn.trace(TraceItem::Held { name, state });
            self.held.push_back(event);
        }
    }

    /// The unbreakable state that a transition would leave from outside, if there is one.
    fn holder(&self, transition: u32) -> Option<StateId> {
        let transition = &self.program.transitions[transition as usize];
        self.unbreakable_inside(transition.domain?, transition.source)
    }

    /// An active unbreakable state inside `domain` that has not ended and that `source` is not part of.
    fn unbreakable_inside(&self, domain: StateId, source: StateId) -> Option<StateId> {
        let inside =
            self.configuration.iter().copied().filter(|s| *s > domain && self.program.within(*s, domain));
        inside
            .filter(|s| self.program.state(*s).unbreakable && !self.runs[*s as usize].ended)
            .find(|s| !self.program.within(source, *s))
    }

    /// Transitions of the state that an event belongs to, then of the states around it. A failure is first tried
    /// again by states that have tries left.
    fn select_outward(&mut self, event: &Event, from: StateId, turn: &mut Turn<'_>) -> Found {
        let own_only = self.concerns_region_only(event, from);
        let program = std::sync::Arc::clone(&self.program);
        for state in program.outward(from) {
            if event.is_failure() && self.retry_left(state) {
                return Found::Step(Step::Restart(state));
            }
            for t in &program.state(state).transitions {
                if program.transitions[*t as usize].pattern.is(&event.name) && self.guard(*t, turn) {
                    return Found::Step(Step::Take(vec![*t]));
                }
            }
            if own_only {
                break;
            }
        }
        Found::Nothing
    }

    /// A region's own end is not its surroundings' business: the parallel state ends when all regions have. Only
    /// a failure that did not come from a final state of the region goes outward.
    fn concerns_region_only(&self, event: &Event, from: StateId) -> bool {
        match event.origin {
            Origin::Outcome { region_end, .. } => {
                self.program.state(from).region && (region_end || !event.is_failure())
            }
            _ => false,
        }
    }

    fn retry_left(&self, state: StateId) -> bool {
        let retry = self.program.state(state).retry;
        retry.is_some_and(|(times, _)| self.runs[state as usize].retries < times)
    }

    fn unhandled(&mut self, event: Event, turn: &mut Turn<'_>) {
        match event.origin {
            Origin::Error(state) => {
                // The state that it came from may have been left by what failed.
                let program = std::sync::Arc::clone(&self.program);
                let here = program.outward(state).find(|s| self.runs[*s as usize].active);
                self.push_failure(here.unwrap_or(0), event.data);
            }
            Origin::Outcome { state, region_end, .. } => {
                if event.is_failure() && !region_end {
                    if let Some(holder) = self.unbreakable_inside(0, state) {
                        self.hold(event, holder, turn);
                        return;
                    }
                    self.fail_run(&event, state, turn);
                } else {
                    self.mark_done(state, &event, turn);
                }
            }
            Origin::Broadcast | Origin::Watch { .. } | Origin::After { .. } | Origin::Retry { .. } => {}
        }
    }

    fn fail_run(&mut self, event: &Event, state: StateId, turn: &mut Turn<'_>) {
        let (reason, mut chain) = super::end::reason_and_chain(&event.data);
        for around in self.program.outward(state) {
            let s = self.program.state(around);
            if !s.chart_root && around != 0 && !chain.contains(&s.path) {
                chain.push(s.path.clone());
            }
        }
        chain.push(self.program.name.clone());
        self.finish_with("failure".into(), reason, chain, turn);
    }

    /// SCXML's selectTransitions for an event that all active states see.
    fn select_broadcast(&mut self, event: &Event, turn: &mut Turn<'_>) -> Vec<u32> {
        let event_name = event.name.clone();
        self.select(turn, |state| &state.transitions, &|pattern| pattern.matches(&event_name))
    }

    /// SCXML's selectEventlessTransitions.
    pub(super) fn select_always(&mut self, turn: &mut Turn<'_>) -> Vec<u32> {
        let found = self.select(turn, |state| &state.always, &|_| true);
        found.into_iter().filter(|t| self.holder(*t).is_none()).collect()
    }

    fn select(
        &mut self,
        turn: &mut Turn<'_>,
        list: fn(&super::program::State) -> &Vec<u32>,
        fits: &dyn Fn(&Pattern) -> bool,
    ) -> Vec<u32> {
        let program = std::sync::Arc::clone(&self.program);
        let mut enabled: Vec<u32> = Vec::new();
        // States whose transitions were already looked at from an earlier leaf, with what they gave.
        let mut looked: Vec<(StateId, Option<u32>)> = Vec::new();
        let mut at = 0;
        while at < self.configuration.len() {
            let leaf = self.configuration[at];
            let next = self.configuration.get(at + 1).copied();
            at += 1;
            if next.is_some_and(|n| n <= program.state(leaf).last) {
                continue;
            }
            for state in program.outward(leaf) {
                let transitions = list(program.state(state));
                if transitions.is_empty() {
                    continue;
                }
                let known = looked.iter().find(|(s, _)| *s == state).map(|(_, found)| *found);
                let found = known.unwrap_or_else(|| {
                    let fitting = |t: &&u32| fits(&program.transitions[**t as usize].pattern);
                    let found = transitions.iter().filter(fitting).find(|t| self.guard(**t, turn)).copied();
                    looked.push((state, found));
                    found
                });
                if let Some(t) = found {
                    if !enabled.contains(&t) {
                        enabled.push(t);
                    }
                    break;
                }
            }
        }
        self.without_conflicts(enabled)
    }

    /// SCXML's removeConflictingTransitions: of two that leave the same states, the inner one wins, else the
    /// earlier one.
    fn without_conflicts(&self, enabled: Vec<u32>) -> Vec<u32> {
        if enabled.len() < 2 {
            return enabled;
        }
        let mut kept: Vec<u32> = Vec::new();
        for candidate in enabled {
            let c = &self.program.transitions[candidate as usize];
            let conflicts = |other: u32| {
                let o = &self.program.transitions[other as usize];
                match (c.domain, o.domain) {
                    (Some(a), Some(b)) => self.program.within(a, b) || self.program.within(b, a),
                    _ => false,
                }
            };
            let in_conflict: Vec<u32> = kept.iter().copied().filter(|k| conflicts(*k)).collect();
            let inner = |k: &u32| {
                let other = self.program.transitions[*k as usize].source;
                c.source != other && self.program.within(c.source, other)
            };
            if in_conflict.iter().all(inner) {
                kept.retain(|k| !in_conflict.contains(k));
                kept.push(candidate);
            }
        }
        kept
    }

    /// Whether a transition's guard holds; one that fails is false and raises `error.execution`.
    pub(super) fn guard(&mut self, transition: u32, turn: &mut Turn<'_>) -> bool {
        let program = std::sync::Arc::clone(&self.program);
        let transition = &program.transitions[transition as usize];
        transition.guard.as_ref().is_none_or(|code| {
            let view = super::View { store: &self.store, runs: &self.runs, sensors: turn.sensors };
            match code.expr.test(&view) {
                Ok(holds) => holds,
                Err(error) => {
                    self.error(transition.source, &error.message, code.place, turn);
                    false
                }
            }
        })
    }
}
