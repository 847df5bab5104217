//! Events inside the engine: their origin, the states that may take them, and the queues in which they wait.

use std::sync::Arc;

use armarium_values::Value;

use crate::program::{EventNumber, FAILURE, Program, StateId, UNKNOWN};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Origin {
    /// All active states see it.
    Broadcast,
    /// An expression failed in this state.
    Error(StateId),
    /// A state reported its outcome. `region_end`: a region reached a final state of its own.
    Outcome { state: StateId, entry: u64, region_end: bool },
    /// A watch of the state fired.
    Watch { state: StateId, entry: u64 },
    /// A timer of the state expired; the event can take this transition only.
    After { state: StateId, entry: u64, transition: u32 },
    /// The state's wait before its next retry is over.
    Retry { state: StateId, entry: u64 },
}

/// Kept small, as events are moved often: rare fields are behind a pointer.
#[derive(Clone, Debug)]
pub(super) struct Event {
    pub(super) number: EventNumber,
    /// The number of parts of its data; 0 for a scalar.
    parts: u32,
    pub(super) origin: Origin,
    data: Option<Box<Value>>,
    rare: Option<Box<Rare>>,
}

#[derive(Clone, Debug, Default)]
struct Rare {
    /// The name, if the chart does not know it.
    name: Option<Arc<str>>,
    /// For an event that was held back: the states inside which it was already handled. It is not offered there
    /// again.
    served: Vec<StateId>,
}

impl Event {
    #[inline]
    pub(super) fn new(number: EventNumber, data: Value, origin: Origin) -> Self {
        let parts = match &data {
            Value::List(_) | Value::Map(_) | Value::String(_) | Value::Bytes(_) => data.parts(),
            _ => 0,
        };
        let parts = u32::try_from(parts).unwrap_or(u32::MAX);
        let data = if matches!(data, Value::Null) { None } else { Some(Box::new(data)) };
        Self { number, parts, origin, data, rare: None }
    }

    /// An event for all active states, by its name.
    pub(super) fn named(program: &Program, name: &str, data: Value) -> Self {
        if let Some(number) = program.event_names.find(name) {
            return Self::new(number, data, Origin::Broadcast);
        }
        let rare = Rare { name: Some(name.into()), served: Vec::new() };
        Self { rare: Some(Box::new(rare)), ..Self::new(UNKNOWN, data, Origin::Broadcast) }
    }

    pub(super) fn data(&self) -> &Value {
        static NULL: Value = Value::Null;
        self.data.as_deref().unwrap_or(&NULL)
    }

    /// The number of parts of its data; 0 for a scalar.
    pub(super) fn parts(&self) -> usize {
        self.parts as usize
    }

    /// Takes the list of states that already handled the event.
    pub(super) fn take_served(&mut self) -> Vec<StateId> {
        self.rare.as_deref_mut().map_or_else(Vec::new, |rare| std::mem::take(&mut rare.served))
    }

    pub(super) fn set_served(&mut self, served: Vec<StateId>) {
        if !served.is_empty() {
            self.rare.get_or_insert_default().served = served;
        }
    }

    pub(super) fn name<'e>(&'e self, program: &'e Program) -> &'e str {
        let other = self.rare.as_deref().and_then(|rare| rare.name.as_deref());
        other.unwrap_or_else(|| program.event_names.name(self.number))
    }

    /// The state that the event belongs to, and the entry of that state that it was meant for.
    pub(super) fn scope(&self) -> Option<(StateId, u64)> {
        match self.origin {
            Origin::Broadcast | Origin::Error(_) => None,
            Origin::Outcome { state, entry, .. }
            | Origin::Watch { state, entry }
            | Origin::Retry { state, entry }
            | Origin::After { state, entry, .. } => Some((state, entry)),
        }
    }

    pub(super) fn is_failure(&self) -> bool {
        self.number == FAILURE && matches!(self.origin, Origin::Outcome { .. })
    }

    pub(super) fn is_error(&self, program: &Program) -> bool {
        matches!(self.origin, Origin::Error(_)) || self.name(program).starts_with("error.")
    }
}
