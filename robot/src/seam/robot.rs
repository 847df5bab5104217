//! The robot as skills see it: the interface above the guard.

use std::sync::Arc;

use super::lease::Lease;
use crate::boundary::{LeaseError, LeaseLimits, Load, Sensed};
use crate::error::RobotError;
use crate::model::Model;
use crate::newest;

/// A robot as skills see it.
pub trait Robot: Send + Sync {
    /// Its description.
    fn model(&self) -> &Arc<Model>;
    /// The newest sample; the receiver wakes at each new one (1 kHz in the simulator).
    fn sensed(&self) -> newest::Receiver<Arc<Sensed>>;
    /// Takes the exclusive right to command a limb, until the lease is dropped.
    ///
    /// # Errors
    /// [`LeaseError`] when the limb is taken or unknown, or the robot is stopped.
    fn lease(&self, limb: &str, holder: &str, limits: LeaseLimits) -> Result<Lease, LeaseError>;
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
    /// Stops every limb permanently; later leases are refused.
    fn stop(&self, reason: &str);
    /// Says something through the robot's loudspeaker, for people nearby such as the coach.
    fn say(&self, utterance: &str);
}
