//! Who gives stereo frames to skills: the one trait between cameras and whoever looks through them.

use std::sync::Arc;

use async_trait::async_trait;

use crate::camera::StereoCalibration;
use crate::frame::{ImageError, StereoFrame};

/// A provider of stereo frames. Frames that nobody asks for are not made.
#[async_trait]
pub trait ImageSource: Send + Sync {
    /// Its name.
    fn name(&self) -> &str;
    /// Intrinsics and extrinsics.
    fn calibration(&self) -> StereoCalibration;
    /// Waits for the next frame.
    ///
    /// # Errors
    /// [`ImageError::Gone`] when no further frame will come.
    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError>;
}
