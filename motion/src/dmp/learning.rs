//! Learning of a primitive's weights: sample by sample by recursive least squares with forgetting (eqs. 8-11), from
//! a coupling term (eq. 13), or all at once by ridge regression.

use nalgebra::{DMatrix, DVector};

use super::{Canonical, Dmp, TimeScale};
use crate::error::{MotionError, finite, positive, vector, within};

/// One sample of a demonstrated movement, for batch learning; the slices have one value per degree of freedom.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeSample {
    /// Time since the start, s.
    pub t: f64,
    /// Position.
    pub y: Vec<f64>,
    /// Velocity, unit / s.
    pub yd: Vec<f64>,
    /// Acceleration, unit / s^2.
    pub ydd: Vec<f64>,
}

/// Checks that there are at least two samples of `dofs` finite values with increasing times.
pub(crate) fn check_time_samples(samples: &[TimeSample], dofs: usize) -> Result<(), MotionError> {
    if samples.len() < 2 {
        return Err(MotionError::TooFew { what: "samples", needed: 2, got: samples.len() });
    }
    for s in samples {
        within("t", s.t, -1e12, 1e12)?;
        vector("y", dofs, &s.y)?;
        vector("yd", dofs, &s.yd)?;
        vector("ydd", dofs, &s.ydd)?;
    }
    samples.windows(2).try_for_each(|pair| positive("time between samples", pair[1].t - pair[0].t))
}

/// Recursive least squares over the kernels, with a pending coupling term for the next step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CouplingLearner {
    /// Forgetting factor lambda per 10 ms.
    forgetting: f64,
    initial_gain: f64,
    /// P of (9), one per kernel. All degrees of freedom share it because (9) does not depend on the data.
    pub(crate) gain: Vec<f64>,
    /// By how much a sample moves each weight: kernel value times gain times the factor of the forcing term.
    share: Vec<f64>,
    coupling: Vec<f64>,
    pub(crate) coupled: bool,
    /// Weights and gain before the pending coupling is learned, to restore them if the step is refused.
    weights_before: Vec<f64>,
    gain_before: Vec<f64>,
}

impl CouplingLearner {
    pub(crate) fn new(dofs: usize, kernels: usize, forgetting: f64, initial_gain: f64) -> Self {
        Self {
            forgetting,
            initial_gain,
            gain: vec![initial_gain; kernels],
            share: vec![0.0; kernels],
            coupling: vec![0.0; dofs],
            coupled: false,
            weights_before: vec![0.0; dofs * kernels],
            gain_before: vec![initial_gain; kernels],
        }
    }

    /// Resets P to its initial value.
    pub(crate) fn forget(&mut self) {
        self.gain.fill(self.initial_gain);
    }

    /// Sets P from a stored primitive.
    pub(crate) fn set_gain(&mut self, gain: Vec<f64>) -> Result<(), MotionError> {
        vector("gain", self.gain.len(), &gain)?;
        gain.iter().try_for_each(|p| within("gain", *p, 0.0, f64::MAX))?;
        self.gain = gain;
        Ok(())
    }

    /// The share of the learned information that is forgotten in `dt` s.
    pub(crate) fn forgotten(&self, dt: f64) -> f64 {
        1.0 - libm::pow(self.forgetting, dt / 0.01)
    }

    /// Sets P of every kernel to `p`, limited to P(0).
    pub(crate) fn settle(&mut self, p: f64) {
        self.gain.fill(p.min(self.initial_gain));
    }

    /// Keeps the coupling term for the next step.
    pub(crate) fn couple(&mut self, coupling: &[f64]) -> Result<(), MotionError> {
        vector("coupling", self.coupling.len(), coupling)?;
        self.coupling.copy_from_slice(coupling);
        self.coupled = true;
        Ok(())
    }

    /// (9) for the kernel values `psi` with the factor `r` of the forcing term, in a form without division by them.
    fn update_gain(&mut self, dt: f64, r: f64, psi: &[f64]) {
        let lambda = libm::pow(self.forgetting, dt / 0.01);
        let r2 = r * r;
        for ((p, psi), share) in self.gain.iter_mut().zip(psi).zip(&mut self.share) {
            *p = (*p / (lambda + *p * r2 * psi)).min(self.initial_gain);
            *share = psi * *p * r;
        }
    }

