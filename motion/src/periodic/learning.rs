//! Learning of a [`PeriodicDmp`]'s weights: online by recursive least squares with forgetting (eqs. 8-11), or all
//! at once by regression. Also the displacement rule for coaching in metres.

use nalgebra::{DMatrix, DVector};

use super::PeriodicDmp;
use crate::dmp::{Cutoff, Ridge, TimeScale};
use crate::error::{MAX_MAGNITUDE, MotionError, finite, frequency, positive, vector, within};

/// One sample of a demonstrated period, for batch learning; the slices have one value per degree of freedom.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseSample {
    /// Phase, rad.
    pub phase: f64,
    /// Position.
    pub y: Vec<f64>,
    /// Derivative with respect to the phase: velocity / omega, unit / rad.
    pub dy: Vec<f64>,
    /// Second derivative with respect to the phase: acceleration / omega^2, unit / rad^2.
    pub ddy: Vec<f64>,
}

impl PeriodicDmp {
    /// Learns from one sample: `y`, `yd` (unit/s), `ydd` (unit/s^2) at `phase` rad of a demonstration of `omega`
    /// rad/s, `dt` s after the previous one. The state that [`step`](Self::step) integrates is not changed. Does
    /// not allocate.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite, or `dt` or `omega` is not positive; nothing is learned.
    ///
    /// # Source
    /// Eqs. (8)-(11); differs in: lambda holds for 10 ms and is scaled with `dt`, and P stays at most at its
    /// initial value, so that a kernel that was not visited for a long time does not learn from noise.
    pub fn learn(
        &mut self,
        phase: f64,
        omega: f64,
        dt: f64,
        y: &[f64],
        yd: &[f64],
        ydd: &[f64],
    ) -> Result<(), MotionError> {
        let n = self.dofs();
        finite("phase", &[phase])?;
        frequency("omega", omega)?;
        positive("dt", dt)?;
        vector("y", n, y)?;
        vector("yd", n, yd)?;
        vector("ydd", n, ydd)?;
        self.learner.learn(&mut self.dmp, phase, TimeScale::Frequency(omega), dt, [y, yd, ydd]);
        Ok(())
    }

    /// Moves the path near `phase` by `shift` (one per degree of freedom, in its unit) for each whole pass over it,
    /// of which `advance` rad pass now. This is (10) and (13) with P at the fixed point of (9), in units of the
    /// path: `C = alpha_z beta_z shift`. The kernels are selected [`lag`](Self::lag) earlier, so that the path
    /// moves at the coach's phase and not behind it.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite; an amplitude of 0 cannot be coached.
    pub fn displace(&mut self, phase: f64, advance: f64, shift: &[f64]) -> Result<(), MotionError> {
        vector("shift", self.dofs(), shift)?;
        self.displace_some(phase, advance, shift)
    }

    /// As [`displace`](Self::displace), for the first degrees of freedom only.
    pub(crate) fn displace_some(
        &mut self,
        phase: f64,
        advance: f64,
        shift: &[f64],
    ) -> Result<(), MotionError> {
        finite("phase", &[phase])?;
        vector("advance", 1, &[advance])?;
        vector("shift", shift.len(), shift)?;
        self.dmp.check_amplitude()?;
        let scale = self.config.alpha_z * self.config.beta_z * advance
            / (std::f64::consts::TAU * self.kernels().mean() * self.amplitude());
        shift.iter().try_for_each(|s| within("displacement", scale * s, -MAX_MAGNITUDE, MAX_MAGNITUDE))?;
        self.dmp.add_to_weights(phase - self.lag(), scale, shift);
        Ok(())
    }

    /// The lag (rad) of the path behind the forcing term: the group delay `1 / beta_z` of (4), (5).
    pub fn lag(&self) -> f64 {
        1.0 / self.config.beta_z
    }

