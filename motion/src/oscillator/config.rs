//! The constants of the adaptive oscillator, and its rules.

use serde::{Deserialize, Serialize};

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

/// The constants of an [`AdaptiveOscillator`](crate::AdaptiveOscillator).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OscillatorConfig {
    /// Coordinates of the signal.
    pub dims: usize,
    /// Harmonics m of (3); those that the sample rate cannot resolve are not learned.
    pub harmonics: usize,
    /// How phase and frequency follow the error.
    pub rule: OscillatorRule,
    /// Whether the initial phase and frequency are estimated from the signal so far.
    pub estimate: bool,
    /// Initial frequency without an estimate, Hz.
    pub initial_hz: f64,
    /// Lower bound of the frequency search, Hz.
    pub lowest_hz: f64,
    /// Upper bound of the frequency search, Hz.
    pub highest_hz: f64,
    /// Natural frequency of the loop that corrects phase and frequency, as a share of the running frequency.
    pub bandwidth: f64,
    /// Number of periods over which the weights average, once settled.
    pub memory: f64,
}

impl Default for OscillatorConfig {
    fn default() -> Self {
        Self {
            dims: 1,
            harmonics: 10,
            rule: OscillatorRule::Scaled,
            estimate: true,
            initial_hz: 1.0,
            lowest_hz: 0.22,
            highest_hz: 4.0,
            bandwidth: 0.08,
            memory: 5.0,
        }
    }
}

impl OscillatorConfig {
    /// The defaults for a signal of `dims` coordinates.
    #[must_use]
    pub fn with_dims(dims: usize) -> Self {
        Self { dims, ..Self::default() }
    }

    pub(super) fn validate(&self) -> Result<(), MotionError> {
        within("harmonics", self.harmonics as f64, 1.0, 64.0)?;
        constant("initial_hz", self.initial_hz)?;
        constant("lowest_hz", self.lowest_hz)?;
        within("highest_hz", self.highest_hz, self.lowest_hz, 1000.0 * self.lowest_hz)?;
        within("bandwidth", self.bandwidth, 1e-4, 0.5)?;
        within("memory", self.memory, 0.5, 1000.0)?;
        if let OscillatorRule::Paper { coupling, learning } | OscillatorRule::Bare { coupling, learning } =
            self.rule
        {
            constant("coupling", coupling)?;
            constant("learning", learning)?;
        }
        Ok(())
    }
}
