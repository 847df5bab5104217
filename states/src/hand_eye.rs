//! The hand-eye correction: the true pose of the cameras on the head, and how the neck leans.
//!
//! The head's kinematics give an assumed camera pose. A mounting error of a few degrees and millimetres displaces
//! everything that is seen by centimetres. The robot determines the mounting by looking at the marker on its own
//! hand, and stores it in memory. [`CorrectedImages`] is the one place where it is applied: all that see through the robot's
//! own eyes get frames with the true pose. The mounting is a pose in the camera's own frame, because it turns with the head. What the
//! joints under the neck are off tilts the cameras, too, but does not turn with the head; the floor shows it.

use std::sync::Arc;

use armarium_memoryx::{Commit, EntityId, Memory, MemoryError};
use armarium_runtime::skill::Failure;
use armarium_values::{Frame, Pose, Value};
use armarium_visionx::{ImageError, ImageSource, StereoCalibration, StereoFrame};
use async_trait::async_trait;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};

use crate::motions::failed;

const SEGMENT: &str = "AgentInstances";
const ENTITY: &str = "hand_eye";

/// The attributes; the mounting is given in the frame `CAMERA`, how the neck leans in the root frame.
const MOUNTED: &str = "believed_from_left";
const CAMERA: &str = "camera_left_believed";
const UPRIGHT: &str = "upright";

/// Where the cameras are, as far as it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Mounting {
    /// The left camera's true pose in the frame of its assumed pose.
    pub(crate) believed_from_left: Isometry3<f64>,
    /// Turns what a neck that leans believes to be the root frame upright, about the cameras, and lifts it, m.
    pub(crate) upright: Isometry3<f64>,
}

impl Mounting {
    /// The newest one in memory; that of a robot without errors if there is none, or none that can be read.
    pub(crate) async fn load(memory: &dyn Memory, agent: &str) -> Result<Self, Failure> {
        let known = match memory.latest(&address(agent)?).await {
            Ok(known) => known,
            Err(MemoryError::NotFound { .. }) => return Ok(Self::default()),
            Err(error) => return Err(failed(error)),
        };
        let pose = |name: &str, frame: Frame| match known.attribute(name) {
            Some(Value::Pose(pose)) if pose.frame == frame => pose.isometry(),
            _ => Isometry3::identity(),
        };
        Ok(Self { believed_from_left: pose(MOUNTED, CAMERA.into()), upright: pose(UPRIGHT, Frame::root()) })
    }

    /// Writes it to memory.
    pub(crate) async fn store(&self, memory: &dyn Memory, agent: &str, stamp_ns: u64) -> Result<(), Failure> {
        let mounted = Pose::new(CAMERA.into(), &self.believed_from_left);
        let upright = Pose::new(Frame::root(), &self.upright);
        let attributes = [(MOUNTED, Value::Pose(mounted)), (UPRIGHT, Value::Pose(upright))];
        let commit = Commit::new(address(agent)?, stamp_ns, attributes);
        memory.commit(vec![commit]).await.map_err(failed)?;
        Ok(())
    }

    /// The left camera's true pose, which the head's kinematics believe to be at `root_from_left`. What a neck that leans moves is left
    /// out: some millimetres.
    pub(crate) fn corrected(&self, root_from_left: &Isometry3<f64>) -> Isometry3<f64> {
        let mounted = root_from_left * self.believed_from_left;
        let at = self.upright.translation.vector + mounted.translation.vector;
        Isometry3::from_parts(at.into(), self.upright.rotation * mounted.rotation)
    }

    /// What is known when the cameras, which this says to be at `root_from_left`, are found to be turned by `turn` more about their own axes,
    /// and the neck to lean so that `upright` more turns its root frame. What they see at the place `kept` (root frame) stays there, as it
    /// has shown where they are.
    pub(crate) fn turned(
        &self,
        turn: &UnitQuaternion<f64>,
        upright: &UnitQuaternion<f64>,
        root_from_left: &Isometry3<f64>,
        kept: &Point3<f64>,
    ) -> Self {
        let (before, at) = (root_from_left.rotation, root_from_left.translation.vector);
        let in_left = root_from_left.inverse() * kept;
        let moves = kept.coords - at - upright * (before * (turn * in_left.coords));
        let moves = Translation3::from(before.inverse() * (self.upright.rotation * moves));
        let upright = Isometry3::from_parts(self.upright.translation, upright * self.upright.rotation);
        Self { believed_from_left: self.believed_from_left * Isometry3::from_parts(moves, *turn), upright }
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
        let mounting = Mounting::load(&*self.memory, &self.agent).await;
        let mounting = mounting.map_err(|failure| ImageError::Spoilt {
            provider: self.name().into(),
            what: format!("no pose of its cameras: {failure}"),
        })?;
        if mounting == Mounting::default() {
            return Ok(frame);
        }
        let root_from_left = mounting.corrected(&frame.root_from_left);
        Ok(Arc::new(StereoFrame { root_from_left, ..Arc::unwrap_or_clone(frame) }))
    }
}

fn address(agent: &str) -> Result<EntityId, Failure> {
    EntityId::new(SEGMENT, agent, ENTITY).map_err(failed)
}

#[cfg(test)]
mod tests {
    use armarium_memoryx::tokio_clock;
    use armarium_visionx::{PinholeCamera, RgbImage};
    use nalgebra::Vector3;

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
        let memory: Arc<dyn Memory> = Arc::new(armarium_knowledge::working_memory(tokio_clock()));
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
            let known = Mounting::load(&*memory, "local").await.unwrap();
            let known = Mounting { believed_from_left: known.believed_from_left * found, ..known };
            known.store(&*memory, "local", 1).await.unwrap();
            expected *= found;
            let seen = images.next().await.unwrap().root_from_left;
            assert!((seen.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12);
        }
    }

    #[test]
    fn what_levels_the_cameras_keeps_what_they_see_in_one_place() {
        let turned = |x: f64, y: f64, z: f64| UnitQuaternion::from_euler_angles(x, y, z);
        let known = Mounting {
            believed_from_left: Isometry3::new(
                Vector3::new(0.01, 0.02, -0.01),
                Vector3::new(0.02, 0.0, 0.03),
            ),
            upright: Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.01), turned(0.003, -0.004, 0.0)),
        };
        let believed = Isometry3::from_parts(Translation3::new(0.1, 0.2, 1.6), turned(-2.3, 0.1, 0.2));
        let (turn, upright) = (turned(0.01, -0.02, 0.004), turned(-0.006, 0.005, 0.0));
        let (seen, kept) = (known.corrected(&believed), Point3::new(0.2, 0.6, 1.0));
        let levelled = known.turned(&turn, &upright, &seen, &kept).corrected(&believed);
        assert!(((levelled * (seen.inverse() * kept)) - kept).norm() < 1e-12);
        let by = levelled.rotation * (upright * seen.rotation * turn).inverse();
        assert!(by.angle() < 1e-12, "{by}");
    }
}
