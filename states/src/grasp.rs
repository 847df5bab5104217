//! The geometry of a grasp from above with a level palm, shared by the skills that plan, servo and verify it.

use armarium_robot::postures::palm_down;
use nalgebra::{Isometry3, Point3, Vector3};

/// The nominal centre of a grasped object in the TCP frame: below the palm, between the pads, m.
pub(crate) const GRASP_IN_TCP: Vector3<f64> = Vector3::new(0.08, 0.0, 0.0);

/// Width of a finger pad across the closing direction, m.
pub(crate) const PAD_WIDTH: f64 = 0.05;

/// The TCP pose that grasps an object at `center` (root frame) with a level palm at the given yaw.
pub(crate) fn tcp_at(center: &Point3<f64>, yaw: f64) -> Isometry3<f64> {
    let rotation = palm_down(yaw, 0.0);
    Isometry3::from_parts((center.coords - rotation * GRASP_IN_TCP).into(), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_object_is_below_the_tcp() {
        let tcp = tcp_at(&Point3::new(0.3, 0.5, 0.97), 0.4);
        let center = tcp * Point3::from(GRASP_IN_TCP);
        assert!((center - Point3::new(0.3, 0.5, 0.97)).norm() < 1e-12);
        assert!((tcp.translation.z - 1.05).abs() < 1e-12);
    }
}
