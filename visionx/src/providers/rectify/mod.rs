//! Rectification: turns stereo pairs of cameras that are distorted, differ or are not quite parallel into the images of
//! two identical, parallel cameras without distortion. A table gives the source of each pixel.
//!
//! This module does not calibrate; [`CameraModel`] describes the cameras.

use std::sync::Arc;

use nalgebra::{Matrix3, Point2, Rotation3, UnitQuaternion, Vector3};

use crate::camera::{PinholeCamera, StereoCalibration};
use crate::frame::{DepthImage, RgbImage, StereoFrame};
use crate::mask::Region;
use crate::providers::{CameraModel, NotStereo};

/// Marks a pixel without a source.
const NOTHING: u32 = u32::MAX;
/// Cosine of the largest angle, 45 degrees, between a camera and the pair's common direction.
const MIN_COSINE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// The rectification of a pair of cameras.
///
/// # Source
/// A. Fusiello, E. Trucco, A. Verri, A compact algorithm for rectification of stereo pairs, Machine Vision and
/// Applications 12 (2000); differs in: the old axis that the new one keeps close to is the mean of both cameras', and
/// the principal point is chosen so that the images' centres stay in the centre.
#[derive(Clone, Debug)]
pub struct Rectification {
    calibration: StereoCalibration,
    /// Rotation from the rectified left camera's axes to the real left camera's; both have the same origin.
    left_from_rectified: UnitQuaternion<f64>,
    eyes: [Vec<SourcePixel>; 2],
}

/// The source of a pixel.
#[derive(Clone, Copy, Debug)]
struct SourcePixel {
    /// The upper left of the four source pixels; [`NOTHING`] outside of the image.
    at: u32,
    /// Interpolation weights of the next column and row, of 256.
    part: [u16; 2],
    /// Depth in the rectified camera over depth in the old one.
    depth: f32,
}

impl Rectification {
    /// The rectification of two cameras whose images are `width` x `height` px.
    ///
    /// # Errors
    /// Why they are not a pair.
    pub fn new(
        left: &CameraModel,
        right: &CameraModel,
        (width, height): (u32, u32),
    ) -> Result<Self, NotStereo> {
        if width < 2 || height < 2 || width.max(height) > 1 << 15 {
            return Err(NotStereo::Size { width, height });
        }
        let reference_from_rectified = axes(left, right)?;
        let turned =
            [left, right].map(|eye| eye.reference_from_camera.rotation.inverse() * reference_from_rectified);
        let focal = [left, right].iter().map(|eye| eye.focal[0] + eye.focal[1]).sum::<f64>() / 4.0;
        let middle = Point2::new(f64::from(width - 1), f64::from(height - 1)) / 2.0;
        let mut center = Vector3::zeros();
        for (eye, camera_from_rectified) in [left, right].into_iter().zip(&turned) {
            let ray = camera_from_rectified.inverse() * ray_of(eye, &middle)?;
            center += Vector3::new(middle.x, middle.y, 0.0) / 2.0 - ray * (focal / ray.z / 2.0);
        }
        let camera = PinholeCamera { width, height, focal, center: [center.x, center.y] };
        let baseline = (right.reference_from_camera.translation.vector
            - left.reference_from_camera.translation.vector)
            .norm();
        let eyes = [table(left, &turned[0], &camera), table(right, &turned[1], &camera)];
        let calibration = StereoCalibration { camera, baseline };
        Ok(Self { calibration, left_from_rectified: turned[0], eyes })
    }

    /// The calibration of the rectified pair.
    pub fn calibration(&self) -> StereoCalibration {
        self.calibration
    }

    /// Rectifies the frame; black where the cameras saw nothing. `None` when an image has another size. A depth image
    /// whose size is not the left image's is left out.
    pub fn rectify(&self, frame: &StereoFrame) -> Option<StereoFrame> {
        let [left, right] = &self.eyes;
        Some(StereoFrame {
            stamp_ns: frame.stamp_ns,
            left: self.image(&frame.left, left)?.into(),
            right: self.image(&frame.right, right)?.into(),
            depth: frame.depth.as_ref().and_then(|depth| self.depth(depth)).map(Arc::new),
            root_from_left: frame.root_from_left * self.left_from_rectified,
        })
    }

    /// Bilinear interpolation.
    fn image(&self, image: &RgbImage, sources: &[SourcePixel]) -> Option<RgbImage> {
        let PinholeCamera { width, height, .. } = self.calibration.camera;
        if (image.width(), image.height()) != (width, height) {
            return None;
        }
        let (old, row) = (image.data(), width as usize * 3);
        let mut data = vec![0; old.len()];
        for (pixel, source) in data.chunks_exact_mut(3).zip(sources) {
            let at = source.at as usize * 3;
            // Each row needs two adjacent pixels. [`NOTHING`] has none and stays black.
            let (Some(upper), Some(lower)) = (old.get(at..at + 6), old.get(at + row..at + row + 6)) else {
                continue;
            };
            let [x, y] = source.part.map(u32::from);
            let weights = [(256 - x) * (256 - y), x * (256 - y), (256 - x) * y, x * y];
            for (c, value) in pixel.iter_mut().enumerate() {
                let four = [upper[c], upper[c + 3], lower[c], lower[c + 3]];
                let sum: u32 = four.iter().zip(weights).map(|(v, weight)| u32::from(*v) * weight).sum();
                // Divides by 65536 with rounding.
                *value = ((sum + (1 << 15)) >> 16) as u8;
            }
        }
        RgbImage::from_rgb(width, height, data).ok()
    }

