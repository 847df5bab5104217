//! The arms of the learning-control experiment: three joints in the shoulder (about y, x and z), one in the elbow
//! (about y), two links that hang down along -z when all angles are 0.

use nalgebra::{Isometry3, Matrix3x4, Rotation3, Translation3, UnitQuaternion, Vector3, Vector4, Vector6};

/// An arm, given by its shoulder and its links, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arm4 {
    pub(crate) shoulder: Vector3<f64>,
    pub(crate) links: [f64; 2],
}

impl Arm4 {
    /// The hand in the world for joint angles `q`, rad; its frame is the forearm's.
    pub(crate) fn hand(&self, q: &Vector4<f64>) -> Isometry3<f64> {
        let (rotations, _, hand) = self.chain(q);
        Isometry3::from_parts(Translation3::from(hand), UnitQuaternion::from_rotation_matrix(&rotations[3]))
    }

    /// Rotation after each joint, elbow and hand.
    fn chain(&self, q: &Vector4<f64>) -> ([Rotation3<f64>; 4], Vector3<f64>, Vector3<f64>) {
        let (x, y, z) = (Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis());
        let first = Rotation3::from_axis_angle(&y, q[0]);
        let second = first * Rotation3::from_axis_angle(&x, q[1]);
        let third = second * Rotation3::from_axis_angle(&z, q[2]);
        let fourth = third * Rotation3::from_axis_angle(&y, q[3]);
        let elbow = self.shoulder - third * (z.into_inner() * self.links[0]);
        let hand = elbow - fourth * (z.into_inner() * self.links[1]);
        ([first, second, third, fourth], elbow, hand)
    }

    /// Columns of the Jacobian of the hand in the world: linear part (m/rad), then angular part.
    pub(crate) fn jacobian(&self, q: &Vector4<f64>) -> [Vector6<f64>; 4] {
        let (rotations, elbow, hand) = self.chain(q);
        let [first, second, third, _] = rotations;
        let joints = [
            (Vector3::y(), self.shoulder),
            (first * Vector3::x(), self.shoulder),
            (second * Vector3::z(), self.shoulder),
            (third * Vector3::y(), elbow),
        ];
        joints.map(|(axis, at)| {
            let linear = axis.cross(&(hand - at));
            Vector6::new(linear.x, linear.y, linear.z, axis.x, axis.y, axis.z)
        })
    }

    /// Joint angles that move the hand to `x`, m, starting from `near` and attracted to `posture` in the null space;
    /// `None` where the arm does not reach.
    pub(crate) fn inverse(
        &self,
        x: Vector3<f64>,
        posture: Vector4<f64>,
        near: Vector4<f64>,
    ) -> Option<Vector4<f64>> {
        let mut q = near;
        for _ in 0..2000 {
            let columns = self.jacobian(&q).map(|c| Vector3::new(c[0], c[1], c[2]));
            let j = Matrix3x4::from_columns(&columns);
            let inverse = (j * j.transpose()).try_inverse()?;
            let away = posture - q;
            let missing = x - self.hand(&q).translation.vector;
            let step = away + j.transpose() * inverse * (missing - j * away);
            q += step * (0.2 / step.norm()).min(1.0);
            if step.norm() < 1e-12 {
                break;
            }
        }
        ((self.hand(&q).translation.vector - x).norm() < 1e-9).then_some(q)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: Arm4 = Arm4 { shoulder: Vector3::new(0.0, 0.2, 0.0), links: [0.3, 0.25] };

    #[test]
    fn the_jacobian_is_the_derivative() {
        let q = Vector4::new(-0.4, 0.2, 0.3, -1.1);
        for (i, column) in ARM.jacobian(&q).iter().enumerate() {
            let h = Vector4::ith(i, 1e-6);
            let (after, before) = (ARM.hand(&(q + h)), ARM.hand(&(q - h)));
            let linear = (after.translation.vector - before.translation.vector) / 2e-6;
            let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / 2e-6;
            assert!((linear - column.fixed_rows::<3>(0)).norm() < 1e-8);
            assert!((angular - column.fixed_rows::<3>(3)).norm() < 1e-8);
        }
        assert!(
            (ARM.hand(&Vector4::zeros()).translation.vector - Vector3::new(0.0, 0.2, -0.55)).norm() < 1e-12
        );
    }

    #[test]
    fn the_inverse_reaches_the_point_with_the_posture_nearest_to_the_one_asked_for() {
        let posture = Vector4::new(-0.6, -0.1, 0.3, -1.3);
        let x = Vector3::new(0.35, 0.15, -0.2);
        let q = ARM.inverse(x, posture, posture).unwrap();
        assert!((ARM.hand(&q).translation.vector - x).norm() < 1e-10);
        // At the optimum the remaining distance to the posture has no null-space part: it is J^T of some vector.
        let columns = ARM.jacobian(&q).map(|c| Vector3::new(c[0], c[1], c[2]));
        let j = Matrix3x4::from_columns(&columns);
        let left = posture - q;
        let in_rows = j.transpose() * (j * j.transpose()).try_inverse().unwrap() * j * left;
        assert!((left - in_rows).norm() < 1e-9);
        assert!(ARM.inverse(Vector3::new(1.0, 0.0, 0.0), posture, posture).is_none());
    }
}
