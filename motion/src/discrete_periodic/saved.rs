//! The file format of a discrete-periodic primitive.

use serde::{Deserialize, Serialize};

use super::{DiscretePeriodicConfig, DiscretePeriodicDmp};
use crate::error::{MotionError, vector};

/// The saved form: everything that defines the movement, without its present state.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SavedDiscretePeriodic {
    config: DiscretePeriodicConfig,
    omega: f64,
    duration: f64,
    centre: Vec<f64>,
    start: Vec<f64>,
    start_slope: Vec<f64>,
    weights: Vec<f64>,
    control_weights: Vec<f64>,
}

impl From<DiscretePeriodicDmp> for SavedDiscretePeriodic {
    fn from(dmp: DiscretePeriodicDmp) -> Self {
        Self {
            centre: dmp.centre().to_vec(),
            weights: dmp.weights().to_vec(),
            control_weights: dmp.control_weights().to_vec(),
            omega: dmp.omega,
            duration: dmp.duration,
            start: dmp.start,
            start_slope: dmp.start_slope,
            config: dmp.config,
        }
    }
}

impl TryFrom<SavedDiscretePeriodic> for DiscretePeriodicDmp {
    type Error = MotionError;

    fn try_from(saved: SavedDiscretePeriodic) -> Result<Self, MotionError> {
        let mut dmp = Self::new(saved.config, saved.omega, saved.duration)?;
        let n = dmp.dofs();
        vector("centre", n, &saved.centre)?;
        vector("start", n, &saved.start)?;
        vector("start_slope", n, &saved.start_slope)?;
        dmp.set_weights(&saved.weights)?;
        dmp.set_control_weights(&saved.control_weights)?;
        dmp.take_start(&saved.start, &saved.start_slope, &saved.centre);
        dmp.restart();
        Ok(dmp)
    }
}
