//! What a frame is on the network and in a recording: a header, and the images' bytes one after the other.
//!
//! On the network the bytes are the payload and the header its attachment, so that pixels can stay where they are in
//! shared memory. In a recording, and in the answer to a question, they are one [`pack`]ed message: the header's length as four bytes
//! (little-endian), the header, the bytes. The header is CBOR, a map by field name; `docs/wire-images.md` describes it.
//! Nothing that is decoded here is trusted: a header that does not fit its bytes is an error.

use armarium_bus::stream::StreamPosition;
use std::io::Cursor;
use std::sync::Arc;

use armarium_bus::{Bounds, CodecError};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::frame::{Frame, FrameImage, LONGEST_NAME, MOST_IMAGES, PixelFormat, PixelOwner, Pixels};
use super::lenient::decode_leniently;
use crate::files::{FileError, decode_gray, decode_image, size_of};
use crate::frame::ImageError;

/// The version of the header that is written here.
pub const VERSION: u32 = 1;
/// The Zenoh encoding of a frame whose header is attached.
pub const ENCODING: &str = "application/octet-stream;image/frame;v1";
/// The Zenoh encoding of a [`pack`]ed frame.
pub const PACKED: &str = "application/octet-stream;image/packed-frame;v1";
/// Most bytes that the coded images of a frame may have when they are decoded: they are made of far fewer.
const MOST_DECODED: usize = 512 << 20;
/// What a header may cost.
const BOUNDS: Bounds = Bounds { bytes: 16 << 10, items: 1024, depth: 8 };

/// How the bytes of an image are coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageCoding {
    /// As the format says.
    #[default]
    Raw,
    /// A PNG file: RGB, gray, or gray of 16 bit, as the format has it.
    Png,
    /// A JPEG file: RGB or gray.
    Jpeg,
}

/// What is said of a frame beside its bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the header: [`VERSION`].
    pub version: u32,
    /// Tells one life of a provider from the next: its numbers begin anew in each. Recordings of earlier versions call it
    /// `life`.
    #[serde(alias = "life")]
    pub epoch: u64,
    /// Counts the provider's frames.
    pub number: u64,
    /// When the shutter was open, by the provider's clock, ns.
    pub stamp_ns: u64,
    /// When the frame was sent, ns since 1970 by the sender's clock.
    pub sent_ns: u64,
    /// Name of the first camera's coordinate frame.
    pub frame_id: String,
    /// The first camera's pose in the robot's root frame: x, y, z, m, and the unit quaternion x, y, z, w.
    pub root_from_camera: Option<[f64; 7]>,
    /// The images, in the order of their bytes.
    pub images: Vec<ImageHeader>,
}

/// What is said of one image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageHeader {
    /// Which image of the frame.
    pub role: String,
    /// How its pixels are to be read when they are decoded.
    pub format: PixelFormat,
    /// How its bytes are coded.
    pub coding: ImageCoding,
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// How many bytes it has.
    pub bytes: u64,
}

/// Why bytes are no frame.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WireError {
    /// The header is no CBOR map of the right fields.
    #[error("the header cannot be read: {0}")]
    Header(#[from] CodecError),
    /// A newer or older program sent it.
    #[error("the header has version {found}; this side understands version {VERSION}")]
    Version {
        /// The version found.
        found: u32,
    },
    /// The message's encoding is not that of a frame.
    #[error("it is sent as `{found}`; this side understands `{ENCODING}`")]
    Encoding {
        /// The encoding found.
        found: String,
    },
    /// Too many images, two of one role, a name that is too long, or a pose that is none.
    #[error("the header says something that no frame can be: {what}")]
    Impossible {
        /// What.
        what: &'static str,
    },
    /// Header and payload do not fit.
    #[error("the header speaks of {expected} bytes, and there are {actual}")]
    Length {
        /// What the images need, bytes.
        expected: u64,
        /// What there is, bytes.
        actual: u64,
    },
    /// An image has not the bytes of its size.
    #[error("the image `{role}`: {source}")]
    Image {
        /// Its role.
        role: String,
        /// What is wrong.
        source: ImageError,
    },
    /// A coded image cannot be decoded.
    #[error("the image `{role}` {source}")]
    Coded {
        /// Its role.
        role: String,
        /// Why.
        source: FileError,
    },
    /// A coded image has another size or format than the header says.
    #[error("the image `{role}` is not what its header says")]
    Other {
        /// Its role.
        role: String,
    },
}

