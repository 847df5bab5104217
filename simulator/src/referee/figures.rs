//! The report's figures, as a pure function of world, log, marks and what vision saw.
//!
//! Raw 1 kHz truth, unfiltered. Where the definition leaves something open, the function that computes the
//! figure says what is done. A figure whose data are missing is absent.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Serialize;

use super::Mark;
use super::log::{Record, TruthLog};
use super::paths::{
    POINTS, Period, aligned, distance_to_coach, index_of_phase, mean_period, positions, repeat_period,
};
use crate::bed::Bed;
use crate::coach::{ActionKind, CoachPath, EventKind, PhaseTracker};
use crate::simulation::WIPE_EVERY;
use crate::table::{DirtGrid, TableTop};
use crate::truth::FrameTruth;
use crate::world::{CoachingAction, Gesture, World};

/// Distance from TCP to the middle of a nominally grasped object along the TCP's x, m: `grasp_right`.
const GRASP_OFFSET: f64 = 0.08;
/// Under this normal force, contact is lost, N.
const LOST_N: f64 = 0.2;
/// How long after the first touch its peak is looked for, s.
const TOUCHDOWN_S: f64 = 0.5;
/// Cycles over which the force is judged.
const FORCE_CYCLES: f64 = 5.0;
/// Least time that a gesture (or no hand) lasts before a frame counts, s.
const STEADY_S: f64 = 0.3;
/// How long the motion takes to its own speed after its start and after the coach has gone, s.
const RECOVERY_S: f64 = 1.0;

/// What the referee found. Names are the report's.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RefereeReport {
    /// The grasp.
    pub grasp: Option<GraspFigures>,
    /// The imitation in free space.
    pub imitation: Option<ImitationFigures>,
    /// The contact force after adaptation.
    pub force: Option<ForceFigures>,
    /// Of the area that the sponge's footprint sweeps along the coach's path, the part cleaned before coaching began.
    pub wiped_fraction: Option<f64>,
    /// What coaching changed, one entry for each of the coach's actions that took place.
    pub coaching: Vec<CoachingFigures>,
    /// How often gestures were seen right.
    pub gestures: Option<GestureFigures>,
}

/// The grasp.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GraspFigures {
    /// True sponge pose in the hand less the nominal grasp when closing has ended, m.
    pub position_error_m: f64,
}

/// The imitation in free space.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImitationFigures {
    /// Inverse of the repeat period of the whole learned path, Hz.
    pub frequency_hz: f64,
    /// True TCP path over one steady period against the coach's true path, m.
    pub path_rms_m: f64,
}

/// The normal force between sponge and table over the first 5 cycles after adaptation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ForceFigures {
    /// What was asked for, N.
    pub desired_n: f64,
    /// Its mean, N.
    pub mean_n: f64,
    /// Root mean square difference from what was asked for, N.
    pub rms_error_n: f64,
    /// Its maximum, N.
    pub max_n: f64,
    /// For how long it was under 0.2 N, s.
    pub contact_lost_s: f64,
    /// Its maximum in the half second after the first touch, N.
    pub touchdown_max_n: f64,
    /// Cycles spent adapting.
    pub cycles: u32,
}

/// What one action of the coach changed. Figures that its kind does not have, or whose time had not come when the run
/// ended, are absent.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoachingFigures {
    /// Which step of the world's coaching, from 0.
    pub step: usize,
    /// `push`, `fist`, `point_one`, `point_two` or `open_hand`.
    pub kind: &'static str,
    /// The coached phase, 0 to 1.
    pub phase: f64,
    /// Unit vector of the intended shift, root frame; none for the open hand.
    pub direction: Option<[f64; 3]>,
    /// Signed shift of the executed path at the coached phase along the direction, m.
    pub displacement_m: Option<f64>,
    /// Angle between the horizontal shift at the coached phase and the direction, degrees.
    pub direction_error_deg: Option<f64>,
    /// The same shift two cycles after the coach has gone, m.
    pub retained_m: Option<f64>,
    /// Root mean square shift of phases more than a quarter period away, m; not for `point_one`.
    pub far_side_rms_m: Option<f64>,
    /// Lowest frequency over the learned one while the hand was near; none for pushes.
    pub slowed_to: Option<f64>,
}

