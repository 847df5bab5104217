//! Turns inputs from outside into events: expired timers, returned or stuck skills, a stop.

use std::collections::BTreeMap;

use armarium_values::Value;

use super::event::{Event, Origin};
use super::state::{Microstep, SkillRun, StateStatus, Timer, TimerUse, Turn};
use super::{Effect, Engine, MAX_MICROSTEPS, MAX_QUEUE, TraceItem};
use crate::program::{AFTER, Kind, RETRY, StateId};
use crate::skill::{Failure, Outcome, SkillResult};

impl Engine {
    /// The rarely needed data of a state, created on first use.
    pub(super) fn extra(&mut self, state: StateId) -> &mut StateStatus {
        self.runs[state as usize].extra.get_or_insert_default()
    }

    pub(super) fn extra_of(&self, state: StateId) -> Option<&StateStatus> {
        self.runs[state as usize].extra.as_deref()
    }

    /// An event from outside. If its data do not have the type that the chart declares, it is dropped and
    /// `error.communication` is raised.
    pub(super) fn event(&mut self, name: &str, data: Value, turn: &mut Turn<'_>) {
        let program = turn.program;
        let converted = match program.event_types.get(name) {
            Some(ty) => ty.convert(data),
            None => Ok(data),
        };
        match converted {
            Ok(data) => self.queue(Event::named(program, name, data), turn),
            Err(error) => {
                let reason = format!("the data of `{name}`: {error}");
                turn.trace(|_| TraceItem::Dropped { name: name.to_owned(), reason: reason.clone() });
                let data = Value::record([("reason", reason.into())]);
                self.queue(Event::named(program, "error.communication", data), turn);
            }
        }
    }

    pub(super) fn queue(&mut self, event: Event, turn: &mut Turn<'_>) {
        if self.external.len() >= MAX_QUEUE || !self.can_carry(&event) {
            let reason = "too many events are waiting".into();
            turn.trace(|p| TraceItem::Dropped { name: event.name(p).to_owned(), reason });
        } else {
            self.external.push_back(event);
        }
    }

    pub(super) fn timer(&mut self, timer: u64, turn: &mut Turn<'_>) {
        let Some(Timer { of, chain }) = self.timers.remove(&timer) else { return };
        if chain > MAX_MICROSTEPS {
            let what = format!("{MAX_MICROSTEPS} timers without any time between them");
            return self.restless(&what, turn);
        }
        self.chain = chain;
        match of {
            TimerUse::Send { event, to, .. } => self.post(event, to, turn),
            TimerUse::After { state, entry, transition } => {
                let path = turn.program.path(state);
                let waits = matches!(turn.program.state(state).kind, Kind::Atomic);
                let reason = match waits {
                    true => format!("the time of `{path}` was up"),
                    false => format!("`{path}` had not ended when its time was up"),
                };
                let data = Value::record([("reason", reason.into())]);
                self.queue(Event::new(AFTER, data, Origin::After { state, entry, transition }), turn);
            }
            TimerUse::Retry { state, entry } => {
                self.queue(Event::new(RETRY, Value::Null, Origin::Retry { state, entry }), turn);
            }
        }
    }

    /// Cancels the skill of a state that is to end with this outcome.
    pub(super) fn choose(&mut self, path: &str, outcome: String, turn: &mut Turn<'_>) {
        let program = turn.program;
        let running = self.skills.iter().find(|(_, state)| program.path(**state) == path);
        let running = running.map(|(activation, state)| (*activation, *state));
        let reason = match running.map(|(activation, state)| (activation, state, &program.state(state).kind))
        {
            Some((activation, state, Kind::Skill { manifest })) if manifest.has_outcome(&outcome) => {
                self.extra(state).chosen = Some(outcome);
                turn.out.push(Effect::Cancel { activation, grace: manifest.grace });
                return;
            }
            Some(_) => format!("the skill of `{path}` has no such outcome"),
            None => format!("no skill runs in `{path}`"),
        };
        turn.trace(|_| TraceItem::Dropped { name: outcome, reason });
    }

    pub(super) fn skill_ended(&mut self, activation: u64, result: SkillResult, turn: &mut Turn<'_>) {
        let Some(state) = self.skills.remove(&activation) else { return };
        let cancelled = self.extra(state).skill == SkillRun::Cancelling(activation);
        let result = match self.extra(state).chosen.take() {
            Some(failure) if failure == "failure" => Err(Failure::new("somebody chose that it fails")),
            Some(name) => {
                Ok(Outcome { name, outputs: result.map(|given| given.outputs).unwrap_or_default() })
            }
            None => result,
        };
        turn.trace(|p| {
            let (outcome, reason, outputs) = match &result {
                _ if cancelled => ("cancelled", None, BTreeMap::new()),
                Ok(outcome) => (outcome.name.as_str(), None, outcome.outputs.clone()),
                Err(failure) => ("failure", Some(failure.reason.clone()), BTreeMap::new()),
            };
            let (state, outcome) = (p.path(state).to_owned(), outcome.to_owned());
            TraceItem::SkillEnded { activation, state, outcome, reason, outputs }
        });
        self.extra(state).skill = SkillRun::None;
        if cancelled {
            self.returned(activation, turn);
        } else {
            let event = self.outcome_of_skill(state, result, turn);
            self.external.push_back(event);
        }
    }

    /// A cancelled skill has returned.
    pub(super) fn returned(&mut self, activation: u64, turn: &mut Turn<'_>) {
        if let Some(pending) = &mut self.pending {
            pending.waiting.remove(&activation);
            self.complete_if_returned(turn);
        }
    }

    pub(super) fn skill_stuck(&mut self, activation: u64, turn: &mut Turn<'_>) {
        let Some(state) = self.skills.remove(&activation) else { return };
        let path = turn.program.path(state).to_owned();
        self.extra(state).skill = SkillRun::None;
        let reason = format!("the skill of `{path}` did not return after it was cancelled");
        self.finish_with("failure".into(), Some(reason), vec![path], turn);
        self.returned(activation, turn);
    }

    pub(super) fn stop(&mut self, outcome: &str, reason: String, turn: &mut Turn<'_>) {
        let running = self.pending.as_ref().is_some_and(|p| matches!(p.step, Microstep::Finish { .. }));
        if !running {
            self.finish_with(outcome.to_owned(), Some(reason), Vec::new(), turn);
        }
    }
}
