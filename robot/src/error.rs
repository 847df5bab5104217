//! Why a part of a robot cannot be used.

use crate::boundary::{MAX_KG, MAX_M, MAX_NAME};

/// A robot lacks something.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// A name that the robot does not have.
    #[error("the robot has no {kind} `{name}`; it has {known}")]
    Unknown {
        /// Link, joint, limb, hand or sensor.
        kind: &'static str,
        /// The requested name.
        name: String,
        /// Comma-separated names.
        known: String,
    },
    /// A load that is not physical.
    #[error(
        "the load `{name}` of {mass_kg} kg is not physical: a mass is 0 to {MAX_KG} kg, lengths are at most {MAX_M} m, a name has at most {MAX_NAME} bytes"
    )]
    Load {
        /// What it is.
        name: String,
        /// Its mass, kg.
        mass_kg: f64,
    },
    /// Surroundings that cannot be kept.
    #[error("the surroundings cannot be used: {why}")]
    Surroundings {
        /// What is wrong with them.
        why: String,
    },
    /// A factor that would make the robot faster than it was asked to be, or stand.
    #[error("the speed scale {scale} cannot be used: it is over 0 and at most 1")]
    SpeedScale {
        /// The factor.
        scale: f64,
    },
    /// The robot is in another process, which refuses, or cannot be asked.
    #[error("the robot `{robot}`: {why}")]
    Remote {
        /// `AGENT/ROBOT`.
        robot: String,
        /// The reason.
        why: String,
    },
    /// It has no cameras.
    #[error("the robot has no stereo cameras; its robot file names none under `cameras`")]
    NoCamera,
}
