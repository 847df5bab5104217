//! Who gives frames, and how they reach those who look at them.
//!
//! - [`Frame`]: one moment, of one or more images. [`Description`]: what a provider gives, and its calibration.
//! - [`ImageProvider`]: who gives frames. [`StereoProvider`] makes one of an [`ImageSource`](crate::ImageSource), such as
//!   the simulator's cameras, and [`StereoView`] the other way; [`FileProvider`] gives images of files,
//!   [`RecordingProvider`] what was recorded, [`FrameSender`] what a program makes itself, `CameraProvider` (feature `camera`) what a camera sees, [`RemoteProvider`] what another
//!   process offers.
//! - [`FanOut`]: many readers of one provider. [`offer`]: to other processes. [`Recording`]: into a file.
//! - [`wire`]: what a frame is on the network and in a recording.

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
pub use description::{CameraModel, Description, Distortion, ImageDescription};
pub use discovery::{FoundProvider, RemoteError, providers};
pub use fan_out::{FanOut, Subscription};
pub use files::{FileProvider, Pace};
pub use frame::{Frame, FrameImage, MOST_IMAGES, PixelFormat, PixelOwner, Pixels};
pub use offering::{Offered, OfferedStatistics, offer};
pub use pair::{StereoPair, stereo_frame};
pub use recording::{RecordingError, RecordingProvider, recorded};
pub use remote::{Delivery, RemoteProvider, RemoteStatistics};
pub use stereo::{StereoProvider, StereoView, frame_of};
pub use wire::ImageCoding;
pub use writing::Recording;

/// Who gives frames. Frames that nobody asks for need not be made.
#[async_trait]
pub trait ImageProvider: Send + Sync {
    /// What it gives, and its calibration.
    fn description(&self) -> Description;

    /// Waits for the next frame.
    ///
    /// # Errors
    /// [`ImageError::Gone`] when no further frame will come. Anything else spoils one frame; the next may be good.
    async fn next(&self) -> Result<Arc<Frame>, ImageError>;
}
