//! The adaptive frequency oscillator with its adaptive Fourier series on several kinds of signals: settling time,
//! accuracy and ripple; with `basin` over all start frequencies, with and without an estimated start.

use std::f64::consts::TAU;

use armarium_motion::{AdaptiveOscillator, OscillatorConfig, OscillatorRule};
use armarium_values::random::StandardNormal;
use armarium_viewer::report::{Curve, Look, Panel, PanelRow, picture};
use rand::SeedableRng as _;
use rand::distr::Distribution as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::error::{ExperimentError, within};
use super::experiment::{Experiment, ExperimentResult, panel};
use super::settings::{ExperimentSettings as _, Setting, settings};

/// The waveform.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Signal {
    /// A sine.
    Sine,
    /// Three harmonics.
    Harmonics3,
    /// A square wave.
    Square,
    /// A sine with offset 0.5.
    Offset,
    /// A sine with noise.
    Noise,
    /// Two harmonics with a frequency step.
    Step,
    /// A sine whose frequency rises slowly.
    Chirp,
    /// One coordinate of a figure of eight that repeats twice per round, mixed with the other coordinate.
    Eight,
    /// A figure of eight in the plane, rotated by 30 degrees: two coordinates.
    Plane,
}

impl Setting for Signal {}

/// The update rule of phase and frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum UpdateRule {
    /// `scaled` with an estimated start, `bare` without.
    Auto,
    /// The phase error of the whole signal, in a loop with scaled gains.
    Scaled,
    /// The papers' equations with scaled gains.
    Bare,
    /// The papers' equations with fixed gains.
    Paper,
}

impl Setting for UpdateRule {}

settings! {
    /// Settings of the oscillator.
    Oscillator {
        /// sine, harmonics3, square, offset, noise, step, chirp, eight or plane.
        signal: Signal = Signal::Sine;
        /// Fundamental frequency, Hz; step and chirp have their own.
        frequency: f64 = 1.3;
        /// Scale factor of the whole signal.
        amplitude: f64 = 1.0, 1e-6..=1e6;
        /// Harmonics of the Fourier series.
        harmonics: usize = 10;
        /// Start frequency of the oscillator, Hz.
        initial: f64 = 1.0;
        /// Whether the start frequency is estimated from the signal so far.
        estimate: bool = true;
        /// auto (scaled with estimate, bare without), scaled, bare or paper.
        rule: UpdateRule = UpdateRule::Auto;
        /// K of (1), (2): unscaled for the paper's rule; for the bare rule the value at 1.3 Hz for a signal
        /// between -1 and 1.
        coupling: f64 = 15.0;
        /// Learning gain of (3), 1/s: unscaled for the paper's rule; for the bare rule the value at 1.3 Hz.
        learning: f64 = 2.0;
        /// Step, s.
        dt: f64 = 0.001, 1e-4..=0.1;
        /// Length of the run, s.
        seconds: f64 = 60.0, 1.0..=1800.0;
        /// Standard deviation of the noise in the signal `noise`.
        noise: f64 = 0.2, 0.0..=10.0;
        /// Seed of the noise.
        seed: u64 = 1;
        /// Frequency before the step, Hz.
        step_from: f64 = 1.0;
        /// Frequency after the step, Hz.
        step_to: f64 = 1.6;
        /// Time of the step, s.
        step_at: f64 = 30.0;
        /// Frequency before the chirp, Hz.
        chirp_from: f64 = 0.8;
        /// Frequency after the chirp, Hz.
        chirp_to: f64 = 1.6;
        /// Start of the chirp, s.
        chirp_begin: f64 = 10.0, 0.0..=1e5;
        /// End of the chirp, s.
        chirp_end: f64 = 50.0;
        /// Also measures settling at 16 frequencies from 0.25 to 4 Hz, with and without an estimated start.
        basin: bool = false;
    }
}

