//! The file format of a periodic primitive, and the checks when it is read.

use serde::{Deserialize, Serialize};

use super::{PeriodicDmp, PeriodicDmpConfig};
use crate::error::MotionError;

/// The saved form: everything that defines the motion, without its present state.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SavedPeriodic {
    config: PeriodicDmpConfig,
    centre: Vec<f64>,
    amplitude: f64,
    weights: Vec<f64>,
    gain: Vec<f64>,
}

impl From<PeriodicDmp> for SavedPeriodic {
    fn from(dmp: PeriodicDmp) -> Self {
        Self {
            centre: dmp.centre().to_vec(),
            amplitude: dmp.amplitude(),
            weights: dmp.weights().to_vec(),
            gain: dmp.learner.gain,
            config: dmp.config,
        }
    }
}

impl TryFrom<SavedPeriodic> for PeriodicDmp {
    type Error = MotionError;

    fn try_from(saved: SavedPeriodic) -> Result<Self, MotionError> {
        let mut dmp = Self::new(saved.config)?;
        dmp.set_centre(&saved.centre)?;
        dmp.set_amplitude(saved.amplitude)?;
        dmp.set_weights(&saved.weights)?;
        dmp.learner.set_gain(saved.gain)?;
        dmp.start_on_path(0.0, 1.0)?;
        Ok(dmp)
    }
}
