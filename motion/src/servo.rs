//! Position-based visual servoing: from the observed poses of the hand and of its target to a twist.
//!
//! Independent of the camera. If hand and target are measured with the same camera, its mounting error cancels. Several hands that
//! go to one thing have a servo each, and [`in_step`] makes them arrive together.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::constants::POSITIVE;
use crate::error::{MotionError, finite, positive, vector};

constants! {
    /// The constants of a [`PositionServo`].
    pub struct ServoConfig {
        /// Gain lambda far from the target, 1/s.
        gain_far: f64 = 1.0, POSITIVE;
        /// Gain lambda at the target, 1/s; larger than far away, so that the end is not slow.
        gain_near: f64 = 2.5, POSITIVE;
        /// Error at which the gain is about halfway between, m (rotations count `radius` m per rad).
        gain_scale: f64 = 0.05, POSITIVE;
        /// Lever arm that converts rotations to metres, m.
        radius: f64 = 0.1, POSITIVE;
        /// Speed limit, m/s.
        max_linear: f64 = 0.15, POSITIVE;
        /// Limit of the angular velocity, rad/s.
        max_angular: f64 = 0.6, POSITIVE;
        /// Converged when the distance is less than this, m, ...
        position_tolerance: f64 = 0.005, POSITIVE;
        /// ... and the angle is less than this, rad, ...
        rotation_tolerance: f64 = 0.05, POSITIVE;
        /// ... for this many observations in a row.
        hold_frames: u32 = 5;
        /// Gives up after this long, s.
        timeout: f64 = 20.0, POSITIVE;
        /// The target counts as lost when it was not observed for this long, s.
        lost_after: f64 = 1.0, POSITIVE;
        /// The servo diverges when the error has exceeded its minimum by this factor (and by 10 mm) in `hold_frames`
        /// consecutive observations.
        divergence: f64 = 2.0, 1.0..=1e9;
    }
}

/// The share of `lost_after` up to which what was seen is as good as new.
const FRESH: f64 = 0.2;

/// Hand and target observed together, in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServoObservation {
    /// The pose of the hand's TCP.
    pub hand: Isometry3<f64>,
    /// The pose that the TCP shall reach.
    pub target: Isometry3<f64>,
}

/// The status of the servo.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ServoStatus {
    /// Moving to the target.
    Running,
    /// At the target for the required number of observations.
    Converged,
    /// The timeout has passed.
    TimedOut,
    /// Hand or target were not observed for too long.
    Lost,
    /// The error grows: a frame is wrong, or something holds the hand.
    Diverged,
}

/// The command of a step, in the frame of the observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServoCommand {
    /// Velocity of the TCP, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular: Vector3<f64>,
    /// Distance to the target, m.
    pub distance: f64,
    /// Angle to the target, rad.
    pub angle: f64,
    /// The rate with which the error falls, 1/s: the velocities are this times the error.
    pub rate: f64,
    /// The status; the velocities are zero unless it is running.
    pub status: ServoStatus,
}

/// `v = -lambda t`, `omega = -lambda theta u`, with t and theta u of the hand relative to the target. The TCP moves
/// on a straight line even when its speed is limited, since both parts are scaled together.
#[derive(Debug, Clone)]
pub struct PositionServo {
    config: ServoConfig,
    elapsed: f64,
    unseen: f64,
    held: u32,
    growing: u32,
    smallest: f64,
    axis: Option<Vector3<f64>>,
    last: ServoCommand,
}

impl PositionServo {
    /// A servo before its first observation.
    ///
    /// # Errors
    /// When a constant is not positive.
    pub fn new(config: ServoConfig) -> Result<Self, MotionError> {
        config.check_ranges()?;
        Ok(Self {
            config,
            elapsed: 0.0,
            unseen: 0.0,
            held: 0,
            growing: 0,
            smallest: f64::INFINITY,
            axis: None,
            last: still(f64::INFINITY, f64::INFINITY, ServoStatus::Running),
        })
    }

