//! The discrete-periodic primitive: an initial transient movement that flows into a periodic one, in a single system of n
//! degrees of freedom on one phase (r, phi).
//!
//! The phase starts far from its limit cycle, where the kernels of the discrete part lie along its spiral, and settles on
//! the cycle, where only the phase angle and the periodic kernels are left. `discrete_periodic/phase.rs` is the canonical
//! system, `kernels.rs` the two kernel sets, `learning.rs` the regression. A control signal on the same kernels is
//! learned by [`crate::LearningControl`].
//!
//! Equation numbers refer to Gams, Ude and Morimoto, "Efficient synchronization of dual-arm humanoid robot movement
//! primitives", IROS 2015.

mod config;
mod kernels;
mod learning;
mod phase;
mod saved;

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::error::{LARGEST, MotionError, finite, positive, vector, within};
use crate::pdmp::Transition;

pub use self::config::DiscretePeriodicConfig;
use self::kernels::BlendedKernels;
pub use self::learning::differentiate;
pub use self::phase::{CanonicalRule, CanonicalSystem};
use self::saved::Saved;

/// What a step yields; the slices have one value a degree of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscretePeriodicState<'a> {
    /// Phase angle phi, rad; from `-omega T` over 0, where the periodic part begins, on and on.
    pub phase: f64,
    /// Distance r of the phase from the centre of its limit cycle, dimensionless; it falls to mu.
    pub radius: f64,
    /// Position, in the unit of the degree of freedom.
    pub y: &'a [f64],
    /// Velocity, unit / s, with the control signal of the last step.
    pub yd: &'a [f64],
    /// Acceleration at constant frequency and control signal, unit / s^2.
    pub ydd: &'a [f64],
}

/// A movement of n degrees of freedom that begins discretely and becomes periodic.
///
/// # Source
/// Gams et al. 2015, (1)-(9), (12), (13). Differs in: (1), (2) are integrated exactly for a forcing term that is constant
/// over a step; (5) is evaluated so that it is defined however far the phase is from every kernel, where the quotient as
/// printed becomes 0/0; the control signal of (12) is scaled with the frequency, so that what was adapted at one
/// frequency holds at every other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Saved", into = "Saved")]
pub struct DiscretePeriodicDmp {
    pub(crate) config: DiscretePeriodicConfig,
    pub(crate) kernels: BlendedKernels,
    /// Frequency and duration T of the demonstration.
    omega: f64,
    duration: f64,
    start_radius: f64,
    pub(crate) centre: Vec<f64>,
    start: Vec<f64>,
    /// Derivative after the phase at the start, unit / rad.
    start_slope: Vec<f64>,
    /// Degree of freedom by degree of freedom, first the periodic kernels, then the discrete ones.
    pub(crate) weights: Vec<f64>,
    /// The same of (13), for the demonstrated frequency, unit / s.
    control_weights: Vec<f64>,
    phase: f64,
    radius: f64,
    y: Vec<f64>,
    z: Vec<f64>,
    yd: Vec<f64>,
    ydd: Vec<f64>,
    correction: Vec<f64>,
    /// Forcing term and control at (phase, radius), valid while `fresh`.
    forcing: Vec<f64>,
    control: Vec<f64>,
    fresh: bool,
    /// Normalised kernel values of the last evaluation.
    psi: Vec<f64>,
    next_forcing: Vec<f64>,
    next_control: Vec<f64>,
    next_y: Vec<f64>,
    next_z: Vec<f64>,
}

impl DiscretePeriodicDmp {
    /// A primitive that stands still in 0, for a discrete part of `duration` s that flows into a motion of `omega` rad/s.
    /// Its start phase comes from integrating (3), (4) back from (mu1, 0) for that time.
    ///
    /// # Errors
    /// Names the constant that cannot be; [`MotionError::NotFinite`] when the phase runs away on its way back.
    pub fn new(config: DiscretePeriodicConfig, omega: f64, duration: f64) -> Result<Self, MotionError> {
        config.validate()?;
        within("omega", omega, 1e-9, 1e9)?;
        within("omega * duration", omega * duration, 1e-6, 1e4)?;
        let kernels = BlendedKernels::new(&config, omega * duration)?;
        let zeros = || vec![0.0; config.dofs];
        let weights = vec![0.0; config.dofs * kernels.len()];
        let start_radius = kernels.start_radius();
        Ok(Self {
            psi: vec![0.0; kernels.len()],
            control_weights: weights.clone(),
            weights,
            kernels,
            omega,
            duration,
            start_radius,
            centre: zeros(),
            start: zeros(),
            start_slope: zeros(),
            phase: -omega * duration,
            radius: start_radius,
            y: zeros(),
            z: zeros(),
            yd: zeros(),
            ydd: zeros(),
            correction: zeros(),
            forcing: zeros(),
            control: zeros(),
            fresh: false,
            next_forcing: zeros(),
            next_control: zeros(),
            next_y: zeros(),
            next_z: zeros(),
            config,
        })
    }

