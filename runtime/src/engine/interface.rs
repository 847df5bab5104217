//! The engine's inputs and effects: data only.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_values::Value;
use serde::{Deserialize, Serialize};

use crate::program::StateId;
use crate::skill::{Limits, SkillResult};
use crate::trace::TraceItem;

/// An input of the engine. `activation` is the number of a skill's start, `entry` the entry of the state that a watch was armed
/// in, `place` is `file:line:column`; a state is given by its path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "input", rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Input {
    /// A skill returned, cancelled or not.
    SkillEnded { activation: u64, result: SkillResult },
    /// A cancelled skill has not returned within its grace.
    SkillStuck { activation: u64 },
    /// Somebody chooses how the skill of a state ends: it is cancelled, and counts as ended with this outcome.
    Choose {
        state: String,
        /// `success`, `failure`, or one that the skill declares.
        outcome: String,
    },
    /// An event for all active states: from a skill that runs, or from outside.
    Event { name: String, data: Value },
    /// A timer ran out.
    Timer { timer: u64 },
    /// A watch fired.
    Watch { watch: u32, entry: u64 },
    /// An expression of a watch failed.
    WatchFailed { watch: u32, entry: u64, message: String, place: String },
    /// A watch reads a number that is NaN: its condition counts as false, and `error.channel` is raised.
    WatchBlind { watch: u32, message: String, place: String },
    /// Stop everything: all skills are cancelled, the run ends as `stopped`.
    Stop { reason: String },
    /// An external cause makes it impossible to continue: as `Stop`, but the run ends as `failure`.
    Abort { reason: String },
}

/// An effect: something for the driver to carry out. `activation` is the number of a skill's start in the run.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Effect {
    /// Start a skill.
    StartSkill {
        activation: u64,
        state: StateId,
        /// Its name in the registry.
        skill: String,
        /// Its inputs, checked, with defaults.
        inputs: BTreeMap<String, Value>,
        /// Bounds from the chart.
        limits: Limits,
    },
    /// Tell a skill to stop within `grace`. The driver then reports it as ended or as stuck.
    Cancel { activation: u64, grace: Duration },
    /// Start a timer. Of timers that expire at one instant, those with lower `order` are reported first: inner states, then the
    /// order in the file.
    StartTimer { timer: u64, after: Duration, order: u64 },
    /// Cancel a timer.
    CancelTimer { timer: u64 },
    /// Begin to sample a watch; `entry` is that of its state, and is reported with it.
    ArmWatch { watch: u32, entry: u64 },
    /// Stop sampling a watch.
    DisarmWatch { watch: u32 },
    /// Send an event to another agent; `to` is the agent, or `agent/Chart`.
    Send { event: String, to: String, data: Value },
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
