//! One microstep: cancel what is left, wait until it has returned, then leave, act and enter.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use super::enter::Entries;
use super::program::{Kind, StateId};
use super::{Effect, Engine, Event, Pending, Run, SkillRun, Step, TraceItem, Turn};

/// Longest time that a timer waits.
const LONGEST_S: f64 = 1.0e9;

/// A finite, non-negative number of seconds as a duration.
pub(super) fn duration(seconds: f64) -> Duration {
    if seconds.is_finite() { Duration::from_secs_f64(seconds.clamp(0.0, LONGEST_S)) } else { Duration::ZERO }
}

impl Engine {
    /// Begins a microstep: cancels the skills of all states that it leaves.
    pub(super) fn begin(&mut self, step: Step, event: Option<Event>, turn: &mut Turn<'_>) {
        if let Step::Take(transitions) = &step {
            for t in transitions {
                let t = &self.program.transitions[*t as usize];
                turn.trace(TraceItem::Transition {
                    source: self.program.state(t.source).path.clone(),
                    event: event.as_ref().map(|e| e.name.to_string()),
                    target: t.target.map(|s| self.program.state(s).path.clone()),
                });
            }
        }
        let exits = self.exits(&step);
        let waiting = self.cancel(&exits, turn);
        if !waiting.is_empty() {
            let states = exits.iter().filter(|s| **s != 0 && !self.program.state(**s).chart_root);
            let states = states.map(|s| self.program.state(*s).path.clone()).collect();
            turn.trace(TraceItem::Leaving { states });
        }
        self.pending = Some(Pending { step, event, exits, waiting });
        self.complete_if_returned(turn);
    }

    /// Ends the run, whatever is being done: everything is left, once all skills have returned.
    pub(super) fn finish_with(
        &mut self,
        outcome: String,
        reason: Option<String>,
        chain: Vec<String>,
        turn: &mut Turn<'_>,
    ) {
        self.show_configuration(turn);
        // What was pending is given up; its cancelled skills are still waited for, as their states are active.
        self.pending = None;
        self.begin(Step::Finish { outcome, reason, chain }, None, turn);
    }

    fn exits(&self, step: &Step) -> Vec<StateId> {
        let inside = |domain: StateId| {
            let program = &self.program;
            self.configuration.iter().copied().filter(move |s| *s != domain && program.within(*s, domain))
        };
        match step {
            Step::Finish { .. } => self.configuration.clone(),
            Step::Restart(state) => inside(*state).collect(),
            Step::Take(transitions) => {
                let domains = transitions.iter().filter_map(|t| self.program.transitions[*t as usize].domain);
                let exits: BTreeSet<StateId> = domains.flat_map(inside).collect();
                exits.into_iter().collect()
            }
        }
    }

    /// Cancels the skills of these states; gives those that have to return.
    fn cancel(&mut self, states: &[StateId], turn: &mut Turn<'_>) -> BTreeSet<u64> {
        let mut waiting = BTreeSet::new();
        for state in states {
            let run = &mut self.runs[*state as usize];
            match run.skill {
                SkillRun::Running(activation) => {
                    run.skill = SkillRun::Cancelling(activation);
                    let path = self.program.state(*state).path.clone();
                    turn.trace(TraceItem::SkillCancelled { activation, state: path });
                    let grace = match &self.program.state(*state).kind {
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
                    run.skill = SkillRun::None;
                    self.ready.remove(state);
                }
                SkillRun::None => {}
            }
        }
        waiting
    }

    /// Goes on with the microstep that is pending, once all skills that it leaves have returned.
    pub(super) fn complete_if_returned(&mut self, turn: &mut Turn<'_>) {
        if self.pending.as_ref().is_none_or(|p| !p.waiting.is_empty()) {
            return;
        }
        let Some(pending) = self.pending.take() else { return };
        if pending.event.is_some() {
            self.store.event.clone_from(&pending.event);
        }
        self.remember(&pending.exits);
        for state in pending.exits.iter().rev() {
            self.exit(*state, turn);
        }
        match pending.step {
            Step::Take(transitions) => self.take(&transitions, turn),
            Step::Restart(state) => self.restart(state, pending.event.as_ref(), turn),
            Step::Finish { outcome, reason, chain } => self.finish(outcome, reason, chain, turn),
        }
    }

    fn take(&mut self, transitions: &[u32], turn: &mut Turn<'_>) {
        let program = Arc::clone(&self.program);
        let mut entries = Entries::default();
        for t in transitions {
            let t = &program.transitions[*t as usize];
            // What a transition gives is evaluated before its actions change anything that it reads.
            let given = self.bindings(&t.with, turn);
            self.act(&t.actions, t.source, turn);
            if let (Some(target), Some(domain)) = (t.target, t.domain) {
                self.add_target(target, domain, &mut entries);
                entries.given.push((target, given));
            }
        }
        self.enter_all(entries, turn);
    }

    // Leaving.

    /// Histories of states that are left remember what is active now.
    fn remember(&mut self, exits: &[StateId]) {
        let program = Arc::clone(&self.program);
        for state in exits {
            for history in &program.state(*state).histories {
                let Kind::History { deep, .. } = &program.state(*history).kind else { continue };
                let inside = self.configuration.iter().copied();
                let inside = inside.filter(|s| s != state && program.within(*s, *state));
                let states: Vec<StateId> = if *deep {
                    // Leaves of this chart; the inside of another chart is not remembered.
                    let foreign = |s: StateId| {
                        program.outward(s).take_while(|a| a != state).any(|a| program.state(a).chart_root)
                    };
                    let own: Vec<StateId> = inside.filter(|s| !foreign(*s)).collect();
                    let inner = |s: &StateId| !own.iter().any(|o| o != s && program.within(*o, *s));
                    own.iter().copied().filter(inner).collect()
                } else {
                    inside.filter(|s| program.state(*s).parent == Some(*state)).collect()
                };
                self.remembered.insert(*history, states);
            }
        }
    }

    fn exit(&mut self, state: StateId, turn: &mut Turn<'_>) {
        let program = Arc::clone(&self.program);
        let of = program.state(state);
        self.act(&of.exit, state, turn);
        for timer in std::mem::take(&mut self.runs[state as usize].timers) {
            if self.timers.remove(&timer).is_some() {
                turn.out.push(Effect::CancelTimer { timer });
            }
        }
        for watch in &of.watches {
            turn.out.push(Effect::DisarmWatch { watch: *watch });
        }
        if matches!(of.kind, Kind::Final { .. })
            && let Some(parent) = of.parent
        {
            self.runs[parent as usize].done = None;
        }
        self.runs[state as usize] = Run::default();
        self.configuration.retain(|s| *s != state);
        if state != 0 && !of.chart_root {
            turn.trace(TraceItem::Exited { state: of.path.clone() });
        }
        if of.unbreakable {
            self.release_held();
        }
    }
}
