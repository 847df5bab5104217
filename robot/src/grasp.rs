//! Orientations of a hand. Where it grasps is part of its description, so they hold for any hand.

use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};

use crate::Hand;

impl Hand {
    /// The orientation of the TCP (root from TCP) that grasps from straight above: the approach points down, and the
    /// axis across approach and closing direction points `yaw` rad to the left of forward.
    pub fn palm_down(&self, yaw: f64) -> UnitQuaternion<f64> {
        let level = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0);
        let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(level));
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
            * level
            * self.grasp_in_tcp.rotation.inverse()
    }

    /// The outward normal of a surface from which this orientation of the TCP (root from TCP) grasps straight: against the
    /// approach.
    pub fn grasps_from(&self, root_from_tcp: &UnitQuaternion<f64>) -> Unit<Vector3<f64>> {
        Unit::new_normalize(-(root_from_tcp * (self.grasp_in_tcp.rotation * Vector3::x())))
    }
}