/// The log of a run, one entry per step.
#[derive(Default)]
struct OscillatorLog {
    /// True phase, rad, not wrapped.
    phase: Vec<f64>,
    /// First coordinate, and the series' approximation of it.
    value: Vec<f64>,
    series: Vec<f64>,
    /// Frequency of the signal, and its running estimate, Hz.
    truth: Vec<f64>,
    hz: Vec<f64>,
}

impl Experiment for Oscillator {
    const NAME: &'static str = "oscillator";
    const ABOUT: &'static str = "adaptive frequency oscillator: when it settles on which signal";

    fn run(&self) -> Result<ExperimentResult, ExperimentError> {
        self.check()?;
        let log = self.listen()?;
        let mut outcome = self.figures(&log);
        outcome.plot("oscillator", self.plot(&log));
        if self.basin {
            self.sweep(&mut outcome)?;
        }
        Ok(outcome)
    }
}

impl Oscillator {
    fn check(&self) -> Result<(), ExperimentError> {
        self.check_ranges()?;
        within("initial", self.initial, 0.05, 0.2 / self.dt)?;
        within("chirp_end", self.chirp_end, self.chirp_begin + self.dt, 1e6)?;
        if self.signal == Signal::Step {
            within("step_at", self.step_at, 0.0, self.seconds)?;
        }
        for (key, hz) in [
            ("frequency", self.frequency),
            ("step_from", self.step_from),
            ("step_to", self.step_to),
            ("chirp_from", self.chirp_from),
            ("chirp_to", self.chirp_to),
        ] {
            within(key, hz, 0.05, 0.2 / self.dt)?;
        }
        Ok(())
    }

    fn config(&self) -> OscillatorConfig {
        let (coupling, learning) = (self.coupling, self.learning);
        let rule = match (self.rule, self.estimate) {
            (UpdateRule::Paper, _) => OscillatorRule::Paper { coupling, learning },
            (UpdateRule::Bare, _) | (UpdateRule::Auto, false) => {
                OscillatorRule::Bare { coupling: coupling / 1.3, learning: learning / 1.3 }
            }
            _ => OscillatorRule::Scaled,
        };
        OscillatorConfig {
            dims: if self.signal == Signal::Plane { 2 } else { 1 },
            harmonics: self.harmonics,
            rule,
            estimate: self.estimate,
            initial_hz: self.initial,
            ..OscillatorConfig::default()
        }
    }

    /// True frequency at a time, Hz.
    fn truth(&self, t: f64) -> f64 {
        match self.signal {
            Signal::Step if t < self.step_at => self.step_from,
            Signal::Step => self.step_to,
            Signal::Chirp => {
                let share = ((t - self.chirp_begin) / (self.chirp_end - self.chirp_begin)).clamp(0.0, 1.0);
                self.chirp_from + share * (self.chirp_to - self.chirp_from)
            }
            _ => self.frequency,
        }
    }

    /// The coordinates at a phase, rad.
    fn value(&self, p: f64, rng: &mut ChaCha8Rng) -> [f64; 2] {
        let eight = |p: f64| [libm::sin(p), libm::sin(2.0 * p)];
        let one = match self.signal {
            Signal::Sine | Signal::Chirp => libm::sin(p),
            Signal::Harmonics3 => {
                0.6 * libm::sin(p) + 0.3 * libm::cos(2.0 * p + 0.4) + 0.2 * libm::sin(3.0 * p + 1.1)
            }
            Signal::Square => libm::sin(p).signum(),
            Signal::Offset => 0.5 + 0.5 * libm::sin(p),
            Signal::Noise => {
                let normal: f64 = StandardNormal.sample(rng);
                libm::sin(p) + self.noise * normal
            }
            Signal::Step => 0.7 * libm::sin(p) + 0.3 * libm::sin(2.0 * p + 0.5),
            Signal::Eight => 0.5 * libm::sin(p) + 0.87 * libm::sin(2.0 * p),
            Signal::Plane => {
                let ([x, y], (sin, cos)) = (eight(p), libm::sincos(30.0_f64.to_radians()));
                return [self.amplitude * (cos * x - sin * y), self.amplitude * (sin * x + cos * y)];
            }
        };
        [self.amplitude * one, 0.0]
    }

