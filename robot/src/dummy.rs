//! A robot without physics: joints that follow their targets, and a wrist that measures the hand's weight and
//! pushes on it.
//!
//! For tests of skills and of the guard. [`ServoJoints`] is pure and stepped; [`DummyRobot`] steps it each
//! millisecond of tokio's clock. There is no table and no object: all forces come from calls of
//! [`DummyRobot::push`].

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point3, Vector3};
use parking_lot::Mutex;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;

use crate::wrist::LoadedHand;
use crate::{Guard, GuardConfig, GuardedRobot, JointTargets, Kinematics, Model, Robot, Sample, Twist};

/// Bandwidth of the joints' servos, rad/s; critically damped.
const SERVO: f64 = 100.0;
/// Amplitude of the wrench's noise, N and N m: large enough that no two samples are equal.
const NOISE: f64 = 1e-3;

/// Joints that follow position and velocity targets as critically damped servos, unaffected by forces.
#[derive(Clone, Debug)]
pub struct ServoJoints {
    sample: Sample,
    kinematics: Kinematics,
    hand: Option<(LoadedHand, crate::LinkId)>,
    before: Option<Twist>,
    rng: ChaCha8Rng,
}

impl ServoJoints {
    /// Joints at rest at `q` (all joints, rad or m; missing values are 0). `seed` determines the wrench's noise.
    pub fn new(model: &Arc<Model>, q: &[f64], seed: u64) -> Self {
        let mut position = model.zero();
        position.iter_mut().zip(q).for_each(|(to, from)| *to = *from);
        let hand = model
            .limbs()
            .values()
            .find_map(|limb| Some((model.sensor_of(limb)?, limb.tcp?)))
            .map(|(sensor, tcp)| (LoadedHand::new(model, sensor, tcp), sensor));
        let mut joints = Self {
            sample: Sample::resting(position),
            kinematics: Kinematics::new(model),
            hand,
            before: None,
            rng: ChaCha8Rng::seed_from_u64(seed),
        };
        joints.sense(&Vector3::zeros(), 1e-3);
        joints
    }

    /// The present sample of joints and wrist.
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    /// The kinematics at the present configuration.
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// Moves the joints towards `targets` for `dt` s; `push` acts on the hand at the TCP (root frame, N).
    pub fn step(&mut self, targets: &JointTargets, push: &Vector3<f64>, dt: f64) {
        let Sample { position, velocity, .. } = &mut self.sample;
        for (j, (q, v)) in position.iter_mut().zip(velocity.iter_mut()).enumerate() {
            *v +=
                dt * (SERVO * SERVO * (targets.position[j] - *q) + 2.0 * SERVO * (targets.velocity[j] - *v));
            *q += dt * *v;
        }
        self.sense(push, dt);
    }

    /// Repeats the wrench of `earlier`, like a broken sensor.
    pub fn repeat_wrench(&mut self, earlier: &Self) {
        self.sample.force_raw = earlier.sample.force_raw;
        self.sample.torque_raw = earlier.sample.torque_raw;
    }

    fn sense(&mut self, push: &Vector3<f64>, dt: f64) {
        self.kinematics.update(&self.sample.position);
        let Some((hand, sensor)) = &self.hand else { return };
        let now = self.kinematics.twist(*sensor, &Point3::origin(), &self.sample.velocity);
        let before = self.before.replace(now).unwrap_or(now);
        let acceleration =
            Twist { linear: (now.linear - before.linear) / dt, angular: (now.angular - before.angular) / dt };
        let (force, torque) = hand.reaction(&self.kinematics, push, &now.angular, &acceleration);
        let rng = &mut self.rng;
        let mut noise = || Vector3::from_fn(|_, _| rng.random_range(-NOISE..NOISE));
        self.sample.force_raw = force + noise();
        self.sample.torque_raw = torque + noise();
    }
}

/// A guarded robot on tokio's clock, 1 kHz; it stops when this is dropped.
#[derive(Debug)]
pub struct DummyRobot {
    robot: Arc<GuardedRobot>,
    push: Arc<Mutex<Vector3<f64>>>,
    task: JoinHandle<()>,
}

impl DummyRobot {
    /// Starts a robot at rest at `q` (all joints; missing values are 0) in the current tokio runtime.
    pub fn start(model: Arc<Model>, q: &[f64]) -> Self {
        let mut joints = ServoJoints::new(&model, q, 0);
        let (mut guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
        let push = Arc::new(Mutex::new(Vector3::zeros()));
        let pushed = Arc::clone(&push);
        let task = tokio::spawn(async move {
            let mut tick = tokio::time::interval(Duration::from_millis(1));
            tick.set_missed_tick_behavior(MissedTickBehavior::Burst);
            let mut stamp_ns = 0;
            loop {
                tick.tick().await;
                stamp_ns += 1_000_000;
                let push = *pushed.lock();
                joints.step(guard.step(stamp_ns, joints.sample()), &push, 1e-3);
            }
        });
        Self { robot, push, task }
    }

    /// The robot as skills see it.
    pub fn robot(&self) -> Arc<dyn Robot> {
        Arc::clone(&self.robot) as Arc<dyn Robot>
    }

    /// Pushes the hand at its TCP with a force, root frame, N, until the next call.
    pub fn push(&self, force: Vector3<f64>) {
        *self.push.lock() = force;
    }

    /// The robot's utterances since the last call, oldest first.
    pub fn take_utterances(&self) -> Vec<String> {
        self.robot.shared.take_utterances()
    }
}

impl Drop for DummyRobot {
    fn drop(&mut self) {
        self.task.abort();
    }
}
