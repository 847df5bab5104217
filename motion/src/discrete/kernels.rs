//! The bell-shaped kernels over a decaying phase, and the phase itself.

use crate::dmp::{Canonical, KernelActivation, TimeScale};
use crate::error::MotionError;

/// Lower bound of the phase, so that its logarithm stays bounded long after the end.
const MIN_PHASE: f64 = 1e-12;
/// Kernels at this distance or farther are left out: their values are under 1e-19 of the nearest one's.
const REACH: usize = 6;

/// `exp(-(u - i)^2 / 0.8)` over `u = (N - 1) t / duration`, which is `-(N - 1) ln x / alpha_x`. The kernels have
/// equal widths and distances in time; the last one continues after the end.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DecayKernels {
    count: usize,
    alpha_x: f64,
    per_log: f64,
}

impl DecayKernels {
    /// `count` kernels, at least 2, for a phase that ends at `exp(-alpha_x)`.
    pub(crate) fn new(count: usize, alpha_x: f64) -> Self {
        Self { count, alpha_x, per_log: (count - 1) as f64 / alpha_x }
    }

    /// The phase at `t` s of a movement of `duration` s.
    pub(super) fn phase_at(&self, t: f64, duration: f64) -> f64 {
        libm::exp(-self.alpha_x * t / duration).max(MIN_PHASE)
    }

    /// Writes the kernel values at phase `x` to `out`. The sum is never 0.
    pub(crate) fn evaluate(&self, x: f64, out: &mut [f64]) -> KernelActivation {
        let u = (-libm::log(x) * self.per_log).clamp(0.0, (self.count - 1) as f64);
        let below = u as usize;
        let used = (below + 1).saturating_sub(REACH)..(below + 1 + REACH).min(self.count);
        out.fill(0.0);
        let mut sum = 0.0;
        for (i, o) in used.clone().zip(&mut out[used.clone()]) {
            let away = u - i as f64;
            *o = libm::exp(-away * away / 0.8);
            sum += *o;
        }
        KernelActivation { used, sum, gate: x }
    }
}

/// The canonical system `tau x' = -alpha_x x`.
impl Canonical for DecayKernels {
    /// 1 at the start, `exp(-alpha_x)` after the duration.
    type Phase = f64;

    fn kernels(&self) -> usize {
        self.count
    }

    fn advance(&self, x: f64, dt: f64, scale: TimeScale) -> Result<f64, MotionError> {
        Ok((x * libm::exp(-self.alpha_x * scale.advance(dt))).max(MIN_PHASE))
    }

    /// The gate is the phase: the forcing term decays with it.
    fn activate(&self, x: f64, psi: &mut [f64]) -> KernelActivation {
        self.evaluate(x, psi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_one_in_its_turn_and_the_last_one_holds_on() {
        let (count, alpha) = (7, 2.0);
        let kernels = DecayKernels::new(count, alpha);
        let mut psi = vec![0.0; count];
        for i in 0..count {
            let x = libm::exp(-alpha * i as f64 / (count - 1) as f64);
            let active = kernels.evaluate(x, &mut psi);
            assert!((psi[i] - 1.0).abs() < 1e-12 && (psi.iter().sum::<f64>() - active.sum).abs() < 1e-12);
        }
        kernels.evaluate(1e-12, &mut psi);
        assert_eq!(psi[count - 1], 1.0);
    }
}
