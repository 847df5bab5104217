//! What a skill is: a manifest that declares its inputs, outputs and limbs (`manifest`, `parameter`), and a future that acts.
//!
//! A skill is started with checked inputs, reports one outcome, and returns soon after it has been cancelled.

mod manifest;
mod parameter;

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::Value;
use futures::future::BoxFuture;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::channels::Channels;

pub use manifest::{DeclaredAt, Mark, MarkNumber, MarkTime, SkillManifest};
pub(crate) use parameter::inputs;
pub use parameter::{InputError, NameKind, Parameter, ParameterError};

/// How a skill ended well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// `success`, or an outcome that the manifest declares.
    pub name: String,
    /// Outputs by name.
    pub outputs: BTreeMap<String, Value>,
}

impl Outcome {
    /// The outcome `success` without outputs.
    pub fn success() -> Self {
        Self { name: "success".into(), outputs: BTreeMap::new() }
    }

    /// An outcome that the manifest declares, without outputs.
    pub fn named(name: &str) -> Self {
        Self { name: name.into(), outputs: BTreeMap::new() }
    }

    /// The same outcome with one more output.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.outputs.insert(name.into(), value.into());
        self
    }
}

/// Why a skill failed, in words for the operator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[error("{reason}")]
pub struct Failure {
    /// One sentence: what happened, and what to do about it where that is known.
    pub reason: String,
}

impl Failure {
    /// A failure with its reason.
    pub fn new(reason: impl Into<String>) -> Self {
        Self { reason: reason.into() }
    }

    /// For an input whose value is not what the skill needs.
    pub fn input(name: &str, expected: &str, found: &Value) -> Self {
        Self::new(format!("the input `{name}` should be {expected}, but is {}", found.describe()))
    }
}

/// How a skill ended.
pub type SkillResult = Result<Outcome, Failure>;

/// Bounds that the chart puts on every skill inside a state; inner states only tighten them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limits {
    /// Largest wrist force, N.
    pub force_n: Option<f64>,
    /// Largest TCP speed, m/s.
    pub speed_m_s: Option<f64>,
}

impl Limits {
    /// The tighter of both bounds, each by itself.
    #[must_use]
    pub fn tightened(self, inner: Self) -> Self {
        let least = |a: Option<f64>, b: Option<f64>| match (a, b) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
        Self {
            force_n: least(self.force_n, inner.force_n),
            speed_m_s: least(self.speed_m_s, inner.speed_m_s),
        }
    }
}

/// Largest number of events of one skill that wait.
pub const MAX_EVENTS: usize = 256;

/// Raises events of a running skill into its chart, in their order.
#[derive(Clone, Debug)]
pub struct Events {
    queue: mpsc::Sender<(String, Value)>,
    dropped: Dropped,
}

/// Number of events that were dropped because the queue was full, by name.
type Dropped = Arc<Mutex<BTreeMap<String, u64>>>;

impl Events {
    /// Raises one of the manifest's events without waiting. If [`MAX_EVENTS`] already wait, the event is dropped
    /// and counted, and the trace of the run reports the count.
    pub fn raise(&self, name: &str, data: Value) {
        if let Err(mpsc::error::TrySendError::Full((name, _))) = self.queue.try_send((name.to_owned(), data))
        {
            self.dropped(&name, 1);
        }
    }

    /// Counts events that were dropped elsewhere.
    pub(crate) fn dropped(&self, name: &str, count: u64) {
        let mut dropped = self.dropped.lock();
        *dropped.entry(name.to_owned()).or_default() += count;
    }
}

/// The receiving end of [`Events`].
#[derive(Debug)]
pub(crate) struct EventQueue {
    queue: mpsc::Receiver<(String, Value)>,
    dropped: Dropped,
}

/// A bounded queue of events: its sender and its receiver.
pub(crate) fn events() -> (Events, EventQueue) {
    let (sender, queue) = mpsc::channel(MAX_EVENTS);
    let dropped = Dropped::default();
    (Events { queue: sender, dropped: Arc::clone(&dropped) }, EventQueue { queue, dropped })
}

impl EventQueue {
    /// The next event, if one is waiting.
    pub(crate) fn take(&mut self) -> Option<(String, Value)> {
        self.queue.try_recv().ok()
    }

    /// The next event; `None` once all senders are gone.
    pub(crate) async fn next(&mut self) -> Option<(String, Value)> {
        self.queue.recv().await
    }

    /// The number of events of one name that were dropped since the last call.
    pub(crate) fn take_dropped(&mut self) -> Option<(String, u64)> {
        self.dropped.lock().pop_first()
    }
}

/// The context of a running skill.
#[derive(Clone, Debug)]
pub struct SkillContext {
    /// Path of the state that runs it, for messages and the trace.
    pub state: String,
    /// Inputs, complete and of their declared types.
    pub inputs: BTreeMap<String, Value>,
    /// Bounds from the chart.
    pub limits: Limits,
    /// Cancelled when the state is left; the skill then stops what it does and returns.
    pub cancel: CancellationToken,
    /// The channels that observers publish on; skills may publish as well.
    pub channels: Channels,
    /// Raises the manifest's events into the chart.
    pub events: Events,
    /// The active states inside the skill, if it has any: those of a chart that another agent runs. They appear in
    /// the trace; only the newest value counts.
    pub inside: tokio::sync::watch::Sender<Vec<String>>,
}

impl SkillContext {
    /// The input of that name.
    ///
    /// # Errors
    /// When the manifest does not declare it.
    pub fn value(&self, name: &str) -> Result<&Value, Failure> {
        self.inputs.get(name).ok_or_else(|| Failure::new(format!("the input `{name}` is missing")))
    }

    /// An input that is a finite number, SI.
    ///
    /// # Errors
    /// When it is not a finite number.
    pub fn number(&self, name: &str) -> Result<f64, Failure> {
        let value = self.value(name)?;
        value.as_f64().filter(|n| n.is_finite()).ok_or_else(|| Failure::input(name, "a finite number", value))
    }

    /// An input that is text.
    ///
    /// # Errors
    /// When it is not text.
    pub fn text(&self, name: &str) -> Result<&str, Failure> {
        let value = self.value(name)?;
        value.as_str().ok_or_else(|| Failure::input(name, "text", value))
    }
}

/// The action of a leaf state.
pub trait Skill: Send + Sync + 'static {
    /// What the skill declares about itself.
    fn manifest(&self) -> SkillManifest;
    /// Acts until it has an outcome or is cancelled. A cancelled skill's result is ignored.
    fn run(&self, context: SkillContext) -> BoxFuture<'static, SkillResult>;
}
