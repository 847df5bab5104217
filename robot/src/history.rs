//! Where the robot's links were: its joints of the last seconds, as a source of frames. It asks no one and commands nothing.

use std::collections::VecDeque;
use std::sync::Arc;

use armarium_values::Frame;
use armarium_values::transforms::{FrameSource, KEPT_NS, TransformError, bracket};
use nalgebra::Isometry3;
use parking_lot::Mutex;
use tokio::task::JoinHandle;

use crate::{Model, Robot, Sensed};

/// Most samples: ten seconds at 2 kHz.
const MAX_SAMPLES: usize = 20_001;

/// The samples of the last ten seconds. Each link of the robot is a frame in its root frame; between two samples, joints
/// are interpolated linearly, so that a link turns about its axis.
pub struct JointHistory {
    model: Arc<Model>,
    samples: Mutex<VecDeque<Arc<Sensed>>>,
}

impl JointHistory {
    /// A history without samples.
    pub fn new(model: &Arc<Model>) -> Self {
        Self { model: Arc::clone(model), samples: Mutex::default() }
    }

    /// The history of a robot from now on, kept by a task that ends when the robot does or the history is dropped.
    pub fn of(robot: &dyn Robot) -> (Arc<Self>, JoinHandle<()>) {
        let history = Arc::new(Self::new(robot.model()));
        let (mut sensed, keeper) = (robot.sensed(), Arc::downgrade(&history));
        let task = tokio::spawn(async move {
            while sensed.changed().await.is_ok() {
                let sample = sensed.borrow_and_update();
                let Some(history) = keeper.upgrade() else { return };
                history.keep(sample);
            }
        });
        (history, task)
    }

    /// Keeps a sample. One that is not later than the newest is ignored.
    pub fn keep(&self, sample: Arc<Sensed>) {
        let mut samples = self.samples.lock();
        let newest = sample.stamp_ns;
        if samples.back().is_some_and(|last| last.stamp_ns >= newest) {
            return;
        }
        samples.push_back(sample);
        while samples.len() > MAX_SAMPLES
            || samples.get(1).is_some_and(|second| second.stamp_ns + KEPT_NS <= newest)
        {
            samples.pop_front();
        }
    }

    /// The positions of all joints at a time, rad (m).
    ///
    /// # Errors
    /// [`TransformError::TooOld`] and [`TransformError::NotYet`], about `frame`.
    pub fn joints(&self, frame: &Frame, stamp_ns: u64) -> Result<Vec<f64>, TransformError> {
        let samples = self.samples.lock();
        let between = bracket(frame, samples.len(), |index| samples[index].stamp_ns, stamp_ns)?;
        let [before, after] = between.samples.map(|index| &samples[index].position);
        Ok(before.iter().zip(after).map(|(a, b)| a + between.share * (b - a)).collect())
    }
}

impl FrameSource for JointHistory {
    fn parent(
        &self,
        frame: &Frame,
        stamp_ns: u64,
    ) -> Option<Result<(Frame, Isometry3<f64>), TransformError>> {
        if *frame == Frame::root() {
            return None;
        }
        let link = self.model.link(&frame.0)?;
        let joints = self.joints(frame, stamp_ns);
        Some(joints.map(|q| (Frame::root(), self.model.link_pose(&q, link))))
    }

    fn frames(&self) -> Vec<Frame> {
        self.model.links().iter().map(|link| Frame(link.name.clone())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armarium_values::transforms::Transforms;

    #[test]
    fn links_are_where_the_joints_were_between_two_samples() {
        let model = Model::shipped("armar3").unwrap();
        let history = Arc::new(JointHistory::new(&model));
        let neck = model.require_joint("neck_yaw").unwrap();
        let at = |yaw: f64| {
            let mut q = model.zero();
            q[neck] = yaw;
            q
        };
        for k in 0..12_000_u32 {
            let position = at(0.2 * f64::from(k) * 1e-3);
            let (stamp_ns, velocity) = (u64::from(k) * 1_000_000, vec![0.0; position.len()]);
            let sample = Sensed { stamp_ns, velocity, position, wrenches: Vec::new() };
            history.keep(Arc::new(sample));
        }
        let mut transforms = Transforms::new();
        transforms.attach(Arc::clone(&history) as Arc<dyn FrameSource>);
        let ask = |frame: &str, stamp: u64| transforms.transform(&Frame::root(), &frame.into(), stamp);
        let expected = model.link_pose(&at(0.2 * 5.0005), model.link("camera_left").unwrap());
        let found = ask("camera_left", 5_000_500_000).unwrap();
        assert!((found.inverse() * expected).translation.vector.norm() < 1e-9);
        assert!(found.rotation.angle_to(&expected.rotation) < 1e-7);
        let between =
            transforms.transform(&"camera_left".into(), &"camera_right".into(), 5_000_000_000).unwrap();
        assert!((between.translation.vector.norm() - 0.093).abs() < 0.01, "{between}");
        assert!(matches!(ask("camera_left", 1_000_000_000), Err(TransformError::TooOld { .. })));
        assert!(matches!(ask("camera_left", 12_000_000_000), Err(TransformError::NotYet { .. })));
        assert!(ask("nose", 5_000_000_000).unwrap_err().to_string().contains("camera_left, camera_right"));
        assert!(history.samples.lock().len() <= 10_002);
    }
}
