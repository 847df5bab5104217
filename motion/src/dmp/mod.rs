//! The core that all dynamic movement primitives of this crate share: a canonical system ([`Canonical`]), a
//! transformation system ([`Transformation`]), a forcing term ([`KernelSum`]) and its learning (`learning.rs`).
//!
//! With the time scale `tau = 1 / Omega`, per degree of freedom:
//!
//! ```text
//! tau z' = alpha_z (beta_z (g - y) - z) + f + C        the transformation system
//! tau y' = z + tau u
//! f = r s(phase) sum_i w_i psi_i(phase) / sum_i psi_i(phase)    the forcing term
//! ```
//!
//! The canonical system defines the phase, its advance, its kernels psi and the gate s: a circle for the periodic
//! primitive, a decay for the discrete one, a spiral onto a circle for the discrete-periodic one. Goals,
//! demonstrations and file formats belong to the primitives, not to the core.

#[macro_use]
mod accessors;
mod learning;
mod transformation;

use std::ops::Range;

use crate::error::{MotionError, vector};

pub use self::learning::TimeSample;
pub(crate) use self::learning::{CouplingLearner, Cutoff, Ridge, check_time_samples};
pub use self::transformation::Integrator;
pub(crate) use self::transformation::{StepMatrix, TimeScale, Transformation, widest_euler_step};

/// A canonical system: the phase of a primitive, which replaces time, and the kernels over it.
pub(crate) trait Canonical {
    /// The phase.
    type Phase: Copy;

    /// The number of kernels.
    fn kernels(&self) -> usize;

    /// The phase, `dt` s after `phase`. Does not allocate.
    fn advance(&self, phase: Self::Phase, dt: f64, scale: TimeScale) -> Result<Self::Phase, MotionError>;

    /// Writes the kernel values at `phase` to `psi`, one per kernel. Does not allocate.
    fn activate(&self, phase: Self::Phase, psi: &mut [f64]) -> KernelActivation;
}

/// The kernel values at a phase.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KernelActivation {
    /// The kernels whose values were written; all others are 0.
    pub(crate) used: Range<usize>,
    /// The sum of their values.
    pub(crate) sum: f64,
    /// The gate s, by which the phase scales the forcing term.
    pub(crate) gate: f64,
}

/// A weighted sum of normalised kernels, one per degree of freedom: a forcing term, or a learned control signal.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KernelSum {
    /// Degree of freedom by degree of freedom: `weights[d * kernels + i]`.
    pub(crate) weights: Vec<f64>,
    /// Its value at the present phase, and at the next one during a step.
    pub(crate) now: Vec<f64>,
    next: Vec<f64>,
}

impl KernelSum {
    fn new(dofs: usize, kernels: usize) -> Self {
        Self { weights: vec![0.0; dofs * kernels], now: vec![0.0; dofs], next: vec![0.0; dofs] }
    }
}

/// Writes the sums of `weights` over kernels with the values `psi` to `out`, one value per degree of freedom.
fn weighted(weights: &[f64], psi: &[f64], used: &Range<usize>, scale: f64, out: &mut [f64]) {
    let psi_used = &psi[used.clone()];
    for (o, w) in out.iter_mut().zip(weights.chunks_exact(psi.len())) {
        *o = scale * w[used.clone()].iter().zip(psi_used).map(|(w, p)| w * p).sum::<f64>();
    }
}

/// A primitive: the forcing term is the first of its `SUMS` kernel sums; a second one adds a velocity.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Dmp<C: Canonical, const SUMS: usize = 1> {
    pub(crate) canonical: C,
    phase: C::Phase,
    pub(crate) transformation: Transformation,
    pub(crate) sums: [KernelSum; SUMS],
    amplitude: f64,
    /// Kernel values of the last evaluation. If `fresh`, they and the sums belong to `phase`.
    psi: Vec<f64>,
    active: KernelActivation,
    fresh: bool,
}

impl<C: Canonical, const SUMS: usize> Dmp<C, SUMS> {
    /// A primitive at rest at 0 and at `phase`, with all weights 0 and amplitude 1.
    pub(crate) fn new(canonical: C, phase: C::Phase, dofs: usize, alpha_z: f64, beta_z: f64) -> Self {
        let kernels = canonical.kernels();
        Self {
            canonical,
            phase,
            transformation: Transformation::new(dofs, alpha_z, beta_z),
            sums: std::array::from_fn(|_| KernelSum::new(dofs, kernels)),
            amplitude: 1.0,
            psi: vec![0.0; kernels],
            active: KernelActivation { used: 0..0, sum: 1.0, gate: 1.0 },
            fresh: false,
        }
    }

    pub(crate) fn phase(&self) -> C::Phase {
        self.phase
    }

