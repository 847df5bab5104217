//! The box task of Gams et al. 2015 (Fig. 4, V) on both arms of ARMAR-III in the simulator's physics. The right arm
//! lifts a box and shakes it as demonstrated. The left arm's demonstration is too small and out of phase; from epoch to
//! epoch it learns to follow, using the forces that both palms sense.
//!
//! Each epoch starts with the box on its table. The learner uses sensed joints and palm forces; the figures are
//! computed by the referee.

use std::f64::consts::TAU;

use armarium_motion::{
    DiscretePeriodicConfig, DiscretePeriodicDmp, FeedbackError, LearningControl, LearningControlConfig,
    LiftAndShake,
};
use armarium_simulator::carrying::{CarriedBox, Carrying, CarryingFigures, CarryingRecord, PalmSensed};
use armarium_simulator::start::MountedPad;
use armarium_simulator::world::{NoiseSpec, PadSpec};
use nalgebra::{Point3, Vector3, Vector6};

use super::dual_arm_robot::{Arms, JOINTS, Joints};
use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult};
use super::ilc::{learned, until_diverged};
use super::settings::{Settings as _, settings};

settings! {
    /// Settings of the box, the arms and the learning; root frame: x right, y forward, z up.
    DualArm {
        /// Mass of the box, kg.
        mass: f64 = 1.5, 0.05..=10.0;
        /// Its width between the hands, depth and height, m.
        size: [f64; 3] = [0.44, 0.3, 0.24], 0.05..=1.0;
        /// Centre of the box at the start, m.
        at: [f64; 3] = [0.0, 0.45, 1.02], -10.0..=10.0;
        /// Force of the hands on the box, N.
        squeeze: f64 = 60.0;
        /// Stiffness of a hand's pad in its normal direction, N/m.
        stiffness: f64 = 6000.0, 100.0..=20_000.0;
        /// Shear stiffness of a hand's pad, N/m.
        shear_stiffness: f64 = 2000.0, 100.0..=20_000.0;
        /// Half edge lengths of a pad, along the fingers and up, m.
        pad: [f64; 2] = [0.08, 0.09], 0.005..=0.5;
        /// Friction coefficient between pad and box.
        friction: f64 = 0.9, 0.0..=3.0;
        /// K1 of (14).
        k1: f64 = 3.0, -1e3..=1e3;
        /// Weights of the components in (10): forces along x, y, z, and moments about them, 1/m^2. A stiff box needs
        /// small ones.
        weights: [f64; 6] = [0.1, 1.0, 1.0, 1.0, 1.0, 1.0], 0.0..=1e4;
        /// K2 of (14); 0 gives (10).
        k2: f64 = 1.0, -1e3..=1e3;
        /// Cut-off frequency of the low-pass filter on the palms' forces, Hz.
        filter: f64 = 20.0, 0.1..=1e4;
        /// Q of (11).
        q: f64 = 1.0;
        /// L of (11).
        l: f64 = 0.3;
        /// C of (11).
        c: f64 = 0.3;
        /// Epochs of learning.
        epochs: usize = 10, 1.0..=100.0;
        /// Duration T of the discrete part, s.
        duration: f64 = 1.5, 0.2..=20.0;
        /// Periods of the periodic part in an epoch.
        periods: u32 = 3, 1.0..=20.0;
        /// Length of a period, s.
        period: f64 = 1.2, 0.2..=20.0;
        /// Height by which the right hand lifts, m.
        lift: f64 = 0.12, -10.0..=10.0;
        /// Amplitude of the right hand's shaking, m.
        amplitude: f64 = 0.03, -10.0..=10.0;
        /// Height in the left hand's demonstration, m.
        left_lift: f64 = 0.08, -10.0..=10.0;
        /// Amplitude in the left hand's demonstration, m.
        left_amplitude: f64 = 0.015, -10.0..=10.0;
        /// Phase of the left hand's demonstration relative to the right hand's, rad.
        left_phase: f64 = 0.6;
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
        /// White noise of a palm's force sensor, N per axis; of its torque 1/20 of it, N m.
        noise: f64 = 0.3, 0.0..=20.0;
        /// Standard deviation of the force sensor's offset, N; only changes since the grasp are used.
        bias: f64 = 1.0, 0.0..=100.0;
        /// Seed of noise and offset.
        seed: u64 = 1;
    }
}

/// Middle of the palm, TCP frame, along the fingers, m.
const PALM_MIDDLE: f64 = -0.03;
/// From the TCP to the inner side of the hand, m.
const HAND_HALF: f64 = 0.05;
/// Distance of the waiting hands from the box, m.
const WAIT_DISTANCE: f64 = 0.03;
/// Durations of closing the hands, and of holding before the motion begins, s.
const CLOSE: f64 = 0.8;
const HOLD: f64 = 0.6;
/// Interval at the end of the holding over which the palms' forces are averaged, s.
const AVERAGING_TIME: f64 = 0.2;
const DT: f64 = Carrying::DT;

