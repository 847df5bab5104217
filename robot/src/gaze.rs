//! Turns the head so that the cameras look at a point, with a horizon as level as the neck allows. The cameras stay
//! parallel. This module computes joint positions and does not command the robot.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};

use crate::{IkError, Kinematics, LinkId, Model, RobotError, StereoCamera};

/// The parts of the gaze: the two cameras (optical axis z, image's right x) and the joints that turn them.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaze {
    left: LinkId,
    right: LinkId,
    joints: Vec<usize>,
    eyes: Vec<usize>,
}

const ITERATIONS: usize = 100;
const DAMPING: f64 = 0.02;
/// Weight of a level horizon relative to the direction.
const LEVEL: f64 = 0.2;
/// The gaze is on the point when the angle between the axis and the point is less than this, rad.
const TOLERANCE: f64 = 2e-3;
/// Largest change of a joint in one iteration, rad.
const MAX_CHANGE: f64 = 0.2;

impl Gaze {
    /// Uses the robot's stereo cameras and the limb that turns them. Joints that turn only one camera are eye joints.
    ///
    /// # Errors
    /// [`RobotError::NoCamera`] when the robot has no cameras.
    pub fn of(model: &Model) -> Result<Self, RobotError> {
        let &StereoCamera { left, right, ref on, .. } = model.camera().ok_or(RobotError::NoCamera)?;
        let head = on.as_deref().map_or(&[][..], |on| model.limb(on)).iter().copied();
        let (joints, eyes) = head.partition(|&j| model.moves(j, left) && model.moves(j, right));
        Ok(Self { left, right, joints, eyes })
    }

    /// All joints `q`, with the head turned so that the point between the cameras looks at `point` (root frame, m).
    ///
    /// # Errors
    /// [`IkError`] with the remaining angle if the head cannot turn that far.
    pub fn look_at(&self, model: &Arc<Model>, q: &[f64], point: &Point3<f64>) -> Result<Vec<f64>, IkError> {
        let mut q = q.to_vec();
        q.resize(model.joints().len(), 0.0);
        self.eyes.iter().for_each(|&j| q[j] = 0.0);
        let mut kinematics = Kinematics::new(model);
        for level in [true, false] {
            // Where the neck cannot reach both, the direction has priority over the horizon.
            for _ in 0..ITERATIONS {
                kinematics.update(&q);
                if !self.improve(&kinematics, &mut q, point, level) {
                    break;
                }
            }
        }
        let angle = self.angle(model, &q, point);
        if angle < TOLERANCE {
            return Ok(q);
        }
        let link = model.links()[self.left.index()].name.clone();
        Err(IkError { link, position_error_m: 0.0, orientation_error_rad: angle, nearest: q })
    }

    /// The angle between the gaze and the point (root frame, m), with all joints at `q`, rad.
    pub fn angle(&self, model: &Arc<Model>, q: &[f64], point: &Point3<f64>) -> f64 {
        let mut kinematics = Kinematics::new(model);
        kinematics.update(q);
        self.off(&kinematics, point).norm()
    }

    /// The rotation vector that turns the optical axis towards the point, rad.
    fn off(&self, kinematics: &Kinematics, point: &Point3<f64>) -> Vector3<f64> {
        let (left, right) = (kinematics.pose(self.left), kinematics.pose(self.right));
        let between = 0.5 * (left.translation.vector + right.translation.vector);
        let axis = left.rotation * Vector3::z();
        let there = point.coords - between;
        let across = axis.cross(&there);
        let angle = libm::atan2(across.norm(), axis.dot(&there));
        across.try_normalize(1e-12).map_or_else(Vector3::zeros, |turn| turn * angle)
    }

    /// One damped step. A joint at its limit leaves the rotation to the others. Returns whether there was anything
    /// to improve.
    fn improve(&self, kinematics: &Kinematics, q: &mut [f64], point: &Point3<f64>, level: bool) -> bool {
        let left = kinematics.pose(self.left).rotation;
        let (axis, side) = (left * Vector3::z(), left * Vector3::x());
        // A rotation by r about the optical axis lifts the image's right axis by r times the z of `axis x side`.
        let weight = if level { LEVEL } else { 0.0 };
        let roll = -weight * side.z * axis.cross(&side).z.signum();
        let error = self.off(kinematics, point) + axis * roll;
        if error.norm() < 0.01 * TOLERANCE || !error.iter().all(|e| e.is_finite()) {
            return false;
        }
        let column = |j: usize| {
            let turn = *kinematics.axis(j);
            let along = axis * axis.dot(&turn);
            turn - along + weight * along
        };
        let joints = kinematics.model().joints();
        let mut free = self.joints.clone();
        while !free.is_empty() {
            let mut gram = Matrix3::identity() * (DAMPING * DAMPING);
            free.iter().for_each(|&j| gram += column(j) * column(j).transpose());
            let Some(solved) = gram.cholesky().map(|c| c.solve(&error)) else { return false };
            let out = free.iter().position(|&j| {
                let change = column(j).dot(&solved);
                (q[j] <= joints[j].lower && change < 0.0) || (q[j] >= joints[j].upper && change > 0.0)
            });
            if let Some(out) = out {
                free.swap_remove(out);
                continue;
            }
            for &j in &free {
                let change = column(j).dot(&solved).clamp(-MAX_CHANGE, MAX_CHANGE);
                q[j] = (q[j] + change).max(joints[j].lower).min(joints[j].upper);
            }
            return true;
        }
        false
    }
}
