//! The two-layered imitation system: an adaptive oscillator finds phase and frequency of the demonstration, and a
//! periodic primitive on the oscillator's phase learns the motion online.

use std::f64::consts::TAU;

use crate::error::MotionError;
use crate::oscillator::{AdaptiveOscillator, OscillatorConfig};
use crate::periodic::{PeriodicDmp, PeriodicDmpConfig};

/// Longest time that is learned as one sample, s.
const MAX_SAMPLE_TIME: f64 = 0.01;

/// Learns a periodic motion from samples of its position, at any sample rate.
///
/// The primitive learns from the oscillator's Fourier series and not from the samples. The series gives position,
/// velocity and acceleration as smooth functions of the phase, even if a camera sees only a few noisy positions per
/// period.
#[derive(Debug, Clone)]
pub struct Imitation {
    oscillator: AdaptiveOscillator,
    primitive: PeriodicDmp,
    learning: bool,
    starts: u32,
    learned: f64,
    best_unexplained: f64,
    /// The result at the end of the last period, kept back until the next period confirms it.
    pending: PeriodResult,
    kept: PeriodResult,
    next_keep: f64,
    scratch: [Vec<f64>; 3],
}

impl Imitation {
    /// For a signal of `oscillator.dims` coordinates.
    ///
    /// # Errors
    /// When a constant is invalid, or the two have different numbers of coordinates.
    pub fn new(oscillator: OscillatorConfig, primitive: PeriodicDmpConfig) -> Result<Self, MotionError> {
        crate::error::size("dofs", oscillator.dims, primitive.dofs)?;
        let zeros = vec![0.0; primitive.dofs];
        let dmp = PeriodicDmp::new(primitive)?;
        Ok(Self {
            oscillator: AdaptiveOscillator::new(oscillator)?,
            learning: false,
            starts: 0,
            learned: 0.0,
            best_unexplained: f64::INFINITY,
            pending: PeriodResult { primitive: dmp.clone(), hz: None },
            kept: PeriodResult { primitive: dmp.clone(), hz: None },
            next_keep: 1.0,
            scratch: [zeros.clone(), zeros.clone(), zeros],
            primitive: dmp,
        })
    }

    /// An imitation of `dofs` coordinates with all defaults.
    ///
    /// # Errors
    /// When `dofs` is 0.
    pub fn with_dofs(dofs: usize) -> Result<Self, MotionError> {
        Self::new(OscillatorConfig::with_dims(dofs), PeriodicDmpConfig::with_dofs(dofs))
    }

    /// Processes the position `point`, `dt` s after the previous one. Missing samples are simply left out.
    ///
    /// # Errors
    /// As [`AdaptiveOscillator::update`].
    pub fn observe(&mut self, dt: f64, point: &[f64]) -> Result<(), MotionError> {
        self.oscillator.update(dt, point)?;
        if self.oscillator.starts() != self.starts {
            self.forget();
        }
        self.learning = self.learning || self.oscillator.settled();
        if self.learning {
            self.learn_back(dt)?;
            self.keep();
        }
        Ok(())
    }

    /// A restart defines the phase anew, which invalidates what was learned before.
    fn forget(&mut self) {
        self.starts = self.oscillator.starts();
        self.learning = false;
        self.learned = 0.0;
        self.best_unexplained = f64::INFINITY;
        self.next_keep = 1.0;
        self.primitive.forget();
    }

    /// Learns the part of the phase that has passed in the last `dt`.
    fn learn_back(&mut self, dt: f64) -> Result<(), MotionError> {
        let (phase, omega) = (self.oscillator.phase(), self.oscillator.omega());
        if self.learned == 0.0 {
            for (d, g) in self.primitive.centre_mut().iter_mut().enumerate() {
                *g = self.oscillator.mean(d).unwrap_or(*g);
            }
        }
        // A gap longer than a period gives no more information than a period.
        let dt = dt.min(TAU / omega);
        let pieces = (dt / MAX_SAMPLE_TIME).ceil().max(1.0);
        let step = dt / pieces;
        let [y, dy, ddy] = &mut self.scratch;
        for k in (0..pieces as usize).rev() {
            let at = phase - omega * step * k as f64;
            self.oscillator.signal(at, y, dy, ddy)?;
            dy.iter_mut().for_each(|v| *v *= omega);
            ddy.iter_mut().for_each(|a| *a *= omega * omega);
            self.primitive.learn(at, omega, step, y, dy, ddy)?;
        }
        self.learned += omega * dt;
        Ok(())
    }

    /// Accepts the result of a period once the next one was similar too, so that a demonstration may end at any
    /// time.
    fn keep(&mut self) {
        if self.periods() < self.next_keep {
            return;
        }
        self.next_keep += 1.0;
        let unexplained = self.oscillator.unexplained();
        if unexplained > 2.0 * self.best_unexplained + 0.03 {
            self.pending.hz = None;
            return;
        }
        self.best_unexplained = self.best_unexplained.min(unexplained);
        if self.pending.hz.is_some() {
            std::mem::swap(&mut self.kept, &mut self.pending);
        }
        let hz = self.oscillator.mean_frequency_hz().unwrap_or_else(|| self.oscillator.frequency_hz());
        self.pending.take_over(&self.primitive, hz);
    }

    /// The oscillator.
    pub fn oscillator(&self) -> &AdaptiveOscillator {
        &self.oscillator
    }

    /// The primitive as learned so far; empty while [`learning`](Self::learning) is false. Clone it to run it: its
    /// phase is the oscillator's.
    pub fn primitive(&self) -> &PeriodicDmp {
        &self.primitive
    }

    /// Whether the frequency has settled, so that the motion is being learned.
    pub fn learning(&self) -> bool {
        self.learning
    }

    /// Periods learned so far.
    pub fn periods(&self) -> f64 {
        self.learned / TAU
    }

    /// The result: the primitive and its frequency, Hz, from the last period that was followed by a similar one.
    /// `None` before two periods were learned.
    pub fn result(&self) -> Option<(&PeriodicDmp, f64)> {
        self.kept.hz.map(|hz| (&self.kept.primitive, hz))
    }
}

/// A copy of the learned primitive with its frequency; invalid without a frequency.
#[derive(Debug, Clone)]
struct PeriodResult {
    primitive: PeriodicDmp,
    hz: Option<f64>,
}

impl PeriodResult {
    fn take_over(&mut self, primitive: &PeriodicDmp, hz: f64) {
        self.hz = Some(hz);
        self.primitive.take_over(primitive);
        self.primitive.sharpen();
    }
}
