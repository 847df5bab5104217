//! How many steps of a millisecond the simulator makes a second without its cameras: one arm that moves, one that wipes, both in
//! free space, and both with a box between their hands. Each is the fastest of five.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]
#![expect(clippy::print_stdout, reason = "a bench measures time and prints it")]

use std::time::Instant;

use armarium_robot::{Kinematics, Lease, LeaseLimits, Limb};
use armarium_simulator::physics::{External, Plant};
use armarium_simulator::start::{self, MountedPad};
use armarium_simulator::world::{BodySpec, PadSpec, Place};
use armarium_simulator::{Options, Simulation, World};
use nalgebra::{Isometry3, Point3, Vector3};

const STEPS: u32 = 4000;
const RUNS: usize = 5;

/// The most steps per second of several runs.
fn measure(what: &str, mut step: impl FnMut(f64)) {
    let mut best = 0.0f64;
    for run in 0..RUNS {
        let start = Instant::now();
        for i in 0..STEPS {
            step(f64::from(run as u32 * STEPS + i) * 1e-3);
        }
        best = best.max(f64::from(STEPS) / start.elapsed().as_secs_f64());
    }
    println!("{best:>8.0} steps/s  {what}");
}

/// Moves an arm to and fro, about the posture in which it begins.
fn sway((arm, joints): &(Lease, usize), t: f64) {
    let v = libm::cos(2.0 * t) * 0.3;
    let speeds: Vec<f64> = (0..*joints).map(|joint| if joint % 2 == 0 { v } else { -v }).collect();
    let _ = arm.command(&speeds);
}

/// Whole steps, with sensors, guard, coach and referee, in which the first `count` arms move.
fn free(count: usize) {
    let mut simulation =
        Simulation::new(&World::default(), 1, Options::default()).expect("the default world is sound");
    let robot = simulation.robot();
    let lease =
        |arm: &Limb| robot.lease(&arm.name, "bench", LeaseLimits::default()).expect("the arm is free");
    let leases: Vec<_> = robot.model().arms().take(count).map(|arm| (lease(arm), arm.joints.len())).collect();
    let what = if count == 1 { "one arm moves" } else { "both arms move" };
    measure(&format!("whole steps, {what}"), |t| {
        leases.iter().for_each(|arm| sway(arm, t));
        simulation.step();
    });
}

/// The physics alone: the hand presses the sponge that it holds on the table.
fn wiping() {
    let mut world = World::ideal();
    let robots = start::robots(&world, 1, None).expect("the default robot is sound");
    let model = robots[0].model.clone();
    let arm = model.arm(&robots[0].arm).expect("the arm that works");
    let hand = model.hand_of(arm).expect("it has a hand");
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(&robots[0].position);
    let tcp = kinematics.pose(arm.tcp.expect("it has a TCP"));
    let held = tcp * hand.grasp_in_tcp;
    world.table.height = held.translation.z - 0.018;
    world.table.center = [held.translation.x, held.translation.y];
    world.objects[0].at = world.table.center;
    let mut target = robots[0].position.clone();
    let mut plant = Plant::new(&world, robots).expect("the default world is sound");
    plant.place(0, &Isometry3::from_parts(held.translation, plant.object(0).unwrap_or(held).rotation));
    let still = vec![0.0; target.len()];
    let joints = arm.joints.clone();
    let start = target.clone();
    measure("physics, one arm rubs on the table", |t| {
        for (k, &joint) in joints.iter().enumerate() {
            target[joint] = start[joint] + 0.01 * libm::sin(3.0 * t + k as f64);
        }
        plant.step(&[(&target, &still)], &External::default());
    });
}

/// The physics alone: both hands hold a box between soft pads.
fn carrying() {
    let mut world = World::ideal();
    let mut robots = start::robots(&world, 1, None).expect("the default robot is sound");
    let model = robots[0].model.clone();
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(&robots[0].position);
    let arms: Vec<_> = model.arms().take(2).collect();
    let tcps = [0, 1].map(|side: usize| *kinematics.pose(arms[side].tcp.expect("it has a TCP")));
    let middle =
        nalgebra::center(&Point3::from(tcps[0].translation.vector), &tcps[1].translation.vector.into());
    let apart = (tcps[0].translation.vector - tcps[1].translation.vector).norm();
    // The pads press one centimetre into the sides of a box between the hands.
    let mounted = |side: usize| {
        let inner =
            tcps[side].rotation.inverse() * (middle.coords - tcps[side].translation.vector).normalize();
        let along = inner.cross(&Vector3::x()).normalize();
        MountedPad {
            spec: PadSpec::default(),
            middle: Point3::from(inner * 0.03),
            edges: [along, inner.cross(&along)],
            normal: inner,
        }
    };
    let size = [(apart - 0.04).clamp(0.05, 1.0), 0.3, 0.24];
    world.table.height = middle.z - size[2] / 2.0;
    world.objects.clear();
    let at = Place::At(middle.into());
    world.bodies = vec![BodySpec { name: "box".into(), size, mass: 1.5, at, ..BodySpec::default() }];
    robots[0].pads = vec![mounted(0), mounted(1)];
    let start = robots[0].position.clone();
    let mut target = start.clone();
    let joints: Vec<usize> = arms.iter().flat_map(|arm| arm.joints.iter().copied()).collect();
    let mut plant = Plant::new(&world, robots).expect("the default robot is sound");
    let still = vec![0.0; target.len()];
    measure("physics, both arms and a box between them", |t| {
        for (k, &joint) in joints.iter().enumerate() {
            target[joint] = start[joint] + 0.002 * libm::sin(3.0 * t + k as f64);
        }
        plant.step(&[(&target, &still)], &External::default());
    });
    assert!(plant.pads(0).all(|pad| pad.normal > 0.0), "both hands hold the box");
}

fn main() {
    free(1);
    free(2);
    wiping();
    carrying();
}
