//! Tests of the physics against closed forms that the whole plant must reproduce.

use std::sync::Arc;

use armarium_robot::{Kinematics, Model};
use nalgebra::{Isometry3, Vector3};

use super::{DT, External, Plant};
use crate::world::GRAVITY;
use crate::world::{ObjectSpec, TableSpec, World};

fn model() -> Arc<Model> {
    Model::shipped("armar3").unwrap()
}

/// A world whose table is far below the hand.
fn free() -> World {
    World { table: TableSpec { height: 0.4, ..TableSpec::default() }, objects: vec![], ..World::default() }
}

fn start(model: &Model) -> Vec<f64> {
    let mut q = model.zero();
    q[model.joint("elbow_r").unwrap()] = -0.4;
    for finger in ["finger_left_r", "finger_right_r"] {
        q[model.joint(finger).unwrap()] = 0.05;
    }
    q
}

fn hold(plant: &mut Plant, steps: usize, external: &External) {
    let q = plant.position().to_vec();
    let zero = vec![0.0; q.len()];
    for _ in 0..steps {
        plant.step(&q, &zero, external);
    }
}

fn hand_mass(model: &Model) -> f64 {
    let sensor = model.link("wrist_sensor_right").unwrap();
    model.subtree(sensor).filter_map(|l| model.links()[l.index()].inertial).map(|i| i.mass).sum()
}

fn sensor_pose(model: &Arc<Model>, plant: &Plant) -> Isometry3<f64> {
    let mut kinematics = Kinematics::new(model);
    kinematics.update(plant.position());
    *kinematics.pose(model.link("wrist_sensor_right").unwrap())
}

#[test]
fn the_bodies_stand_where_the_model_says() {
    let model = model();
    let mut q = start(&model);
    for (i, joint) in model.joints().iter().enumerate() {
        q[i] = (joint.lower + (joint.upper - joint.lower) * (0.3 + 0.01 * i as f64))
            .clamp(joint.lower, joint.upper);
    }
    let mut plant = Plant::new(&model, &free(), &q).unwrap();
    let mut kinematics = Kinematics::new(&model);
    hold(&mut plant, 50, &External::default());
    kinematics.update(plant.position());
    let expected = kinematics.pose(model.link("tcp_right").unwrap());
    assert!((plant.tcp().translation.vector - expected.translation.vector).norm() < 1e-9);
    assert!(plant.tcp().rotation.angle_to(&expected.rotation) < 1e-9);
    for (a, b) in plant.position().iter().zip(&q) {
        assert!((a - b).abs() < 1e-9);
    }
}

#[test]
fn a_hanging_hand_reads_its_weight() {
    let model = model();
    let q = start(&model);
    let mut plant = Plant::new(&model, &free(), &q).unwrap();
    hold(&mut plant, 100, &External::default());
    let (force, torque) = plant.wrist();
    let pose = sensor_pose(&model, &plant);
    let weight = hand_mass(&model) * GRAVITY;
    assert!((pose.rotation * force + Vector3::z() * weight).norm() < 1e-6, "{force}");
    // The torque is the weight times the lever arm of the hand's centre of mass.
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(plant.position());
    let mut expected = Vector3::zeros();
    for link in model.subtree(model.link("wrist_sensor_right").unwrap()) {
        if let Some(i) = model.links()[link.index()].inertial {
            let c = kinematics.pose(link) * i.center;
            expected += (c.coords - pose.translation.vector).cross(&(Vector3::z() * -GRAVITY * i.mass));
        }
    }
    assert!((pose.rotation * torque - expected).norm() < 1e-6, "{torque} {expected}");
}

#[test]
fn a_push_reads_its_force_and_its_torque() {
    let model = model();
    let q = start(&model);
    let mut plant = Plant::new(&model, &free(), &q).unwrap();
    hold(&mut plant, 300, &External::default());
    let (force_before, torque_before) = plant.wrist();
    let push = Vector3::new(6.0, 0.0, 8.0);
    hold(&mut plant, 500, &External { hand: push, objects: vec![] });
    let (force, torque) = plant.wrist();
    let pose = sensor_pose(&model, &plant);
    assert!((pose.rotation * (force - force_before) - push).norm() < 0.01, "{force}");
    let arm = plant.tcp().translation.vector - pose.translation.vector;
    let expected = arm.cross(&push);
    assert!((pose.rotation * (torque - torque_before) - expected).norm() < 0.01);
}

