//! What a skill declares about itself: inputs, outputs, outcomes, limbs, channels, and marks for the referee of a run.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::Location;
use std::path::Path;
use std::time::Duration;

use armarium_values::{Type, Value};

use crate::attention::{Attended, Attends};

use super::parameter::{NameKind, Parameter};

/// What a skill declares about itself; used by the checker, the editor's schema and `armarium skills`.
#[derive(Clone, Debug, PartialEq)]
pub struct SkillManifest {
    /// The name that charts use.
    pub name: String,
    /// Names that charts used for it before, and still may.
    pub formerly: Vec<String>,
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
    /// What it needs to know the place of while it runs.
    pub attends: Vec<Attends>,
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
    /// When it ends, however it does.
    End,
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

    /// A mark that is set when the skill ends, however it does.
    pub fn at_end(name: &str) -> Self {
        Self { at: MarkTime::End, ..Self::at_start(name) }
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

impl SkillManifest {
    /// Whether the skill can end so: `success`, `failure`, or an outcome that it declares.
    pub fn has_outcome(&self, name: &str) -> bool {
        ["success", "failure"].contains(&name) || self.outcomes.iter().any(|outcome| outcome == name)
    }

    /// A skill without inputs, outputs, further outcomes, events, channels or limbs, and with a grace of 1 s.
    #[track_caller]
    pub fn new(name: &str, description: &str) -> Self {
        Self {
            name: name.into(),
            formerly: Vec::new(),
            description: description.into(),
            declared_at: DeclaredAt(Some(Location::caller())),
            inputs: Vec::new(),
            outputs: Vec::new(),
            outcomes: Vec::new(),
            events: Vec::new(),
            marks: Vec::new(),
            reads: Vec::new(),
            publishes: Vec::new(),
            attends: Vec::new(),
            limbs: Vec::new(),
            limbs_by_input: BTreeMap::new(),
            grace: Duration::from_secs(1),
            open: false,
        }
    }

    /// Says that charts may also use a name that the skill, or one that it replaces, had before.
    #[must_use]
    pub fn formerly(mut self, name: &str) -> Self {
        self.formerly.push(name.into());
        self
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

    /// Says that the skill needs to know, while it runs, the place of what the value of an input names: a reference into memory, a class or
    /// a place. An error of `within` m is borne; `weight` is 1 for what counts as usual.
    #[must_use]
    pub fn attends(mut self, input: &str, within: f64, weight: f64) -> Self {
        self.attends.push(Attends { what: Attended::Input(input.into()), within, weight });
        self
    }

    /// The same for what a pattern of memory matches.
    #[must_use]
    pub fn attends_pattern(mut self, pattern: &str, within: f64, weight: f64) -> Self {
        self.attends.push(Attends { what: Attended::Pattern(pattern.into()), within, weight });
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