    /// Uses the nearest pixel: the mean of two depths may lie on neither surface.
    fn depth(&self, depth: &DepthImage) -> Option<DepthImage> {
        let PinholeCamera { width, height, .. } = self.calibration.camera;
        if (depth.width, depth.height) != (width, height) || depth.data.len() != self.eyes[0].len() {
            return None;
        }
        let nearest = |source: &SourcePixel| {
            if source.at == NOTHING {
                return 0.0;
            }
            let [right, down] = source.part.map(|part| usize::from(part >= 128));
            depth.data[source.at as usize + right + down * width as usize] * source.depth
        };
        Some(DepthImage { width, height, data: self.eyes[0].iter().map(nearest).collect() })
    }
}

/// The common axes of the rectified pair: x along the baseline, z close to both viewing directions.
fn axes(left: &CameraModel, right: &CameraModel) -> Result<UnitQuaternion<f64>, NotStereo> {
    let poses = [left, right].map(|eye| eye.reference_from_camera);
    let forward = poses.iter().map(|pose| pose.rotation * Vector3::z()).sum::<Vector3<f64>>();
    let x = (poses[1].translation.vector - poses[0].translation.vector)
        .try_normalize(1e-6)
        .ok_or(NotStereo::NotBeside)?;
    let y = forward.cross(&x).try_normalize(1e-6).ok_or(NotStereo::NotBeside)?;
    let z = x.cross(&y);
    let close = |pose: &nalgebra::Isometry3<f64>| {
        let [right, ahead] = [Vector3::x(), Vector3::z()].map(|axis| pose.rotation * axis);
        right.dot(&x) > MIN_COSINE && ahead.dot(&z) > MIN_COSINE
    };
    if !poses.iter().all(close) {
        return Err(NotStereo::NotBeside);
    }
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    Ok(UnitQuaternion::from_rotation_matrix(&rotation))
}

/// The ray, in the camera's axes, of the pixel `px`.
fn ray_of(camera: &CameraModel, px: &Point2<f64>) -> Result<Vector3<f64>, NotStereo> {
    let [fx, fy] = camera.focal;
    let seen = Point2::new((px.x - camera.center[0]) / fx, (px.y - camera.center[1]) / fy);
    let ideal = camera.distortion.undistort(&seen);
    ideal.map(|p| p.coords.push(1.0)).ok_or(NotStereo::Distortion)
}

/// The source of each pixel of the rectified camera.
fn table(
    eye: &CameraModel,
    camera_from_rectified: &UnitQuaternion<f64>,
    ideal: &PinholeCamera,
) -> Vec<SourcePixel> {
    let reach = reach(eye);
    let last = [f64::from(ideal.width - 1), f64::from(ideal.height - 1)];
    let source = |x: u32, y: u32| -> Option<SourcePixel> {
        let ray = camera_from_rectified * ideal.ray(&Point2::new(f64::from(x), f64::from(y)));
        let plane = Point2::new(ray.x / ray.z, ray.y / ray.z);
        if ray.z <= 1e-6 || plane.coords.norm() >= reach {
            return None;
        }
        let seen = eye.distortion.distort(&plane);
        let px = [eye.center[0] + eye.focal[0] * seen.x, eye.center[1] + eye.focal[1] * seen.y];
        if !px.iter().zip(last).all(|(p, last)| (0.0..=last).contains(p)) {
            return None;
        }
        // The last column and row take the pixels before them, with full weight.
        let corner = [0, 1].map(|i| px[i].floor().min(last[i] - 1.0));
        let part = [0, 1].map(|i| ((px[i] - corner[i]) * 256.0).round() as u16);
        let at = corner[1] as u32 * ideal.width + corner[0] as u32;
        Some(SourcePixel { at, part, depth: (1.0 / ray.z) as f32 })
    };
    let nothing = SourcePixel { at: NOTHING, part: [0; 2], depth: 0.0 };
    let pixels = Region::whole(ideal.width, ideal.height).pixels();
    pixels.map(|(x, y)| source(x, y).unwrap_or(nothing)).collect()
}

/// The largest radius, at depth 1, up to which the radial model increases. Beyond, it would fold the image back.
fn reach(eye: &CameraModel) -> f64 {
    let d = &eye.distortion;
    let slope = |r: f64| 1.0 + r * r * (3.0 * d.k1 + r * r * (5.0 * d.k2 + r * r * 7.0 * d.k3));
    let steps = (0..1000u32).map(|i| f64::from(i) * 0.005);
    steps.take_while(|r| slope(*r) > 0.0).last().unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
