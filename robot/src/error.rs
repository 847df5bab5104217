//! Why a part of a robot cannot be used.

/// A robot lacks something.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// A name that the robot does not have.
    #[error("the robot has no {kind} `{name}`; it has {known}")]
    Unknown {
        /// Link, joint or limb.
        kind: &'static str,
        /// The requested name.
        name: String,
        /// Comma-separated names.
        known: String,
    },
    /// It has no cameras.
    #[error("the robot has no stereo cameras; its robot file names none under `cameras`")]
    NoCamera,
}
