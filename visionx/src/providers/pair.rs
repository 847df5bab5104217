//! From the frames of a provider to the stereo pairs that trackers work on.

use nalgebra::Isometry3;

use super::convert::{depth_of, rgb_of};
use super::{Description, Frame};
use crate::camera::StereoCalibration;
use crate::frame::{ImageError, StereoFrame};

/// What a provider's frames are as stereo pairs.
#[derive(Clone, Debug)]
pub struct StereoPair {
    provider: String,
    calibration: StereoCalibration,
}

impl StereoPair {
    /// The pairs of the provider with this description.
    ///
    /// # Errors
    /// As [`Description::stereo`].
    pub fn of(description: &Description) -> Result<Self, String> {
        Ok(Self { provider: description.name.clone(), calibration: description.stereo()? })
    }

    /// The provider's name.
    #[must_use]
    pub fn provider(&self) -> &str {
        &self.provider
    }

    /// The calibration of the pairs.
    #[must_use]
    pub fn calibration(&self) -> StereoCalibration {
        self.calibration
    }

    /// The pair in a frame.
    ///
    /// # Errors
    /// [`ImageError::Spoilt`] when an eye is missing, or has not the calibration's size: what is seen in it lies elsewhere.
    pub fn frame(&self, frame: &Frame) -> Result<StereoFrame, ImageError> {
        let stereo = stereo_frame(frame, &self.provider)?;
        if self.calibration.fits(&stereo) {
            return Ok(stereo);
        }
        let (camera, [left, right]) = (&self.calibration.camera, [&stereo.left, &stereo.right]);
        let what = format!(
            "eyes of {} x {} and {} x {} pixels, and is calibrated for {} x {}",
            left.width(),
            left.height(),
            right.width(),
            right.height(),
            camera.width,
            camera.height
        );
        Err(ImageError::Spoilt { provider: self.provider.clone(), what })
    }
}

/// The stereo frame of a frame with the images `left` and `right`, and `depth` if there is one. A frame that does not
/// say where its camera is has it at the root.
///
/// # Errors
/// [`ImageError::Spoilt`] when an eye is missing.
pub fn stereo_frame(frame: &Frame, provider: &str) -> Result<StereoFrame, ImageError> {
    let spoilt = |what: String| ImageError::Spoilt { provider: provider.into(), what };
    let eye = |role: &str| {
        let image = frame.image(role).ok_or_else(|| spoilt(format!("a frame without the image `{role}`")))?;
        rgb_of(image).ok_or_else(|| spoilt(format!("the image `{role}` has no colours")))
    };
    Ok(StereoFrame {
        stamp_ns: frame.stamp_ns,
        left: eye("left")?,
        right: eye("right")?,
        depth: frame.image("depth").and_then(depth_of),
        root_from_left: frame.root_from_camera.unwrap_or_else(Isometry3::identity),
    })
}
