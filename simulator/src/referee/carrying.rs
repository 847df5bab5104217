//! The probe `carrying`: what two hands do to what they carry between them, and how they put it down.

use armarium_values::report::Requirement::{AtLeast, AtMost, Between, Shown};
use armarium_values::report::{Block, Figure, Section, Series, TimePlot};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::probes::{Probe, figure};
use super::run::{JudgedRun, ns, seconds};
use crate::physics::PressedLoad;
use crate::world::{BodySpec, GRAVITY, WorldEvent};

pub(super) const PROBE: Probe = Probe { name: "carrying", measure, asks, section };

/// Every so many milliseconds a point is drawn.
const STRIDE: usize = 10;
/// The force of the table is a mean over so many milliseconds: where rigid bodies meet, a single one has no force of its own, but an
/// impulse.
const WINDOW: usize = 10;

/// What stands on the load is spilled when the fluid in it would stand at a larger angle to its rim, degrees, ...
const SPILLED_DEG: f64 = 12.0;
/// ... or when it has moved on the load by this, m.
const SPILLED_M: f64 = 0.01;
/// Time constant of the low-pass of 10 Hz on the acceleration, s.
const SMOOTH: f64 = 1.0 / (2.0 * std::f64::consts::PI * 10.0);
/// The largest internal force where hands grip, N.
const PULLED_N: f64 = 60.0;

/// A load that is pressed with more counts as crushed, N; in a shove it may be more.
pub(super) const CRUSHED_N: f64 = 40.0;
const PEAK_N: f64 = 60.0;
/// The least friction for which hands are asked to press, and how much more they shall press than that needs.
const FRICTION: f64 = 0.6;
const MARGIN: f64 = 1.5;
/// How long after a shove the squeeze may be another one, s.
const SHOVED_S: f64 = 0.5;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct CarryingFigures {
    /// The body that was carried.
    load: String,
    /// Its mass with what stands on it, kg.
    mass_kg: f64,
    /// Whether the hands grip it, instead of pressing on it.
    gripped: bool,
    /// By which share the hands' first weighing is wrong, after the lift.
    #[serde(skip_serializing_if = "Option::is_none")]
    mass_error: Option<f64>,
    /// From when to when it was carried, s.
    from_s: f64,
    for_s: f64,
    /// Mean, least and largest internal force while it was carried, N.
    internal_mean_n: f64,
    internal_least_n: f64,
    internal_most_n: f64,
    /// Of what is pressed, from when it was weighed: RMS of the internal force less the asked one, N, but for half a second after a shove.
    #[serde(skip_serializing_if = "Option::is_none")]
    squeeze_rms_n: Option<f64>,
    /// Largest angle between its z axis and the vertical, less that at the beginning where it is pressed, degrees.
    tilt_deg: f64,
    /// Of what stands on it: the largest angle of its axis to what pulls at what it holds, degrees, when that was, s, and how far it moved
    /// on the load, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    sloshed_deg: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sloshed_at_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    upon_moved_m: Option<f64>,
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
    /// How far it moved along the floor from the moment in which the table bore it until the hands had let go, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    put_down_moved_m: Option<f64>,
}

/// What was between the hands at a time, ns, and the pose of its middle.
pub(super) type Pressed = (u64, PressedLoad, Isometry3<f64>);

/// What was between the hands in a span of time, ns.
pub(super) fn between<'r>(run: &JudgedRun<'r>, from: u64, to: u64) -> &'r [Pressed] {
    let at = |t: u64| run.log.pressed.partition_point(|(stamp, ..)| *stamp < t);
    let (from, to) = (at(from), at(to));
    &run.log.pressed[from..to.max(from)]
}

