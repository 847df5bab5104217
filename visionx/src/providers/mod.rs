//! Image providers, and the transport of their frames to readers.
//!
//! - [`RawFrame`]: one or more images of one moment. [`ProviderDescription`]: a provider's images and calibration.
//! - [`ImageProvider`]: the trait. [`StereoProvider`] makes one of an [`ImageSource`](crate::ImageSource), such as the
//!   simulator's cameras, and [`StereoView`] does the reverse. [`FileProvider`] reads image files,
//!   [`RecordingProvider`] recordings, [`FrameSender`] takes frames that the program makes, `CameraProvider` (feature
//!   `camera`) reads a camera, [`RemoteProvider`] a provider of another process.
//! - [`offer`]: publishes to other processes. [`RecordingWriter`]: writes a file.
//! - [`wire`]: the format of a frame on the network and in a recording.

mod calibration;
#[cfg(feature = "camera")]
mod camera;
mod channel;
mod compressed;
pub mod convert;
mod description;
mod discovery;
mod fan_out;
mod files;
mod frame;
mod lenient;
mod offering;
mod pair;
mod recording;
pub mod rectify;
mod remote;
mod stereo;
pub mod wire;
mod writing;

use std::sync::Arc;

use async_trait::async_trait;

use crate::frame::ImageError;

#[cfg(feature = "camera")]
pub use camera::CameraProvider;
pub use channel::{FrameChannel, FrameSender, channel};
pub use description::{CameraModel, Distortion, ImageDescription, NotStereo, ProviderDescription};
pub use discovery::{FoundProvider, RemoteError, providers};
pub use files::{FileProvider, Pace};
pub use frame::{MAX_IMAGES, PixelFormat, PixelOwner, Pixels, RawFrame, RawImage};
pub use offering::{Offered, OfferedStatistics, offer};
pub use pair::StereoPair;
pub use recording::{RecordingError, RecordingProvider, recorded};
pub use remote::{Delivery, RemoteProvider, RemoteStatistics};
pub use stereo::{StereoProvider, StereoView, frame_of};
pub use wire::ImageCoding;
pub use writing::RecordingWriter;

/// A provider of frames. It need not make a frame that no caller waits for.
#[async_trait]
pub trait ImageProvider: Send + Sync {
    /// Its images and their calibration.
    fn description(&self) -> ProviderDescription;

    /// Waits for the next frame.
    ///
    /// # Errors
    /// [`ImageError::Gone`] when no further frame will come. Any other error concerns one frame; the next may be
    /// good.
    async fn next(&self) -> Result<Arc<RawFrame>, ImageError>;
}
