//! Tests of the box task: learned, dropped, out of reach.

use super::*;

fn list(outcome: &ExperimentResult, name: &str) -> Vec<f64> {
    outcome.figures[name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn the_left_arm_learns_to_carry_the_box() {
    let outcome = DualArm { periods: 1, epochs: 4, ..DualArm::default() }.run().unwrap();
    let (distance, force) = (list(&outcome, "distance_rms_m"), list(&outcome, "force_rms_n"));
    assert!(distance[3] < 0.5 * distance[0], "{distance:?}");
    assert!(force[3] < force[0], "{force:?}");
    assert!(distance[0] < outcome.figures["distance_rms_before_m"].as_f64().unwrap(), "{distance:?}");
    assert!(list(&outcome, "held").iter().all(|h| *h > 0.999));
    assert!(list(&outcome, "joint_speed_rad_s").iter().all(|v| *v < 1.0));
    assert!(outcome.figures["diverged_in_epoch"].is_null());
}

#[test]
fn a_box_on_slippery_pads_is_dropped() {
    let outcome = DualArm { periods: 1, epochs: 1, friction: 0.02, ..DualArm::default() }.run().unwrap();
    assert!(list(&outcome, "slipped_m")[0] > 0.1, "{:?}", outcome.figures["slipped_m"]);
}

#[test]
fn what_the_arms_cannot_reach_is_said() {
    let far = DualArm { at: [0.0, 0.9, 1.02], ..DualArm::default() };
    assert!(matches!(far.run(), Err(ExperimentError::Failed(why)) if why.contains("does not reach")));
    let hard = DualArm { squeeze: 1e4, ..DualArm::default() };
    assert!(matches!(hard.run(), Err(ExperimentError::Setting { key, .. }) if key == "squeeze"));
}
