//! Tests of the physics against closed forms that the whole plant must reproduce.

use std::sync::Arc;

use armarium_robot::{ForceTorque, Kinematics, Model};
use nalgebra::{Isometry3, Vector3};

use super::{DT, External, Plant};
use crate::world::GRAVITY;
use crate::world::{ObjectSpec, TableSpec, World};

fn model() -> Arc<Model> {
    Model::shipped("armar3").unwrap()
}

/// A world whose table is far below the hand.
fn free() -> World {
    World { table: TableSpec { height: 0.4, ..TableSpec::default() }, objects: vec![], ..World::ideal() }
}

/// The plant of a world whose only robot begins in a posture.
fn plant_of(model: &Arc<Model>, world: &World, posture: &[f64]) -> Plant {
    let robots = crate::start::robots(world, 1, Some(posture.to_vec())).unwrap();
    assert_eq!(robots[0].model.name(), model.name());
    Plant::new(world, robots).unwrap()
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
    let q = plant.position(0).to_vec();
    let zero = vec![0.0; q.len()];
    for _ in 0..steps {
        plant.step(&[(&q, &zero)], external);
    }
}

fn hand_mass(model: &Model) -> f64 {
    let sensor = model.link("wrist_sensor_right").unwrap();
    model.subtree(sensor).filter_map(|l| model.links()[l.index()].inertial).map(|i| i.mass).sum()
}

fn sensor_pose(model: &Arc<Model>, plant: &Plant) -> Isometry3<f64> {
    let mut kinematics = Kinematics::new(model);
    kinematics.update(plant.position(0));
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
    let mut plant = plant_of(&model, &free(), &q);
    let mut kinematics = Kinematics::new(&model);
    hold(&mut plant, 50, &External::default());
    kinematics.update(plant.position(0));
    let expected = kinematics.pose(model.link("tcp_right").unwrap());
    assert!((plant.tcp(0).translation.vector - expected.translation.vector).norm() < 1e-9);
    assert!(plant.tcp(0).rotation.angle_to(&expected.rotation) < 1e-9);
    for (a, b) in plant.position(0).iter().zip(&q) {
        assert!((a - b).abs() < 1e-9);
    }
}

#[test]
fn a_hanging_hand_reads_its_weight() {
    let model = model();
    let q = start(&model);
    let mut plant = plant_of(&model, &free(), &q);
    hold(&mut plant, 100, &External::default());
    let ForceTorque { force, torque } = plant.wrench(0);
    let pose = sensor_pose(&model, &plant);
    let weight = hand_mass(&model) * GRAVITY;
    assert!((pose.rotation * force + Vector3::z() * weight).norm() < 1e-6, "{force}");
    // The torque is the weight times the lever arm of the hand's centre of mass.
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(plant.position(0));
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
fn a_hand_may_be_heavier_or_lighter_than_its_model_says() {
    let model = model();
    let mut world = free();
    world.physics.0.hand_mass_error = 0.05;
    let mut plant = plant_of(&model, &world, &start(&model));
    hold(&mut plant, 100, &External::default());
    let share = plant.wrench(0).force.norm() / (hand_mass(&model) * GRAVITY);
    assert!(((share - 1.0).abs() - 0.05).abs() < 1e-6, "{share}");
}

#[test]
fn a_push_reads_its_force_and_its_torque() {
    let model = model();
    let q = start(&model);
    let mut plant = plant_of(&model, &free(), &q);
    hold(&mut plant, 300, &External::default());
    let ForceTorque { force: force_before, torque: torque_before } = plant.wrench(0);
    let push = Vector3::new(6.0, 0.0, 8.0);
    hold(&mut plant, 500, &External { hand: push, ..External::default() });
    let ForceTorque { force, torque } = plant.wrench(0);
    let pose = sensor_pose(&model, &plant);
    assert!((pose.rotation * (force - force_before) - push).norm() < 0.01, "{force}");
    let arm = plant.tcp(0).translation.vector - pose.translation.vector;
    let expected = arm.cross(&push);
    assert!((pose.rotation * (torque - torque_before) - expected).norm() < 0.01);
}

#[test]
fn a_shove_at_the_forearm_moves_the_hand_and_is_not_felt_as_a_force_on_it() {
    let model = model();
    let mut plant = plant_of(&model, &free(), &start(&model));
    hold(&mut plant, 300, &External::default());
    let (before, at) = (plant.wrench(0).force, plant.tcp(0).translation.vector);
    let q = plant.position(0).to_vec();
    let external = External { arm: Vector3::x() * 40.0, ..External::default() };
    (0..500).for_each(|_| plant.step(&[(&q, &vec![0.0; q.len()])], &external));
    assert!((plant.wrench(0).force - before).norm() < 0.5, "{}", plant.wrench(0).force - before);
    assert!((plant.tcp(0).translation.vector - at).norm() > 1e-4);
}

#[test]
fn servos_track_a_moving_set_point() {
    let model = model();
    let q0 = start(&model);
    let mut plant = plant_of(&model, &free(), &q0);
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
            q[j] = q0[j] + amplitude * ramp * (libm::sin(phase) - libm::sin(k as f64));
            v[j] = amplitude * omega * libm::cos(phase) * ramp;
        }
        plant.step(&[(&q, &v)], &External::default());
        kinematics.update(&q);
        if t > 0.6 {
            let error = plant.tcp(0).translation.vector - kinematics.pose(tcp).translation.vector;
            worst = worst.max(error.norm());
        }
    }
    assert!(worst < 2e-3, "{worst}");
}

