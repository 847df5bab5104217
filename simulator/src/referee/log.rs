//! The referee's log of a run: the part of the truth that the figures need, once per millisecond, bounded.

use nalgebra::{Isometry3, Vector3};

use crate::coach::ActionEvent;
use crate::truth::{FrameTruth, TruthEvent, TruthSample};

/// Largest number of samples: 20 minutes. Later ones are dropped, and `truncated` is set.
const MOST_SAMPLES: usize = 1_200_000;
/// Largest number of frames and gestures.
pub(super) const MOST_FRAMES: usize = 100_000;

/// One millisecond. In the recording: `/truth/tcp`, `/truth/contact` and `/truth/sponge`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Time since the robot's start, ns.
    pub stamp_ns: u64,
    /// Pose of the right TCP in the root frame.
    pub tcp: Isometry3<f64>,
    /// Pose of the sponge's middle, if there is a sponge.
    pub sponge: Option<Isometry3<f64>>,
    /// Normal force of the table on the sponge, N.
    pub normal: f64,
    /// Friction of the table on the sponge, N, its magnitude.
    pub tangential: f64,
    /// Position of the coach's tool, while it is shown.
    pub tool: Option<Vector3<f64>>,
}

/// The log of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TruthLog {
    /// One per millisecond, in order of time.
    pub records: Vec<Record>,
    /// The coach's events.
    pub coach: Vec<ActionEvent>,
    /// The truth about every rendered frame.
    pub frames: Vec<FrameTruth>,
    /// Whether entries were dropped because the log was full.
    pub truncated: bool,
}

impl TruthLog {
    pub(super) fn sample(&mut self, s: &TruthSample) {
        if self.records.len() >= MOST_SAMPLES {
            if !self.truncated {
                tracing::warn!("the referee's log is full; later samples do not count");
            }
            self.truncated = true;
            return;
        }
        self.records.push(Record {
            stamp_ns: s.stamp_ns,
            tcp: s.tcp,
            sponge: s.sponge,
            normal: s.contact.normal,
            tangential: s.contact.tangential.norm(),
            tool: s.coach.tool.map(|t| t.translation.vector),
        });
    }

    pub(super) fn frame(&mut self, frame: &FrameTruth) {
        if self.frames.len() < MOST_FRAMES {
            self.frames.push(*frame);
        } else {
            self.truncated = true;
        }
    }

    pub(super) fn event(&mut self, _stamp_ns: u64, event: &TruthEvent) {
        if let TruthEvent::Coach(event) = event
            && self.coach.len() < MOST_FRAMES
        {
            self.coach.push(*event);
        }
    }

    /// The records from `from_ns` to before `to_ns`.
    #[must_use]
    pub fn between(&self, from_ns: u64, to_ns: u64) -> &[Record] {
        let at = |t: u64| self.records.partition_point(|r| r.stamp_ns < t);
        let (from, to) = (at(from_ns), at(to_ns));
        &self.records[from..to.max(from)]
    }

    /// The last record at or before a time.
    #[must_use]
    pub fn at(&self, stamp_ns: u64) -> Option<&Record> {
        let after = self.records.partition_point(|r| r.stamp_ns <= stamp_ns);
        after.checked_sub(1).map(|i| &self.records[i])
    }
}
