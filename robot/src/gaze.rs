//! Turning the head so that the cameras look at a point. The eyes stay parallel; it moves nothing itself.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::{IkError, Kinematics, LinkId, Model, RobotError};

/// What the gaze is made of: the two cameras (optical axis z) and the joints that turn them.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaze {
    /// The left camera's link; with its right one it defines the point between the eyes.
    pub left: LinkId,
    /// The right camera's link.
    pub right: LinkId,
    /// The joints to use.
    pub joints: Vec<usize>,
    /// The joint held at 0, so that the image stays level (neck roll), and the eyes.
    pub still: Vec<usize>,
}

const ITERATIONS: usize = 60;
const DAMPING: f64 = 0.02;
/// An axis this far from the point, rad, looks at it.
const TOLERANCE: f64 = 2e-3;

impl Gaze {
    /// ARMAR-III's gaze by the links `camera_left`, `camera_right` and the limb `head`.
    ///
    /// # Errors
    /// [`RobotError::Unknown`] when the robot has no such links.
    pub fn of(model: &Model) -> Result<Self, RobotError> {
        let (left, right) = (model.require_link("camera_left")?, model.require_link("camera_right")?);
        let shared = |j: &usize| model.moves(*j, left) && model.moves(*j, right);
        let rolls = |j: &usize| model.joints()[*j].name.contains("roll");
        let head = model.limb("head");
        let joints = head.iter().copied().filter(|j| shared(j) && !rolls(j)).collect();
        let still = head.iter().copied().filter(|j| !shared(j) || rolls(j)).collect();
        Ok(Self { left, right, joints, still })
    }

    /// All joints `q` with the head turned so that the point between the cameras looks at `point` (root frame, m).
    ///
    /// # Errors
    /// [`IkError`] with the angle that remains when the head cannot turn so far.
    pub fn look_at(&self, model: &Arc<Model>, q: &[f64], point: &Point3<f64>) -> Result<Vec<f64>, IkError> {
        let mut q = q.to_vec();
        q.resize(model.joints().len(), 0.0);
        self.still.iter().for_each(|&j| q[j] = 0.0);
        let mut kinematics = Kinematics::new(model);
        for _ in 0..ITERATIONS {
            kinematics.update(&q);
            let (axis, error) = self.error(&kinematics, point);
            if error.norm() < 0.1 * TOLERANCE || !error.iter().all(|e| e.is_finite()) {
                break;
            }
            let column = |j: usize| {
                let turn = *kinematics.axis(j);
                turn - axis * axis.dot(&turn)
            };
            let mut gram = Matrix3::identity() * (DAMPING * DAMPING);
            self.joints.iter().for_each(|&j| gram += column(j) * column(j).transpose());
            let Some(solved) = gram.cholesky().map(|c| c.solve(&error)) else { break };
            for &j in &self.joints {
                let joint = &model.joints()[j];
                q[j] = (q[j] + column(j).dot(&solved).clamp(-0.2, 0.2)).max(joint.lower).min(joint.upper);
            }
        }
        kinematics.update(&q);
        let angle = self.error(&kinematics, point).1.norm();
        if angle < TOLERANCE {
            return Ok(q);
        }
        let link = model.links()[self.left.index()].name.clone();
        Err(IkError { link, position_error_m: 0.0, orientation_error_rad: angle, nearest: q })
    }

    /// The optical axis, and the rotation vector that turns it towards the point.
    fn error(&self, kinematics: &Kinematics, point: &Point3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let (left, right): (&Isometry3<f64>, &Isometry3<f64>) =
            (kinematics.pose(self.left), kinematics.pose(self.right));
        let between = 0.5 * (left.translation.vector + right.translation.vector);
        let axis = left.rotation * Vector3::z();
        let there = (point.coords - between).normalize();
        let across = axis.cross(&there);
        let angle = across.norm().atan2(axis.dot(&there));
        (axis, across.try_normalize(1e-12).map_or_else(Vector3::zeros, |a| a * angle))
    }
}