    pub(crate) fn set_phase(&mut self, phase: C::Phase) {
        self.phase = phase;
        self.fresh = false;
    }

    /// Weights of the forcing term.
    pub(crate) fn weights(&self) -> &[f64] {
        &self.sums[0].weights
    }

    /// Mutable access to the weights of the forcing term.
    pub(crate) fn weights_mut(&mut self) -> &mut Vec<f64> {
        self.fresh = false;
        &mut self.sums[0].weights
    }

    /// Replaces the weights of one kernel sum.
    pub(crate) fn set_weights(
        &mut self,
        sum: usize,
        what: &'static str,
        weights: &[f64],
    ) -> Result<(), MotionError> {
        vector(what, self.sums[sum].weights.len(), weights)?;
        self.sums[sum].weights.copy_from_slice(weights);
        self.fresh = false;
        Ok(())
    }

    pub(crate) fn amplitude(&self) -> f64 {
        self.amplitude
    }

    pub(crate) fn set_amplitude(&mut self, amplitude: f64) -> Result<(), MotionError> {
        vector("amplitude", 1, &[amplitude])?;
        self.amplitude = amplitude;
        self.fresh = false;
        Ok(())
    }

    /// Refuses an amplitude of 0, for which weights have no effect.
    pub(crate) fn check_amplitude(&self) -> Result<(), MotionError> {
        if self.amplitude == 0.0 {
            return Err(MotionError::Degenerate { what: "amplitude", why: "0 hides every weight" });
        }
        Ok(())
    }

    /// Recomputes the kernel sums if phase, weights or amplitude have changed.
    pub(crate) fn refresh(&mut self) {
        if !self.fresh {
            self.evaluate(self.phase);
            self.accept();
        }
    }

    /// Evaluates the kernel sums at `phase` into `next`.
    fn evaluate(&mut self, phase: C::Phase) {
        self.fresh = false;
        self.active = self.canonical.activate(phase, &mut self.psi);
        let scale = self.amplitude * self.active.gate / self.active.sum;
        for sum in &mut self.sums {
            weighted(&sum.weights, &self.psi, &self.active.used, scale, &mut sum.next);
        }
    }

    fn accept(&mut self) {
        for sum in &mut self.sums {
            std::mem::swap(&mut sum.now, &mut sum.next);
        }
        self.fresh = true;
    }

    /// Advances phase and state by `dt` s. `input` returns the velocity u of a degree of freedom (unit / s) from
    /// the value of the second kernel sum. Does not allocate; a refused step leaves phase, state and weights
    /// unchanged.
    pub(crate) fn step(
        &mut self,
        dt: f64,
        scale: TimeScale,
        integrator: Integrator,
        input: impl Fn(usize, f64) -> f64,
    ) -> Result<(), MotionError> {
        let phase = self.canonical.advance(self.phase, dt, scale)?;
        self.refresh();
        self.evaluate(phase);
        let [forcing, control @ ..] = &self.sums[..] else { return Ok(()) };
        let second = |d: usize| control.first().map_or((0.0, 0.0), |c| (c.now[d], c.next[d]));
        let transformation = &mut self.transformation;
        match integrator {
            Integrator::Exact => transformation.advance_exactly(
                dt,
                scale,
                |d| 0.5 * (forcing.now[d] + forcing.next[d]),
                |d| {
                    let (now, next) = second(d);
                    input(d, 0.5 * (now + next))
                },
            ),
            Integrator::Euler => transformation.advance_by_euler(dt, scale, |d| forcing.now[d]),
        }
        transformation.check()?;
        transformation.commit(scale, |d| forcing.next[d], |d| input(d, second(d).1));
        self.phase = phase;
        self.accept();
        Ok(())
    }

    /// Adds `scale psi_i(phase) shift_d` to each weight of the forcing term; `shift` may have fewer values than
    /// there are degrees of freedom. Does not allocate.
    pub(crate) fn add_to_weights(&mut self, phase: C::Phase, scale: f64, shift: &[f64]) {
        self.fresh = false;
        self.active = self.canonical.activate(phase, &mut self.psi);
        for (w, s) in self.sums[0].weights.chunks_exact_mut(self.psi.len()).zip(shift) {
            for (w, psi) in w.iter_mut().zip(&self.psi) {
                *w += scale * psi * s;
            }
        }
    }

    /// Writes the forcing term at any phase to `out`, one value per degree of freedom. Allocates.
    pub(crate) fn forcing_at(&self, phase: C::Phase, out: &mut [f64]) {
        let mut psi = vec![0.0; self.psi.len()];
        let active = self.canonical.activate(phase, &mut psi);
        let scale = self.amplitude * active.gate / active.sum;
        weighted(self.weights(), &psi, &active.used, scale, out);
    }
}
