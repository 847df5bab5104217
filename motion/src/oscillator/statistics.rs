//! The signal statistics of the adaptive oscillator: whether its phase error lasts, the signal's amplitude and
//! frequency, and means over whole periods.

use std::f64::consts::TAU;

/// Detects a lasting phase error: then the frequency is changing, and the loop's bandwidth grows.
#[derive(Debug, Clone, Default)]
pub(super) struct Drift {
    /// Phase error, rad, and its square, smoothed over a period.
    mean: f64,
    square: f64,
    /// Three standard deviations of the mean under noise alone, rad.
    noise: f64,
}

impl Drift {
    /// Adds the phase error `ahead` of the last `turned` rad. Returns the certainty that it lasts, 0 to 1. A mean
    /// within the noise counts as 0.
    pub(super) fn add(&mut self, ahead: f64, turned: f64) -> f64 {
        let share = 1.0 - libm::exp(-turned / TAU);
        self.mean += (ahead - self.mean) * share;
        self.square += (ahead * ahead - self.square) * share;
        self.noise = 3.0 * (0.5 * share * self.square).sqrt();
        ((self.lasting().abs() - 0.05) / 0.12).clamp(0.0, 1.0)
    }

    /// The lasting phase error, rad.
    pub(super) fn lasting(&self) -> f64 {
        self.mean - self.mean.clamp(-self.noise, self.noise)
    }
}

/// The quantities that scale the gains of [`super::OscillatorRule::Bare`].
#[derive(Debug, Clone)]
pub(super) struct Pace {
    /// Running frequency, Hz, smoothed over a period, so that the gains do not follow its changes within one.
    pub(super) hz: f64,
    /// Largest recent magnitude.
    pub(super) peak: f64,
}

impl Pace {
    pub(super) fn add(&mut self, dt: f64, omega: f64, v: f64) {
        let periods = self.hz * dt;
        self.hz += (omega / TAU - self.hz) * (1.0 - libm::exp(-periods));
        self.peak = v.abs().max(self.peak * libm::exp(-periods / 8.0));
    }
}

/// Means over whole periods.
#[derive(Debug, Clone)]
pub(super) struct PeriodMeans {
    turned: f64,
    sum: f64,
    missed: f64,
    weight: f64,
    power: f64,
    means: [f64; 3],
    count: usize,
    pub(super) unexplained: f64,
}

impl Default for PeriodMeans {
    fn default() -> Self {
        Self {
            turned: 0.0,
            sum: 0.0,
            missed: 0.0,
            weight: 0.0,
            power: 0.0,
            means: [0.0; 3],
            count: 0,
            unexplained: 1.0,
        }
    }
}

impl PeriodMeans {
    pub(super) fn residual(&mut self, turned: f64, missed: f64, power: f64) {
        self.missed += turned * missed;
        self.weight += turned;
        self.power = power;
    }

    pub(super) fn add(&mut self, omega: f64, turned: f64) {
        self.turned += turned;
        self.sum += omega * turned;
        if self.turned >= TAU {
            self.means.rotate_right(1);
            self.means[0] = self.sum / self.turned;
            self.count += 1;
            let share = self.missed / (self.weight * self.power);
            self.unexplained = if share.is_finite() { share } else { 1.0 };
            (self.turned, self.sum, self.missed, self.weight) = (0.0, 0.0, 0.0, 0.0);
        }
    }

    pub(super) fn steady(&self, tolerance: f64) -> bool {
        self.count >= 2 && (self.means[0] / self.means[1] - 1.0).abs() <= tolerance
    }
}