    /// Sets P to the fixed point that (9) reaches in a long uniform sweep with steps of `dt` s, as if the motion
    /// had been learned for a long time. The learning rate of a coupling then no longer depends on the past.
    ///
    /// # Errors
    /// When `dt` is not positive, or the amplitude is 0.
    pub fn settle_gain(&mut self, dt: f64) -> Result<(), MotionError> {
        positive("dt", dt)?;
        self.dmp.check_amplitude()?;
        let r = self.amplitude();
        let p = self.learner.forgotten(dt) / (self.kernels().mean() * r * r);
        self.learner.settle(p);
        Ok(())
    }

    /// Removes the effect of overlapping kernels from weights that [`learn`](Self::learn) has found; to be called
    /// only once.
    ///
    /// (8)-(10) regress each kernel by itself, so a weight is the mean of the forcing term around its kernel, and
    /// (6) averages these means again: 25 kernels lose 3 % of a first harmonic. Here the weights become those whose
    /// forcing term has the learned means around the kernels.
    pub fn sharpen(&mut self) {
        let k = self.kernels().len();
        let fine = 16 * k;
        let mut psi = vec![0.0; k];
        let (mut mean, mut total) = (vec![0.0; k], 0.0);
        for s in 0..fine {
            let sum = self.kernels().evaluate(std::f64::consts::TAU * s as f64 / fine as f64, &mut psi);
            let own = psi[0];
            total += own;
            mean.iter_mut().zip(&psi).for_each(|(m, psi)| *m += own * psi / sum);
        }
        // All kernels are equal, so the means around kernel i are those around kernel 0, shifted by i.
        let overlap = DMatrix::from_fn(k, k, |i, j| mean[(j + k - i) % k] / total);
        let Some(factor) = overlap.cholesky() else { return };
        for w in self.weights_mut().chunks_exact_mut(k) {
            let mut column = DVector::from_column_slice(w);
            factor.solve_mut(&mut column);
            w.copy_from_slice(column.as_slice());
        }
    }

    /// Learns all weights at once from samples of one or more periods; the centre becomes their mean.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for fewer than two samples; sizes and values as in [`learn`](Self::learn). An
    /// amplitude of 0 cannot be learned.
    ///
    /// # Source
    /// Least squares on (6) with all kernels at once and a ridge of 1e-9 of the mean diagonal, instead of the
    /// kernel-wise regression of the papers. The path then fits as closely as the kernels allow.
    pub fn learn_batch(&mut self, samples: &[PhaseSample]) -> Result<(), MotionError> {
        let n = self.dofs();
        check_samples(samples, n)?;
        self.dmp.check_amplitude()?;
        let centre: Vec<f64> =
            (0..n).map(|d| samples.iter().map(|s| s.y[d]).sum::<f64>() / samples.len() as f64).collect();
        let system = &self.dmp.transformation;
        let row = |s: &PhaseSample| -> Vec<f64> {
            (0..n).map(|d| system.forcing(centre[d], s.y[d], s.dy[d], s.ddy[d])).collect()
        };
        let targets: Vec<f64> = samples.iter().flat_map(row).collect();
        let phases = samples.iter().map(|s| s.phase);
        // Most kernels are far away: their contribution is below rounding.
        let cutoff = Cutoff { first: 1e-9, second: 1e-9 };
        let weights = self.dmp.regress(phases, &targets, cutoff, Ridge::Relative(1e-9))?;
        self.weights_mut().copy_from_slice(&weights);
        self.centre_mut().copy_from_slice(&centre);
        Ok(())
    }
}

fn check_samples(samples: &[PhaseSample], n: usize) -> Result<(), MotionError> {
    if samples.len() < 2 {
        return Err(MotionError::TooFew { what: "samples", needed: 2, got: samples.len() });
    }
    for s in samples {
        finite("phase", &[s.phase])?;
        vector("y", n, &s.y)?;
        vector("dy", n, &s.dy)?;
        vector("ddy", n, &s.ddy)?;
    }
    Ok(())
}
