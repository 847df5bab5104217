//! Inverse kinematics checked by forward kinematics.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{DifferentialIk, IkConfig, Model, PoseOptions, Twist, pose_error, solve_pose};

fn arm() -> (Arc<Model>, crate::LinkId, Vec<usize>) {
    let model = Model::shipped("armar3").unwrap();
    let tcp = model.link("tcp_right").unwrap();
    let joints = model.limb("right_arm").to_vec();
    (model, tcp, joints)
}

/// Random arm joints in the middle `share` of their ranges.
fn inside(model: &Model, joints: &[usize], share: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut q = model.zero();
    for &j in joints {
        let joint = &model.joints()[j];
        let (middle, half) = (0.5 * (joint.upper + joint.lower), 0.5 * share * (joint.upper - joint.lower));
        q[j] = rng.random_range(middle - half..middle + half);
    }
    q
}

#[test]
fn poses_in_reach_are_found() {
    let (model, tcp, joints) = arm();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..50 {
        let goal = inside(&model, &joints, 0.8, &mut rng);
        let target = model.link_pose(&goal, tcp);
        let options = PoseOptions::default();
        let q = solve_pose(&model, tcp, &joints, &target, &model.zero(), &options, &mut rng).unwrap();
        let error = pose_error(&model.link_pose(&q, tcp), &target);
        assert!(error.linear.norm() < 1e-4 && error.angular.norm() < 1e-3);
        for &j in &joints {
            let joint = &model.joints()[j];
            assert!(q[j] >= joint.lower + 0.0199 && q[j] <= joint.upper - 0.0199, "{}", joint.name);
        }
    }
}

#[test]
fn a_free_turn_reaches_more() {
    let (model, tcp, joints) = arm();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let goal = inside(&model, &joints, 0.6, &mut rng);
    // The same position, rotated by half a turn about the link's x: reachable only if that rotation is free.
    let target = model.link_pose(&goal, tcp)
        * nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let options = PoseOptions { orient: [false, true, true], ..PoseOptions::default() };
    let q = solve_pose(&model, tcp, &joints, &target, &goal, &options, &mut rng).unwrap();
    let here = model.link_pose(&q, tcp);
    assert!((here * Vector3::x()).angle(&(target * Vector3::x())) < 1e-3);
    assert!((here.translation.vector - target.translation.vector).norm() < 1e-4);
}

#[test]
fn a_pose_out_of_reach_says_how_far() {
    let (model, tcp, joints) = arm();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let target = Isometry3::from_parts(
        Translation3::new(0.25, 2.0, 1.0),
        model.link_pose(&model.zero(), tcp).rotation,
    );
    let options = PoseOptions::default();
    let error = solve_pose(&model, tcp, &joints, &target, &model.zero(), &options, &mut rng).unwrap_err();
    // From shoulder to TCP there are at most 0.75 m; the target is 1.9 m away.
    assert!(error.position_error_m > 1.0 && error.position_error_m < 1.5, "{error}");
    assert!(error.to_string().contains("tcp_right"));
    let nan = Isometry3::translation(f64::NAN, 0.0, 0.0);
    assert!(solve_pose(&model, tcp, &joints, &nan, &model.zero(), &options, &mut rng).is_err());
}

#[test]
fn a_step_makes_the_twist_and_the_posture_does_not_disturb_it() {
    let (model, tcp, joints) = arm();
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut ik = DifferentialIk::new(&model, tcp, &joints, IkConfig::default());
    let posture = vec![0.3; 7];
    for _ in 0..200 {
        let q = inside(&model, &joints, 0.7, &mut rng);
        let mut any = || Vector3::from_fn(|_, _| rng.random_range(-0.1..0.1));
        let twist = Twist { linear: any(), angular: any() };
        let step = ik.step(&q, &twist, Some(&posture));
        let (scale, residual, singular) = (step.scale, step.residual, step.singular);
        let mut all = vec![0.0; model.joints().len()];
        for (&j, v) in joints.iter().zip(step.velocities) {
            assert!(v.abs() <= model.joints()[j].velocity + 1e-12);
            all[j] = *v;
        }
        if singular > 0.06 {
            let made = ik.kinematics().twist(tcp, &nalgebra::Point3::origin(), &all);
            // The angular rows have the weight 0.3.
            assert!(residual < 1e-9 || scale < 1.0 || residual < 2e-3 * twist.linear.norm(), "{residual}");
            assert!((made.linear - twist.linear * scale).norm() <= residual + 1e-9);
            assert!((made.angular - twist.angular * scale).norm() <= residual / 0.3 + 1e-9);
        }
    }
}

