//! Stereo frames, which trackers work on: two decoded images with depth and the camera's pose at their time. Providers
//! give [`RawFrame`](crate::providers::RawFrame)s, whose pixels are in the camera's own format.

use std::fmt;
use std::ops::Deref;
use std::sync::{Arc, LazyLock};

use nalgebra::Isometry3;

use crate::mask::Region;

/// A decoded image: RGB, 8 bit a channel, rows from the top, three bytes a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbImage {
    width: u32,
    height: u32,
    data: Vec<u8>,
}

type Draw = Box<dyn FnOnce() -> RgbImage + Send>;

/// An [`RgbImage`] that is drawn or decoded when somebody first looks at it, and then kept for all: a camera's second image costs
/// nothing where nobody needs it. Copies share it.
#[derive(Clone)]
pub struct SharedImage {
    width: u32,
    height: u32,
    image: Arc<LazyLock<RgbImage, Draw>>,
}

impl SharedImage {
    /// An image of this size, px, which `draw` gives, at most once. If it gives another size, the image is black.
    pub fn later(width: u32, height: u32, draw: impl FnOnce() -> RgbImage + Send + 'static) -> Self {
        let draw = move || {
            let drawn = draw();
            let fits = (drawn.width, drawn.height) == (width, height);
            if fits { drawn } else { RgbImage::painted(width, height, |_, _| [0; 3]) }
        };
        Self { width, height, image: Arc::new(LazyLock::new(Box::new(draw))) }
    }

    /// Width, px; known before the image is drawn.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, px; known before the image is drawn.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }
}

impl From<RgbImage> for SharedImage {
    fn from(image: RgbImage) -> Self {
        Self::later(image.width, image.height, || image)
    }
}

impl Deref for SharedImage {
    type Target = RgbImage;

    fn deref(&self) -> &RgbImage {
        &self.image
    }
}

impl fmt::Debug for SharedImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SharedImage({} x {})", self.width, self.height)
    }
}

impl PartialEq for SharedImage {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.image, &other.image) || **self == **other
    }
}

/// A depth image: distance along the optical axis, m; 0 where there is no measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthImage {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// Depth, m, rows from the top; `width * height` values.
    pub data: Vec<f32>,
}

/// How far from a measurement a hole is filled, px.
const FILLED: usize = 3;

impl DepthImage {
    /// The depth measured at a pixel, m; 0 where there is none.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> f32 {
        let inside = x < self.width && y < self.height;
        let at = y as usize * self.width as usize + x as usize;
        self.data.get(at).copied().filter(|_| inside).unwrap_or(0.0)
    }

    /// Fills narrow holes, such as depth cameras leave along edges: each pixel takes the depth of the nearest measurement in its
    /// row or column, at most three pixels away. So an edge comes to lie in the middle of its hole.
    #[must_use]
    pub fn filled(&self) -> Self {
        let (w, h) = (self.width as usize, self.height as usize);
        let mut filled = self.clone();
        if self.data.len() != w * h {
            return filled;
        }
        for (i, depth) in filled.data.iter_mut().enumerate().filter(|(_, depth)| **depth == 0.0) {
            let (u, v) = (i % w, i / w);
            let at = |u: usize, v: usize| Some(self.data[v * w + u]).filter(|z| *z > 0.0);
            let near = |r: usize| {
                let left = u.checked_sub(r).and_then(|u| at(u, v));
                let right = Some(u + r).filter(|u| *u < w).and_then(|u| at(u, v));
                let above = v.checked_sub(r).and_then(|v| at(u, v));
                let below = Some(v + r).filter(|v| *v < h).and_then(|v| at(u, v));
                left.or(right).or(above).or(below)
            };
            *depth = (1..=FILLED).find_map(near).unwrap_or(0.0);
        }
        filled
    }
}

/// One stereo frame: both images were taken at the same time.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoFrame {
    /// The time of the exposure since the provider's start, ns; the same clock as the robot's samples.
    pub stamp_ns: u64,
    /// Left eye.
    pub left: SharedImage,
    /// Right eye.
    pub right: SharedImage,
    /// Depth registered to the left eye, where the provider has it.
    pub depth: Option<Arc<DepthImage>>,
    /// The left camera's pose in the robot's root frame, computed from joint angles and calibration. An error
    /// of the mounting is not included.
    pub root_from_left: Isometry3<f64>,
}

/// Why there is no frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The number of bytes does not fit the image's size.
    #[error("an image of {width} x {height} pixels needs {expected} bytes, not {actual}")]
    Size {
        /// Width, px.
        width: u32,
        /// Height, px.
        height: u32,
        /// Bytes needed.
        expected: usize,
        /// Bytes given.
        actual: usize,
    },
    /// The provider is gone.
    #[error("the image provider `{provider}` has gone")]
    Gone {
        /// Its name.
        provider: String,
    },
    /// One frame is unavailable or not of the requested kind; later frames may be.
    #[error("the image provider `{provider}` gave {what}")]
    Spoilt {
        /// Its name.
        provider: String,
        /// What is wrong.
        what: String,
    },
}

impl RgbImage {
    /// Makes an image of raw RGB bytes.
    ///
    /// # Errors
    /// [`ImageError::Size`] unless there are `width * height * 3` bytes.
    pub fn from_rgb(width: u32, height: u32, data: Vec<u8>) -> Result<Self, ImageError> {
        let expected = width as usize * height as usize * 3;
        if data.len() == expected {
            Ok(Self { width, height, data })
        } else {
            Err(ImageError::Size { width, height, expected, actual: data.len() })
        }
    }

    /// An image with these colours at each column and row, in rows from the top.
    pub fn painted(width: u32, height: u32, mut color: impl FnMut(u32, u32) -> [u8; 3]) -> Self {
        let data = Region::whole(width, height).pixels().flat_map(|(x, y)| color(x, y)).collect();
        Self { width, height, data }
    }

    /// Width, px.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, px.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All bytes, RGB, rows from the top.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// All bytes, for drawing.
    #[must_use]
    pub fn data_mut(&mut self) -> &mut [u8] {
        &mut self.data
    }

    /// All bytes, by value.
    #[must_use]
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }

    /// The colour at a pixel; black outside of the image.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        if x >= self.width || y >= self.height {
            return [0; 3];
        }
        let i = (y as usize * self.width as usize + x as usize) * 3;
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shared_image_is_drawn_once_and_only_when_somebody_looks() {
        let drawn = Arc::new(std::sync::atomic::AtomicU32::new(0));
        let count = Arc::clone(&drawn);
        let image = SharedImage::later(2, 1, move || {
            count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            RgbImage::painted(2, 1, |x, _| [x as u8; 3])
        });
        let copy = image.clone();
        assert_eq!((copy.width(), copy.height(), format!("{copy:?}").as_str()), (2, 1, "SharedImage(2 x 1)"));
        assert_eq!(drawn.load(std::sync::atomic::Ordering::Relaxed), 0);
        assert_eq!((image.pixel(1, 0), copy.pixel(0, 0)), ([1; 3], [0; 3]));
        assert_eq!(image, SharedImage::from(RgbImage::clone(&copy)));
        assert_eq!(drawn.load(std::sync::atomic::Ordering::Relaxed), 1);
        let other = SharedImage::later(2, 1, || RgbImage::painted(5, 5, |_, _| [9; 3]));
        assert_eq!((other.pixel(0, 0), other.data().len()), ([0; 3], 6));
    }
}
