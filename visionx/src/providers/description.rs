//! The description of a provider: its images and the calibration of its cameras.

use armarium_source::form;
use nalgebra::{Isometry3, Point2, Point3};
use serde::{Deserialize, Serialize};

use super::frame::{PixelFormat, RawImage};
use crate::camera::{PinholeCamera, StereoCalibration};

/// Describes a provider.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProviderDescription {
    /// The provider's name.
    pub name: String,
    /// A description for people.
    pub about: String,
    /// Name of the coordinate frame of the first camera.
    pub frame_id: String,
    /// Maximum frame rate, Hz; `None` when unknown.
    pub rate_hz: Option<f64>,
    /// Its images, in the order of the frames. Sizes may change at run time; each frame carries its own.
    pub images: Vec<ImageDescription>,
}

/// One image of a provider's frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageDescription {
    /// Its role, such as `left` or `depth`.
    pub role: String,
    /// The pixel format.
    pub format: PixelFormat,
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// The camera that took it; `None` when unknown.
    pub camera: Option<CameraModel>,
}

/// A camera: a pinhole with lens distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraModel {
    /// Focal lengths along x and y, px.
    pub focal: [f64; 2],
    /// Principal point, px.
    pub center: [f64; 2],
    /// Radial k1, k2, k3 and tangential p1, p2 of Brown and Conrady's model; all 0 without distortion.
    pub distortion: Distortion,
    /// The camera's pose in the provider's coordinate frame.
    pub reference_from_camera: Isometry3<f64>,
}

form! {
    /// Brown and Conrady's distortion, as OpenCV's `plumb_bob`.
    ///
    /// # Source
    /// D. C. Brown, Decentering distortion of lenses, Photogrammetric Engineering 32 (1966).
    #[derive(Copy, Deserialize)]
    pub struct Distortion: "a distortion" {
        /// Radial.
        pub k1: f64;
        /// Radial.
        pub k2: f64;
        /// Tangential.
        pub p1: f64;
        /// Tangential.
        pub p2: f64;
        /// Radial.
        pub k3: f64;
    }
}

