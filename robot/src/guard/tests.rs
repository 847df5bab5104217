//! The guard with servo joints, stepped without a clock: limits, faults, forces.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::bodies::{Bodies, least_distance};
use crate::planning::KnownBox;
use crate::{
    Fault, Guard, GuardConfig, GuardedRobot, Kinematics, Lease, LeaseError, LeaseLimits, Load, LoadShape,
    Model, Robot, ServoJoints, Wrench, load_mass,
};

const RIGHT: &str = "right_wrist";
const LEFT: &str = "left_wrist";

struct Rig {
    model: Arc<Model>,
    guard: Guard,
    robot: Arc<GuardedRobot>,
    joints: ServoJoints,
    now_ms: u64,
    frozen: bool,
}

impl Rig {
    fn new() -> Self {
        let model = Model::shipped("armar3").unwrap();
        let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::default());
        let joints = ServoJoints::new(&model, model.ready("right_arm"), 1);
        let mut rig = Self { model, guard, robot, joints, now_ms: 0, frozen: false };
        rig.run(150, |_| Vector3::zeros());
        rig.robot.tare("right_wrist").unwrap();
        rig.robot.tare("left_wrist").unwrap();
        rig.run(50, |_| Vector3::zeros());
        rig
    }

    fn lease(&self, limb: &str) -> Lease {
        self.robot.lease(limb, "test", LeaseLimits::default()).unwrap()
    }

    /// Steps `ms` times; `push` returns the force at the right TCP.
    fn run(&mut self, ms: u64, mut push: impl FnMut(Point3<f64>) -> Vector3<f64>) {
        let tcp = self.model.link("tcp_right").unwrap();
        for _ in 0..ms {
            let at = Point3::from(self.joints.kinematics().pose(tcp).translation.vector);
            self.step(&[(RIGHT, push(at))]);
        }
    }

    /// Steps once, with forces at the TCPs of sensors.
    fn step(&mut self, pushes: &[(&str, Vector3<f64>)]) {
        self.now_ms += 1;
        let targets = self.guard.step(self.now_ms * 1_000_000, self.joints.sample()).clone();
        let before = self.joints.clone();
        let push = |name: &str| pushes.iter().find(|(sensor, _)| *sensor == name).map(|(_, push)| *push);
        let of = |sensor: &crate::WrenchSensor| push(&sensor.name).unwrap_or_default();
        let pushes: Vec<_> = self.model.wrenches().iter().map(of).collect();
        self.joints.step(&targets, &pushes, 1e-3);
        if self.frozen {
            // The joints continue; the wrench is repeated.
            self.joints.repeat_wrench(self.sensor(RIGHT), &before);
        }
    }

    fn sensor(&self, name: &str) -> usize {
        self.model.wrenches().iter().position(|sensor| sensor.name == name).unwrap()
    }

    fn felt(&self, name: &str) -> Wrench {
        self.robot.sensed().borrow().wrenches[self.sensor(name)].external
    }

    fn command(&mut self, lease: &Lease, velocities: &[f64], ms: u64) {
        for _ in 0..ms {
            lease.command(velocities).unwrap();
            self.run(1, |_| Vector3::zeros());
        }
    }

    fn fastest(&self) -> f64 {
        self.joints.sample().velocity.iter().fold(0.0, |most, v| most.max(v.abs()))
    }

    fn wrist(&self) -> Wrench {
        self.felt(RIGHT)
    }

    fn limit_and(&self, joint: &str) -> (usize, f64, f64) {
        let j = self.model.joint(joint).unwrap();
        (j, self.model.joints()[j].lower, self.model.joints()[j].upper)
    }
}

#[test]
fn every_joint_brakes_from_full_speed_within_200_ms() {
    for limb in ["right_arm", "left_arm", "torso", "head", "right_hand", "left_hand"] {
        let mut rig = Rig::new();
        let lease = rig.lease(limb);
        let speeds: Vec<f64> = rig
            .model
            .limb(limb)
            .iter()
            .map(|&j| rig.model.joints()[j].velocity.copysign(0.5 - rig.joints.sample().position[j]))
            .collect();
        rig.command(&lease, &speeds, 250);
        assert!(rig.fastest() > 0.1 || limb.ends_with("hand"), "{limb} moves at {}", rig.fastest());
        drop(lease);
        rig.run(200, |_| Vector3::zeros());
        assert!(rig.fastest() < 0.01, "{limb} still moves at {}", rig.fastest());
    }
}

