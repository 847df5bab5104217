//! The report's figures, as a pure function of world, log, marks and vision results.
//!
//! They use the raw 1 kHz truth, unfiltered. Where the definition of a figure leaves a choice, the function that
//! computes it documents it. Grasp, imitation and force are here; coaching, gestures and wiping have files of their
//! own.

use super::Mark;
use super::gestures::gestures;
use super::log::TruthLog;
use super::paths::{distance_to_coach, mean_period, positions, repeat_period};
use super::report::{ForceFigures, GraspFigures, ImitationFigures, RefereeReport};
use super::wiped::WipedCells;
use crate::coach::{CoachPath, EventKind};
use crate::world::World;

/// Contact counts as lost below this normal force, N.
const LOST_N: f64 = 0.2;
/// Window after the first touch in which its peak is searched, s.
const TOUCHDOWN_S: f64 = 0.5;
/// Number of cycles over which the force is judged.
const FORCE_CYCLES: f64 = 5.0;

/// Computes all figures.
pub fn compute(
    world: &World,
    log: &TruthLog,
    marks: &[(u64, Mark)],
    seen: &[(u64, Option<String>)],
) -> RefereeReport {
    let run = RunLog::new(world, log, marks);
    RefereeReport {
        grasp: run.grasp(),
        imitation: run.imitation(),
        force: run.force(),
        wiped_fraction: run.wiped().and_then(|cells| cells.swept.covered_by(&cells.cleaned)),
        coaching: run.coaching(),
        gestures: gestures(log, seen),
    }
}

/// The object that is judged, by its index in the world's `objects`: the one in the hand when it closed last; where nothing was
/// marked so, the one in question at the end.
pub fn judged_object(log: &TruthLog, marks: &[(u64, Mark)]) -> Option<usize> {
    let closed = marks.iter().rev().find(|(_, mark)| *mark == Mark::GraspClosed);
    let record = closed.map_or(log.records.last(), |(at, _)| log.at(*at));
    Some(record?.object?.0)
}

/// The cells of the table that had to be cleaned, and those that were; `None` before adaptation has ended.
pub fn wiped(world: &World, log: &TruthLog, marks: &[(u64, Mark)]) -> Option<WipedCells> {
    RunLog::new(world, log, marks).wiped()
}

pub(super) struct RunLog<'a> {
    pub(super) world: &'a World,
    pub(super) log: &'a TruthLog,
    marks: &'a [(u64, Mark)],
    pub(super) path: CoachPath,
}

impl<'a> RunLog<'a> {
    fn new(world: &'a World, log: &'a TruthLog, marks: &'a [(u64, Mark)]) -> Self {
        let path = CoachPath::new(&world.coach.demonstration.clone().unwrap_or_default());
        Self { world, log, marks, path }
    }
}

