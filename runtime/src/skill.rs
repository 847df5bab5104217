//! What a skill is: a manifest that declares its inputs, outputs and limbs, and a future that acts.
//!
//! A skill is started with checked inputs, reports one outcome, and returns soon after it has been cancelled.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::panic::Location;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use armarium_source::suggest;
use armarium_values::{ConvertError, Type, Unit, Value};
use futures::future::BoxFuture;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use crate::channels::Channels;

/// What a skill declares about itself; used by the checker, the editor's schema and `armarium skills`.
#[derive(Clone, Debug, PartialEq)]
pub struct SkillManifest {
    /// The name that charts use.
    pub name: String,
    /// One or two sentences for people.
    pub description: String,
    /// Its inputs.
    pub inputs: Vec<Parameter>,
    /// Its outputs, with its outcome.
    pub outputs: Vec<Parameter>,
    /// Outcomes beyond `success` and `failure`.
    pub outcomes: Vec<String>,
    /// Events that it raises while it runs.
    pub events: Vec<String>,
    /// Marks for the referee of a run.
    pub marks: Vec<Mark>,
    /// Channels that it reads.
    pub reads: Vec<String>,
    /// Channels that it publishes.
    pub publishes: Vec<String>,
    /// Limbs that it commands; two regions that can command one limb at the same time are an error at load.
    pub limbs: Vec<String>,
    /// Limbs that it commands by the value of an input: for each such input, the limbs that each of its values names. They
    /// are held against those of other regions where the value is known before the run.
    pub limbs_by_input: BTreeMap<String, BTreeMap<String, Vec<String>>>,
    /// How long it may take to return after a cancel.
    pub grace: Duration,
    /// Whether it may have more inputs and outputs than declared here, as for a skill of another agent that has not
    /// been queried yet.
    pub open: bool,
    /// Where it is declared: for people, and for editors that go there.
    pub declared_at: DeclaredAt,
}

/// A line of a program's text, if it is known. Any two are equal: what is declared is the same wherever it stands.
#[derive(Clone, Copy, Debug, Default)]
pub struct DeclaredAt(Option<&'static Location<'static>>);

impl DeclaredAt {
    /// The file, from the folder of its Cargo workspace on, and the line, from 1.
    #[must_use]
    pub fn line(self) -> Option<(&'static Path, u32)> {
        self.0.map(|place| (Path::new(place.file()), place.line()))
    }
}

impl PartialEq for DeclaredAt {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// A typed, documented input or output of a skill or chart, or a local of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Its type, with the unit for numbers.
    pub ty: Type,
    /// Value when none is given; an input without one is required.
    pub default: Option<Value>,
    /// Smallest number that is allowed, SI.
    pub minimum: Option<f64>,
    /// Largest number that is allowed, SI.
    pub maximum: Option<f64>,
    /// What names its values are, where they are names that are known before a run.
    pub names: Option<NameKind>,
    /// One sentence for people.
    pub description: String,
}

/// A kind of names that are known before a run. What the names are, the host of the skills knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum NameKind {
    /// A posture of the robot.
    Posture,
    /// An arm of the robot.
    Arm,
    /// A class of objects in prior knowledge.
    ObjectClass,
    /// What judges a simulated run.
    Probe,
}

impl fmt::Display for NameKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Posture => "posture",
            Self::Arm => "arm",
            Self::ObjectClass => "object class",
            Self::Probe => "probe",
        })
    }
}

/// A point in a run that a referee must know: a skill has reached it, with some of its numbers. It has no effect on
/// the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// The name that referees use.
    pub name: String,
    /// When the mark is set.
    pub at: MarkTime,
    /// Its numbers: the name in the mark, and where the number comes from.
    pub numbers: Vec<(String, MarkNumber)>,
}

/// When a mark is set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MarkTime {
    /// When the skill begins.
    Start,
    /// When it ends with `success`.
    Success,
    /// When it raises this event.
    Event(String),
}

/// Where a number of a mark comes from. A mark at the start or at an event can use inputs only.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MarkNumber {
    /// The input of this name.
    Input(String),
    /// The output of this name.
    Output(String),
}

impl Mark {
    /// A mark that is set when the skill begins.
    pub fn at_start(name: &str) -> Self {
        Self { name: name.into(), at: MarkTime::Start, numbers: Vec::new() }
    }

    /// A mark that is set when the skill ends with `success`.
    pub fn at_success(name: &str) -> Self {
        Self { at: MarkTime::Success, ..Self::at_start(name) }
    }

    /// A mark that is set when the skill raises `event`.
    pub fn at_event(event: &str, name: &str) -> Self {
        Self { at: MarkTime::Event(event.into()), ..Self::at_start(name) }
    }

    /// Adds a number: the skill's input `input`.
    #[must_use]
    pub fn with_input(mut self, name: &str, input: &str) -> Self {
        self.numbers.push((name.into(), MarkNumber::Input(input.into())));
        self
    }

    /// Adds a number: the skill's output `output`.
    #[must_use]
    pub fn with_output(mut self, name: &str, output: &str) -> Self {
        self.numbers.push((name.into(), MarkNumber::Output(output.into())));
        self
    }

