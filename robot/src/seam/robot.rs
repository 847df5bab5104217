//! The robot as skills see it: the interface above the guard.

use std::sync::Arc;

use nalgebra::Point3;

use super::lease::Lease;
use crate::boundary::{LeaseError, LeaseLimits, Sensed};
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
    /// Takes the present compensated wrist force as zero. To be called while nothing touches the hand.
    fn tare(&self);
    /// Sets what the hand holds, so that its weight is compensated: mass, kg, and centre in the TCP frame, m.
    fn set_load(&self, mass_kg: f64, center_in_tcp: Point3<f64>);
    /// Stops every limb permanently; later leases are refused.
    fn stop(&self, reason: &str);
    /// Says something through the robot's loudspeaker, for people nearby such as the coach.
    fn say(&self, utterance: &str);
}