#[test]
fn an_object_rests_on_its_springs() {
    let model = model();
    let mut world = World::ideal();
    world.table.tilt_deg = [0.0; 2];
    world.table.bumps.clear();
    world.objects[0].at = [-0.1, 0.8];
    let mut plant = plant_of(&model, &world, &start(&model));
    hold(&mut plant, 500, &External::default());
    let weight = 0.15 * GRAVITY;
    assert!((plant.contact(0).normal - weight).abs() < 1e-3);
    let z = plant.object(0).unwrap().translation.z;
    assert!((z - (0.95 + 0.02 - weight / 2000.0)).abs() < 1e-5, "{z}");
    assert_eq!(plant.held(0), None);
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
    let mut plant = plant_of(&model, &world, &q);
    plant.place(0, grasp);
    (model, plant)
}

fn close(plant: &mut Plant, model: &Model, steps: usize, external: &External) {
    let mut q = plant.position(0).to_vec();
    for finger in ["finger_left_r", "finger_right_r"] {
        q[model.joint(finger).unwrap()] = 0.02;
    }
    let zero = vec![0.0; q.len()];
    for _ in 0..steps {
        plant.step(&[(&q, &zero)], external);
    }
}

#[test]
fn closing_takes_and_the_sensor_feels_the_load() {
    let (model, mut plant) = with_object_between_pads();
    let before = {
        let (m, mut p) = (&model, plant_of(&model, &free(), &start(&model)));
        close(&mut p, m, 800, &External::default());
        p.wrench(0).force
    };
    close(&mut plant, &model, 800, &External::default());
    assert_eq!(plant.held(0), Some(0));
    let pose = sensor_pose(&model, &plant);
    let difference = pose.rotation * (plant.wrench(0).force - before);
    assert!((difference + Vector3::z() * 0.15 * GRAVITY).norm() < 0.01, "{difference}");
}

/// Why a joint holds what the pads press on, and not their contacts alone.
#[test]
fn by_contacts_alone_an_object_creeps_out_of_the_hand() {
    let creep = |joins: bool| {
        let (model, mut plant) = with_object_between_pads();
        plant.joins = joins;
        let in_hand = |plant: &Plant| plant.tcp(0).inverse() * plant.object(0).unwrap();
        close(&mut plant, &model, 1000, &External::default());
        let before = in_hand(&plant);
        close(&mut plant, &model, 10_000, &External::default());
        let after = in_hand(&plant);
        let turned = before.rotation.angle_to(&after.rotation).to_degrees();
        ((after.translation.vector - before.translation.vector).norm(), turned)
    };
    let (joined, contacts) = (creep(true), creep(false));
    assert!(joined.0 < 1e-5 && joined.1 < 0.01, "{joined:?}");
    assert!(contacts.1 > 1.0, "{contacts:?}");
}

#[test]
fn opening_drops_and_a_knock_takes_it_out() {
    let (model, mut plant) = with_object_between_pads();
    close(&mut plant, &model, 500, &External::default());
    let knock = |f: f64| External { objects: vec![Vector3::z() * -f], ..External::default() };
    close(&mut plant, &model, 100, &knock(50.0));
    assert_eq!(plant.held(0), Some(0));
    close(&mut plant, &model, 100, &knock(110.0));
    assert_eq!(plant.held(0), None);

    let (model, mut plant) = with_object_between_pads();
    close(&mut plant, &model, 500, &External::default());
    assert_eq!(plant.held(0), Some(0));
    hold_open(&mut plant, &model);
    assert_eq!(plant.held(0), None);
    assert!(plant.object(0).unwrap().translation.z < plant.tcp(0).translation.z - 0.15);
}

