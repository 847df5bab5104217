//! The postures of ARMAR-III have the properties that its robot file states.

use std::path::Path;

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::{
    DifferentialIk, Gaze, IkConfig, Kinematics, Model, PoseOptions, Twist, description, pose_error,
    solve_pose,
};

/// Yaw of the hand in `wipe`, rad.
const WIPE_YAW: f64 = 0.77;
/// Position of the TCP in `wipe`, root frame, m.
const WIPE_TCP: [f64; 3] = [0.28, 0.53, 1.05];
/// The point that the cameras look at in both postures, root frame, m.
const TABLE: [f64; 3] = [0.25, 0.55, 1.00];

fn wipe_pose(model: &Model, offset: [f64; 3]) -> Isometry3<f64> {
    let at = Vector3::from(WIPE_TCP) + Vector3::from(offset);
    Isometry3::from_parts(Translation3::from(at), model.hands()["right_hand"].palm_down(WIPE_YAW))
}

#[test]
fn the_robots_that_ship_are_read_without_a_warning() {
    for name in description::shipped_robots() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots");
        let read = description::load(&Path::new(file).join(name).join("robot.yaml"), &[]).unwrap();
        assert_eq!((&*read.model, read.warnings), (&*Model::shipped(name).unwrap(), Vec::new()), "{name}");
    }
    let unknown = Model::shipped("armar4").unwrap_err()[0].to_string();
    assert!(unknown.contains("no robot `armar4`") && unknown.contains("armar3"), "{unknown}");
}

#[test]
fn wipe_holds_the_level_hand_over_the_table() {
    let model = Model::shipped("armar3").unwrap();
    let tcp = model.link_pose(&model.postures()["wipe"], model.link("tcp_right").unwrap());
    let error = pose_error(&tcp, &wipe_pose(&model, [0.0; 3]));
    assert!(error.linear.norm() < 2e-3 && error.angular.norm() < 5e-3, "{error:?}");
    assert!((tcp * Vector3::x()).angle(&-Vector3::z()) < 5e-3);
    assert_eq!(
        (model.ready("right_arm"), model.start()),
        (&model.postures()["wipe"][..], &model.postures()["home"][..])
    );
}

/// The left arm mirrors the right one across the plane x = 0, with the torso mirrored: frames are mirrored about their y.
#[test]
fn the_left_hand_mirrors_the_right_one() {
    let model = Model::shipped("armar3").unwrap();
    let mirrored = |pose: Isometry3<f64>| {
        let mirror = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        let rotation = mirror
            * pose.rotation.to_rotation_matrix().matrix()
            * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
        (mirror * pose.translation.vector, rotation)
    };
    for posture in ["home", "wipe"] {
        let [right, left] =
            ["right_arm", "left_arm"].map(|arm| model.posture(posture, arm).unwrap().to_vec());
        let pose = |q: &[f64], link: &str| model.link_pose(q, model.link(link).unwrap());
        for links in [
            ["tcp_right", "tcp_left"],
            ["wrist_sensor_right", "wrist_sensor_left"],
            ["grasp_right", "grasp_left"],
            ["hand_marker_right", "hand_marker_left"],
        ] {
            let (place, rotation) = mirrored(pose(&right, links[0]));
            let found = pose(&left, links[1]);
            assert!((found.translation.vector - place).norm() < 1e-9, "{posture} {links:?}");
            let off = found.rotation.to_rotation_matrix().matrix() - rotation;
            assert!(off.norm() < 1e-9, "{posture} {links:?}");
        }
        // The finger on the side of the thumb of one is that of the other.
        let (inner, _) = mirrored(pose(&right, "finger_left_r"));
        assert!((pose(&left, "finger_right_l").translation.vector - inner).norm() < 1e-9);
    }
    let [right, left] = ["right_wrist", "left_wrist"].map(|name| {
        let sensor = model.wrenches().iter().find(|sensor| sensor.name == name).unwrap();
        model
            .subtree(sensor.frame)
            .filter_map(|link| model.links()[link.index()].inertial)
            .map(|inertial| inertial.mass)
            .sum::<f64>()
    });
    assert!((right - left).abs() < 1e-12);
    assert_eq!(model.start_of("left_arm"), model.posture("home", "left_arm").unwrap());
    assert_eq!(model.start_of("right_arm"), model.start());
}

#[test]
fn both_postures_look_at_the_table_with_a_level_horizon_and_keep_joint_limits() {
    let model = Model::shipped("armar3").unwrap();
    for q in [model.postures()["home"].clone(), model.postures()["wipe"].clone()] {
        for (q, joint) in q.iter().zip(model.joints()) {
            assert!(*q >= joint.lower && *q <= joint.upper, "{} at {q}", joint.name);
        }
        for camera in ["camera_left", "camera_right"] {
            let camera = model.link_pose(&q, model.link(camera).unwrap());
            let there = camera.inverse() * Point3::from(TABLE);
            assert!(there.coords.angle(&Vector3::z()) < 0.08, "{there:?}"); // half the baseline over 0.7 m
            assert!((camera * Vector3::x()).z.abs() < 0.05, "tilted by {}", (camera * Vector3::x()).z);
        }
    }
}

#[test]
fn home_hides_nothing_of_the_table_and_leads_straight_to_wipe() {
    let model = Model::shipped("armar3").unwrap();
    let (home, wipe) = (model.postures()["home"].clone(), model.postures()["wipe"].clone());
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
    let model = Model::shipped("armar3").unwrap();
    let (tcp, joints) = (model.link("tcp_right").unwrap(), model.reaching_joints("right_arm"));
    let mut ik = DifferentialIk::new(&model, tcp, &joints, IkConfig::default());
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let options = PoseOptions { margin: 0.06, restarts: 0, ..PoseOptions::default() };
    let seed = model.postures()["wipe"].clone();
    for (x, y) in [(0.0, 0.0), (0.13, 0.13), (0.13, -0.13), (-0.13, 0.13), (-0.13, -0.13)] {
        for z in [-0.05, 0.0, 0.05] {
            let target = wipe_pose(&model, [x, y, z]);
            let q = solve_pose(&model, tcp, &joints, &target, &seed, &options, &mut rng).unwrap();
            for k in 0..8 {
                let (s, c) = libm::sincos(f64::from(k) * std::f64::consts::FRAC_PI_4);
                let twist = Twist { linear: Vector3::new(c, s, 0.0), angular: Vector3::zeros() };
                let step = ik.step(&q, &twist, None);
                assert!(step.scale > 0.44 && step.residual < 0.05, "{} at {x} {y} {z}", step.scale);
            }
        }
    }
}

#[test]
fn the_head_finds_points_all_over_the_table_and_says_when_it_cannot() {
    let model = Model::shipped("armar3").unwrap();
    let gaze = Gaze::of(&model).unwrap();
    let q = model.postures()["wipe"].clone();
    for x in [-0.2, 0.25, 0.7] {
        for y in [0.35, 0.9] {
            gaze.look_at(&model, &q, &Point3::new(x, y, 0.95)).unwrap();
        }
    }
    let behind = gaze.look_at(&model, &q, &Point3::new(0.1, -2.0, 1.6)).unwrap_err();
    assert!(behind.orientation_error_rad > 0.5);
}
