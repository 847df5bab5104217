//! The probe `body_coaching`: what each reach of a person's arm beside a running motion changed: compares the executed path before and
//! after it, aligned in phase. The right arm pushes along its forearm, the left one pulls.

use armarium_values::report::Requirement::{AtLeast, AtMost};
use armarium_values::report::{Block, Cell, Figure, Section, Table};
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::coached::{angle_deg, far_side, shift_at};
use super::log::LoggedReach;
use super::paths::{POINTS, Period, aligned, mean_period, positions, repeat_period};
use super::probes::{Probe, cell, figure, of_each, table_of, things};
use super::run::{JudgedRun, ns, seconds};

/// An arm whose wrist is farther than this from the path does not coach, m.
const BESIDE: f64 = 0.5;
/// Time that the motion needs to be as it will be, after its start and after the arm has gone, s.
const SETTLES_S: f64 = 1.0;

pub(super) const PROBE: Probe = Probe {
    name: "body_coaching",
    measure: |run| of_each(&figures(run)),
    asks: |own| things(own).iter().enumerate().flat_map(|(i, reach)| asks(i, reach)).collect(),
    section: |_, own| {
        let note = "How far each arm moved the motion, and what stayed when it had gone.";
        vec![Section::new("Coaching by arms", note, vec![Block::Table(table(own))])]
    },
};

/// What one arm changed. Figures that were not complete when the run ended are absent.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ArmFigures {
    /// `push` or `pull`.
    kind: &'static str,
    /// When the hand set out, s of the run.
    at_s: f64,
    /// Unit vector of the intended shift, root frame.
    direction: [f64; 3],
    /// Signed shift of the executed path along the direction, where the path is nearest to the wrist, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    displacement_m: Option<f64>,
    /// Angle between the horizontal shift there and the direction, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    direction_error_deg: Option<f64>,
    /// The same shift two cycles after the arm has gone, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    retained_m: Option<f64>,
    /// RMS shift of the phases more than a quarter period away, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    far_side_rms_m: Option<f64>,
}

fn figures(run: &JudgedRun<'_>) -> Vec<ArmFigures> {
    let Some(started) = run.time_of(|mark| *mark == Milestone::PlayStarted) else { return Vec::new() };
    let reaches: Vec<&LoggedReach> =
        run.log.reaches.iter().filter(|reach| reach.began_ns > started).collect();
    let one = |i: usize| {
        let before = i.checked_sub(1).map_or(started, |before| reaches[before].ended_ns);
        let until = reaches.get(i + 1).map_or(run.end_ns(), |next| next.began_ns);
        changed(run, reaches[i], (before, until))
    };
    (0..reaches.len()).filter_map(one).collect()
}

/// What an arm changed; `None` where it was not beside the path.
fn changed(run: &JudgedRun<'_>, reach: &LoggedReach, (from, until): (u64, u64)) -> Option<ArmFigures> {
    let [elbow, wrist] = reach.forearm()?;
    let path = positions(run.log.between(from + ns(SETTLES_S), reach.began_ns));
    let period_s = repeat_period(&path)?;
    let samples = (2.0 * period_s * 1e3).ceil() as usize + 2;
    let before = mean_period(path.get(path.len().checked_sub(samples)?..)?, period_s, 2)?;
    let beside = |i: &usize| (before[*i] - wrist).norm();
    let nearest = (0..POINTS).min_by(|a, b| beside(a).total_cmp(&beside(b)))?;
    if beside(&nearest) > BESIDE {
        return None;
    }
    let (kind, way) = if reach.side == 0 { ("push", wrist - elbow) } else { ("pull", elbow - wrist) };
    let direction = way.try_normalize(1e-9)?;
    let after = |from: u64| {
        let from = from.min(until.saturating_sub(ns(1.02 * period_s)));
        let path = positions(run.log.between(from, (from + ns(2.5 * period_s)).min(until)));
        mean_period(&path, period_s, 1).map(|period| aligned(&before, &period))
    };
    let shift = |after: &Period| -> Vector3<f64> { shift_at(&before, after, nearest) };
    let at_once = after(reach.ended_ns + ns(SETTLES_S));
    let later = after(reach.ended_ns + ns(2.0 * period_s));
    Some(ArmFigures {
        kind,
        at_s: seconds(reach.began_ns),
        direction: direction.into(),
        displacement_m: at_once.as_ref().map(|after| shift(after).dot(&direction)),
        direction_error_deg: at_once.as_ref().and_then(|after| angle_deg(&shift(after), &direction)),
        retained_m: later.as_ref().map(|after| shift(after).dot(&direction)),
        far_side_rms_m: at_once.as_ref().map(|after| far_side(&before, after, nearest)),
    })
}

fn asks(index: usize, reach: &Value) -> Vec<Figure> {
    let kind = reach["kind"].as_str().unwrap_or_default();
    let group = format!("Arm {}: {kind}", index + 1);
    let of = |name, key, unit, requirement| figure((&group, name), reach, key, unit, requirement);
    let number = |key: &str| reach.get(key).and_then(Value::as_f64);
    let kept = number("retained_m").zip(number("displacement_m")).map(|(kept, all)| kept / all * 100.0);
    vec![
        of("moved its way", ("displacement_m", 1e3), ("mm", 1), AtLeast(20.0)),
        of("off its way", ("direction_error_deg", 1.0), ("°", 1), AtMost(30.0)),
        Figure { value: kept, ..of("kept after two cycles", ("", 1.0), ("%", 0), AtLeast(80.0)) },
        of("far side moved, RMS", ("far_side_rms_m", 1e3), ("mm", 1), AtMost(5.0)),
    ]
}

/// One row for each arm that acted.
fn table(own: &Value) -> Table {
    table_of(own, &["Arm", "#At", "#Moved the motion", "#Kept", "#Far side, RMS"], |reach| {
        vec![
            Cell::Text(reach["kind"].as_str().unwrap_or_default().to_owned()),
            cell(reach, ("at_s", 1.0), "s", 1),
            cell(reach, ("displacement_m", 1e3), "mm", 1),
            cell(reach, ("retained_m", 1e3), "mm", 1),
            cell(reach, ("far_side_rms_m", 1e3), "mm", 1),
        ]
    })
}
