//! Learning from epoch to epoch, compared with an independent implementation: joint space, task space, and with
//! moments.

use super::*;

fn list(outcome: &ExperimentResult, name: &str) -> Vec<f64> {
    outcome.figures[name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn the_left_arm_learns_to_follow_within_some_epochs() {
    // The figures of an independent implementation in numpy.
    for (k1, k2, expected) in [
        (0.3, 0.5, [3.757e-2, 7.284e-3, 1.758e-3, 5.42e-4]),
        (0.3, 0.0, [3.763e-2, 7.467e-3, 1.865e-3, 5.94e-4]),
        (0.1, 0.0, [5.171e-2, 3.221e-2, 2.035e-2, 1.302e-2]),
        (1.0, 1.0, [1.946e-2, 7.348e-3, 2.795e-3, 1.070e-3]),
    ] {
        let z = list(&Ilc { epochs: 4, k1, k2, ..Ilc::default() }.run().unwrap(), "z_rms_m");
        for (ours, theirs) in z.iter().zip(expected) {
            assert!((ours / theirs - 1.0).abs() < 0.1, "{k1} {k2}: {z:?}");
        }
    }
    let outcome = Ilc { epochs: 6, ..Ilc::default() }.run().unwrap();
    let velocity = list(&outcome, "velocity_rms_m_s");
    for (ours, theirs) in velocity.iter().zip([6.414e-2, 1.570e-2, 4.404e-3, 1.642e-3, 9.10e-4, 6.14e-4]) {
        assert!((ours / theirs - 1.0).abs() < 0.03, "{velocity:?}");
    }
    let discrete = list(&outcome, "discrete_z_rms_m");
    let without = list(&outcome, "discrete_z_rms_m_forces_only");
    assert!((1..6).all(|k| discrete[k] < without[k]), "{discrete:?} {without:?}");
    assert!((outcome.figures["z_rms_m_before"].as_f64().unwrap() / 0.06393 - 1.0).abs() < 0.02);
    assert_eq!(outcome.plots.len(), 3);
}

#[test]
fn it_learns_in_task_space_and_with_moments_too() {
    let task = Ilc { epochs: 6, space: Space::Task, ..Ilc::default() }.run().unwrap();
    let z = list(&task, "z_rms_m");
    assert!(z[5] < 0.1 * z[0], "{z:?}");
    let turning = Ilc { epochs: 6, orientation: true, ..Ilc::default() }.run().unwrap();
    let z = list(&turning, "z_rms_m");
    assert!(z[5] < 0.2 * z[0], "{z:?}");
    assert_eq!(list(&turning, "turned_rms_rad").len(), 6);
    let both = Ilc { space: Space::Task, orientation: true, ..Ilc::default() };
    assert!(matches!(both.run(), Err(ExperimentError::Setting { .. })));
}

#[test]
fn gains_that_do_not_hold_the_motion_are_reported() {
    let outcome = Ilc { epochs: 30, k1: 50.0, ..Ilc::default() }.run().unwrap();
    let z = list(&outcome, "z_rms_m");
    assert!(!outcome.figures["diverged_in_epoch"].is_null() || z[z.len() - 1] > z[0], "{z:?}");
    assert!(Ilc { hand: [0.9, 0.15], ..Ilc::default() }.run().is_err());
}
