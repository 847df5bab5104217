//! The path that belongs to a set of weights: the steady periodic solution of eqs. (4)-(7), without running the
//! primitive and without its transient.

use std::f64::consts::TAU;

use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};

use super::PeriodicDmp;
use crate::dmp::StepMatrix;
use crate::error::{MotionError, finite, within};

/// One period of n degrees of freedom, sampled evenly in the phase: sample `s` is at `2 pi s / samples`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PeriodicPath {
    /// Positions, one row of n values per sample.
    pub y: Vec<Vec<f64>>,
    /// Derivatives with respect to the phase (velocity / omega), unit / rad; one row per sample.
    pub dy: Vec<Vec<f64>>,
}

impl PeriodicPath {
    /// The number of samples.
    pub fn len(&self) -> usize {
        self.y.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.y.is_empty()
    }

    /// The phase of sample `s`, rad.
    pub fn phase(&self, s: usize) -> f64 {
        TAU * s as f64 / self.len().max(1) as f64
    }

    /// The mean position, one value per degree of freedom.
    pub fn mean(&self) -> Vec<f64> {
        let n = self.y.first().map_or(0, Vec::len);
        (0..n).map(|d| self.y.iter().map(|y| y[d]).sum::<f64>() / self.len() as f64).collect()
    }
}

impl PeriodicDmp {
    /// The steady path of the present weights, centre and amplitude, at `samples` phases (4 to 100 000).
    ///
    /// # Errors
    /// [`MotionError::OutOfRange`] for another number of samples.
    pub fn steady_path(&self, samples: usize) -> Result<PeriodicPath, MotionError> {
        within("samples", samples as f64, 4.0, 100_000.0)?;
        // Fine enough that the error of the trapezoid rule on the forcing term is far below a micrometre on a
        // metre.
        let fine = 800_usize.div_ceil(samples) * samples;
        let stride = fine / samples;
        let n = self.dofs();
        let forcing = self.forcing_over_period(0.0, fine);
        let mut path = PeriodicPath { y: vec![vec![0.0; n]; samples], dy: vec![vec![0.0; n]; samples] };
        for d in 0..n {
            let (mut y, mut z) = self.periodic_start(&forcing, n, d);
            for step in 0..fine {
                if step % stride == 0 {
                    path.y[step / stride][d] = self.centre()[d] + y;
                    path.dy[step / stride][d] = z;
                }
                (y, z) = self.phase_step(&forcing, n, d, step, y, z);
            }
        }
        Ok(path)
    }

    /// Sets the state to the steady path at `phase` rad, for a motion of `omega` rad/s: there is no transient.
    ///
    /// # Errors
    /// When the phase or `omega` is not finite.
    pub fn start_on_path(&mut self, phase: f64, omega: f64) -> Result<(), MotionError> {
        finite("phase", &[phase])?;
        finite("omega", &[omega])?;
        let (y, z) = self.steady_state(phase);
        self.put_state(phase, &y, &z, omega);
        Ok(())
    }

    /// Position and derivative with respect to the phase on the steady path at `phase` rad.
    pub fn steady_state(&self, phase: f64) -> (Vec<f64>, Vec<f64>) {
        let n = self.dofs();
        let fine = 800;
        let forcing = self.forcing_over_period(phase, fine);
        let mut state = (self.centre().to_vec(), vec![0.0; n]);
        for d in 0..n {
            let (y, z) = self.periodic_start(&forcing, n, d);
            state.0[d] += y;
            state.1[d] = z;
        }
        state
    }

    /// The forcing term at `fine + 1` phases of the period after `from`, row by row.
    fn forcing_over_period(&self, from: f64, fine: usize) -> Vec<f64> {
        let n = self.dofs();
        let mut forcing = vec![0.0; n * (fine + 1)];
        for (s, row) in forcing.chunks_exact_mut(n).enumerate() {
            self.forcing_at(from + TAU * s as f64 / fine as f64, row);
        }
        forcing
    }

    fn phase_step(&self, forcing: &[f64], n: usize, d: usize, step: usize, y: f64, z: f64) -> (f64, f64) {
        let fine = forcing.len() / n - 1;
        let transition = StepMatrix::new(self.config.alpha_z, self.config.beta_z, TAU / fine as f64);
        let mean = 0.5 * (forcing[step * n + d] + forcing[(step + 1) * n + d]);
        let rest = mean / (self.config.alpha_z * self.config.beta_z);
        let (y, z) = transition.apply(y - rest, z);
        (y + rest, z)
    }

    /// The state (relative to the centre) that returns to itself after the period: `(I - A) x = b`.
    fn periodic_start(&self, forcing: &[f64], n: usize, d: usize) -> (f64, f64) {
        let fine = forcing.len() / n - 1;
        let (mut y, mut z) = (0.0, 0.0);
        for step in 0..fine {
            (y, z) = self.phase_step(forcing, n, d, step, y, z);
        }
        let whole = StepMatrix::new(self.config.alpha_z, self.config.beta_z, TAU);
        let (yy, zy) = whole.apply(1.0, 0.0);
        let (yz, zz) = whole.apply(0.0, 1.0);
        let open = Matrix2::new(1.0 - yy, -yz, -zy, 1.0 - zz);
        // The system is damped, so A has no eigenvalue 1 and the matrix can be inverted.
        let inverse = open.try_inverse().unwrap_or_else(Matrix2::identity);
        let start = inverse * nalgebra::Vector2::new(y, z);
        (start.x, start.y)
    }
}

