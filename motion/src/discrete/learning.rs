//! Learning of a [`DiscreteDmp`]: sample by sample, from a coupling term, or all at once by regression.

use super::DiscreteDmp;
use crate::dmp::{Cutoff, Ridge, TimeSample, TimeScale, check_time_samples};
use crate::error::{MotionError, constant, positive, vector, within};

impl DiscreteDmp {
    /// Learns from one sample: `y`, `yd` (unit/s), `ydd` (unit/s^2) at `t` s of a demonstration of `duration` s,
    /// `dt` s after the previous sample. The goal must be set before. The state that [`step`](Self::step)
    /// integrates is not changed. Does not allocate.
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
        let x = self.dmp.canonical.phase_at(t, duration);
        self.learner.learn(&mut self.dmp, x, TimeScale::Duration(duration), dt, [y, yd, ydd]);
        Ok(())
    }

    /// Learns all weights at once from the samples of one movement, which lasts from the first to the last sample.
    /// Start and goal become its ends, and the state is set to the start. Returns the duration, s.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for fewer than two samples; also when sizes differ, a value is not finite or the
    /// times do not increase. An amplitude of 0 cannot be learned.
    ///
    /// # Source
    /// Least squares on (6) with all kernels at once and a ridge of 1e-9 of the mean diagonal.
    pub fn learn_batch(&mut self, samples: &[TimeSample]) -> Result<f64, MotionError> {
        let n = self.dofs();
        check_time_samples(samples, n)?;
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
            return Err(MotionError::TooFew { what: "samples", needed: 2, got: 0 });
        };
        self.dmp.check_amplitude()?;
        let duration = last.t - first.t;
        let (scale, system) = (TimeScale::Duration(duration), &self.dmp.transformation);
        let row = |s: &TimeSample| -> Vec<f64> {
            let target =
                |d: usize| system.forcing(last.y[d], s.y[d], scale.slope(s.yd[d]), scale.curvature(s.ydd[d]));
            (0..n).map(target).collect()
        };
        let targets: Vec<f64> = samples.iter().flat_map(row).collect();
        let phases = samples.iter().map(|s| self.dmp.canonical.phase_at(s.t - first.t, duration));
        let cutoff = Cutoff { first: 0.0, second: 0.0 };
        let weights = self.dmp.regress(phases, &targets, cutoff, Ridge::Relative(1e-9))?;
        self.begin(&first.y, &first.yd, duration)?;
        self.dmp.weights_mut().copy_from_slice(&weights);
        self.start.copy_from_slice(&first.y);
        self.set_goal(&last.y)?;
        Ok(duration)
    }
}