/// While it was carried: from the first time that this began until it was put down, or to the end of the run.
fn carried<'r>(run: &JudgedRun<'r>) -> Option<&'r [Pressed]> {
    let from = run.first_time_of(|mark| *mark == Milestone::CarryingStarted)?;
    let after = |what: fn(&Milestone) -> bool| run.time_of(what).filter(|to| *to > from);
    let to = after(|mark| *mark == Milestone::PutDownStarted);
    let to = to.or_else(|| after(|mark| matches!(mark, Milestone::CarryingEnded { .. })));
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

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    let carried = carried(run)?;
    let [begin, .., end] = carried else { return None };
    let (from, load, start) = begin;
    let body = run.world.named_bodies().nth(load.body)?;
    let forces: Vec<f64> = carried.iter().map(|(_, load, _)| internal_force(load)).collect();
    let fold = |start: f64, pick: fn(f64, f64) -> f64| forces.iter().copied().fold(start, pick);
    let touched = |(_, load, _): &&Pressed| load.hands.iter().all(|hand| hand.force != Vector3::zeros());
    // What is gripped is to be level; what is pressed keeps the tilt of the table on which it stood.
    let stood = if load.gripped { 0.0 } else { tilt(start) };
    let lean = |(_, _, pose): &Pressed| (tilt(pose) - stood).abs().to_degrees();
    let way = |pair: &[Pressed]| (pair[1].2.translation.vector - pair[0].2.translation.vector).norm();
    let height = |(_, _, pose): &Pressed| pose.translation.z - start.translation.z;
    let borne = carried.iter().position(|(_, load, _)| load.borne_n == 0.0);
    let upon = Upon::of(run, load.body);
    let mass = body.mass + upon.as_ref().map_or(0.0, |upon| upon.mass);
    let put_down = put_down(run, mass * GRAVITY);
    let weighed = run.marks().iter().find_map(|(_, mark)| match mark {
        Milestone::CarryingEnded { weight_n } => Some(*weight_n),
        _ => None,
    });
    let stood_upon = upon.as_ref().and_then(|upon| upon.stood(run, *from)).unwrap_or_default();
    let sloshed = stood_upon.iter().max_by(|a, b| a.sloshed_deg.total_cmp(&b.sloshed_deg));
    let moved = stood_upon.iter().map(|upon| upon.moved_m).reduce(f64::max);
    // Where nothing is between the hands there is no entry at all.
    let lasted = (end.0 - from) / 1_000_000 + 1;
    let figures = CarryingFigures {
        load: body.name.clone(),
        mass_kg: mass,
        gripped: load.gripped,
        mass_error: weighed.map(|weight| weight / (mass * GRAVITY) - 1.0),
        from_s: seconds(*from),
        for_s: seconds(end.0 - from),
        internal_mean_n: forces.iter().sum::<f64>() / forces.len() as f64,
        internal_least_n: fold(f64::INFINITY, f64::min),
        internal_most_n: fold(0.0, f64::max),
        squeeze_rms_n: squeeze_rms(run, carried, mass).filter(|_| !load.gripped),
        tilt_deg: carried.iter().map(lean).fold(0.0, f64::max),
        sloshed_deg: sloshed.map(|most| most.sloshed_deg),
        sloshed_at_s: sloshed.map(|most| seconds(most.at_ns)),
        upon_moved_m: moved,
        slipped_m: borne.map_or(0.0, |borne| (in_hands(end) - in_hands(&carried[borne])).norm()),
        held: carried.iter().filter(touched).count() as f64 / lasted as f64,
        way_m: carried.windows(2).map(way).sum(),
        lifted_m: carried.iter().map(height).fold(0.0, f64::max),
        put_down_n: put_down.map(|(force, _)| force),
        put_down_moved_m: put_down.map(|(_, moved)| moved),
    };
    serde_json::to_value(figures).ok()
}

/// Whether something is shoved then, or was within the last half second.
fn shoved(run: &JudgedRun<'_>, at: u64) -> bool {
    let mut shoves = run.world.disturbances.iter().filter(|what| what.after == WorldEvent::Start);
    shoves.any(|what| (0.0..what.duration + SHOVED_S).contains(&(seconds(at) - what.at)))
}

