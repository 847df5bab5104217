//! A learned offset along a surface normal, as a function of the phase: wiping adds it to a motion to keep the
//! force. [`crate::SurfaceAdaptation`] learns it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::error::{MotionError, kernel_width, vector, within};
use crate::periodic::PhaseKernels;

/// `offset(phase)` along `normal`, m, as a sum of normalised kernels over the phase.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SavedCorrection", into = "SavedCorrection")]
pub struct SurfaceCorrection {
    kernels: PhaseKernels,
    pub(crate) weights: Vec<f64>,
    normal: Vector3<f64>,
}

impl SurfaceCorrection {
    /// A correction from its kernels' `weights` (m), their `width` h, and the outward surface normal (any length) in
    /// the motion's frame. A positive offset leads away from the surface.
    ///
    /// # Errors
    /// When there are fewer than two weights, a value is not finite or the normal is zero.
    pub fn new(weights: Vec<f64>, width: f64, normal: [f64; 3]) -> Result<Self, MotionError> {
        within("weights of the surface correction", weights.len() as f64, 2.0, 4096.0)?;
        vector("weights of the surface correction", weights.len(), &weights)?;
        kernel_width("width", width, weights.len())?;
        vector("normal", 3, &normal)?;
        let normal = Vector3::from(normal)
            .try_normalize(1e-9)
            .ok_or(MotionError::Degenerate { what: "normal", why: "it has no length" })?;
        Ok(Self { kernels: PhaseKernels::new(weights.len(), width), weights, normal })
    }

    /// Outward surface normal, a unit vector in the motion's frame.
    pub fn normal(&self) -> Vector3<f64> {
        self.normal
    }

    /// The weights, m, one per kernel.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// The kernels.
    pub fn kernels(&self) -> &PhaseKernels {
        &self.kernels
    }

    /// The offset (m, outward) at `phase` rad. Does not allocate.
    pub fn offset(&self, phase: f64) -> f64 {
        self.offset_and_slope(phase).0
    }

    /// The offset (m) and its derivative with respect to the phase (m/rad) at `phase` rad. Does not allocate.
    pub fn offset_and_slope(&self, phase: f64) -> (f64, f64) {
        let n = self.weights.len() as f64;
        let (mut sum, mut weighted, mut slope_sum, mut slope_weighted) = (0.0, 0.0, 0.0, 0.0);
        for (i, w) in self.weights.iter().enumerate() {
            let (sin, cos) = libm::sincos(phase - std::f64::consts::TAU * i as f64 / n);
            let psi = libm::exp(self.kernels.width() * (cos - 1.0));
            let slope = -self.kernels.width() * sin * psi;
            sum += psi;
            weighted += psi * w;
            slope_sum += slope;
            slope_weighted += slope * w;
        }
        let offset = weighted / sum;
        (offset, (slope_weighted - offset * slope_sum) / sum)
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedCorrection {
    weights: Vec<f64>,
    width: f64,
    normal: [f64; 3],
}

impl From<SurfaceCorrection> for SavedCorrection {
    fn from(c: SurfaceCorrection) -> Self {
        Self { width: c.kernels.width(), weights: c.weights, normal: c.normal.into() }
    }
}

impl TryFrom<SavedCorrection> for SurfaceCorrection {
    type Error = MotionError;

    fn try_from(s: SavedCorrection) -> Result<Self, MotionError> {
        Self::new(s.weights, s.width, s.normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_is_the_derivative() {
        let weights = (0..36).map(|i| ((i * 7 % 13) as f64 - 6.0) * 1e-3).collect();
        let c = SurfaceCorrection::new(weights, 90.0, [0.0, 0.0, 2.0]).unwrap();
        for k in 0..50 {
            let phase = f64::from(k) * 0.3;
            let numeric = (c.offset(phase + 1e-5) - c.offset(phase - 1e-5)) / 2e-5;
            assert!((c.offset_and_slope(phase).1 - numeric).abs() < 1e-7);
        }
        assert!((c.normal() - Vector3::z()).norm() < 1e-15);
    }
}
