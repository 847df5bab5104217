//! The robot as skills see it: the interface above the guard.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::lease::Lease;
use crate::boundary::{LeaseError, LeaseLimits, Load, Sensed};
use crate::error::RobotError;
use crate::model::Model;
use crate::newest;
use crate::planning::KnownBox;

/// A robot as skills see it.
pub trait Robot: Send + Sync {
    /// Its description.
    fn model(&self) -> &Arc<Model>;
    /// The newest sample; the receiver wakes at each new one (1 kHz in the simulator).
    fn sensed(&self) -> newest::NewestReceiver<Arc<Sensed>>;
    /// Why no further sample will come, where that is known.
    fn lost(&self) -> Option<String> {
        None
    }
    /// Takes the exclusive right to command several limbs together, all or none, until the lease is dropped: one command for
    /// all of them, in the order given, and one fault. `touches` names what the hands that they move, with what these hold, may
    /// come near to: known boxes ([`set_surroundings`](Self::set_surroundings)) or links. All else keeps its distance.
    ///
    /// # Errors
    /// [`LeaseError`] when a limb is taken or unknown, or the robot is stopped.
    fn lease_together(
        &self,
        limbs: &[&str],
        holder: &str,
        limits: LeaseLimits,
        touches: &[String],
    ) -> Result<Lease, LeaseError>;
    /// Takes the exclusive right to command one limb, until the lease is dropped; its hand touches nothing.
    ///
    /// # Errors
    /// As [`lease_together`](Self::lease_together).
    fn lease(&self, limb: &str, holder: &str, limits: LeaseLimits) -> Result<Lease, LeaseError> {
        self.lease_together(&[limb], holder, limits, &[])
    }
    /// Takes the present compensated force of a wrench sensor as zero. To be called while nothing touches the hand.
    ///
    /// # Errors
    /// [`RobotError::Unknown`] when there is no such sensor.
    fn tare(&self, wrench: &str) -> Result<(), RobotError>;
    /// Sets what a hand holds, so that its weight is compensated; `None` for nothing. See [`Load`] for two hands that
    /// hold one thing.
    ///
    /// # Errors
    /// [`RobotError::Unknown`] when there is no such hand, [`RobotError::Load`] when the load is not physical.
    fn set_load(&self, hand: &str, load: Option<Load>) -> Result<(), RobotError>;
    /// What the hands hold, by their names, as far as it was set.
    fn loads(&self) -> BTreeMap<String, Load>;
    /// Sets what is known to stand around the robot, root frame, in place of what was known before. Its bodies keep their distance
    /// from it.
    ///
    /// # Errors
    /// [`RobotError::Surroundings`] when a box is none, or there are too many.
    fn set_surroundings(&self, boxes: Vec<KnownBox>) -> Result<(), RobotError>;
    /// Stops every limb. Leases get the fault, and later ones are refused until [`reset`](Self::reset).
    fn stop(&self, reason: &str);
    /// Ends a stop: limbs can be leased again. Leases that were stopped stay so.
    fn reset(&self);
    /// Multiplies all commanded velocities from now on: 1 at first, 0.05 for a first try with a new robot. What an arm does to give
    /// way to a force is not changed.
    ///
    /// # Errors
    /// [`RobotError::SpeedScale`] when it is not over 0 and at most 1.
    fn set_speed_scale(&self, scale: f64) -> Result<(), RobotError>;
    /// Says something through the robot's loudspeaker, for people nearby such as the coach.
    fn say(&self, utterance: &str);
}
