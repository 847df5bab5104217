//! The named postures have the properties that their docs state.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::{
    DifferentialIk, Gaze, IkConfig, Kinematics, Model, PoseOptions, Twist, pose_error, postures, solve_pose,
};

fn wipe_pose(offset: [f64; 3]) -> Isometry3<f64> {
    let at = Vector3::from(postures::WIPE_TCP) + Vector3::from(offset);
    Isometry3::from_parts(Translation3::from(at), postures::palm_down(postures::WIPE_YAW, 0.0))
}

#[test]
fn wipe_holds_the_level_hand_over_the_table() {
    let model = Arc::new(Model::armar3());
    let tcp = model.link_pose(&postures::wipe(&model), model.link("tcp_right").unwrap());
    let error = pose_error(&tcp, &wipe_pose([0.0; 3]));
    assert!(error.linear.norm() < 2e-3 && error.angular.norm() < 5e-3, "{error:?}");
    assert!((tcp * Vector3::x()).angle(&-Vector3::z()) < 5e-3);
    assert_eq!(postures::named(&model, "wipe"), Some(postures::wipe(&model)));
    assert_eq!(postures::named(&model, "no such"), None);
}

#[test]
fn both_postures_look_at_the_table_with_a_level_horizon_and_keep_joint_limits() {
    let model = Arc::new(Model::armar3());
    for q in [postures::home(&model), postures::wipe(&model)] {
        for (q, joint) in q.iter().zip(model.joints()) {
            assert!(*q >= joint.lower && *q <= joint.upper, "{} at {q}", joint.name);
        }
        for camera in ["camera_left", "camera_right"] {
            let camera = model.link_pose(&q, model.link(camera).unwrap());
            let there = camera.inverse() * Point3::from(postures::TABLE);
            assert!(there.coords.angle(&Vector3::z()) < 0.08, "{there:?}"); // half the baseline over 0.7 m
            assert!((camera * Vector3::x()).z.abs() < 0.05, "tilted by {}", (camera * Vector3::x()).z);
        }
    }
}

#[test]
fn home_hides_nothing_of_the_table_and_leads_straight_to_wipe() {
    let model = Arc::new(Model::armar3());
    let (home, wipe) = (postures::home(&model), postures::wipe(&model));
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(&home);
    let arm = ["elbow_r", "underarm_r", "wrist_1_r", "hand_right", "finger_left_r", "finger_right_r"];
    for camera in ["camera_left", "camera_right"] {
        let eye = kinematics.pose(model.link(camera).unwrap()).translation.vector;
        for link in arm {
            let p = kinematics.pose(model.link(link).unwrap()).translation.vector;
            let shadow = eye + (p - eye) * ((eye.z - 0.95) / (eye.z - p.z).max(1e-3));
            assert!(shadow.x > 0.7 || shadow.y < 0.2, "{link} hides {shadow:?} from {camera}");
        }
    }
    for k in 0..=50 {
        let t = f64::from(k) / 50.0;
        let q: Vec<f64> = home.iter().zip(&wipe).map(|(a, b)| a + t * (b - a)).collect();
        kinematics.update(&q);
        for (link, clearance) in [("elbow_r", 0.06), ("wrist_1_r", 0.05), ("hand_right", 0.09)] {
            let z = kinematics.pose(model.link(link).unwrap()).translation.z;
            assert!(z > 0.95 + clearance, "{link} at {z} after {t}");
        }
    }
}

#[test]
fn the_wiping_workspace_is_in_reach_and_fast_in_every_direction() {
    let model = Arc::new(Model::armar3());
    let (tcp, joints) = (model.link("tcp_right").unwrap(), postures::reaching_joints(&model));
    let mut ik = DifferentialIk::new(&model, tcp, &joints, IkConfig::default());
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let options = PoseOptions { margin: 0.06, restarts: 0, ..PoseOptions::default() };
    let seed = postures::wipe(&model);
    for (x, y) in [(0.0, 0.0), (0.13, 0.13), (0.13, -0.13), (-0.13, 0.13), (-0.13, -0.13)] {
        for z in [-0.05, 0.0, 0.05] {
            let target = wipe_pose([x, y, z]);
            let q = solve_pose(&model, tcp, &joints, &target, &seed, &options, &mut rng).unwrap();
            for k in 0..8 {
                let (s, c) = (f64::from(k) * std::f64::consts::FRAC_PI_4).sin_cos();
                let twist = Twist { linear: Vector3::new(c, s, 0.0), angular: Vector3::zeros() };
                let step = ik.step(&q, &twist, None);
                assert!(step.scale > 0.44 && step.residual < 0.05, "{} at {x} {y} {z}", step.scale);
            }
        }
    }
}

#[test]
fn the_head_finds_points_all_over_the_table_and_says_when_it_cannot() {
    let model = Arc::new(Model::armar3());
    let gaze = Gaze::of(&model).unwrap();
    let q = postures::wipe(&model);
    for x in [-0.2, 0.25, 0.7] {
        for y in [0.35, 0.9] {
            gaze.look_at(&model, &q, &Point3::new(x, y, 0.95)).unwrap();
        }
    }
    let behind = gaze.look_at(&model, &q, &Point3::new(0.1, -2.0, 1.6)).unwrap_err();
    assert!(behind.orientation_error_rad > 0.5);
}
