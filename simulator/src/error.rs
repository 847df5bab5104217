//! Why a simulation cannot be built.

use armarium_source::Finding;

/// Why a simulation cannot be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// The physics could not be built.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The robot's files cannot be used.
    #[error("the robot `{robot}` cannot be used: {}", findings.first().map_or_else(String::new, ToString::to_string))]
    Robot {
        /// The robot.
        robot: String,
        /// Everything that is wrong.
        findings: Vec<Finding>,
    },
    /// The robot has no arm that could wipe.
    #[error("the robot has no such arm: a group of its robot file with a `tcp`")]
    Arm,
    /// The robot has no cameras.
    #[error("the robot has no stereo cameras; its robot file names none under `cameras`")]
    Camera,
    /// The start posture does not have one position per joint.
    #[error("a starting posture needs {expected} finite joint positions")]
    Start {
        /// Number of joints of the model.
        expected: usize,
    },
}

/// Why a plant cannot be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlantError {
    /// The robot lacks something that the simulator needs.
    #[error("the robot lacks the {what}")]
    Missing {
        /// The missing part.
        what: String,
    },
    /// The physics rejected a joint.
    #[error("the joint `{joint}` does not fit into the robot's tree")]
    Joint {
        /// The joint's name.
        joint: String,
    },
}
