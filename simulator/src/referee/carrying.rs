//! The probe `carrying`: what two hands do to what they carry between them, and how they put it down.

use armarium_values::report::Requirement::{AtLeast, AtMost, Shown};
use armarium_values::report::{Block, Figure, Section, Series, TimePlot};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::probes::{Probe, figure};
use super::run::{Run, seconds};
use crate::physics::PressedLoad;
use crate::world::GRAVITY;

pub(super) const PROBE: Probe = Probe { name: "carrying", measure, asks, section };

/// Every so many milliseconds a point is drawn.
const STRIDE: usize = 10;
/// The force of the table is a mean over so many milliseconds: where rigid bodies meet, a single one has no force of its own, but an
/// impulse.
const WINDOW: usize = 10;

/// A load that is pressed with more counts as crushed, N.
pub(super) const CRUSHED_N: f64 = 40.0;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct CarryingFigures {
    /// The body that was carried.
    load: String,
    /// Its mass, kg.
    mass_kg: f64,
    /// From when to when it was carried, s.
    from_s: f64,
    for_s: f64,
    /// Mean, least and largest internal force while it was carried, N.
    internal_mean_n: f64,
    internal_least_n: f64,
    internal_most_n: f64,
    /// Largest angle between its z axis and the vertical, less that at the beginning, degrees.
    tilt_deg: f64,
    /// How far it has slipped between the hands, from when they bore it to the end, m.
    slipped_m: f64,
    /// Share of the time in which both hands touched it.
    held: f64,
    /// How far it was carried and how high it was lifted, m.
    way_m: f64,
    lifted_m: f64,
    /// Largest force of the table while it was put down, as a mean over 10 ms, less its weight, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    put_down_n: Option<f64>,
    /// How far it moved from the moment in which the table bore it until the hands had let go, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    put_down_moved_m: Option<f64>,
}

/// What was between the hands at a time, ns, and the pose of its middle.
pub(super) type Pressed = (u64, PressedLoad, Isometry3<f64>);

/// What was between the hands in a span of time, ns.
pub(super) fn between<'r>(run: &Run<'r>, from: u64, to: u64) -> &'r [Pressed] {
    let at = |t: u64| run.log.pressed.partition_point(|(stamp, ..)| *stamp < t);
    let (from, to) = (at(from), at(to));
    &run.log.pressed[from..to.max(from)]
}

/// While it was carried: from the first time that this began to the last time that it ended, or to the end of the run.
fn carried<'r>(run: &Run<'r>) -> Option<&'r [Pressed]> {
    let from = run.first_time_of(|mark| *mark == Milestone::CarryingStarted)?;
    let to = run.time_of(|mark| *mark == Milestone::CarryingEnded).filter(|to| *to > from);
    Some(between(run, from, to.unwrap_or(run.end_ns())))
}

/// The internal force, N: half the difference of the forces along the line between both contacts.
pub(super) fn internal_force(load: &PressedLoad) -> f64 {
    let [first, second] = &load.hands;
    let line = (second.at - first.at).normalize();
    (first.force - second.force).dot(&line) / 2.0
}

/// The angle of the load's z axis to the vertical, rad.
pub(super) fn tilt(pose: &Isometry3<f64>) -> f64 {
    (pose.rotation * Vector3::z()).angle(&Vector3::z())
}

/// Where the middle between both pads is in the load.
pub(super) fn in_hands((_, load, pose): &Pressed) -> Vector3<f64> {
    let middle = nalgebra::center(&load.hands[0].at, &load.hands[1].at);
    pose.inverse_transform_point(&middle).coords
}