    /// Advances by `dt` s. Returns the twist for the observation (`None` if hand or target were not observed).
    /// Without an observation the last command decays, as it is based on an older one.
    ///
    /// # Errors
    /// When `dt` is not positive or a pose is not finite; nothing is changed.
    pub fn step(
        &mut self,
        dt: f64,
        observation: Option<&ServoObservation>,
    ) -> Result<ServoCommand, MotionError> {
        self.step_aged(dt, observation.map(|seen| (seen, 0.0)))
    }

    /// The same for an observation that was computed from what was seen some time ago, s: the older, the slower the hand goes, as the
    /// target may have moved since. What is older than a fifth of `lost_after` does not count as arrived, and what is older than that is lost.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn step_aged(
        &mut self,
        dt: f64,
        observation: Option<(&ServoObservation, f64)>,
    ) -> Result<ServoCommand, MotionError> {
        positive("dt", dt)?;
        if let Some((o, age)) = observation {
            finite("age", &[age])?;
            for pose in [&o.hand, &o.target] {
                vector("pose", 3, pose.translation.vector.as_slice())?;
                finite("pose", pose.rotation.coords.as_slice())?;
            }
        }
        if self.last.status != ServoStatus::Running {
            return Ok(self.last);
        }
        self.elapsed += dt;
        self.last = match observation {
            Some((o, age)) => self.seen(o, age.max(0.0)),
            None => self.blind(dt),
        };
        if self.elapsed >= self.config.timeout && self.last.status == ServoStatus::Running {
            self.last = still(self.last.distance, self.last.angle, ServoStatus::TimedOut);
        }
        Ok(self.last)
    }

    fn blind(&mut self, dt: f64) -> ServoCommand {
        self.unseen += dt;
        self.held = 0;
        let mut command = self.last;
        if self.unseen > self.config.lost_after {
            return still(command.distance, command.angle, ServoStatus::Lost);
        }
        let fade = libm::exp(-dt / (0.2 * self.config.lost_after));
        command.linear *= fade;
        command.angular *= fade;
        command.rate *= fade;
        command
    }

    fn seen(&mut self, o: &ServoObservation, age: f64) -> ServoCommand {
        self.unseen = age;
        let t = o.hand.translation.vector - o.target.translation.vector;
        let turn = self.steady_turn(&(o.hand.rotation * o.target.rotation.inverse()));
        let (distance, angle) = (t.norm(), turn.norm().min(std::f64::consts::TAU - turn.norm()));
        let error = distance + self.config.radius * angle;
        if age > self.config.lost_after {
            return still(distance, angle, ServoStatus::Lost);
        }
        if let Some(status) = self.judge((distance, angle, error), age) {
            return still(distance, angle, status);
        }
        let c = &self.config;
        let gain = c.gain_far + (c.gain_near - c.gain_far) * libm::exp(-error / c.gain_scale);
        let (linear, angular) = (-gain * t, -gain * turn);
        let scale = (c.max_linear / linear.norm()).min(c.max_angular / angular.norm()).min(1.0);
        let fresh = 1.0 - age / c.lost_after;
        let scale = if scale.is_finite() { scale * fresh } else { fresh };
        ServoCommand {
            linear: linear * scale,
            angular: angular * scale,
            distance,
            angle,
            rate: gain * scale,
            status: ServoStatus::Running,
        }
    }

    /// The rotation vector. Near half a turn, where noise flips its sign, it keeps its initial direction.
    fn steady_turn(&mut self, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
        let mut turn = rotation.scaled_axis();
        let angle = turn.norm();
        if angle > 0.75 * std::f64::consts::PI {
            if self.axis.is_some_and(|axis| axis.dot(&turn) < 0.0) {
                turn *= (angle - std::f64::consts::TAU) / angle;
            }
            self.axis = turn.try_normalize(1e-12);
        } else {
            self.axis = None;
        }
        turn
    }

    fn judge(&mut self, (distance, angle, error): (f64, f64, f64), age: f64) -> Option<ServoStatus> {
        let c = &self.config;
        let near =
            age <= FRESH * c.lost_after && distance <= c.position_tolerance && angle <= c.rotation_tolerance;
        self.held = if near { self.held + 1 } else { 0 };
        if near && self.held >= c.hold_frames.max(1) {
            return Some(ServoStatus::Converged);
        }
        self.smallest = self.smallest.min(error);
        let grown = error > self.smallest * c.divergence + 0.01;
        self.growing = if grown { self.growing + 1 } else { 0 };
        (self.growing >= c.hold_frames.max(1)).then_some(ServoStatus::Diverged)
    }
}

