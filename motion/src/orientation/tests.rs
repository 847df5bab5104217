//! Tests orientations against closed forms: rotations about one axis, unit norm, invariance, the shortest way, the
//! goal.

use std::f64::consts::{PI, TAU};

use proptest::prelude::*;

use super::*;
use crate::{DiscreteDmpConfig, PeriodicDmpConfig};

fn rotation(x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z))
}

/// A quintic of time from 0 to 1 and its derivative.
fn quintic(s: f64) -> (f64, f64) {
    (s * s * s * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s * s * (1.0 - s) * (1.0 - s))
}

/// Orientations at 200 Hz of a rotation of 2 s about `axis` by `angle` rad, from `start`.
fn turn(start: UnitQuaternion<f64>, axis: Vector3<f64>, angle: f64) -> Vec<UnitQuaternion<f64>> {
    let at =
        |k: i32| UnitQuaternion::from_scaled_axis(axis * (angle * quintic(f64::from(k) / 400.0).0)) * start;
    (0..=400).map(at).collect()
}

/// A rocking motion about two axes, evenly sampled over one period.
fn rocking(centre: UnitQuaternion<f64>, size: f64) -> Vec<UnitQuaternion<f64>> {
    (0..400)
        .map(|k| {
            let phase = TAU * f64::from(k) / 400.0;
            rotation(
                size * libm::sin(phase),
                0.6 * size * libm::cos(2.0 * phase),
                0.3 * size * libm::cos(phase),
            ) * centre
        })
        .collect()
}

fn discrete() -> DiscreteOrientationDmp {
    DiscreteOrientationDmp::new(DiscreteDmpConfig::default()).unwrap()
}

fn periodic() -> PeriodicOrientationDmp {
    PeriodicOrientationDmp::new(PeriodicDmpConfig::default()).unwrap()
}

#[test]
fn a_turn_about_one_axis_is_reproduced_with_its_angular_velocity() {
    let axis = Vector3::new(1.0, 2.0, -2.0) / 3.0;
    let start = rotation(0.3, -0.4, 0.5);
    // Also by more than half a turn: the direction of the demonstration is kept.
    for angle in [1.2, 4.5] {
        let shown = turn(start, axis, angle);
        let mut dmp = discrete();
        let duration = dmp.learn(0.005, &shown).unwrap();
        assert!((duration - 2.0).abs() < 1e-12);
        dmp.begin(&start, duration).unwrap();
        for k in 1..=2000 {
            let state = dmp.step(0.001, duration).unwrap();
            let (share, rate) = quintic(f64::from(k) / 2000.0);
            let wanted = UnitQuaternion::from_scaled_axis(axis * (angle * share)) * start;
            assert!(state.orientation.angle_to(&wanted) < 5e-3 * angle, "{k}");
            let velocity = axis * (angle * rate / duration);
            assert!((state.angular_velocity - velocity).norm() < 0.03 * angle, "{k}");
        }
    }
}

#[test]
fn it_arrives_at_the_goal_also_at_one_that_was_turned_on_the_way() {
    let mut dmp = discrete();
    dmp.learn(0.005, &turn(rotation(0.1, 0.2, 0.3), Vector3::z(), 1.0)).unwrap();
    let goal = rotation(-0.5, 0.9, 0.2);
    dmp.begin(&rotation(0.3, 0.0, 0.0), 1.0).unwrap();
    let mut last = dmp.state();
    for k in 0..3000 {
        if k == 400 {
            dmp.set_goal(goal, 1.0).unwrap();
            let now = dmp.state();
            assert!(now.orientation.angle_to(&last.orientation) < 1e-9);
            assert!((now.angular_velocity - last.angular_velocity).norm() < 1e-9);
        }
        last = dmp.step(0.001, 1.0).unwrap();
    }
    assert!(last.orientation.angle_to(&goal) < 1e-3 && last.angular_velocity.norm() < 1e-2);
}

#[test]
fn without_a_demonstration_it_turns_the_shortest_way() {
    let mut dmp = discrete();
    let start = rotation(0.0, 0.0, 1.5 * PI);
    dmp.begin(&start, 1.0).unwrap();
    // 270 degrees in one direction are 90 degrees in the other, and q and -q are the same orientation.
    let mut turned = 0.0;
    for _ in 0..3000 {
        turned += dmp.step(0.001, 1.0).unwrap().angular_velocity.z * 0.001;
    }
    assert!((turned - 0.5 * PI).abs() < 0.01, "{turned}");
    let negative = UnitQuaternion::new_unchecked(-start.into_inner());
    let mut other = discrete();
    other.begin(&negative, 1.0).unwrap();
    assert!(other.primitive().state().y.iter().zip([0.0, 0.0, -0.5 * PI]).all(|(a, b)| (a - b).abs() < 1e-9));
}

#[test]
fn a_rhythm_is_reproduced_about_its_mean() {
    let centre = rotation(0.7, -0.2, 0.4);
    let shown = rocking(centre, 0.6);
    let mut dmp = periodic();
    dmp.learn_period(&shown).unwrap();
    assert!(dmp.centre().angle_to(&centre) < 0.1);
    dmp.start_on_path(0.0, 3.0).unwrap();
    let steps = 400 * 8;
    for k in 1..=2 * steps {
        let state = dmp.step(TAU / 3.0 / f64::from(steps), 3.0).unwrap();
        if k % 8 == 0 {
            let wanted = shown[(k / 8) as usize % 400];
            assert!(
                state.orientation.angle_to(&wanted) < 6e-3,
                "{k} {}",
                state.orientation.angle_to(&wanted)
            );
        }
    }
}

