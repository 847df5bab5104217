//! Images, camera models, providers and processors, tracking and gestures.
//!
//! - [`Image`], [`DepthImage`], [`StereoFrame`]: what cameras give. [`ImageSource`]: who gives it.
//! - [`PinholeCamera`], [`StereoCalibration`]: from pixels to points.
//!
//! This room knows no robot and no memory: results are plain values in the camera's frame.

mod camera;
mod frame;

pub use camera::{PinholeCamera, StereoCalibration};
pub use frame::{DepthImage, Image, ImageError, ImageSource, StereoFrame};