/// The result of an epoch: the referee's figures and log from the start of the motion, the largest commanded joint
/// speed, rad/s, and the smallest distance from a joint limit, rad.
pub(super) struct Epoch {
    pub(super) figures: CarryingFigures,
    pub(super) log: Vec<CarryingRecord>,
    pub(super) speed: f64,
    pub(super) margin: f64,
}

/// The demonstrated motions of both arms.
struct Demonstrations {
    open: [Joints; 2],
    right: DiscretePeriodicDmp,
    left: DiscretePeriodicDmp,
}

impl Experiment for DualArm {
    const NAME: &'static str = "dual_arm";
    const ABOUT: &'static str = "both arms of ARMAR-III carry and shake a box (Gams et al. 2015, Fig. 4)";
    const ALIASES: &'static [(&'static str, &'static str)] =
        &[("periodic_kernels", "n"), ("discrete_kernels", "m")];

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let mut arms = Arms::new()?;
        let mut demonstrations = self.demonstrate(&mut arms)?;
        let config = LearningControlConfig { q: self.q, l: self.l, c: self.c };
        let mut control = LearningControl::new(config, JOINTS, self.steps() + 1)?;
        let gains = FeedbackError { k1: self.k1, k2: self.k2, ..FeedbackError::default() };
        let silent = FeedbackError { k1: 0.0, k2: 0.0, ..gains };
        let before = self.epoch(&mut arms, &mut demonstrations, &mut control, silent, 0)?;
        control.abandon();
        let (epochs, diverged) = until_diverged(self.epochs, |number| {
            let epoch = self.epoch(&mut arms, &mut demonstrations, &mut control, gains, number)?;
            control.finish(&mut demonstrations.left)?;
            Ok::<_, ExperimentError>(epoch)
        });
        let mut outcome = ExperimentResult::default();
        self.figures(&before, &epochs, diverged, &mut outcome);
        outcome.plot("dual_arm", self.plot(&before, &epochs));
        Ok(outcome)
    }
}

