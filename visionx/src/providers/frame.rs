//! A provider's frame: one or more images of one moment, in any camera format.
//!
//! Nothing is converted here; [`super::convert`] does that.

use std::fmt;
use std::sync::Arc;

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::frame::ImageError;

/// Most images of a frame.
pub const MAX_IMAGES: usize = 16;
/// Longest name of a role or frame, bytes.
pub(super) const MAX_NAME_BYTES: usize = 200;
/// Longest side of an image, px; a list of points may be longer.
pub(super) const MAX_SIDE: u32 = 65_536;
/// Most bytes of an image.
pub(super) const MAX_IMAGE_BYTES: usize = 2 << 30;

/// The pixel format of an image. Rows from the top, without padding; numbers are little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum PixelFormat {
    /// Red, green, blue: a byte each.
    Rgb8,
    /// Brightness: a byte.
    Gray8,
    /// A byte a pixel behind a colour filter; the first row begins red, green; the second green, blue.
    BayerRggb8,
    /// The same; rows begin blue, green; green, red.
    BayerBggr8,
    /// The same; rows begin green, red; blue, green.
    BayerGrbg8,
    /// The same; rows begin green, blue; red, green.
    BayerGbrg8,
    /// Distance along the optical axis, m, 32-bit float; 0 where there is no measurement.
    Depth32F,
    /// Distance along the optical axis, mm, 16 bit; 0 where there is no measurement.
    Depth16,
    /// Points x, y, z in the camera's frame, m, 32-bit floats; NaN where there is no measurement. An organised cloud
    /// has the camera's width and height, any other the height 1.
    Points32F,
}

/// The owner of an image's bytes, such as a buffer in shared memory.
pub trait PixelOwner: Send + Sync {
    /// The bytes.
    fn bytes(&self) -> &[u8];
    /// Whether the bytes read so far are valid; false when shared memory has been overwritten meanwhile.
    fn is_intact(&self) -> bool {
        true
    }
}

/// The bytes of one image; clones share them.
#[derive(Clone)]
pub struct Pixels {
    owner: Arc<dyn PixelOwner>,
    start: usize,
    end: usize,
}

/// One image of a frame, as its provider made it: in any pixel format.
#[derive(Clone, Debug, PartialEq)]
pub struct RawImage {
    role: String,
    format: PixelFormat,
    width: u32,
    height: u32,
    pixels: Pixels,
}

/// One frame as its provider made it: all images of one moment. Two are equal when their content is, wherever the bytes
/// are. Trackers work on a [`StereoFrame`](crate::StereoFrame), which [`super::StereoPair`] makes of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawFrame {
    /// Consecutive number of the provider's frames; a gap means dropped frames.
    pub number: u64,
    /// The time of the exposure by the provider's clock, ns; the same clock as the robot's samples where there is a
    /// robot.
    pub stamp_ns: u64,
    /// Name of the coordinate frame that poses and points are in: that of the first camera.
    pub frame_id: String,
    /// The estimated pose of the first camera in the robot's root frame, where there is a robot.
    pub root_from_camera: Option<Isometry3<f64>>,
    /// The images; each role at most once.
    pub images: Vec<RawImage>,
}

impl PixelFormat {
    /// Bytes of one pixel.
    #[must_use]
    pub fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Gray8 | Self::BayerRggb8 | Self::BayerBggr8 | Self::BayerGrbg8 | Self::BayerGbrg8 => 1,
            Self::Depth16 => 2,
            Self::Rgb8 => 3,
            Self::Depth32F => 4,
            Self::Points32F => 12,
        }
    }

    /// Bytes of an image; `None` beyond 2 GiB or a side of 65536 px, and when a side is 0.
    #[must_use]
    pub fn bytes(self, width: u32, height: u32) -> Option<usize> {
        let sides = width > 0 && height > 0 && height <= MAX_SIDE;
        let wide = width <= MAX_SIDE || (self == Self::Points32F && height == 1);
        let pixels = u64::from(width).checked_mul(u64::from(height))?;
        let bytes = pixels.checked_mul(self.bytes_per_pixel() as u64)?;
        let bytes = usize::try_from(bytes).ok()?;
        (sides && wide && bytes <= MAX_IMAGE_BYTES).then_some(bytes)
    }
}

impl PixelOwner for Vec<u8> {
    fn bytes(&self) -> &[u8] {
        self
    }
}

