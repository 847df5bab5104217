//! The right hand under a skill's command: two finger pads that open and close together.

use std::sync::Arc;

use armarium_robot::{Lease, Model, Sensed};
use armarium_runtime::skill::{Failure, SkillContext};

use crate::arm::lease;
use crate::equipment::Equipment;

/// The right hand with its lease.
pub(crate) struct Hand {
    lease: Lease,
    model: Arc<Model>,
}

/// Gain with which the pads are kept at equal distances from the middle, 1/s.
const CENTRING_GAIN: f64 = 5.0;

impl Hand {
    /// Leases the right hand for the skill in `context`.
    pub(crate) fn take(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        let lease = lease(equipment, context, "right_hand")?;
        Ok(Self { lease, model: Arc::clone(equipment.robot.model()) })
    }

    /// Distance of the pads, m.
    pub(crate) fn aperture(&self, sample: &Sensed) -> f64 {
        aperture(&self.model, sample)
    }

    /// Rate at which the aperture grows, m/s.
    pub(crate) fn opening_speed(&self, sample: &Sensed) -> f64 {
        joints(&self.model).iter().map(|&j| sample.velocity[j]).sum()
    }

    /// Closes each pad at a speed, m/s (negative: opens), and keeps the pads centred.
    pub(crate) fn close_at(&self, sample: &Sensed, speed: f64) -> Result<(), Failure> {
        let positions: Vec<f64> = joints(&self.model).iter().map(|&j| sample.position[j]).collect();
        let mean = positions.iter().sum::<f64>() / positions.len().max(1) as f64;
        let velocities: Vec<f64> = positions.iter().map(|p| -speed + CENTRING_GAIN * (mean - p)).collect();
        self.lease.command(&velocities).map_err(|fault| Failure::new(fault.to_string()))
    }
}

/// Distance of the pads, m.
pub(crate) fn aperture(model: &Model, sample: &Sensed) -> f64 {
    joints(model).iter().map(|&j| sample.position[j]).sum()
}

fn joints(model: &Model) -> &[usize] {
    model.limb("right_hand")
}
