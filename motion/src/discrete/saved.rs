//! How a discrete primitive is kept in a file.

use serde::{Deserialize, Serialize};

use super::{DiscreteDmp, DiscreteDmpConfig};
use crate::error::{MotionError, vector, within};

/// The saved form: everything that makes the movement, not the instant that it was saved in.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Saved {
    config: DiscreteDmpConfig,
    start: Vec<f64>,
    goal: Vec<f64>,
    amplitude: f64,
    weights: Vec<f64>,
    gain: Vec<f64>,
}

impl From<DiscreteDmp> for Saved {
    fn from(dmp: DiscreteDmp) -> Self {
        Self {
            config: dmp.config,
            start: dmp.start,
            goal: dmp.goal,
            amplitude: dmp.amplitude,
            weights: dmp.weights,
            gain: dmp.gain,
        }
    }
}

impl TryFrom<Saved> for DiscreteDmp {
    type Error = MotionError;

    fn try_from(saved: Saved) -> Result<Self, MotionError> {
        let mut dmp = Self::new(saved.config)?;
        vector("start", dmp.start.len(), &saved.start)?;
        vector("gain", dmp.gain.len(), &saved.gain)?;
        saved.gain.iter().try_for_each(|p| within("gain", *p, 0.0, f64::MAX))?;
        dmp.set_goal(&saved.goal)?;
        dmp.set_amplitude(saved.amplitude)?;
        dmp.set_weights(&saved.weights)?;
        dmp.gain = saved.gain;
        let rest = vec![0.0; saved.start.len()];
        dmp.begin(&saved.start, &rest, 1.0)?;
        dmp.start = saved.start;
        Ok(dmp)
    }
}
