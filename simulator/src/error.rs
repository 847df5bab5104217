//! Why a simulation cannot be built.

use crate::physics::PlantError;

/// Why a simulation cannot be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// The physics could not be built.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The robot has no camera.
    #[error("the robot's description has no link `camera_left`")]
    Camera,
    /// The start posture does not have one position per joint.
    #[error("a starting posture needs {expected} finite joint positions")]
    Start {
        /// Number of joints of the model.
        expected: usize,
    },
}