#[test]
fn accelerations_and_speeds_stay_within_the_limits() {
    let mut rig = Rig::new();
    let lease = rig.lease("right_arm");
    let mut before = rig.guard.targets().velocity.clone();
    for k in 0..400_u32 {
        let sign = if (k / 60) % 2 == 0 { 1.0 } else { -1.0 };
        lease.command(&[9.0 * sign, -5.0, 3.0, 9.0 * sign, 0.1, 9.0, -9.0]).unwrap();
        rig.run(1, |_| Vector3::zeros());
        let now = rig.guard.targets().velocity.clone();
        for (j, joint) in rig.model.joints().iter().enumerate() {
            assert!(now[j].abs() <= joint.velocity + 1e-9, "{} at {}", joint.name, now[j]);
            assert!((now[j] - before[j]).abs() <= joint.acceleration * 1e-3 * 2.0 + 1e-9, "{}", joint.name);
        }
        before = now;
    }
}

/// Speed of a TCP that the guard's targets command, m/s.
fn target_speed(rig: &Rig, tcp: &str) -> f64 {
    let tcp = rig.model.link(tcp).unwrap();
    rig.joints.kinematics().twist(tcp, &Point3::origin(), &rig.guard.targets().velocity).linear.norm()
}

#[test]
fn arm_and_torso_of_one_holder_are_scaled_together() {
    let mut rig = Rig::new();
    let limits = LeaseLimits { speed_m_s: Some(0.1), ..LeaseLimits::default() };
    let torso = rig.robot.lease("torso", "test", limits).unwrap();
    let arm = rig.robot.lease("right_arm", "test", limits).unwrap();
    // Each joint moves away from its nearer limit, so that none has to stop.
    let away = |limb: &str| -> Vec<f64> {
        let speed = |(i, &j): (usize, &usize)| {
            let (joint, q) = (&rig.model.joints()[j], rig.joints.sample().position[j]);
            (0.3 + 0.05 * i as f64).copysign(joint.upper + joint.lower - 2.0 * q)
        };
        rig.model.limb(limb).iter().enumerate().map(speed).collect()
    };
    let commands = ["torso", "right_arm"].map(away);
    for k in 0..150 {
        torso.command(&commands[0]).unwrap();
        arm.command(&commands[1]).unwrap();
        rig.run(1, |_| Vector3::zeros());
        let speed = target_speed(&rig, "tcp_right");
        // The targets are one step ahead of the joint positions for which the bound was computed.
        assert!(speed < 0.1 * 1.03, "{speed} m/s after {k} ms");
    }
    let speed = target_speed(&rig, "tcp_right");
    assert!(speed > 0.095, "{speed}");
    let joints = ["torso", "right_arm"].map(|limb| rig.model.limb(limb).to_vec()).concat();
    let velocity = &rig.guard.targets().velocity;
    let factors: Vec<f64> =
        joints.iter().zip(commands.concat()).map(|(&j, command)| velocity[j] / command).collect();
    assert!(factors.iter().all(|f| (f / factors[0] - 1.0).abs() < 0.02), "{factors:?}");
}

#[test]
fn the_torso_alone_is_bounded_by_the_hand_that_it_carries() {
    let mut rig = Rig::new();
    let limits = LeaseLimits { speed_m_s: Some(0.1), ..LeaseLimits::default() };
    let torso = rig.robot.lease("torso", "test", limits).unwrap();
    rig.command(&torso, &[0.0, 0.0, 0.9], 300);
    let speed = target_speed(&rig, "tcp_right");
    assert!(speed > 0.05 && speed < 0.1 * 1.03, "{speed}");
}

