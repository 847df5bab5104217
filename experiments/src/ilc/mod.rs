//! Two arms learn to carry a box together (Gams et al. 2015, III-V): the right arm moves as demonstrated; the left arm
//! learns from epoch to epoch to keep the distance, by current-iteration learning control with feedback-error learning.

use std::f64::consts::TAU;

use armarium_motion::{
    DiscretePeriodicConfig, DiscretePeriodicDmp, FeedbackError, LearningControl, LearningControlConfig,
    LiftAndShake, MotionError, differentiate,
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3, Vector4, Vector6};
use serde::{Deserialize, Serialize};

use super::arm4::Arm4;
use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult};
use super::settings::{ExperimentSettings as _, Setting, settings};

/// The space of the primitives and of the learned control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Space {
    /// Angles of the arm's joints, as in the paper's experiment.
    Joint,
    /// Coordinates of the hand.
    Task,
}

impl Setting for Space {}

settings! {
    /// Settings of the arms and of the learning.
    Ilc {
        /// Stiffness of the box between the hands, N/m.
        stiffness: f64 = 500.0, 1e-3..=1e6;
        /// K1 of (14), joint space.
        k1: f64 = 0.3, -1e3..=1e3;
        /// K1 in task space.
        k1_task: f64 = 0.03, -1e3..=1e3;
        /// K2 of (14); 0 gives (10).
        k2: f64 = 1.0, -1e3..=1e3;
        /// Q of (11).
        q: f64 = 1.0;
        /// L of (11).
        l: f64 = 0.3;
        /// C of (11).
        c: f64 = 0.3;
        /// Epochs of learning.
        epochs: usize = 10, 1.0..=200.0;
        /// Space of the learning: joint or task.
        space: Space = Space::Joint;
        /// Feeds back moments and rotations as well (joint space).
        orientation: bool = false;
        /// Rotational stiffness of the box, N m/rad.
        turn_stiffness: f64 = 2.0, 0.0..=1e6;
        /// Duration T of the discrete part, s.
        duration: f64 = 1.0, 0.05..=60.0;
        /// Periods of the periodic part in an epoch.
        periods: u32 = 3, 1.0..=100.0;
        /// Length of a period, s.
        period: f64 = 1.0, 0.05..=60.0;
        /// Step, s.
        dt: f64 = 0.002;
        /// Constant of (1).
        alpha_z: f64 = 8.0;
        /// Constant of (1).
        beta_z: f64 = 2.0;
        /// Periodic kernels N.
        n: usize = 25;
        /// Discrete kernels M.
        m: usize = 25;
        /// Ridge parameter of both regressions.
        ridge: f64 = 1e-8;
        /// Links of the arms, m.
        links: [f64; 2] = [0.3, 0.3], 1e-3..=10.0;
        /// Distance of the shoulders from the middle, m.
        shoulder: f64 = 0.2, -10.0..=10.0;
        /// Distance of the hands in front, and from the middle, m.
        hand: [f64; 2] = [0.35, 0.15], -10.0..=10.0;
        /// Height of the hands at the start, m.
        start: f64 = -0.25, -10.0..=10.0;
        /// Height by which the right hand lifts, m.
        lift: f64 = 0.15, -10.0..=10.0;
        /// Amplitude of the right hand's oscillation, m.
        amplitude: f64 = 0.04, -10.0..=10.0;
        /// Height in the left hand's demonstration, m.
        left_lift: f64 = 0.08, -10.0..=10.0;
        /// Amplitude in the left hand's demonstration, m.
        left_amplitude: f64 = 0.02, -10.0..=10.0;
        /// Phase of the left hand's demonstration relative to the right hand's, rad.
        left_phase: f64 = 0.6;
        /// Posture that attracts the left arm's demonstration, rad; the right arm's is its mirror image.
        posture: [f64; 4] = [-0.6, -0.1, 0.3, -1.3], -TAU..=TAU;
    }
}

