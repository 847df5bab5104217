//! One microstep: cancel the skills of the states to leave, wait until they have returned, then leave, act and
//! enter.

use std::collections::BTreeSet;
use std::time::Duration;

use super::enter::Entries;
use super::state::{Microstep, Pending, SkillRun, Turn};
use super::{Effect, Engine, TraceItem};
use crate::program::{Kind, Pattern, Program, StateId};

/// Longest duration of a timer, s.
const MAX_DELAY_S: f64 = 1.0e9;

/// Shortest duration of a timer other than zero, s.
const MIN_DELAY_S: f64 = 1.0e-6;

/// A finite, non-negative number of seconds as a duration.
pub(super) fn duration(seconds: f64) -> Duration {
    if seconds.is_finite() && seconds > 0.0 {
        Duration::from_secs_f64(seconds.clamp(MIN_DELAY_S, MAX_DELAY_S))
    } else {
        Duration::ZERO
    }
}

impl Engine {
    /// Begins a microstep: cancels the skills of all states that it leaves. Completes it at once if there are none.
    pub(super) fn begin(&mut self, step: Microstep, turn: &mut Turn<'_>) {
        if turn.tracing {
            self.trace_transitions(&step, turn);
        }
        if self.near_a_bound()
            && let Microstep::Take(transitions) = &step
        {
            transitions.iter().for_each(|t| self.circle.note(turn.program.tables.jump(*t).source));
        }
        let exits = self.exits(&step, turn.program);
        let waiting = if self.skills.is_empty() && self.ready.is_empty() {
            BTreeSet::new()
        } else {
            self.cancel(&exits, turn)
        };
        if waiting.is_empty() {
            return self.complete(step, exits, turn);
        }
        turn.trace(|p| {
            let states = exits.iter().filter(|s| !p.is_root(**s));
            TraceItem::Leaving { states: states.map(|s| p.path(*s).to_owned()).collect() }
        });
        self.pending = Some(Pending { step, exits, waiting });
    }

    fn trace_transitions(&self, step: &Microstep, turn: &mut Turn<'_>) {
        let Microstep::Take(transitions) = step else { return };
        for t in transitions {
            let event = self.store.event.as_ref().map(|e| e.name(turn.program).to_owned());
            turn.trace(|p| {
                let t = &p.transitions[*t as usize];
                let targets: Vec<&str> = t.targets.iter().map(|s| p.path(*s)).collect();
                let always = matches!(t.pattern, Pattern::None) && t.delay.is_none();
                TraceItem::Transition {
                    source: p.path(t.source).to_owned(),
                    event: event.filter(|_| !always),
                    target: (!targets.is_empty()).then(|| targets.join(" ")),
                }
            });
        }
    }

    /// Ends the run in any situation: leaves all states once all skills have returned.
    pub(super) fn finish_with(
        &mut self,
        outcome: String,
        reason: Option<String>,
        chain: Vec<String>,
        turn: &mut Turn<'_>,
    ) {
        self.show_configuration(turn);
        self.ended_in = self.leaves();
        // The pending microstep is dropped. Its cancelled skills are still waited for, as their states are active.
        self.pending = None;
        self.begin(Microstep::Finish { outcome, reason, chain }, turn);
    }

    /// The state inside which a transition leaves and enters states.
    pub(super) fn domain(&self, transition: u32, program: &Program) -> Option<StateId> {
        let jump = program.tables.jump(transition);
        if !jump.historic {
            return Some(jump.domain).filter(|d| *d != StateId::MAX);
        }
        let t = &program.transitions[transition as usize];
        let targets: Vec<StateId> =
            t.targets.iter().flat_map(|target| self.effective(*target, program)).collect();
        Some(program.domain(t.source, t.internal, &targets))
    }

    /// The index range of the configuration with the active states inside `domain`.
    pub(super) fn inside(&self, domain: StateId, program: &Program) -> (usize, usize) {
        let last = program.tables.last(domain);
        let from = self.configuration.partition_point(|s| *s <= domain);
        (from, from + self.configuration[from..].partition_point(|s| *s <= last))
    }

    fn exits(&mut self, step: &Microstep, program: &Program) -> Vec<StateId> {
        let mut exits = std::mem::take(&mut self.exits);
        exits.clear();
        let mut add = |domain: StateId| {
            let (from, to) = self.inside(domain, program);
            exits.extend_from_slice(&self.configuration[from..to]);
        };
        match step {
            Microstep::Finish { .. } => exits.extend_from_slice(&self.configuration),
            Microstep::Restart(state) => add(*state),
            Microstep::Take(transitions) => {
                transitions.iter().filter_map(|t| self.domain(*t, program)).for_each(&mut add);
                if transitions.len() > 1 {
                    exits.sort_unstable();
                    exits.dedup();
                }
            }
        }
        exits
    }

    /// Cancels the skills of these states. Returns the activations that have to return.
    fn cancel(&mut self, states: &[StateId], turn: &mut Turn<'_>) -> BTreeSet<u64> {
        let mut waiting = BTreeSet::new();
        for state in states {
            let Some(extra) = self.runs[*state as usize].extra.as_deref_mut() else { continue };
            match extra.skill {
                SkillRun::Running(activation) => {
                    extra.skill = SkillRun::Cancelling(activation);
                    turn.trace(|p| TraceItem::SkillCancelled {
                        activation,
                        state: p.path(*state).to_owned(),
                    });
                    let grace = match &turn.program.state(*state).kind {
                        Kind::Skill { manifest } => manifest.grace,
                        _ => Duration::from_secs(1),
                    };
                    turn.out.push(Effect::Cancel { activation, grace });
                    waiting.insert(activation);
                }
                SkillRun::Cancelling(activation) => {
                    waiting.insert(activation);
                }
                SkillRun::Ready(_) => {
                    extra.skill = SkillRun::None;
                    self.ready.remove(state);
                }
                SkillRun::None => {}
            }
        }
        waiting
    }

