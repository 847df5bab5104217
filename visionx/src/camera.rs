//! Camera models. Camera frame: z along the optical axis, x to the right, y down (OpenCV, REP 103 `_optical`).

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::frame::{DepthImage, StereoFrame};

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

/// Two identical, parallel cameras: the right camera stands `baseline` m along the left camera's x.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StereoCalibration {
    /// Intrinsics of each eye.
    pub camera: PinholeCamera,
    /// Distance between the cameras, m.
    pub baseline: f64,
}

impl PinholeCamera {
    /// Half the angles that its pictures hold across and up, rad.
    pub fn half_angles(&self) -> [f64; 2] {
        [self.width, self.height].map(|side| libm::atan(0.5 * f64::from(side) / self.focal))
    }

    /// Half the angle of the cone about the optical axis that its pictures hold whole, rad.
    pub fn cone(&self) -> f64 {
        let [across, up] = self.half_angles();
        across.min(up)
    }

    /// Projects a point (camera frame, m) to px; `None` for a point behind the camera or in its plane.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        let px = |axis: usize| self.center[axis] + self.focal * point[axis] / point.z;
        (point.z > 1e-6).then(|| Point2::new(px(0), px(1)))
    }

    /// Projects the point (this camera's frame, m) into an identical camera that stands `shift` m along this
    /// one's x.
    pub fn project_shifted(&self, point: &Point3<f64>, shift: f64) -> Option<Point2<f64>> {
        self.project(&Point3::new(point.x - shift, point.y, point.z))
    }

    /// A depth image, if it is whole and of this camera.
    pub(crate) fn usable<'d>(&self, depth: &'d DepthImage) -> Option<&'d DepthImage> {
        let fits = (depth.width, depth.height) == (self.width, self.height);
        (fits && depth.data.len() == self.width as usize * self.height as usize).then_some(depth)
    }

    /// The direction of a pixel's ray, scaled so that its z is 1.
    pub fn ray(&self, px: &Point2<f64>) -> Vector3<f64> {
        Vector3::new((px.x - self.center[0]) / self.focal, (px.y - self.center[1]) / self.focal, 1.0)
    }
}

impl StereoCalibration {
    /// Whether both images have the calibration's size and the calibration's numbers describe a valid camera.
    pub fn fits(&self, frame: &StereoFrame) -> bool {
        let size = (self.camera.width, self.camera.height);
        let usable = self.camera.focal > 0.0 && self.baseline > 0.0;
        usable && [&frame.left, &frame.right].iter().all(|i| (i.width(), i.height()) == size)
    }

    /// Covariance (left camera frame, m^2) of a triangulated point whose two pixels have standard deviations
    /// `sigma_px` (left, right), px, the same along x and y. First order, for a point in front of the camera.
    pub fn covariance(&self, point: &Point3<f64>, sigma_px: [f64; 2]) -> Matrix3<f64> {
        let scale = point.z / self.camera.focal;
        let [l, r] = sigma_px.map(|s| s * s);
        // With disparity d: x = (u - c) b / d, y = (v - c) b / d, z = f b / d, so that dp/dd = -p z / (f b).
        let by_disparity = point.coords * (-point.z / (self.camera.focal * self.baseline));
        let by_left = Vector3::new(scale, 0.0, 0.0) + by_disparity;
        let by_row = Vector3::new(0.0, scale, 0.0);
        by_left * by_left.transpose() * l
            + by_disparity * by_disparity.transpose() * r
            + by_row * by_row.transpose() * ((l + r) / 4.0)
    }

    /// The point (left camera frame, m) seen at `left` and `right`, px; `None` without positive disparity.
    pub fn triangulate(&self, left: &Point2<f64>, right: &Point2<f64>) -> Option<Point3<f64>> {
        let disparity = left.x - right.x;
        (disparity > 0.1).then(|| {
            let PinholeCamera { focal, center: [cx, cy], .. } = self.camera;
            let z = focal * self.baseline / disparity;
            let y = (left.y + right.y) / 2.0;
            Point3::new((left.x - cx) * z / focal, (y - cy) * z / focal, z)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CALIBRATION: StereoCalibration = StereoCalibration {
        camera: PinholeCamera { width: 640, height: 480, focal: 515.0, center: [320.0, 240.0] },
        baseline: 0.093,
    };

    #[test]
    fn triangulation_undoes_projection() {
        let point = Point3::new(0.12, -0.07, 0.9);
        let left = CALIBRATION.camera.project(&point).unwrap();
        let right = CALIBRATION.camera.project_shifted(&point, CALIBRATION.baseline).unwrap();
        assert!((CALIBRATION.triangulate(&left, &right).unwrap() - point).norm() < 1e-12);
        assert!((CALIBRATION.camera.ray(&left) * 0.9 - point.coords).norm() < 1e-12);
    }

    #[test]
    fn covariance_agrees_with_finite_differences() {
        let point = Point3::new(0.12, -0.07, 0.9);
        let left = CALIBRATION.camera.project(&point).unwrap();
        let right = CALIBRATION.camera.project_shifted(&point, CALIBRATION.baseline).unwrap();
        let (h, sigma) = (1e-4, [0.2, 0.5]);
        let mut expected = Matrix3::zeros();
        for (dx, dy) in [(h, 0.0), (0.0, h)] {
            for (eye, s) in sigma.iter().enumerate() {
                let d = nalgebra::Vector2::new(dx, dy);
                let moved = if eye == 0 { (left + d, right) } else { (left, right + d) };
                let j = (CALIBRATION.triangulate(&moved.0, &moved.1).unwrap() - point) / h;
                expected += j * j.transpose() * (s * s);
            }
        }
        assert!((CALIBRATION.covariance(&point, sigma) - expected).amax() < 1e-3 * expected.amax());
    }
}
