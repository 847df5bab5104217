//! A robot without physics: joints that follow their targets, and wrench sensors that measure the hands' weights and
//! pushes on them.
//!
//! For tests of skills and of the guard. [`ServoJoints`] is pure and stepped; [`DummyRobot`] steps it each
//! millisecond of tokio's clock. There is no table and no object: all forces come from calls of
//! [`DummyRobot::push`].

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point3, Vector3};
use parking_lot::Mutex;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior};

use crate::driver::{Driver, DriverClock, DriverError, TimedSample};
use crate::wrist::LoadedHand;
use crate::{
    Guard, GuardConfig, GuardedRobot, JointTargets, Kinematics, LinkId, Model, Robot, Sample, Twist,
};

/// Bandwidth of the joints' servos, rad/s; critically damped.
const SERVO: f64 = 100.0;
/// Amplitude of the wrench's noise, N and N m: large enough that no two samples are equal.
const NOISE: f64 = 1e-3;

/// A hand on a wrench sensor.
#[derive(Clone, Debug)]
struct SensedHand {
    hand: LoadedHand,
    sensor: LinkId,
    before: Option<Twist>,
}

/// Joints that follow position and velocity targets as critically damped servos, unaffected by forces.
#[derive(Clone, Debug)]
pub struct ServoJoints {
    sample: Sample,
    kinematics: Kinematics,
    hands: Vec<SensedHand>,
    rng: ChaCha8Rng,
}

impl ServoJoints {
    /// Joints at rest at `q` (all joints, rad or m; missing values are 0). `seed` determines the wrench's noise.
    pub fn new(model: &Arc<Model>, q: &[f64], seed: u64) -> Self {
        let mut position = model.zero();
        position.iter_mut().zip(q).for_each(|(to, from)| *to = *from);
        let hand = |(index, sensor): (usize, LinkId)| {
            let tcp = model.arms().find(|arm| arm.wrench == Some(index)).and_then(|arm| arm.tcp);
            let hand = LoadedHand::new(model, sensor, tcp.unwrap_or(sensor));
            SensedHand { hand, sensor, before: None }
        };
        let mut joints = Self {
            sample: Sample::resting(model, position),
            kinematics: Kinematics::new(model),
            hands: model.wrenches().iter().map(|wrench| wrench.frame).enumerate().map(hand).collect(),
            rng: ChaCha8Rng::seed_from_u64(seed),
        };
        joints.sense(&[], 1e-3);
        joints
    }

    /// The present sample of joints and wrench sensors.
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    /// The kinematics at the present configuration.
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// Moves the joints towards `targets` for `dt` s; `pushes` act on the hands at their TCPs (root frame, N), in the
    /// order of the wrench sensors. Hands for which none is given are not pushed.
    pub fn step(&mut self, targets: &JointTargets, pushes: &[Vector3<f64>], dt: f64) {
        let Sample { position, velocity, .. } = &mut self.sample;
        for (j, (q, v)) in position.iter_mut().zip(velocity.iter_mut()).enumerate() {
            *v +=
                dt * (SERVO * SERVO * (targets.position[j] - *q) + 2.0 * SERVO * (targets.velocity[j] - *v));
            *q += dt * *v;
        }
        self.sense(pushes, dt);
    }

    /// Repeats what a wrench sensor felt in `earlier`, as if it were broken.
    pub fn repeat_wrench(&mut self, sensor: usize, earlier: &Self) {
        self.sample.wrenches[sensor] = earlier.sample.wrenches[sensor];
    }

    fn sense(&mut self, pushes: &[Vector3<f64>], dt: f64) {
        let Self { sample, kinematics, hands, rng } = self;
        kinematics.update(&sample.position);
        for (i, SensedHand { hand, sensor, before }) in hands.iter_mut().enumerate() {
            let now = kinematics.twist(*sensor, &Point3::origin(), &sample.velocity);
            let before = before.replace(now).unwrap_or(now);
            let acceleration = Twist {
                linear: (now.linear - before.linear) / dt,
                angular: (now.angular - before.angular) / dt,
            };
            let push = pushes.get(i).copied().unwrap_or_default();
            let felt = hand.reaction(kinematics, &push, &now.angular, &acceleration);
            sample.wrenches[i] = felt.map(|v| v + Vector3::from_fn(|_, _| rng.random_range(-NOISE..NOISE)));
        }
    }
}

