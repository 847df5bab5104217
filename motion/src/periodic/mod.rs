//! The periodic dynamic movement primitive of n degrees of freedom on one phase (eqs. 4-11), with the two
//! kinds of coupling: one that only perturbs (eq. 12) and one that the weights learn (eq. 13).
//!
//! It does not find the frequency (see [`crate::AdaptiveOscillator`]), and it does not depend on a space: the
//! degrees of freedom may be joints or coordinates. Learning from data is in `learning.rs`, the path of the weights
//! in `path.rs`, the equations in `dmp/mod.rs`. As a function of the phase the system is linear and independent of
//! the frequency: `y'' + alpha_z y' + alpha_z beta_z (y - g) = f`; this is integrated exactly.

mod config;
mod kernels;
mod learning;
mod path;
mod saved;

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

pub use self::config::PeriodicDmpConfig;
pub use self::kernels::PhaseKernels;
pub use self::learning::PhaseSample;
pub use self::path::{PathResponse, PeriodicPath};
pub use crate::dmp::Integrator;
use crate::dmp::{CouplingLearner, Dmp, TimeScale, widest_euler_step};
use crate::error::{MAX_MAGNITUDE, MotionError, finite, frequency, positive, vector, within};

/// The result of a step; the slices have one value per degree of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DmpState<'a> {
    /// Phase, rad, in `0..2 pi`.
    pub phase: f64,
    /// Position, in the unit of the degree of freedom.
    pub y: &'a [f64],
    /// Velocity, unit / s.
    pub yd: &'a [f64],
    /// Acceleration at constant frequency, unit / s^2.
    pub ydd: &'a [f64],
}

/// A periodic movement of n degrees of freedom on one phase.
///
/// # Source
/// Petrič et al. 2014, eqs. (4)-(13). Each degree of freedom has its own weights; all share P because (9) does not
/// depend on the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "saved::SavedPeriodic", into = "saved::SavedPeriodic")]
pub struct PeriodicDmp {
    config: PeriodicDmpConfig,
    dmp: Dmp<PhaseKernels>,
    learner: CouplingLearner,
}

primitive!(PeriodicDmp, PeriodicDmpConfig);
coached!(PeriodicDmp);

impl PeriodicDmp {
    /// A primitive at rest at 0: all weights 0, amplitude 1.
    ///
    /// # Errors
    /// [`MotionError::OutOfRange`] or [`MotionError::NotFinite`] names the invalid constant.
    pub fn new(config: PeriodicDmpConfig) -> Result<Self, MotionError> {
        config.validate()?;
        let (n, k) = (config.dofs, config.kernels);
        let kernels = PhaseKernels::new(k, config.width.unwrap_or(2.5 * k as f64));
        Ok(Self {
            dmp: Dmp::new(kernels, 0.0, n, config.alpha_z, config.beta_z),
            learner: CouplingLearner::new(n, k, config.forgetting, config.initial_gain),
            config,
        })
    }

    /// The kernels.
    pub fn kernels(&self) -> &PhaseKernels {
        &self.dmp.canonical
    }

    /// Centre of oscillation g, one per degree of freedom.
    pub fn centre(&self) -> &[f64] {
        &self.dmp.transformation.goal
    }

    /// Moves the whole motion: the position follows smoothly.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    pub fn set_centre(&mut self, centre: &[f64]) -> Result<(), MotionError> {
        vector("centre", self.dofs(), centre)?;
        self.centre_mut().copy_from_slice(centre);
        Ok(())
    }

    /// The phase, rad, in `0..2 pi`.
    pub fn phase(&self) -> f64 {
        self.dmp.phase()
    }

    /// Sets the phase, for a primitive that follows an oscillator; the position does not jump.
    ///
    /// # Errors
    /// When the phase is not finite.
    pub fn set_phase(&mut self, phase: f64) -> Result<(), MotionError> {
        finite("phase", &[phase])?;
        self.dmp.set_phase(phase.rem_euclid(TAU));
        Ok(())
    }

    /// The state after the last step.
    pub fn state(&self) -> DmpState<'_> {
        let state = &self.dmp.transformation;
        DmpState { phase: self.phase(), y: &state.y, yd: &state.yd, ydd: &state.ydd }
    }

    /// Starts from a given position and velocity (unit / s) at `phase`, for a motion of `omega` rad/s.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite, or `omega` is not positive.
    pub fn reset(&mut self, phase: f64, y: &[f64], yd: &[f64], omega: f64) -> Result<(), MotionError> {
        vector("y", self.dofs(), y)?;
        vector("yd", self.dofs(), yd)?;
        frequency("omega", omega)?;
        self.set_phase(phase)?;
        self.dmp.transformation.put(y, yd, TimeScale::Frequency(omega));
        Ok(())
    }

    /// Advances phase and state by `dt` seconds at `omega` rad/s (0 stands still) and returns the new state.
    /// Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive, `omega` is negative, the Euler step is too large to be stable, or the result
    /// would not be finite. State and weights are then unchanged, and a pending coupling waits for the next step.
    ///
    /// # Source
    /// Eqs. (4)-(7).
    pub fn step(&mut self, dt: f64, omega: f64) -> Result<DmpState<'_>, MotionError> {
        positive("dt", dt)?;
        let advance = omega * dt;
        within("omega * dt", advance, 0.0, MAX_MAGNITUDE)?;
        within("omega", omega, 0.0, MAX_MAGNITUDE)?;
        if self.config.integrator == Integrator::Euler {
            let widest = widest_euler_step(self.config.alpha_z, self.config.beta_z);
            within("alpha_z * omega * dt", self.config.alpha_z * advance, 0.0, 0.99 * widest)?;
        }
        let integrator = self.config.integrator;
        let step = |dmp: &mut Dmp<_>| dmp.step(dt, TimeScale::Frequency(omega), integrator, |_, _| 0.0);
        self.learner.step(&mut self.dmp, dt, step)?;
        Ok(self.state())
    }

    /// Mutable access to the weights.
    pub(crate) fn weights_mut(&mut self) -> &mut [f64] {
        self.dmp.weights_mut()
    }

    /// Mutable access to the centre.
    pub(crate) fn centre_mut(&mut self) -> &mut [f64] {
        &mut self.dmp.transformation.goal
    }

    /// Writes the forcing term (6) at any phase (rad) to `out`, one value per degree of freedom. Allocates.
    pub(crate) fn forcing_at(&self, phase: f64, out: &mut [f64]) {
        self.dmp.forcing_at(phase, out);
    }

    /// Resets weights and P.
    pub(crate) fn forget(&mut self) {
        self.weights_mut().fill(0.0);
        self.learner.forget();
    }

    /// Copies weights, centre and P from a primitive of the same size.
    pub(crate) fn take_over(&mut self, other: &Self) {
        self.weights_mut().copy_from_slice(other.weights());
        self.centre_mut().copy_from_slice(other.centre());
        self.learner.gain.copy_from_slice(&other.learner.gain);
    }

    fn put_state(&mut self, phase: f64, y: &[f64], z: &[f64], omega: f64) {
        self.dmp.set_phase(phase.rem_euclid(TAU));
        self.dmp.transformation.put_slope(y, z, TimeScale::Frequency(omega));
    }
}

#[cfg(test)]
mod tests;