/// How often gestures were seen right.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GestureFigures {
    /// Frames that count: with a hand, and as many without.
    pub frames: usize,
    /// Part of them that was seen right.
    pub accuracy: f64,
    /// What was seen, by what was shown; `none` is no hand.
    pub confusion: BTreeMap<String, BTreeMap<String, u32>>,
}

/// Computes all figures.
#[must_use]
pub fn compute(
    world: &World,
    log: &TruthLog,
    marks: &[(u64, Mark)],
    seen: &[(u64, Option<String>)],
) -> RefereeReport {
    let path = CoachPath::new(&world.coach.demonstration.clone().unwrap_or_default());
    let run = Run { world, log, marks, path };
    RefereeReport {
        grasp: run.grasp(),
        imitation: run.imitation(),
        force: run.force(),
        wiped_fraction: run.wiped_fraction(),
        coaching: run.coaching(),
        gestures: gestures(log, seen),
    }
}

struct Run<'a> {
    world: &'a World,
    log: &'a TruthLog,
    marks: &'a [(u64, Mark)],
    path: CoachPath,
}

impl Run<'_> {
    /// The last mark that passes.
    fn marked(&self, test: impl Fn(&Mark) -> bool) -> Option<(u64, Mark)> {
        self.marks.iter().rev().find(|(_, m)| test(m)).copied()
    }

    fn end_ns(&self) -> u64 {
        self.log.records.last().map_or(0, |r| r.stamp_ns + 1)
    }

    /// When the coach first acts, or the end of the run.
    fn coaching_ns(&self) -> u64 {
        let first = self.log.coach.iter().find(|e| e.event == EventKind::Began);
        first.map_or(self.end_ns(), |e| ns(e.t))
    }

    fn grasp(&self) -> Option<GraspFigures> {
        let (at, _) = self.marked(|m| *m == Mark::GraspClosed)?;
        let record = self.log.at(at)?;
        let in_tcp = record.tcp.inverse() * record.sponge?;
        let off = in_tcp.translation.vector - Vector3::x() * GRASP_OFFSET;
        Some(GraspFigures { position_error_m: off.norm() })
    }

    /// From the steady part of the free-space motion (from [`Mark::FreeSpaceSteady`], else from the end of learning) until
    /// adaptation starts. The path is one whole period, the last one.
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
            path_rms_m: distance_to_coach(&last, &self.path),
        })
    }

    /// Five periods of the executed motion from the end of adaptation, or as far as the coach lets it be.
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

    /// The footprint is that of the sponge as the hand holds it (its place and yaw in the hand at the end of
    /// adaptation), with the TCP on the coach's path. Cells count as cleaned by the elastic pressure of the sponge's true
    /// poses, every 5 ms, until the coach first acts.
    fn wiped_fraction(&self) -> Option<f64> {
        let (ended, _) = self.marked(|m| matches!(m, Mark::AdaptationEnded { .. }))?;
        let spec = self.world.sponge()?;
        let record = self.log.at(ended)?;
        let tcp_from_sponge = record.tcp.inverse() * record.sponge?;
        let (table, bed) = (TableTop::new(&self.world.table), Bed::new(spec));
        let mut swept = DirtGrid::new(&table);
        for i in 0..360 {
            let [x, y] = self.path.point(std::f64::consts::TAU * f64::from(i) / 360.0);
            let mut tcp = record.tcp;
            (tcp.translation.x, tcp.translation.y) = (x, y);
            bed.cover(&table, &(tcp * tcp_from_sponge), &mut swept);
        }
        let mut cleaned = DirtGrid::new(&table);
        let step = WIPE_EVERY * 1_000_000;
        for r in self.log.between(0, self.coaching_ns()) {
            if r.stamp_ns.is_multiple_of(step)
                && r.normal > 0.0
                && let Some(pose) = &r.sponge
            {
                bed.wipe(&table, pose, &mut cleaned);
            }
        }
        swept.covered_by(&cleaned)
    }

    fn coaching(&self) -> Vec<CoachingFigures> {
        let began = self.log.coach.iter().filter(|e| e.event == EventKind::Began);
        began.filter_map(|e| self.action(e.step, e.kind, ns(e.t))).collect()
    }

    fn action(&self, step: usize, kind: ActionKind, began: u64) -> Option<CoachingFigures> {
        let event = |wanted: &dyn Fn(&EventKind) -> bool| {
            self.log.coach.iter().find(|e| e.step == step && wanted(&e.event)).map(|e| (ns(e.t), e.event))
        };
        let arrived = event(&|e| matches!(e, EventKind::Arrived { .. }));
        let leaves = event(&|e| *e == EventKind::Leaves).map(|(t, _)| t);
        let ended = event(&|e| *e == EventKind::Ended).map(|(t, _)| t);
        let (phase, given) = match &self.world.coach.coaching.get(step)?.action {
            CoachingAction::Push { push } => (push.phase, Some(Vector3::from(push.force))),
            CoachingAction::Show(show) => (show.phase, show.direction.map(Vector3::from)),
        };
        let before = self.before(began);
        let index = before.as_ref().map(|(b, _)| index_of_phase(b, &self.path, phase));
        let palm = arrived.and_then(|(_, e)| match e {
            EventKind::Arrived { palm } => Some(Vector3::from(palm)),
            _ => None,
        });
        let on_path = before.as_ref().zip(index).map(|((b, _), i)| b[i]);
        let direction = match kind {
            ActionKind::Push | ActionKind::Gesture(Gesture::PointOne) => given,
            ActionKind::Gesture(Gesture::Fist) => palm.zip(on_path).map(|(hand, path)| hand - path),
            ActionKind::Gesture(Gesture::PointTwo) => palm.zip(on_path).map(|(hand, path)| path - hand),
            ActionKind::Gesture(Gesture::OpenHand) => None,
        }
        .and_then(|d| d.try_normalize(1e-9));

        let mut figures = CoachingFigures {
            step,
            kind: name(kind),
            phase,
            direction: direction.map(Into::into),
            displacement_m: None,
            direction_error_deg: None,
            retained_m: None,
            far_side_rms_m: None,
            slowed_to: None,
        };
        let Some((before, period_s)) = before else { return Some(figures) };
        figures.slowed_to = arrived
            .map(|(t, _)| t)
            .and_then(|from| self.slowest(from, leaves.unwrap_or(self.end_ns()), period_s));
        let (Some(ended), Some(direction), Some(index)) = (ended, direction, index) else {
            return Some(figures);
        };
        let next = self.next_action(ended);
        if let Some(after) = self.after(ended + ns(RECOVERY_S), next, period_s, &before) {
            let shift = shift_at(&before, &after, index);
            figures.displacement_m = Some(shift.dot(&direction));
            figures.direction_error_deg = angle_deg(&shift, &direction);
            if kind != ActionKind::Gesture(Gesture::PointOne) {
                figures.far_side_rms_m = Some(far_side(&before, &after, index));
            }
        }
        let later = ended + ns(2.0 * period_s);
        figures.retained_m =
            self.after(later, next, period_s, &before).map(|p| shift_at(&before, &p, index).dot(&direction));
        Some(figures)
    }

    /// The mean of the last two periods before `began` (of one, when there is no time for two), and their length, s.
    /// Looked for since the motion has its own speed again: after its start and after the coach was there last.
    fn before(&self, began: u64) -> Option<(Period, f64)> {
        let started = self.marked(|m| *m == Mark::WipingStarted).map_or(0, |(at, _)| at);
        let ends = self.log.coach.iter().filter(|e| e.event == EventKind::Ended).map(|e| ns(e.t));
        let disturbed = ends.filter(|t| *t < began).max().unwrap_or(0).max(started);
        let from = (disturbed + ns(RECOVERY_S)).max(began.saturating_sub(ns(12.0)));
        let path = positions(self.log.between(from.min(began), began));
        // Too short to show its period: then the period is the coach's, and the last one counts although disturbed.
        let period_s = repeat_period(&path).unwrap_or(1.0 / self.path.frequency());
        let whole = began.saturating_sub(ns(1.02 * period_s)).max(started);
        let path = if path.len() as f64 > 1.02e3 * period_s {
            path
        } else {
            positions(self.log.between(whole, began))
        };
        let of = |count: usize| {
            let samples = (count as f64 * period_s * 1e3).ceil() as usize + 2;
            mean_period(path.get(path.len().checked_sub(samples)?..)?, period_s, count)
        };
        Some((of(2).or_else(|| of(1))?, period_s))
    }

    /// When the coach acts next after `ended`, or the end of the run.
    fn next_action(&self, ended: u64) -> u64 {
        let begins = self.log.coach.iter().filter(|e| e.event == EventKind::Began).map(|e| ns(e.t));
        begins.filter(|t| *t >= ended).min().unwrap_or(self.end_ns())
    }

    /// The period from `from` on (earlier when it would reach past `until`), in phase with `before`. Its own length
    /// is measured over what follows.
    fn after(&self, from: u64, until: u64, period_s: f64, before: &Period) -> Option<Period> {
        let from = from.min(until.saturating_sub(ns(1.02 * period_s)));
        let path = positions(self.log.between(from, (from + ns(2.5 * period_s)).min(until)));
        let own = repeat_period(&path).filter(|own| (own / period_s - 1.0).abs() < 0.2).unwrap_or(period_s);
        mean_period(&path, own, 1).map(|period| aligned(before, &period))
    }

    /// The least ratio of the learned time for an eighth of the path to the time it took, between two times.
    fn slowest(&self, from: u64, to: u64, period_s: f64) -> Option<f64> {
        let mut tracker = PhaseTracker::new(self.path.clone());
        let stride = 5;
        let records = self.log.between(from.saturating_sub(ns(2.0 * period_s)), to);
        let mut track: Vec<(u64, f64)> = Vec::new();
        for pair in records.windows(stride + 1).step_by(stride) {
            let (a, b): (&Record, &Record) = (&pair[0], &pair[stride]);
            let dt = (b.stamp_ns - a.stamp_ns) as f64 * 1e-9;
            let p = b.tcp.translation.vector;
            let v = (p - a.tcp.translation.vector) / dt;
            track.push((b.stamp_ns, tracker.update([p.x, p.y], [v.x, v.y], dt)));
        }
        let eighth = std::f64::consts::TAU / 8.0;
        let inside = track.partition_point(|(t, _)| *t < from);
        let slowest = (inside..track.len())
            .filter_map(|i| {
                let (start, theta) = track[i];
                let end = track[i..].iter().find(|(_, t)| *t >= theta + eighth).map(|(t, _)| *t)?;
                Some((end - start) as f64 * 1e-9)
            })
            .fold(0.0, f64::max);
        (slowest > 0.0).then(|| period_s / 8.0 / slowest)
    }
}

