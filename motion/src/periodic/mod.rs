//! The periodic dynamic movement primitive of n degrees of freedom on one phase (eqs. 4-11), with the two
//! kinds of coupling: one that only perturbs (eq. 12) and one that the weights learn (eq. 13).
//!
//! What it is not: it does not find the frequency (see [`crate::AdaptiveOscillator`]) and knows no space: the
//! degrees of freedom may be joints or coordinates. Learning from data is in `learning.rs`, the path that
//! the weights stand for in `path.rs`, the equations in `dmp/mod.rs`. In the phase the system is linear and independent of
//! the frequency: `y'' + alpha_z y' + alpha_z beta_z (y - g) = f`; the integration is exact in that.

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
use crate::error::{LARGEST, MotionError, finite, frequency, positive, vector, within};

/// What a step yields; the slices have one value a degree of freedom.
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
/// Petrič et al. 2014, eqs. (4)-(13); the weights are per degree of freedom, P is common to all of them because
/// (9) does not depend on the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "saved::Saved", into = "saved::Saved")]
pub struct PeriodicDmp {
    config: PeriodicDmpConfig,
    dmp: Dmp<PhaseKernels>,
    learner: CouplingLearner,
}

impl PeriodicDmp {
    /// A primitive at rest in 0 that stands still: all weights 0, amplitude 1.
    ///
    /// # Errors
    /// [`MotionError::OutOfRange`] or [`MotionError::NotFinite`] names the constant that cannot be.
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

    /// The constants.
    #[must_use]
    pub fn config(&self) -> &PeriodicDmpConfig {
        &self.config
    }

    /// Degrees of freedom n.
    #[must_use]
    pub fn dofs(&self) -> usize {
        self.config.dofs
    }

    /// The kernels.
    #[must_use]
    pub fn kernels(&self) -> &PhaseKernels {
        &self.dmp.canonical
    }

    /// The weights of degree of freedom `dof` (one a kernel), or nothing if there is no such degree.
    #[must_use]
    pub fn weights_of(&self, dof: usize) -> Option<&[f64]> {
        self.weights().chunks_exact(self.kernels().len()).nth(dof)
    }

    /// All weights, degree of freedom by degree of freedom.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        self.dmp.weights()
    }

    /// Replaces all weights; the state stays, so that the position does not jump.
    ///
    /// # Errors
    /// When the number of weights is not `dofs * kernels` or one of them is not finite.
    pub fn set_weights(&mut self, weights: &[f64]) -> Result<(), MotionError> {
        self.dmp.set_weights(0, "weights", weights)
    }

    /// Centre of oscillation g, one a degree of freedom.
    #[must_use]
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

    /// Amplitude factor r of (6), dimensionless; 1 is the motion as learned.
    #[must_use]
    pub fn amplitude(&self) -> f64 {
        self.dmp.amplitude()
    }

    /// Scales the motion about its centre; the position follows smoothly.
    ///
    /// # Errors
    /// When the factor is not finite.
    pub fn set_amplitude(&mut self, amplitude: f64) -> Result<(), MotionError> {
        self.dmp.set_amplitude(amplitude)
    }

    /// The phase, rad, in `0..2 pi`.
    #[must_use]
    pub fn phase(&self) -> f64 {
        self.dmp.phase()
    }

    /// Sets the phase, as an oscillator that leads this primitive does; the position does not jump.
    ///
    /// # Errors
    /// When the phase is not finite.
    pub fn set_phase(&mut self, phase: f64) -> Result<(), MotionError> {
        finite("phase", &[phase])?;
        self.dmp.set_phase(phase.rem_euclid(TAU));
        Ok(())
    }

    /// The state after the last step.
    #[must_use]
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

    /// Adds `c` (one a degree of freedom) to (4) for the next step only: the motion gives way and comes back.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    ///
    /// # Source
    /// Eq. (12).
    pub fn perturb(&mut self, c: &[f64]) -> Result<(), MotionError> {
        vector("perturbation", self.dofs(), c)?;
        self.dmp.transformation.perturbation.copy_from_slice(c);
        Ok(())
    }

    /// Hands the coupling term `c` to the weights in the next step, at the phase of now: the motion keeps it.
    /// P of (9) moves on in such a step too, so a coach that stays calls this in each step, with zeros where
    /// his field ends.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    ///
    /// # Source
    /// Eqs. (9), (10), (13).
    pub fn couple(&mut self, c: &[f64]) -> Result<(), MotionError> {
        self.learner.couple(c)
    }

    /// Advances phase and state by `dt` seconds at `omega` rad/s (0 stands still) and returns the new state.
    /// Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive, `omega` is negative, the Euler step is too wide to be stable, or the result
    /// would not be finite. State and weights are unchanged, and a coupling waits for the next step.
    ///
    /// # Source
    /// Eqs. (4)-(7).
    pub fn step(&mut self, dt: f64, omega: f64) -> Result<DmpState<'_>, MotionError> {
        positive("dt", dt)?;
        let advance = omega * dt;
        within("omega * dt", advance, 0.0, LARGEST)?;
        within("omega", omega, 0.0, LARGEST)?;
        if self.config.integrator == Integrator::Euler {
            let widest = widest_euler_step(self.config.alpha_z, self.config.beta_z);
            within("alpha_z * omega * dt", self.config.alpha_z * advance, 0.0, 0.99 * widest)?;
        }
        let integrator = self.config.integrator;
        let step = |dmp: &mut Dmp<_>| dmp.step(dt, TimeScale::Frequency(omega), integrator, |_, _| 0.0);
        self.learner.step(&mut self.dmp, dt, step)?;
        Ok(self.state())
    }
}

impl PeriodicDmp {
    /// The weights, to be changed.
    pub(crate) fn weights_mut(&mut self) -> &mut [f64] {
        self.dmp.weights_mut()
    }

    /// The centre, to be changed.
    pub(crate) fn centre_mut(&mut self) -> &mut [f64] {
        &mut self.dmp.transformation.goal
    }

    /// Writes the forcing term (6) at any phase (rad) to `out`, one value a degree of freedom. Allocates.
    pub(crate) fn forcing_at(&self, phase: f64, out: &mut [f64]) {
        self.dmp.forcing_at(phase, out);
    }

    /// Forgets what was learned: weights and P.
    pub(crate) fn forget(&mut self) {
        self.weights_mut().fill(0.0);
        self.learner.forget();
    }

    /// Takes over weights, centre and P of a primitive of the same size.
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
