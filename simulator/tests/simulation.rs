//! The whole simulator, from outside: repeatable, in virtual time, safe.
use std::sync::Arc;
use std::time::Duration;

use armarium_robot::LeaseLimits;
use armarium_simulator::world::{CoachingAction, CoachingStep, Gesture, Show, WrenchFault};
use armarium_simulator::{Options, Simulation, TruthDigest, TruthSample, TruthSink, World};
use nalgebra::Vector3;

fn simulation(world: &World, seed: u64) -> (Simulation, TruthDigest) {
    let digest = TruthDigest::default();
    let options = Options { truth_sinks: vec![Box::new(digest.clone())], ..Options::default() };
    (Simulation::new(world, seed, options).unwrap(), digest)
}

/// Three seconds with a moving arm and torso, a demonstration and a hand.
fn busy(seed: u64) -> u64 {
    let mut world = World::default();
    let show = Show {
        gesture: Gesture::PointTwo,
        phase: 0.0,
        offset: [0.1, 0.0, 0.0],
        duration: 1.0,
        direction: None,
    };
    world.coach.coaching = vec![CoachingStep { at: 0.1, action: CoachingAction::Show(show) }];
    let (mut simulation, digest) = simulation(&world, seed);
    let robot = simulation.robot();
    let arm = robot.lease("right_arm", "test", LeaseLimits::default()).unwrap();
    let torso = robot.lease("torso", "test", LeaseLimits::default()).unwrap();
    robot.say("Please show me.");
    robot.say("I am wiping.");
    for i in 0..3000 {
        let v = libm::sin(f64::from(i) * 2e-3) * 0.4;
        arm.command(&[v, -v, v, v, -v, 0.3 * v, 0.3 * v]).unwrap();
        torso.command(&[0.2 * v, 0.1 * v, 0.2 * v]).unwrap();
        simulation.step();
    }
    assert!(simulation.truth().coach.tool.is_some());
    digest.value()
}

#[test]
fn the_same_seed_is_the_same_run() {
    assert_eq!(busy(1), busy(1));
    assert_ne!(busy(1), busy(2));
}

#[derive(Clone, Default)]
struct Speeds(Arc<std::sync::Mutex<Vec<f64>>>);

impl TruthSink for Speeds {
    fn sample(&mut self, sample: &TruthSample) {
        let fastest = sample.velocity.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        self.0.lock().unwrap().push(fastest);
    }
}

/// From full speed in free space, the arm stands 200 ms after its commander has gone or become silent.
#[test]
fn the_arm_stands_when_its_commander_goes() {
    for silent in [false, true] {
        let speeds = Speeds::default();
        let options = Options { truth_sinks: vec![Box::new(speeds.clone())], ..Options::default() };
        let mut simulation = Simulation::new(&World::default(), 1, options).unwrap();
        let robot = simulation.robot();
        let arm = robot.lease("right_arm", "test", LeaseLimits::default()).unwrap();
        for _ in 0..400 {
            arm.command(&[0.0, 1.0, -1.0, 1.0, -1.0, 0.0, 0.0]).unwrap();
            simulation.step();
        }
        let kept = if silent {
            Some(arm)
        } else {
            drop(arm);
            None
        };
        for _ in 0..400 {
            simulation.step();
        }
        let speeds = speeds.0.lock().unwrap();
        assert!(speeds[398] > 0.9, "{}", speeds[398]);
        let rest = speeds[600..].iter().fold(0.0f64, |m, v| m.max(*v));
        assert!(rest < 0.01, "{silent} {rest}");
        drop(kept);
    }
}