    /// The numbers of one run of the skill. Values that are absent or no numbers are left out.
    pub fn numbers_of(
        &self,
        inputs: &BTreeMap<String, Value>,
        outputs: &BTreeMap<String, Value>,
    ) -> BTreeMap<String, f64> {
        let number = |source: &MarkNumber| match source {
            MarkNumber::Input(name) => inputs.get(name).and_then(Value::as_f64),
            MarkNumber::Output(name) => outputs.get(name).and_then(Value::as_f64),
        };
        self.numbers.iter().filter_map(|(name, source)| Some((name.clone(), number(source)?))).collect()
    }
}

/// Why a parameter refuses a value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ParameterError {
    /// It has another type, or another unit.
    #[error(transparent)]
    Type(#[from] ConvertError),
    /// The number is not within the bounds.
    #[error("{value} is outside of the allowed range, {} to {}", bound(*.minimum), bound(*.maximum))]
    Range {
        /// The number, SI.
        value: f64,
        /// Smallest number that is allowed.
        minimum: Option<f64>,
        /// Largest number that is allowed.
        maximum: Option<f64>,
    },
}

fn bound(bound: Option<f64>) -> String {
    bound.map_or_else(|| "any".into(), |bound| bound.to_string())
}

/// Why a skill or chart cannot be started with the given inputs.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InputError {
    /// No input of that name.
    #[error("there is no input `{name}`{}", help.as_ref().map_or(String::new(), |h| format!("; {h}")))]
    Unknown {
        /// The name.
        name: String,
        /// What might be meant.
        help: Option<String>,
    },
    /// The value does not fit.
    #[error("input `{name}`: {error}")]
    Value {
        /// The name.
        name: String,
        /// What is wrong.
        error: ParameterError,
    },
    /// An input without default was not given.
    #[error("the input `{name}` is needed, and was not given")]
    Missing {
        /// The name.
        name: String,
    },
    /// The chart has no profile of that name.
    #[error("the chart has no profile `{name}`; it has: {known}")]
    Profile {
        /// The name.
        name: String,
        /// The profiles that it has.
        known: String,
    },
}

/// Checks the given values against the parameters: converts them, checks the bounds, adds defaults.
///
/// # Errors
/// [`InputError`] for a value that is unknown, missing, of another type, or out of bounds.
pub(crate) fn inputs<'p>(
    parameters: impl Iterator<Item = &'p Parameter> + Clone,
    mut given: BTreeMap<String, Value>,
) -> Result<BTreeMap<String, Value>, InputError> {
    let names = || parameters.clone().map(|p| p.name.as_str());
    if let Some(name) = given.keys().find(|name| !names().any(|known| known == *name)) {
        let all = || format!("the inputs are {}", names().collect::<Vec<_>>().join(", "));
        let none = names().next().is_none();
        let help = if none {
            Some("it has no inputs".to_owned())
        } else {
            suggest(name, names()).or_else(|| Some(all()))
        };
        return Err(InputError::Unknown { name: name.clone(), help });
    }
    let one = |parameter: &Parameter| {
        let name = parameter.name.clone();
        let value = match given.remove(&name) {
            Some(value) => {
                parameter.accept(value).map_err(|error| InputError::Value { name: name.clone(), error })?
            }
            None => parameter.default.clone().ok_or_else(|| InputError::Missing { name: name.clone() })?,
        };
        Ok((name, value))
    };
    parameters.clone().map(one).collect()
}

impl Parameter {
    /// A parameter without default and bounds.
    pub fn new(name: &str, ty: Type, description: &str) -> Self {
        let (name, description) = (name.into(), description.into());
        Self { name, ty, default: None, minimum: None, maximum: None, names: None, description }
    }

    /// A value that it takes, as it is written in a file: the default, or something of its type. None where only an
    /// expression gives one.
    #[must_use]
    pub fn example(&self) -> Option<String> {
        let number =
            self.minimum.or(self.maximum).map_or(0.0, |bound| if self.allows(0.0) { 0.0 } else { bound });
        let value = match &self.ty {
            _ if self.default.is_some() => self.default.clone()?,
            Type::Bool => Value::Bool(false),
            Type::Int => Value::Int(number as i64),
            Type::Float(Some(unit)) if *unit != Unit::ONE => return Some(format!("{number} {unit}")),
            Type::Float(_) => Value::Float(number),
            Type::Duration => return Some(format!("{number} s")),
            Type::String | Type::Any => Value::String(String::new()),
            Type::Reference(kind) => Value::String(kind.to_lowercase()),
            Type::Enum(words) => Value::String(words.first()?.clone()),
            Type::List(_) => Value::List(Vec::new()),
            Type::Map(_) => Value::Map(BTreeMap::new()),
            _ => return None,
        };
        self.accept(value.clone()).ok()?;
        match value {
            Value::Reference(reference) => Some(reference.id),
            Value::String(word)
                if !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || c == '_') =>
            {
                Some(word)
            }
            Value::Duration(seconds) => Some(format!("{seconds} s")),
            value => Some(value.to_json().to_string()),
        }
    }

    fn allows(&self, x: f64) -> bool {
        !x.is_nan() && self.minimum.is_none_or(|m| x >= m) && self.maximum.is_none_or(|m| x <= m)
    }

    /// Whether a value already has exactly the declared form. If false, [`accept`](Self::accept) decides.
    pub(crate) fn holds(&self, value: &Value) -> bool {
        match (&self.ty, value) {
            (Type::Bool, Value::Bool(_)) | (Type::String, Value::String(_)) => true,
            (Type::Int, Value::Int(i)) => self.allows(*i as f64),
            (Type::Float(_), Value::Float(x)) | (Type::Duration, Value::Duration(x)) => self.allows(*x),
            _ => false,
        }
    }

    /// The value, converted to the declared type and checked against the bounds.
    ///
    /// # Errors
    /// [`ParameterError`] when it is of another type, or out of bounds.
    pub fn accept(&self, value: Value) -> Result<Value, ParameterError> {
        let value = self.ty.convert(value)?;
        match value.as_f64().filter(|x| !self.allows(*x)) {
            None => Ok(value),
            Some(value) => Err(ParameterError::Range { value, minimum: self.minimum, maximum: self.maximum }),
        }
    }
}