    /// Continues the pending microstep once all skills that it leaves have returned.
    pub(super) fn complete_if_returned(&mut self, turn: &mut Turn<'_>) {
        if let Some(pending) = self.pending.take_if(|p| p.waiting.is_empty()) {
            self.complete(pending.step, pending.exits, turn);
        }
    }

    fn complete(&mut self, step: Microstep, exits: Vec<StateId>, turn: &mut Turn<'_>) {
        self.leave(&exits, turn);
        self.exits = exits;
        match step {
            Microstep::Take(transitions) => {
                self.take(&transitions, turn);
                self.enabled = transitions;
            }
            Microstep::Restart(state) => self.restart(state, turn),
            Microstep::Finish { outcome, reason, chain } => self.finish(outcome, reason, chain, turn),
        }
    }

    fn take(&mut self, transitions: &[u32], turn: &mut Turn<'_>) {
        let program = turn.program;
        if let [t] = transitions {
            // By far the most common case: one transition that stays, or goes to a plain state beside its source.
            let jump = program.tables.jump(*t);
            if jump.simple {
                if jump.acts {
                    self.act(&program.transitions[*t as usize].actions, jump.source, turn);
                }
                if jump.target != StateId::MAX {
                    self.enter_leaf(jump.target, turn);
                }
                return;
            }
        }
        let mut entries = Entries::default();
        for number in transitions {
            let t = &program.transitions[*number as usize];
            // The values that a transition gives are evaluated before its actions change the variables that they
            // read.
            let given = (!t.with.is_empty()).then(|| self.bindings(&t.with, turn));
            self.act(&t.actions, t.source, turn);
            let Some(domain) = self.domain(*number, program) else { continue };
            entries.targets.extend(t.targets.iter().map(|target| (*target, domain)));
            if let (Some(given), [target]) = (given, t.targets.as_slice()) {
                entries.given.push((*target, given));
            }
        }
        self.enter_all(entries, turn);
    }

    // Leaving.

    /// Leaves states, inner ones first; histories record their states before that.
    fn leave(&mut self, exits: &[StateId], turn: &mut Turn<'_>) {
        if exits.is_empty() {
            return;
        }
        self.moved = true;
        for state in exits {
            if !turn.program.tables.node(*state).plain {
                self.remember(*state, turn.program);
            }
        }
        for state in exits.iter().rev() {
            self.exit(*state, turn);
        }
        if let [only] = exits {
            let at = self.configuration.partition_point(|s| s < only);
            self.configuration.remove(at);
        } else {
            let runs = &self.runs;
            self.configuration.retain(|s| runs[*s as usize].active);
        }
    }

    /// The histories of a state that is left record the active states.
    fn remember(&mut self, state: StateId, program: &Program) {
        for history in &program.state(state).histories {
            let Kind::History { deep, .. } = &program.state(*history).kind else { continue };
            let (from, to) = self.inside(state, program);
            let inside = self.configuration[from..to].iter().copied();
            let states: Vec<StateId> = if *deep {
                // Leaves of this chart only; the inside of another chart is not recorded.
                let foreign = |s: StateId| {
                    program.outward(s).take_while(|a| *a != state).any(|a| program.state(a).chart_root)
                };
                let own: Vec<StateId> = inside.filter(|s| !foreign(*s)).collect();
                let next = |i: usize| own.get(i + 1).copied();
                let inner = |i: &usize| next(*i).is_none_or(|n| !program.within(n, own[*i]));
                (0..own.len()).filter(inner).map(|i| own[i]).collect()
            } else {
                inside.filter(|s| program.tables.parent(*s) == Some(state)).collect()
            };
            self.remembered.insert(*history, states);
        }
    }

    fn exit(&mut self, state: StateId, turn: &mut Turn<'_>) {
        let program = turn.program;
        if !program.tables.node(state).plain {
            self.exit_fully(state, turn);
        }
        let run = &mut self.runs[state as usize];
        run.active = false;
        run.extra = None;
        if !program.is_root(state) {
            turn.trace(|p| TraceItem::Exited { state: p.path(state).to_owned() });
        }
    }

    fn exit_fully(&mut self, state: StateId, turn: &mut Turn<'_>) {
        let of = turn.program.state(state);
        self.act(&of.exit, state, turn);
        let timers = self.runs[state as usize].extra.as_deref_mut().map(|e| std::mem::take(&mut e.timers));
        for timer in timers.into_iter().flatten() {
            if self.timers.remove(&timer).is_some() {
                turn.out.push(Effect::CancelTimer { timer });
            }
        }
        turn.out.extend(of.watches.iter().map(|watch| Effect::DisarmWatch { watch: *watch }));
        if let (Kind::Final { .. }, Some(parent)) = (&of.kind, of.parent)
            && let Some(extra) = self.runs[parent as usize].extra.as_deref_mut()
        {
            extra.done = None;
        }
        self.eager -= u32::from(!of.always.is_empty());
        if of.unbreakable {
            self.unbreakable -= 1;
            self.release_held();
        }
    }
}