    /// The constants.
    #[must_use]
    pub fn config(&self) -> &DiscretePeriodicConfig {
        &self.config
    }

    /// Degrees of freedom n.
    #[must_use]
    pub fn dofs(&self) -> usize {
        self.config.dofs
    }

    /// Frequency of the demonstration, rad/s.
    #[must_use]
    pub fn demonstrated_omega(&self) -> f64 {
        self.omega
    }

    /// Duration T of the demonstration's discrete part, s.
    #[must_use]
    pub fn demonstrated_duration(&self) -> f64 {
        self.duration
    }

    /// The phase (phi, r) from which every execution starts: rad, dimensionless.
    #[must_use]
    pub fn initial_phase(&self) -> (f64, f64) {
        (-self.omega * self.duration, self.start_radius)
    }

    /// Kernels of both sets together: the weights a degree of freedom.
    #[must_use]
    pub fn kernels(&self) -> usize {
        self.kernels.len()
    }

    /// Weights of the forcing term (5): degree of freedom by degree of freedom, first the periodic kernels.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Replaces the weights of the forcing term; the state stays.
    ///
    /// # Errors
    /// When their number is not `dofs * kernels` or one is not finite.
    pub fn set_weights(&mut self, weights: &[f64]) -> Result<(), MotionError> {
        vector("weights", self.weights.len(), weights)?;
        self.weights.copy_from_slice(weights);
        self.fresh = false;
        Ok(())
    }

    /// Weights of the control signal (13), unit / s at the demonstrated frequency, in the order of the others.
    #[must_use]
    pub fn control_weights(&self) -> &[f64] {
        &self.control_weights
    }

    /// Replaces the weights of the control signal; the state stays.
    ///
    /// # Errors
    /// When their number is not `dofs * kernels` or one is not finite.
    pub fn set_control_weights(&mut self, weights: &[f64]) -> Result<(), MotionError> {
        vector("control weights", self.control_weights.len(), weights)?;
        self.control_weights.copy_from_slice(weights);
        self.fresh = false;
        Ok(())
    }

    /// The goal g of (1), one a degree of freedom: the mean of the periodic part.
    #[must_use]
    pub fn centre(&self) -> &[f64] {
        &self.centre
    }