#[test]
fn an_arm_of_another_holder_is_not_slowed() {
    let mut rig = Rig::new();
    let limits = LeaseLimits { speed_m_s: Some(0.02), ..LeaseLimits::default() };
    let right = rig.robot.lease("right_arm", "one", limits).unwrap();
    let left = rig.robot.lease("left_arm", "other", LeaseLimits::default()).unwrap();
    for _ in 0..200 {
        right.command(&[0.3; 7]).unwrap();
        left.command(&[0.05; 7]).unwrap();
        rig.run(1, |_| Vector3::zeros());
    }
    assert!(target_speed(&rig, "tcp_right") < 0.02 * 1.03);
    let velocity = &rig.guard.targets().velocity;
    assert!(rig.model.limb("left_arm").iter().all(|&j| (velocity[j] - 0.05).abs() < 1e-9));
}

#[test]
fn a_joint_stops_softly_before_its_limit() {
    let mut rig = Rig::new();
    let lease = rig.lease("right_arm");
    let (joint, _, upper) = rig.limit_and("elbow_r");
    let place = rig.model.limb("right_arm").iter().position(|&j| j == joint).unwrap();
    let mut command = vec![0.0; 7];
    command[place] = 1.0;
    rig.command(&lease, &command, 4000);
    let q = rig.joints.sample().position[joint];
    assert!(q < upper && q > upper - 0.02, "{q} of {upper}");
    assert!(rig.fastest() < 1e-3);
}

#[test]
fn the_watchdog_acts_after_30_ms_and_only_on_what_moves() {
    let mut rig = Rig::new();
    let lease = rig.lease("right_arm");
    rig.command(&lease, &[0.2; 7], 100);
    rig.run(30, |_| Vector3::zeros());
    assert_eq!(lease.fault(), None);
    rig.run(2, |_| Vector3::zeros());
    assert_eq!(lease.fault(), Some(Fault::Watchdog { silent_ms: 31 }));
    rig.run(200, |_| Vector3::zeros());
    assert!(rig.fastest() < 0.01);
    drop(lease);
    let lease = rig.lease("right_arm");
    rig.command(&lease, &[0.0; 7], 1);
    rig.run(500, |_| Vector3::zeros());
    assert_eq!(lease.fault(), None);
}

#[test]
fn the_wrist_reads_a_push_and_no_motion_of_its_own() {
    let mut rig = Rig::new();
    assert!(rig.wrist().force.norm() < 0.02, "{:?}", rig.wrist());
    let push = Vector3::new(3.0, -4.0, 5.0);
    rig.run(100, |_| push);
    let wrist = rig.wrist();
    assert!((wrist.force - push).norm() < 0.02 && wrist.torque.norm() < 0.02, "{wrist:?}");
    rig.run(100, |_| Vector3::zeros());
    let lease = rig.lease("right_arm");
    let mut most = 0.0_f64;
    for k in 0..600_u32 {
        let speed = if (k / 100) % 2 == 0 { 1.0 } else { -1.0 };
        lease.command(&[speed, 0.5 * speed, -speed, speed, 0.0, 0.0, 0.0]).unwrap();
        rig.run(1, |_| Vector3::zeros());
        most = most.max(rig.wrist().force.norm());
    }
    // The hand of 1 kg accelerates at up to 8 m/s².
    assert!(most < 0.5, "its own motion reads as {most} N");
}

#[test]
fn what_the_hand_lifts_is_weighed_and_compensated() {
    let mut rig = Rig::new();
    let before = rig.wrist();
    let weight = Vector3::new(0.0, 0.0, -0.15 * 9.81);
    rig.run(100, |_| weight);
    assert!((load_mass(&before, &rig.wrist()) - 0.15).abs() < 0.002);
    let load = Load { name: "sponge".into(), mass_kg: 0.15, center_in_tcp: Point3::origin(), shape: None };
    rig.robot.set_load("right_hand", Some(load)).unwrap();
    rig.run(100, |_| weight);
    assert!(rig.wrist().force.norm() < 0.02, "{:?}", rig.wrist());
}

