//! Records what the engine read from its sensors in each turn, beside the input, so that the turn can be replayed.
//!
//! The engine is a function of its inputs and of the values that its expressions read. With the same inputs, and
//! for each the same readings in the same order, it goes through the same states.

use std::cell::RefCell;
use std::collections::VecDeque;

use armarium_values::Value;
use serde::{Deserialize, Serialize};

use super::{Effect, Engine, Input, Sensors};

/// One reading of a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorReading {
    /// The value of a channel or of a field of it; `None` if there was none.
    Channel(Option<Value>),
    /// Seconds since a channel was published; `None` if it never was.
    Age(Option<f64>),
}

/// One turn of a run: the engine's input and its sensor readings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputRecord {
    /// Virtual time since the run began, ns.
    pub at_ns: u64,
    /// The input; `None` for the start.
    pub input: Option<Input>,
    /// The values that expressions read, in order.
    pub seen: Vec<SensorReading>,
}

impl Engine {
    /// Replays a recorded turn. An engine with the same chart inputs that replays all turns of a run goes through
    /// the same states and gives the same effects.
    pub fn replay(&mut self, turn: &InputRecord, out: &mut Vec<Effect>) {
        let sensors = Replaying::new(turn.seen.iter().cloned());
        match &turn.input {
            None => self.start(&sensors, out),
            Some(input) => self.handle(input.clone(), &sensors, out),
        }
    }
}

/// Sensors that forward to others and record every reading.
pub struct RecordingSensors<'s> {
    inner: &'s dyn Sensors,
    seen: RefCell<Vec<SensorReading>>,
}

impl std::fmt::Debug for RecordingSensors<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recording").field("seen", &self.seen).finish_non_exhaustive()
    }
}

impl<'s> RecordingSensors<'s> {
    /// Records what is read from `inner`.
    pub fn new(inner: &'s dyn Sensors) -> Self {
        Self { inner, seen: RefCell::new(Vec::new()) }
    }

    /// The readings, in order.
    #[must_use]
    pub fn seen(self) -> Vec<SensorReading> {
        self.seen.into_inner()
    }
}

impl Sensors for RecordingSensors<'_> {
    fn channel(&self, channel: u32, path: &[String]) -> Option<Value> {
        let value = self.inner.channel(channel, path);
        self.seen.borrow_mut().push(SensorReading::Channel(value.clone()));
        value
    }
    fn age(&self, channel: u32) -> Option<f64> {
        let age = self.inner.age(channel);
        self.seen.borrow_mut().push(SensorReading::Age(age));
        age
    }
}

/// Sensors that return recorded readings in the same order, and nothing after the last one.
#[derive(Debug, Default)]
pub struct Replaying {
    seen: RefCell<VecDeque<SensorReading>>,
}

impl Replaying {
    /// Sensors that return these readings.
    pub fn new(seen: impl IntoIterator<Item = SensorReading>) -> Self {
        Self { seen: RefCell::new(seen.into_iter().collect()) }
    }
}

impl Sensors for Replaying {
    fn channel(&self, _: u32, _: &[String]) -> Option<Value> {
        match self.seen.borrow_mut().pop_front() {
            Some(SensorReading::Channel(value)) => value,
            _ => None,
        }
    }
    fn age(&self, _: u32) -> Option<f64> {
        match self.seen.borrow_mut().pop_front() {
            Some(SensorReading::Age(age)) => age,
            _ => None,
        }
    }
}
