//! The head under a skill's command: it turns until the cameras look at a point, and follows a moving point. Both
//! cameras stay parallel, as the stereo calibration holds only then. It holds the lease for as long as it lives.
//! Cameras that nothing turns look where they look: they can only be asked how far off a point is.

use std::sync::Arc;

use armarium_robot::{Gaze, Lease, Model, Sensed};
use armarium_runtime::skill::{Failure, SkillContext, SkillManifest};
use nalgebra::{Isometry3, Point3, Unit, Vector3, center};

use crate::arm::lease;
use crate::equipment::Equipment;
use crate::motions::failed;

/// The limb that turns the cameras, if there is one.
fn head(model: &Model) -> Option<&str> {
    model.camera()?.on.as_deref()
}

/// Adds the limb that a skill commands when it turns the head.
pub(crate) fn moves_the_head(manifest: SkillManifest, equipment: &Equipment) -> SkillManifest {
    match head(equipment.robot.model()) {
        Some(head) => manifest.limb(head),
        None => manifest,
    }
}

/// Gain of the joints' error, 1/s.
const GAIN: f64 = 4.0;
/// Interval at which the joint goal is recomputed, s, because the torso under the head may move.
const RENEWAL: f64 = 0.1;

/// The head that a skill commands.
pub(crate) struct Head {
    /// None for cameras that nothing turns.
    lease: Option<Lease>,
    joints: Vec<usize>,
    model: Arc<Model>,
    gaze: Gaze,
    /// The goal of all joints, rad, and its age, s.
    goal: Option<(Vec<f64>, f64)>,
}

impl Head {
    /// Leases the head for the skill in `context`.
    pub(crate) fn take(equipment: &Equipment, context: &SkillContext) -> Result<Self, Failure> {
        let model = Arc::clone(equipment.robot.model());
        let lease = head(&model).map(|head| lease(equipment, context, head, &[])).transpose()?;
        let joints = head(&model).map_or_else(Vec::new, |head| model.limb(head).to_vec());
        let gaze = Gaze::of(&model).map_err(failed)?;
        Ok(Self { lease, joints, model, gaze, goal: None })
    }

    /// Whether it can turn.
    pub(crate) fn turns(&self) -> bool {
        self.lease.is_some()
    }

    /// The middle between the cameras and where they look, with all joints as in `q`: a place in the root frame, m, and a unit vector.
    pub(crate) fn eye(&self, q: &[f64]) -> (Point3<f64>, Unit<Vector3<f64>>) {
        let pose = |eye| self.model.link_pose(q, eye);
        let eyes = self.model.camera().map(|camera| [pose(camera.left), pose(camera.right)]);
        let [left, right] = eyes.unwrap_or([Isometry3::identity(); 2]);
        let middle = center(&left.translation.vector.into(), &right.translation.vector.into());
        (middle, left.rotation * Vector3::z_axis())
    }

    /// Where the cameras come to look that shall look at `point` (root frame, m): there, or as near as the neck can.
    pub(crate) fn reached(&self, sample: &Sensed, point: &Point3<f64>) -> Unit<Vector3<f64>> {
        match self.turns() {
            true => self.eye(&self.facing(sample, point)).1,
            false => self.eye(&sample.position).1,
        }
    }

    /// Where the cameras are and where they look from there when the head is as at the start, with all other joints as in `sample`: a
    /// place in the root frame, m, and a unit vector.
    pub(crate) fn straight(&self, sample: &Sensed) -> (Point3<f64>, Unit<Vector3<f64>>) {
        let mut q = sample.position.clone();
        self.joints.iter().for_each(|&j| q[j] = self.model.start()[j]);
        self.eye(&q)
    }

    /// Turns towards `point` (root frame, m) for `dt` s, each joint with at most `speed` rad/s, as close as the
    /// neck can. Returns the remaining angle of the gaze, rad.
    pub(crate) fn look(
        &mut self,
        sample: &Sensed,
        dt: f64,
        point: &Point3<f64>,
        speed: f64,
    ) -> Result<f64, Failure> {
        let angle = self.gaze.angle(&self.model, &sample.position, point);
        let Some(lease) = &self.lease else { return Ok(angle) };
        let goal = match self.goal.take() {
            Some((goal, age)) if age + dt < RENEWAL => (goal, age + dt),
            _ => (self.facing(sample, point), 0.0),
        };
        let towards = |&j: &usize| (GAIN * (goal.0[j] - sample.position[j])).clamp(-speed, speed);
        let velocity: Vec<f64> = self.joints.iter().map(towards).collect();
        self.goal = Some(goal);
        lease.command(&velocity).map_err(failed)?;
        Ok(angle)
    }

    fn facing(&self, sample: &Sensed, point: &Point3<f64>) -> Vec<f64> {
        let solved = self.gaze.look_at(&self.model, &sample.position, point);
        solved.unwrap_or_else(|nearest| nearest.nearest)
    }
}
