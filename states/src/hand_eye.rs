//! The hand-eye correction: the true pose of the cameras on the head.
//!
//! The head's kinematics give an assumed camera pose. A mounting error of a few degrees and millimetres displaces
//! everything that is seen by centimetres. The robot determines the mounting by looking at the marker on its own
//! hand, and stores it in memory. [`CorrectedImages`] is the one place where it is applied: all that see through the robot's
//! own eyes get frames with the true pose. The correction is a pose in the camera's own frame, because it turns with the head.

use std::sync::Arc;

use armarium_memoryx::{Commit, EntityId, Memory, MemoryError};
use armarium_runtime::skill::Failure;
use armarium_values::{Pose, Value};
use armarium_visionx::{ImageError, ImageSource, StereoCalibration, StereoFrame};
use async_trait::async_trait;
use nalgebra::Isometry3;

use crate::motions::failed;

const SEGMENT: &str = "AgentInstances";
const ENTITY: &str = "hand_eye";

/// The frame in which the mounting is given.
const CAMERA: &str = "camera_left_believed";

/// The newest mounting in memory, `believed_from_left`: the left camera's true pose in the frame of its assumed pose; the identity if there
/// is none, or none that can be read.
pub(crate) async fn load_mounting(memory: &dyn Memory, agent: &str) -> Result<Isometry3<f64>, Failure> {
    match memory.latest(&address(agent)?).await {
        Ok(snapshot) => Ok(match snapshot.attribute("believed_from_left") {
            Some(Value::Pose(pose)) if pose.frame.0 == CAMERA => pose.isometry(),
            _ => Isometry3::identity(),
        }),
        Err(MemoryError::NotFound { .. }) => Ok(Isometry3::identity()),
        Err(error) => Err(failed(error)),
    }
}

/// Writes the mounting to memory.
pub(crate) async fn store_mounting(
    memory: &dyn Memory,
    agent: &str,
    believed_from_left: &Isometry3<f64>,
    residual_m: f64,
    stamp_ns: u64,
) -> Result<(), Failure> {
    let mounting = Value::Pose(Pose::new(CAMERA.into(), believed_from_left));
    let attributes = [("believed_from_left", mounting), ("residual", residual_m.into())];
    let commit = Commit::new(address(agent)?, stamp_ns, attributes);
    memory.commit(vec![commit]).await.map_err(failed)?;
    Ok(())
}

/// A robot's images with the true pose of its cameras, as far as its memory knows it.
pub struct CorrectedImages {
    source: Arc<dyn ImageSource>,
    memory: Arc<dyn Memory>,
    agent: String,
}

impl CorrectedImages {
    /// The images of `source`; `agent` has found the mounting of its cameras and keeps it in `memory`.
    pub fn new(source: Arc<dyn ImageSource>, memory: Arc<dyn Memory>, agent: &str) -> Self {
        Self { source, memory, agent: agent.into() }
    }
}

#[async_trait]
impl ImageSource for CorrectedImages {
    fn name(&self) -> &str {
        self.source.name()
    }

    fn calibration(&self) -> StereoCalibration {
        self.source.calibration()
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let frame = self.source.next().await?;
        let mounting = load_mounting(&*self.memory, &self.agent).await;
        let mounting = mounting.map_err(|failure| ImageError::Spoilt {
            provider: self.name().into(),
            what: format!("no pose of its cameras: {failure}"),
        })?;
        if mounting == Isometry3::identity() {
            return Ok(frame);
        }
        let root_from_left = frame.root_from_left * mounting;
        Ok(Arc::new(StereoFrame { root_from_left, ..Arc::unwrap_or_clone(frame) }))
    }
}

fn address(agent: &str) -> Result<EntityId, Failure> {
    EntityId::new(SEGMENT, agent, ENTITY).map_err(failed)
}

#[cfg(test)]
mod tests {
    use armarium_memoryx::{WorkingMemory, tokio_clock};
    use armarium_visionx::{PinholeCamera, RgbImage};
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    /// A camera that believes to be at `0`.
    struct Camera(Isometry3<f64>);

    #[async_trait]
    impl ImageSource for Camera {
        fn name(&self) -> &str {
            "camera"
        }

        fn calibration(&self) -> StereoCalibration {
            let camera = PinholeCamera { width: 1, height: 1, focal: 1.0, center: [0.5; 2] };
            StereoCalibration { camera, baseline: 0.1 }
        }

        async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
            let [left, right] = [0, 1].map(|_| RgbImage::painted(1, 1, |_, _| [0; 3]).into());
            Ok(Arc::new(StereoFrame { stamp_ns: 1, left, right, depth: None, root_from_left: self.0 }))
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_mounting_that_is_found_twice_is_that_of_both_findings() {
        let memory: Arc<dyn Memory> = Arc::new(WorkingMemory::new(tokio_clock()));
        let turned = |axis: Vector3<f64>, x: f64| {
            Isometry3::from_parts(Vector3::new(x, 0.02, 0.0).into(), UnitQuaternion::from_scaled_axis(axis))
        };
        let believed = turned(Vector3::new(0.0, 0.0, 1.2), 0.4);
        let [first, second] =
            [turned(Vector3::new(0.03, 0.0, 0.0), 0.01), turned(Vector3::new(0.0, 0.05, 0.02), -0.02)];
        let images = CorrectedImages::new(Arc::new(Camera(believed)), Arc::clone(&memory), "local");
        assert_eq!(images.next().await.unwrap().root_from_left, believed, "nothing is known yet");
        let mut expected = believed;
        for found in [first, second] {
            // What is left of the error is seen in the frame of the camera as it is corrected so far.
            let known = load_mounting(&*memory, "local").await.unwrap();
            store_mounting(&*memory, "local", &(known * found), 0.001, 1).await.unwrap();
            expected *= found;
            let seen = images.next().await.unwrap().root_from_left;
            assert!((seen.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12);
        }
    }
}