impl RunLog<'_> {
    /// The last mark for which `test` is true.
    pub(super) fn marked(&self, test: impl Fn(&Mark) -> bool) -> Option<(u64, Mark)> {
        self.marks.iter().rev().find(|(_, m)| test(m)).copied()
    }

    pub(super) fn end_ns(&self) -> u64 {
        self.log.records.last().map_or(0, |r| r.stamp_ns + 1)
    }

    /// When the coach first acts, or the end of the run.
    pub(super) fn coaching_ns(&self) -> u64 {
        let first = self.log.coach.iter().find(|e| e.event == EventKind::Began);
        first.map_or(self.end_ns(), |e| ns(e.t))
    }

    /// Of the object in the hand when it closed last; of the one in question if there was none in it.
    fn grasp(&self) -> Option<GraspFigures> {
        let (at, _) = self.marked(|m| *m == Mark::GraspClosed)?;
        let record = self.log.at(at)?;
        let (object, pose) = record.object?;
        let in_tcp = record.tcp.inverse() * pose;
        let off = in_tcp.translation.vector - self.world.grasp_in_tcp();
        let object = self.world.objects.get(object)?.name.clone();
        Some(GraspFigures { object, position_error_m: off.norm() })
    }

    /// From the steady part of the free-space motion (from [`Mark::FreeSpaceSteady`], else from the end of
    /// learning) until adaptation starts. The path is the last whole period.
    fn imitation(&self) -> Option<ImitationFigures> {
        let (learned, _) = self.marked(|m| *m == Mark::LearningEnded)?;
        let steady = self.marked(|m| *m == Mark::FreeSpaceSteady).map_or(learned, |(at, _)| at);
        let until = self
            .marks
            .iter()
            .find(|(at, m)| *m == Mark::AdaptationStarted && *at > learned)
            .map_or(self.end_ns(), |(at, _)| *at);
        let path = positions(self.log.between(steady.max(learned), until));
        let period_s = repeat_period(&path)?;
        let samples = (period_s * 1e3).ceil() as usize + 2;
        let last = mean_period(&path[path.len().saturating_sub(samples)..], period_s, 1)?;
        Some(ImitationFigures {
            frequency_hz: 1.0 / period_s,
            demonstrated_frequency_hz: self.world.coach.demonstration.as_ref().map(|shown| shown.frequency),
            path_rms_m: distance_to_coach(&last, &self.path),
        })
    }

    /// Five periods of the executed motion from the end of adaptation, or fewer if the coach acts before.
    fn force(&self) -> Option<ForceFigures> {
        let (ended, mark) = self.marked(|m| matches!(m, Mark::AdaptationEnded { .. }))?;
        let Mark::AdaptationEnded { desired_n, cycles } = mark else { return None };
        let until = self.coaching_ns().max(ended);
        let after = self.log.between(ended, until);
        let period_s = repeat_period(&positions(&after[..after.len().min(15_000)]))?;
        let count = ((FORCE_CYCLES * period_s * 1e3).round() as usize).min(after.len());
        let forces: Vec<f64> = after[..count].iter().map(|r| r.normal).collect();
        let n = forces.len() as f64;
        let squares: f64 = forces.iter().map(|f| (f - desired_n).powi(2)).sum();
        Some(ForceFigures {
            desired_n,
            mean_n: forces.iter().sum::<f64>() / n,
            rms_error_n: (squares / n).sqrt(),
            max_n: forces.iter().copied().fold(0.0, f64::max),
            contact_lost_s: forces.iter().filter(|f| **f < LOST_N).count() as f64 * 1e-3,
            touchdown_max_n: self.touchdown(ended),
            cycles,
        })
    }

    fn touchdown(&self, ended: u64) -> f64 {
        let started = self.marked(|m| *m == Mark::AdaptationStarted).map_or(0, |(at, _)| at);
        let adapting = self.log.between(started.min(ended), ended);
        let touched = adapting.iter().position(|r| r.normal > LOST_N).unwrap_or(adapting.len());
        adapting[touched..].iter().take((TOUCHDOWN_S * 1e3) as usize).map(|r| r.normal).fold(0.0, f64::max)
    }
}