fn hold_open(plant: &mut Plant, model: &Model) {
    let mut q = plant.position(0).to_vec();
    for finger in ["finger_left_r", "finger_right_r"] {
        q[model.joint(finger).unwrap()] = 0.06;
    }
    let zero = vec![0.0; q.len()];
    for _ in 0..600 {
        plant.step(&[(&q, &zero)], &External::default());
    }
}

/// Steps with set points that move some joints at a speed from where they are; returns the largest change of what the
/// sensors feel from step to step, N.
fn drive(plant: &mut Plant, joints: &[(usize, f64)], steps: usize, targets: &mut [f64]) -> f64 {
    let mut jump = 0.0_f64;
    let mut before: Vec<_> = plant.wrenches(0).map(|wrench| wrench.force).collect();
    let mut velocity = vec![0.0; targets.len()];
    for &(joint, speed) in joints {
        velocity[joint] = speed;
    }
    for _ in 0..steps {
        joints.iter().for_each(|&(joint, speed)| targets[joint] += speed * DT);
        plant.step(&[(targets, &velocity)], &External::default());
        for (now, before) in plant.wrenches(0).zip(&mut before) {
            jump = jump.max((now.force - *before).norm());
            *before = now.force;
        }
    }
    jump
}

#[test]
fn arms_that_nobody_moves_sleep_and_wake_when_they_are_commanded() {
    let model = model();
    let mut targets = start(&model);
    let mut plant = plant_of(&model, &free(), &targets);
    let [torso, elbow] = ["hip_yaw", "elbow_l"].map(|joint| model.joint(joint).unwrap());
    drive(&mut plant, &[], 10, &mut targets);
    assert_eq!(plant.awake(), 0);
    // The torso carries sleeping arms, and their weight is felt.
    drive(&mut plant, &[(torso, 0.2)], 500, &mut targets);
    assert_eq!(plant.awake(), 0);
    let still: Vec<_> = plant.wrenches(0).map(|wrench| wrench.force.norm()).collect();
    assert!(still.iter().all(|force| (force - hand_mass(&model) * GRAVITY).abs() < 1.0), "{still:?}");
    // One wakes while the torso turns: nothing jumps.
    let before = plant.position(0).to_vec();
    let jump = drive(&mut plant, &[(torso, 0.2)], 1, &mut targets);
    drive(&mut plant, &[(torso, 0.2), (elbow, -0.001)], 1, &mut targets);
    assert_eq!(plant.awake(), 1);
    let moved: Vec<f64> = plant.position(0).iter().zip(&before).map(|(a, b)| (a - b).abs()).collect();
    let most = |skip: usize| {
        (0..moved.len()).filter(|joint| *joint != skip).map(|joint| moved[joint]).fold(0.0, f64::max)
    };
    assert!(most(torso) < 1e-5, "{moved:?}");
    assert!((plant.velocity(0)[torso] - 0.2).abs() < 0.01, "{}", plant.velocity(0)[torso]);
    let waking = drive(&mut plant, &[(torso, 0.2), (elbow, -0.001)], 5, &mut targets);
    assert!(waking < jump + 0.5, "{waking} after {jump}");
    drive(&mut plant, &[(elbow, -0.5)], 500, &mut targets);
    assert!((plant.position(0)[elbow] + 0.25).abs() < 0.01, "{}", plant.position(0)[elbow]);
    drive(&mut plant, &[], 290, &mut targets);
    assert_eq!(plant.awake(), 1);
    let quiet = drive(&mut plant, &[], 200, &mut targets);
    assert_eq!(plant.awake(), 0);
    assert!(quiet < 0.01, "falling asleep is felt: {quiet}");
    assert_eq!(plant.velocity(0)[elbow], 0.0);
}

#[test]
fn a_sleeping_arm_wakes_when_it_is_touched() {
    let model = model();
    let mut targets = start(&model);
    let mut world = free();
    world.objects = vec![ObjectSpec { at: [0.25, 0.6], ..ObjectSpec::default() }];
    let mut plant = plant_of(&model, &world, &targets);
    drive(&mut plant, &[], 10, &mut targets);
    assert_eq!(plant.awake(), 0);
    // Something falls on the left hand.
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(plant.position(0));
    let hand = kinematics.pose(model.link("hand_left").unwrap()).translation.vector;
    plant.place(0, &Isometry3::translation(hand.x, hand.y + 0.02, hand.z + 0.25));
    let mut woke = false;
    for _ in 0..400 {
        drive(&mut plant, &[], 1, &mut targets);
        woke |= plant.awake() == 1;
    }
    assert!(woke);
}

