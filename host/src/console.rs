//! The output of a run or an agent for people. The program `armarium` draws a line on the terminal; a program of your
//! own can stay silent ([`Silent`]) or draw something else.

use std::sync::Arc;

use armarium_source::Finding;
use armarium_viewer::progress::ProgressLine;

/// Returns the time of the robot's world, ns.
pub type WorldClock = Arc<dyn Fn() -> u64 + Send + Sync>;

/// The output of a run or an agent for people. Every call must return at once.
pub trait Console: Send + Sync {
    /// Information that the user needs: listening endpoints, data that was not kept.
    fn note(&self, _text: &str) {}

    /// An event of the chart, as a line with the time.
    fn happened(&self, _line: &str) {}

    /// An item of the run's trace, for programs: `at_ns` and `item` of a [`TraceEvent`](armarium_runtime::trace::TraceEvent).
    fn traced(&self, _event: &serde_json::Value) {}

    /// The progress.
    fn progress(&self, _status: &ProgressLine) {}

    /// The end of the run.
    fn finished(&self, _status: &ProgressLine) {}

    /// Warnings of a chart that runs nevertheless.
    fn warnings(&self, _findings: &[Finding]) {}

    /// The skill of a state blocks the program's only thread. The robot stands still; the run cannot continue.
    fn blocked(&self, _state: &str) {}

    /// A page in the browser shows this from now on.
    fn page(&self, _url: &str) {}

    /// From now on there is a world with this clock.
    fn world_begins(&self, _clock: WorldClock) {}
}

/// No output.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Console for Silent {}
