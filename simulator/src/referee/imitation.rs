//! The probe `imitation`: the motion in free space against the one that the coach showed; and the paths of the whole run.

use armarium_values::report::Requirement::{AtMost, Shown};
use armarium_values::report::{Block, Figure, Path, PathStyle, Plan, Section};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::log::Record;
use super::paths::{distance_to_coach, mean_period, positions, repeat_period};
use super::probes::{Probe, figure};
use super::run::{JudgedRun, name, ns};
use crate::coach::{CoachPath, EventKind};

pub(super) const PROBE: Probe = Probe {
    name: "imitation",
    measure: |run| serde_json::to_value(imitation(run)?).ok(),
    asks,
    section: |run, _| {
        let plan = plan("Paths over the table", paths(run));
        let note = "The table seen from above; a dot marks where each begins.";
        vec![Section::new("Paths", note, vec![Block::Plan(plan)])]
    },
};

/// Interval of the drawn points of a path, ms.
pub(super) const STRIDE: usize = 10;
/// The coach's tool counts as on the ideal path up to this distance, over the path's half width.
const NEAR: f64 = 0.4;

const SECOND: u64 = 1_000_000_000;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct ImitationFigures {
    /// Inverse of the repeat period of the whole learned path, Hz.
    frequency_hz: f64,
    /// The frequency that the coach showed, Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    demonstrated_frequency_hz: Option<f64>,
    /// True TCP path over one steady period against the coach's true path, m.
    path_rms_m: f64,
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Imitation", name), own, key, unit, requirement);
    let mut figures = vec![of("learned frequency", ("frequency_hz", 1.0), ("Hz", 4), Shown)];
    let number = |key: &str| own.get(key).and_then(Value::as_f64);
    if let Some((learned, shown)) = number("frequency_hz").zip(number("demonstrated_frequency_hz")) {
        let error = Some((learned / shown - 1.0).abs() * 100.0);
        figures.push(Figure { value: error, ..of("frequency error", ("", 1.0), ("%", 2), AtMost(1.0)) });
    }
    figures.push(of("path error, RMS", ("path_rms_m", 1e3), ("mm", 1), AtMost(10.0)));
    figures
}

/// From the steady part of the free-space motion (from [`Milestone::FreeSpaceSteady`], else from the end of
/// learning) until adaptation starts. The path is the last whole period.
fn imitation(run: &JudgedRun<'_>) -> Option<ImitationFigures> {
    let learned = run.time_of(|m| *m == Milestone::LearningEnded)?;
    let steady = run.time_of(|m| *m == Milestone::FreeSpaceSteady).unwrap_or(learned);
    let until = run.lowered_after(learned).unwrap_or(run.end_ns());
    let path = positions(run.log.between(steady.max(learned), until));
    let period_s = repeat_period(&path)?;
    let samples = (period_s * 1e3).ceil() as usize + 2;
    let last = mean_period(&path[path.len().saturating_sub(samples)..], period_s, 1)?;
    Some(ImitationFigures {
        frequency_hz: 1.0 / period_s,
        demonstrated_frequency_hz: run.world.coach.demonstration.as_ref().map(|shown| shown.frequency),
        path_rms_m: distance_to_coach(&last, &run.path),
    })
}

