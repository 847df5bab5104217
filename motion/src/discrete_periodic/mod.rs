//! The discrete-periodic primitive: an initial transient movement that continues as a periodic one, in a single
//! system with n degrees of freedom on one phase (r, phi).
//!
//! The phase starts far from its limit cycle, on a spiral that carries the kernels of the discrete part. It
//! converges to the cycle, where only the phase angle and the periodic kernels matter. `discrete_periodic/phase.rs`
//! is the canonical system, `kernels.rs` the two kernel sets, `learning.rs` the regression; the rest is
//! `dmp/mod.rs`, with the control signal as a second kernel sum. [`crate::LearningControl`] learns a control signal
//! on the same kernels.
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

pub use self::config::DiscretePeriodicConfig;
use self::kernels::BlendedKernels;
pub use self::learning::differentiate;
pub use self::phase::{CanonicalRule, CanonicalSystem};
use self::saved::SavedDiscretePeriodic;
use crate::dmp::{Canonical, Dmp, Integrator, TimeScale};
use crate::error::{MAX_MAGNITUDE, MotionError, positive, vector, within};

/// The result of a step; the slices have one value per degree of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscretePeriodicState<'a> {
    /// Phase angle phi, rad: it starts at `-omega T`, the periodic part begins at 0, and it increases without
    /// bound.
    pub phase: f64,
    /// Distance r of the phase from the centre of its limit cycle, dimensionless; it decreases to mu.
    pub radius: f64,
    /// Position, in the unit of the degree of freedom.
    pub y: &'a [f64],
    /// Velocity, unit / s, with the control signal of the last step.
    pub yd: &'a [f64],
    /// Acceleration at constant frequency and control signal, unit / s^2.
    pub ydd: &'a [f64],
}

/// A movement of n degrees of freedom that begins as a discrete one and becomes periodic.
///
/// # Source
/// Gams et al. 2015, (1)-(9), (12), (13). Differs in: (1), (2) are integrated exactly for a forcing term that is
/// constant over a step; (5) is evaluated such that it is defined however far the phase is from every kernel, where
/// the printed quotient becomes 0/0; the control signal of (12) is scaled with the frequency, so that a signal
/// adapted at one frequency holds at every other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SavedDiscretePeriodic", into = "SavedDiscretePeriodic")]
pub struct DiscretePeriodicDmp {
    config: DiscretePeriodicConfig,
    /// Frequency and duration T of the demonstration.
    omega: f64,
    duration: f64,
    start: Vec<f64>,
    /// Derivative with respect to the phase at the start, unit / rad.
    start_slope: Vec<f64>,
    /// The weights of both sums: first the periodic kernels, then the discrete ones. Those of the control signal (13) are
    /// for the demonstrated frequency, unit / s.
    dmp: Dmp<BlendedKernels, 2>,
    correction: Vec<f64>,
}

/// Which kernel sum is the control signal.
const CONTROL: usize = 1;

primitive!(DiscretePeriodicDmp, DiscretePeriodicConfig);

impl DiscretePeriodicDmp {
    /// A primitive at rest at 0, for a discrete part of `duration` s that continues as a motion of `omega` rad/s.
    /// Its start phase is found by integrating (3), (4) back from (mu1, 0) over that time.
    ///
    /// # Errors
    /// Names the invalid constant; [`MotionError::NotFinite`] when the phase diverges while integrating back.
    pub fn new(config: DiscretePeriodicConfig, omega: f64, duration: f64) -> Result<Self, MotionError> {
        config.validate()?;
        within("omega", omega, 1e-9, 1e9)?;
        within("omega * duration", omega * duration, 1e-6, 1e4)?;
        let kernels = BlendedKernels::new(&config, omega, omega * duration)?;
        let phase = (-omega * duration, kernels.start_radius);
        let zeros = || vec![0.0; config.dofs];
        Ok(Self {
            omega,
            duration,
            start: zeros(),
            start_slope: zeros(),
            correction: zeros(),
            dmp: Dmp::new(kernels, phase, config.dofs, config.alpha_z, config.beta_z),
            config,
        })
    }

