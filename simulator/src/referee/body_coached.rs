//! The probe `body_coaching`: what each reach of a person's arm beside a running motion changed: compares the executed path before and
//! after it, aligned in phase. The right arm pushes along its forearm, the left one pulls.

use armarium_values::report::Requirement::{AtLeast, AtMost};
use armarium_values::report::{Block, Cell, Figure, Section, Table};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::log::LoggedReach;
use super::path_change::{PathChange, far_side_moved, kept};
use super::paths::{POINTS, aligned, mean_period, positions, repeat_period};
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
    /// How far the path was moved where it is nearest to the wrist.
    #[serde(flatten)]
    change: PathChange,
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
    let [at_once, later] = [SETTLES_S, 2.0 * period_s].map(|waited| after(reach.ended_ns + ns(waited)));
    let change = PathChange::measured(&before, [at_once, later], nearest, &direction);
    Some(ArmFigures { kind, at_s: seconds(reach.began_ns), direction: direction.into(), change })
}

fn asks(index: usize, reach: &Value) -> Vec<Figure> {
    let kind = reach["kind"].as_str().unwrap_or_default();
    let group = format!("Arm {}: {kind}", index + 1);
    let of = |name, key, unit, requirement| figure((&group, name), reach, key, unit, requirement);
    vec![
        of("moved its way", ("displacement_m", 1e3), ("mm", 1), AtLeast(20.0)),
        of("off its way", ("direction_error_deg", 1.0), ("°", 1), AtMost(30.0)),
        kept(&group, reach),
        far_side_moved(&group, reach),
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
