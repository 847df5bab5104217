//! Learning of a [`DiscretePeriodicDmp`]: all weights of both kernel sets at once by regression, also those of the
//! control signal.

use super::DiscretePeriodicDmp;
use crate::dmp::{Canonical, Cutoff, Ridge, TimeSample, TimeScale, check_time_samples};
use crate::error::{MotionError, finite, positive, vector};

impl DiscretePeriodicDmp {
    /// Learns the forcing term from one demonstration: the discrete part, followed by at least a part of a period, with
    /// the duration and frequency for which the primitive was made. The start becomes that of the demonstration, the goal g the mean
    /// of its periodic part, and the state is set to the start. The control signal is kept.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for fewer than two samples or none in the periodic part; also when sizes differ, a
    /// value is not finite or the times do not increase. Nothing is changed then.
    ///
    /// # Source
    /// (1) solved for f, least squares on (5) over both kernel sets with the ridge of the config.
    pub fn learn(&mut self, samples: &[TimeSample]) -> Result<(), MotionError> {
        let n = self.dofs();
        check_time_samples(samples, n)?;
        let begin = samples[0].t;
        let periodic: Vec<&TimeSample> =
            samples.iter().filter(|s| s.t - begin >= self.duration - 1e-9).collect();
        if periodic.is_empty() {
            return Err(MotionError::TooFew { what: "samples of the periodic part", needed: 1, got: 0 });
        }
        let mean = |d: usize| periodic.iter().map(|s| s.y[d]).sum::<f64>() / periodic.len() as f64;
        let centre: Vec<f64> = (0..n).map(mean).collect();
        let (scale, system) = (TimeScale::Frequency(self.omega), &self.dmp.transformation);
        let row = |s: &TimeSample| -> Vec<f64> {
            let target =
                |d: usize| system.forcing(centre[d], s.y[d], scale.slope(s.yd[d]), scale.curvature(s.ydd[d]));
            (0..n).map(target).collect()
        };
        let targets: Vec<f64> = samples.iter().flat_map(row).collect();
        let weights = self.regress(&self.phases_of(samples)?, &targets)?;
        let slope: Vec<f64> = samples[0].yd.iter().map(|v| scale.slope(*v)).collect();
        self.set_weights(&weights)?;
        self.take_start(&samples[0].y, &slope, &centre);
        self.restart();
        Ok(())
    }

    /// The phase (phi, r) at each sample, at the demonstrated frequency.
    fn phases_of(&self, samples: &[TimeSample]) -> Result<Vec<(f64, f64)>, MotionError> {
        let scale = TimeScale::Frequency(self.omega);
        let mut phase = self.initial_phase();
        let mut last = samples.first().map_or(0.0, |s| s.t);
        let at = |s: &TimeSample| {
            if s.t > last {
                phase = self.dmp.canonical.advance(phase, s.t - last, scale)?;
                last = s.t;
            }
            Ok(phase)
        };
        samples.iter().map(at).collect()
    }

    /// The weights for which the kernel sum fits `targets` best (`dofs` values per phase), with the ridge of the
    /// config.
    pub(crate) fn regress(&self, phases: &[(f64, f64)], targets: &[f64]) -> Result<Vec<f64>, MotionError> {
        let cutoff = Cutoff { first: 1e-12, second: 0.0 };
        self.dmp.regress(phases.iter().copied(), targets, cutoff, Ridge::Absolute(self.config.ridge))
    }
}

/// Samples with velocity and acceleration from `positions`, one every `dt` s from time 0: second-order central
/// differences, one-sided at the ends.
///
/// # Errors
/// [`MotionError::TooFew`] for fewer than four positions; when sizes differ, a value is not finite or `dt` not positive.
pub fn differentiate(dt: f64, positions: &[Vec<f64>]) -> Result<Vec<TimeSample>, MotionError> {
    positive("dt", dt)?;
    let Some(n) = positions.first().map(Vec::len).filter(|_| positions.len() >= 4) else {
        return Err(MotionError::TooFew { what: "positions", needed: 4, got: positions.len() });
    };
    positions.iter().try_for_each(|p| vector("position", n, p))?;
    let last = positions.len() - 1;
    let sample = |k: usize| {
        let y = |i: usize, d: usize| positions[i][d];
        let velocity = |d: usize| match k {
            0 => (4.0 * y(1, d) - 3.0 * y(0, d) - y(2, d)) / (2.0 * dt),
            k if k == last => (3.0 * y(k, d) - 4.0 * y(k - 1, d) + y(k - 2, d)) / (2.0 * dt),
            k => (y(k + 1, d) - y(k - 1, d)) / (2.0 * dt),
        };
        let bend =
            |a: [usize; 4], d: usize| 2.0 * y(a[0], d) - 5.0 * y(a[1], d) + 4.0 * y(a[2], d) - y(a[3], d);
        let acceleration = |d: usize| {
            let difference = match k {
                0 => bend([0, 1, 2, 3], d),
                k if k == last => bend([k, k - 1, k - 2, k - 3], d),
                k => y(k + 1, d) - 2.0 * y(k, d) + y(k - 1, d),
            };
            difference / (dt * dt)
        };
        TimeSample {
            t: dt * k as f64,
            y: positions[k].clone(),
            yd: (0..n).map(velocity).collect(),
            ydd: (0..n).map(acceleration).collect(),
        }
    };
    let samples: Vec<TimeSample> = (0..=last).map(sample).collect();
    samples.iter().try_for_each(|s| finite("acceleration", &s.ydd))?;
    Ok(samples)
}
