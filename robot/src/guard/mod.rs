//! The guard: the safety layer between leases and the joints' drives. Pure and stepped; it has no clock, task or
//! physics.
//!
//! The driver of the joints calls [`Guard::step`] with each sample (1 kHz) and applies the [`JointTargets`]. One
//! step does the following. It compensates the wrench sensors and publishes the sample. It detects faults. It takes the
//! newest command of each limb, or 0. It scales joints that move a TCP together to the TCP and joint speed limits,
//! keeping the direction, and limits the acceleration (`bounds.rs`). A differential platform only rolls and turns. It stops each
//! joint softly before its limits.
//! It integrates to a setpoint that stays near the measured position. Above the force limit at its sensor, an arm
//! yields.

mod bounds;
mod clearance;
mod force;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::Duration;

use nalgebra::Vector2;

use self::bounds::VelocityBounds;
use self::clearance::Clearance;
use self::force::{Sensor, YieldingArms};
use crate::seam::lease::{LeaseBoard, LeaseTable};
use crate::{
    Fault, ForceTorque, GuardedRobot, JointKind, Kinematics, Model, Platform, PlatformKind, Robot as _,
    RobotLimits, Sensed,
};

/// The guard's own limits. Leases can only tighten them, but for the force, which they can raise up to `most_force_n`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuardConfig {
    /// Longest time without a new command for a moving limb.
    pub watchdog: Duration,
    /// Largest compensated force at any wrench sensor, N, for leases that say no limit of their own.
    pub force_n: f64,
    /// The largest limit that a lease may say, N.
    pub most_force_n: f64,
    /// Largest speed of any TCP, m/s.
    pub speed_m_s: f64,
    /// How long the raw sample of a wrench sensor may stay bit-identical.
    pub frozen: Duration,
    /// Largest distance of a revolute joint's setpoint from its measured position, rad: limits the torque in
    /// contact.
    pub window_rad: f64,
    /// The same for a prismatic joint, m: with the drive's stiffness, this determines the grip's force.
    pub window_m: f64,
    /// Distance from its limits at which a revolute joint stops, rad.
    pub margin_rad: f64,
    /// Yielding speed per newton of force above the threshold, m/s/N.
    pub yield_gain: f64,
    /// Largest yielding speed, m/s.
    pub yield_speed_m_s: f64,
}

impl Default for GuardConfig {
    fn default() -> Self {
        Self {
            watchdog: Duration::from_millis(30),
            force_n: 40.0,
            most_force_n: 40.0,
            speed_m_s: 1.0,
            frozen: Duration::from_millis(100),
            window_rad: 0.05,
            window_m: 0.02,
            margin_rad: 0.005,
            yield_gain: 0.004,
            yield_speed_m_s: 0.3,
        }
    }
}

impl GuardConfig {
    /// The limits of a robot.
    pub fn of(model: &Model) -> Self {
        let RobotLimits { force_n, most_force_n, speed_m_s } = model.limits();
        Self { force_n, most_force_n, speed_m_s, ..Self::default() }
    }
}

/// Longest step that is integrated, s, so that the setpoints do not jump after a pause of the driver.
const MAX_STEP_S: f64 = 0.02;

/// A raw sample of the joints and the wrench sensors.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Joint positions in the model's order, rad (m).
    pub position: Vec<f64>,
    /// Joint velocities, rad/s (m/s).
    pub velocity: Vec<f64>,
    /// What each hand exerts on its wrench sensor, in the sensor's frame, about its origin; in the order of the
    /// model's sensors.
    pub wrenches: Vec<ForceTorque>,
}

impl Sample {
    /// At rest at `position`, with nothing on the wrench sensors of `model`.
    pub fn resting(model: &Model, position: Vec<f64>) -> Self {
        let velocity = vec![0.0; position.len()];
        Self { position, velocity, wrenches: vec![ForceTorque::default(); model.wrenches().len()] }
    }

    fn is_finite(&self, joints: usize) -> bool {
        let all = |values: &[f64]| values.len() == joints && values.iter().all(|v| v.is_finite());
        all(&self.position) && all(&self.velocity)
    }
}

/// The targets of the joints' drives, in the model's order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointTargets {
    /// Positions, rad (m).
    pub position: Vec<f64>,
    /// Velocities, rad/s (m/s).
    pub velocity: Vec<f64>,
}