/// Why a provider's images are not a stereo pair.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NotStereo {
    /// An eye is missing.
    #[error("there is no image `{0}`")]
    NoImage(&'static str),
    /// An eye's camera is unknown.
    #[error("the camera of `{0}` is not calibrated")]
    NotCalibrated(&'static str),
    /// An eye's calibration has numbers that no camera has.
    #[error("the calibration of `{0}` is not one of a camera")]
    NoCamera(&'static str),
    /// The eyes' images differ in size.
    #[error("the images `left` and `right` are not of one size")]
    Sizes,
    /// An eye's lens distorts.
    #[error("`{0}` is distorted")]
    Distorted(&'static str),
    /// The cameras differ.
    #[error("the two cameras are not equal")]
    Differ,
    /// Pixels are wider than high, or higher than wide.
    #[error("the pixels are not square")]
    PixelsNotSquare,
    /// The cameras do not stand side by side.
    #[error("the right camera does not stand to the right of the left one, parallel to it")]
    NotParallel,
    /// The cameras stand too far from side by side to be rectified.
    #[error("the right camera does not stand to the right of the left one, looking the same way")]
    NotBeside,
    /// Images that are too small or too large to be rectified.
    #[error("images of {width} x {height} pixels are not rectified")]
    Size {
        /// Width, px.
        width: u32,
        /// Height, px.
        height: u32,
    },
    /// The distortion model has no inverse in the image's middle.
    #[error("the distortion is beyond what its model can be")]
    Distortion,
}

impl Distortion {
    /// Distorts an ideal point of the image plane (at depth 1).
    pub fn distort(&self, ideal: &Point2<f64>) -> Point2<f64> {
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Point2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// The ideal point that appears at `seen`, by fixed-point iteration; `None` where the model does not converge, far
    /// outside of the calibrated area.
    pub fn undistort(&self, seen: &Point2<f64>) -> Option<Point2<f64>> {
        let mut ideal = *seen;
        for _ in 0..50 {
            let error = seen - self.distort(&ideal);
            ideal += error;
            if !ideal.coords.iter().all(|v| v.is_finite()) {
                return None;
            }
            if error.norm() < 1e-12 {
                return Some(ideal);
            }
        }
        ((self.distort(&ideal) - seen).norm() < 1e-9).then_some(ideal)
    }
}

impl CameraModel {
    /// A pinhole camera at the provider's coordinate frame, shifted by `shift` m along x.
    pub fn ideal(camera: &PinholeCamera, shift: f64) -> Self {
        Self {
            focal: [camera.focal; 2],
            center: camera.center,
            distortion: Distortion::default(),
            reference_from_camera: Isometry3::translation(shift, 0.0, 0.0),
        }
    }

    /// Projects a point of the provider's coordinate frame (m) to px; `None` behind the camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        let p = self.reference_from_camera.inverse_transform_point(point);
        (p.z > 1e-6).then(|| {
            let seen = self.distortion.distort(&Point2::new(p.x / p.z, p.y / p.z));
            Point2::new(self.center[0] + self.focal[0] * seen.x, self.center[1] + self.focal[1] * seen.y)
        })
    }

    /// Whether all numbers are finite and the focal lengths positive.
    pub fn is_usable(&self) -> bool {
        let d = &self.distortion;
        let numbers = [d.k1, d.k2, d.p1, d.p2, d.k3, self.center[0], self.center[1]];
        let pose = self.reference_from_camera.to_homogeneous();
        let finite = numbers.iter().chain(pose.iter()).all(|v| v.is_finite());
        finite && self.focal.iter().all(|f| f.is_finite() && *f > 0.0)
    }
}

impl ImageDescription {
    /// The description of an image that a camera, if it is known, has taken.
    pub(super) fn of(image: &RawImage, camera: Option<CameraModel>) -> Self {
        let (width, height) = (image.width(), image.height());
        Self { role: image.role().into(), format: image.format(), width, height, camera }
    }
}

impl ProviderDescription {
    /// The description of an [`ImageSource`](crate::ImageSource): left and right images, and depth for the
    /// left.
    pub fn of_stereo(name: &str, frame_id: &str, calibration: &StereoCalibration) -> Self {
        let camera = &calibration.camera;
        let image = |role: &str, format, shift| ImageDescription {
            role: role.into(),
            format,
            width: camera.width,
            height: camera.height,
            camera: Some(CameraModel::ideal(camera, shift)),
        };
        Self {
            name: name.into(),
            about: "a stereo pair".into(),
            frame_id: frame_id.into(),
            rate_hz: None,
            images: vec![
                image("left", PixelFormat::Rgb8, 0.0),
                image("right", PixelFormat::Rgb8, calibration.baseline),
                image("depth", PixelFormat::Depth32F, 0.0),
            ],
        }
    }

    /// The image of a role.
    pub fn image(&self, role: &str) -> Option<&ImageDescription> {
        self.images.iter().find(|image| image.role == role)
    }

    /// The cameras of the roles `left` and `right`, and their common image size.
    pub(super) fn eyes(&self) -> Result<((u32, u32), [CameraModel; 2]), NotStereo> {
        let eye = |role: &'static str| {
            let image = self.image(role).ok_or(NotStereo::NoImage(role))?;
            let camera = image.camera.ok_or(NotStereo::NotCalibrated(role))?;
            let usable = camera.is_usable().then_some(((image.width, image.height), camera));
            usable.ok_or(NotStereo::NoCamera(role))
        };
        let ((size, left), (other, right)) = (eye("left")?, eye("right")?);
        if size != other {
            return Err(NotStereo::Sizes);
        }
        Ok((size, [left, right]))
    }

    /// The calibration, if the roles `left` and `right` are two identical, parallel cameras without
    /// distortion.
    ///
    /// # Errors
    /// Why they are not such a pair.
    pub fn stereo(&self) -> Result<StereoCalibration, NotStereo> {
        let ((width, height), [left, right]) = self.eyes()?;
        for (role, eye) in [("left", &left), ("right", &right)] {
            if eye.distortion != Distortion::default() {
                return Err(NotStereo::Distorted(role));
            }
        }
        if left.focal != right.focal || left.center != right.center {
            return Err(NotStereo::Differ);
        }
        let pair = left.reference_from_camera.inverse() * right.reference_from_camera;
        let shift = pair.translation.vector;
        if (left.focal[0] - left.focal[1]).abs() > 1e-9 * left.focal[0] {
            return Err(NotStereo::PixelsNotSquare);
        }
        if pair.rotation.angle() > 1e-6 || shift.yz().norm() > 1e-6 || shift.x <= 0.0 {
            return Err(NotStereo::NotParallel);
        }
        let camera = PinholeCamera { width, height, focal: left.focal[0], center: left.center };
        Ok(StereoCalibration { camera, baseline: shift.x })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::CALIBRATION;

    const LENS: Distortion = Distortion { k1: -0.28, k2: 0.07, p1: 1e-3, p2: -5e-4, k3: 0.002 };

    #[test]
    fn undistorting_undoes_distorting() {
        for i in 0..9 {
            let ideal = Point2::new(f64::from(i % 3) * 0.3 - 0.3, f64::from(i / 3) * 0.25 - 0.25);
            let back = LENS.undistort(&LENS.distort(&ideal)).unwrap();
            assert!((back - ideal).norm() < 1e-9, "{ideal}");
        }
        assert_eq!(LENS.undistort(&Point2::new(1e300, 1.0)), None);
        assert_eq!(Distortion::default().distort(&Point2::new(0.3, -0.2)), Point2::new(0.3, -0.2));
    }

    #[test]
    fn a_stereo_pair_is_described_and_read_back() {
        let described = ProviderDescription::of_stereo("eyes", "camera_left", &CALIBRATION);
        assert_eq!(described.stereo(), Ok(CALIBRATION));
        let point = Point3::new(0.1, -0.05, 0.8);
        let right = described.image("right").and_then(|i| i.camera).unwrap().project(&point).unwrap();
        let expected = CALIBRATION.camera.project_shifted(&point, CALIBRATION.baseline).unwrap();
        assert!((right - expected).norm() < 1e-9);
        for spoil in [
            |d: &mut ProviderDescription| d.images[1].role = "middle".into(),
            |d: &mut ProviderDescription| d.images[0].camera = None,
            |d: &mut ProviderDescription| d.images[1].width = 10,
            |d: &mut ProviderDescription| d.images[0].camera.as_mut().unwrap().distortion = LENS,
            |d: &mut ProviderDescription| d.images[0].camera.as_mut().unwrap().focal[1] = f64::NAN,
            |d: &mut ProviderDescription| d.images.swap(0, 1),
            |d: &mut ProviderDescription| {
                let camera = d.images[1].camera.as_mut().unwrap();
                camera.reference_from_camera = Isometry3::translation(-0.1, 0.0, 0.0);
            },
        ] {
            let mut wrong = described.clone();
            spoil(&mut wrong);
            if wrong.images[0].role == "left" || wrong.images[1].role == "middle" {
                assert!(wrong.stereo().is_err(), "{wrong:?}");
            } else {
                assert_eq!(wrong.stereo(), Ok(CALIBRATION), "the order of the images does not matter");
            }
        }
    }
}
