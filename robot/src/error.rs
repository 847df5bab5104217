//! Why a robot's description cannot be used.

/// Errors of reading a robot's description.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// The description cannot be used.
    #[error("robot description: {what}")]
    Description {
        /// What is wrong and where.
        what: String,
    },
    /// A name that the description does not contain.
    #[error("the robot has no {kind} `{name}`; it has {known}")]
    Unknown {
        /// Link, joint or limb.
        kind: &'static str,
        /// The requested name.
        name: String,
        /// Comma-separated names.
        known: String,
    },
}
