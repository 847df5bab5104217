//! The bell-shaped kernels over one period (eq. 7), and the periodic phase.

use std::f64::consts::TAU;

use crate::dmp::{Canonical, KernelActivation, TimeScale};
use crate::error::MotionError;

/// `n` equal kernels `exp(h (cos(phase - c_i) - 1))` with centres `c_i = 2 pi i / n`.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseKernels {
    width: f64,
    cos_centre: Vec<f64>,
    sin_centre: Vec<f64>,
    mean: f64,
}

impl PhaseKernels {
    /// `n` kernels (at least one) of `width` h, dimensionless; the papers' width is `2.5 n`.
    pub fn new(n: usize, width: f64) -> Self {
        let centre = |i: usize| TAU * i as f64 / n as f64;
        // The trapezoid rule converges exponentially for periodic functions.
        let samples = 2000;
        let value = |k: usize| libm::exp(width * (libm::cos(TAU * k as f64 / samples as f64) - 1.0));
        Self {
            width,
            cos_centre: (0..n).map(|i| libm::cos(centre(i))).collect(),
            sin_centre: (0..n).map(|i| libm::sin(centre(i))).collect(),
            mean: (0..samples).map(value).sum::<f64>() / samples as f64,
        }
    }

    /// The number of kernels.
    pub fn len(&self) -> usize {
        self.cos_centre.len()
    }

    /// Whether there is no kernel at all.
    pub fn is_empty(&self) -> bool {
        self.cos_centre.is_empty()
    }

    /// The width h.
    pub fn width(&self) -> f64 {
        self.width
    }

    /// The mean of one kernel over the period: its share of the samples in a uniform sweep.
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Writes the `len()` kernel values at `phase` (rad) to `out` and returns their sum. Does not allocate.
    pub fn evaluate(&self, phase: f64, out: &mut [f64]) -> f64 {
        let (sin, cos) = libm::sincos(phase);
        let mut sum = 0.0;
        for ((o, c), s) in out.iter_mut().zip(&self.cos_centre).zip(&self.sin_centre) {
            // cos(phase - c_i), expanded so that all kernels share one sine and cosine.
            let value = libm::exp(self.width * (cos * c + sin * s - 1.0));
            *o = value;
            sum += value;
        }
        sum
    }
}

/// The canonical system of a periodic movement (eq. 4's Omega): the phase moves on a circle.
impl Canonical for PhaseKernels {
    /// The phase, rad, in `0..2 pi`.
    type Phase = f64;

    fn kernels(&self) -> usize {
        self.len()
    }

    fn advance(&self, phase: f64, dt: f64, scale: TimeScale) -> Result<f64, MotionError> {
        Ok((phase + scale.advance(dt)).rem_euclid(TAU))
    }

    fn activate(&self, phase: f64, psi: &mut [f64]) -> KernelActivation {
        KernelActivation { used: 0..psi.len(), sum: self.evaluate(phase, psi), gate: 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kernel_is_one_at_its_centre_and_all_are_equal() {
        let kernels = PhaseKernels::new(25, 62.5);
        let mut psi = vec![0.0; 25];
        for i in 0..25 {
            kernels.evaluate(TAU * i as f64 / 25.0, &mut psi);
            assert!((psi[i] - 1.0).abs() < 1e-12);
        }
        // Wide kernels in closed form: exp(-h) I_0(h), about 1 / sqrt(2 pi h) for large h.
        assert!((kernels.mean() - 1.0 / (TAU * 62.5_f64).sqrt()).abs() < 2e-4);
    }
}