/// The guard of one robot; see the module.
#[derive(Debug)]
pub struct Guard {
    shared: Arc<LeaseBoard>,
    config: GuardConfig,
    kinematics: Kinematics,
    sensors: Vec<Sensor>,
    arms: YieldingArms,
    bounds: VelocityBounds,
    clearance: Clearance,
    measured: Sample,
    desired: Vec<f64>,
    targets: JointTargets,
    stamp_ns: Option<u64>,
    /// Whether the next sample is of drives that have braked by themselves.
    braked: bool,
}

impl Guard {
    /// A guard and the robot that it protects. The joints hold the position of the first sample.
    pub fn new(model: Arc<Model>, config: GuardConfig) -> (Self, Arc<GuardedRobot>) {
        let shared = Arc::new(LeaseBoard::new(&model));
        let robot = Arc::new(GuardedRobot { shared: Arc::clone(&shared) });
        let n = model.joints().len();
        let guard = Self {
            shared,
            config,
            kinematics: Kinematics::new(&model),
            sensors: Sensor::all(&model),
            arms: YieldingArms::new(&model),
            bounds: VelocityBounds::new(&model),
            clearance: Clearance::new(&model),
            measured: Sample::resting(&model, model.zero()),
            desired: vec![0.0; n],
            targets: JointTargets { position: model.zero(), velocity: vec![0.0; n] },
            stamp_ns: None,
            braked: false,
        };
        (guard, robot)
    }

    /// The targets of the last step.
    pub fn targets(&self) -> &JointTargets {
        &self.targets
    }

    /// The robot's utterances since the last call, oldest first.
    pub fn take_utterances(&mut self) -> Vec<String> {
        self.shared.take_utterances()
    }

    /// Says that the next sample is of drives that stand, or brake, by themselves: the set points begin again where the joints
    /// are, and limbs in motion are taken from their commanders.
    pub fn drives_have_braked(&mut self) {
        self.braked = true;
    }

    /// Stops the robot for good, as its drives are out of reach: leases are refused with the reason, and no sample follows.
    pub fn end(&mut self, reason: &str) {
        let robot = GuardedRobot { shared: Arc::clone(&self.shared) };
        robot.shared.leases().ended = Some(reason.to_owned());
        robot.stop(reason);
        // Once more, so that those who command are told why before the samples end.
        self.shared.sensed.send(self.shared.sensed.borrow());
        self.shared.sensed.close();
    }

    /// Processes a sample taken at `stamp_ns` since the robot's start, publishes it, and returns the targets of the
    /// drives.
    ///
    /// A sample that is not finite or of the wrong length is replaced by the previous one; if this continues, the
    /// wrench sensors count as frozen. Allocates only the published sample.
    pub fn step(&mut self, stamp_ns: u64, sample: &Sample) -> &JointTargets {
        let dt = self.accept(stamp_ns, sample);
        let shared = Arc::clone(&self.shared);
        let mut table = shared.leases();
        self.sense(&mut table, stamp_ns, dt);
        self.find_faults(&mut table, stamp_ns);
        self.take_commands(&table);
        drop(table);
        // Before the rest is computed: skills of other threads begin with it meanwhile.
        self.publish(stamp_ns);
        self.arms.yield_into(&self.sensors, &self.kinematics, &self.config, &mut self.desired);
        let Self { bounds, clearance, kinematics, desired, targets, .. } = self;
        clearance.update(kinematics, &targets.position);
        bounds.bound(&shared.model, kinematics, clearance, desired);
        bounds.accelerate(&shared.model, desired, &mut targets.velocity, dt);
        if let Some(platform) = shared.model.platform() {
            roll_only(platform, &targets.position, &mut targets.velocity);
        }
        self.integrate(dt);
        self.braked = false;
        &self.targets
    }

    /// Returns the time since the last sample, s.
    fn accept(&mut self, stamp_ns: u64, sample: &Sample) -> f64 {
        let first = self.stamp_ns.is_none();
        #[expect(clippy::cast_precision_loss, reason = "a step is far below 2^52 ns")]
        let since = stamp_ns.saturating_sub(self.stamp_ns.unwrap_or(stamp_ns)) as f64 * 1e-9;
        self.stamp_ns = Some(stamp_ns);
        if sample.is_finite(self.desired.len()) {
            self.measured.position.copy_from_slice(&sample.position);
            self.measured.velocity.copy_from_slice(&sample.velocity);
            if first || self.braked {
                self.targets.position.copy_from_slice(&sample.position);
                self.targets.velocity.fill(0.0);
            }
        }
        self.measured.wrenches.clone_from(&sample.wrenches);
        self.kinematics.update(&self.measured.position);
        since.min(MAX_STEP_S)
    }

