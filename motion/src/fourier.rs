//! The adaptive Fourier series of several coordinates on one phase (eq. 3), in signal units.

use nalgebra::{SMatrix, SVector};

/// `v_d(phase) = sum_c alpha_dc cos(c phase) + beta_dc sin(c phase)`, c from 0 to the number of harmonics.
#[derive(Debug, Clone)]
pub(crate) struct FourierSeries {
    dims: usize,
    harmonics: usize,
    /// `alpha[d * (harmonics + 1) + c]`.
    alpha: Vec<f64>,
    beta: Vec<f64>,
    /// Cosines and sines of the last evaluated phase.
    cosine: Vec<f64>,
    sine: Vec<f64>,
}

impl FourierSeries {
    pub(crate) fn new(dims: usize, harmonics: usize) -> Self {
        let n = dims * (harmonics + 1);
        Self {
            dims,
            harmonics,
            alpha: vec![0.0; n],
            beta: vec![0.0; n],
            cosine: vec![1.0; harmonics + 1],
            sine: vec![0.0; harmonics + 1],
        }
    }

    pub(crate) fn harmonics(&self) -> usize {
        self.harmonics
    }

    /// The weights alpha and beta of coordinate `d` and harmonic `c`.
    pub(crate) fn weight(&self, d: usize, c: usize) -> (f64, f64) {
        let i = d * (self.harmonics + 1) + c;
        (self.alpha[i], self.beta[i])
    }

    fn tabulate(&mut self, phase: f64) {
        let (sin, cos) = libm::sincos(phase);
        let (mut s, mut c) = (0.0, 1.0);
        for k in 0..=self.harmonics {
            self.cosine[k] = c;
            self.sine[k] = s;
            (c, s) = (c * cos - s * sin, s * cos + c * sin);
        }
    }

    /// The value of every coordinate at `phase`, to which later calls of [`learn`](Self::learn) refer. Also the
    /// derivative with respect to the phase, with each harmonic divided by its number: a phase detector that steep
    /// edges do not make narrow.
    pub(crate) fn evaluate(&mut self, phase: f64, value: &mut [f64], slope: &mut [f64]) {
        self.tabulate(phase);
        for d in 0..self.dims {
            let (mut v, mut s) = (0.0, 0.0);
            for c in 0..=self.harmonics {
                let (a, b) = self.weight(d, c);
                v += a * self.cosine[c] + b * self.sine[c];
                s += b * self.cosine[c] - a * self.sine[c];
            }
            value[d] = v;
            slope[d] = s;
        }
    }

    /// Value, first and second derivative with respect to the phase, as learning data.
    pub(crate) fn triplet(&self, phase: f64, y: &mut [f64], dy: &mut [f64], ddy: &mut [f64]) {
        for d in 0..self.dims {
            (y[d], dy[d], ddy[d]) = (0.0, 0.0, 0.0);
        }
        for c in 0..=self.harmonics {
            let k = c as f64;
            let (sin, cos) = libm::sincos(k * phase);
            for d in 0..self.dims {
                let (a, b) = self.weight(d, c);
                let v = a * cos + b * sin;
                y[d] += v;
                dy[d] += k * (b * cos - a * sin);
                ddy[d] -= k * k * v;
            }
        }
    }

    /// Gradient step with `rate` on the errors at the last evaluated phase, for harmonics up to `highest`. The
    /// first sine weight of the coordinate `pinned` stays 0, so that the phase is defined.
    pub(crate) fn learn_pinned(&mut self, rate: f64, error: &[f64], highest: usize, pinned: usize) {
        for (d, error) in error.iter().enumerate().take(self.dims) {
            let base = d * (self.harmonics + 1);
            self.alpha[base] += rate * error;
            for c in 1..=self.harmonics.min(highest) {
                self.alpha[base + c] += 2.0 * rate * self.cosine[c] * error;
                if c > 1 || d != pinned {
                    self.beta[base + c] += 2.0 * rate * self.sine[c] * error;
                }
            }
        }
    }

    /// The same step without the part that would shift the whole signal in phase: phase errors are corrected by the
    /// phase itself, and meanwhile the coordinates keep their relative phases.
    pub(crate) fn learn(&mut self, rate: f64, error: &[f64], highest: usize) {
        let highest = self.harmonics.min(highest);
        let (mut along, mut norm) = (0.0, 0.0);
        for (d, error) in error.iter().enumerate().take(self.dims) {
            let base = d * (self.harmonics + 1);
            self.alpha[base] += rate * error;
            for c in 1..=highest {
                let (a, b, k) = (self.alpha[base + c], self.beta[base + c], c as f64);
                along += k * (b * self.cosine[c] - a * self.sine[c]) * error;
                norm += k * k * (a * a + b * b);
            }
        }
        let shift = if norm > 1e-300 { along / norm } else { 0.0 };
        for (d, error) in error.iter().enumerate().take(self.dims) {
            let base = d * (self.harmonics + 1);
            for c in 1..=highest {
                let (a, b, turn) = (self.alpha[base + c], self.beta[base + c], c as f64 * shift);
                self.alpha[base + c] += 2.0 * rate * (self.cosine[c] * error - turn * b);
                self.beta[base + c] += 2.0 * rate * (self.sine[c] * error + turn * a);
            }
        }
    }