impl Header {
    /// The header of a frame whose images are sent as they are.
    #[must_use]
    pub fn raw(frame: &Frame, epoch: u64, sent_ns: u64) -> Self {
        let images = frame.images.iter().map(ImageHeader::raw).collect();
        Self {
            version: VERSION,
            epoch,
            number: frame.number,
            stamp_ns: frame.stamp_ns,
            sent_ns,
            frame_id: frame.frame_id.clone(),
            root_from_camera: frame.root_from_camera.as_ref().map(seven),
            images,
        }
    }

    /// Where the frame stands in the provider's stream.
    #[must_use]
    pub fn position(&self) -> StreamPosition {
        StreamPosition { epoch: self.epoch, number: self.number }
    }

    /// Its bytes.
    ///
    /// # Errors
    /// [`WireError::Header`] does not happen with a header of ours.
    pub fn encode(&self) -> Result<Vec<u8>, WireError> {
        Ok(armarium_bus::encode(self)?)
    }

    /// Reads and checks a header.
    ///
    /// # Errors
    /// [`WireError`] when it is none or says something impossible.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let version: Versioned = decode_leniently(bytes, BOUNDS)?;
        if version.version != VERSION {
            return Err(WireError::Version { found: version.version });
        }
        let header: Self = decode_leniently(bytes, BOUNDS)?;
        header.check()?;
        Ok(header)
    }

    fn check(&self) -> Result<(), WireError> {
        let impossible = |what| Err(WireError::Impossible { what });
        let long = |name: &str| name.len() > LONGEST_NAME;
        if self.images.len() > MOST_IMAGES {
            return impossible("it has too many images");
        }
        if long(&self.frame_id) || self.images.iter().any(|i| long(&i.role) || i.role.is_empty()) {
            return impossible("a name is empty or too long");
        }
        let twice = |(n, image): (usize, &ImageHeader)| self.images[..n].iter().any(|i| i.role == image.role);
        if self.images.iter().enumerate().any(twice) {
            return impossible("two images have one role");
        }
        if self.root_from_camera.is_some_and(|pose| isometry(pose).is_none()) {
            return impossible("the camera's pose is none");
        }
        let coded = self.images.iter().filter(|image| image.coding != ImageCoding::Raw);
        let decoded = coded.map(|image| image.format.bytes(image.width, image.height).unwrap_or(usize::MAX));
        if decoded.fold(0, usize::saturating_add) > MOST_DECODED {
            return impossible("its coded images are larger than 512 MiB");
        }
        Ok(())
    }

    /// The frame of these bytes. Raw images stay where they are; coded ones are decoded.
    ///
    /// # Errors
    /// [`WireError`] when the bytes are not those that the header speaks of.
    pub fn frame(&self, owner: &Arc<dyn PixelOwner>) -> Result<Frame, WireError> {
        self.frame_at(owner, 0)
    }

    fn frame_at(&self, owner: &Arc<dyn PixelOwner>, start: usize) -> Result<Frame, WireError> {
        let actual = owner.bytes().len().saturating_sub(start) as u64;
        let sum = self.images.iter().try_fold(0u64, |sum, image| sum.checked_add(image.bytes));
        let expected = sum.unwrap_or(u64::MAX);
        // A frame without images is sent as one byte: shared memory has no empty buffers.
        if expected != actual && !(expected == 0 && actual == 1) {
            return Err(WireError::Length { expected, actual });
        }
        let mut at = start;
        let mut images = Vec::with_capacity(self.images.len());
        for image in &self.images {
            // Not longer than what there is, as checked.
            let end = at + usize::try_from(image.bytes).unwrap_or(usize::MAX - at);
            let part = Pixels::part(Arc::clone(owner), at, end);
            let part = part.ok_or(WireError::Length { expected, actual })?;
            images.push(image.image(part)?);
            at = end;
        }
        Ok(Frame {
            number: self.number,
            stamp_ns: self.stamp_ns,
            frame_id: self.frame_id.clone(),
            root_from_camera: self.root_from_camera.and_then(isometry),
            images,
        })
    }
}

