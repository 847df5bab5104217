//! Both arms of ARMAR-III: their inverse kinematics near a posture, and the joint motions of the box task.

use std::sync::Arc;

use armarium_robot::description::default_robot;
use armarium_robot::{Kinematics, Limb, LinkId, Model, pose_error};
use nalgebra::{
    Isometry3, Matrix3, Matrix6, Point3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6,
};

use super::error::ExperimentError;

/// Joints of an arm.
pub(super) const JOINTS: usize = 7;
/// Angles or speeds of an arm's joints, rad or rad/s.
pub(super) type Joints = SVector<f64, JOINTS>;

/// The right arm with its hand level in front of the body, fingers forward, palm towards the middle.
const POSTURE: [f64; JOINTS] = [0.203, -0.021, 0.044, 0.315, -0.217, 0.114, 0.094];
/// Signs by which the left arm's joints mirror it.
const MIRROR: [f64; JOINTS] = [1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0];

/// The right and the left arm; the rest of the robot stands still.
pub(super) struct Arms {
    kinematics: Kinematics,
    tcps: [LinkId; 2],
    joints: [[usize; JOINTS]; 2],
}

impl Arms {
    pub(super) fn new() -> Result<Self, ExperimentError> {
        let failed = |what: String| ExperimentError::Failed(what);
        let model =
            Model::shipped(default_robot()).map_err(|wrong| failed(format!("{:?}", wrong.first())))?;
        let missing = || ExperimentError::Failed("the robot lacks two arms of seven joints".into());
        let arms: Vec<&Limb> = model.arms().take(2).collect();
        let limb = |side: usize| {
            let limb = arms.get(side).ok_or_else(missing)?;
            let joints: [usize; JOINTS] = limb.joints.as_slice().try_into().map_err(|_| missing())?;
            Ok::<_, ExperimentError>((limb.tcp.ok_or_else(missing)?, joints))
        };
        let (right, left) = (limb(0)?, limb(1)?);
        let kinematics = Kinematics::new(&model);
        Ok(Self { kinematics, tcps: [right.0, left.0], joints: [right.1, left.1] })
    }

    pub(super) fn model(&self) -> &Arc<Model> {
        self.kinematics.model()
    }

    /// All joints of the robot, or their speeds: the arms' at `q`, all others 0.
    pub(super) fn all(&self, q: &[Joints; 2]) -> Vec<f64> {
        let mut all = vec![0.0; self.model().joints().len()];
        self.write(q, &mut all);
        all
    }

    /// Writes both arms' joints to their places in `all`.
    pub(super) fn write(&self, q: &[Joints; 2], all: &mut [f64]) {
        for (joints, q) in self.joints.iter().zip(q) {
            joints.iter().zip(q.iter()).for_each(|(j, q)| all[*j] = *q);
        }
    }

    /// The joints of one arm, from `all`.
    pub(super) fn of(&self, side: usize, all: &[f64]) -> Joints {
        Joints::from_fn(|i, _| all[self.joints[side][i]])
    }

    /// Sets the estimated positions of all joints.
    pub(super) fn update(&mut self, all: &[f64]) {
        self.kinematics.update(all);
    }

    /// Orientation of one arm's hand, after [`update`](Self::update).
    pub(super) fn rotation(&self, side: usize) -> UnitQuaternion<f64> {
        self.kinematics.pose(self.tcps[side]).rotation
    }

    /// Columns of the Jacobian of one TCP (m/rad, then rad/rad, root frame) after [`update`](Self::update).
    pub(super) fn columns(&self, side: usize) -> [Vector6<f64>; JOINTS] {
        let tcp = self.tcps[side];
        let at = Point3::from(self.kinematics.pose(tcp).translation.vector);
        self.joints[side].map(|j| {
            let twist = self.kinematics.column(j, tcp, &at);
            let (l, a) = (twist.linear, twist.angular);
            Vector6::new(l.x, l.y, l.z, a.x, a.y, a.z)
        })
    }

    /// The posture near which an arm stays.
    pub(super) fn posture(side: usize) -> Joints {
        let mirror = |i: usize| if side == 0 { 1.0 } else { MIRROR[i] };
        Joints::from_fn(|i, _| mirror(i) * POSTURE[i])
    }

    /// The joint angles nearest to the posture that move the TCP of one arm to `x` (root frame, m), with the hand level
    /// and its fingers forward; `near` is the start of the search.
    pub(super) fn inverse(
        &mut self,
        side: usize,
        x: Vector3<f64>,
        near: &Joints,
    ) -> Result<Joints, ExperimentError> {
        let level = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(level));
        let target = Isometry3::from_parts(x.into(), rotation);
        let posture = Self::posture(side);
        let mut all = self.all(&[Self::posture(0), Self::posture(1)]);
        let mut q = *near;
        let mut apart = f64::INFINITY;
        for _ in 0..200 {
            self.joints[side].iter().zip(q.iter()).for_each(|(j, q)| all[*j] = *q);
            self.update(&all);
            let error = pose_error(self.kinematics.pose(self.tcps[side]), &target);
            let (l, a) = (error.linear, error.angular);
            let error = Vector6::new(l.x, l.y, l.z, a.x, a.y, a.z);
            apart = error.norm();
            let jacobian = SMatrix::<f64, 6, JOINTS>::from_columns(&self.columns(side));
            let square = jacobian * jacobian.transpose() + Matrix6::identity() * 1e-12;
            let Some(inverse) = square.try_inverse() else { break };
            let away = posture - q;
            let step = away + jacobian.transpose() * (inverse * (error - jacobian * away));
            q += step * (0.3 / step.norm()).min(1.0);
            if step.norm() < 1e-12 {
                break;
            }
        }
        if apart < 1e-6 && self.margin(side, &q) > 0.0 {
            return Ok(q);
        }
        let what = ["right", "left"][side];
        Err(ExperimentError::Failed(format!(
            "the {what} arm does not reach ({:.3}, {:.3}, {:.3}) m with a level hand",
            x.x, x.y, x.z
        )))
    }

    /// The smallest distance of a joint from its limit, rad; negative beyond the limit.
    pub(super) fn margin(&self, side: usize, q: &Joints) -> f64 {
        let joints = self.joints[side].iter().zip(q.iter());
        let margin = |(j, q): (&usize, &f64)| {
            let joint = &self.model().joints()[*j];
            (q - joint.lower).min(joint.upper - q)
        };
        joints.map(margin).fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arms_mirror_each_other() {
        let mut arms = Arms::new().unwrap();
        for z in [1.02, 1.1, 1.18] {
            let q = [1.0, -1.0].map(|s| Vector3::new(0.29 * s, 0.45, z));
            let right = arms.inverse(0, q[0], &Arms::posture(0)).unwrap();
            let left = arms.inverse(1, q[1], &Arms::posture(1)).unwrap();
            for i in 0..JOINTS {
                assert!((left[i] - MIRROR[i] * right[i]).abs() < 1e-6, "{z} {i}");
            }
        }
        assert!(arms.inverse(0, Vector3::new(0.29, 1.5, 1.0), &Arms::posture(0)).is_err());
    }
}
