//! A hand under a skill's command: finger pads that open and close together.

use std::sync::Arc;

use armarium_robot::{Lease, Model, Sensed};
use armarium_runtime::skill::{Failure, SkillContext, SkillManifest};

use crate::arm::lease;
use crate::equipment::Equipment;
use crate::grasp::hand;

/// The arm's hand with its lease.
pub(crate) struct Hand {
    lease: Lease,
    model: Arc<Model>,
}

/// Adds the limb that a skill commands when it moves the hand.
pub(crate) fn moves_the_hand(manifest: SkillManifest, equipment: &Equipment) -> SkillManifest {
    match hand(equipment.robot.model()) {
        Ok(hand) => manifest.limb(&hand.name),
        Err(_) => manifest,
    }
}

/// Gain with which the pads are kept at equal distances from the middle, 1/s.
const CENTRING_GAIN: f64 = 5.0;

impl Hand {
    /// Leases the hand for the skill in `context`.
    pub(crate) fn take(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        let model = Arc::clone(equipment.robot.model());
        let lease = lease(equipment, context, &hand(&model)?.name)?;
        Ok(Self { lease, model })
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
    hand(model).map_or(&[], |hand| model.limb(&hand.name))
}
