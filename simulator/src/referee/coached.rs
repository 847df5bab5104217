//! The probe `coaching`: what each of the coach's actions changed: compares executed paths before and after it, aligned in phase.

use armarium_values::report::Requirement::{AtLeast, AtMost};
use armarium_values::report::{Block, Cell, Figure, Section, Table};
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::log::Record;
use super::path_change::{PathChange, far_side_moved, kept};
use super::paths::{Period, aligned, index_of_phase, mean_period, positions, repeat_period};
use super::probes::{Probe, cell, figure, of_each, table_of, things};
use super::run::{JudgedRun, ns};
use crate::coach::{ActionKind, EventKind, PhaseTracker};
use crate::world::{CoachingAction, Gesture};

/// Time that the motion needs to reach its own speed, after its start and after the coach has gone, s.
const RECOVERY_S: f64 = 1.0;

pub(super) const PROBE: Probe = Probe {
    name: "coaching",
    measure: |run| of_each(&run.coaching()),
    asks,
    section: |_, own| {
        let note = "How far each coaching moved the motion, and what stayed when the coach had gone.";
        vec![Section::new("Coaching", note, vec![Block::Table(table(own))])]
    },
};

/// What one action of the coach changed. Figures that its kind does not have, or that were not complete when the
/// run ended, are absent.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct CoachingFigures {
    /// Index of the step of the world's coaching, from 0.
    step: usize,
    /// `push`, `fist`, `point_one`, `point_two` or `open_hand`.
    kind: &'static str,
    /// When it began, s of the run.
    at_s: f64,
    /// The coached phase, 0 to 1.
    phase: f64,
    /// Unit vector of the intended shift, root frame; `None` for the open hand.
    #[serde(skip_serializing_if = "Option::is_none")]
    direction: Option<[f64; 3]>,
    /// How far the path was moved at the coached phase; the far side not for `point_one`.
    #[serde(flatten)]
    change: PathChange,
    /// Lowest frequency while the hand was near, over the learned one; `None` for pushes.
    #[serde(skip_serializing_if = "Option::is_none")]
    slowed_to: Option<f64>,
}

fn asks(own: &Value) -> Vec<Figure> {
    things(own).iter().enumerate().flat_map(|(i, action)| asks_of_one(i, action)).collect()
}

fn asks_of_one(index: usize, action: &Value) -> Vec<Figure> {
    let kind = action.get("kind").and_then(Value::as_str).unwrap_or("push");
    if kind == "open_hand" {
        return Vec::new();
    }
    let group = format!("Coaching {}: {}", index + 1, kind.replace('_', " "));
    let of = |name, key, unit, requirement| figure((&group, name), action, key, unit, requirement);
    let push = kind == "push";
    let moved = of("moved", ("displacement_m", 1e3), ("mm", 1), AtLeast(if push { 20.0 } else { 10.0 }));
    let mut figures = vec![moved, kept(&group, action)];
    figures.push(if push {
        of("off the push's direction", ("direction_error_deg", 1.0), ("°", 1), AtMost(30.0))
    } else {
        of("slowed to", ("slowed_to", 100.0), ("%", 0), AtMost(70.0))
    });
    if kind != "point_one" {
        figures.push(far_side_moved(&group, action));
    }
    figures
}

/// One row for each of the coach's actions.
fn table(own: &Value) -> Table {
    let titles = ["Coach", "#At", "#Moved the motion", "#Kept", "#Far side, RMS", "#Slowed to"];
    table_of(own, &titles, |action| {
        vec![
            Cell::Text(action["kind"].as_str().unwrap_or_default().replace('_', " ")),
            cell(action, ("at_s", 1.0), "s", 1),
            cell(action, ("displacement_m", 1e3), "mm", 1),
            cell(action, ("retained_m", 1e3), "mm", 1),
            cell(action, ("far_side_rms_m", 1e3), "mm", 1),
            cell(action, ("slowed_to", 1e2), "%", 0),
        ]
    })
}

/// One period of the motion before all coaching, and the newest period in phase with it.
struct Uncoached {
    period: Period,
    newest: Period,
}

