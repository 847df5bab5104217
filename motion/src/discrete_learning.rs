//! How a [`DiscreteDmp`] learns: sample by sample, from a coupling term, or all at once by regression.

use nalgebra::{DMatrix, DVector};

use crate::discrete::DiscreteDmp;
use crate::error::{MotionError, constant, finite, positive, vector, within};

/// One sample of a demonstrated movement, for batch learning; the slices have one value a degree of freedom.
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

impl DiscreteDmp {
    /// Learns from one sample: `y`, `yd` (unit/s), `ydd` (unit/s^2) at `t` s of a demonstration of `duration` s whose
    /// goal is set, `dt` s after the sample before. The state that [`step`](Self::step) integrates is not touched.
    /// Does not allocate.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite, `t` is negative, or `dt` or `duration` not positive; nothing is
    /// learned.
    ///
    /// # Source
    /// Eqs. (8)-(11) with `1 / duration` for Omega and `x r` for r; differs in: lambda holds for 10 ms and is scaled
    /// with `dt`, and P stays at most at its initial value.
    pub fn learn(
        &mut self,
        t: f64,
        duration: f64,
        dt: f64,
        y: &[f64],
        yd: &[f64],
        ydd: &[f64],
    ) -> Result<(), MotionError> {
        let n = self.dofs();
        within("t", t, 0.0, f64::MAX)?;
        constant("duration", duration)?;
        positive("dt", dt)?;
        vector("y", n, y)?;
        vector("yd", n, yd)?;
        vector("ydd", n, ydd)?;
        let x = self.phase_at(t, duration);
        self.fresh = false;
        self.kernels.evaluate(x, &mut self.psi);
        self.update_gain(dt, x);
        let (alpha, beta, r) = (self.config.alpha_z, self.config.beta_z, self.amplitude * x);
        let k = self.config.kernels;
        for (d, w) in self.weights.chunks_exact_mut(k).enumerate() {
            let target =
                duration * duration * ydd[d] - alpha * (beta * (self.goal[d] - y[d]) - duration * yd[d]);
            for ((w, psi), p) in w.iter_mut().zip(&self.psi).zip(&self.gain) {
                *w += psi * p * r * (target - *w * r);
            }
        }
        Ok(())
    }

    fn phase_at(&self, t: f64, duration: f64) -> f64 {
        (-self.config.alpha_x * t / duration).exp().max(1e-12)
    }

    /// (9) at the kernel values in `psi`.
    fn update_gain(&mut self, dt: f64, x: f64) {
        let lambda = self.config.forgetting.powf(dt / 0.01);
        let r2 = (self.amplitude * x).powi(2);
        for (p, psi) in self.gain.iter_mut().zip(&self.psi) {
            *p = (*p / (lambda + *p * r2 * psi)).min(self.config.initial_gain);
        }
    }

    /// (9), (10), (13) at the kernel values in `psi`.
    pub(crate) fn update_weights(&mut self, dt: f64, x: f64, coupling: &[f64]) {
        self.update_gain(dt, x);
        let (k, r) = (self.config.kernels, self.amplitude * x);
        for (w, c) in self.weights.chunks_exact_mut(k).zip(coupling) {
            for ((w, psi), p) in w.iter_mut().zip(&self.psi).zip(&self.gain) {
                *w += psi * p * r * c;
            }
        }
    }

    /// Learns all weights at once from the samples of one movement, which lasts from the first to the last of them;
    /// start and goal become its ends, and the state is put to the start. Returns its duration, s.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for less than two samples; when sizes differ, a value is not finite or time does not go
    /// on. An amplitude of 0 cannot be learned.
    ///
    /// # Source
    /// Least squares on (6) with all kernels at once and a ridge of 1e-9 of the mean diagonal.
    pub fn learn_batch(&mut self, samples: &[TimeSample]) -> Result<f64, MotionError> {
        let n = self.dofs();
        check(samples, n)?;
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
            return Err(MotionError::TooFew { what: "samples", needed: 2, got: 0 });
        };
        if self.amplitude == 0.0 {
            return Err(MotionError::Degenerate { what: "amplitude", why: "0 hides every weight" });
        }
        let duration = last.t - first.t;
        let (normal, moment) = self.normal_equations(samples, first.t, duration, &last.y);
        let factor = normal
            .cholesky()
            .ok_or(MotionError::Degenerate { what: "samples", why: "their times leave kernels open" })?;
        let solution = factor.solve(&moment);
        finite("weights", solution.as_slice())?;
        self.begin(&first.y, &first.yd, duration)?;
        self.weights.copy_from_slice(solution.as_slice());
        self.fresh = false;
        self.start.copy_from_slice(&first.y);
        self.goal.copy_from_slice(&last.y);
        Ok(duration)
    }

    fn normal_equations(
        &self,
        samples: &[TimeSample],
        begin: f64,
        duration: f64,
        goal: &[f64],
    ) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, k) = (self.dofs(), self.config.kernels);
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        let mut normal: DMatrix<f64> = DMatrix::zeros(k, k);
        let mut moment = DMatrix::zeros(k, n);
        let mut psi = DVector::zeros(k);
        for s in samples {
            let x = self.phase_at(s.t - begin, duration);
            let sum = self.kernels.evaluate(x, psi.as_mut_slice());
            psi *= self.amplitude * x / sum;
            normal.ger(1.0, &psi, &psi, 1.0);
            for (d, goal) in goal.iter().enumerate() {
                let pull = alpha * (beta * (goal - s.y[d]) - duration * s.yd[d]);
                moment.column_mut(d).axpy(duration * duration * s.ydd[d] - pull, &psi, 1.0);
            }
        }
        let ridge = 1e-9 * (normal.trace() / k as f64).max(f64::MIN_POSITIVE);
        for i in 0..k {
            normal[(i, i)] += ridge;
        }
        (normal, moment)
    }
}

fn check(samples: &[TimeSample], n: usize) -> Result<(), MotionError> {
    if samples.len() < 2 {
        return Err(MotionError::TooFew { what: "samples", needed: 2, got: samples.len() });
    }
    for s in samples {
        within("t", s.t, -1e12, 1e12)?;
        vector("y", n, &s.y)?;
        vector("yd", n, &s.yd)?;
        vector("ydd", n, &s.ydd)?;
    }
    for pair in samples.windows(2) {
        positive("time between samples", pair[1].t - pair[0].t)?;
    }
    Ok(())
}