#[test]
fn servos_track_a_moving_set_point() {
    let model = model();
    let q0 = start(&model);
    let mut plant = Plant::new(&model, &free(), &q0).unwrap();
    let arm = model.limb("right_arm").to_vec();
    let mut kinematics = Kinematics::new(&model);
    let tcp = model.link("tcp_right").unwrap();
    let (mut q, mut v) = (q0.clone(), vec![0.0; q0.len()]);
    let mut worst = 0.0f64;
    let (amplitude, omega) = (0.15, std::f64::consts::TAU * 0.8);
    for i in 0..3000 {
        let t = f64::from(i) * DT;
        let ramp = (t / 0.5).min(1.0);
        for (k, &j) in arm.iter().enumerate() {
            let phase = omega * t + k as f64;
            q[j] = q0[j] + amplitude * ramp * (phase.sin() - (k as f64).sin());
            v[j] = amplitude * omega * phase.cos() * ramp;
        }
        plant.step(&q, &v, &External::default());
        kinematics.update(&q);
        if t > 0.6 {
            let error = plant.tcp().translation.vector - kinematics.pose(tcp).translation.vector;
            worst = worst.max(error.norm());
        }
    }
    assert!(worst < 2e-3, "{worst}");
}

#[test]
fn an_object_rests_on_its_springs() {
    let model = model();
    let mut world = World::default();
    world.table.tilt_deg = [0.0; 2];
    world.table.bumps.clear();
    world.objects[0].at = [-0.1, 0.8];
    let mut plant = Plant::new(&model, &world, &start(&model)).unwrap();
    hold(&mut plant, 500, &External::default());
    let weight = 0.15 * GRAVITY;
    assert!((plant.reaction(0).unwrap().normal - weight).abs() < 1e-3);
    let z = plant.object(0).unwrap().translation.z;
    assert!((z - (0.95 + 0.02 - weight / 2000.0)).abs() < 1e-5, "{z}");
    assert_eq!(plant.held(), None);
}

/// A hand far above the table with an object between its pads.
fn with_object_between_pads() -> (Arc<Model>, Plant) {
    let model = model();
    let q = start(&model);
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(&q);
    let grasp = kinematics.pose(model.link("grasp_right").unwrap());
    let mut world = free();
    world.objects = vec![ObjectSpec { at: [0.25, 0.6], ..ObjectSpec::default() }];
    let mut plant = Plant::new(&model, &world, &q).unwrap();
    plant.place(0, grasp);
    (model, plant)
}

fn close(plant: &mut Plant, model: &Model, steps: usize, external: &External) {
    let mut q = plant.position().to_vec();
    for finger in ["finger_left_r", "finger_right_r"] {
        q[model.joint(finger).unwrap()] = 0.02;
    }
    let zero = vec![0.0; q.len()];
    for _ in 0..steps {
        plant.step(&q, &zero, external);
    }
}

#[test]
fn closing_takes_and_the_sensor_feels_the_load() {
    let (model, mut plant) = with_object_between_pads();
    let before = {
        let (m, mut p) = (&model, Plant::new(&model, &free(), &start(&model)).unwrap());
        close(&mut p, m, 800, &External::default());
        p.wrist().0
    };
    close(&mut plant, &model, 800, &External::default());
    assert_eq!(plant.held(), Some(0));
    let pose = sensor_pose(&model, &plant);
    let difference = pose.rotation * (plant.wrist().0 - before);
    assert!((difference + Vector3::z() * 0.15 * GRAVITY).norm() < 0.01, "{difference}");
}

#[test]
fn opening_drops_and_a_knock_takes_it_out() {
    let (model, mut plant) = with_object_between_pads();
    close(&mut plant, &model, 500, &External::default());
    let knock = |f: f64| External { hand: Vector3::zeros(), objects: vec![Vector3::z() * -f] };
    close(&mut plant, &model, 100, &knock(50.0));
    assert_eq!(plant.held(), Some(0));
    close(&mut plant, &model, 100, &knock(110.0));
    assert_eq!(plant.held(), None);

    let (model, mut plant) = with_object_between_pads();
    close(&mut plant, &model, 500, &External::default());
    assert_eq!(plant.held(), Some(0));
    hold_open(&mut plant, &model);
    assert_eq!(plant.held(), None);
    assert!(plant.object(0).unwrap().translation.z < plant.tcp().translation.z - 0.15);
}

fn hold_open(plant: &mut Plant, model: &Model) {
    let mut q = plant.position().to_vec();
    for finger in ["finger_left_r", "finger_right_r"] {
        q[model.joint(finger).unwrap()] = 0.06;
    }
    let zero = vec![0.0; q.len()];
    for _ in 0..600 {
        plant.step(&q, &zero, &External::default());
    }
}