/// The compensated wrist force that skills see is the push only, without weight, bias and motion.
#[test]
fn the_compensated_wrist_reads_a_push() {
    let mut world = World::default();
    world.disturbances = vec![armarium_simulator::world::Disturbance {
        knock: "hand".into(),
        force: [0.0, 20.0, 0.0],
        at: 0.5,
        duration: 1.0,
        ..Default::default()
    }];
    let (mut simulation, _) = simulation(&world, 4);
    let robot = simulation.robot();
    for _ in 0..500 {
        simulation.step();
    }
    robot.tare("right_wrist").unwrap();
    robot.say("wiping");
    let sensed = robot.sensed();
    let (mut quiet, mut peak) = (0.0f64, Vector3::zeros());
    for i in 0..1300 {
        simulation.step();
        let force = sensed.borrow().wrenches[0].external.force;
        if (10..400).contains(&i) {
            quiet = quiet.max(force.norm());
        }
        if force.norm() > peak.norm() {
            peak = force;
        }
    }
    assert!(quiet < 1.0, "{quiet}");
    assert!((peak - Vector3::y() * 20.0).norm() < 1.5, "{peak}");
}

#[test]
fn a_frozen_wrench_takes_the_arm_away() {
    let mut world = World::default();
    world.faults.wrench = WrenchFault::Frozen;
    let (mut simulation, _) = simulation(&world, 1);
    let robot = simulation.robot();
    let arm = robot.lease("right_arm", "test", LeaseLimits::default()).unwrap();
    for _ in 0..200 {
        simulation.step();
    }
    assert!(arm.fault().is_some());
}

#[tokio::test(start_paused = true)]
async fn frames_come_at_their_rate_to_those_who_wait() {
    let mut world = World::default();
    (world.camera.stamp_offset, world.camera.stamp_jitter) = (0.0, 0.0);
    let (simulation, _) = simulation(&world, 1);
    let (images, handle) = (simulation.images(), simulation.handle());
    let task = tokio::spawn(simulation.run());
    let first = images.next().await.unwrap();
    let second = images.next().await.unwrap();
    assert_eq!((first.left.width(), first.left.height()), (640, 480));
    let apart = second.stamp_ns - first.stamp_ns;
    assert!((66_000_000..=67_000_000).contains(&apart), "{apart}");
    tokio::time::sleep(Duration::from_millis(500)).await;
    let late = images.next().await.unwrap();
    assert!(late.stamp_ns > second.stamp_ns + 500_000_000);
    handle.stop();
    task.await.unwrap();
    assert!(images.next().await.is_err());
}

/// The conformance suite for robot drivers, with real physics.
#[tokio::test(start_paused = true)]
async fn every_limb_of_every_simulated_robot_conforms() {
    for name in armarium_robot::description::shipped_robots() {
        let mut world = World::default();
        name.clone_into(&mut world.robot.model);
        for limb in world.model().unwrap().limbs().keys() {
            let (simulation, _) = simulation(&world, 5);
            let (robot, handle) = (simulation.robot(), simulation.handle());
            let task = tokio::spawn(simulation.run());
            let checked = armarium_robot::conformance::check(&robot, limb).await;
            checked.unwrap_or_else(|violation| panic!("{name}, {limb}: {violation}"));
            handle.stop();
            task.await.unwrap();
        }
    }
}

/// Against 80 N the arm yields along the force, and then stands.
#[test]
fn the_arm_gives_way_to_a_strong_push() {
    let mut world = World::default();
    world.disturbances = vec![armarium_simulator::world::Disturbance {
        knock: "hand".into(),
        force: [0.0, 80.0, 0.0],
        at: 0.2,
        duration: 1.0,
        ..Default::default()
    }];
    let (mut simulation, _) = simulation(&world, 2);
    let robot = simulation.robot();
    for _ in 0..300 {
        simulation.step();
    }
    robot.tare("right_wrist").unwrap();
    robot.say("wiping");
    let arm = robot.lease("right_arm", "test", LeaseLimits::default()).unwrap();
    let start = simulation.truth().tcp.translation.vector;
    for _ in 0..1800 {
        let _ = arm.command(&[0.0; 7]);
        simulation.step();
    }
    assert!(matches!(arm.fault(), Some(armarium_robot::Fault::Force { .. })), "{:?}", arm.fault());
    let moved = simulation.truth().tcp.translation.vector - start;
    assert!(moved.y > 0.02, "{moved}");
    assert!(simulation.truth().velocity.iter().all(|v| v.abs() < 0.01));
}