#[test]
fn the_raw_wrist_of_a_hanging_hand_reads_its_weight_downwards() {
    let rig = Rig::new();
    let sensor = rig.model.link("wrist_sensor_right").unwrap();
    let force = rig.joints.kinematics().pose(sensor) * rig.joints.sample().wrenches[rig.sensor(RIGHT)].force;
    assert!((force - Vector3::new(0.0, 0.0, -9.81)).norm() < 0.01, "{force:?}");
}

#[test]
fn a_strong_push_is_given_way_to_until_it_is_under_the_limit() {
    let mut rig = Rig::new();
    let arm = rig.lease("right_arm");
    let hand = rig.lease("right_hand");
    // A person of 500 N/m, whose hand is 0.16 m behind the robot's: 80 N.
    let tcp = rig.model.link("tcp_right").unwrap();
    let start = rig.joints.kinematics().pose(tcp).translation.vector;
    let spring = move |at: Point3<f64>| Vector3::new(500.0 * (start.x - 0.16 - at.x).min(0.0), 0.0, 0.0);
    rig.run(2000, spring);
    let Some(Fault::Force { force_n, limit_n, .. }) = arm.fault() else { panic!("{:?}", arm.fault()) };
    assert!(limit_n == 40.0 && force_n > 60.0 && force_n < 90.0, "{force_n}");
    assert_eq!(hand.fault(), None);
    let force = rig.wrist().force.norm();
    assert!(force < 40.0 && force > 10.0, "{force} N remain");
    assert!(rig.fastest() < 0.01, "it stands, at {}", rig.fastest());
    let end = rig.joints.kinematics().pose(tcp).translation.vector;
    assert!((end - start).x < -0.08 && (end - start).yz().norm() < 0.02, "{:?}", end - start);
}

#[test]
fn pressing_on_a_stiff_table_ends_under_the_limit_of_the_lease() {
    for stiffness in [2000.0, 10_000.0] {
        let mut rig = Rig::new();
        let limits = LeaseLimits { force_n: Some(20.0), ..LeaseLimits::default() };
        let lease = rig.robot.lease("right_arm", "test", limits).unwrap();
        let tcp = rig.model.link("tcp_right").unwrap();
        let table = rig.joints.kinematics().pose(tcp).translation.z - 0.03;
        let spring = move |at: Point3<f64>| Vector3::new(0.0, 0.0, stiffness * (table - at.z).max(0.0));
        let mut ik = crate::DifferentialIk::new(
            &rig.model,
            tcp,
            rig.model.limb("right_arm"),
            crate::IkConfig::default(),
        );
        let down = crate::Twist { linear: Vector3::new(0.0, 0.0, -0.1), angular: Vector3::zeros() };
        for _ in 0..2000 {
            let q = rig.joints.sample().position.clone();
            let _ = lease.command(ik.step(&q, &down, None).velocities);
            rig.run(1, spring);
        }
        assert!(matches!(lease.fault(), Some(Fault::Force { limit_n: 20.0, .. })), "{:?}", lease.fault());
        let force = rig.wrist().force.norm();
        assert!(force < 20.0, "{force} N remain at {stiffness} N/m");
        assert!(rig.fastest() < 0.01, "it stands at {stiffness} N/m, at {}", rig.fastest());
    }
}

#[test]
fn a_frozen_wrench_faults_the_arm_but_not_the_head() {
    let mut rig = Rig::new();
    let (arm, head) = (rig.lease("right_arm"), rig.lease("head"));
    rig.frozen = true;
    rig.run(99, |_| Vector3::zeros());
    assert_eq!(arm.fault(), None);
    rig.run(5, |_| Vector3::zeros());
    assert!(matches!(arm.fault(), Some(Fault::FrozenWrench { frozen_ms: 100, .. })), "{:?}", arm.fault());
    assert_eq!(head.fault(), None);
    drop(arm);
    rig.frozen = false;
    rig.run(2, |_| Vector3::zeros());
    let arm = rig.lease("right_arm");
    rig.run(10, |_| Vector3::zeros());
    assert_eq!(arm.fault(), None);
}