    fn listen(&self) -> Result<OscillatorLog, ExperimentError> {
        let mut oscillator = AdaptiveOscillator::new(self.config())?;
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let dims = self.config().dims;
        let [mut y, mut dy, mut ddy] = [[0.0; 2]; 3];
        let mut log = OscillatorLog::default();
        let mut phase = 0.0;
        for k in 0..(self.seconds / self.dt).round() as usize {
            let value = self.value(phase, &mut rng);
            oscillator.update(self.dt, &value[..dims])?;
            oscillator.signal(oscillator.phase(), &mut y[..dims], &mut dy[..dims], &mut ddy[..dims])?;
            log.phase.push(phase);
            log.value.push(value[0]);
            log.series.push(if oscillator.running() { y[0] } else { f64::NAN });
            log.hz.push(oscillator.frequency_hz());
            let truth = self.truth(self.dt * k as f64);
            log.truth.push(truth);
            phase += TAU * truth * self.dt;
        }
        Ok(log)
    }

    fn figures(&self, log: &OscillatorLog) -> ExperimentResult {
        let mut outcome = ExperimentResult::default();
        let step = (self.step_at / self.dt).round() as usize;
        let steps = self.signal == Signal::Step;
        let first = settle(log, 0, if steps { step } else { log.hz.len() });
        outcome.figure("settle_s", first.map_or(f64::NAN, |k| self.dt * k as f64));
        let (error, ripple) = self.at_the_end(log);
        outcome.figure("error", error);
        outcome.figure("ripple", ripple);
        let second = if steps { settle(log, step, log.hz.len()) } else { None };
        outcome.figure("settle_after_step_s", second.map_or(f64::NAN, |k| self.dt * (k - step) as f64));
        outcome.figure("settle_periods", first.map_or(f64::NAN, |k| log.phase[k] / TAU));
        outcome.figure("final_hz", log.hz.last().copied().unwrap_or(f64::NAN));
        outcome
    }

