//! Records the states that a run without rest cycles through, so that its failure can name them.

use crate::program::{Program, StateId};

/// How many states a failure names.
const MAX_NAMED: usize = 8;
/// States are recorded when the count is this close to a bound.
pub(crate) const RECORDED_BEFORE_BOUND: u32 = 32;

/// The most recent states, each once.
#[derive(Debug, Default)]
pub(crate) struct Circle(Vec<StateId>);

impl Circle {
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    pub(crate) fn note(&mut self, state: StateId) {
        self.0.retain(|known| *known != state);
        self.0.insert(0, state);
        self.0.truncate(MAX_NAMED);
    }

    /// The paths of the states, in the file's order.
    pub(crate) fn names(&self, program: &Program) -> String {
        let mut states = self.0.clone();
        states.sort_unstable();
        states.iter().map(|state| format!("`{}`", program.path(*state))).collect::<Vec<_>>().join(", ")
    }
}