/// [`ServoJoints`] below a guard, 1 kHz.
#[derive(Clone, Debug)]
pub struct ServoDriver {
    joints: ServoJoints,
    clock: DriverClock,
    targets: JointTargets,
    steps: u64,
    /// When the next sample is due, in real time.
    due: Instant,
}

impl ServoDriver {
    /// Joints at rest at `q` (all joints; missing values are 0), whose time passes as `clock` says.
    pub fn new(model: &Arc<Model>, q: &[f64], clock: DriverClock) -> Self {
        let joints = ServoJoints::new(model, q, 0);
        let position = joints.sample().position.clone();
        let targets = JointTargets { velocity: vec![0.0; position.len()], position };
        Self { joints, clock, targets, steps: 0, due: Instant::now() }
    }
}

impl Driver for ServoDriver {
    fn clock(&self) -> DriverClock {
        self.clock
    }

    fn period(&self) -> Duration {
        Duration::from_millis(1)
    }

    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        if self.clock == DriverClock::Realtime {
            self.due = (self.due + self.period()).max(Instant::now() - Duration::from_millis(20));
            pause_until(self.due);
        }
        self.joints.step(&self.targets, &[], 1e-3);
        self.steps += 1;
        let sample = self.joints.sample().clone();
        Ok(TimedSample { stamp_ns: self.steps * 1_000_000, sample, braked: false, bodies: BTreeMap::new() })
    }

    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        self.targets.clone_from(targets);
        Ok(())
    }

    fn brake(&mut self) {
        self.targets.position.clone_from(&self.joints.sample.position);
        self.targets.velocity.fill(0.0);
    }
}

#[expect(clippy::disallowed_methods, reason = "a driver in real time has a thread of its own")]
fn pause_until(due: Instant) {
    std::thread::sleep(due.saturating_duration_since(Instant::now()));
}

/// A guarded robot on tokio's clock, 1 kHz; it stops when this is dropped.
#[derive(Debug)]
pub struct DummyRobot {
    robot: Arc<GuardedRobot>,
    pushes: Arc<Mutex<Vec<Vector3<f64>>>>,
    task: JoinHandle<()>,
}

impl DummyRobot {
    /// Starts a robot at rest at `q` (all joints; missing values are 0) in the current tokio runtime.
    pub fn start(model: Arc<Model>, q: &[f64]) -> Self {
        let mut joints = ServoJoints::new(&model, q, 0);
        let (mut guard, robot) = Guard::new(Arc::clone(&model), GuardConfig::of(&model));
        let pushes = Arc::new(Mutex::new(vec![Vector3::zeros(); model.wrenches().len()]));
        let pushed = Arc::clone(&pushes);
        let task = tokio::spawn(async move {
            let mut tick = tokio::time::interval(Duration::from_millis(1));
            tick.set_missed_tick_behavior(MissedTickBehavior::Burst);
            let mut stamp_ns = 0;
            loop {
                tick.tick().await;
                stamp_ns += 1_000_000;
                let pushes = pushed.lock().clone();
                joints.step(guard.step(stamp_ns, joints.sample()), &pushes, 1e-3);
            }
        });
        Self { robot, pushes, task }
    }

    /// The robot as skills see it.
    pub fn robot(&self) -> Arc<dyn Robot> {
        Arc::clone(&self.robot) as Arc<dyn Robot>
    }

    /// Pushes the hand of a wrench sensor (an index into the model's) at its TCP with a force, root frame, N, until
    /// the next call. A robot without this sensor feels nothing.
    pub fn push(&self, sensor: usize, force: Vector3<f64>) {
        self.pushes.lock().get_mut(sensor).into_iter().for_each(|push| *push = force);
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