impl JudgedRun<'_> {
    /// One entry for each action that began.
    fn coaching(&self) -> Vec<CoachingFigures> {
        let began = self.log.coach.iter().filter(|e| e.event == EventKind::Began);
        let mut uncoached = None;
        began.filter_map(|e| self.action(e.step, e.kind, ns(e.t), &mut uncoached)).collect()
    }

    /// What one action changed. The coach's phases are located on the motion before all coaching (`uncoached`, set
    /// by the first action), and later periods are aligned with it. A path that was pushed aside could not be used,
    /// as its points no longer lie at their phases.
    fn action(
        &self,
        step: usize,
        kind: ActionKind,
        began: u64,
        uncoached: &mut Option<Uncoached>,
    ) -> Option<CoachingFigures> {
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
        let before = self.before(began).map(|(period, period_s)| match uncoached {
            None => {
                *uncoached = Some(Uncoached { period, newest: period });
                (period, period_s)
            }
            Some(known) => {
                known.newest = aligned(&known.newest, &period);
                (known.newest, period_s)
            }
        });
        let index = uncoached.as_ref().map(|known| index_of_phase(&known.period, &self.path, phase));
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
            kind: kind.name(),
            at_s: began as f64 * 1e-9,
            phase,
            direction: direction.map(Into::into),
            change: PathChange::default(),
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
        let after = |from: u64| self.after(from, next, period_s, &before);
        let (at_once, later) = (after(ended + ns(RECOVERY_S)), after(ended + ns(2.0 * period_s)));
        figures.change = PathChange::measured(&before, [at_once, later], index, &direction);
        if kind == ActionKind::Gesture(Gesture::PointOne) {
            figures.change.far_side_rms_m = None;
        }
        Some(figures)
    }

    /// The mean of the last two periods before `began` (of one, if there is no time for two), and their length, s.
    /// Only the time since the motion reached its own speed counts: after its start and after the coach was last
    /// there.
    fn before(&self, began: u64) -> Option<(Period, f64)> {
        let started = self.marked(|m| *m == Milestone::WipingStarted).map_or(0, |(at, _)| at);
        let ends = self.log.coach.iter().filter(|e| e.event == EventKind::Ended).map(|e| ns(e.t));
        let disturbed = ends.filter(|t| *t < began).max().unwrap_or(0).max(started);
        let from = (disturbed + ns(RECOVERY_S)).max(began.saturating_sub(ns(12.0)));
        let path = positions(self.log.between(from.min(began), began));
        // Too short to determine its period: then the coach's period is used, and the last period counts although
        // disturbed.
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

    /// The start of the coach's next action after `ended`, or the end of the run.
    fn next_action(&self, ended: u64) -> u64 {
        let begins = self.log.coach.iter().filter(|e| e.event == EventKind::Began).map(|e| ns(e.t));
        begins.filter(|t| *t >= ended).min().unwrap_or(self.end_ns())
    }

    /// The period from `from` on (earlier if it would end after `until`), aligned with `before`. Its own length is
    /// measured over what follows.
    fn after(&self, from: u64, until: u64, period_s: f64, before: &Period) -> Option<Period> {
        let from = from.min(until.saturating_sub(ns(1.02 * period_s)));
        let path = positions(self.log.between(from, (from + ns(2.5 * period_s)).min(until)));
        let own = repeat_period(&path).filter(|own| (own / period_s - 1.0).abs() < 0.2).unwrap_or(period_s);
        mean_period(&path, own, 1).map(|period| aligned(before, &period))
    }

    /// The minimum, between two times, of the learned time for an eighth of the path over the time that it took.
    fn slowest(&self, from: u64, to: u64, period_s: f64) -> Option<f64> {
        let mut tracker = PhaseTracker::new(self.path.clone());
        // Velocities are means over this many records. Every record is tracked: the slowest eighth may be the last
        // one before `to`, which a coarser grid of times would miss by up to its width.
        let stride = 5;
        let records = self.log.between(from.saturating_sub(ns(2.0 * period_s)), to);
        let mut track: Vec<(u64, f64)> = Vec::new();
        for pair in records.windows(stride + 1) {
            let (a, last, b): (&Record, &Record, &Record) = (&pair[0], &pair[stride - 1], &pair[stride]);
            let seconds = |from: &Record| (b.stamp_ns - from.stamp_ns) as f64 * 1e-9;
            let p = b.tcp.translation.vector;
            let v = (p - a.tcp.translation.vector) / seconds(a);
            track.push((b.stamp_ns, tracker.update([p.x, p.y], [v.x, v.y], seconds(last))));
        }
        let eighth = std::f64::consts::TAU / 8.0;
        let inside = track.partition_point(|(t, _)| *t < from);
        let slowest = (inside..track.len())
            .filter_map(|i| {
                let (start, theta) = track[i];
                Some((reached(&track[i..], theta + eighth)? - start as f64) * 1e-9)
            })
            .fold(0.0, f64::max);
        (slowest > 0.0).then(|| period_s / 8.0 / slowest)
    }
}

/// The time when the phase passes `theta`, ns, interpolated between the samples of a track (ns, rad). So figures
/// from these times vary continuously with the motion, independent of the sampling grid.
fn reached(track: &[(u64, f64)], theta: f64) -> Option<f64> {
    let at = track.iter().position(|(_, phase)| *phase >= theta)?;
    let (after, above) = track[at];
    let Some((before, below)) = at.checked_sub(1).map(|i| track[i]) else { return Some(after as f64) };
    Some(before as f64 + (theta - below) / (above - below) * (after - before) as f64)
}
