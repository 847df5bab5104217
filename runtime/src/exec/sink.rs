//! Receivers of a run's trace: recordings, progress lines, viewers.

use crate::engine::InputRecord;
use crate::trace::TraceEvent;

/// Receives trace events in order. It is called in the middle of a run and must return at once.
pub trait TraceSink: Send {
    /// Called for each trace event.
    fn record(&mut self, event: &TraceEvent);
    /// Called for each input of the engine, before the trace events that it causes. All inputs, in order, are
    /// enough to replay the run.
    fn input(&mut self, _turn: &InputRecord) {}
}

impl<F: FnMut(&TraceEvent) + Send> TraceSink for F {
    fn record(&mut self, event: &TraceEvent) {
        self(event);
    }
}
