//! A hand under a skill's command: finger pads that open and close together.

use armarium_robot::{Lease, Sensed};
use armarium_runtime::skill::{Failure, SkillContext};

use crate::arm::{at_hand, chosen, lease};
use crate::equipment::Equipment;
use crate::grasp::hand;
use crate::motions::failed;

/// An arm's hand with its lease.
pub(crate) struct LeasedHand {
    lease: Lease,
    name: String,
    joints: Vec<usize>,
}

/// Gain with which the pads are kept at equal distances from the middle, 1/s.
const CENTRING_GAIN: f64 = 5.0;
/// Gain with which joints go to a shape, 1/s.
const SHAPING_GAIN: f64 = 4.0;

impl LeasedHand {
    /// Leases the hand of the arm that the input names, for the skill in `context`.
    pub(crate) async fn take(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        let (model, arm) = (equipment.robot.model(), chosen(equipment, context)?);
        let name = hand(model, arm)?.name.clone();
        let touches = at_hand(equipment, arm, &[]).await?;
        let lease = lease(equipment, context, &name, &touches)?;
        Ok(Self { lease, joints: model.limb(&name).to_vec(), name })
    }

    /// Its name.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Distance of the pads, m.
    pub(crate) fn aperture(&self, sample: &Sensed) -> f64 {
        aperture(&self.joints, sample)
    }

    /// Rate at which the aperture grows, m/s.
    pub(crate) fn opening_speed(&self, sample: &Sensed) -> f64 {
        self.joints.iter().map(|&j| sample.velocity[j]).sum()
    }

    /// Moves each joint towards its place in a shape, rad (m); returns how far the farthest one is from it.
    pub(crate) fn towards(&self, sample: &Sensed, shape: &[f64]) -> Result<f64, Failure> {
        let off = || self.joints.iter().zip(shape).map(|(&j, goal)| goal - sample.position[j]);
        let velocities: Vec<f64> = off().map(|off| SHAPING_GAIN * off).collect();
        self.lease.command(&velocities).map_err(failed)?;
        Ok(off().fold(0.0, |most, off| most.max(off.abs())))
    }

    /// Closes each pad at a speed, m/s (negative: opens), and keeps the pads centred.
    pub(crate) fn close_at(&self, sample: &Sensed, speed: f64) -> Result<(), Failure> {
        let positions: Vec<f64> = self.joints.iter().map(|&j| sample.position[j]).collect();
        let mean = positions.iter().sum::<f64>() / positions.len().max(1) as f64;
        let velocities: Vec<f64> = positions.iter().map(|p| -speed + CENTRING_GAIN * (mean - p)).collect();
        self.lease.command(&velocities).map_err(failed)
    }
}

/// Distance of the pads of a hand with these joints, m.
pub(crate) fn aperture(joints: &[usize], sample: &Sensed) -> f64 {
    joints.iter().map(|&j| sample.position[j]).sum()
}
