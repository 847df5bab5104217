//! Camera models. Camera frame: z along the optical axis, x to the right, y down (OpenCV, REP 103 `_optical`).

use nalgebra::{Point2, Point3};
use serde::{Deserialize, Serialize};

/// An ideal pinhole camera without distortion. Pixel centres are at whole coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PinholeCamera {
    /// Width of the image, px.
    pub width: u32,
    /// Height of the image, px.
    pub height: u32,
    /// Focal length, px.
    pub focal: f64,
    /// Principal point, px.
    pub center: [f64; 2],
}

/// Two equal, parallel cameras: the right eye is `baseline` m along the left camera's x.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StereoCalibration {
    /// Intrinsics of each eye.
    pub camera: PinholeCamera,
    /// Distance of the eyes, m.
    pub baseline: f64,
}

impl PinholeCamera {
    /// Where a point (camera frame, m) appears, px; `None` behind or in the plane of the camera.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        (point.z > 1e-6).then(|| {
            Point2::new(
                self.center[0] + self.focal * point.x / point.z,
                self.center[1] + self.focal * point.y / point.z,
            )
        })
    }
}

impl StereoCalibration {
    /// The point (left camera frame, m) seen at `left` and `right`, px; `None` without positive disparity.
    #[must_use]
    pub fn triangulate(&self, left: &Point2<f64>, right: &Point2<f64>) -> Option<Point3<f64>> {
        let disparity = left.x - right.x;
        (disparity > 0.1).then(|| {
            let z = self.camera.focal * self.baseline / disparity;
            let y = (left.y + right.y) / 2.0;
            Point3::new(
                (left.x - self.camera.center[0]) * z / self.camera.focal,
                (y - self.camera.center[1]) * z / self.camera.focal,
                z,
            )
        })
    }
}
