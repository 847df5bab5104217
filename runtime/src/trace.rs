//! The events of a run as data: for recordings, progress lines, viewers and hashes.
//!
//! The engine emits [`TraceItem`]s, the executor adds the virtual time.

use std::collections::{BTreeMap, BTreeSet};

use armarium_values::Value;
use serde::{Deserialize, Serialize};

/// A trace item and its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TraceEvent {
    /// Virtual time since the run began, ns.
    pub at_ns: u64,
    /// What happened.
    pub item: TraceItem,
}

/// An item of the trace. States are given by their path in the chart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "snake_case")]
pub enum TraceItem {
    /// The run began.
    Started {
        /// Name of the chart.
        chart: String,
        /// Its inputs.
        inputs: BTreeMap<String, Value>,
    },
    /// An event was taken from the queue.
    Event {
        /// Its name.
        name: String,
        /// The state that it belongs to; `None` for events that all states see.
        from: Option<String>,
        /// Its data.
        data: Value,
    },
    /// An event was dropped: its state has been left meanwhile, or a queue was full.
    Dropped {
        /// Its name.
        name: String,
        /// Why it was dropped.
        reason: String,
    },
    /// Somebody acted on the run from outside, such as through its live page.
    Acted {
        /// What was done.
        action: String,
    },
    /// An event is held back until an unbreakable state ends.
    Held {
        /// Its name.
        name: String,
        /// The unbreakable state.
        state: String,
    },
    /// An event was sent to another agent.
    Sent {
        /// Its name.
        name: String,
        /// The agent, or `agent/Chart`.
        to: String,
        /// Its data.
        data: Value,
    },
    /// A transition was taken.
    Transition {
        /// The state that it is written at.
        source: String,
        /// The event that triggered it; `None` for `always`.
        event: Option<String>,
        /// Its target; `None` for a transition that leaves no state.
        target: Option<String>,
    },
    /// States wait for their skills to return before they are left.
    Leaving {
        /// The states.
        states: Vec<String>,
    },
    /// A state was left.
    Exited {
        /// The state.
        state: String,
    },
    /// A state was entered.
    Entered {
        /// The state.
        state: String,
    },
    /// A state has ended and no transition took its outcome; it stays active.
    Done {
        /// The state.
        state: String,
        /// Its outcome.
        outcome: String,
    },
    /// A state is retried.
    Retry {
        /// The state.
        state: String,
        /// Number of this retry, from 1.
        attempt: u32,
        /// Why the previous attempt failed.
        reason: String,
    },
    /// The active states changed.
    Configuration {
        /// The innermost active states, in the chart's order.
        leaves: Vec<String>,
    },
    /// A skill was started.
    SkillStarted {
        /// Number of this start in the run.
        activation: u64,
        /// The state.
        state: String,
        /// The skill.
        skill: String,
        /// Its inputs.
        inputs: BTreeMap<String, Value>,
    },
    /// The active states inside a state that another agent runs.
    Inside {
        /// The state.
        state: String,
        /// The innermost active states there.
        leaves: Vec<String>,
    },
    /// A skill was cancelled.
    SkillCancelled {
        /// Number of its start.
        activation: u64,
        /// The state.
        state: String,
    },
    /// A skill returned.
    SkillEnded {
        /// Number of its start.
        activation: u64,
        /// The state.
        state: String,
        /// Its outcome; `cancelled` if it was cancelled before.
        outcome: String,
        /// The reason of a failure.
        reason: Option<String>,
        /// Its outputs.
        outputs: BTreeMap<String, Value>,
    },
    /// A variable was assigned.
    Assigned {
        /// Its name, prefixed with the chart's path unless that is the outermost.
        variable: String,
        /// Its new value.
        value: Value,
    },
    /// The action `log` ran.
    Log {
        /// The state.
        state: String,
        /// The text.
        text: String,
    },
    /// An expression failed.
    Error {
        /// What happened.
        message: String,
        /// `file:line:column`.
        place: String,
    },
    /// The run ended.
    Finished {
        /// Its outcome.
        outcome: String,
        /// The reason of an outcome other than success.
        reason: Option<String>,
        /// The states that a failure passed through.
        chain: Vec<String>,
        /// The chart's outputs.
        outputs: BTreeMap<String, Value>,
    },
}

/// Follows a trace and keeps the active states, for a progress line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunStatus {
    /// The innermost active states, in the chart's order.
    pub leaves: Vec<String>,
    /// The states that wait for their skills to return.
    pub leaving: BTreeSet<String>,
    /// The active states inside states that other agents run.
    pub inside: BTreeMap<String, Vec<String>>,
    /// The outcome, once the run has ended.
    pub outcome: Option<String>,
}

impl RunStatus {
    /// Applies one more trace event.
    pub fn update(&mut self, event: &TraceEvent) {
        match &event.item {
            TraceItem::Configuration { leaves } => self.leaves.clone_from(leaves),
            TraceItem::Leaving { states } => self.leaving = states.iter().cloned().collect(),
            TraceItem::Exited { state } => {
                self.leaving.remove(state);
                self.inside.remove(state);
            }
            TraceItem::Inside { state, leaves } => {
                self.inside.insert(state.clone(), leaves.clone());
            }
            TraceItem::SkillEnded { state, .. } => {
                self.inside.remove(state);
            }
            TraceItem::Finished { outcome, .. } => self.outcome = Some(outcome.clone()),
            _ => {}
        }
    }

    /// The active states in one line, with those of other agents in brackets after their state.
    pub fn line(&self) -> String {
        self.lines().join(" | ")
    }

    /// The innermost active states, each with the active states inside it at another agent.
    pub fn lines(&self) -> Vec<String> {
        let one = |leaf: &String| match self.inside.get(leaf).filter(|inside| !inside.is_empty()) {
            Some(inside) => format!("{leaf} [{}]", inside.join(" | ")),
            None => leaf.clone(),
        };
        self.leaves.iter().map(one).collect()
    }
}