#[test]
fn each_arm_has_a_sensor_of_its_own() {
    let mut rig = Rig::new();
    let push = Vector3::new(0.0, 5.0, -3.0);
    (0..100).for_each(|_| rig.step(&[(LEFT, push)]));
    assert!((rig.felt(LEFT).force - push).norm() < 0.02, "{:?}", rig.felt(LEFT));
    assert!(rig.felt(RIGHT).force.norm() < 0.02, "{:?}", rig.felt(RIGHT));
    // A tare and a load concern one of them.
    rig.robot.tare(LEFT).unwrap();
    (0..100).for_each(|_| rig.step(&[(LEFT, push), (RIGHT, push)]));
    assert!(rig.felt(LEFT).force.norm() < 0.02 && (rig.felt(RIGHT).force - push).norm() < 0.02);
    let load = Load { name: "cup".into(), mass_kg: 0.3, center_in_tcp: Point3::origin(), shape: None };
    rig.robot.set_load("left_hand", Some(load.clone())).unwrap();
    rig.run(100, |_| Vector3::zeros());
    let weighed = Vector3::z() * 0.3 * 9.81 - push;
    assert!((rig.felt(LEFT).force - weighed).norm() < 0.02, "{:?}", rig.felt(LEFT));
    assert!(rig.felt(RIGHT).force.norm() < 0.02);
    // So does too strong a force.
    let (right, left) = (rig.lease("right_arm"), rig.lease("left_arm"));
    (0..200).for_each(|_| rig.step(&[(LEFT, Vector3::x() * -60.0)]));
    let said = left.fault().map(|fault| fault.to_string()).unwrap_or_default();
    assert!(said.contains("`left_wrist`") && right.fault().is_none(), "{said}");
    let unknown = rig.robot.tare("nose").unwrap_err().to_string();
    assert_eq!(unknown, "the robot has no wrench sensor `nose`; it has right_wrist, left_wrist");
    assert!(rig.robot.set_load("nose", None).is_err());
    let heavy = Load { mass_kg: f64::NAN, ..load };
    assert!(rig.robot.set_load("left_hand", Some(heavy)).unwrap_err().to_string().contains("not physical"));
}

/// Where a TCP is, and how far it went in 300 ms of a push on the right hand.
fn gone(rig: &mut Rig, push: Vector3<f64>) -> [Vector3<f64>; 2] {
    let tcps = ["tcp_right", "tcp_left"].map(|tcp| rig.model.link(tcp).unwrap());
    let at = |rig: &Rig| tcps.map(|tcp| rig.joints.kinematics().pose(tcp).translation.vector);
    let before = at(rig);
    (0..300).for_each(|_| rig.step(&[(RIGHT, push)]));
    let after = at(rig);
    [after[0] - before[0], after[1] - before[1]]
}

#[test]
fn arms_that_hold_one_load_give_way_and_stop_together() {
    let push = Vector3::new(0.0, 60.0, 0.0);
    let hold = |rig: &Rig, names: [&str; 2]| {
        for (hand, name) in ["right_hand", "left_hand"].into_iter().zip(names) {
            let load = Load { name: name.into(), mass_kg: 0.0, center_in_tcp: Point3::origin(), shape: None };
            rig.robot.set_load(hand, Some(load)).unwrap();
        }
        rig.lease("left_arm")
    };
    let mut rig = Rig::new();
    let left = hold(&rig, ["tray", "cup"]);
    let [right_went, left_went] = gone(&mut rig, push);
    assert!(right_went.y > 0.02 && left_went.norm() < 1e-3, "{right_went} {left_went}");
    assert_eq!(left.fault(), None, "two things");

    let mut rig = Rig::new();
    // Hanging straight down, the left arm could not follow: its elbow is bent first.
    let (elbow, ..) = rig.limit_and("elbow_l");
    let lease = rig.lease("left_arm");
    let place = rig.model.limb("left_arm").iter().position(|&j| j == elbow).unwrap();
    let mut bend = [0.0; 7];
    bend[place] = -0.8;
    rig.command(&lease, &bend, 1000);
    drop(lease);
    rig.run(300, |_| Vector3::zeros());
    let left = hold(&rig, ["tray", "tray"]);
    let right = rig.lease("right_arm");
    let [right_went, left_went] = gone(&mut rig, push);
    assert!(right_went.y > 0.02, "{right_went}");
    assert!((left_went - right_went).norm() < 0.25 * right_went.norm(), "{right_went} {left_went}");
    assert!(matches!(left.fault(), Some(Fault::Force { .. })), "{:?}", left.fault());
    assert!(matches!(right.fault(), Some(Fault::Force { .. })), "{:?}", right.fault());
}

