//! The data that the engine needs for every event, stored side by side: event names as numbers, the tree of states,
//! and each state's transitions by event. A lookup costs the logarithm of the number of one state's events,
//! whatever the chart's size.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Kind, Pattern, State, StateId, Transition};

/// Number of an event's name.
pub(crate) type EventNumber = u32;

/// Stands for every name that the chart does not know.
pub(crate) const UNKNOWN: EventNumber = u32::MAX;
pub(crate) const FAILURE: EventNumber = 0;
pub(crate) const SUCCESS: EventNumber = 1;
pub(crate) const ERROR_EXECUTION: EventNumber = 2;
pub(crate) const ERROR_QUEUE: EventNumber = 3;
pub(crate) const AFTER: EventNumber = 4;
pub(crate) const RETRY: EventNumber = 5;
pub(crate) const ERROR_CHANNEL: EventNumber = 6;
/// The names that every program knows; the index is the number.
const FIXED: [&str; 7] =
    ["failure", "success", "error.execution", "error.queue", "after", "retry", "error.channel"];

/// Names of events and their numbers.
#[derive(Debug)]
pub(crate) struct EventNames {
    names: Vec<Arc<str>>,
    numbers: BTreeMap<Arc<str>, EventNumber>,
}

impl Default for EventNames {
    fn default() -> Self {
        let mut all = Self { names: Vec::new(), numbers: BTreeMap::new() };
        FIXED.iter().for_each(|name| {
            all.intern(name);
        });
        all
    }
}

impl EventNames {
    /// The number of a name; a new name gets a new number.
    pub(crate) fn intern(&mut self, name: &str) -> EventNumber {
        if let Some(known) = self.numbers.get(name) {
            return *known;
        }
        let name: Arc<str> = name.into();
        let number = EventNumber::try_from(self.names.len()).unwrap_or(UNKNOWN);
        self.names.push(Arc::clone(&name));
        self.numbers.insert(name, number);
        number
    }

    pub(crate) fn find(&self, name: &str) -> Option<EventNumber> {
        self.numbers.get(name).copied()
    }

    pub(crate) fn name(&self, number: EventNumber) -> &str {
        self.names.get(number as usize).map_or("", |name| &**name)
    }
}

/// First index and end of a range of entries in a list.
type Span = (u32, u32);

/// The data of one state for selecting, leaving and entering.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StateNode {
    parent: StateId,
    last: StateId,
    /// Transitions by exact event, in [`Tables::on`].
    on: Span,
    /// Transitions with a star, in [`Tables::lists`].
    wild: Span,
    /// Eventless transitions, in [`Tables::lists`].
    always: Span,
    /// Entering and leaving it has no other effect.
    pub(crate) plain: bool,
    /// A plain state with nothing inside.
    pub(crate) leaf: bool,
}

/// The data of one transition for taking it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Jump {
    pub(crate) source: StateId,
    /// States are left and entered inside this state; [`StateId::MAX`] for a transition without target.
    pub(crate) domain: StateId,
    /// The target of a simple transition; [`StateId::MAX`] if it stays.
    pub(crate) target: StateId,
    pub(crate) guarded: bool,
    pub(crate) acts: bool,
    /// Whether the domain depends on the states that a history remembers.
    pub(crate) historic: bool,
    /// It stays, or goes to a plain leaf beside its source, and gives no values.
    pub(crate) simple: bool,
}

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct Tables {
    nodes: Vec<StateNode>,
    /// Event and transition number, sorted by both within a state.
    on: Vec<(EventNumber, u32)>,
    lists: Vec<u32>,
    jumps: Vec<Jump>,
}

fn at(list: &[u32]) -> u32 {
    u32::try_from(list.len()).unwrap_or(u32::MAX)
}