    /// Frequency of the demonstration, rad/s.
    pub fn demonstrated_omega(&self) -> f64 {
        self.omega
    }

    /// The phase (phi, r) from which every execution starts: rad, dimensionless.
    pub fn initial_phase(&self) -> (f64, f64) {
        (-self.omega * self.duration, self.dmp.canonical.start_radius)
    }

    /// Number of kernels of both sets together: the weights per degree of freedom.
    pub fn kernels(&self) -> usize {
        self.dmp.canonical.kernels()
    }

    /// Weights of the control signal (13), unit / s at the demonstrated frequency, in the order of the others.
    pub fn control_weights(&self) -> &[f64] {
        &self.dmp.sums[CONTROL].weights
    }

    /// Replaces the weights of the control signal; the state is unchanged.
    ///
    /// # Errors
    /// When their number is not `dofs * kernels` or one is not finite.
    pub fn set_control_weights(&mut self, weights: &[f64]) -> Result<(), MotionError> {
        self.dmp.set_weights(CONTROL, "control weights", weights)
    }

    /// The goal g of (1), one per degree of freedom: the mean of the periodic part.
    pub fn centre(&self) -> &[f64] {
        &self.dmp.transformation.goal
    }

    /// Moves the whole periodic motion, also while running; the position follows smoothly.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    pub fn set_centre(&mut self, centre: &[f64]) -> Result<(), MotionError> {
        vector("centre", self.dofs(), centre)?;
        self.dmp.transformation.goal.copy_from_slice(centre);
        Ok(())
    }

    /// Sets phase, position and velocity to the start of the demonstration.
    pub fn restart(&mut self) {
        self.dmp.set_phase(self.initial_phase());
        self.dmp.transformation.put_slope(&self.start, &self.start_slope, TimeScale::Frequency(self.omega));
        self.dmp.transformation.ydd.fill(0.0);
        self.correction.fill(0.0);
    }

    /// The state after the last step.
    pub fn state(&self) -> DiscretePeriodicState<'_> {
        let (state, (phase, radius)) = (&self.dmp.transformation, self.dmp.phase());
        DiscretePeriodicState { phase, radius, y: &state.y, yd: &state.yd, ydd: &state.ydd }
    }

    /// Writes the learned control signal (13) at the present phase, unit / s, for a motion of `omega` rad/s. Does
    /// not allocate.
    ///
    /// # Errors
    /// When the size differs or `omega` is negative or not finite.
    pub fn control(&mut self, omega: f64, out: &mut [f64]) -> Result<(), MotionError> {
        crate::error::size("control", self.dofs(), out.len())?;
        within("omega", omega, 0.0, MAX_MAGNITUDE)?;
        self.dmp.refresh();
        for (o, u) in out.iter_mut().zip(&self.dmp.sums[CONTROL].now) {
            *o = u * omega / self.omega;
        }
        Ok(())
    }

    /// Adds the velocity `u` (unit / s, one per degree of freedom) to (2) in the next step, in addition to the
    /// learned control.
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
        within("omega", omega, 0.0, MAX_MAGNITUDE)?;
        within("omega * dt", omega * dt, 0.0, MAX_MAGNITUDE)?;
        within("dt", dt, 0.0, MAX_MAGNITUDE)?;
        // The learned control signal is for the demonstrated frequency.
        let (correction, demonstrated) = (&self.correction, self.omega);
        let input = |d: usize, learned: f64| learned * omega / demonstrated + correction[d];
        self.dmp.step(dt, TimeScale::Frequency(omega), Integrator::Exact, input)?;
        self.correction.fill(0.0);
        Ok(self.state())
    }

    fn take_start(&mut self, y: &[f64], slope: &[f64], centre: &[f64]) {
        self.start.copy_from_slice(y);
        self.start_slope.copy_from_slice(slope);
        self.dmp.transformation.goal.copy_from_slice(centre);
    }

    /// Duration of a whole execution with `periods` periods at `omega` rad/s, s.
    pub fn length(&self, periods: f64, omega: f64) -> f64 {
        (self.omega * self.duration + TAU * periods) / omega
    }
}

#[cfg(test)]
mod tests;