fn ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

fn name(kind: ActionKind) -> &'static str {
    match kind {
        ActionKind::Push => "push",
        ActionKind::Gesture(gesture) => label(gesture),
    }
}

fn label(gesture: Gesture) -> &'static str {
    match gesture {
        Gesture::Fist => "fist",
        Gesture::PointOne => "point_one",
        Gesture::PointTwo => "point_two",
        Gesture::OpenHand => "open_hand",
    }
}

/// The shift at a phase: the mean over a thirty-second of the period about it.
fn shift_at(before: &Period, after: &Period, index: usize) -> Vector3<f64> {
    let reach = POINTS / 64;
    let around = (0..=2 * reach).map(|k| (index + POINTS + k - reach) % POINTS);
    around.map(|i| after[i] - before[i]).sum::<Vector3<f64>>() / (2 * reach + 1) as f64
}

fn far_side(before: &Period, after: &Period, index: usize) -> f64 {
    let far = (POINTS / 4 + 1..POINTS - POINTS / 4).map(|k| (index + k) % POINTS);
    let (sum, count) = far.fold((0.0, 0), |(s, n), i| (s + (after[i] - before[i]).norm_squared(), n + 1));
    (sum / f64::from(count)).sqrt()
}

fn angle_deg(shift: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
    let flat = |v: &Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let (a, b) = (flat(shift).try_normalize(1e-6)?, flat(direction).try_normalize(1e-6)?);
    Some(a.dot(&b).clamp(-1.0, 1.0).acos().to_degrees())
}