#[test]
fn samples_that_are_not_numbers_move_nothing() {
    let mut rig = Rig::new();
    let lease = rig.lease("right_arm");
    rig.command(&lease, &[0.3; 7], 50);
    let mut broken = rig.joints.sample().clone();
    broken.position[8] = f64::NAN;
    let right = rig.sensor(RIGHT);
    broken.wrenches[right].force.x = f64::INFINITY;
    for _ in 0..150 {
        rig.now_ms += 1;
        let targets = rig.guard.step(rig.now_ms * 1_000_000, &broken);
        assert!(targets.position.iter().chain(&targets.velocity).all(|v| v.is_finite()));
    }
    assert!(lease.fault().is_some());
    assert!(rig.wrist().force.norm().is_finite());
}

#[test]
fn the_setpoint_does_not_run_away_from_a_joint_that_is_held() {
    let mut rig = Rig::new();
    let lease = rig.lease("right_arm");
    let held = rig.joints.sample().clone();
    let (joint, ..) = rig.limit_and("elbow_r");
    let mut sample = held.clone();
    for k in 0..1000_u32 {
        rig.now_ms += 1;
        for (now, held) in sample.wrenches.iter_mut().zip(&held.wrenches) {
            now.force.x = held.force.x + 1e-4 * f64::from(k % 7);
        }
        lease.command(&[0.0, 0.0, 0.0, -0.5, 0.0, 0.0, 0.0]).unwrap();
        let targets = rig.guard.step(rig.now_ms * 1_000_000, &sample);
        assert!((targets.position[joint] - held.position[joint]).abs() <= 0.05 + 1e-12);
    }
    assert!(rig.guard.targets().velocity[joint].abs() < 0.03);
}

#[test]
fn a_stop_lasts_until_it_is_reset_and_utterances_are_heard() {
    let mut rig = Rig::new();
    let lease = rig.lease("right_arm");
    rig.robot.say("ready");
    rig.robot.say("show me");
    assert_eq!(rig.guard.take_utterances(), ["ready", "show me"]);
    assert!(rig.guard.take_utterances().is_empty());
    rig.robot.stop("a test");
    assert_eq!(lease.command(&[0.1; 7]), Err(Fault::Stopped { reason: "a test".into() }));
    assert!(rig.robot.lease("head", "test", LeaseLimits::default()).is_err());
    rig.robot.reset();
    assert!(lease.command(&[0.1; 7]).is_err(), "it was stopped");
    drop(lease);
    rig.lease("right_arm").command(&[0.1; 7]).unwrap();
}

