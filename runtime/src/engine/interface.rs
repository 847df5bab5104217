//! The engine's inputs and effects: data only.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_values::Value;
use serde::{Deserialize, Serialize};

use crate::program::StateId;
use crate::skill::{Limits, SkillResult};
use crate::trace::TraceItem;

/// An input of the engine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "input", rename_all = "snake_case")]
pub enum Input {
    /// A skill returned, cancelled or not.
    SkillEnded {
        /// Number of its start.
        activation: u64,
        /// How it ended.
        result: SkillResult,
    },
    /// A cancelled skill has not returned within its grace.
    SkillStuck {
        /// Number of its start.
        activation: u64,
    },
    /// Somebody chooses how the skill of a state ends: it is cancelled, and counts as ended with this outcome.
    Choose {
        /// The state's path.
        state: String,
        /// `success`, `failure`, or one that the skill declares.
        outcome: String,
    },
    /// An event for all active states: from a skill that runs, or from outside.
    Event {
        /// Its name.
        name: String,
        /// What comes with it.
        data: Value,
    },
    /// A timer ran out.
    Timer {
        /// Its number.
        timer: u64,
    },
    /// A watch fired.
    Watch {
        /// Its number.
        watch: u32,
        /// The entry of the state that it was armed in.
        entry: u64,
    },
    /// An expression of a watch failed.
    WatchFailed {
        /// Its number.
        watch: u32,
        /// The entry of the state that it was armed in.
        entry: u64,
        /// What happened.
        message: String,
        /// `file:line:column`.
        place: String,
    },
    /// A watch reads a number that is NaN: its condition counts as false, and `error.channel` is raised.
    WatchBlind {
        /// Its number.
        watch: u32,
        /// What happened.
        message: String,
        /// `file:line:column`.
        place: String,
    },
    /// Stop everything: all skills are cancelled, the run ends as `stopped`.
    Stop {
        /// Why.
        reason: String,
    },
    /// An external cause makes it impossible to continue: as `Stop`, but the run ends as `failure`.
    Abort {
        /// Why.
        reason: String,
    },
}

/// An effect: something for the driver to carry out.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Start a skill.
    StartSkill {
        /// Number of this start in the run.
        activation: u64,
        /// The state that runs it.
        state: StateId,
        /// Its name in the registry.
        skill: String,
        /// Its inputs, checked, with defaults.
        inputs: BTreeMap<String, Value>,
        /// Bounds from the chart.
        limits: Limits,
    },
    /// Tell a skill to stop. The driver then reports it as ended or as stuck.
    Cancel {
        /// Number of its start.
        activation: u64,
        /// How long it may take.
        grace: Duration,
    },
    /// Start a timer. Of timers that expire at one instant, those with lower `order` are reported first.
    StartTimer {
        /// Its number.
        timer: u64,
        /// Its duration.
        after: Duration,
        /// Inner states first, then the order in the file.
        order: u64,
    },
    /// Cancel a timer.
    CancelTimer {
        /// Its number.
        timer: u64,
    },
    /// Begin to sample a watch.
    ArmWatch {
        /// Its number.
        watch: u32,
        /// The entry of its state; it is reported with the watch.
        entry: u64,
    },
    /// Stop sampling a watch.
    DisarmWatch {
        /// Its number.
        watch: u32,
    },
    /// Send an event to another agent.
    Send {
        /// Its name.
        event: String,
        /// The agent, or `agent/Chart`.
        to: String,
        /// What comes with it.
        data: Value,
    },
    /// An item for the trace.
    Trace(TraceItem),
    /// The run has ended; the last effect.
    Finished(RunResult),
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub struct RunResult {
    /// The chart's outcome: `success`, `failure`, one of its own, or `stopped`.
    pub outcome: String,
    /// The reason of an outcome other than success, where it is known.
    pub reason: Option<String>,
    /// The states that a failure came through, from the inside out.
    pub chain: Vec<String>,
    /// The chart's outputs.
    pub outputs: BTreeMap<String, Value>,
}

/// Values that expressions read from outside the engine.
pub trait Sensors {
    /// The newest value of a channel, or the field of it at `path`. `channel` is an index into
    /// [`Program::channels`](crate::program::Program::channels).
    fn channel(&self, channel: u32, path: &[String]) -> Option<Value>;
    /// Seconds since the channel was published.
    fn age(&self, channel: u32) -> Option<f64>;
}

/// Sensors without any channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoSensors;

impl Sensors for NoSensors {
    fn channel(&self, _: u32, _: &[String]) -> Option<Value> {
        None
    }
    fn age(&self, _: u32) -> Option<f64> {
        None
    }
}

/// One sample of a watch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WatchSample {
    /// The condition.
    pub holds: bool,
    /// Whether a watch that has fired may fire again.
    pub until: bool,
    /// An expression that failed, and where it was written.
    pub error: Option<(String, String)>,
    /// A number that is NaN, so that the condition is undefined, and where it is read.
    pub blind: Option<(String, String)>,
}