/// Frames between the first and the last that vision looked at. A frame that it passed over counts as nothing seen.
fn gestures(log: &TruthLog, seen: &[(u64, Option<String>)]) -> Option<GestureFigures> {
    let answers: BTreeMap<u64, Option<&str>> = seen.iter().map(|(t, l)| (*t, l.as_deref())).collect();
    let (first, _) = answers.first_key_value()?;
    let (last, _) = answers.last_key_value()?;
    let looked_at = log.frames.iter().filter(|f| (*first..=*last).contains(&f.stamp_ns));
    let steady = looked_at.filter(|f| f.since_s >= STEADY_S);
    let (with, without): (Vec<&FrameTruth>, Vec<&FrameTruth>) = steady.partition(|f| f.gesture.is_some());
    let with: Vec<_> = with.into_iter().filter(|f| f.visible).collect();
    let some = with.len().min(without.len());
    let spread = (0..some).map(|i| without[i * without.len() / some]);
    let mut figures = GestureFigures::default();
    let mut right = 0usize;
    for frame in with.iter().copied().chain(spread) {
        let shown = frame.gesture.map_or("none", label);
        let answer = answers.get(&frame.stamp_ns).copied().flatten().unwrap_or("none");
        right += usize::from(shown == answer);
        figures.frames += 1;
        *figures.confusion.entry(shown.into()).or_default().entry(answer.into()).or_default() += 1;
    }
    (figures.frames > 0).then(|| {
        figures.accuracy = right as f64 / figures.frames as f64;
        figures
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::Isometry3;

    use super::*;
    use crate::coach::{ActionEvent, wrap};

    /// A run that performs the coach's path perfectly at `force(t)` N, shifted along y by `shift(t, phase)`, with the
    /// sponge level and nominal in the hand.
    fn run(seconds: f64, force: impl Fn(f64) -> f64, shift: impl Fn(f64, f64) -> f64) -> (World, TruthLog) {
        let mut world = World::default();
        world.table.tilt_deg = [0.0; 2];
        world.table.bumps.clear();
        let path = CoachPath::new(&world.coach.demonstration.clone().unwrap());
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
        let mut log = TruthLog::default();
        for i in 0..(seconds * 1e3) as u64 {
            let t = i as f64 * 1e-3;
            let phase = 0.5 * t;
            let [x, y] = path.point(TAU * phase);
            let normal = force(t);
            let z = 0.95 + 0.02 + GRASP_OFFSET - normal / 2000.0;
            let at = Vector3::new(x, y + shift(t, phase.fract()), z);
            let tcp = Isometry3::from_parts(at.into(), down);
            let sponge = Isometry3::translation(at.x, at.y, at.z - GRASP_OFFSET);
            log.records.push(Record {
                stamp_ns: i * 1_000_000,
                tcp,
                sponge: Some(sponge),
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

    /// The path is pushed out by 30 mm about phase 0.25 from 20 s on, of which 24 mm are left after 30 s.
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

    #[test]
    fn gestures_are_counted_with_as_many_frames_without() {
        let mut log = TruthLog::default();
        let mut seen = Vec::new();
        for i in 0..100u64 {
            let gesture = (i >= 80).then_some(Gesture::Fist);
            log.frames.push(FrameTruth { stamp_ns: i, gesture, since_s: 1.0, visible: true });
            seen.push((i, (i >= 85).then(|| "fist".to_owned())));
        }
        let figures = gestures(&log, &seen).unwrap();
        assert_eq!(figures.frames, 40);
        assert!((figures.accuracy - 35.0 / 40.0).abs() < 1e-12);
        assert_eq!(figures.confusion["fist"]["none"], 5);
    }
}
