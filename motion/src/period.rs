//! The repeat period of a vector signal: the time shift for which its recent past is most similar to itself.
//!
//! All coordinates are compared together, so that a figure of eight repeats once per round although one of its
//! coordinates repeats twice.

use crate::error::{MotionError, positive, vector, within};

/// The recent past of an n-dimensional signal on a uniform time grid, in a ring buffer.
#[derive(Debug, Clone)]
pub(crate) struct History {
    dims: usize,
    pub(crate) grid: f64,
    capacity: usize,
    ring: Vec<f64>,
    head: usize,
    pub(crate) len: usize,
    /// Time from the newest grid point to the newest sample, s.
    pub(crate) overhang: f64,
    last: Vec<f64>,
    started: bool,
}

impl History {
    /// A history of `span` s in steps of `grid` s.
    pub(crate) fn new(dims: usize, grid: f64, span: f64) -> Self {
        let capacity = (span / grid).ceil() as usize + 1;
        Self {
            dims,
            grid,
            capacity,
            ring: vec![0.0; capacity * dims],
            head: 0,
            len: 0,
            overhang: 0.0,
            last: vec![0.0; dims],
            started: false,
        }
    }

    pub(crate) fn clear(&mut self) {
        self.len = 0;
        self.started = false;
    }

    /// Adds the sample `v`, `dt` s after the previous one, interpolated linearly onto the grid.
    pub(crate) fn push(&mut self, dt: f64, v: &[f64]) {
        if !self.started {
            self.started = true;
            self.overhang = 0.0;
            self.last.copy_from_slice(v);
            self.store(1.0, v);
            return;
        }
        // A gap longer than the history would only fill it with one straight line.
        let dt = dt.min(self.grid * self.capacity as f64);
        let mut reached = self.grid - self.overhang;
        while reached <= dt {
            self.store(reached / dt, v);
            reached += self.grid;
        }
        self.overhang = dt - (reached - self.grid);
        self.last.copy_from_slice(v);
    }

    fn store(&mut self, share: f64, v: &[f64]) {
        let slot = &mut self.ring[self.head * self.dims..(self.head + 1) * self.dims];
        for ((s, last), v) in slot.iter_mut().zip(&self.last).zip(v) {
            *s = last + share * (v - last);
        }
        self.head = (self.head + 1) % self.capacity;
        self.len = (self.len + 1).min(self.capacity);
    }

    /// The grid point `age` steps before the newest.
    pub(crate) fn at(&self, age: usize) -> &[f64] {
        let slot = (self.head + 2 * self.capacity - 1 - age) % self.capacity;
        &self.ring[slot * self.dims..(slot + 1) * self.dims]
    }

    /// Writes the newest `count` grid points to `out`, oldest first, and returns the mean squared distance from
    /// their mean.
    fn unroll(&self, count: usize, out: &mut Vec<f64>) -> f64 {
        out.clear();
        for age in (0..count).rev() {
            out.extend_from_slice(self.at(age));
        }
        let mut variance = 0.0;
        for d in 0..self.dims {
            let column = || out.iter().skip(d).step_by(self.dims);
            let mean = column().sum::<f64>() / count as f64;
            variance += column().map(|v| (v - mean) * (v - mean)).sum::<f64>() / count as f64;
        }
        variance
    }
}

/// A repeat period and how well the signal repeats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeriodEstimate {
    /// The period, s.
    pub period: f64,
    /// Mean squared difference over one period, relative to that of unrelated samples: 0 for exact repetition, 1
    /// for none.
    pub difference: f64,
}

/// Finds the repeat period of a vector signal, sample by sample.
#[derive(Debug, Clone)]
pub struct PeriodEstimator {
    history: History,
    shortest: f64,
    longest: f64,
    unrolled: Vec<f64>,
    difference: Vec<f64>,
}

impl PeriodEstimator {
    /// For a signal of `dims` coordinates and periods from `shortest` to `longest` s; keeps a history of 2.5 times
    /// the longest.
    ///
    /// # Errors
    /// When a bound is not positive, or the longest is not greater than the shortest or more than 1000 times as
    /// great.
    pub fn new(dims: usize, shortest: f64, longest: f64) -> Result<Self, MotionError> {
        within("dims", dims as f64, 1.0, 64.0)?;
        positive("shortest period", shortest)?;
        within("longest period", longest, shortest, 1000.0 * shortest)?;
        let history = History::new(dims, shortest / 20.0, 2.5 * longest);
        let unrolled = Vec::with_capacity(history.capacity * dims);
        let difference = Vec::with_capacity(history.capacity);
        Ok(Self { history, shortest, longest, unrolled, difference })
    }

    /// Adds a sample, `dt` s after the previous one.
    ///
    /// # Errors
    /// When `dt` is not positive or the sample does not fit; it is not added.
    pub fn push(&mut self, dt: f64, v: &[f64]) -> Result<(), MotionError> {
        positive("dt", dt)?;
        vector("sample", self.history.dims, v)?;
        self.history.push(dt, v);
        Ok(())
    }

    pub(crate) fn history(&self) -> &History {
        &self.history
    }

    /// Clears the history.
    pub fn clear(&mut self) {
        self.history.clear();
    }