    /// Mean product of the derivative with respect to the phase and the detector of [`evaluate`](Self::evaluate):
    /// the response to a phase error of 1 rad.
    pub(crate) fn slope_power(&self) -> f64 {
        let mut power = 0.0;
        for d in 0..self.dims {
            for c in 1..=self.harmonics {
                let (a, b) = self.weight(d, c);
                power += 0.5 * c as f64 * (a * a + b * b);
            }
        }
        power
    }

    /// Mean square about the mean, summed over the coordinates.
    pub(crate) fn power(&self) -> f64 {
        let mut power = 0.0;
        for d in 0..self.dims {
            for c in 1..=self.harmonics {
                let (a, b) = self.weight(d, c);
                power += 0.5 * (a * a + b * b);
            }
        }
        power
    }

    /// The coordinate with the strongest fundamental.
    pub(crate) fn strongest(&self) -> usize {
        let strength = |d: &usize| {
            let (a, b) = self.weight(*d, 1);
            a * a + b * b
        };
        (0..self.dims).max_by(|x, y| strength(x).total_cmp(&strength(y))).unwrap_or(0)
    }

    /// Moves the origin of the phase to the maximum of the fundamental of coordinate `d`, and returns the shift:
    /// new phase = old phase - shift.
    pub(crate) fn anchor(&mut self, d: usize) -> f64 {
        let (a, b) = self.weight(d, 1);
        let shift = libm::atan2(b, a);
        for c in 1..=self.harmonics {
            let (sin, cos) = libm::sincos(c as f64 * shift);
            for e in 0..self.dims {
                let i = e * (self.harmonics + 1) + c;
                let (a, b) = (self.alpha[i], self.beta[i]);
                self.alpha[i] = a * cos + b * sin;
                self.beta[i] = b * cos - a * sin;
            }
        }
        self.beta[d * (self.harmonics + 1) + 1] = 0.0;
        shift
    }

    /// Fits the weights up to `highest` (at most [`FITTED`]) to samples `(phase, values)` by least squares with a
    /// small ridge. Returns the remaining sum of squares (infinite if there is no fit). Does not allocate.
    pub(crate) fn fit<'a>(
        &mut self,
        highest: usize,
        samples: impl Iterator<Item = (f64, &'a [f64])> + Clone,
    ) -> f64 {
        let highest = highest.min(self.harmonics).min(FITTED);
        let mut normal = Normal::zeros();
        for (phase, _) in samples.clone() {
            let row = self.row(phase, highest);
            normal.ger(1.0, &row, &row, 1.0);
        }
        let ridge = 1e-3 * normal[(0, 0)].max(1.0);
        for i in 1..TERMS {
            normal[(i, i)] += ridge;
        }
        let Some(factor) = normal.cholesky() else { return f64::INFINITY };
        self.alpha.fill(0.0);
        self.beta.fill(0.0);
        let mut left = 0.0;
        for d in 0..self.dims {
            let mut moment = Terms::zeros();
            for (phase, values) in samples.clone() {
                moment.axpy(values[d], &self.row(phase, highest), 1.0);
                left += values[d] * values[d];
            }
            let solution = factor.solve(&moment);
            left -= moment.dot(&solution);
            self.take(d, highest, &solution);
        }
        left
    }

    /// The regressors at a phase: 1, then cosine and sine of each harmonic up to `highest`, then zeros.
    fn row(&mut self, phase: f64, highest: usize) -> Terms {
        self.tabulate(phase);
        let mut row = Terms::zeros();
        row[0] = 1.0;
        for c in 1..=highest {
            (row[2 * c - 1], row[2 * c]) = (self.cosine[c], self.sine[c]);
        }
        row
    }

    fn take(&mut self, d: usize, highest: usize, solution: &Terms) {
        let base = d * (self.harmonics + 1);
        self.alpha[base] = solution[0];
        for c in 1..=highest {
            (self.alpha[base + c], self.beta[base + c]) = (solution[2 * c - 1], solution[2 * c]);
        }
    }
}

/// Largest number of harmonics in a fit; a few periods do not determine more.
pub(crate) const FITTED: usize = 5;
const TERMS: usize = 2 * FITTED + 1;
type Terms = SVector<f64, TERMS>;
type Normal = SMatrix<f64, TERMS, TERMS>;