fn measure(run: &Run<'_>) -> Option<Value> {
    let carried = carried(run)?;
    let [begin, .., end] = carried else { return None };
    let (from, load, start) = begin;
    let body = run.world.named_bodies().nth(load.body)?;
    let forces: Vec<f64> = carried.iter().map(|(_, load, _)| internal_force(load)).collect();
    let fold = |start: f64, pick: fn(f64, f64) -> f64| forces.iter().copied().fold(start, pick);
    let touched = |(_, load, _): &&Pressed| load.hands.iter().all(|hand| hand.force != Vector3::zeros());
    let lean = |(_, _, pose): &Pressed| (tilt(pose) - tilt(start)).abs().to_degrees();
    let way = |pair: &[Pressed]| (pair[1].2.translation.vector - pair[0].2.translation.vector).norm();
    let height = |(_, _, pose): &Pressed| pose.translation.z - start.translation.z;
    let borne = carried.iter().find(|(_, load, _)| load.table_n == 0.0);
    let put_down = put_down(run, body.mass * GRAVITY);
    let figures = CarryingFigures {
        load: body.name.clone(),
        mass_kg: body.mass,
        from_s: seconds(*from),
        for_s: seconds(end.0 - from),
        internal_mean_n: forces.iter().sum::<f64>() / forces.len() as f64,
        internal_least_n: fold(f64::INFINITY, f64::min),
        internal_most_n: fold(0.0, f64::max),
        tilt_deg: carried.iter().map(lean).fold(0.0, f64::max),
        slipped_m: borne.map_or(0.0, |borne| (in_hands(end) - in_hands(borne)).norm()),
        held: carried.iter().filter(touched).count() as f64 / carried.len() as f64,
        way_m: carried.windows(2).map(way).sum(),
        lifted_m: carried.iter().map(height).fold(0.0, f64::max),
        put_down_n: put_down.map(|(force, _)| force),
        put_down_moved_m: put_down.map(|(_, moved)| moved),
    };
    serde_json::to_value(figures).ok()
}

/// The largest force of the table less the weight, N, and how far the load moved from when the table bore it, m.
fn put_down(run: &Run<'_>, weight: f64) -> Option<(f64, f64)> {
    let from = run.time_of(|mark| *mark == Milestone::PutDownStarted)?;
    let to = run.time_of(|mark| *mark == Milestone::PutDownEnded).filter(|to| *to > from)?;
    let lowered = between(run, from, to);
    let mean =
        |window: &[Pressed]| window.iter().map(|(_, load, _)| load.table_n).sum::<f64>() / WINDOW as f64;
    let most = lowered.windows(WINDOW).map(mean).fold(0.0, f64::max);
    let (_, _, first) = lowered.iter().find(|(_, load, _)| load.table_n > 0.5 * weight)?;
    let (_, _, last) = lowered.last()?;
    Some((most - weight, (last.translation.vector - first.translation.vector).norm()))
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Carrying", name), own, key, unit, requirement);
    let mut figures = vec![
        of("internal force, mean", ("internal_mean_n", 1.0), ("N", 1), Shown),
        of("internal force, least", ("internal_least_n", 1.0), ("N", 1), AtLeast(5.0)),
        of("internal force, largest", ("internal_most_n", 1.0), ("N", 1), AtMost(CRUSHED_N)),
        of("tilt, largest", ("tilt_deg", 1.0), ("°", 1), AtMost(5.0)),
        of("slipped", ("slipped_m", 1e3), ("mm", 1), AtMost(5.0)),
        of("touched by both hands", ("held", 100.0), ("%", 1), AtLeast(100.0)),
        of("way", ("way_m", 1.0), ("m", 2), Shown),
        of("lifted", ("lifted_m", 1e3), ("mm", 0), AtLeast(50.0)),
    ];
    if own.get("put_down_n").is_some() {
        figures.push(of("put down with, over the weight", ("put_down_n", 1.0), ("N", 1), AtMost(15.0)));
        figures.push(of("moved by letting go", ("put_down_moved_m", 1e3), ("mm", 1), AtMost(5.0)));
    }
    figures
}

