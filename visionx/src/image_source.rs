//! The trait through which skills get stereo frames.

use std::sync::Arc;

use async_trait::async_trait;

use crate::camera::StereoCalibration;
use crate::frame::{ImageError, StereoFrame};

/// A provider of stereo frames. It makes a frame only when a caller waits for one.
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