/// The log of an epoch, one entry per step.
#[derive(Default)]
pub(super) struct Epoch {
    pub(super) left: Vec<Vector4<f64>>,
    /// Positions of the hands, m, and their velocities, m/s: right, left.
    pub(super) x: Vec<[Vector3<f64>; 2]>,
    pub(super) v: Vec<[Vector3<f64>; 2]>,
    /// Angle between the hands relative to the start, rad.
    pub(super) turned: Vec<f64>,
}

/// All epochs with one kind of feedback.
pub(super) struct Learning {
    /// Without learning and feedback.
    pub(super) before: Epoch,
    pub(super) epochs: Vec<Epoch>,
    pub(super) right: Vec<Vector4<f64>>,
    /// The epoch in which the motion diverged, counted from 1.
    pub(super) diverged: Option<usize>,
}

impl Experiment for Ilc {
    const NAME: &'static str = "ilc";
    const ABOUT: &'static str = "two arms learn to carry a box (Gams et al. 2015, Figs 1, 2, 3, 5, 6)";
    const ALIASES: &'static [(&'static str, &'static str)] =
        &[("periodic_kernels", "n"), ("discrete_kernels", "m")];

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let learning = self.learn(self.k2)?;
        let forces_only = self.learn(0.0)?;
        let mut outcome = ExperimentResult::default();
        self.figures(&learning, &forces_only, &mut outcome);
        outcome.plot("ilc", self.plot_epochs(&learning));
        outcome.plot("ilc_joints", self.plot_joints(&learning));
        outcome.plot("ilc_feedback", self.plot_feedback(&learning, &forces_only));
        Ok(outcome)
    }
}

/// Runs `count` epochs, numbered from 1, until one fails: the user sets the gains, so an unstable motion is a valid
/// result. Returns the epochs before it, and its number.
pub(super) fn until_diverged<T, E>(
    count: usize,
    mut epoch: impl FnMut(usize) -> Result<T, E>,
) -> (Vec<T>, Option<usize>) {
    let mut epochs = Vec::new();
    for number in 1..=count {
        match epoch(number) {
            Ok(epoch) => epochs.push(epoch),
            Err(_) => return (epochs, Some(number)),
        }
    }
    (epochs, None)
}

/// Learns a motion from positions, one every `dt` s.
pub(super) fn learned(
    config: DiscretePeriodicConfig,
    omega: f64,
    duration: f64,
    dt: f64,
    positions: &[Vec<f64>],
) -> Result<DiscretePeriodicDmp, ExperimentError> {
    let mut dmp = DiscretePeriodicDmp::new(config, omega, duration)?;
    dmp.learn(&differentiate(dt, positions)?)?;
    Ok(dmp)
}