    /// The repeat period of the signal so far, if it repeats; at least 1.75 periods must have been seen. Several
    /// spans of the past are tried, so that the time before the periodic part does not count for long.
    ///
    /// # Source
    /// The normalised difference function of de Cheveigné and Kawahara's YIN (2002), summed over the coordinates.
    pub fn estimate(&mut self) -> Option<PeriodEstimate> {
        let mut best: Option<PeriodEstimate> = None;
        for share in [1.0, 0.65, 0.4, 0.25, 0.15] {
            let count = (self.history.capacity as f64 * share) as usize;
            if count > self.history.len && share > 0.15 && self.history.len < (count * 2) / 3 {
                continue;
            }
            let found = self.estimate_over(count.min(self.history.len));
            // A longer past is better evidence, unless a shorter one repeats clearly better.
            best = match (best, found) {
                (Some(b), Some(f)) if f.difference < 0.6 * b.difference - 0.02 => Some(f),
                (None, found) => found,
                (best, _) => best,
            };
        }
        best
    }

    /// The estimate from the newest `span` s only.
    pub fn estimate_recent(&mut self, span: f64) -> Option<PeriodEstimate> {
        let count = (span / self.history.grid) as usize + 1;
        self.estimate_over(count.min(self.history.len))
    }

    fn estimate_over(&mut self, count: usize) -> Option<PeriodEstimate> {
        let longest = ((count as f64 / 1.75) as usize).min((self.longest / self.history.grid) as usize);
        let shortest = (self.shortest / self.history.grid) as usize;
        if longest <= shortest + 2 {
            return None;
        }
        let variance = self.history.unroll(count, &mut self.unrolled);
        if variance <= 1e-18 {
            return None;
        }
        self.compare_lags(longest + 1, variance);
        first_dip(&self.difference, shortest, longest)
            .map(|(lag, difference)| PeriodEstimate { period: lag * self.history.grid, difference })
    }

    /// The normalised difference for lags 0 to `longest`.
    fn compare_lags(&mut self, longest: usize, variance: f64) {
        let dims = self.history.dims;
        self.difference.clear();
        for lag in 0..=longest {
            let late = &self.unrolled[lag * dims..];
            let count = (late.len() / dims).max(1) as f64;
            let sum: f64 = late.iter().zip(&self.unrolled).map(|(a, b)| (a - b) * (a - b)).sum();
            self.difference.push(sum / count / (2.0 * variance));
        }
    }
}

/// The first minimum that is about as deep as the deepest: (lag, interpolated between the samples; depth).
fn first_dip(difference: &[f64], shortest: usize, longest: usize) -> Option<(f64, f64)> {
    // A small lag counts as a repetition only after the difference has been large.
    let apart = difference.iter().position(|d| *d > 0.5)?.max(shortest);
    let lags = apart..longest.min(difference.len() - 1);
    let deepest = lags.clone().map(|l| difference[l]).fold(f64::INFINITY, f64::min);
    if deepest > 0.35 {
        return None;
    }
    let threshold = deepest + 0.1;
    let enter = lags.clone().find(|l| difference[*l] <= threshold)?;
    let leave = (enter..lags.end).find(|l| difference[*l] > threshold).unwrap_or(lags.end);
    let lag = (enter..leave).min_by(|a, b| difference[*a].total_cmp(&difference[*b]))?;
    if lag == 0 || lag + 1 >= difference.len() || lag + 1 >= lags.end {
        return None;
    }
    let (a, b, c) = (difference[lag - 1], difference[lag], difference[lag + 1]);
    let curvature = a - 2.0 * b + c;
    let shift = if curvature > 0.0 { (0.5 * (a - c) / curvature).clamp(-1.0, 1.0) } else { 0.0 };
    Some((lag as f64 + shift, b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn estimate(period: f64, rate: f64, signal: impl Fn(f64) -> Vec<f64>) -> f64 {
        let dims = signal(0.0).len();
        let mut estimator = PeriodEstimator::new(dims, 0.25, 4.0).unwrap();
        let samples = (2.5 * period * rate) as usize;
        for k in 0..samples {
            estimator.push(1.0 / rate, &signal(k as f64 / rate / period * TAU)).unwrap();
        }
        estimator.estimate().unwrap().period / period
    }

    #[test]
    fn shapes_repeat_once_a_round() {
        for period in [0.34, 0.8, 1.7, 3.3] {
            for rate in [60.0, 1000.0] {
                let near = |ratio: f64| (ratio - 1.0).abs() < 0.02;
                assert!(near(estimate(period, rate, |p| vec![libm::sin(p)])), "sine {period} {rate}");
                let eight = |p: f64| vec![0.5 * libm::sin(p) + 0.87 * libm::sin(2.0 * p)];
                assert!(near(estimate(period, rate, eight)), "eight {period} {rate}");
                let turned = |p: f64| {
                    vec![
                        libm::sin(p) + 0.7 * libm::sin(2.0 * p),
                        0.6 * libm::sin(2.0 * p) - libm::sin(p),
                        1.0,
                    ]
                };
                assert!(near(estimate(period, rate, turned)));
            }
        }
    }

    #[test]
    fn noise_and_stillness_have_no_period() {
        let mut estimator = PeriodEstimator::new(1, 0.25, 4.0).unwrap();
        let mut seed = 1_u64;
        for _ in 0..600 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            estimator.push(1.0 / 60.0, &[(seed >> 40) as f64]).unwrap();
        }
        assert_eq!(estimator.estimate(), None);
        estimator.clear();
        for _ in 0..600 {
            estimator.push(1.0 / 60.0, &[0.3]).unwrap();
        }
        assert_eq!(estimator.estimate(), None);
    }
}