#[test]
fn what_one_hand_holds_stays_in_it_while_the_other_arm_wakes() {
    let (model, mut plant) = with_object_between_pads();
    close(&mut plant, &model, 800, &External::default());
    let in_hand = |plant: &Plant| plant.tcp(0).inverse() * plant.object(0).unwrap();
    let before = in_hand(&plant);
    let mut targets = plant.position(0).to_vec();
    for finger in ["finger_left_r", "finger_right_r"] {
        targets[model.joint(finger).unwrap()] = 0.02;
    }
    let elbow = model.joint("elbow_l").unwrap();
    let awake = plant.awake();
    let jump = drive(&mut plant, &[(elbow, -0.001)], 100, &mut targets);
    assert_eq!((awake, plant.awake(), plant.held(0)), (0, 2, Some(0)));
    let slipped = (in_hand(&plant).translation.vector - before.translation.vector).norm();
    assert!(slipped < 1e-5 && jump < 2.0, "{slipped} m, {jump} N");
}

#[test]
fn either_hand_takes_things_and_each_sensor_feels_its_own() {
    let model = model();
    let mut q = start(&model);
    q[model.joint("elbow_l").unwrap()] = -0.4;
    for finger in ["finger_left_l", "finger_right_l"] {
        q[model.joint(finger).unwrap()] = 0.05;
    }
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(&q);
    let grasp = *kinematics.pose(model.link("grasp_left").unwrap());
    let mut world = free();
    world.robot.arm = Some("left_arm".into());
    world.objects = vec![ObjectSpec { at: [0.25, 0.6], ..ObjectSpec::default() }];
    let mut plant = plant_of(&model, &world, &q);
    plant.place(0, &grasp);
    let mut targets = q.clone();
    for finger in ["finger_left_l", "finger_right_l"] {
        targets[model.joint(finger).unwrap()] = 0.02;
    }
    drive(&mut plant, &[], 900, &mut targets);
    assert_eq!(plant.held(0), Some(0));
    let sensed: Vec<_> = plant.wrenches(0).map(|wrench| wrench.force.norm()).collect();
    let sensor = |name: &str| model.wrenches().iter().position(|sensor| sensor.name == name).unwrap();
    let load = sensed[sensor("left_wrist")] - sensed[sensor("right_wrist")];
    assert!((load - 0.15 * GRAVITY).abs() < 0.02, "{sensed:?}");
}

#[test]
fn the_head_has_dynamics_of_its_own() {
    let model = model();
    let mut targets = start(&model);
    let mut plant = plant_of(&model, &free(), &targets);
    let yaw = model.joint("neck_yaw").unwrap();
    drive(&mut plant, &[], 10, &mut targets);
    // A set point that jumps is reached within some time constants of the servo, and not at once.
    targets[yaw] += 0.05;
    drive(&mut plant, &[], 1, &mut targets);
    assert!(plant.position(0)[yaw] < 0.03, "{}", plant.position(0)[yaw]);
    drive(&mut plant, &[], 150, &mut targets);
    assert!((plant.position(0)[yaw] - 0.05).abs() < 1e-3, "{}", plant.position(0)[yaw]);
    assert_eq!(plant.awake(), 0);
}

#[test]
fn an_arm_sleeps_with_what_it_holds_and_wakes_when_that_is_knocked() {
    let (model, mut plant) = with_object_between_pads();
    close(&mut plant, &model, 2000, &External::default());
    assert_eq!((plant.held(0), plant.awake()), (Some(0), 0));
    let weight = hand_mass(&model) * GRAVITY + 0.15 * GRAVITY;
    assert!((plant.wrench(0).force.norm() - weight).abs() < 0.02, "{}", plant.wrench(0).force);
    let in_hand = |plant: &Plant| plant.tcp(0).inverse() * plant.object(0).unwrap();
    let before = in_hand(&plant);
    let knock = |f: f64| External { objects: vec![Vector3::z() * -f], ..External::default() };
    close(&mut plant, &model, 100, &knock(20.0));
    assert_eq!((plant.held(0), plant.awake()), (Some(0), 1));
    assert!((plant.wrench(0).force.norm() - weight - 20.0).abs() < 0.5, "{}", plant.wrench(0).force);
    close(&mut plant, &model, 1000, &External::default());
    assert_eq!((plant.held(0), plant.awake()), (Some(0), 0));
    assert!((in_hand(&plant).translation.vector - before.translation.vector).norm() < 1e-5);
    // It opens as ever.
    hold_open(&mut plant, &model);
    assert_eq!(plant.held(0), None);
}
