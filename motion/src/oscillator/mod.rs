//! The adaptive frequency oscillator with an adaptive Fourier series (eqs. 1-3): it finds phase and frequency of a
//! periodic signal of one or several coordinates, with any wave form.
//!
//! Three things go beyond the paper. The phase error is computed from the whole estimated signal (its derivative
//! with respect to the phase) instead of the fundamental of one coordinate, so that figures of eight and other
//! signals with a weak fundamental lock too. All gains scale with the running frequency and the signal's power, so
//! that they settle in the same number of periods at any frequency and amplitude. The initial values are estimated
//! from the signal so far ([`PeriodEstimator`]). [`OscillatorRule::Paper`] is the paper's rule, for comparison.

mod config;
mod statistics;

use std::f64::consts::TAU;

use crate::error::{MotionError, sample_time, vector};
use crate::fourier::FourierSeries;
use crate::period::{PeriodEstimate, PeriodEstimator};

pub use self::config::{OscillatorConfig, OscillatorRule};
use self::statistics::{Drift, Pace, PeriodMeans};

/// Estimates and tracks phase, frequency and wave form of a periodic signal.
#[derive(Debug, Clone)]
pub struct AdaptiveOscillator {
    config: OscillatorConfig,
    estimator: PeriodEstimator,
    series: FourierSeries,
    pace: Pace,
    anchor: usize,
    running: bool,
    phase: f64,
    /// The frequency of the loop, rad/s.
    loop_omega: f64,
    /// Rate of the phase, rad/s: the loop's frequency plus the lasting part of its phase corrections.
    omega: f64,
    /// Phase passed since the oscillator started, rad.
    passed: f64,
    elapsed: f64,
    drift: Drift,
    /// Time until the past is evaluated again, s.
    until_look: f64,
    disagreements: u32,
    just_started: bool,
    starts: u32,
    periods: PeriodMeans,
    /// Phase passed and time at which the mean frequency starts to count.
    counted_from: Option<(f64, f64)>,
    value: Vec<f64>,
    slope: Vec<f64>,
    error: Vec<f64>,
}

impl AdaptiveOscillator {
    /// An oscillator before its first sample.
    ///
    /// # Errors
    /// When a constant is invalid.
    pub fn new(config: OscillatorConfig) -> Result<Self, MotionError> {
        config.validate()?;
        let estimator = PeriodEstimator::new(config.dims, 1.0 / config.highest_hz, 1.0 / config.lowest_hz)?;
        let zeros = vec![0.0; config.dims];
        Ok(Self {
            series: FourierSeries::new(config.dims, config.harmonics),
            pace: Pace { hz: config.initial_hz, peak: 0.0 },
            estimator,
            anchor: 0,
            running: !config.estimate,
            phase: 0.0,
            loop_omega: TAU * config.initial_hz,
            omega: TAU * config.initial_hz,
            passed: 0.0,
            elapsed: 0.0,
            drift: Drift::default(),
            until_look: 0.0,
            disagreements: 0,
            just_started: false,
            starts: 0,
            periods: PeriodMeans::default(),
            counted_from: None,
            value: zeros.clone(),
            slope: zeros.clone(),
            error: zeros,
            config,
        })
    }

    /// The constants.
    pub fn config(&self) -> &OscillatorConfig {
        &self.config
    }

    /// Processes the sample `v` (one value per coordinate), `dt` s after the previous one. Between samples the
    /// phase advances by itself, so that the sampling may be slow and irregular.
    ///
    /// # Errors
    /// When `dt` is not positive or the sample does not fit; nothing is changed.
    ///
    /// # Source
    /// Eqs. (1)-(3); the module's documentation lists the differences.
    pub fn update(&mut self, dt: f64, v: &[f64]) -> Result<(), MotionError> {
        sample_time(dt)?;
        vector("signal", self.config.dims, v)?;
        self.estimator.push(dt, v)?;
        if self.config.estimate {
            self.look_back(dt);
        }
        if self.running {
            match self.config.rule {
                OscillatorRule::Scaled => self.follow(dt, v),
                OscillatorRule::Paper { coupling, learning } => self.follow_paper(dt, v, coupling, learning),
                OscillatorRule::Bare { coupling, learning } => {
                    self.pace.add(dt, self.loop_omega, v[self.anchor]);
                    let gain = coupling * self.pace.hz / self.pace.peak.max(1e-12);
                    self.follow_paper(dt, v, gain, learning * self.pace.hz);
                }
            }
            self.note(dt);
        }
        Ok(())
    }

    /// The present phase, rad, in `0..2 pi`; 0 is where the fundamental of the leading coordinate was largest at
    /// the start.
    pub fn phase(&self) -> f64 {
        self.phase
    }

