//! How far the coach lifts his hand to keep it clear of the robot's arm as it passes.
//!
//! Geometry of a standing hand, and of the arm as it was seen through one cycle. It makes no other decisions.

use nalgebra::{Isometry3, Point3, Vector3};

use super::SeenArm;

/// The hand touches the arm if it is nearer to the arm's axis than this, m: half the arm, half the hand and a
/// margin.
const CLEAR: f64 = 0.065;
/// The arm may touch the hand for a part of each cycle. If it does so for more than the first share of a cycle, the
/// coach lifts his hand until the share is at most the second.
const BRUSHED: (f64, f64) = (0.4, 0.1);
/// Height of a lifting step, m, and the largest number of steps.
const STEP: f64 = 0.01;
const STEPS: u32 = 10;
/// Distances from the palm to the wrist and to the fingertips, along the fingers, m.
const HAND: [f64; 2] = [-0.08, 0.15];
/// Number of intervals at whose ends the hand's distance to the arm is computed.
const SAMPLES: u32 = 6;

/// How far a hand at `hand` has to be lifted over the arm, m.
pub(super) fn lift(hand: &Isometry3<f64>, cycle: &[Option<SeenArm>]) -> f64 {
    let within = |lift: f64| {
        let seen = cycle.iter().flatten();
        let (all, near) =
            seen.fold((0, 0), |(all, near), arm| (all + 1, near + u32::from(meets(hand, lift, arm))));
        if all == 0 { 0.0 } else { f64::from(near) / f64::from(all) }
    };
    if within(0.0) <= BRUSHED.0 {
        return 0.0;
    }
    let heights = (1..=STEPS).map(|k| f64::from(k) * STEP);
    heights.clone().find(|&h| within(h) <= BRUSHED.1).unwrap_or(f64::from(STEPS) * STEP)
}

fn meets(hand: &Isometry3<f64>, lift: f64, arm: &SeenArm) -> bool {
    (0..=SAMPLES).any(|k| {
        let along = HAND[0] + (HAND[1] - HAND[0]) * f64::from(k) / f64::from(SAMPLES);
        let point = hand * Point3::new(0.0, 0.0, along) + Vector3::z() * lift;
        let bones = [[arm.tcp, arm.wrist], [arm.wrist, arm.elbow]];
        bones.iter().any(|bone| distance(&point, bone) < CLEAR)
    })
}

/// Distance from a point to a line segment, m.
fn distance(point: &Point3<f64>, [from, to]: &[Point3<f64>; 2]) -> f64 {
    let (along, there) = (to - from, point - from);
    let share = (along.dot(&there) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (there - along * share).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An arm along x, 1 m over the ground, whose elbow is at `x` = 0.5.
    fn arm() -> Option<SeenArm> {
        let at = |x: f64| Point3::new(x, 0.0, 1.0);
        Some(SeenArm { tcp: at(0.0), velocity: Vector3::zeros(), wrist: at(0.1), elbow: at(0.5) })
    }

    /// A hand with its palm over `x`, its fingers across the arm.
    fn hand(x: f64, z: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            nalgebra::Translation3::new(x, 0.0, z),
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2),
        )
    }

    #[test]
    fn a_hand_in_the_arm_is_lifted_over_it_and_another_is_not() {
        let cycle = vec![arm(); 10];
        assert!((lift(&hand(0.3, 1.0), &cycle) - 0.07).abs() < 1e-9);
        assert!((lift(&hand(0.3, 1.02), &cycle) - 0.05).abs() < 1e-9);
        assert_eq!(lift(&hand(-0.2, 1.0), &cycle), 0.0);
        assert_eq!(lift(&hand(0.3, 1.0), &[None, None]), 0.0);
    }

    #[test]
    fn a_hand_that_is_brushed_in_passing_stays() {
        let away = arm().map(|a| SeenArm {
            tcp: a.tcp + Vector3::x(),
            wrist: a.wrist + Vector3::x(),
            elbow: a.elbow + Vector3::x(),
            ..a
        });
        let mut cycle = vec![away; 10];
        cycle[..4].fill(arm());
        assert_eq!(lift(&hand(0.3, 1.0), &cycle), 0.0);
        cycle[4] = arm();
        assert!(lift(&hand(0.3, 1.0), &cycle) > 0.0);
    }
}
