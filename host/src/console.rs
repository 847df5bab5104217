//! Where a run and an agent tell people how it goes. The program `armarium` draws a line on the terminal; a program of one's own
//! may say nothing ([`Silent`]) or draw what it likes.

use std::sync::Arc;

use armarium_source::Finding;
use armarium_viewer::progress::Status;

/// Tells the time of the robot's world, ns.
pub type Clock = Arc<dyn Fn() -> u64 + Send + Sync>;

/// Where a run and an agent tell people how it goes. Every call must return at once.
pub trait Console: Send + Sync {
    /// Something that whoever started it has to know: where it listens, what was not kept.
    fn note(&self, text: &str) {
        let _ = text;
    }

    /// Something that the chart did, as a line with the time.
    fn happened(&self, line: &str) {
        let _ = line;
    }

    /// How far it has come.
    fn progress(&self, status: &Status) {
        let _ = status;
    }

    /// It has come to its end.
    fn finished(&self, status: &Status) {
        let _ = status;
    }

    /// What is doubtful in a chart that runs all the same.
    fn warnings(&self, findings: &[Finding]) {
        let _ = findings;
    }

    /// The skill of a state keeps the program's only thread to itself. The robot stands; nothing more can be done here.
    fn blocked(&self, state: &str) {
        let _ = state;
    }

    /// From now on there is a world with this time.
    fn world_begins(&self, clock: Clock) {
        let _ = clock;
    }
}

/// Says nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Console for Silent {}