#[test]
fn following_a_twist_into_joint_limits_stays_inside_them() {
    let (model, tcp, joints) = arm();
    let mut ik = DifferentialIk::new(&model, tcp, &joints, IkConfig::default());
    for direction in [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::z(), -Vector3::z()] {
        let mut q = model.zero();
        let twist = Twist { linear: 0.3 * direction, angular: Vector3::zeros() };
        for _ in 0..5000 {
            let step = ik.step(&q, &twist, None);
            for (&j, v) in joints.iter().zip(step.velocities) {
                assert!(v.is_finite());
                q[j] += v * 1e-3;
            }
        }
        for &j in &joints {
            let joint = &model.joints()[j];
            assert!(
                q[j] >= joint.lower + 0.0199 && q[j] <= joint.upper - 0.0199,
                "{} at {}",
                joint.name,
                q[j]
            );
        }
    }
    let step = ik.step(&model.zero(), &Twist { linear: Vector3::repeat(f64::NAN), ..Twist::default() }, None);
    assert!(step.velocities.iter().all(|v| *v == 0.0));
}

#[test]
fn free_axes_are_left_to_the_posture() {
    let (model, tcp, joints) = arm();
    let config =
        IkConfig { angular_weight: Vector3::new(0.0, 0.3, 0.3), posture_gain: 2.0, ..IkConfig::default() };
    let mut ik = DifferentialIk::new(&model, tcp, &joints, config);
    let mut q = model.zero();
    let (posture, start) = ([0.1, 0.2, 0.1, -0.3, 0.2, 0.1, 0.1], model.link_pose(&q, tcp));
    let distance =
        |q: &[f64]| joints.iter().zip(&posture).map(|(&j, p)| (q[j] - p).powi(2)).sum::<f64>().sqrt();
    let before = distance(&q);
    for _ in 0..3000 {
        let error = pose_error(&model.link_pose(&q, tcp), &start);
        let twist = Twist { linear: 5.0 * error.linear, angular: 5.0 * error.angular };
        let step = ik.step(&q, &twist, Some(&posture));
        joints.iter().zip(step.velocities).for_each(|(&j, v)| q[j] += v * 1e-3);
    }
    let end = model.link_pose(&q, tcp);
    assert!((end.translation.vector - start.translation.vector).norm() < 1e-3);
    assert!((end * Vector3::x()).angle(&(start * Vector3::x())) < 5e-3);
    assert!(distance(&q) < before);
}

#[test]
fn what_the_task_leaves_free_buys_speed() {
    let (model, tcp, joints) = arm();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut ik = DifferentialIk::new(&model, tcp, &joints, IkConfig::default());
    let (mut faster, mut tried) = (0, 0);
    for _ in 0..200 {
        let q = inside(&model, &joints, 0.6, &mut rng);
        let linear = Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5));
        let twist = Twist { linear, angular: Vector3::zeros() };
        let slow = Twist { linear: 1e-3 * linear, angular: Vector3::zeros() };
        // The least-norm solution, which is linear, scaled to the limits.
        let step = ik.step(&q, &slow, None);
        let least = 1.0 / step.velocities.iter().fold(1e-12_f64, |most, v| most.max(1e3 * v.abs()));
        if step.singular < 0.06 || least >= 1.0 {
            continue;
        }
        let step = ik.step(&q, &twist, None);
        let (scale, velocities) = (step.scale, step.velocities.to_vec());
        if step.residual > 2e-3 * linear.norm() {
            continue; // A joint is near its limit.
        }
        assert!(scale >= least - 1e-9, "{scale} and {least}");
        tried += 1;
        faster += usize::from(scale > 1.05 * least);
        let mut all = vec![0.0; model.joints().len()];
        joints.iter().zip(&velocities).for_each(|(&j, v)| all[j] = *v);
        let made = ik.kinematics().twist(tcp, &nalgebra::Point3::origin(), &all).linear;
        assert!((made - scale * linear).norm() < 2e-3 * linear.norm(), "{made:?} and {:?}", scale * linear);
    }
    assert!(tried > 50 && faster >= 5, "{faster} of {tried}");
}