    /// The running frequency Omega, rad/s. With [`OscillatorRule::Scaled`] it is the actual rate of the phase,
    /// which the loop's own frequency follows with a delay while the signal's frequency changes.
    pub fn omega(&self) -> f64 {
        self.omega
    }

    /// The running frequency, Hz: the repeat frequency of the whole signal.
    pub fn frequency_hz(&self) -> f64 {
        self.omega / TAU
    }

    /// The mean frequency, Hz, without the first one and a half periods after the oscillator locked, in which the
    /// phase may still adjust to the wave form. It is steadier than the running frequency, because noise and a
    /// coach's uneven pace average out. `None` before four periods.
    pub fn mean_frequency_hz(&self) -> Option<f64> {
        let (phase, time) = self.counted_from?;
        (self.passed > 4.0 * TAU).then(|| (self.passed - phase) / (self.elapsed - time) / TAU)
    }

    /// Whether the oscillator follows the signal; with `estimate`, only after the signal has repeated once.
    pub fn running(&self) -> bool {
        self.running
    }

    /// Whether the frequency is steady: the means of the last two periods agree within 2 %, and the series explains
    /// most of the signal.
    pub fn settled(&self) -> bool {
        self.running && self.periods.steady(0.02) && self.periods.unexplained < 0.5
    }

    /// Periods passed since the oscillator locked.
    pub fn periods(&self) -> f64 {
        self.passed / TAU
    }

    /// How often the oscillator has (re)started; each start defines phase 0 anew.
    pub fn starts(&self) -> u32 {
        self.starts
    }

    /// The share of the signal's power that the series did not explain in the last whole period; 1 before the first
    /// one.
    pub fn unexplained(&self) -> f64 {
        self.periods.unexplained
    }

    /// Writes the estimated signal and its first and second derivative with respect to the phase (unit/rad,
    /// unit/rad^2) at `phase` rad. Does not allocate.
    ///
    /// # Errors
    /// When a slice does not have one value per coordinate or the phase is not finite.
    pub fn signal(
        &self,
        phase: f64,
        y: &mut [f64],
        dy: &mut [f64],
        ddy: &mut [f64],
    ) -> Result<(), MotionError> {
        crate::error::finite("phase", &[phase])?;
        for slice in [&*y, &*dy, &*ddy] {
            crate::error::size("signal", self.config.dims, slice.len())?;
        }
        self.series.triplet(phase, y, dy, ddy);
        Ok(())
    }

    /// The mean of coordinate `d` over the period, or `None` if there is no such coordinate.
    pub fn mean(&self, d: usize) -> Option<f64> {
        (d < self.config.dims).then(|| self.series.weight(d, 0).0)
    }

    /// Estimates the frequency from the recent past. Starts with the first estimate, and restarts after three in a row that
    /// differ from the running one.
    fn look_back(&mut self, dt: f64) {
        self.until_look -= dt;
        if self.until_look > 0.0 {
            return;
        }
        let period = TAU / self.loop_omega;
        let estimate = if self.running {
            self.until_look = 0.25 * period;
            let young = self.passed < 4.0 * TAU;
            self.estimator
                .estimate_recent(3.5 * period)
                .filter(|_| !young)
                .or_else(|| self.estimator.estimate())
        } else {
            self.until_look = 0.2;
            self.estimator.estimate()
        };
        let Some(found) = estimate else { return };
        if !self.running {
            self.start(found);
            return;
        }
        let ratio = found.period * self.loop_omega / TAU;
        self.disagreements = if (ratio - 1.0).abs() > 0.07 { self.disagreements + 1 } else { 0 };
        if self.disagreements >= 3 {
            self.start(found);
        }
    }

    /// Fits the series to the last periods at the estimated frequency, so that the loop starts locked.
    fn start(&mut self, found: PeriodEstimate) {
        self.running = true;
        self.loop_omega = TAU / found.period;
        // The minimum of the difference is flat; the residual of the fit locates the period more precisely.
        for reach in [0.03, 0.01] {
            let omega = self.loop_omega;
            let [slower, same, faster] = [1.0 - reach, 1.0, 1.0 + reach].map(|r| self.fit_past(omega * r));
            let curvature = slower - 2.0 * same + faster;
            let shift = if curvature > 0.0 { 0.5 * (slower - faster) / curvature } else { 0.0 };
            self.loop_omega = omega * (1.0 + reach * shift.clamp(-1.0, 1.0));
        }
        self.fit_past(self.loop_omega);
        self.omega = self.loop_omega;
        self.anchor = self.series.strongest();
        self.phase = (-self.series.anchor(self.anchor)).rem_euclid(TAU);
        self.just_started = true;
        self.starts = self.starts.saturating_add(1);
        self.passed = 0.0;
        self.elapsed = 0.0;
        self.drift = Drift::default();
        self.disagreements = 0;
        self.periods = PeriodMeans::default();
        self.counted_from = None;
        self.until_look = found.period;
    }