    /// Error of the mean estimated frequency, and half its peak-to-peak variation, over the last 10 s (or half the
    /// run), relative to the true frequency.
    fn at_the_end(&self, log: &OscillatorLog) -> (f64, f64) {
        let n = log.hz.len();
        let count = ((10.0 / self.dt) as usize).clamp(1, n.div_ceil(2));
        let ratios = || (n - count..n).map(|k| log.hz[k] / log.truth[k]);
        let error = (ratios().sum::<f64>() / count as f64 - 1.0).abs();
        let (low, high) =
            ratios().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), r| (r.min(low), r.max(high)));
        (error, 0.5 * (high - low))
    }

    /// Settling times in periods over the frequency, with and without an estimated start.
    fn sweep(&self, outcome: &mut ExperimentResult) -> Result<(), ExperimentError> {
        let hz: Vec<f64> = (0..16).map(|i| 0.25 * libm::pow(16.0_f64, f64::from(i) / 15.0)).collect();
        // These two signals define their own frequencies.
        let own = matches!(self.signal, Signal::Step | Signal::Chirp);
        let signal = if own { Signal::Sine } else { self.signal };
        let periods = |estimate: bool, f: f64| -> Result<f64, ExperimentError> {
            let one = Self {
                signal,
                estimate,
                frequency: f,
                seconds: (16.0 / f).max(20.0),
                basin: false,
                ..self.clone()
            };
            one.check()?;
            let log = one.listen()?;
            Ok(settle(&log, 0, log.hz.len()).map_or(f64::NAN, |k| log.phase[k] / TAU))
        };
        let row = |estimate: bool| hz.iter().map(|f| periods(estimate, *f)).collect::<Result<Vec<f64>, _>>();
        let (estimated, bare) = (row(true)?, row(false)?);
        let points =
            |values: &[f64]| hz.iter().zip(values).map(|(f, p)| [libm::log10(*f), *p]).collect::<Vec<_>>();
        let panel = Panel {
            marks: vec![(libm::log10(self.initial), "initial".into())],
            y_range: Some([0.0, 17.0]),
            ..panel(
                "log10 of the frequency, Hz",
                "periods until settled",
                vec![
                    Curve::new("start estimated", points(&estimated)).looking(Look::Colour(1)),
                    Curve::new("started at the initial frequency", points(&bare)).looking(Look::Dots(2)),
                ],
            )
        };
        outcome.plot(
            "oscillator_basin",
            picture("Where the oscillator settles", &[PanelRow { height: 320.0, panels: vec![panel] }]),
        );
        let list = |values: Vec<f64>| serde_json::Value::from(values);
        outcome.figure("basin_hz", list(hz));
        outcome.figure("basin_periods_estimated", list(estimated));
        outcome.figure("basin_periods_bare", list(bare));
        Ok(())
    }

    fn plot(&self, log: &OscillatorLog) -> String {
        let time = |k: usize| self.dt * k as f64;
        let n = log.hz.len();
        let stride = n.div_ceil(3000);
        let over = |from: usize, to: usize, stride: usize, of: &dyn Fn(usize) -> f64| {
            (from..to).step_by(stride).map(|k| [time(k), of(k)]).collect::<Vec<[f64; 2]>>()
        };
        let window = ((6.0 / self.truth(0.0) / self.dt) as usize).min(n);
        let marks = match self.signal {
            Signal::Step => vec![(self.step_at, "step".to_owned())],
            Signal::Chirp => vec![(self.chirp_begin, "chirp".to_owned()), (self.chirp_end, "end".to_owned())],
            _ => Vec::new(),
        };
        let frequency = Panel {
            marks,
            ..panel(
                "time, s",
                "frequency, Hz",
                vec![
                    Curve::new("signal", over(0, n, stride, &|k| log.truth[k])).looking(Look::Reference),
                    Curve::new("oscillator", over(0, n, stride, &|k| log.hz[k])).looking(Look::Colour(1)),
                ],
            )
        };
        let waves = |from: usize, to: usize| {
            panel(
                "time, s",
                "signal",
                vec![
                    Curve::new("signal", over(from, to, 1.max((to - from) / 1500), &|k| log.value[k]))
                        .looking(Look::Reference),
                    Curve::new(
                        "Fourier series",
                        over(from, to, 1.max((to - from) / 1500), &|k| log.series[k]),
                    )
                    .looking(Look::Colour(2)),
                ],
            )
        };
        picture(
            "Adaptive frequency oscillator",
            &[
                PanelRow { height: 280.0, panels: vec![frequency] },
                PanelRow { height: 260.0, panels: vec![waves(0, window), waves(n - window / 2, n)] },
            ],
        )
    }
}

/// The first step in `from..to` from which on, until `to`, the running frequency, averaged over the true period that
/// ends there, stays within 1 % of the true mean.
fn settle(log: &OscillatorLog, from: usize, to: usize) -> Option<usize> {
    let (mut begin, mut heard, mut true_sum) = (from, 0.0, 0.0);
    let mut since = None;
    for k in from..to {
        heard += log.hz[k];
        true_sum += log.truth[k];
        let whole = log.phase[k] - log.phase[from] >= TAU;
        while log.phase[k] - log.phase[begin] > TAU {
            heard -= log.hz[begin];
            true_sum -= log.truth[begin];
            begin += 1;
        }
        let good = whole && (heard / true_sum - 1.0).abs() <= 0.01;
        since = if good { since.or(Some(k)) } else { None };
    }
    since
}

#[cfg(test)]
mod tests;