fn still(distance: f64, angle: f64, status: ServoStatus) -> ServoCommand {
    let (linear, angular) = (Vector3::zeros(), Vector3::zeros());
    ServoCommand { linear, angular, distance, angle, rate: 0.0, status }
}

/// Slows hands that go to one thing down to the slowest of those that are still on their way, so that the errors of all fall at one
/// rate and all arrive together.
pub fn in_step(commands: &mut [ServoCommand]) {
    let running = |c: &&ServoCommand| c.status == ServoStatus::Running;
    let slowest = commands.iter().filter(running).map(|c| c.rate).fold(f64::INFINITY, f64::min);
    for command in commands.iter_mut().filter(|c| c.rate > slowest) {
        let share = slowest / command.rate;
        command.linear *= share;
        command.angular *= share;
        command.rate = slowest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn pose(t: [f64; 3], r: [f64; 3]) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(t), UnitQuaternion::from_scaled_axis(Vector3::from(r)))
    }

    fn follow(hand: Isometry3<f64>, c: &ServoCommand, dt: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::from(hand.translation.vector + c.linear * dt),
            UnitQuaternion::from_scaled_axis(c.angular * dt) * hand.rotation,
        )
    }

    #[test]
    fn it_goes_straight_and_stops() {
        let config = ServoConfig {
            position_tolerance: 5e-4,
            rotation_tolerance: 0.5_f64.to_radians(),
            ..ServoConfig::default()
        };
        let mut servo = PositionServo::new(config).unwrap();
        let target = pose([0.3, 0.5, 1.0], [0.1, 0.0, 0.2]);
        let deg = |a: f64| a.to_radians();
        let mut hand = target * pose([0.15, -0.1, 0.25], [deg(20.0), deg(-30.0), deg(60.0)]);
        let start = hand;
        let (mut length, mut steps) = (0.0, 0);
        let last = loop {
            let c = servo.step(0.04, Some(&ServoObservation { hand, target })).unwrap();
            steps += 1;
            if c.status != ServoStatus::Running {
                break c;
            }
            length += c.linear.norm() * 0.04;
            assert!(c.linear.norm() < 0.15 + 1e-12 && c.angular.norm() < 0.6 + 1e-12);
            hand = follow(hand, &c, 0.04);
        };
        assert_eq!(last.status, ServoStatus::Converged);
        let straight = (start.translation.vector - target.translation.vector).norm();
        assert!(length / straight < 1.001, "{}", length / straight);
        assert!(f64::from(steps) * 0.04 < 8.0);
    }

    /// When both hands come within 5 mm of their targets, s, and the longest way of one that was not seen for a second.
    fn arrivals(ways: [f64; 2], unseen: [std::ops::Range<f64>; 2]) -> [f64; 2] {
        let target = Isometry3::identity();
        let config = ServoConfig { lost_after: 1.5, ..ServoConfig::default() };
        let mut servos = [0, 1].map(|_| PositionServo::new(config.clone()).unwrap());
        let mut hands = ways.map(|way| pose([way, 0.0, 0.0], [0.0; 3]));
        let (mut seen_at, mut arrived, mut t) = ([0.0; 2], [f64::NAN; 2], 0.0);
        while arrived.iter().any(|at| at.is_nan()) && t < 20.0 {
            t += 0.02;
            let mut commands = [0, 1].map(|i| {
                if !unseen[i].contains(&t) {
                    seen_at[i] = t;
                }
                let seen = ServoObservation { hand: hands[i], target };
                servos[i].step_aged(0.02, Some((&seen, t - seen_at[i]))).unwrap()
            });
            in_step(&mut commands);
            for i in 0..2 {
                hands[i] = follow(hands[i], &commands[i], 0.02);
                if arrived[i].is_nan() && hands[i].translation.vector.norm() < 0.005 {
                    arrived[i] = t;
                }
            }
        }
        arrived
    }

    #[test]
    fn hands_in_step_arrive_together_also_when_one_is_not_seen_for_a_second() {
        for ways in [[0.1, 0.1], [0.12, 0.1], [0.09, 0.11]] {
            for unseen in [[0.0..0.0, 0.0..0.0], [0.5..1.5, 0.0..0.0], [0.0..0.0, 0.8..1.8]] {
                let [first, second] = arrivals(ways, unseen.clone());
                assert!((first - second).abs() < 0.2, "{ways:?} {unseen:?}: {first} {second}");
            }
        }
    }

    #[test]
    fn what_was_seen_long_ago_slows_the_hand_and_is_lost_in_the_end() {
        let seen = ServoObservation { hand: pose([0.05, 0.0, 0.0], [0.0; 3]), target: Isometry3::identity() };
        let speed = |age: f64| {
            let mut servo = PositionServo::new(ServoConfig::default()).unwrap();
            let command = servo.step_aged(0.04, Some((&seen, age))).unwrap();
            (command.linear.norm(), command.status)
        };
        let (new, half) = (speed(0.0).0, speed(0.5).0);
        assert!((half - new / 2.0).abs() < 1e-12, "{new} {half}");
        assert_eq!(speed(1.1), (0.0, ServoStatus::Lost));
        // At the target, but seen too long ago to count.
        let there = ServoObservation { hand: Isometry3::identity(), target: Isometry3::identity() };
        let mut servo = PositionServo::new(ServoConfig::default()).unwrap();
        let late = (0..50).map(|_| servo.step_aged(0.04, Some((&there, 0.4))).unwrap().status);
        assert!(late.last() == Some(ServoStatus::Running));
    }

    #[test]
    fn near_a_half_turn_it_keeps_its_side() {
        let mut servo = PositionServo::new(ServoConfig::default()).unwrap();
        let target = Isometry3::identity();
        let mut first = None;
        for k in 0..20 {
            let angle = std::f64::consts::PI + if k % 2 == 0 { 0.02 } else { -0.02 };
            let hand = pose([0.0; 3], [0.0, 0.0, angle]);
            let c = servo.step(0.04, Some(&ServoObservation { hand, target })).unwrap();
            let sign = *first.get_or_insert(c.angular.z.signum());
            assert_eq!(c.angular.z.signum(), sign);
        }
    }

    #[test]
    fn it_says_why_it_ends() {
        let target = Isometry3::identity();
        let away = |x: f64| ServoObservation { hand: pose([x, 0.0, 0.0], [0.0; 3]), target };
        let run = |observe: &dyn Fn(u32) -> Option<ServoObservation>| {
            let mut servo = PositionServo::new(ServoConfig::default()).unwrap();
            (0..1000)
                .map(|k| servo.step(0.04, observe(k).as_ref()).unwrap())
                .find(|c| c.status != ServoStatus::Running)
                .map(|c| (c.status, c.linear.norm()))
        };
        assert_eq!(run(&|_| Some(away(0.2))), Some((ServoStatus::TimedOut, 0.0)));
        assert_eq!(run(&|k| (k < 10).then(|| away(0.2))), Some((ServoStatus::Lost, 0.0)));
        assert_eq!(run(&|k| Some(away(0.1 + 0.01 * f64::from(k)))), Some((ServoStatus::Diverged, 0.0)));
        assert_eq!(run(&|_| Some(away(0.001))), Some((ServoStatus::Converged, 0.0)));
    }
}
