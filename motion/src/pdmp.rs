//! The periodic dynamic movement primitive of n degrees of freedom on one phase (eqs. 4-11), with the two
//! kinds of coupling: one that only perturbs (eq. 12) and one that the weights learn (eq. 13).
//!
//! What it is not: it does not find the frequency (see [`crate::AdaptiveOscillator`]) and knows no space: the
//! degrees of freedom may be joints or coordinates. Learning from data is in `pdmp_learning`, the path that
//! the weights stand for in `path`. In the phase the system is linear and independent of the frequency:
//! `y'' + alpha_z y' + alpha_z beta_z (y - g) = f`; the integration below is exact in that.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::error::{LARGEST, MotionError, finite, frequency, positive, vector, within};
use crate::kernels::PhaseKernels;

mod config;
mod saved;
mod transition;

pub use self::config::{Integrator, PeriodicDmpConfig};
pub(crate) use self::transition::Transition;
use self::transition::widest_euler_step;

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
    pub(crate) config: PeriodicDmpConfig,
    pub(crate) kernels: PhaseKernels,
    pub(crate) centre: Vec<f64>,
    pub(crate) amplitude: f64,
    /// Degree of freedom by degree of freedom: `weights[d * kernels + i]`.
    pub(crate) weights: Vec<f64>,
    /// P of (9), one a kernel.
    pub(crate) gain: Vec<f64>,
    phase: f64,
    y: Vec<f64>,
    z: Vec<f64>,
    yd: Vec<f64>,
    ydd: Vec<f64>,
    perturbation: Vec<f64>,
    coupling: Vec<f64>,
    coupled: bool,
    /// Kernel values and forcing term at `phase`, valid while `fresh`.
    pub(crate) psi: Vec<f64>,
    psi_sum: f64,
    forcing: Vec<f64>,
    pub(crate) fresh: bool,
    /// Scratch of a step, so that a refused step changes nothing.
    next_y: Vec<f64>,
    next_z: Vec<f64>,
    next_forcing: Vec<f64>,
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
        let gain = vec![config.initial_gain; k];
        let zeros = || vec![0.0; n];
        Ok(Self {
            kernels,
            gain,
            config,
            centre: zeros(),
            amplitude: 1.0,
            weights: vec![0.0; n * k],
            phase: 0.0,
            y: zeros(),
            z: zeros(),
            yd: zeros(),
            ydd: zeros(),
            perturbation: zeros(),
            coupling: zeros(),
            coupled: false,
            psi: vec![0.0; k],
            psi_sum: 1.0,
            forcing: zeros(),
            fresh: false,
            next_y: zeros(),
            next_z: zeros(),
            next_forcing: zeros(),
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
        &self.kernels
    }

    /// The weights of degree of freedom `dof` (one a kernel), or nothing if there is no such degree.
    #[must_use]
    pub fn weights_of(&self, dof: usize) -> Option<&[f64]> {
        self.weights.chunks_exact(self.kernels.len()).nth(dof)
    }

    /// All weights, degree of freedom by degree of freedom.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Replaces all weights; the state stays, so that the position does not jump.
    ///
    /// # Errors
    /// When the number of weights is not `dofs * kernels` or one of them is not finite.
    pub fn set_weights(&mut self, weights: &[f64]) -> Result<(), MotionError> {
        vector("weights", self.weights.len(), weights)?;
        self.weights.copy_from_slice(weights);
        self.fresh = false;
        Ok(())
    }

    /// Centre of oscillation g, one a degree of freedom.
    #[must_use]
    pub fn centre(&self) -> &[f64] {
        &self.centre
    }

    /// Moves the whole motion: the position follows smoothly.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    pub fn set_centre(&mut self, centre: &[f64]) -> Result<(), MotionError> {
        vector("centre", self.centre.len(), centre)?;
        self.centre.copy_from_slice(centre);
        Ok(())
    }

    /// Amplitude factor r of (6), dimensionless; 1 is the motion as learned.
    #[must_use]
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// Scales the motion about its centre; the position follows smoothly.
    ///
    /// # Errors
    /// When the factor is not finite.
    pub fn set_amplitude(&mut self, amplitude: f64) -> Result<(), MotionError> {
        vector("amplitude", 1, &[amplitude])?;
        self.amplitude = amplitude;
        self.fresh = false;
        Ok(())
    }

    /// The phase, rad, in `0..2 pi`.
    #[must_use]
    pub fn phase(&self) -> f64 {
        self.phase
    }

    /// Sets the phase, as an oscillator that leads this primitive does; the position does not jump.
    ///
    /// # Errors
    /// When the phase is not finite.
    pub fn set_phase(&mut self, phase: f64) -> Result<(), MotionError> {
        finite("phase", &[phase])?;
        self.phase = phase.rem_euclid(TAU);
        self.fresh = false;
        Ok(())
    }

    /// The state after the last step.
    #[must_use]
    pub fn state(&self) -> DmpState<'_> {
        DmpState { phase: self.phase, y: &self.y, yd: &self.yd, ydd: &self.ydd }
    }

    /// Starts from a given position and velocity (unit / s) at `phase`, for a motion of `omega` rad/s.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite, or `omega` is not positive.
    pub fn reset(&mut self, phase: f64, y: &[f64], yd: &[f64], omega: f64) -> Result<(), MotionError> {
        vector("y", self.y.len(), y)?;
        vector("yd", self.y.len(), yd)?;
        frequency("omega", omega)?;
        self.set_phase(phase)?;
        self.y.copy_from_slice(y);
        self.yd.copy_from_slice(yd);
        for (z, v) in self.z.iter_mut().zip(yd) {
            *z = v / omega;
        }
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
        vector("perturbation", self.perturbation.len(), c)?;
        self.perturbation.copy_from_slice(c);
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
        vector("coupling", self.coupling.len(), c)?;
        self.coupling.copy_from_slice(c);
        self.coupled = true;
        Ok(())
    }

    /// Advances phase and state by `dt` seconds at `omega` rad/s (0 stands still) and returns the new state.
    /// Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive, `omega` is negative, the Euler step is too wide to be stable, or the result
    /// would not be finite. The state is unchanged.
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
        self.refresh();
        if self.coupled {
            let coupling = std::mem::take(&mut self.coupling);
            self.update_weights(dt, &coupling);
            self.coupling = coupling;
        }
        let phase = (self.phase + advance).rem_euclid(TAU);
        match self.config.integrator {
            Integrator::Exact => self.advance_exact(advance, phase),
            Integrator::Euler => self.advance_euler(advance, phase),
        }
        self.commit(phase, omega)
    }

    fn commit(&mut self, phase: f64, omega: f64) -> Result<DmpState<'_>, MotionError> {
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        finite("position", &self.next_y)?;
        finite("velocity", &self.next_z)?;
        std::mem::swap(&mut self.y, &mut self.next_y);
        std::mem::swap(&mut self.z, &mut self.next_z);
        std::mem::swap(&mut self.forcing, &mut self.next_forcing);
        self.phase = phase;
        self.fresh = true;
        self.coupled = false;
        for d in 0..self.y.len() {
            let pull = alpha * (beta * (self.centre[d] - self.y[d]) - self.z[d]);
            self.yd[d] = omega * self.z[d];
            self.ydd[d] = omega * omega * (pull + self.forcing[d] + self.perturbation[d]);
            self.perturbation[d] = 0.0;
        }
        Ok(self.state())
    }

    fn advance_exact(&mut self, advance: f64, phase: f64) {
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        let transition = Transition::new(alpha, beta, advance);
        self.evaluate_forcing(phase);
        for d in 0..self.y.len() {
            let forcing = 0.5 * (self.forcing[d] + self.next_forcing[d]) + self.perturbation[d];
            let rest = self.centre[d] + forcing / (alpha * beta);
            let (offset, z) = transition.apply(self.y[d] - rest, self.z[d]);
            self.next_y[d] = rest + offset;
            self.next_z[d] = z;
        }
    }

    fn advance_euler(&mut self, advance: f64, phase: f64) {
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        for d in 0..self.y.len() {
            let pull = alpha * (beta * (self.centre[d] - self.y[d]) - self.z[d]);
            self.next_y[d] = self.y[d] + advance * self.z[d];
            self.next_z[d] = self.z[d] + advance * (pull + self.forcing[d] + self.perturbation[d]);
        }
        self.evaluate_forcing(phase);
    }

    /// Brings kernel values and forcing term up to date with phase, weights and amplitude.
    fn refresh(&mut self) {
        if !self.fresh {
            self.evaluate_forcing(self.phase);
            std::mem::swap(&mut self.forcing, &mut self.next_forcing);
            self.fresh = true;
        }
    }

    /// Kernel values at `phase` into `psi`, the forcing term (6) into `next_forcing`.
    fn evaluate_forcing(&mut self, phase: f64) {
        self.psi_sum = self.kernels.evaluate(phase, &mut self.psi);
        let scale = self.amplitude / self.psi_sum;
        for (f, w) in self.next_forcing.iter_mut().zip(self.weights.chunks_exact(self.psi.len())) {
            *f = scale * w.iter().zip(&self.psi).map(|(w, p)| w * p).sum::<f64>();
        }
    }

    /// Writes the forcing term (6) at any phase (rad) to `out`, one value a degree of freedom. Allocates.
    pub(crate) fn forcing_at(&self, phase: f64, out: &mut [f64]) {
        let mut psi = vec![0.0; self.kernels.len()];
        let sum = self.kernels.evaluate(phase, &mut psi);
        for (o, w) in out.iter_mut().zip(self.weights.chunks_exact(psi.len())) {
            *o = self.amplitude / sum * w.iter().zip(&psi).map(|(w, p)| w * p).sum::<f64>();
        }
    }
}

impl PeriodicDmp {
    pub(crate) fn put_state(&mut self, phase: f64, y: &[f64], z: &[f64], omega: f64) {
        self.phase = phase.rem_euclid(TAU);
        self.fresh = false;
        self.y.copy_from_slice(y);
        self.z.copy_from_slice(z);
        for (yd, z) in self.yd.iter_mut().zip(z) {
            *yd = omega * z;
        }
    }
}

#[cfg(test)]
mod tests;