/// What every version of the header has.
#[derive(Deserialize)]
struct Versioned {
    version: u32,
}

impl ImageHeader {
    fn raw(image: &FrameImage) -> Self {
        Self {
            role: image.role().into(),
            format: image.format(),
            coding: ImageCoding::Raw,
            width: image.width(),
            height: image.height(),
            bytes: image.bytes().len() as u64,
        }
    }

    fn image(&self, bytes: Pixels) -> Result<FrameImage, WireError> {
        let pixels = match self.coding {
            ImageCoding::Raw => bytes,
            ImageCoding::Png | ImageCoding::Jpeg => self.decoded(bytes.bytes())?.into(),
        };
        FrameImage::new(&self.role, self.format, (self.width, self.height), pixels)
            .map_err(|source| WireError::Image { role: self.role.clone(), source })
    }

    fn decoded(&self, file: &[u8]) -> Result<Vec<u8>, WireError> {
        let coded = |source| WireError::Coded { role: self.role.clone(), source };
        let other = || WireError::Other { role: self.role.clone() };
        // Before its pixels are decoded: the header's size is one that was checked.
        if size_of(Cursor::new(file)).map_err(coded)? != (self.width, self.height) {
            return Err(other());
        }
        match self.format {
            PixelFormat::Rgb8 => Ok(decode_image(file).map_err(coded)?.into_data()),
            PixelFormat::Depth32F | PixelFormat::Points32F => Err(other()),
            format => Ok(decode_gray(file, format == PixelFormat::Depth16).map_err(coded)?.2),
        }
    }
}

/// A frame as one message, its images as they are.
///
/// # Errors
/// As [`Header::encode`].
pub fn pack(frame: &Frame, epoch: u64, sent_ns: u64) -> Result<Vec<u8>, WireError> {
    let header = Header::raw(frame, epoch, sent_ns).encode()?;
    let mut bytes = Vec::with_capacity(4 + header.len() + frame.bytes());
    bytes.extend((header.len() as u32).to_le_bytes());
    bytes.extend(&header);
    frame.images.iter().for_each(|image| bytes.extend(image.bytes()));
    Ok(bytes)
}

/// The frame of a [`pack`]ed message, whose bytes it keeps, and its header.
///
/// # Errors
/// [`WireError`].
pub fn unpack(message: Vec<u8>) -> Result<(Header, Frame), WireError> {
    let short = WireError::Length { expected: 4, actual: message.len() as u64 };
    let Some((length, rest)) = message.split_first_chunk::<4>() else { return Err(short) };
    let length = u32::from_le_bytes(*length) as usize;
    let actual = rest.len() as u64;
    let header = rest.get(..length).ok_or(WireError::Length { expected: length as u64, actual })?;
    let header = Header::decode(header)?;
    let owner: Arc<dyn PixelOwner> = Arc::new(message);
    let frame = header.frame_at(&owner, 4 + length)?;
    Ok((header, frame))
}

fn seven(pose: &Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

fn isometry([x, y, z, i, j, k, w]: [f64; 7]) -> Option<Isometry3<f64>> {
    let rotation = Quaternion::new(w, i, j, k);
    let unit = (rotation.norm() - 1.0).abs() < 1e-6;
    let rotation = UnitQuaternion::new_unchecked(rotation);
    let finite = [x, y, z].iter().all(|v| v.is_finite());
    (finite && unit).then(|| Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

#[cfg(test)]
mod tests;