/// Seconds as nanoseconds.
pub(super) fn ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::{Isometry3, Vector3};

    use super::super::log::Record;
    use super::*;
    use crate::coach::{ActionEvent, ActionKind, wrap};

    /// A run that performs the coach's path perfectly with `force(t)` N, shifted along y by `shift(t, phase)`, with
    /// the object level and nominal in the hand.
    fn run(seconds: f64, force: impl Fn(f64) -> f64, shift: impl Fn(f64, f64) -> f64) -> (World, TruthLog) {
        let mut world = World::default();
        world.table.tilt_deg = [0.0; 2];
        world.table.bumps.clear();
        let path = CoachPath::new(&world.coach.demonstration.clone().unwrap());
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
        // The default robot grasps along its TCP's x.
        let grasp = world.grasp_in_tcp().x;
        let mut log = TruthLog::default();
        for i in 0..(seconds * 1e3) as u64 {
            let t = i as f64 * 1e-3;
            let phase = 0.5 * t;
            let [x, y] = path.point(TAU * phase);
            let normal = force(t);
            let z = 0.95 + 0.02 + grasp - normal / 2000.0;
            let at = Vector3::new(x, y + shift(t, phase.fract()), z);
            let tcp = Isometry3::from_parts(at.into(), down);
            let object = Isometry3::translation(at.x, at.y, at.z - grasp);
            log.records.push(Record {
                stamp_ns: i * 1_000_000,
                tcp,
                object: Some((0, object)),
                normal,
                tangential: 0.0,
                tool: None,
            });
        }
        (world, log)
    }

    fn marks(free: u64, adapted: u64) -> Vec<(u64, Mark)> {
        let s = 1_000_000_000;
        vec![
            (s, Mark::GraspClosed),
            (s, Mark::LearningEnded),
            (free * s, Mark::AdaptationStarted),
            (adapted * s, Mark::AdaptationEnded { desired_n: 8.0, cycles: 4 }),
        ]
    }

    #[test]
    fn a_perfect_run_has_perfect_figures() {
        let (world, log) = run(30.0, |t| if t < 10.0 { 0.0 } else { 8.0 }, |_, _| 0.0);
        let report = compute(&world, &log, &marks(10, 12), &[]);
        assert!(report.grasp.unwrap().position_error_m < 1e-9);
        let imitation = report.imitation.unwrap();
        assert!((imitation.frequency_hz - 0.5).abs() < 1e-4);
        assert!(imitation.path_rms_m < 2e-4, "{imitation:?}");
        let force = report.force.unwrap();
        assert!((force.mean_n - 8.0).abs() < 1e-9 && force.rms_error_n < 1e-9 && force.contact_lost_s == 0.0);
        assert!((force.touchdown_max_n - 8.0).abs() < 1e-9);
        assert!(report.wiped_fraction.unwrap() > 0.99, "{:?}", report.wiped_fraction);
        assert!(report.coaching.is_empty() && report.gestures.is_none());
    }

    #[test]
    fn a_weak_force_wipes_nothing_and_errors_are_counted() {
        let (world, log) = run(30.0, |_| 2.0, |_, _| 0.0);
        assert_eq!(compute(&world, &log, &marks(10, 12), &[]).wiped_fraction, Some(0.0));
        let wave = |t: f64| 8.0 + 2.0 * (TAU * 0.5 * t).sin();
        let (world, log) = run(30.0, wave, |_, _| 0.0);
        let force = compute(&world, &log, &marks(10, 12), &[]).force.unwrap();
        assert!((force.rms_error_n - 2f64.sqrt()).abs() < 1e-3 && (force.max_n - 10.0).abs() < 1e-3);
    }

    /// The path is pushed out by 30 mm about phase 0.25 from 20 s on; 24 mm remain after 30 s.
    #[test]
    fn a_local_shift_is_measured_where_it_is() {
        let bump = |t: f64, phase: f64| {
            let off = wrap(TAU * (phase - 0.25)) / TAU;
            let height = if t < 20.0 {
                0.0
            } else if t < 31.05 {
                0.03
            } else {
                0.024
            };
            height * (-(off / 0.08).powi(2)).exp()
        };
        let (world, mut log) = run(45.0, |_| 8.0, bump);
        for (t, event) in [(15.0, EventKind::Began), (28.0, EventKind::Ended)] {
            log.coach.push(ActionEvent { step: 0, kind: ActionKind::Push, event, t });
        }
        let report = compute(&world, &log, &marks(2, 3), &[]);
        let push = &report.coaching[0];
        assert_eq!(push.kind, "push");
        assert!((push.displacement_m.unwrap() - 0.03).abs() < 1.5e-3, "{push:?}");
        assert!((push.retained_m.unwrap() - 0.024).abs() < 1.5e-3, "{push:?}");
        assert!(push.far_side_rms_m.unwrap() < 2e-3, "{push:?}");
        assert!(push.direction_error_deg.unwrap() < 5.0 && push.slowed_to.is_none());
    }
}
