//! Tests of the probes on logs that are made up.

use std::f64::consts::TAU;

use armarium_values::report::Figure;
use nalgebra::{Isometry3, Vector3};
use serde_json::{Value, json};

use super::*;
use crate::coach::{ActionEvent, ActionKind, CoachPath, EventKind, wrap};

fn compute(world: &World, log: &TruthLog, marks: &[(u64, Milestone)]) -> Value {
    measure(world, log, marks, &[]).into()
}

fn number(report: &Value, place: &str) -> f64 {
    report.pointer(place).and_then(Value::as_f64).unwrap_or(f64::NAN)
}

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
            fastest_joint: 0.0,
        });
    }
    (world, log)
}

fn marks(free: u64, adapted: u64) -> Vec<(u64, Milestone)> {
    let s = 1_000_000_000;
    vec![
        (s, Milestone::GraspClosed),
        (s, Milestone::LearningEnded),
        (free * s, Milestone::AdaptationStarted),
        (adapted * s, Milestone::AdaptationEnded { desired_n: 8.0, cycles: 4 }),
    ]
}

#[test]
fn a_perfect_run_has_perfect_figures() {
    let (world, log) = run(30.0, |t| if t < 10.0 { 0.0 } else { 8.0 }, |_, _| 0.0);
    let report = compute(&world, &log, &marks(10, 12));
    assert!(number(&report, "/grasp/position_error_m") < 1e-9);
    assert!((number(&report, "/imitation/frequency_hz") - 0.5).abs() < 1e-4);
    assert!(number(&report, "/imitation/path_rms_m") < 2e-4, "{report}");
    assert!((number(&report, "/force/mean_n") - 8.0).abs() < 1e-9, "{report}");
    assert!(number(&report, "/force/rms_error_n") < 1e-9 && number(&report, "/force/contact_lost_s") == 0.0);
    assert!((number(&report, "/force/touchdown_max_n") - 8.0).abs() < 1e-9);
    assert!(number(&report, "/wiped_fraction") > 0.99, "{report}");
    assert!(report.get("coaching").is_none() && report.get("gestures").is_none());
}

#[test]
fn the_window_of_the_touchdown_begins_at_the_same_step_with_forces_of_a_recording() {
    let force = |t: f64| if t < 10.4 { 0.0 } else { 0.2003 + 16.5 * (t - 10.5) };
    let recorded = |t: f64| (force(t) * 1e3).round() / 1e3;
    let [exact, again] = [&force as &dyn Fn(f64) -> f64, &recorded].map(|force| {
        let (world, log) = run(30.0, force, |_, _| 0.0);
        number(&compute(&world, &log, &marks(10, 12)), "/force/touchdown_max_n")
    });
    assert!((exact - again).abs() < 1e-3, "{exact} N, and {again} N from the recording");
}

#[test]
fn a_weak_force_wipes_nothing_and_errors_are_counted() {
    let (world, log) = run(30.0, |_| 2.0, |_, _| 0.0);
    assert_eq!(compute(&world, &log, &marks(10, 12))["wiped_fraction"], 0.0);
    let wave = |t: f64| 8.0 + 2.0 * libm::sin(TAU * 0.5 * t);
    let (world, log) = run(30.0, wave, |_, _| 0.0);
    let report = compute(&world, &log, &marks(10, 12));
    assert!((number(&report, "/force/rms_error_n") - 2f64.sqrt()).abs() < 1e-3, "{report}");
    assert!((number(&report, "/force/max_n") - 10.0).abs() < 1e-3);
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
        height * libm::exp(-(off / 0.08).powi(2))
    };
    let (world, mut log) = run(45.0, |_| 8.0, bump);
    for (t, event) in [(15.0, EventKind::Began), (28.0, EventKind::Ended)] {
        log.coach.push(ActionEvent { step: 0, kind: ActionKind::Push, event, t });
    }
    let report = compute(&world, &log, &marks(2, 3));
    let push = &report["coaching"][0];
    assert_eq!(push["kind"], "push");
    assert!((number(push, "/displacement_m") - 0.03).abs() < 1.5e-3, "{push}");
    assert!((number(push, "/retained_m") - 0.024).abs() < 1.5e-3, "{push}");
    assert!(number(push, "/far_side_rms_m") < 2e-3, "{push}");
    assert!(number(push, "/direction_error_deg") < 5.0 && push.get("slowed_to").is_none());
}