/// The response of the steady path to the weights: `y(phase) - g = r sum_i R(phase - c_i) w_i`, with the same curve
/// for every kernel, tabulated once. Reading does not allocate, so a coach can use it in every step.
#[derive(Debug, Clone, PartialEq)]
pub struct PathResponse {
    samples: usize,
    kernels: usize,
    /// Row by row: `table[s * kernels + i]`.
    table: Vec<f64>,
}

impl PathResponse {
    /// The response of `dmp`'s kernels at `8 * kernels` phases.
    ///
    /// # Errors
    /// As [`PeriodicDmp::new`].
    pub fn new(dmp: &PeriodicDmp) -> Result<Self, MotionError> {
        let kernels = dmp.kernels().len();
        let samples = 8 * kernels;
        let mut single = PeriodicDmp::new(super::PeriodicDmpConfig { dofs: 1, ..dmp.config().clone() })?;
        single.weights_mut()[0] = 1.0;
        let path = single.steady_path(samples)?;
        let mut table = vec![0.0; samples * kernels];
        for s in 0..samples {
            for i in 0..kernels {
                // Kernel i is kernel 0 shifted by 8 i samples.
                table[s * kernels + i] = path.y[(s + samples - 8 * i) % samples][0];
            }
        }
        Ok(Self { samples, kernels, table })
    }

    /// The number of tabulated phases.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The phase of table row `s`, rad.
    pub fn phase(&self, s: usize) -> f64 {
        TAU * s as f64 / self.samples as f64
    }

    /// The path at table row `s` for `weights` (one per kernel), amplitude 1 and centre 0.
    pub fn at_row(&self, s: usize, weights: &[f64]) -> f64 {
        let s = s % self.samples;
        let row = &self.table[s * self.kernels..(s + 1) * self.kernels];
        row.iter().zip(weights).map(|(r, w)| r * w).sum()
    }

    /// The table row nearest to `phase` rad.
    pub fn row(&self, phase: f64) -> usize {
        let turns = (phase / TAU).rem_euclid(1.0);
        if turns.is_finite() { (turns * self.samples as f64).round() as usize % self.samples } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PeriodicDmpConfig;

    fn wavy() -> PeriodicDmp {
        let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(2)).unwrap();
        let weights: Vec<f64> = (0..50).map(|i| ((i * 37 % 11) as f64 - 5.0) * 0.3).collect();
        dmp.set_weights(&weights).unwrap();
        dmp.set_centre(&[0.5, -1.0]).unwrap();
        dmp.set_amplitude(0.8).unwrap();
        dmp
    }

    #[test]
    fn the_steady_path_is_where_a_long_run_ends() {
        let mut dmp = wavy();
        let path = dmp.steady_path(100).unwrap();
        let (omega, dt) = (3.0, TAU / 3.0 / 2000.0);
        for _ in 0..6000 {
            dmp.step(dt, omega).unwrap();
        }
        for s in 0..100 {
            let state = dmp.state();
            let s_now = (state.phase / TAU * 100.0).round() as usize % 100;
            assert_eq!(s_now, s);
            for d in 0..2 {
                assert!((state.y[d] - path.y[s][d]).abs() < 1e-5, "{s} {d}");
                assert!((state.yd[d] / omega - path.dy[s][d]).abs() < 1e-4);
            }
            for _ in 0..20 {
                dmp.step(dt, omega).unwrap();
            }
        }
    }

    #[test]
    fn a_start_on_the_path_stays_on_it() {
        let mut dmp = wavy();
        let path = dmp.steady_path(400).unwrap();
        dmp.start_on_path(1.0, 2.0).unwrap();
        for _ in 0..500 {
            let state = dmp.step(0.004, 2.0).unwrap();
            let at = state.phase / TAU * 400.0;
            let (s, part) = (at.floor() as usize, at.fract());
            let y = path.y[s][0] * (1.0 - part) + path.y[(s + 1) % 400][0] * part;
            assert!((state.y[0] - y).abs() < 2e-4, "{} {}", state.y[0], y);
        }
    }

    #[test]
    fn the_response_adds_up_to_the_path() {
        let dmp = wavy();
        let response = PathResponse::new(&dmp).unwrap();
        let path = dmp.steady_path(response.samples()).unwrap();
        for s in 0..response.samples() {
            for d in 0..2 {
                let y = dmp.centre()[d]
                    + dmp.amplitude()
                        * response.at_row(s, dmp.weights().chunks_exact(dmp.kernels().len()).nth(d).unwrap());
                assert!((y - path.y[s][d]).abs() < 1e-9);
            }
        }
    }
}
