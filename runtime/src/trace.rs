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

/// An item of the trace. States are given by their path in the chart, skills' starts by their number in the run (`activation`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum TraceItem {
    /// The run began.
    Started { chart: String, inputs: BTreeMap<String, Value> },
    /// An event was taken from the queue.
    Event {
        name: String,
        /// The state that it belongs to; `None` for events that all states see.
        from: Option<String>,
        data: Value,
    },
    /// An event was dropped: its state has been left meanwhile, or a queue was full.
    Dropped { name: String, reason: String },
    /// Somebody acted on the run from outside, such as through its live page.
    Acted { action: String },
    /// An event is held back until an unbreakable state ends.
    Held { name: String, state: String },
    /// An event was sent to another agent.
    Sent {
        name: String,
        /// The agent, or `agent/Chart`.
        to: String,
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
    Leaving { states: Vec<String> },
    /// A state was left.
    Exited { state: String },
    /// A state was entered.
    Entered { state: String },
    /// A state has ended and no transition took its outcome; it stays active.
    Done { state: String, outcome: String },
    /// A state is retried.
    Retry {
        state: String,
        /// Number of this retry, from 1.
        attempt: u32,
        /// Why the previous attempt failed.
        reason: String,
    },
    /// The active states changed; these are the innermost, in the chart's order.
    Configuration { leaves: Vec<String> },
    /// A skill was started.
    SkillStarted { activation: u64, state: String, skill: String, inputs: BTreeMap<String, Value> },
    /// The innermost active states inside a state that another agent runs.
    Inside { state: String, leaves: Vec<String> },
    /// A skill was cancelled.
    SkillCancelled { activation: u64, state: String },
    /// A skill returned.
    SkillEnded {
        activation: u64,
        state: String,
        /// Its outcome; `cancelled` if it was cancelled before.
        outcome: String,
        /// The reason of a failure.
        reason: Option<String>,
        outputs: BTreeMap<String, Value>,
    },
    /// A variable was assigned.
    Assigned {
        /// Its name, prefixed with the chart's path unless that is the outermost.
        variable: String,
        value: Value,
    },
    /// The action `log` ran.
    Log { state: String, text: String },
    /// An expression failed; `place` is `file:line:column`.
    Error { message: String, place: String },
    /// The run ended.
    Finished {
        outcome: String,
        /// The reason of an outcome other than success.
        reason: Option<String>,
        /// The states that a failure passed through.
        chain: Vec<String>,
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
