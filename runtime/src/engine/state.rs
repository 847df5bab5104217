//! The data of a run: the status of each state, the pending microstep, the variables, and the view that expressions
//! have of them.

use std::collections::{BTreeMap, BTreeSet};

use armarium_values::Value;
use armarium_values::expr::{EvalContext, MAX_PARTS};

use super::event::Event;
use super::{Effect, Sensors, TraceItem};
use crate::program::{EventNumber, Program, StateId};

/// Largest number of parts that all assigned variables may hold together.
const MAX_HELD_PARTS: usize = 20 * MAX_PARTS;

/// The status of a state's skill.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum SkillRun {
    #[default]
    None,
    /// The state was entered; the skill starts at the end of the macrostep.
    Ready(BTreeMap<String, Value>),
    Running(u64),
    Cancelling(u64),
}

/// The status of a state; reset when the state is entered.
#[derive(Clone, Debug, Default)]
pub(super) struct StateRun {
    /// Number of this entry, counted over all states. It distinguishes one stay in a state from another.
    pub(super) entry: u64,
    /// Data that few states need.
    pub(super) extra: Option<Box<StateStatus>>,
    /// Number of the newest selection that has looked at this state.
    pub(super) seen: u32,
    /// Number of the newest entry that has planned a state inside this one.
    pub(super) filled: u32,
    pub(super) active: bool,
}

/// The status of a state with a skill, timers, retries or an outcome.
#[derive(Clone, Debug, Default)]
pub(super) struct StateStatus {
    pub(super) skill: SkillRun,
    /// How its skill ends as soon as it returns, where somebody has chosen that.
    pub(super) chosen: Option<String>,
    /// Its outcome, if no transition took it.
    pub(super) done: Option<EventNumber>,
    /// Whether it has reported its outcome, for unbreakable states.
    pub(super) ended: bool,
    pub(super) retries: u32,
    /// Whether it waits before its next retry; nothing inside it is active then.
    pub(super) waiting: bool,
    pub(super) timers: Vec<u64>,
    /// The values from the transition that entered it, for further retries.
    pub(super) given: BTreeMap<String, Value>,
    /// For a parallel state: the first outcome of a region that is not success.
    pub(super) first_other: Option<(EventNumber, Value)>,
}

/// A timer that has been started.
#[derive(Clone, Debug)]
pub(super) struct Timer {
    pub(super) of: TimerUse,
    /// How many timers of zero duration have expired in a row up to this one, which is included.
    pub(super) chain: u32,
}

#[derive(Clone, Debug)]
pub(super) enum TimerUse {
    After { state: StateId, entry: u64, transition: u32 },
    Retry { state: StateId, entry: u64 },
    Send { id: Option<String>, event: Event, to: Option<String> },
}

/// A microstep: transitions to take, a state whose inside begins again, or the run's end. It is carried out once all skills that
/// it leaves have returned.
#[derive(Clone, Debug)]
pub(super) enum Microstep {
    Take(Vec<u32>),
    Restart(StateId),
    Finish { outcome: String, reason: Option<String>, chain: Vec<String> },
}

#[derive(Clone, Debug)]
pub(super) struct Pending {
    pub(super) step: Microstep,
    /// States to leave, in the file's order.
    pub(super) exits: Vec<StateId>,
    /// Skills that have not returned yet.
    pub(super) waiting: BTreeSet<u64>,
}

/// The variables of a run, which expressions read.
#[derive(Debug, Default)]
pub(super) struct Variables {
    pub(super) data: Vec<Option<Value>>,
    pub(super) event: Option<Event>,
    /// Number of parts of each assigned value that is not a scalar, by slot.
    pub(super) parts: BTreeMap<u32, usize>,
    /// Their sum.
    pub(super) held: usize,
}

impl Variables {
    /// Sets a variable. Returns false, and changes nothing, if all variables together would hold too much.
    pub(super) fn assign(&mut self, slot: u32, value: Value) -> bool {
        let parts = match &value {
            Value::List(_) | Value::Map(_) | Value::String(_) | Value::Bytes(_) => value.parts(),
            _ => 0,
        };
        if parts > 0 || !self.parts.is_empty() {
            let held = self.held - self.parts.get(&slot).copied().unwrap_or(0) + parts;
            if held > MAX_HELD_PARTS {
                return false;
            }
            self.held = held;
            if parts > 0 {
                self.parts.insert(slot, parts);
            } else {
                self.parts.remove(&slot);
            }
        }
        self.data[slot as usize] = Some(value);
        true
    }
}

/// The engine's variables, states and sensors, as expressions see them.
pub(super) struct RunContext<'v> {
    pub(super) program: &'v Program,
    pub(super) store: &'v Variables,
    pub(super) runs: &'v [StateRun],
    pub(super) sensors: &'v dyn Sensors,
}

impl RunContext<'_> {
    /// Whether a channel is of what charts observe of memory.
    fn observed(&self, channel: u32) -> bool {
        self.program.observed_channels.contains(&channel)
    }
}

impl EvalContext for RunContext<'_> {
    #[inline]
    fn data(&self, slot: u32) -> Option<&Value> {
        self.store.data.get(slot as usize)?.as_ref()
    }
    fn channel(&self, channel: u32, path: &[String]) -> Option<Value> {
        // What memory held once and holds no more is not there.
        self.sensors.channel(channel, path).filter(|value| !(*value == Value::Null && self.observed(channel)))
    }
    fn age(&self, channel: u32) -> Option<f64> {
        let never = || (!self.observed(channel)).then_some(f64::INFINITY);
        self.sensors.age(channel).or_else(never)
    }
    fn event_name(&self) -> Option<&str> {
        self.store.event.as_ref().map(|e| e.name(self.program))
    }
    fn event_data(&self) -> Option<&Value> {
        self.store.event.as_ref().map(|e| e.data())
    }
    fn active(&self, state: u32) -> bool {
        self.runs.get(state as usize).is_some_and(|r| r.active)
    }
}

/// The context of one call of the engine.
pub(super) struct Turn<'t> {
    pub(super) program: &'t Program,
    pub(super) sensors: &'t dyn Sensors,
    pub(super) out: &'t mut Vec<Effect>,
    pub(super) tracing: bool,
    /// Number of actions run so far.
    pub(super) actions: u32,
}

impl<'t> Turn<'t> {
    /// Emits a trace item. The item is not built when tracing is off.
    #[inline]
    pub(super) fn trace(&mut self, item: impl FnOnce(&'t Program) -> TraceItem) {
        if self.tracing {
            self.out.push(Effect::Trace(item(self.program)));
        }
    }
}