    /// Moves the whole periodic motion, also while running; the position follows smoothly.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    pub fn set_centre(&mut self, centre: &[f64]) -> Result<(), MotionError> {
        vector("centre", self.centre.len(), centre)?;
        self.centre.copy_from_slice(centre);
        Ok(())
    }

    /// Puts phase, position and velocity to the start of the demonstration.
    pub fn restart(&mut self) {
        (self.phase, self.radius) = self.initial_phase();
        self.y.copy_from_slice(&self.start);
        self.z.copy_from_slice(&self.start_slope);
        for (v, z) in self.yd.iter_mut().zip(&self.z) {
            *v = self.omega * z;
        }
        self.ydd.fill(0.0);
        self.correction.fill(0.0);
        self.fresh = false;
    }

    /// As [`restart`](Self::restart) from another position and velocity (unit / s), for a motion of `omega` rad/s.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite or `omega` is not positive; nothing is changed.
    pub fn restart_from(&mut self, y: &[f64], yd: &[f64], omega: f64) -> Result<(), MotionError> {
        vector("y", self.y.len(), y)?;
        vector("yd", self.y.len(), yd)?;
        within("omega", omega, 1e-9, LARGEST)?;
        self.restart();
        self.y.copy_from_slice(y);
        self.yd.copy_from_slice(yd);
        for (z, v) in self.z.iter_mut().zip(yd) {
            *z = v / omega;
        }
        Ok(())
    }

    /// The state after the last step.
    #[must_use]
    pub fn state(&self) -> DiscretePeriodicState<'_> {
        DiscretePeriodicState {
            phase: self.phase,
            radius: self.radius,
            y: &self.y,
            yd: &self.yd,
            ydd: &self.ydd,
        }
    }

    /// Whether the phase is still in the discrete part.
    #[must_use]
    pub fn in_discrete_part(&self) -> bool {
        self.phase < 0.0
    }

    /// Writes the learned control signal (13) at the phase of now, unit / s, for a motion of `omega` rad/s. Does not allocate.
    ///
    /// # Errors
    /// When the size differs or `omega` is negative or not finite.
    pub fn control(&mut self, omega: f64, out: &mut [f64]) -> Result<(), MotionError> {
        crate::error::size("control", self.control.len(), out.len())?;
        within("omega", omega, 0.0, LARGEST)?;
        self.refresh();
        for (o, u) in out.iter_mut().zip(&self.control) {
            *o = u * omega / self.omega;
        }
        Ok(())
    }

    /// Adds the velocity `u` (unit / s, one a degree of freedom) to (2) in the next step, beside the learned control.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    ///
    /// # Source
    /// Eq. (12).
    pub fn correct(&mut self, u: &[f64]) -> Result<(), MotionError> {
        vector("correction", self.correction.len(), u)?;
        self.correction.copy_from_slice(u);
        Ok(())
    }

    /// Advances phase and state by `dt` s at `omega` rad/s (0 stands still). Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive, `omega` is negative or the result would not be finite. The state is unchanged.
    ///
    /// # Source
    /// Eqs. (1)-(9), (12), (13).
    pub fn step(&mut self, dt: f64, omega: f64) -> Result<DiscretePeriodicState<'_>, MotionError> {
        positive("dt", dt)?;
        within("omega", omega, 0.0, LARGEST)?;
        within("omega * dt", omega * dt, 0.0, LARGEST)?;
        within("dt", dt, 0.0, LARGEST)?;
        self.refresh();
        let advance = omega * dt;
        let turned = match self.config.canonical.rule {
            CanonicalRule::Modified => advance,
            CanonicalRule::Original => self.omega * dt,
        };
        let radius = self.config.canonical.advance(self.radius, turned);
        let phase = self.phase + advance;
        finite("phase", &[phase, radius])?;
        self.evaluate(phase, radius);
        let transition = Transition::new(self.config.alpha_z, self.config.beta_z, advance);
        for d in 0..self.y.len() {
            (self.next_y[d], self.next_z[d]) = self.advance_one(d, dt, omega, &transition);
        }
        finite("position", &self.next_y)?;
        finite("velocity", &self.next_z)?;
        self.commit(phase, radius, omega);
        Ok(self.state())
    }

    /// Position and z of degree of freedom `d` after the step: exact for forcing and control that are constant in it, and
    /// of second order for what they change.
    fn advance_one(&self, d: usize, dt: f64, omega: f64, transition: &Transition) -> (f64, f64) {
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        let u = self.input(d, omega, 0.5 * (self.control[d] + self.next_control[d]));
        if omega <= 0.0 {
            return (self.y[d] + u * dt, self.z[d]);
        }
        let slope = u / omega;
        let forcing = 0.5 * (self.forcing[d] + self.next_forcing[d]);
        let rest = self.centre[d] + forcing / (alpha * beta) + slope / beta;
        let (y, z) = transition.apply(self.y[d] - rest, self.z[d] + slope);
        (rest + y, z - slope)
    }

    /// The whole control signal of degree of freedom `d`, unit / s, from what was learned of it at the demonstrated frequency.
    fn input(&self, d: usize, omega: f64, learned: f64) -> f64 {
        learned * omega / self.omega + self.correction[d]
    }

    fn commit(&mut self, phase: f64, radius: f64, omega: f64) {
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        for d in 0..self.y.len() {
            let pull = alpha * (beta * (self.centre[d] - self.next_y[d]) - self.next_z[d]);
            self.yd[d] = omega * self.next_z[d] + self.input(d, omega, self.next_control[d]);
            self.ydd[d] = omega * omega * (pull + self.next_forcing[d]);
        }
        std::mem::swap(&mut self.y, &mut self.next_y);
        std::mem::swap(&mut self.z, &mut self.next_z);
        std::mem::swap(&mut self.forcing, &mut self.next_forcing);
        std::mem::swap(&mut self.control, &mut self.next_control);
        self.correction.fill(0.0);
        (self.phase, self.radius) = (phase, radius);
        self.fresh = true;
    }

    /// Brings forcing term and control up to date with phase and weights.
    fn refresh(&mut self) {
        if !self.fresh {
            self.evaluate(self.phase, self.radius);
            std::mem::swap(&mut self.forcing, &mut self.next_forcing);
            std::mem::swap(&mut self.control, &mut self.next_control);
            self.fresh = true;
        }
    }

    /// (5) and (13) at a phase into `next_forcing` and `next_control`.
    fn evaluate(&mut self, phase: f64, radius: f64) {
        let used = self.kernels.evaluate(phase, radius, &mut self.psi);
        let k = self.psi.len();
        for d in 0..self.next_forcing.len() {
            let over = |weights: &[f64]| -> f64 {
                let weights = &weights[d * k..(d + 1) * k];
                self.psi[used.clone()].iter().zip(&weights[used.clone()]).map(|(p, w)| p * w).sum()
            };
            self.next_forcing[d] = over(&self.weights);
            self.next_control[d] = over(&self.control_weights);
        }
    }

    fn take_start(&mut self, y: &[f64], slope: &[f64], centre: Vec<f64>) {
        self.start.copy_from_slice(y);
        self.start_slope.copy_from_slice(slope);
        self.centre = centre;
    }

    /// How long a whole execution with `periods` periods lasts at `omega` rad/s, s.
    #[must_use]
    pub fn length(&self, periods: f64, omega: f64) -> f64 {
        (self.omega * self.duration + TAU * periods) / omega
    }
}

#[cfg(test)]
mod tests;
