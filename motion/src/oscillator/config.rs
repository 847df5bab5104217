//! The constants of the adaptive oscillator, and its rules.

use serde::{Deserialize, Serialize};

use crate::constants::GAIN;
use crate::error::{MotionError, constant, within};

/// How phase and frequency follow the error.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OscillatorRule {
    /// By the derivative of the estimated signal, with all gains scaled.
    #[default]
    Scaled,
    /// (1), (2) as printed, on the coordinate with the strongest fundamental: `-K e sin(phase)`.
    Paper {
        /// Coupling constant K, in 1 / (unit s) for the phase.
        coupling: f64,
        /// Learning rate of the weights in (3), 1/s.
        learning: f64,
    },
    /// (1)-(3) with gains proportional to the running frequency and to the inverse of the signal's amplitude.
    Bare {
        /// Coupling constant K at 1 Hz, for a signal between -1 and 1.
        coupling: f64,
        /// Learning rate of the weights in (3) at 1 Hz, 1/s.
        learning: f64,
    },
}

constants! {
    /// The constants of an [`AdaptiveOscillator`](crate::AdaptiveOscillator).
    pub struct OscillatorConfig {
        /// Coordinates of the signal.
        dims: usize = 1;
        /// Harmonics m of (3); those that the sample rate cannot resolve are not learned.
        harmonics: usize = 10, 1.0..=64.0;
        /// How phase and frequency follow the error.
        rule: OscillatorRule = OscillatorRule::Scaled;
        /// Whether the initial phase and frequency are estimated from the signal so far.
        estimate: bool = true;
        /// Initial frequency without an estimate, Hz.
        initial_hz: f64 = 1.0, GAIN;
        /// Lower bound of the frequency search, Hz.
        lowest_hz: f64 = 0.22, GAIN;
        /// Upper bound of the frequency search, Hz.
        highest_hz: f64 = 4.0;
        /// Natural frequency of the loop that corrects phase and frequency, as a share of the running frequency.
        bandwidth: f64 = 0.08, 1e-4..=0.5;
        /// Number of periods over which the weights average, once settled.
        memory: f64 = 5.0, 0.5..=1000.0;
    }
}

impl OscillatorConfig {
    /// The defaults for a signal of `dims` coordinates.
    pub fn with_dims(dims: usize) -> Self {
        Self { dims, ..Self::default() }
    }

    pub(super) fn validate(&self) -> Result<(), MotionError> {
        self.check_ranges()?;
        within("highest_hz", self.highest_hz, self.lowest_hz, 1000.0 * self.lowest_hz)?;
        if let OscillatorRule::Paper { coupling, learning } | OscillatorRule::Bare { coupling, learning } =
            self.rule
        {
            constant("coupling", coupling)?;
            constant("learning", learning)?;
        }
        Ok(())
    }
}
