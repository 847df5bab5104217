//! The probe `gaze`: how well memory knew where things were when hands left their places over them, and how old what it knew of needed
//! things was.

use armarium_values::report::Requirement::{AtMost, Shown};
use armarium_values::report::{Block, Cell, Figure, Section};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::log::{KnownThing, NeededThing};
use super::probes::{Probe, cell, figure, table_of};
use super::run::{JudgedRun, seconds};

pub(super) const PROBE: Probe = Probe { name: "gaze", measure, asks, section };

/// A needed thing that was seen longer ago is old, s; the share of the time in which one may be old.
const OLD_S: f64 = 1.0;
const OLD_SHARE: f64 = 0.05;
/// How often that is looked at, ns.
const STEP_NS: u64 = 10_000_000;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct GazeFigures {
    /// Each time that a hand left its place over a thing.
    grasps: Vec<GraspFigures>,
    /// The mean and the largest of their errors, m.
    mean_error_m: f64,
    worst_error_m: f64,
    /// The share of the time in which something was needed when one of it was old.
    old_share: f64,
    /// For how long something was needed, s.
    needed_s: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct GraspFigures {
    thing: String,
    at_s: f64,
    /// From where memory believed it to be to where it was, m.
    error_m: f64,
    /// How long ago the picture was taken in which it was seen last, s.
    age_s: f64,
}

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    let left = run.marks().iter().filter(|(_, mark)| *mark == Milestone::PrePoseLeft);
    let grasps: Vec<GraspFigures> = left.filter_map(|(at, _)| grasp(run, *at)).collect();
    if grasps.is_empty() {
        return None;
    }
    let errors = || grasps.iter().map(|grasp| grasp.error_m);
    let (mean_error_m, worst_error_m) =
        (errors().sum::<f64>() / grasps.len() as f64, errors().fold(0.0, f64::max));
    let (old_ns, needed_ns) = ages(run);
    let old_share = old_ns as f64 / needed_ns.max(1) as f64;
    let figures =
        GazeFigures { grasps, mean_error_m, worst_error_m, old_share, needed_s: seconds(needed_ns) };
    serde_json::to_value(figures).ok()
}

/// What memory knew of a thing at a time.
fn known<'r>(run: &JudgedRun<'r>, thing: &str, at_ns: u64) -> Option<&'r KnownThing> {
    let until = run.log.things.partition_point(|(stamp, ..)| *stamp <= at_ns);
    run.log.things[..until].iter().rev().find(|(_, name, _)| name == thing).map(|(.., known)| known)
}

/// The thing whose place a hand left at a time: it was needed until then.
fn grasp(run: &JudgedRun<'_>, at_ns: u64) -> Option<GraspFigures> {
    let need = run.log.needs.iter().find(|need| need.to_ns == Some(at_ns))?;
    let known = known(run, &need.thing, at_ns)?;
    let body = run.world.named_bodies().position(|body| body.name == known.class)?;
    let truth = run.log.object_at(body, at_ns)?.translation.vector;
    Some(GraspFigures {
        thing: need.thing.clone(),
        at_s: seconds(at_ns),
        error_m: (known.place - truth).norm(),
        age_s: seconds(at_ns.saturating_sub(known.seen_ns)),
    })
}

/// For how long a needed thing was old, and for how long something was needed, ns.
fn ages(run: &JudgedRun<'_>) -> (u64, u64) {
    let end_ns = run.end_ns();
    let (mut old, mut needed) = (0, 0);
    for at in (0..end_ns).step_by(STEP_NS as usize) {
        let lasts = |need: &&NeededThing| need.from_ns <= at && need.to_ns.is_none_or(|to| at < to);
        let mut now = run.log.needs.iter().filter(lasts).peekable();
        if now.peek().is_none() {
            continue;
        }
        needed += STEP_NS;
        let is_old = |need: &NeededThing| {
            known(run, &need.thing, at).is_none_or(|known| seconds(at.saturating_sub(known.seen_ns)) > OLD_S)
        };
        if now.any(is_old) {
            old += STEP_NS;
        }
    }
    (old, needed)
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Gaze", name), own, key, unit, requirement);
    let old = AtMost(OLD_SHARE * 1e2);
    vec![
        of("error when a hand sets out, mean", ("mean_error_m", 1e3), ("mm", 1), Shown),
        of("error when a hand sets out, worst", ("worst_error_m", 1e3), ("mm", 1), Shown),
        of("time in which a needed thing was older than 1 s", ("old_share", 1e2), ("%", 1), old),
    ]
}

fn section(_: &JudgedRun<'_>, own: &Value) -> Vec<Section> {
    if own.is_null() {
        return Vec::new();
    }
    let table = table_of(&own["grasps"], &["thing", "at", "error", "seen before"], |grasp| {
        vec![
            Cell::Code(grasp["thing"].as_str().unwrap_or_default().to_owned()),
            cell(grasp, ("at_s", 1.0), "s", 1),
            cell(grasp, ("error_m", 1e3), "mm", 1),
            cell(grasp, ("age_s", 1.0), "s", 2),
        ]
    });
    let note =
        "Where memory believed things to be when a hand set out from over them, against where they were.";
    vec![Section::new("Where the robot looked", note, vec![Block::Table(table)])]
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::*;
    use crate::referee::TruthLog;
    use crate::world::World;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn what_memory_believes_is_held_against_where_the_thing_is() {
        let world = World::ideal();
        let name = world.named_bodies().next().unwrap().name;
        let mut log = TruthLog::default();
        let record = |at| super::super::Record {
            stamp_ns: at,
            tcp: Isometry3::identity(),
            object: None,
            normal: 0.0,
            tangential: 0.0,
            tool: None,
            fastest_joint: 0.0,
        };
        log.records = (0..4000).map(|ms| record(ms * 1_000_000)).collect();
        let place = Vector3::new(0.3, 0.5, 1.0);
        log.moved.insert(
            0,
            vec![(0, Isometry3::from(place)), (2 * SECOND, Isometry3::from(place + Vector3::x() * 0.06))],
        );
        let known = |seen_ns| KnownThing { class: name.clone(), place, seen_ns };
        // Seen at 1 s and not again, it moves at 2 s; it is needed from 1 s to 3 s.
        log.things = vec![(SECOND, "thing".into(), known(SECOND))];
        log.needs(SECOND, 7, "thing");
        log.needs_no_more(3 * SECOND, 7);
        let own =
            measure(&JudgedRun::new(&world, &log, &[(3 * SECOND, Milestone::PrePoseLeft)], &[])).unwrap();
        assert!((own["mean_error_m"].as_f64().unwrap() - 0.06).abs() < 1e-9, "{own}");
        assert!((own["grasps"][0]["age_s"].as_f64().unwrap() - 2.0).abs() < 1e-9, "{own}");
        assert!((own["needed_s"].as_f64().unwrap() - 2.0).abs() < 0.011, "{own}");
        assert!((own["old_share"].as_f64().unwrap() - 0.5).abs() < 0.011, "{own}");
        let missed: Vec<String> =
            asks(&own).into_iter().filter(|f| f.passed() == Some(false)).map(|f| f.name).collect();
        assert_eq!(missed, ["time in which a needed thing was older than 1 s"]);
    }
}
