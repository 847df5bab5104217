//! The messages between a guard and a driver in another process; `docs/wire-robot.md` describes them.
//!
//! Joints and sensors are in the order of the driver's [`Description`], not of the robot's model.

use std::collections::BTreeMap;

use armarium_bus::{Key, KeyError, Reply, keys};
use serde::{Deserialize, Serialize};

use super::{DriverClock, DriverError};
use crate::message::{WirePose, read};

/// What a driver drives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Description {
    /// The names of its joints in the order of samples and targets.
    pub(super) joints: Vec<String>,
    /// The names of its wrench sensors in the order of samples.
    #[serde(default)]
    pub(super) wrenches: Vec<String>,
    /// Samples per second.
    pub(super) rate_hz: f64,
    /// How its time passes.
    pub(super) clock: DriverClock,
    /// Distinguishes the starts of the driver.
    pub(super) epoch: u64,
    /// How long it waits for targets before it brakes, s; it does not wait by that in lockstep.
    #[serde(default)]
    pub(super) watchdog_s: f64,
    /// The names of the bodies whose poses it tells now and then, if it does.
    #[serde(default)]
    pub(super) bodies: Vec<String>,
    /// How often it has been claimed; in the answer to a claim, its number.
    #[serde(default)]
    pub(super) claims: u64,
}

/// A sample of a driver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WireSample {
    pub(super) epoch: u64,
    /// Counts from 0 in each epoch; a sample that is sent again has the number that it had.
    pub(super) number: u64,
    /// Time since the driver's start, ns.
    pub(super) stamp_ns: u64,
    /// rad (m).
    pub(super) position: Vec<f64>,
    /// rad/s (m/s).
    pub(super) velocity: Vec<f64>,
    /// Force and torque, N and N m.
    #[serde(default)]
    pub(super) wrenches: Vec<[f64; 6]>,
    /// Whether the joints brake or stand because no targets had come.
    #[serde(default)]
    pub(super) braked: bool,
    /// Why targets were refused since the last sample, if any were.
    #[serde(default)]
    pub(super) refused: Option<String>,
    /// Poses of bodies by their names, in the frame in which the odometry began.
    #[serde(default)]
    pub(super) bodies: BTreeMap<String, WirePose>,
    /// How often the driver has been claimed.
    #[serde(default)]
    pub(super) claims: u64,
}

/// The targets that follow from a sample.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WireTargets {
    /// Who has claimed the driver.
    pub(super) commander: String,
    /// The sample's epoch.
    pub(super) epoch: u64,
    /// The sample's number.
    pub(super) number: u64,
    /// rad (m).
    pub(super) position: Vec<f64>,
    /// rad/s (m/s).
    pub(super) velocity: Vec<f64>,
}

/// Asks for the right to send targets. The answer is a [`Description`] or a [`DriverRefusal`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Claim {
    /// A text that is unique to who asks.
    pub(super) commander: String,
    /// Who asks, for people.
    #[serde(default)]
    pub(super) caller: String,
}

/// Gives the right back. The answer is a [`Description`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Release {
    pub(super) commander: String,
}

/// Why something was refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct DriverRefusal {
    /// A sentence.
    pub(super) reason: String,
}

armarium_bus::payloads! {
    Description: "drive/description", 1;
    WireSample: "drive/sample", 1;
    WireTargets: "drive/targets", 1;
    Claim: "drive/claim", 1;
    Release: "drive/release", 1;
    DriverRefusal: "drive/refusal", 1;
}

/// The keys of a driver.
#[derive(Debug)]
pub(super) struct Keys {
    pub(super) description: Key,
    pub(super) sample: Key,
    pub(super) targets: Key,
    pub(super) claim: Key,
}

impl Keys {
    pub(super) fn of(agent: &str, driver: &str) -> Result<Self, KeyError> {
        let part = |part| keys::drive(agent, driver, part);
        let (description, sample) = (part("description")?, part("sample")?);
        Ok(Self { description, sample, targets: part("targets")?, claim: part("claim")? })
    }
}

/// The description in an answer.
pub(super) fn described(driver: &str, reply: &Reply) -> Result<Description, DriverError> {
    let unreadable = |source| DriverError::Message { driver: driver.into(), source };
    match reply {
        Reply::Message(message) => read(&message.encoding, &message.payload).map_err(unreadable),
        Reply::Refusal { encoding, payload } => {
            let DriverRefusal { reason } = read(encoding, payload).map_err(unreadable)?;
            Err(DriverError::Refused { driver: driver.into(), reason })
        }
    }
}
