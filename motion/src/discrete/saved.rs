//! The file format of a discrete primitive.

use serde::{Deserialize, Serialize};

use super::{DiscreteDmp, DiscreteDmpConfig};
use crate::error::{MotionError, vector};

/// The saved form: everything that defines the movement, without its present state.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SavedDiscrete {
    config: DiscreteDmpConfig,
    start: Vec<f64>,
    goal: Vec<f64>,
    amplitude: f64,
    weights: Vec<f64>,
    gain: Vec<f64>,
}

impl From<DiscreteDmp> for SavedDiscrete {
    fn from(dmp: DiscreteDmp) -> Self {
        Self {
            goal: dmp.goal().to_vec(),
            amplitude: dmp.amplitude(),
            weights: dmp.weights().to_vec(),
            gain: dmp.learner.gain,
            start: dmp.start,
            config: dmp.config,
        }
    }
}

impl TryFrom<SavedDiscrete> for DiscreteDmp {
    type Error = MotionError;

    fn try_from(saved: SavedDiscrete) -> Result<Self, MotionError> {
        let mut dmp = Self::new(saved.config)?;
        vector("start", dmp.start.len(), &saved.start)?;
        dmp.set_goal(&saved.goal)?;
        dmp.set_amplitude(saved.amplitude)?;
        dmp.set_weights(&saved.weights)?;
        dmp.learner.set_gain(saved.gain)?;
        let rest = vec![0.0; saved.start.len()];
        dmp.begin(&saved.start, &rest, 1.0)?;
        dmp.start = saved.start;
        Ok(dmp)
    }
}
