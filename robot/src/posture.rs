//! placeholder
use std::sync::Arc;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::Model;

/// The orientation of a TCP (root from TCP) whose fingers point `yaw` rad to the left of forward, with the palm down and
/// the fingers' tips lowered by `pitch` rad.
#[must_use]
pub fn palm_down(yaw: f64, pitch: f64) -> UnitQuaternion<f64> {
    let level = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
    let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(level));
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
        * level
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch)
}

/// Torso and arm for wiping.
#[must_use]
pub fn wipe(model: &Arc<Model>) -> Vec<f64> {
    let mut q = model.zero();
    let values = [-0.2, 0.22, 0.35, 0.359, 0.017, -0.238, 0.622, -0.111, -0.159, 0.173];
    for (&j, v) in model.limb("torso").iter().chain(model.limb("right_arm")).zip(values) {
        q[j] = v;
    }
    q
}