#[test]
fn limbs_that_are_leased_together_have_one_fault() {
    let mut rig = Rig::new();
    let none = LeaseLimits::default();
    let both = rig.robot.lease_together(&["torso", "right_arm"], "test", none, &[]).unwrap();
    assert!(matches!(both.command(&[0.0; 7]), Err(Fault::WrongLength { expected: 10, got: 7, .. })));
    assert!(both.command(&[0.0; 10]).is_err(), "after the fault");
    drop(both);
    let both = rig.robot.lease_together(&["torso", "right_arm"], "test", none, &[]).unwrap();
    let mut command = [0.0; 10];
    (command[2], command[5]) = (0.1, 0.2);
    rig.command(&both, &command, 300);
    let velocity = &rig.guard.targets().velocity;
    let [torso, arm] = ["torso", "right_arm"].map(|limb| rig.model.limb(limb).to_vec());
    assert!((velocity[torso[2]] - 0.1).abs() < 1e-6 && (velocity[arm[2]] - 0.2).abs() < 1e-6);
    // A frozen wrist is a fault of the arm; the torso stops with it.
    rig.frozen = true;
    for _ in 0..110 {
        let _ = both.command(&command);
        rig.run(1, |_| Vector3::zeros());
    }
    rig.run(200, |_| Vector3::zeros());
    assert!(matches!(both.fault(), Some(Fault::FrozenWrench { .. })));
    assert!(rig.fastest() < 0.01);
    let shared = rig.robot.lease_together(&["head", "head"], "test", none, &[]);
    assert!(matches!(shared, Err(LeaseError::Taken { .. })), "{shared:?}");
    assert!(matches!(rig.robot.lease_together(&[], "test", none, &[]), Err(LeaseError::Nothing)));
}

/// How near the hand comes to a board under it that it is driven to, m; with what it holds.
fn nearest_to_a_board(touches: &[String], load: Option<Load>) -> f64 {
    let mut rig = Rig::new();
    let tcp = rig.model.link("tcp_right").unwrap();
    let at = rig.joints.kinematics().pose(tcp).translation.vector;
    let board = KnownBox {
        name: "board".into(),
        root_from_box: Isometry3::translation(at.x, at.y, at.z - 0.2),
        size: Vector3::new(0.3, 0.3, 0.02),
    };
    let mut loads = BTreeMap::new();
    if let Some(load) = load {
        rig.robot.set_load("right_hand", Some(load.clone())).unwrap();
        loads.insert("right_hand".to_owned(), load);
    }
    let boxes = [board];
    let bodies = Bodies::new(&rig.model).with(&rig.model, &loads, &boxes);
    rig.robot.set_surroundings(boxes.to_vec()).unwrap();
    let lease = rig.robot.lease_together(&["right_arm"], "test", LeaseLimits::default(), touches).unwrap();
    let mut ik =
        crate::DifferentialIk::new(&rig.model, tcp, rig.model.limb("right_arm"), crate::IkConfig::default());
    let down = crate::Twist { linear: Vector3::new(0.0, 0.0, -0.5), angular: Vector3::zeros() };
    let mut least = f64::INFINITY;
    for _ in 0..600 {
        let q = rig.joints.sample().position.clone();
        lease.command(ik.step(&q, &down, None).velocities).unwrap();
        rig.run(1, |_| Vector3::zeros());
        least = least.min(least_distance(&bodies, rig.joints.kinematics()));
    }
    least
}

#[test]
fn a_hand_and_what_it_holds_stop_before_a_known_table_unless_the_lease_names_it() {
    let shape = LoadShape {
        tcp_from_box: Isometry3::translation(0.08, 0.0, 0.0),
        size: Vector3::new(0.04, 0.1, 0.07),
    };
    let name = "sponge".to_owned();
    let load = Load { name, mass_kg: 0.0, center_in_tcp: Point3::origin(), shape: Some(shape) };
    for load in [None, Some(load)] {
        let kept = nearest_to_a_board(&[], load.clone());
        assert!(kept > 0.018 && kept < 0.03, "{kept} with {load:?}");
        let touching = nearest_to_a_board(&["board".into()], load);
        assert!(touching < 0.0, "{touching}");
    }
}

