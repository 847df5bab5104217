//! A driver that is sensed and not driven: everything of a run happens but targets, for a robot that must not move yet.
//!
//! The joints stay where they are, so that motions end with their timeouts, or when somebody leads the robot there by hand.

use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;

use super::{Driver, DriverClock, DriverError, TimedSample};
use crate::JointTargets;

/// Samples as the driver below gives them, and targets that it does not get. One in lockstep, whose time stands still without
/// targets, gets those with which its joints stay where they were at first.
#[derive(Debug)]
pub struct DryDriver<D> {
    driver: D,
    held: Option<JointTargets>,
    fastest: Arc<Mutex<Vec<f64>>>,
}

impl<D: Driver> DryDriver<D> {
    /// Keeps targets from a driver.
    pub fn new(driver: D) -> Self {
        Self { driver, held: None, fastest: Arc::default() }
    }

    /// The greatest speed that was wanted of each joint, rad/s (m/s), in the model's order; it goes on being updated, and is empty
    /// before the first targets.
    pub fn fastest(&self) -> Arc<Mutex<Vec<f64>>> {
        Arc::clone(&self.fastest)
    }

    fn sensed(&mut self, timed: TimedSample) -> TimedSample {
        self.held.get_or_insert_with(|| JointTargets {
            position: timed.sample.position.clone(),
            velocity: vec![0.0; timed.sample.position.len()],
        });
        // That nobody drives it is no fault here.
        TimedSample { braked: false, ..timed }
    }
}

impl<D: Driver> Driver for DryDriver<D> {
    fn clock(&self) -> DriverClock {
        self.driver.clock()
    }

    fn period(&self) -> Duration {
        self.driver.period()
    }

    fn bodies(&self) -> Vec<String> {
        self.driver.bodies()
    }

    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        let timed = self.driver.sample()?;
        Ok(self.sensed(timed))
    }

    fn call_on_arrival(&mut self, call: Box<dyn Fn() + Send + Sync>) -> bool {
        self.driver.call_on_arrival(call)
    }

    fn arrived(&mut self) -> Result<Option<TimedSample>, DriverError> {
        let timed = self.driver.arrived()?;
        Ok(timed.map(|timed| self.sensed(timed)))
    }

    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        let mut fastest = self.fastest.lock();
        fastest.resize(targets.velocity.len(), 0.0);
        fastest.iter_mut().zip(&targets.velocity).for_each(|(most, v)| *most = most.max(v.abs()));
        drop(fastest);
        match (self.driver.clock(), &self.held) {
            (DriverClock::Lockstep, Some(held)) => self.driver.apply(held),
            _ => Ok(()),
        }
    }

    fn brake(&mut self) {
        self.driver.brake();
    }
}