impl DualArm {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        within("squeeze", self.squeeze, 0.1, 0.025 * self.stiffness)
    }

    fn omega(&self) -> f64 {
        TAU / self.period
    }

    fn steps(&self) -> usize {
        ((self.duration + f64::from(self.periods) * self.period) / DT).round() as usize
    }

    fn carried(&self) -> CarriedBox {
        let Self { stiffness, shear_stiffness, friction, pad: half, .. } = *self;
        let pad = PadSpec { stiffness, shear_stiffness, friction, half, ..PadSpec::default() };
        // In both hands, y points to the robot's left: to the inner side of the right hand, and to the outer side of the left.
        let mounted = |inner: f64| MountedPad {
            spec: pad,
            middle: Point3::new(0.0, inner * (HAND_HALF + pad.thickness), PALM_MIDDLE),
            edges: [Vector3::z(), Vector3::x()],
            normal: Vector3::y() * inner,
        };
        CarriedBox { mass: self.mass, size: self.size, at: self.at, pads: [mounted(1.0), mounted(-1.0)] }
    }

    /// Position of a hand that presses on the resting box, or waits beside it.
    fn hand_position(&self, side: usize, gap: f64) -> Vector3<f64> {
        let out = self.size[0] / 2.0 + HAND_HALF + PadSpec::default().thickness + gap;
        Vector3::from(self.at) + Vector3::x() * if side == 0 { out } else { -out }
    }

    /// The demonstrated height of a hand.
    fn lift(&self, side: usize) -> LiftAndShake {
        let (lift, amplitude, phase) = if side == 0 {
            (self.lift, self.amplitude, 0.0)
        } else {
            (self.left_lift, self.left_amplitude, self.left_phase)
        };
        LiftAndShake { lift, amplitude, phase, omega: self.omega(), duration: self.duration }
    }

    fn demonstrate(&self, arms: &mut Arms) -> Result<Demonstrations, ExperimentError> {
        let pressed = -self.squeeze / self.stiffness;
        let mut primitives = Vec::new();
        let mut open = [Joints::zeros(); 2];
        for (side, open) in open.iter_mut().enumerate() {
            *open = arms.inverse(side, self.hand_position(side, WAIT_DISTANCE), &Arms::posture(side))?;
            let (mut q, lift) = (*open, self.lift(side));
            let mut path = Vec::with_capacity(self.steps() + 1);
            for k in 0..=self.steps() {
                let up = Vector3::z() * lift.at(DT * k as f64)[0];
                q = arms.inverse(side, self.hand_position(side, pressed) + up, &q)?;
                path.push(q.as_slice().to_vec());
            }
            primitives.push(self.primitive(&path)?);
        }
        let [right, left] = <[DiscretePeriodicDmp; 2]>::try_from(primitives)
            .map_err(|_| ExperimentError::Failed("two arms make two motions".into()))?;
        Ok(Demonstrations { open, right, left })
    }

    fn primitive(&self, path: &[Vec<f64>]) -> Result<DiscretePeriodicDmp, ExperimentError> {
        let config = DiscretePeriodicConfig {
            discrete_kernels: self.m,
            periodic_kernels: self.n,
            alpha_z: self.alpha_z,
            beta_z: self.beta_z,
            ridge: self.ridge,
            ..DiscretePeriodicConfig::with_dofs(JOINTS)
        };
        learned(config, self.omega(), self.duration, DT, path)
    }

    /// The hands grasp the box; then one discrete part and its periods, with feedback from the palms' forces by
    /// `gains`.
    fn epoch(
        &self,
        arms: &mut Arms,
        demonstrations: &mut Demonstrations,
        control: &mut LearningControl,
        gains: FeedbackError,
        number: usize,
    ) -> Result<Epoch, ExperimentError> {
        let Demonstrations { open, right, left } = demonstrations;
        right.restart();
        left.restart();
        let noise = NoiseSpec { wrench: self.noise, wrench_bias: self.bias, ..NoiseSpec::default() };
        let seed = self.seed.wrapping_mul(1000).wrapping_add(number as u64);
        let start = arms.all(open);
        let mut scene = Carrying::new(arms.model(), &self.carried(), &noise, &start, seed)
            .map_err(|error| ExperimentError::Failed(error.to_string()))?;
        let grasp = self.take(&mut scene, arms, open, &[joints(right.state().y), joints(left.state().y)]);
        let mut felt = grasp;
        let referee = scene.referee();
        let from = referee.len();
        let (mut position, mut velocity) = (start.clone(), vec![0.0; start.len()]);
        let (mut speed, mut margin) = (0.0_f64, f64::INFINITY);
        for _ in 0..=self.steps() {
            let error = self.error(&scene, arms, &grasp, &mut felt, gains)?;
            control.step(left, self.omega(), error.as_slice())?;
            let states = [right.step(DT, self.omega())?, left.step(DT, self.omega())?];
            let (q, qd) = (states.map(|s| joints(s.y)), states.map(|s| joints(s.yd)));
            arms.write(&q, &mut position);
            arms.write(&qd, &mut velocity);
            scene.step(&position, &velocity);
            speed = qd.iter().map(Joints::amax).fold(speed, f64::max);
            margin = (0..2).map(|side| arms.margin(side, &q[side])).fold(margin, f64::min);
        }
        let figures = referee.judge(from).unwrap_or_default();
        Ok(Epoch { figures, log: referee.log().split_off(from), speed, margin })
    }

    /// The error of (14): the internal force at the grasp minus the sensed one, and the velocity of the right hand
    /// relative to the left.
    fn error(
        &self,
        scene: &Carrying,
        arms: &mut Arms,
        grasp: &Vector6<f64>,
        felt: &mut Vector6<f64>,
        gains: FeedbackError,
    ) -> Result<Joints, ExperimentError> {
        arms.update(scene.position());
        let columns = [arms.columns(0), arms.columns(1)];
        let twist = |side: usize| -> Vector6<f64> {
            let qd = arms.of(side, scene.velocity());
            columns[side].iter().zip(qd.iter()).map(|(c, v)| c * *v).sum()
        };
        let now = self.internal(arms, scene.palms());
        *felt += (now - *felt) * (DT / (DT + 1.0 / (TAU * self.filter)));
        let wrench = (grasp - *felt).component_mul(&Vector6::from(self.weights));
        let mut error = Joints::zeros();
        gains.in_joint_space(&columns[1], &wrench, &(twist(0) - twist(1)), error.as_mut_slice())?;
        Ok(error)
    }

    /// The internal force of the left hand on the box against the right one: half the difference of forces, N, and of
    /// moments about the centre of the pad, N m. Common parts, such as weight and inertia of the box, cancel.
    fn internal(&self, arms: &Arms, palms: &[PalmSensed; 2]) -> Vector6<f64> {
        let carried = self.carried();
        let at_pad = |side: usize| {
            let PalmSensed { force, torque } = palms[side];
            let lever = arms.rotation(side) * carried.pads[side].middle.coords;
            let moment = torque - lever.cross(&force);
            Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z)
        };
        (at_pad(0) - at_pad(1)) / 2.0
    }

    /// The hands close on the box and hold; returns the left hand's internal force. The sensors' offset is included, as
    /// in all later measurements.
    fn take(
        &self,
        scene: &mut Carrying,
        arms: &mut Arms,
        open: &[Joints; 2],
        closed: &[Joints; 2],
    ) -> Vector6<f64> {
        let steps = |seconds: f64| (seconds / DT).round() as usize;
        let mut mean = Vector6::zeros();
        for k in 0..steps(CLOSE + HOLD) {
            let s = (k as f64 * DT / CLOSE).min(1.0);
            let way = s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s);
            let rate = 30.0 * s * s * (1.0 - s).powi(2) / CLOSE;
            let q = [0, 1].map(|side| open[side] + (closed[side] - open[side]) * way);
            let qd = [0, 1].map(|side| (closed[side] - open[side]) * rate);
            scene.step(&arms.all(&q), &arms.all(&qd));
            if k >= steps(CLOSE + HOLD - AVERAGING_TIME) {
                arms.update(scene.position());
                mean += self.internal(arms, scene.palms()) / steps(AVERAGING_TIME) as f64;
            }
        }
        mean
    }
}

fn joints(values: &[f64]) -> Joints {
    Joints::from_column_slice(values)
}

#[cfg(test)]
mod tests;