    fn sense(&mut self, table: &mut LeaseTable, stamp_ns: u64, dt: f64) {
        let Self { sensors, arms, clearance, kinematics, measured, config, .. } = self;
        let loads_changed = std::mem::take(&mut table.loads_changed);
        if loads_changed {
            sensors.iter_mut().for_each(|sensor| sensor.load(table));
            arms.load(table);
        }
        clearance.read(table, loads_changed);
        let frozen_ns = nanoseconds(config.frozen);
        for (index, sensor) in sensors.iter_mut().enumerate() {
            let raw = measured.wrenches.get(index);
            sensor.sense(kinematics, &measured.velocity, raw, (stamp_ns, dt), frozen_ns);
        }
        for tared in table.tared.drain(..) {
            sensors[tared].tare(kinematics);
        }
    }

    fn find_faults(&mut self, table: &mut LeaseTable, stamp_ns: u64) {
        let watchdog_ns = nanoseconds(self.config.watchdog);
        for slot in &mut table.slots {
            let Some(held) = &mut slot.held else { continue };
            if held.seen.0 != held.sequence {
                held.seen = (held.sequence, stamp_ns);
            }
            let silent_ns = stamp_ns.saturating_sub(held.seen.1);
            let moving = held.velocities.iter().any(|v| *v != 0.0);
            if moving && self.braked {
                slot.fail(&Fault::Braked);
            } else if moving && silent_ns > watchdog_ns {
                slot.fail(&Fault::Watchdog { silent_ms: silent_ns / 1_000_000 });
            }
        }
        for sensor in &mut self.sensors {
            sensor.find_faults(table, &self.config, stamp_ns);
        }
        self.arms.share_faults(table);
        table.share_faults();
    }

    /// The desired velocities: each limb's newest command, or 0 for limbs without a lease that is free of faults.
    fn take_commands(&mut self, table: &LeaseTable) {
        self.desired.fill(0.0);
        for slot in &table.slots {
            let Some(held) = slot.faultless() else { continue };
            for (&joint, &velocity) in slot.limb.joints.iter().zip(&held.velocities) {
                self.desired[joint] = velocity * table.speed_scale;
            }
        }
        self.bounds.read(table, self.config.speed_m_s);
    }

    /// Integrates the velocities. Each joint stops before its limits and stays near its measured position.
    fn integrate(&mut self, dt: f64) {
        let Self { config, measured, targets, shared, .. } = self;
        for (j, joint) in shared.model.joints().iter().enumerate() {
            let (window, margin) = match joint.kind {
                JointKind::Revolute => (config.window_rad, config.margin_rad),
                JointKind::Prismatic => (config.window_m, 0.0),
            };
            let (position, velocity) = (&mut targets.position[j], &mut targets.velocity[j]);
            let up = stopping_speed(joint.upper - margin - *position, joint.acceleration, dt);
            let down = stopping_speed(*position - joint.lower - margin, joint.acceleration, dt);
            *velocity = velocity.clamp(-down, up);
            let wanted = *position + *velocity * dt;
            *position = wanted.clamp(measured.position[j] - window, measured.position[j] + window);
            if (wanted - *position) * *velocity > 0.0 {
                // The joint does not follow: reduce its velocity as if braking, so that it starts gently when it is
                // free again.
                let loss = (2.0 * joint.acceleration * dt).min(velocity.abs());
                *velocity -= loss.copysign(*velocity);
            }
        }
    }

    fn publish(&self, stamp_ns: u64) {
        self.shared.sensed.send(Arc::new(Sensed {
            stamp_ns,
            position: self.measured.position.clone(),
            velocity: self.measured.velocity.clone(),
            wrenches: self.sensors.iter().map(Sensor::sensed).collect(),
        }));
    }
}

/// Takes the motion to its side, which its wheels do not allow, from a differential platform.
fn roll_only(platform: &Platform, position: &[f64], velocity: &mut [f64]) {
    let [x, y, yaw] = platform.joints;
    if platform.kind == PlatformKind::Differential {
        // It looks along its y.
        let forward = Vector2::new(-libm::sin(position[yaw]), libm::cos(position[yaw]));
        let rolling = forward * forward.dot(&Vector2::new(velocity[x], velocity[y]));
        (velocity[x], velocity[y]) = (rolling.x, rolling.y);
    }
}

/// The largest speed from which a joint can brake within `distance` after one more step at that speed.
fn stopping_speed(distance: f64, acceleration: f64, dt: f64) -> f64 {
    acceleration * ((dt * dt + 2.0 * distance.max(0.0) / acceleration).sqrt() - dt)
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
