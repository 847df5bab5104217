//! Who takes the trace of a run while it runs: recordings, progress lines, viewers.

use crate::engine::InputRecord;
use crate::trace::TraceEvent;

/// Takes what happened, in order. Called in the middle of a run: it must return at once.
pub trait TraceSink: Send {
    /// One thing happened.
    fn record(&mut self, event: &TraceEvent);
    /// The engine was told something; what came of it is recorded next. All these, in order, make a run that can be
    /// replayed.
    fn input(&mut self, _turn: &InputRecord) {}
}

impl<F: FnMut(&TraceEvent) + Send> TraceSink for F {
    fn record(&mut self, event: &TraceEvent) {
        self(event);
    }
}
