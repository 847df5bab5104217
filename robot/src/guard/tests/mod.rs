//! The guard with servo joints, stepped without a clock: limits and faults here, `forces`, `distances`.

mod distances;
mod forces;

use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use super::MAX_STEP_S;
use crate::{
    Fault, ForceTorque, Guard, GuardConfig, GuardedRobot, Lease, LeaseError, LeaseLimits, Model, Robot,
    ServoJoints,
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
        let (guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
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

    fn felt(&self, name: &str) -> ForceTorque {
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

    fn wrist(&self) -> ForceTorque {
        self.felt(RIGHT)
    }

    fn limit_and(&self, joint: &str) -> (usize, f64, f64) {
        let j = self.model.joint(joint).unwrap();
        (j, self.model.joints()[j].lower, self.model.joints()[j].upper)
    }
}

#[test]
fn a_lease_with_an_impossible_limit_is_refused() {
    let rig = Rig::new();
    for (force, speed) in [(f64::NAN, 0.3), (-1.0, 0.3), (10.0, f64::NAN), (10.0, -0.1)] {
        let limits = LeaseLimits { force_n: Some(force), speed_m_s: Some(speed) };
        let refused = rig.robot.lease("right_arm", "test", limits).map(|_| ()).unwrap_err();
        assert!(matches!(refused, LeaseError::Limit { .. }), "{refused}");
    }
    drop(rig.lease("right_arm"));
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
fn a_clock_that_jumps_forward_moves_nothing_far_and_ends_what_moves() {
    let mut rig = Rig::new();
    let lease = rig.lease("right_arm");
    let velocity = 0.3;
    rig.command(&lease, &[velocity; 7], 100);
    let before = rig.guard.targets.position.clone();
    // Ten minutes between two samples: nobody knows what the skill would have commanded.
    rig.now_ms += 600_000;
    rig.step(&[]);
    let went = |after: &[f64]| before.iter().zip(after).fold(0.0_f64, |most, (b, a)| most.max((a - b).abs()));
    let jump = went(&rig.guard.targets.position);
    assert!(jump < 2.0 * velocity * MAX_STEP_S, "{jump} rad in the step with the jump");
    assert!(
        matches!(lease.fault(), Some(Fault::Watchdog { silent_ms }) if silent_ms >= 600_000),
        "{:?}",
        lease.fault()
    );
    rig.run(200, |_| Vector3::zeros());
    assert!(rig.fastest() < 0.01);
    assert!(went(&rig.guard.targets.position) < 0.1, "it brakes where it was");
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
        let (sin, cos) = libm::sincos(sample.position[2]);
        aside = aside.max((targets.velocity[0] * cos + targets.velocity[1] * sin).abs());
        (sample.position, sample.velocity) = (targets.position, targets.velocity);
    }
    [aside, libm::hypot(sample.position[0], sample.position[1]), sample.position[2]]
}

#[test]
fn a_differential_platform_rolls_and_turns_and_does_not_move_to_its_side() {
    let [aside, way, turned] = driven("differential");
    assert!(aside < 1e-3, "{aside}");
    assert!(way > 0.3 && turned > 0.2, "{way} {turned}");
    let [aside, ..] = driven("holonomic");
    assert!(aside > 0.4, "{aside}");
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