impl Ilc {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        within("dt", self.dt, 1e-4, 0.05 * self.period.min(self.duration))?;
        within("steps of an epoch", self.steps() as f64, 20.0, 200_000.0)?;
        if self.orientation && self.space == Space::Task {
            let why = "needs space=joint: the primitives of task space are of positions".to_owned();
            return Err(ExperimentError::Setting { key: "orientation".into(), why });
        }
        Ok(())
    }

    fn omega(&self) -> f64 {
        TAU / self.period
    }

    pub(super) fn steps(&self) -> usize {
        ((self.duration + f64::from(self.periods) * self.period) / self.dt).round() as usize
    }

    pub(super) fn discrete_steps(&self) -> usize {
        (self.duration / self.dt).round() as usize
    }

    fn arm(&self, side: f64) -> Arm4 {
        Arm4 { shoulder: Vector3::new(0.0, side * self.shoulder, 0.0), links: self.links }
    }

    fn lift(&self, lift: f64, amplitude: f64, phase: f64) -> LiftAndShake {
        LiftAndShake { lift, amplitude, phase, omega: self.omega(), duration: self.duration }
    }

    /// Joint angles of the demonstration of one arm, one entry per step.
    fn demonstrate(&self, side: f64) -> Result<Vec<Vector4<f64>>, ExperimentError> {
        let arm = self.arm(side);
        let [a, b, c, d] = self.posture;
        let posture = Vector4::new(a, side * b, side * c, d);
        let lift = if side > 0.0 {
            self.lift(self.left_lift, self.left_amplitude, self.left_phase)
        } else {
            self.lift(self.lift, self.amplitude, 0.0)
        };
        let mut q = posture;
        let mut path = Vec::new();
        for k in 0..=self.steps() {
            let t = self.dt * k as f64;
            let x = Vector3::new(self.hand[0], side * self.hand[1], self.start + lift.at(t)[0]);
            q = arm.inverse(x, posture, q).ok_or_else(|| {
                ExperimentError::Failed(format!(
                    "an arm does not reach ({:.3}, {:.3}, {:.3}) m",
                    x.x, x.y, x.z
                ))
            })?;
            path.push(q);
        }
        Ok(path)
    }

    fn primitive(&self, positions: &[Vec<f64>]) -> Result<DiscretePeriodicDmp, ExperimentError> {
        let dofs = positions.first().map_or(1, Vec::len);
        let config = DiscretePeriodicConfig {
            discrete_kernels: self.m,
            periodic_kernels: self.n,
            alpha_z: self.alpha_z,
            beta_z: self.beta_z,
            ridge: self.ridge,
            ..DiscretePeriodicConfig::with_dofs(dofs)
        };
        learned(config, self.omega(), self.duration, self.dt, positions)
    }

    fn learn(&self, k2: f64) -> Result<Learning, ExperimentError> {
        let joints = |q: &[Vector4<f64>]| q.iter().map(|q| q.as_slice().to_vec()).collect::<Vec<_>>();
        let left_shown = self.demonstrate(1.0)?;
        let mut right = self.primitive(&joints(&self.demonstrate(-1.0)?))?;
        let mut left = match self.space {
            Space::Joint => self.primitive(&joints(&left_shown))?,
            Space::Task => {
                let hand = |q: &Vector4<f64>| self.arm(1.0).hand(q).translation.vector.as_slice().to_vec();
                self.primitive(&left_shown.iter().map(hand).collect::<Vec<_>>())?
            }
        };
        let config = LearningControlConfig { q: self.q, l: self.l, c: self.c };
        let mut control = LearningControl::new(config, left.dofs(), self.steps() + 1)?;
        let k1 = if self.space == Space::Joint { self.k1 } else { self.k1_task };
        let gains = FeedbackError { k1, k2, ..FeedbackError::default() };
        let silent = FeedbackError { k1: 0.0, k2: 0.0, ..gains };
        let before = self.epoch(&mut right, &mut left, &mut control, silent, left_shown[0])?;
        control.abandon();
        let right_joints = self.right_joints(&mut right)?;
        let (epochs, diverged) = until_diverged(self.epochs, |_| {
            let epoch = self.epoch(&mut right, &mut left, &mut control, gains, left_shown[0])?;
            control.finish(&mut left).map(|()| epoch)
        });
        Ok(Learning { before, epochs, right: right_joints, diverged })
    }

    fn right_joints(&self, right: &mut DiscretePeriodicDmp) -> Result<Vec<Vector4<f64>>, ExperimentError> {
        right.restart();
        let mut path = vec![Vector4::from_column_slice(right.state().y)];
        for _ in 0..self.steps() {
            path.push(Vector4::from_column_slice(right.step(self.dt, self.omega())?.y));
        }
        Ok(path)
    }

    /// One discrete part and its periods, both arms together, with feedback from the box's force by `gains`.
    fn epoch(
        &self,
        right: &mut DiscretePeriodicDmp,
        left: &mut DiscretePeriodicDmp,
        control: &mut LearningControl,
        gains: FeedbackError,
        posture: Vector4<f64>,
    ) -> Result<Epoch, MotionError> {
        right.restart();
        left.restart();
        let mut epoch = Epoch::default();
        let mut near = posture;
        let mut grasp = None;
        for _ in 0..=self.steps() {
            let hands = [self.right_hand(right), self.left_hand(left, &mut near)];
            let grasp =
                *grasp.get_or_insert_with(|| hands[0].pose.rotation.inverse() * hands[1].pose.rotation);
            let (wrench, twist, turned) = self.box_between(&hands, grasp);
            let mut error = [0.0; 4];
            let error = &mut error[..left.dofs()];
            match (self.space, self.orientation) {
                (Space::Task, _) => {
                    gains.in_task_space(&wrench.as_slice()[..3], &twist.as_slice()[..3], error)?
                }
                (Space::Joint, true) => gains.in_joint_space(&hands[1].columns, &wrench, &twist, error)?,
                (Space::Joint, false) => {
                    let linear = |v: &Vector6<f64>| Vector3::new(v[0], v[1], v[2]);
                    let columns = hands[1].columns.each_ref().map(linear);
                    gains.in_joint_space(&columns, &linear(&wrench), &linear(&twist), error)?;
                }
            }
            epoch.left.push(near);
            epoch.x.push(hands.each_ref().map(|h| h.pose.translation.vector));
            epoch.v.push(hands.each_ref().map(|h| Vector3::new(h.twist[0], h.twist[1], h.twist[2])));
            epoch.turned.push(turned);
            control.step(left, self.omega(), error)?;
            left.step(self.dt, self.omega())?;
            right.step(self.dt, self.omega())?;
        }
        Ok(epoch)
    }

    fn right_hand(&self, right: &DiscretePeriodicDmp) -> HandState {
        let state = right.state();
        HandState::of(
            self.arm(-1.0),
            &Vector4::from_column_slice(state.y),
            &Vector4::from_column_slice(state.yd),
        )
    }

    /// The state of the left hand; updates `near` to its joint angles.
    fn left_hand(&self, left: &DiscretePeriodicDmp, near: &mut Vector4<f64>) -> HandState {
        let state = left.state();
        if self.space == Space::Joint {
            *near = Vector4::from_column_slice(state.y);
            return HandState::of(self.arm(1.0), near, &Vector4::from_column_slice(state.yd));
        }
        let x = Vector3::from_column_slice(state.y);
        // Where the arm does not reach, the angles stay; only the hand's motion is learned.
        *near = self.arm(1.0).inverse(x, *near, *near).unwrap_or(*near);
        let mut hand = HandState::of(self.arm(1.0), near, &Vector4::zeros());
        hand.pose.translation.vector = x;
        hand.twist = Vector6::new(state.yd[0], state.yd[1], state.yd[2], 0.0, 0.0, 0.0);
        hand
    }

    /// `F_d - F_2` with moments (N, N m), the velocity of the right hand relative to the left (m/s, rad/s), and the
    /// rotation between the hands, rad. The box was grasped without force.
    fn box_between(
        &self,
        hands: &[HandState; 2],
        grasp: UnitQuaternion<f64>,
    ) -> (Vector6<f64>, Vector6<f64>, f64) {
        let [right, left] = hands;
        let apart = Vector3::new(0.0, 2.0 * self.hand[1], 0.0);
        let force = self.stiffness * (right.pose.translation.vector + apart - left.pose.translation.vector);
        let turn = (right.pose.rotation * grasp * left.pose.rotation.inverse()).scaled_axis();
        let moment = self.turn_stiffness * turn;
        let wrench = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
        (wrench, right.twist - left.twist, turn.norm())
    }
}

/// The state of a moving hand.
struct HandState {
    pose: Isometry3<f64>,
    columns: [Vector6<f64>; 4],
    /// Linear and angular velocity, m/s, rad/s.
    twist: Vector6<f64>,
}

impl HandState {
    fn of(arm: Arm4, q: &Vector4<f64>, speed: &Vector4<f64>) -> Self {
        let columns = arm.jacobian(q);
        let twist = columns.iter().zip(speed.iter()).map(|(c, s)| c * *s).sum();
        Self { pose: arm.hand(q), columns, twist }
    }
}

#[cfg(test)]
mod tests;