impl Tables {
    pub(crate) fn new(event_names: &mut EventNames, states: &[State], transitions: &[Transition]) -> Self {
        let mut tables = Self { nodes: Vec::with_capacity(states.len()), ..Self::default() };
        for state in states {
            let (on_start, wild_start) = (tables.on.len(), at(&tables.lists));
            for t in &state.transitions {
                match &transitions[*t as usize].pattern {
                    Pattern::Exact(name) => {
                        let number = event_names.intern(name);
                        tables.on.push((number, *t));
                    }
                    Pattern::Prefix(_) | Pattern::Any => tables.lists.push(*t),
                    Pattern::None => {}
                }
            }
            tables.on[on_start..].sort_unstable();
            let always_start = at(&tables.lists);
            tables.lists.extend(&state.always);
            let plain = plain(state);
            let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
            tables.nodes.push(StateNode {
                parent: state.parent.unwrap_or(StateId::MAX),
                last: state.last,
                on: (number(on_start), number(tables.on.len())),
                wild: (wild_start, always_start),
                always: (always_start, at(&tables.lists)),
                plain,
                leaf: plain && matches!(state.kind, Kind::Atomic),
            });
        }
        tables
    }

    /// Adds the transitions, whose domains must be known.
    pub(crate) fn set_jumps(&mut self, transitions: &[Transition]) {
        let jump = |t: &Transition| {
            let domain = t.domain.unwrap_or(StateId::MAX);
            let leaf = |s: StateId| self.node(s).leaf && self.node(s).parent == domain;
            let (simple, target) = match t.targets.as_slice() {
                [] => (t.with.is_empty(), StateId::MAX),
                [only] => (t.with.is_empty() && leaf(*only), *only),
                _ => (false, StateId::MAX),
            };
            let (guarded, acts) = (t.guard.is_some(), !t.actions.is_empty());
            Jump { source: t.source, domain, target, guarded, acts, historic: t.historic, simple }
        };
        self.jumps = transitions.iter().map(jump).collect();
    }

    #[inline]
    pub(crate) fn jump(&self, transition: u32) -> &Jump {
        &self.jumps[transition as usize]
    }

    #[inline]
    pub(crate) fn node(&self, state: StateId) -> &StateNode {
        &self.nodes[state as usize]
    }

    pub(crate) fn parent(&self, state: StateId) -> Option<StateId> {
        Some(self.node(state).parent).filter(|p| *p != StateId::MAX)
    }

    pub(crate) fn last(&self, state: StateId) -> StateId {
        self.node(state).last
    }

    /// The transitions of a state that name this event exactly, in the file's order.
    pub(crate) fn exact(&self, state: StateId, event: EventNumber) -> &[(EventNumber, u32)] {
        let (from, to) = self.node(state).on;
        let all = &self.on[from as usize..to as usize];
        let from = all.partition_point(|(number, _)| *number < event);
        let to = all[from..].partition_point(|(number, _)| *number == event);
        &all[from..from + to]
    }

    /// The transitions of a state that name events with a star, in the file's order.
    pub(crate) fn wild(&self, state: StateId) -> &[u32] {
        let (from, to) = self.node(state).wild;
        &self.lists[from as usize..to as usize]
    }

    /// The eventless transitions of a state, in the file's order.
    pub(crate) fn always(&self, state: StateId) -> &[u32] {
        let (from, to) = self.node(state).always;
        &self.lists[from as usize..to as usize]
    }
}

/// Whether entering and leaving a state has no effect beyond the configuration.
fn plain(state: &State) -> bool {
    let kind = match &state.kind {
        Kind::Atomic | Kind::Parallel => true,
        Kind::Composite { initial } => initial.actions.is_empty(),
        _ => false,
    };
    kind && state.parent.is_some()
        && state.enter.is_empty()
        && state.exit.is_empty()
        && state.after.is_empty()
        && state.watches.is_empty()
        && state.always.is_empty()
        && state.with.is_empty()
        && state.histories.is_empty()
        && state.retry.is_none()
        && !state.unbreakable
        && !state.chart_root
}