/// RMS of the internal force less the asked one, N, from the end of the first motion, in which the load was weighed, on.
fn squeeze_rms(run: &JudgedRun<'_>, carried: &[Pressed], mass: f64) -> Option<f64> {
    let weighed = run.first_time_of(|mark| matches!(mark, Milestone::CarryingEnded { .. }))?;
    let asked = (MARGIN * mass * GRAVITY / (2.0 * FRICTION)).min(CRUSHED_N);
    let held = carried.iter().filter(|(at, ..)| *at > weighed + ns(SHOVED_S) && !shoved(run, *at));
    let squares: Vec<f64> = held.map(|(_, load, _)| (internal_force(load) - asked).powi(2)).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// What stands on the load: the first body that the world puts there.
struct Upon {
    /// Its index.
    body: usize,
    /// Its mass with what is in it, kg.
    mass: f64,
}

impl Upon {
    fn of(run: &JudgedRun<'_>, load: usize) -> Option<Self> {
        let name = run.world.body_name(load)?;
        let stands = |(_, body): &(usize, BodySpec)| body.on.as_deref() == Some(name);
        let (body, spec) = run.world.named_bodies().enumerate().find(stands)?;
        let inside = spec.contents.map_or(0.0, |inside| f64::from(inside.balls) * inside.mass);
        Some(Self { body, mass: spec.mass + inside })
    }

    /// How it stood in each millisecond from `from` ns on in which both hands have the load.
    fn stood(&self, run: &JudgedRun<'_>, from: u64) -> Option<Vec<Stood>> {
        let held = between(run, from, u64::MAX);
        let places = run.log.moved.get(&self.body)?;
        let mut next = 0;
        let mut place_at = |t: u64| {
            next += places[next..].partition_point(|(at, _)| *at <= t);
            places.get(next.checked_sub(1)?).map(|(_, pose)| *pose)
        };
        let begin = held.first()?;
        let on_load = begin.2.inverse() * place_at(begin.0)?;
        let point = |entry: &Pressed| (entry.2 * on_load).translation.vector;
        let mut pull = Vector3::zeros();
        let mut stood = |three: &[Pressed]| {
            let (at_ns, _, pose) = &three[2];
            let place = place_at(*at_ns)?;
            let steps = [three[1].0 - three[0].0, three[2].0 - three[1].0];
            if steps == [1_000_000; 2] {
                let bend = point(&three[2]) - point(&three[1]) * 2.0 + point(&three[0]);
                pull += (bend * 1e6 - pull) * (1e-3 / (SMOOTH + 1e-3));
            }
            let up = Vector3::z() * GRAVITY + pull;
            let sloshed_deg = (place.rotation * Vector3::z()).angle(&up).to_degrees();
            let moved_m = ((pose.inverse() * place).translation.vector - on_load.translation.vector).norm();
            Some(Stood { at_ns: *at_ns, sloshed_deg, moved_m })
        };
        held.windows(3).map(&mut stood).collect()
    }
}

/// How what is upon the load stands at a time.
struct Stood {
    at_ns: u64,
    /// The angle of its axis to the pull that what it holds feels, degrees.
    sloshed_deg: f64,
    /// How far it has moved on the load, m.
    moved_m: f64,
}

/// The largest force of the table less the weight, N, and how far the load moved along the floor from when the table bore it, m.
fn put_down(run: &JudgedRun<'_>, weight: f64) -> Option<(f64, f64)> {
    let from = run.time_of(|mark| *mark == Milestone::PutDownStarted)?;
    let to = run.time_of(|mark| *mark == Milestone::PutDownEnded).filter(|to| *to > from)?;
    let lowered = between(run, from, to);
    let mean =
        |window: &[Pressed]| window.iter().map(|(_, load, _)| load.borne_n).sum::<f64>() / WINDOW as f64;
    let undisturbed = lowered.windows(WINDOW).filter(|window| !shoved(run, window[0].0));
    let most = undisturbed.map(mean).fold(0.0, f64::max);
    let (_, _, first) = lowered.iter().find(|(_, load, _)| load.borne_n > 0.5 * weight)?;
    let (_, _, last) = lowered.last()?;
    Some((most - weight, (last.translation.vector - first.translation.vector).xy().norm()))
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Carrying", name), own, key, unit, requirement);
    let (least, most) = match own["gripped"] == true {
        true => (AtLeast(-PULLED_N), AtMost(PULLED_N)),
        false => (AtLeast(5.0), AtMost(PEAK_N)),
    };
    let mut figures = vec![
        of("internal force, mean", ("internal_mean_n", 1.0), ("N", 1), Shown),
        of("internal force, least", ("internal_least_n", 1.0), ("N", 1), least),
        of("internal force, largest", ("internal_most_n", 1.0), ("N", 1), most),
        of("tilt, largest", ("tilt_deg", 1.0), ("°", 1), AtMost(3.0)),
        of("slipped", ("slipped_m", 1e3), ("mm", 1), AtMost(5.0)),
        of("touched by both hands", ("held", 100.0), ("%", 1), AtLeast(100.0)),
        of("way", ("way_m", 1.0), ("m", 2), Shown),
        of("lifted", ("lifted_m", 1e3), ("mm", 0), AtLeast(50.0)),
    ];
    if own.get("squeeze_rms_n").is_some() {
        figures.push(of("squeeze, RMS off the asked one", ("squeeze_rms_n", 1.0), ("N", 1), AtMost(3.0)));
    }
    if own.get("mass_error").is_some() {
        figures.push(of("weighed wrong by", ("mass_error", 100.0), ("%", 1), Between(-5.0, 5.0)));
    }
    if own.get("sloshed_deg").is_some() {
        let (angle, way) = (AtMost(SPILLED_DEG), AtMost(SPILLED_M * 1e3));
        figures.push(of("spilled: angle of what it holds", ("sloshed_deg", 1.0), ("°", 1), angle));
        figures.push(of("spilled: moved on the load", ("upon_moved_m", 1e3), ("mm", 1), way));
    }
    if own.get("put_down_n").is_some() {
        figures.push(of("put down with, over the weight", ("put_down_n", 1.0), ("N", 1), AtMost(15.0)));
        figures.push(of("moved by letting go", ("put_down_moved_m", 1e3), ("mm", 1), AtMost(5.0)));
    }
    figures
}

fn section(run: &JudgedRun<'_>, _: &Value) -> Vec<Section> {
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
    let mut blocks = vec![Block::Plot(forces), Block::Plot(tilted)];
    let (from, load, _) = &carried[0];
    if let Some(stood) = Upon::of(run, load.body).and_then(|upon| upon.stood(run, *from)) {
        // Of each stretch the worst: a jolt is short.
        let worst = |stretch: &[Stood]| stretch.iter().map(|upon| upon.sloshed_deg).fold(0.0, f64::max);
        blocks.push(Block::Plot(TimePlot {
            title: "What stands on it: the angle of what it holds".into(),
            y_label: "Angle, °".into(),
            series: vec![Series {
                label: "to its axis".into(),
                t_s: stood.chunks(STRIDE).map(|stretch| seconds(stretch[0].at_ns)).collect(),
                y: stood.chunks(STRIDE).map(worst).collect(),
            }],
            ..TimePlot::default()
        }));
    }
    vec![Section::new("Carrying", note, blocks)]
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::physics::PressingHand;
    use crate::referee::TruthLog;
    use crate::world::{Disturbance, World};

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
            let borne_n = if t < 3.5 { 0.0 } else { 2.0 * GRAVITY + extra };
            log.pressed.push((
                ms * 1_000_000,
                PressedLoad { body: 0, hands: [hand(1.0), hand(-1.0)], borne_n, gripped: false },
                pose,
            ));
        }
        (world, log)
    }

    fn figures(tilt: f64, extra: f64) -> Value {
        let (world, log) = carried(tilt, extra);
        let marks = [
            (1_000_000_000, Milestone::CarryingStarted),
            (2_400_000_000, Milestone::CarryingEnded { weight_n: 19.0 }),
            (2_500_000_000, Milestone::PutDownStarted),
            (3_990_000_000, Milestone::PutDownEnded),
        ];
        measure(&JudgedRun::new(&world, &log, &marks, &[])).unwrap()
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

    /// The same, gripped and with a cup on it, which slides by `slides` m in half a second while they set off with `ahead` m/s^2.
    fn with_cup(slides: f64, ahead: f64) -> Value {
        let (mut world, mut log) = carried(0.0, 0.0);
        let cup = BodySpec { name: "cup".into(), mass: 0.3, on: Some("box".into()), ..BodySpec::default() };
        world.bodies.push(cup);
        let places = log.moved.entry(1).or_default();
        for (stamp, load, pose) in &mut log.pressed {
            let t = *stamp as f64 * 1e-9 - 1.2;
            let far = 0.5 * ahead * t.clamp(0.0, 0.5).powi(2) + ahead * 0.5 * (t - 0.5).max(0.0);
            pose.translation.x += far;
            load.hands.iter_mut().for_each(|hand| hand.at.x += far);
            load.gripped = true;
            load.hands[0].force.x = 0.0;
            let slid = slides * (t / 0.5).clamp(0.0, 1.0);
            places.push((*stamp, *pose * Isometry3::translation(0.05 + slid, 0.0, 0.1)));
        }
        let marks = [
            (1_000_000_000, Milestone::CarryingStarted),
            (2_400_000_000, Milestone::CarryingEnded { weight_n: 2.1 * GRAVITY }),
        ];
        measure(&JudgedRun::new(&world, &log, &marks, &[])).unwrap()
    }

    #[test]
    fn a_cup_that_slides_or_sloshes_is_spilled_and_a_load_is_weighed_with_it() {
        let missed = |own: &Value| -> Vec<String> {
            asks(own).into_iter().filter(|f| f.passed() == Some(false)).map(|f| f.name).collect()
        };
        let own = with_cup(0.0, 0.2);
        assert_eq!(own["mass_kg"], 2.3);
        assert!((own["mass_error"].as_f64().unwrap() - (2.1 / 2.3 - 1.0)).abs() < 1e-9, "{own}");
        assert_eq!(missed(&own), ["weighed wrong by"]);
        let slid = with_cup(0.012, 0.2);
        assert_eq!(missed(&slid), ["weighed wrong by", "spilled: moved on the load"]);
        // An acceleration of 3 m/s^2 tilts what stands in it by 17 degrees.
        let sloshed = with_cup(0.0, 3.0);
        let angle = sloshed["sloshed_deg"].as_f64().unwrap();
        assert!((angle - libm::atan(3.0 / GRAVITY).to_degrees()).abs() < 0.5, "{angle}");
        assert_eq!(missed(&sloshed), ["weighed wrong by", "spilled: angle of what it holds"]);
    }

    #[test]
    fn a_squeeze_that_is_not_the_asked_one_is_found_but_not_in_a_shove() {
        let (mut world, mut log) = carried(0.0, 0.0);
        for (stamp, load, _) in &mut log.pressed {
            if (2_000_000_000..2_300_000_000).contains(stamp) {
                load.hands.iter_mut().for_each(|hand| hand.force.x *= 1.6);
            }
        }
        let ended = |at| (at, Milestone::CarryingEnded { weight_n: 19.0 });
        let marks = [(1_000_000_000, Milestone::CarryingStarted), ended(1_200_000_000), ended(3_400_000_000)];
        let rms = |world: &World| {
            let own = measure(&JudgedRun::new(world, &log, &marks, &[])).unwrap();
            own["squeeze_rms_n"].as_f64().unwrap()
        };
        assert!(rms(&world) > 5.0, "{}", rms(&world));
        let start = WorldEvent::Start;
        world.disturbances =
            vec![Disturbance { after: start, at: 2.0, duration: 0.2, ..Disturbance::default() }];
        // 25 N, and 1.5 * 19.62 N / (2 * 0.6) are asked.
        assert!((rms(&world) - 0.475).abs() < 1e-3, "{}", rms(&world));
    }

    #[test]
    fn a_tilt_and_a_hard_landing_are_found() {
        let missed = asks(&figures(0.2, 40.0)).into_iter().filter(|f| f.passed() == Some(false));
        let missed: Vec<String> = missed.map(|f| f.name).collect();
        assert_eq!(missed, ["tilt, largest", "put down with, over the weight"]);
    }
}
