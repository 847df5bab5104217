//! From a provider's frames to the stereo pairs that trackers use.

use std::sync::Arc;

use nalgebra::Isometry3;

use super::convert::{depth_of, rgb_of};
use super::{NotStereo, ProviderDescription, RawFrame};
use crate::camera::StereoCalibration;
use crate::frame::{ImageError, SharedImage, StereoFrame};
use crate::providers::rectify::Rectification;

/// Makes stereo pairs of a provider's frames.
#[derive(Clone, Debug)]
pub struct StereoPair {
    provider: String,
    calibration: StereoCalibration,
    rectification: Option<Arc<Rectification>>,
}

impl StereoPair {
    /// The pairs of the provider with this description. They are rectified when its cameras are distorted, differ or
    /// are not parallel.
    ///
    /// # Errors
    /// Why its images are not a pair.
    pub fn of(description: &ProviderDescription) -> Result<Self, NotStereo> {
        let provider = description.name.clone();
        if let Ok(calibration) = description.stereo() {
            return Ok(Self { provider, calibration, rectification: None });
        }
        let (size, [left, right]) = description.eyes()?;
        let rectification = Rectification::new(&left, &right, size)?;
        let calibration = rectification.calibration();
        Ok(Self { provider, calibration, rectification: Some(Arc::new(rectification)) })
    }

    /// The provider's name.
    pub fn provider(&self) -> &str {
        &self.provider
    }

    /// The calibration of the pairs.
    pub fn calibration(&self) -> StereoCalibration {
        self.calibration
    }

    /// The pair in a frame.
    ///
    /// # Errors
    /// [`ImageError::Spoilt`] when an image is missing or does not have the calibration's size, which would shift all
    /// points.
    pub fn frame(&self, frame: &RawFrame) -> Result<StereoFrame, ImageError> {
        let stereo = stereo_frame(frame, &self.provider)?;
        if self.calibration.fits(&stereo) {
            let rectified = self.rectification.as_ref().and_then(|how| how.rectify(&stereo));
            return Ok(rectified.unwrap_or(stereo));
        }
        let camera = &self.calibration.camera;
        let size = |eye: &SharedImage| format!("{} x {}", eye.width(), eye.height());
        let (left, right) = (size(&stereo.left), size(&stereo.right));
        let wanted = format!("{} x {}", camera.width, camera.height);
        let what = format!("eyes of {left} and {right} pixels, and is calibrated for {wanted}");
        Err(ImageError::Spoilt { provider: self.provider.clone(), what })
    }
}

/// The stereo frame of a frame with the images `left` and `right`, and `depth` if there is one. Without a camera pose
/// in the frame the camera is taken to be at the root.
fn stereo_frame(frame: &RawFrame, provider: &str) -> Result<StereoFrame, ImageError> {
    let spoilt = |what: String| ImageError::Spoilt { provider: provider.into(), what };
    let eye = |role: &str| {
        let image = frame.image(role).ok_or_else(|| spoilt(format!("a frame without the image `{role}`")))?;
        rgb_of(image).ok_or_else(|| spoilt(format!("the image `{role}` has no colours")))
    };
    Ok(StereoFrame {
        stamp_ns: frame.stamp_ns,
        left: eye("left")?.into(),
        right: eye("right")?.into(),
        depth: frame.image("depth").and_then(depth_of).map(Arc::new),
        root_from_left: frame.root_from_camera.unwrap_or_else(Isometry3::identity),
    })
}
