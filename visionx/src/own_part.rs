//! The parts of the robot's own body, of which pictures say nothing: boxes in the root frame.

use armarium_values::distance_from_box;
use nalgebra::{Isometry3, Point3, Vector3};

/// A box that a part of the own body fills.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OwnPart {
    /// Pose of its middle in the root frame.
    pub root_from_box: Isometry3<f64>,
    /// Its edges, m.
    pub size: Vector3<f64>,
}

impl OwnPart {
    pub(crate) fn middle(&self) -> Point3<f64> {
        self.root_from_box.translation.vector.into()
    }

    /// The point of it that is nearest to another one; root frame.
    pub(crate) fn nearest(&self, point: &Point3<f64>) -> Point3<f64> {
        let half = self.size / 2.0;
        let inside = self.root_from_box.inverse_transform_point(point).coords;
        self.root_from_box * Point3::from(inside.zip_map(&half, |at, half| at.clamp(-half, half)))
    }

    /// The distance of a point (root frame) from it, m; 0 inside.
    #[must_use]
    pub fn distance(&self, point: &Point3<f64>) -> f64 {
        distance_from_box(point, &self.root_from_box, &self.size)
    }
}