fn by_name<'a>(figures: &'a [Figure], name: &str) -> &'a Figure {
    figures.iter().find(|f| f.name == name).expect("the figure exists")
}

#[test]
fn a_bound_counts_as_kept() {
    let report = json!({"grasp": {"position_error_m": 0.015}, "force": {"rms_error_n": 1.01, "mean_n": 8.0}});
    let figures = judged_figures(&report);
    assert_eq!(by_name(&figures, "position error").passed(), Some(true));
    assert_eq!(by_name(&figures, "error, RMS").passed(), Some(false));
}

#[test]
fn a_missing_value_fails_and_a_missing_section_is_not_judged() {
    let figures = judged_figures(&json!({"grasp": {}, "wiped_fraction": null}));
    assert_eq!(figures.len(), 1);
    assert_eq!(figures[0].passed(), Some(false));
}

#[test]
fn each_kind_of_coaching_is_asked_what_is_asked_of_it() {
    let report = json!({"wiped_fraction": 1.0, "coaching": [
        {"kind": "push", "displacement_m": 0.025, "retained_m": 0.021, "far_side_rms_m": 0.001,
         "direction_error_deg": 12.0},
        {"kind": "point_one", "displacement_m": 0.012, "retained_m": 0.011, "slowed_to": 0.5},
        {"kind": "open_hand"},
    ]});
    let figures = judged_figures(&report);
    assert!(figures.iter().all(|f| f.passed() == Some(true)), "{figures:?}");
    assert_eq!(figures.iter().filter(|f| f.group.starts_with("Coaching 1")).count(), 4);
    assert_eq!(figures.iter().filter(|f| f.group.starts_with("Coaching 2")).count(), 3);
    assert_eq!(figures.iter().filter(|f| f.group.starts_with("Coaching 3")).count(), 0);
}

#[test]
fn the_frequency_is_judged_against_the_demonstrated_one() {
    let report = json!({"imitation": {"frequency_hz": 0.506, "demonstrated_frequency_hz": 0.5}});
    assert_eq!(by_name(&judged_figures(&report), "frequency error").passed(), Some(false));
}

#[test]
fn a_world_names_the_probes_that_it_wants() {
    let (mut world, log) = run(30.0, |t| if t < 10.0 { 0.0 } else { 8.0 }, |_, _| 0.0);
    world.probes = vec!["force".into()];
    let report = compute(&world, &log, &marks(10, 12));
    assert_eq!(
        report.as_object().map(|report| report.keys().collect::<Vec<_>>()),
        Some(vec![&"force".to_owned()])
    );
}

#[test]
fn bodies_are_judged_by_where_they_end() {
    let mut world = World::parse(
        std::path::Path::new("world.yaml"),
        "objects: []
bodies:
  - {name: cup, shape: cup, at: [0.2, 0.6], contents: {balls: 2}}
  - {name: box, at: [0.4, 0.6]}",
    )
    .unwrap();
    world.table.tilt_deg = [0.0; 2];
    let mut log = TruthLog::default();
    let at = |x: f64, z: f64| Isometry3::translation(x, 0.6, z);
    // Cup, box, and the two balls: one rolls out.
    for (t, objects) in [
        (0, vec![at(0.2, 1.0), at(0.4, 1.0), at(0.2, 0.97), at(0.2, 0.99)]),
        (1, vec![at(0.21, 1.0), at(0.4, 0.1), at(0.21, 0.97), at(0.5, 0.96)]),
    ] {
        log.sample(&TruthSample { stamp_ns: t, objects, ..TruthSample::default() });
    }
    let report = compute(&world, &log, &[]);
    let [cup, other] = [0, 1].map(|i| &report["bodies"][i]);
    assert!(
        (number(cup, "/moved_m") - 0.01).abs() < 1e-9 && cup["spilled"] == 1 && cup["fell"] == false,
        "{cup}"
    );
    assert!(other["fell"] == true && other.get("spilled").is_none(), "{other}");
    let figures = judged_figures(&report);
    assert!(figures.iter().any(|figure| figure.name == "balls spilled" && figure.passed() == Some(false)));
}