    /// (8)-(11) for one sample, `dt` s after the previous one: position `y`, velocity `yd` and acceleration `ydd`
    /// at `phase`. The inputs must have been checked. Does not allocate.
    pub(crate) fn learn<C: Canonical, const SUMS: usize>(
        &mut self,
        dmp: &mut Dmp<C, SUMS>,
        phase: C::Phase,
        scale: TimeScale,
        dt: f64,
        [y, yd, ydd]: [&[f64]; 3],
    ) {
        dmp.fresh = false;
        dmp.active = dmp.canonical.activate(phase, &mut dmp.psi);
        let r = dmp.amplitude * dmp.active.gate;
        self.update_gain(dt, r, &dmp.psi);
        let system = &dmp.transformation;
        for (d, w) in dmp.sums[0].weights.chunks_exact_mut(dmp.psi.len()).enumerate() {
            let target = system.forcing(system.goal[d], y[d], scale.slope(yd[d]), scale.curvature(ydd[d]));
            for (w, share) in w.iter_mut().zip(&self.share) {
                *w += share * (target - *w * r);
            }
        }
    }

    /// Lets the weights learn the pending coupling term by (9), (10), (13), and then runs `step`. A refused step
    /// leaves weights, gain and coupling unchanged. Does not allocate.
    pub(crate) fn step<C: Canonical, const SUMS: usize>(
        &mut self,
        dmp: &mut Dmp<C, SUMS>,
        dt: f64,
        step: impl FnOnce(&mut Dmp<C, SUMS>) -> Result<(), MotionError>,
    ) -> Result<(), MotionError> {
        if !self.coupled {
            return step(dmp);
        }
        dmp.refresh();
        self.gain_before.copy_from_slice(&self.gain);
        let r = dmp.amplitude * dmp.active.gate;
        self.update_gain(dt, r, &dmp.psi);
        let weights = &mut dmp.sums[0].weights;
        std::mem::swap(weights, &mut self.weights_before);
        let kernels = dmp.psi.len();
        let rows = weights.chunks_exact_mut(kernels).zip(self.weights_before.chunks_exact(kernels));
        for ((new, old), c) in rows.zip(&self.coupling) {
            for ((new, old), share) in new.iter_mut().zip(old).zip(&self.share) {
                *new = old + share * c;
            }
        }
        let stepped = step(dmp);
        if stepped.is_ok() {
            self.coupled = false;
        } else {
            std::mem::swap(dmp.weights_mut(), &mut self.weights_before);
            self.gain.copy_from_slice(&self.gain_before);
        }
        stepped
    }
}

/// Regularisation of a regression, for kernels that the samples do not determine.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Ridge {
    /// In squared kernel values.
    Absolute(f64),
    /// As a share of the normal matrix's mean diagonal.
    Relative(f64),
}

/// Thresholds for small kernel values in a regression. The product of kernels `i >= j` is used only if the value of
/// `i` is over `first` and that of `j` is over `second`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cutoff {
    pub(crate) first: f64,
    pub(crate) second: f64,
}

impl<C: Canonical, const SUMS: usize> Dmp<C, SUMS> {
    /// The weights (degree of freedom by degree of freedom) for which a kernel sum fits `targets` (one row of
    /// `dofs` values per phase) best in the least-squares sense, with a ridge.
    pub(crate) fn regress(
        &self,
        phases: impl Iterator<Item = C::Phase>,
        targets: &[f64],
        cutoff: Cutoff,
        ridge: Ridge,
    ) -> Result<Vec<f64>, MotionError> {
        let (n, k) = (self.transformation.dofs(), self.psi.len());
        let mut normal: DMatrix<f64> = DMatrix::zeros(k, k);
        let mut moment: DMatrix<f64> = DMatrix::zeros(k, n);
        let mut psi: DVector<f64> = DVector::zeros(k);
        for (phase, target) in phases.zip(targets.chunks_exact(n)) {
            let active = self.canonical.activate(phase, psi.as_mut_slice());
            psi *= self.amplitude * active.gate / active.sum;
            for i in active.used.clone().filter(|i| psi[*i].abs() > cutoff.first) {
                for j in active.used.start..=i {
                    if psi[j].abs() > cutoff.second {
                        normal[(i, j)] += psi[i] * psi[j];
                    }
                }
                for (d, t) in target.iter().enumerate() {
                    moment[(i, d)] += psi[i] * t;
                }
            }
        }
        let ridge = match ridge {
            Ridge::Absolute(ridge) => ridge,
            Ridge::Relative(share) => share * (normal.trace() / k as f64).max(f64::MIN_POSITIVE),
        };
        for i in 0..k {
            normal[(i, i)] += ridge;
        }
        // The decomposition uses the lower triangle only.
        let open = MotionError::Degenerate { what: "samples", why: "they leave kernels open" };
        let solution = normal.cholesky().ok_or(open)?.solve(&moment);
        finite("weights", solution.as_slice())?;
        Ok(solution.as_slice().to_vec())
    }
}