fn section(run: &Run<'_>, _: &Value) -> Vec<Section> {
    let Some(carried) = carried(run).filter(|carried| !carried.is_empty()) else { return Vec::new() };
    let drawn = || carried.iter().step_by(STRIDE);
    let t_s = || drawn().map(|(at, ..)| seconds(*at)).collect::<Vec<_>>();
    let series = |label: &str, y: Vec<f64>| Series { label: label.into(), t_s: t_s(), y };
    let forces = TimePlot {
        title: "Internal force, and how the hands carry".into(),
        y_label: "Force, N".into(),
        series: vec![
            series("internal force", drawn().map(|(_, load, _)| internal_force(load)).collect()),
            series("first hand, up", drawn().map(|(_, load, _)| load.hands[0].force.z).collect()),
            series("second hand, up", drawn().map(|(_, load, _)| load.hands[1].force.z).collect()),
        ],
        ..TimePlot::default()
    };
    let tilted = TimePlot {
        title: "Tilt of the load".into(),
        y_label: "Angle, °".into(),
        series: vec![series("tilt", drawn().map(|(_, _, pose)| tilt(pose).to_degrees()).collect())],
        ..TimePlot::default()
    };
    let note = "What both hands do to what they carry, at its contacts.";
    vec![Section::new("Carrying", note, vec![Block::Plot(forces), Block::Plot(tilted)])]
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::physics::PressingHand;
    use crate::referee::TruthLog;
    use crate::world::{BodySpec, World};

    /// A box of 2 kg that two hands press with 25 N, lift by 0.1 m in a second, tilt by `tilt` rad at the end, and put down with
    /// `extra` N more than its weight.
    fn carried(tilt: f64, extra: f64) -> (World, TruthLog) {
        let load = BodySpec { name: "box".into(), mass: 2.0, ..BodySpec::default() };
        let world = World { objects: Vec::new(), bodies: vec![load], ..World::ideal() };
        let mut log = TruthLog::default();
        for ms in 0..4000_u64 {
            let t = ms as f64 * 1e-3;
            let z = 1.0 + 0.1 * (t - 1.0).clamp(0.0, 1.0) - 0.1 * (t - 2.5).clamp(0.0, 1.0);
            let turn = if (1.9..2.0).contains(&t) { tilt } else { 0.0 };
            let pose = Isometry3::new(Vector3::new(0.0, 0.5, z), Vector3::x() * turn);
            let hand = |x: f64| PressingHand {
                at: Point3::new(0.2 * x, 0.5, z),
                force: Vector3::new(-25.0 * x, 0.0, if t < 3.0 { 9.81 } else { 0.0 }),
                slipping: 0,
            };
            let table_n = if t < 3.5 { 0.0 } else { 2.0 * GRAVITY + extra };
            log.pressed.push((
                ms * 1_000_000,
                PressedLoad { body: 0, hands: [hand(1.0), hand(-1.0)], table_n },
                pose,
            ));
        }
        (world, log)
    }

    fn figures(tilt: f64, extra: f64) -> Value {
        let (world, log) = carried(tilt, extra);
        let marks = [
            (1_000_000_000, Milestone::CarryingStarted),
            (2_400_000_000, Milestone::CarryingEnded),
            (2_500_000_000, Milestone::PutDownStarted),
            (3_990_000_000, Milestone::PutDownEnded),
        ];
        measure(&Run::new(&world, &log, &marks, &[])).unwrap()
    }

    #[test]
    fn a_box_that_is_carried_well_passes() {
        let own = figures(0.02, 8.0);
        let is = |key: &str, expected: f64| {
            let value = own[key].as_f64().unwrap();
            assert!((value - expected).abs() < 1e-3, "{key}: {value}");
        };
        is("internal_mean_n", 25.0);
        is("internal_least_n", 25.0);
        is("tilt_deg", 0.02_f64.to_degrees());
        is("slipped_m", 0.0);
        is("way_m", 0.1);
        is("lifted_m", 0.1);
        is("put_down_n", 8.0);
        is("put_down_moved_m", 0.0);
        assert_eq!((own["load"].as_str(), own["held"].as_f64()), (Some("box"), Some(1.0)));
        assert!(asks(&own).iter().all(|figure| figure.passed() != Some(false)), "{own}");
    }

    #[test]
    fn a_tilt_and_a_hard_landing_are_found() {
        let missed = asks(&figures(0.2, 40.0)).into_iter().filter(|f| f.passed() == Some(false));
        let missed: Vec<String> = missed.map(|f| f.name).collect();
        assert_eq!(missed, ["tilt, largest", "put down with, over the weight"]);
    }
}