impl Pixels {
    /// Bytes `start..end` of `owner`; `None` when it does not have them.
    pub fn part(owner: Arc<dyn PixelOwner>, start: usize, end: usize) -> Option<Self> {
        (start <= end && end <= owner.bytes().len()).then_some(Self { owner, start, end })
    }

    /// The bytes; empty when their owner has become smaller.
    pub fn bytes(&self) -> &[u8] {
        self.owner.bytes().get(self.start..self.end).unwrap_or_default()
    }

    /// See [`PixelOwner::is_intact`].
    pub fn is_intact(&self) -> bool {
        self.owner.is_intact()
    }
}

impl From<Vec<u8>> for Pixels {
    fn from(bytes: Vec<u8>) -> Self {
        Self { start: 0, end: bytes.len(), owner: Arc::new(bytes) }
    }
}

impl PartialEq for Pixels {
    fn eq(&self, other: &Self) -> bool {
        self.bytes() == other.bytes()
    }
}

impl fmt::Debug for Pixels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes", self.end - self.start)
    }
}

impl RawImage {
    /// An image of raw bytes. `role` names it within the frame: `left`, `right`, `depth`, `points`, `image`.
    ///
    /// # Errors
    /// [`ImageError::Size`] unless the bytes are those of `width * height` pixels.
    pub fn new(
        role: &str,
        format: PixelFormat,
        (width, height): (u32, u32),
        pixels: impl Into<Pixels>,
    ) -> Result<Self, ImageError> {
        let pixels = pixels.into();
        let (expected, actual) = (format.bytes(width, height).unwrap_or(0), pixels.bytes().len());
        if expected == actual && actual > 0 {
            Ok(Self { role: role.into(), format, width, height, pixels })
        } else {
            Err(ImageError::Size { width, height, expected, actual })
        }
    }

    /// Its role within the frame.
    pub fn role(&self) -> &str {
        &self.role
    }

    /// The pixel format.
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// Width, px.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, px.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Its bytes, in the pixel format.
    pub fn bytes(&self) -> &[u8] {
        self.pixels.bytes()
    }
}

impl RawFrame {
    /// The image of a role.
    pub fn image(&self, role: &str) -> Option<&RawImage> {
        self.images.iter().find(|image| image.role == role)
    }

    /// Bytes of all images.
    pub fn bytes(&self) -> usize {
        self.images.iter().map(|image| image.bytes().len()).sum()
    }

    /// Whether the bytes read so far are what the provider sent. The sender may overwrite a frame in shared
    /// memory when the reader is too slow. A reader must therefore check this after it has used the pixels.
    pub fn is_intact(&self) -> bool {
        self.images.iter().all(|image| image.pixels.is_intact())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_has_the_bytes_of_its_format_and_size() {
        for (format, bytes) in [
            (PixelFormat::Rgb8, 18),
            (PixelFormat::Gray8, 6),
            (PixelFormat::BayerGbrg8, 6),
            (PixelFormat::Depth16, 12),
            (PixelFormat::Depth32F, 24),
            (PixelFormat::Points32F, 72),
        ] {
            let image = |bytes| RawImage::new("left", format, (3, 2), vec![0; bytes]);
            assert_eq!(image(bytes).unwrap().bytes().len(), bytes);
            let wrong = Err(ImageError::Size { width: 3, height: 2, expected: bytes, actual: bytes + 1 });
            assert_eq!(image(bytes + 1), wrong);
        }
    }

    #[test]
    fn sizes_that_are_none_are_refused_without_overflow() {
        let rgb = |width, height| PixelFormat::Rgb8.bytes(width, height);
        assert_eq!(rgb(1, 1), Some(3));
        assert_eq!(
            [rgb(0, 5), rgb(5, 0), rgb(u32::MAX, u32::MAX), rgb(65_537, 1), rgb(60_000, 60_000)],
            [None; 5]
        );
        assert_eq!(PixelFormat::Points32F.bytes(1_000_000, 1), Some(12_000_000));
        assert_eq!(PixelFormat::Points32F.bytes(1_000_000, 2), None);
        assert!(RawImage::new("left", PixelFormat::Rgb8, (0, 0), vec![]).is_err());
    }

    #[test]
    fn a_part_of_a_buffer_is_within_it() {
        let owner: Arc<dyn PixelOwner> = Arc::new(vec![1, 2, 3, 4]);
        assert_eq!(Pixels::part(Arc::clone(&owner), 1, 3).unwrap().bytes(), [2, 3]);
        assert_eq!(Pixels::part(Arc::clone(&owner), 3, 5), None);
        assert_eq!(Pixels::part(owner, 3, 2), None);
    }
}