/// A ball on a platform of a kind, driven to its right and forward while it turns.
fn driven(kind: &str) -> [f64; 3] {
    let urdf = "<robot name='ball'><link name='base'><collision><geometry><sphere radius='0.1'/></geometry></collision></link></robot>";
    let file = format!(
        "robot: ball\ndescription: ball.urdf\nplatform: {{kind: {kind}, speed: 1 m/s, turn: 1 rad/s}}\n"
    );
    let model = crate::description::from_texts(&file, urdf).unwrap().model;
    let (mut guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
    let mut sample = crate::guard::Sample::resting(&model, model.zero());
    let lease = robot.lease("platform", "test", LeaseLimits::default()).unwrap();
    let mut aside: f64 = 0.0;
    for ms in 0..1000 {
        lease.command(&[0.5, 0.5, 0.3]).unwrap();
        let targets = guard.step(ms * 1_000_000, &sample).clone();
        let (sin, cos) = sample.position[2].sin_cos();
        aside = aside.max((targets.velocity[0] * cos + targets.velocity[1] * sin).abs());
        (sample.position, sample.velocity) = (targets.position, targets.velocity);
    }
    [aside, sample.position[0].hypot(sample.position[1]), sample.position[2]]
}

#[test]
fn a_differential_platform_rolls_and_turns_and_does_not_move_to_its_side() {
    let [aside, way, turned] = driven("differential");
    assert!(aside < 1e-3, "{aside}");
    assert!(way > 0.3 && turned > 0.2, "{way} {turned}");
    let [aside, ..] = driven("holonomic");
    assert!(aside > 0.4, "{aside}");
}

#[test]
fn surroundings_that_are_none_are_refused() {
    let rig = Rig::new();
    let board = KnownBox {
        name: "board".into(),
        root_from_box: Isometry3::identity(),
        size: Vector3::new(0.3, 0.0, 0.02),
    };
    let flat = rig.robot.set_surroundings(vec![board.clone()]).unwrap_err().to_string();
    assert!(flat.contains("`board`"), "{flat}");
    let many = vec![KnownBox { size: Vector3::repeat(0.1), ..board }; 17];
    assert!(rig.robot.set_surroundings(many).is_err());
}

#[tokio::test(start_paused = true)]
async fn every_limb_of_every_robot_conforms_without_physics() {
    for robot in crate::description::shipped_robots() {
        let model = Model::shipped(robot).unwrap();
        for limb in model.limbs().keys() {
            let dummy = crate::DummyRobot::start(Arc::clone(&model), model.ready(limb));
            let checked = crate::conformance::check(&dummy.robot(), limb).await;
            checked.unwrap_or_else(|violation| panic!("{robot}, {limb}: {violation}"));
        }
    }
}

/// Drives both arms and the torso into three random postures in which bodies overlap, as fast as the joints may go. Returns the
/// least distance on the way, m, and how far the joints moved.
fn least_distance_while_driven(seed: u64, ms: u64) -> (f64, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut rig = Rig::new();
    let bodies = Bodies::new(&rig.model);
    let limbs = ["left_arm", "right_arm", "torso"];
    let leases = limbs.map(|limb| rig.lease(limb));
    let (mut least, mut moved) = (f64::INFINITY, 0.0);
    for _ in 0..3 {
        let mut goal = rig.model.zero();
        let mut at_goal = Kinematics::new(&rig.model);
        while least_distance(&bodies, &at_goal) > 0.0 {
            goal = rig.model.joints().iter().map(|j| rng.random_range(j.lower..j.upper)).collect();
            at_goal.update(&goal);
        }
        for step in 0..ms {
            let before = rig.joints.sample().position.clone();
            for (lease, limb) in leases.iter().zip(limbs) {
                let towards = |&j: &usize| 5.0 * (goal[j] - before[j]).clamp(-1.0, 1.0);
                let speeds: Vec<f64> = rig.model.limb(limb).iter().map(towards).collect();
                lease.command(&speeds).unwrap();
            }
            rig.run(1, |_| Vector3::zeros());
            let now = &rig.joints.sample().position;
            moved += now.iter().zip(&before).map(|(a, b)| (a - b).abs()).sum::<f64>();
            if step % 4 == 0 {
                least = least.min(least_distance(&bodies, rig.joints.kinematics()));
            }
        }
    }
    (least, moved)
}

#[test]
fn arms_stop_before_each_other_before_the_head_and_before_the_trunk() {
    let mut near = 0;
    for seed in 0..30 {
        let (least, moved) = least_distance_while_driven(seed, 700);
        assert!(least > 0.018, "{seed}: {least}");
        assert!(moved > 0.5, "{seed}: {moved}");
        near += u32::from(least < 0.05);
    }
    assert!(near > 14, "only {near} drives came near");
}
