//! The hand-eye correction: the true pose of the cameras on the head.
//!
//! The head's kinematics give an assumed camera pose. A mounting error of a few degrees and millimetres displaces
//! everything that is seen by centimetres. The robot determines the mounting by looking at the marker on its own
//! hand, and stores it in memory. [`CorrectedImages`] is the one place where it is applied: all that see through the robot's
//! eyes get frames with the true pose. It is expressed in the camera's own frame, because it turns with the head.

use std::collections::BTreeMap;
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

/// `believed_from_left`: the left camera's true pose in the frame of its assumed pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HandEye {
    believed_from_left: Isometry3<f64>,
}

impl HandEye {
    /// The correction for this mounting.
    pub(crate) fn new(believed_from_left: Isometry3<f64>) -> Self {
        Self { believed_from_left }
    }

    /// The newest correction in memory; the identity if there is none.
    pub(crate) async fn load(memory: &dyn Memory, agent: &str) -> Result<Self, Failure> {
        match memory.latest(&address(agent)?).await {
            Ok(snapshot) => {
                let mounting = match snapshot.attribute("believed_from_left") {
                    Some(Value::Pose(pose)) if pose.frame.0 == CAMERA => Some(pose.isometry()),
                    _ => None,
                };
                let pose = mounting.ok_or_else(|| {
                    Failure::new("the hand-eye correction in memory is no mounting of a camera")
                })?;
                Ok(Self::new(pose))
            }
            Err(MemoryError::NotFound { .. }) => Ok(Self::new(Isometry3::identity())),
            Err(error) => Err(failed(error)),
        }
    }

    /// Writes the correction to memory.
    pub(crate) async fn store(
        &self,
        memory: &dyn Memory,
        agent: &str,
        residual_m: f64,
        stamp_ns: u64,
    ) -> Result<(), Failure> {
        let attributes = BTreeMap::from([
            (
                "believed_from_left".to_owned(),
                Value::Pose(Pose::new(CAMERA.into(), &self.believed_from_left)),
            ),
            ("residual".to_owned(), residual_m.into()),
        ]);
        let commit = Commit::new(address(agent)?, stamp_ns, attributes);
        memory.commit(vec![commit]).await.map_err(failed)?;
        Ok(())
    }

    /// The mounting that follows from one that is seen through this one.
    pub(crate) fn refined(&self, corrected_from_left: &Isometry3<f64>) -> Self {
        Self { believed_from_left: self.believed_from_left * corrected_from_left }
    }
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
        let mounting = HandEye::load(&*self.memory, &self.agent).await.map_err(|failure| {
            ImageError::Spoilt { provider: self.name().into(), what: failure.to_string() }
        })?;
        if mounting.believed_from_left == Isometry3::identity() {
            return Ok(frame);
        }
        let root_from_left = frame.root_from_left * mounting.believed_from_left;
        Ok(Arc::new(StereoFrame { root_from_left, ..Arc::unwrap_or_clone(frame) }))
    }
}

fn address(agent: &str) -> Result<EntityId, Failure> {
    EntityId::new(SEGMENT, agent, ENTITY).map_err(failed)
}
