//! Gaze selection against closed forms, and in small worlds of directions.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;

fn towards(yaw: f64) -> Unit<Vector3<f64>> {
    Unit::new_normalize(Vector3::new(libm::sin(yaw), libm::cos(yaw), 0.0))
}

fn target(name: &str, yaw: f64, need: f64) -> GazeTarget {
    GazeTarget { name: name.into(), direction: towards(yaw), need, weight: 1.0 }
}

fn selection() -> GazeSelection {
    GazeSelection::new(GazeConfig::default(), GazeStrategy::Saliency).unwrap()
}

proptest! {
    /// The density of Maxwell, integrated.
    #[test]
    fn saliency_is_what_a_normal_place_leaves_outside(deviation in 1e-3_f64..0.5, within in 1e-3_f64..0.5) {
        let x = within / deviation;
        let steps = 4000;
        let density = |r: f64| (2.0 / std::f64::consts::PI).sqrt() * r * r * libm::exp(-r * r / 2.0);
        let step = x.min(12.0) / f64::from(steps);
        let inside: f64 = (0..steps).map(|i| density((f64::from(i) + 0.5) * step) * step).sum();
        prop_assert!((saliency(deviation, within) - (1.0 - inside)).abs() < 1e-4);
    }

    /// Whatever there is, a view is one that the eyes reach, serves somebody, and no single thing would be better served by more than the margin.
    #[test]
    fn no_view_of_one_thing_is_better_by_more_than_the_margin(
        yaws in prop::collection::vec((-1.2_f64..1.2, 0.0_f64..1.0), 1..5),
    ) {
        let targets: Vec<GazeTarget> =
            yaws.iter().enumerate().map(|(i, (yaw, need))| target(&i.to_string(), *yaw, *need)).collect();
        let mut selection = selection();
        let axis = towards(0.0);
        let view = selection.choose(0.1, &axis, &targets, |direction| *direction).unwrap();
        let served = |direction: &Unit<Vector3<f64>>| -> f64 {
            let seen: f64 = targets.iter().map(|t| t.need * selection.seen(direction, &t.direction)).sum();
            seen - selection.config.turn_cost * axis.angle(direction)
        };
        prop_assert!((served(&view.direction) - view.score).abs() < 1e-12);
        for single in &targets {
            prop_assert!(served(&single.direction) <= view.score + 1e-9);
        }
    }
}

#[test]
fn what_is_known_is_not_salient_and_what_is_unknown_is() {
    assert_eq!(saliency(0.0, 0.01), 0.0);
    assert_eq!(saliency(f64::INFINITY, 0.01), 1.0);
    assert!(saliency(f64::NAN, 0.01) == 0.0 && saliency(0.01, 0.0) == 1.0);
    assert!(saliency(0.001, 0.01) < 1e-6 && saliency(0.1, 0.01) > 0.99);
}

#[test]
fn nothing_to_look_at_is_no_view() {
    assert_eq!(selection().choose(0.1, &towards(0.0), &[], |direction| *direction), None);
}

#[test]
fn two_near_things_are_looked_at_together_and_two_far_ones_are_not() {
    let near = [target("cup", -0.2, 0.5), target("hand", 0.2, 0.5)];
    let view = selection().choose(0.1, &towards(0.0), &near, |direction| *direction).unwrap();
    assert_eq!(view.of, ["cup", "hand"]);
    assert!(view.direction.angle(&towards(0.0)) < 1e-9 && view.changed);
    let far = [target("cup", -0.6, 0.5), target("hand", 0.6, 0.6)];
    let view = selection().choose(0.1, &towards(0.0), &far, |direction| *direction).unwrap();
    assert_eq!(view.of, ["hand"]);
}

#[test]
fn what_the_neck_does_not_reach_is_left_for_what_it_does() {
    let targets = [target("behind", 2.5, 1.0), target("before", 0.3, 0.4)];
    let reached = |direction: &Unit<Vector3<f64>>| {
        let yaw = libm::atan2(direction.x, direction.y);
        towards(yaw.clamp(-1.0, 1.0))
    };
    let view = selection().choose(0.1, &towards(0.0), &targets, reached).unwrap();
    assert_eq!(view.of, ["before"]);
}

/// Four things too far apart for one view, the needs of which grow while they are not seen: each is seen often, and no view lasts less than
/// the dwell.
#[test]
fn all_are_seen_in_turn_and_the_eyes_do_not_swing() {
    let yaws = [("a", -0.9), ("b", -0.3), ("c", 0.35), ("d", 0.95)];
    let (dt, growth, within) = (0.05, 0.02, 0.01);
    let mut selection = selection();
    let (mut axis, mut age) = (towards(0.0), BTreeMap::from(yaws.map(|(name, _)| (name, 1.0))));
    let (mut kept, mut shortest, mut oldest) = (0.0, f64::INFINITY, 0.0_f64);
    for tick in 0..1200 {
        let need = |name: &str| saliency(growth * f64::sqrt(age[name]), within);
        let targets: Vec<GazeTarget> =
            yaws.iter().map(|(name, yaw)| target(name, *yaw, need(name))).collect();
        let view = selection.choose(dt, &axis, &targets, |direction| *direction).unwrap();
        kept += dt;
        if view.changed {
            shortest = if tick > 0 { kept.min(shortest) } else { shortest };
            kept = 0.0;
        }
        axis = view.direction;
        for (name, yaw) in yaws {
            let seen = selection.in_view(&axis, &towards(yaw));
            age.entry(name).and_modify(|age| *age = if seen { 0.0 } else { *age + dt });
        }
        if tick > 100 {
            oldest = age.values().fold(oldest, |oldest, age| oldest.max(*age));
        }
    }
    assert!(shortest > 0.4, "a view lasted {shortest} s only");
    assert!(oldest < 2.0, "something was not seen for {oldest} s");
}

#[test]
fn a_single_thing_comes_to_the_middle_of_the_picture() {
    // It is seen as well where it is, but hands at the border are read less well.
    let view =
        selection().choose(0.1, &towards(0.0), &[target("hand", 0.2, 0.5)], |direction| *direction).unwrap();
    assert!(view.direction.angle(&towards(0.2)) < 1e-9);
}
