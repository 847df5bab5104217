//! Conversions between nalgebra's types (used everywhere else) and glam's (used by Rapier).

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::math::{Matrix, Pose, Rotation, Vector};

pub(super) fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub(super) fn to_vector(v: Vector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

pub(super) fn rotation(q: &UnitQuaternion<f64>) -> Rotation {
    Rotation::from_xyzw(q.i, q.j, q.k, q.w)
}

pub(super) fn pose(p: &Isometry3<f64>) -> Pose {
    Pose::from_parts(vector(&p.translation.vector), rotation(&p.rotation))
}

pub(super) fn to_pose(p: &Pose) -> Isometry3<f64> {
    let q = p.rotation;
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(q.w, q.x, q.y, q.z));
    Isometry3::from_parts(Translation3::from(to_vector(p.translation)), rotation)
}

pub(super) fn to_matrix(m: &Matrix) -> Matrix3<f64> {
    Matrix3::from_columns(&[m.x_axis, m.y_axis, m.z_axis].map(to_vector))
}
