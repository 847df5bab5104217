//! The geometry of a grasp from above with a level palm, shared by the skills that plan, servo and verify it.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// The nominal centre of a grasped object in the TCP frame: below the palm, between the pads, m.
pub(crate) const GRASP_IN_TCP: Vector3<f64> = Vector3::new(0.08, 0.0, 0.0);

/// `root_from_tcp` rotation of a hand with its palm down and its fingers level, turned by `yaw` about the vertical;
/// at 0 they point forward (root y).
pub(crate) fn level_palm(yaw: f64) -> UnitQuaternion<f64> {
    let fingers = Vector3::new(-yaw.sin(), yaw.cos(), 0.0);
    let palm_normal = -Vector3::z();
    let lateral = fingers.cross(&palm_normal);
    let axes = Matrix3::from_columns(&[palm_normal, lateral, fingers]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

/// The TCP pose that grasps an object at `center` (root frame) with a level palm of that yaw.
pub(crate) fn tcp_at(center: &Point3<f64>, yaw: f64) -> Isometry3<f64> {
    let rotation = level_palm(yaw);
    Isometry3::from_parts((center.coords - rotation * GRASP_IN_TCP).into(), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_palm_looks_down_and_points_forward() {
        let palm = level_palm(0.0);
        assert!((palm * Vector3::x() + Vector3::z()).norm() < 1e-12, "the palm looks down");
        assert!((palm * Vector3::z() - Vector3::y()).norm() < 1e-12, "the fingers point forward");
        let turned = level_palm(0.5) * Vector3::z();
        assert!(turned.x < 0.0 && turned.y > 0.0, "a positive yaw turns the fingers to the left");
    }

    #[test]
    fn the_object_is_below_the_tcp() {
        let tcp = tcp_at(&Point3::new(0.3, 0.5, 0.97), 0.4);
        let center = tcp * Point3::from(GRASP_IN_TCP);
        assert!((center - Point3::new(0.3, 0.5, 0.97)).norm() < 1e-12);
        assert!((tcp.translation.z - 1.05).abs() < 1e-12);
    }
}
