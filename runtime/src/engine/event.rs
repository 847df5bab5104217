//! Events as the engine keeps them: where they come from, who may take them, and the queues that they wait in.

use std::sync::Arc;

use armarium_values::Value;

use super::program::{Program, StateId};
use super::tables::{FAILURE, Symbol, UNKNOWN};

/// What an event is, beyond its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Origin {
    /// All active states see it.
    Broadcast,
    /// An expression failed in this state.
    Error(StateId),
    /// The state reported its outcome; `region_end` when it is a region that came to a final state of its own.
    Outcome { state: StateId, entry: u64, region_end: bool },
    /// A watch of the state fired.
    Watch { state: StateId, entry: u64 },
    /// A timer of the state ran out; it takes this transition only.
    After { state: StateId, entry: u64, transition: u32 },
    /// The state's wait before its next try is over.
    Retry { state: StateId, entry: u64 },
}

#[derive(Clone, Debug)]
pub(super) struct Event {
    pub(super) symbol: Symbol,
    /// The name, where the chart does not know it.
    other: Option<Arc<str>>,
    pub(super) data: Value,
    pub(super) origin: Origin,
    /// What an event that was held back has already moved: states inside do not see it again.
    pub(super) served: Option<Box<[StateId]>>,
}

impl Event {
    pub(super) fn new(symbol: Symbol, data: Value, origin: Origin) -> Self {
        Self { symbol, other: None, data, origin, served: None }
    }

    /// An event for all active states, by its name.
    pub(super) fn named(program: &Program, name: &str, data: Value) -> Self {
        let symbol = program.tables.symbols.find(name);
        let other = symbol.is_none().then(|| name.into());
        Self { symbol: symbol.unwrap_or(UNKNOWN), other, data, origin: Origin::Broadcast, served: None }
    }

    pub(super) fn name<'e>(&'e self, program: &'e Program) -> &'e str {
        self.other.as_deref().unwrap_or_else(|| program.tables.symbols.name(self.symbol))
    }

    /// The state that it belongs to and the entry that it was meant for.
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
        self.symbol == FAILURE && matches!(self.origin, Origin::Outcome { .. })
    }

    pub(super) fn is_error(&self, program: &Program) -> bool {
        matches!(self.origin, Origin::Error(_)) || self.name(program).starts_with("error.")
    }
}