    /// Fits the series to the last two periods at `omega` rad/s, with phase 0 now; returns the residual.
    fn fit_past(&mut self, omega: f64) -> f64 {
        let history = self.estimator.history();
        let (grid, overhang) = (history.grid, history.overhang);
        let count = history.len.min((2.0 * TAU / self.loop_omega / grid) as usize);
        let highest = self.config.harmonics.min((count / 6).max(1));
        let past = (0..count).map(|age| (-omega * (age as f64 * grid + overhang), history.at(age)));
        self.series.fit(highest, past)
    }

    fn advance(&mut self, dt: f64) {
        self.phase = (self.phase + self.loop_omega * dt).rem_euclid(TAU);
        self.passed += self.loop_omega * dt;
    }

    fn follow(&mut self, dt: f64, v: &[f64]) {
        // A start has already set the phase for this sample.
        if !std::mem::take(&mut self.just_started) {
            self.advance(dt);
        }
        self.series.evaluate(self.phase, &mut self.value, &mut self.slope);
        let (mut along, mut missed) = (0.0, 0.0);
        for (d, v) in v.iter().enumerate() {
            self.error[d] = v - self.value[d];
            along += self.error[d] * self.slope[d];
            missed += self.error[d] * self.error[d];
        }
        let power = self.series.slope_power();
        let ahead = if power > 1e-300 { (along / power).clamp(-1.0, 1.0) } else { 0.0 };
        // A critically damped loop: its bandwidth is wide in the first periods, then narrow, and wide again for
        // changes.
        let age = (self.passed / TAU).max(0.0);
        let turned = self.loop_omega * dt;
        let drifting = self.drift.add(ahead, turned);
        let width = self.config.bandwidth * (1.0 + 0.5 * libm::exp(-age / 2.0) + 3.0 * drifting);
        let share = 1.0 - libm::exp(-2.0 * width * turned);
        self.phase = (self.phase + share * ahead).rem_euclid(TAU);
        self.passed += share * ahead;
        let faster = (width * width * turned * ahead).clamp(-0.2, 0.2);
        let (low, high) = (0.7 * TAU * self.config.lowest_hz, 1.4 * TAU * self.config.highest_hz);
        self.loop_omega = (self.loop_omega * (1.0 + faster)).clamp(low, high);
        self.omega = (self.loop_omega * (1.0 + 2.0 * width * self.drift.lasting())).clamp(low, high);
        let highest = (0.8 * std::f64::consts::PI / turned.max(1e-9)).floor().max(1.0);
        let highest =
            if highest < self.config.harmonics as f64 { highest as usize } else { self.config.harmonics };
        let memory = (2.0 + 0.7 * age).min(self.config.memory);
        let rate = (1.0 - libm::exp(-turned / (TAU * memory))).min(1.0 / (2 * highest + 1) as f64);
        self.series.learn(rate, &self.error, highest);
        self.periods.residual(turned, missed, self.series.power());
    }

    fn follow_paper(&mut self, dt: f64, v: &[f64], coupling: f64, learning: f64) {
        self.series.evaluate(self.phase, &mut self.value, &mut self.slope);
        let mut missed = 0.0;
        for (d, v) in v.iter().enumerate() {
            self.error[d] = v - self.value[d];
            missed += self.error[d] * self.error[d];
        }
        let drive = -coupling * self.error[self.anchor] * libm::sin(self.phase) * dt;
        self.advance(dt);
        self.phase = (self.phase + drive).rem_euclid(TAU);
        self.loop_omega = (self.loop_omega + drive).clamp(1e-3, 1e3);
        self.omega = self.loop_omega;
        // A higher rate would make the weights overshoot the error.
        let rate = (learning * dt).min(1.0 / (2 * self.series.harmonics() + 1) as f64);
        self.series.learn_pinned(rate, &self.error, self.series.harmonics(), self.anchor);
        self.periods.residual(self.loop_omega * dt, missed, self.series.power());
    }

    /// Updates the statistics of the signal.
    fn note(&mut self, dt: f64) {
        self.elapsed += dt;
        if self.counted_from.is_none() && self.passed > 1.5 * TAU {
            self.counted_from = Some((self.passed, self.elapsed));
        }
        self.periods.add(self.loop_omega, self.loop_omega * dt);
    }
}

#[cfg(test)]
mod tests;
