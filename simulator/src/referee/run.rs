//! A run as the probes see it: the world, the log of its truth, the marks of skills, and what vision saw.

use std::collections::BTreeMap;

use super::Milestone;
use super::log::TruthLog;
use crate::coach::{ActionEvent, CoachPath, EventKind};
use crate::world::World;

/// Everything that a probe may read.
pub(super) struct JudgedRun<'a> {
    pub(super) world: &'a World,
    pub(super) log: &'a TruthLog,
    marks: &'a [(u64, Milestone)],
    /// What vision recognised in a frame, by the frame's time.
    pub(super) seen: BTreeMap<u64, Option<&'a str>>,
    /// The path that the coach shows.
    pub(super) path: CoachPath,
}

impl<'a> JudgedRun<'a> {
    pub(super) fn new(
        world: &'a World,
        log: &'a TruthLog,
        marks: &'a [(u64, Milestone)],
        seen: &'a [(u64, Option<String>)],
    ) -> Self {
        let path = CoachPath::new(&world.coach.demonstration.clone().unwrap_or_default());
        let seen = seen.iter().map(|(t, label)| (*t, label.as_deref())).collect();
        Self { world, log, marks, seen, path }
    }

    /// All marks, with their times, ns.
    pub(super) fn marks(&self) -> &'a [(u64, Milestone)] {
        self.marks
    }

    /// The last mark for which `test` is true.
    pub(super) fn marked(&self, test: impl Fn(&Milestone) -> bool) -> Option<(u64, Milestone)> {
        self.marks.iter().rev().find(|(_, m)| test(m)).copied()
    }

    /// The time of the first mark for which `test` is true, ns.
    pub(super) fn first_time_of(&self, test: impl Fn(&Milestone) -> bool) -> Option<u64> {
        self.marks.iter().find(|(_, m)| test(m)).map(|(at, _)| *at)
    }

    /// The time of the last such mark, ns.
    pub(super) fn time_of(&self, test: impl Fn(&Milestone) -> bool) -> Option<u64> {
        self.marked(test).map(|(at, _)| at)
    }

    /// When adaptation ended, ns.
    pub(super) fn adapted(&self) -> Option<u64> {
        self.time_of(|m| matches!(m, Milestone::AdaptationEnded { .. }))
    }

    /// When the robot left free space for the first time after `from`, ns.
    pub(super) fn lowered_after(&self, from: u64) -> Option<u64> {
        let mut marks = self.marks.iter();
        marks.find(|(at, m)| *m == Milestone::AdaptationStarted && *at > from).map(|(at, _)| *at)
    }

    pub(super) fn end_ns(&self) -> u64 {
        self.log.records.last().map_or(0, |r| r.stamp_ns + 1)
    }

    /// When the coach first acts, or the end of the run.
    pub(super) fn coaching_ns(&self) -> u64 {
        let first = self.actions(EventKind::Began).next();
        first.map_or(self.end_ns(), |e| ns(e.t))
    }

    /// The coach's events of a kind.
    pub(super) fn actions(&self, event: EventKind) -> impl Iterator<Item = &'a ActionEvent> {
        self.log.coach.iter().filter(move |e| e.event == event)
    }

    /// The object that is judged, by its index among the world's bodies: the one in the hand when it closed last; where nothing
    /// was marked so, the one in question at the end.
    pub(super) fn judged_object(&self) -> Option<usize> {
        let closed = self.time_of(|mark| *mark == Milestone::GraspClosed);
        let record = closed.map_or(self.log.records.last(), |at| self.log.at(at));
        Some(record?.object?.0)
    }
}

/// Seconds as nanoseconds.
pub(super) fn ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Nanoseconds as seconds.
pub(super) fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

/// The name of an action: `push`, `fist` ...
pub(super) fn name(action: &ActionEvent) -> String {
    action.kind.name().replace('_', " ")
}