/// The coach's path, the one performed in free space, the one wiped, and the one after each of the coach's actions.
/// Each is one period, except that the coach's path has all its periods.
fn paths(run: &JudgedRun<'_>) -> Vec<Path> {
    let log = run.log;
    let Some(shown) = &run.world.coach.demonstration else { return Vec::new() };
    let end = log.records.last().map_or(0, |r| r.stamp_ns);
    let period = (1.05 / shown.frequency * 1e9) as u64;
    let mut paths = Vec::new();
    let mut add = |label: String, style, points: Vec<[f64; 2]>| {
        if points.len() > 1 {
            paths.push(Path { label, style, points });
        }
    };
    let performed = |from: u64, to: u64| {
        let records = log.between(from, to).iter().step_by(STRIDE);
        records.map(|r| [r.tcp.translation.x, r.tcp.translation.y]).collect()
    };
    let learned = run.time_of(|m| *m == Milestone::LearningEnded).unwrap_or(end);
    let tool = demonstrated(&CoachPath::new(shown), log.between(0, learned.max(1)));
    add("demonstrated by the coach".into(), PathStyle::Reference, tool);
    if let Some(steady) = run.time_of(|m| *m == Milestone::FreeSpaceSteady) {
        add("performed in free space".into(), PathStyle::Line, performed(steady, steady + period));
    }
    let Some(adapted) = run.adapted() else { return paths };
    // The end of wiping; after it the tool is lifted.
    let over = log.records.iter().rev().find(|r| r.normal > 1.0).map_or(end, |r| r.stamp_ns);
    let over = over.saturating_sub(SECOND / 2);
    let begins: Vec<u64> = run.actions(EventKind::Began).map(|e| ns(e.t)).collect();
    let until = begins.first().copied().unwrap_or(over);
    add("wiped".into(), PathStyle::Line, performed(until.saturating_sub(period).max(adapted), until));
    for action in run.actions(EventKind::Ended) {
        let gone = ns(action.t);
        let next = begins.iter().copied().find(|t| *t >= gone).unwrap_or(over);
        let from = next.saturating_sub(period).max(gone);
        add(format!("after the {}", name(action)), PathStyle::Line, performed(from, next));
    }
    paths
}

/// The periodic part of a demonstration, without coming, swiping and going: the longest stretch near the ideal
/// path.
fn demonstrated(path: &CoachPath, records: &[Record]) -> Vec<[f64; 2]> {
    let ideal: Vec<[f64; 2]> =
        (0..180).map(|i| path.point(std::f64::consts::TAU * f64::from(i) / 180.0)).collect();
    let half = path.half();
    let far = NEAR * half[0].abs().max(half[1].abs());
    let near = |p: &[f64; 2]| ideal.iter().any(|q| libm::hypot(p[0] - q[0], p[1] - q[1]) < far);
    let tool = |r: &Record| r.tool.map(|t| [t.x, t.y]).filter(near);
    let points: Vec<Option<[f64; 2]>> = records.iter().step_by(STRIDE).map(tool).collect();
    let stretches = points.split(Option::is_none);
    stretches.max_by_key(|s| s.len()).unwrap_or_default().iter().copied().flatten().collect()
}

/// A plan of the table.
pub(super) fn plan(title: &str, paths: Vec<Path>) -> Plan {
    Plan {
        title: title.into(),
        x_label: "x, m (to the robot's right)".into(),
        y_label: "y, m (forward)".into(),
        cells: None,
        paths,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::World;

    /// The tool comes from afar, swipes through the middle, circles three times and goes.
    #[test]
    fn of_the_coachs_tool_only_the_periodic_part_is_drawn() {
        let shown = World::default().coach.demonstration.unwrap();
        let path = CoachPath::new(&shown);
        let [cx, cy] = path.center();
        let turns = (0..30_000).map(|i| path.point(std::f64::consts::TAU * f64::from(i) / 10_000.0));
        let away = |dy: f64| (0..1500).map(move |i| [cx, cy + dy * f64::from(i) / 1500.0]);
        let points = away(0.4).chain(turns).chain(away(0.4));
        let records: Vec<Record> = points
            .enumerate()
            .map(|(i, [x, y])| Record {
                stamp_ns: i as u64 * 1_000_000,
                tcp: nalgebra::Isometry3::identity(),
                object: None,
                normal: 0.0,
                tangential: 0.0,
                tool: Some(nalgebra::Vector3::new(x, y, 1.1)),
                fastest_joint: 0.0,
            })
            .collect();
        let drawn = demonstrated(&path, &records);
        assert!((3000..3100).contains(&drawn.len()), "{}", drawn.len());
        let reach = 0.7 * shown.size[0].max(shown.size[1]);
        assert!(drawn.iter().all(|p| libm::hypot(p[0] - cx, p[1] - cy) < reach));
        assert!(demonstrated(&path, &[]).is_empty());
    }
}