#[test]
fn the_angular_velocity_is_that_of_the_orientation() {
    let mut dmp = periodic();
    dmp.learn_period(&rocking(rotation(0.2, 0.1, -0.4), 0.9)).unwrap();
    dmp.start_on_path(1.0, 2.0).unwrap();
    let (dt, mut last) = (1e-4, dmp.state());
    for _ in 0..3000 {
        let now = dmp.step(dt, 2.0).unwrap();
        let moved = (now.orientation * last.orientation.inverse()).scaled_axis() / dt;
        let mean = 0.5 * (now.angular_velocity + last.angular_velocity);
        assert!((moved - mean).norm() < 1e-5, "{moved} {mean}");
        last = now;
    }
    let (q, slope) = dmp.steady_state(0.4);
    let (r, _) = dmp.steady_state(0.4 + 1e-5);
    assert!(((r * q.inverse()).scaled_axis() / 1e-5 - slope).norm() < 1e-3);
}

#[test]
fn its_centre_turns_without_a_jump() {
    let mut dmp = periodic();
    dmp.learn_period(&rocking(UnitQuaternion::identity(), 0.4)).unwrap();
    dmp.start_on_path(0.0, 3.0).unwrap();
    let before = dmp.step(0.001, 3.0).unwrap();
    let centre = rotation(0.5, 0.5, 0.0);
    dmp.set_centre(centre, 3.0).unwrap();
    let after = dmp.state();
    assert!(after.orientation.angle_to(&before.orientation) < 1e-9);
    assert!((after.angular_velocity - before.angular_velocity).norm() < 1e-9);
    for _ in 0..20_000 {
        dmp.step(0.001, 3.0).unwrap();
    }
    let phase = dmp.primitive().phase();
    assert!(dmp.state().orientation.angle_to(&dmp.steady_state(phase).0) < 1e-4);
}

#[test]
fn what_has_no_centre_is_refused_and_changes_nothing() {
    let mut dmp = periodic();
    dmp.learn_period(&rocking(UnitQuaternion::identity(), 0.4)).unwrap();
    let before = dmp.clone();
    let spinning: Vec<_> = (0..100).map(|k| rotation(0.0, 0.0, TAU * f64::from(k) / 100.0)).collect();
    assert!(matches!(dmp.learn_period(&spinning), Err(MotionError::Degenerate { .. })));
    assert!(dmp.learn_period(&spinning[..4]).is_err());
    let broken = UnitQuaternion::new_unchecked(Quaternion::new(f64::NAN, 0.0, 0.0, 0.0));
    assert!(dmp.set_centre(broken, 1.0).is_err() && dmp.reset(0.0, &broken, &Vector3::zeros(), 1.0).is_err());
    assert_eq!(dmp, before);
}

#[test]
fn both_survive_saving() {
    let mut rhythm = periodic();
    rhythm.learn_period(&rocking(rotation(0.1, 0.2, 0.3), 0.4)).unwrap();
    let text = serde_json::to_string(&rhythm).unwrap();
    let loaded: PeriodicOrientationDmp = serde_json::from_str(&text).unwrap();
    assert!(loaded.steady_state(1.0).0.angle_to(&rhythm.steady_state(1.0).0) < 1e-9);
    let mut reach = discrete();
    reach.learn(0.005, &turn(rotation(0.1, 0.0, 0.0), Vector3::x(), 1.0)).unwrap();
    let loaded: DiscreteOrientationDmp =
        serde_json::from_value(serde_json::to_value(&reach).unwrap()).unwrap();
    assert!(loaded.goal().angle_to(&reach.goal()) < 1e-12);
    let mut bad = serde_json::to_value(&reach).unwrap();
    bad["goal"] = serde_json::json!([0.0, 0.0, 0.0, 0.0]);
    let said = serde_json::from_value::<DiscreteOrientationDmp>(bad).unwrap_err().to_string();
    assert!(said.contains("orientation"), "{said}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The movement does not depend on the frame; its norm is always 1.
    #[test]
    fn the_frame_does_not_matter_and_the_norm_is_one(
        frame in prop::array::uniform3(-2.0..2.0_f64), size in 0.1..1.2_f64, dt in 1e-4..0.05_f64
    ) {
        let frame = rotation(frame[0], frame[1], frame[2]);
        let shown = rocking(rotation(0.3, 0.1, 0.0), size);
        let seen: Vec<_> = shown.iter().map(|q| frame * q).collect();
        let (mut a, mut b) = (periodic(), periodic());
        a.learn_period(&shown).unwrap();
        b.learn_period(&seen).unwrap();
        let start = rotation(0.2, 0.0, 0.4);
        a.reset(0.3, &start, &Vector3::x(), 2.0).unwrap();
        b.reset(0.3, &(frame * start), &(frame * Vector3::x()), 2.0).unwrap();
        for _ in 0..200 {
            let (p, q) = (a.step(dt, 2.0).unwrap(), b.step(dt, 2.0).unwrap());
            prop_assert!((frame * p.orientation).angle_to(&q.orientation) < 1e-6);
            prop_assert!((frame * p.angular_velocity - q.angular_velocity).norm() < 1e-5);
            prop_assert!((p.orientation.norm() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn rate_and_angular_velocity_are_inverse(
        e in prop::array::uniform3(-1.7..1.7_f64), w in prop::array::uniform3(-3.0..3.0_f64), tiny in prop::bool::ANY
    ) {
        let e = Vector3::from(e) * if tiny { 1e-5 } else { 1.0 };
        let w = Vector3::from(w);
        prop_assert!((angular_velocity(&e, &rotation_rate(&e, &w)) - w).norm() < 1e-9);
    }
}
