//! The interface below the guard: a [`Driver`] gives samples of the joints and the wrench sensors, and takes the targets that the
//! guard computes from them. It does not know limbs, leases or skills.
//!
//! - [`GuardedDriver`]: a guard that is stepped with a driver's samples, by the driver's clock.
//! - [`RemoteDriver`]: a driver in another process, in any language (`docs/wire-robot.md`).
//! - [`DryDriver`]: one that is sensed and not driven.
//! - [`DriverServer`]: offers a driver of this process to others.

mod dry;
mod gate;
mod guarded;
mod remote;
mod served;
#[cfg(test)]
mod tests;
mod wire;

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_bus::{CodecError, KeyError, SessionError};
use nalgebra::Isometry3;

pub use dry::DryDriver;
pub use guarded::GuardedDriver;
pub use remote::RemoteDriver;
pub use served::DriverServer;

use crate::{JointTargets, Sample};

/// How a driver's time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DriverClock {
    /// It stands still until the targets for the newest sample have come: a run does not depend on the machine's load.
    Lockstep,
    /// It does not wait. Without targets the joints brake after the driver's own watchdog time.
    Realtime,
}

/// A sample and its time.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedSample {
    /// Time since the driver's start, ns.
    pub stamp_ns: u64,
    /// Joints and wrench sensors, in the model's order.
    pub sample: Sample,
    /// Whether the joints stand, or brake, because targets had not come in time.
    pub braked: bool,
    /// Where bodies are, by their names, in the frame in which the odometry began; empty where nothing is told. A simulation tells
    /// it, for cameras that draw its scene.
    pub bodies: BTreeMap<String, Isometry3<f64>>,
}

/// Joints and wrench sensors below a guard, in the order of a robot's model. Its functions may hold up the thread.
pub trait Driver: Send {
    /// How its time passes.
    fn clock(&self) -> DriverClock;
    /// The time from one sample to the next.
    fn period(&self) -> Duration;
    /// The names of the bodies whose poses come with samples now and then; none where it knows of none.
    fn bodies(&self) -> Vec<String> {
        Vec::new()
    }
    /// Waits for the next sample.
    ///
    /// # Errors
    /// [`DriverError`] when the driver is lost: there will be no further sample.
    fn sample(&mut self) -> Result<TimedSample, DriverError>;
    /// Asks to be called whenever a sample comes, on the thread that brings it, which must not be held up for long. Returns whether
    /// this driver does so; otherwise samples are waited for.
    fn call_on_arrival(&mut self, _call: Box<dyn Fn() + Send + Sync>) -> bool {
        false
    }
    /// The next sample if it has come already.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
    fn arrived(&mut self) -> Result<Option<TimedSample>, DriverError> {
        Ok(None)
    }
    /// Sets the targets that follow from the last sample.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError>;
    /// Lets the joints brake and stand until further targets come.
    fn brake(&mut self);
}

/// How a driver differs from a robot.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Mismatch {
    /// It samples too often, or not often enough.
    #[error("it samples with {hz} Hz; 1 to 10000 are possible")]
    Rate {
        /// Samples per second.
        hz: f64,
    },
    /// It has something that the robot does not.
    #[error("the robot has no {kind} `{name}`; it has {known}")]
    Unknown {
        /// Joint or wrench sensor.
        kind: &'static str,
        /// The driver's name for it.
        name: String,
        /// The robot's, separated by commas.
        known: String,
    },
    /// It has something more than once.
    #[error("it names a {kind} twice")]
    Twice {
        /// Joint or wrench sensor.
        kind: &'static str,
    },
    /// It lacks something.
    #[error("it does not have the {kind} `{name}`")]
    Missing {
        /// Joint or wrench sensor.
        kind: &'static str,
        /// The robot's name for it.
        name: String,
    },
}

/// Why a driver cannot be used, or not any more.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DriverError {
    /// The network failed, or nobody answered.
    #[error("the driver `{driver}`: {source}")]
    Session {
        /// Its name.
        driver: String,
        /// The error.
        source: SessionError,
    },
    /// A message that is not understood.
    #[error("the driver `{driver}` sent what is not understood: {source}")]
    Message {
        /// Its name.
        driver: String,
        /// The error.
        source: CodecError,
    },
    /// It does not obey this process.
    #[error("the driver `{driver}` refuses: {reason}")]
    Refused {
        /// Its name.
        driver: String,
        /// Its reason.
        reason: String,
    },
    /// It is not a driver of this robot.
    #[error("the driver `{driver}` is not one of the robot `{robot}`: {what}")]
    OtherRobot {
        /// Its name.
        driver: String,
        /// The robot.
        robot: String,
        /// The difference.
        what: Mismatch,
    },
    /// No sample came.
    #[error("the driver `{driver}` has sent no sample for {silent_ms} ms")]
    Silent {
        /// Its name.
        driver: String,
        /// How long, ms.
        silent_ms: u64,
    },
    /// Its clock went back, or stood still.
    #[error("the clock of the driver `{driver}` went from {before_ns} to {after_ns} ns")]
    Clock {
        /// Its name.
        driver: String,
        /// The stamp before.
        before_ns: u64,
        /// The stamp after it.
        after_ns: u64,
    },
    /// Samples of another start of the driver came.
    #[error("the driver `{driver}` was started again, or there are two of the name")]
    Restarted {
        /// Its name.
        driver: String,
    },
}

impl From<KeyError> for DriverError {
    fn from(error: KeyError) -> Self {
        Self::Session { driver: error.name.clone(), source: error.into() }
    }
}