impl SkillManifest {
    /// A skill without inputs, outputs, further outcomes, events, channels or limbs, and with a grace of 1 s.
    #[track_caller]
    pub fn new(name: &str, description: &str) -> Self {
        Self {
            name: name.into(),
            description: description.into(),
            declared_at: DeclaredAt(Some(Location::caller())),
            inputs: Vec::new(),
            outputs: Vec::new(),
            outcomes: Vec::new(),
            events: Vec::new(),
            marks: Vec::new(),
            reads: Vec::new(),
            publishes: Vec::new(),
            limbs: Vec::new(),
            limbs_by_input: BTreeMap::new(),
            grace: Duration::from_secs(1),
            open: false,
        }
    }

    /// Adds an input that the chart must give.
    #[must_use]
    pub fn input(mut self, name: &str, ty: Type, description: &str) -> Self {
        self.inputs.push(Parameter::new(name, ty, description));
        self
    }

    /// Adds an input with a default.
    #[must_use]
    pub fn optional(mut self, name: &str, ty: Type, default: impl Into<Value>, description: &str) -> Self {
        let default = Some(default.into());
        self.inputs.push(Parameter { default, ..Parameter::new(name, ty, description) });
        self
    }

    /// Says that the values of the input that was added last are names that are known before a run.
    #[must_use]
    pub fn names(mut self, kind: NameKind) -> Self {
        self.inputs.iter_mut().last().into_iter().for_each(|input| input.names = Some(kind));
        self
    }

    /// Adds an output.
    #[must_use]
    pub fn output(mut self, name: &str, ty: Type, description: &str) -> Self {
        self.outputs.push(Parameter::new(name, ty, description));
        self
    }

    /// Adds an outcome beyond `success` and `failure`.
    #[must_use]
    pub fn outcome(mut self, name: &str) -> Self {
        self.outcomes.push(name.into());
        self
    }

    /// Adds an event that the skill raises while it runs.
    #[must_use]
    pub fn event(mut self, name: &str) -> Self {
        self.events.push(name.into());
        self
    }

    /// Adds a mark that the skill sets.
    #[must_use]
    pub fn mark(mut self, mark: Mark) -> Self {
        self.marks.push(mark);
        self
    }

    /// Adds a channel that the skill reads.
    #[must_use]
    pub fn reads(mut self, channel: &str) -> Self {
        self.reads.push(channel.into());
        self
    }

    /// Adds a channel that the skill publishes: one that ships, or one that charts declare under `channels:`.
    #[must_use]
    pub fn publishes(mut self, channel: &str) -> Self {
        self.publishes.push(channel.into());
        self
    }

    /// Adds a limb that the skill commands.
    #[must_use]
    pub fn limb(mut self, name: &str) -> Self {
        self.limbs.push(name.into());
        self
    }

    /// Says that a value of an input names a limb that the skill then commands.
    #[must_use]
    pub fn limb_by_input(mut self, input: &str, value: &str, limb: &str) -> Self {
        let of_input = self.limbs_by_input.entry(input.into()).or_default();
        of_input.entry(value.into()).or_default().push(limb.into());
        self
    }

    /// Whether it commands any limb.
    pub fn moves(&self) -> bool {
        !self.limbs.is_empty() || !self.limbs_by_input.is_empty()
    }

    /// The limbs that it commands, for people.
    pub fn commands(&self) -> Vec<String> {
        let by_input = self.limbs_by_input.iter().map(|(input, named)| {
            let limbs: BTreeSet<&str> = named.values().flatten().map(String::as_str).collect();
            format!("by `{input}`: {}", limbs.into_iter().collect::<Vec<_>>().join(" or "))
        });
        self.limbs.iter().cloned().chain(by_input).collect()
    }

    /// Sets how long the skill may take to return after a cancel.
    #[must_use]
    pub fn grace(mut self, grace: Duration) -> Self {
        self.grace = grace;
        self
    }
}

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
