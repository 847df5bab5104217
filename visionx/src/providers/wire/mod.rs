//! The format of a frame on the network and in a recording: a header, and the images' bytes one after the other.
//!
//! On the network the bytes are the payload and the header its attachment, so that pixels can stay in shared memory. In
//! a recording, and in the answer to a query, they are one [`pack`]ed message: the header's length as four bytes
//! (little-endian), the header, the bytes. The header is CBOR, a map by field name; `docs/wire-images.md` describes it.
//! Nothing that is decoded here is trusted: a header that does not fit its bytes is an error.

use armarium_bus::stream::StreamPosition;
use std::io::Cursor;
use std::sync::Arc;

use armarium_bus::{Bounds, CodecError};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::frame::{MAX_IMAGES, MAX_NAME_BYTES, PixelFormat, PixelOwner, Pixels, RawFrame, RawImage};
use super::lenient::decode_leniently;
use crate::files::{FileError, decode_gray, decode_image, size_of};
use crate::frame::ImageError;

/// The version of the header that is written here.
pub const VERSION: u32 = 1;
/// The Zenoh encoding of a frame whose header is attached.
pub const ENCODING: &str = "application/octet-stream;image/frame;v1";
/// The Zenoh encoding of a [`pack`]ed frame.
pub const PACKED: &str = "application/octet-stream;image/packed-frame;v1";
/// Limit of a frame's images after decoding, bytes; their encoded files are much smaller.
const MAX_DECODED_BYTES: usize = 512 << 20;
/// Limits of a header.
const BOUNDS: Bounds = Bounds { bytes: 16 << 10, items: 1024, depth: 8 };

/// The encoding of an image's bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageCoding {
    /// Raw bytes in the pixel format.
    #[default]
    Raw,
    /// A PNG file: RGB, gray, or 16 bit gray, depending on the pixel format.
    Png,
    /// A JPEG file: RGB or gray.
    Jpeg,
}

/// The header of a frame: all but its bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the header: [`VERSION`].
    pub version: u32,
    /// Distinguishes the runs of a provider; its numbers start again in each. Recordings of earlier versions call it
    /// `life`.
    #[serde(alias = "life")]
    pub epoch: u64,
    /// Consecutive number of the provider's frames.
    pub number: u64,
    /// The time of the exposure by the provider's clock, ns.
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

/// The header of one image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageHeader {
    /// Its role within the frame.
    pub role: String,
    /// The pixel format after decoding.
    pub format: PixelFormat,
    /// The encoding of its bytes.
    pub coding: ImageCoding,
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// Its number of bytes.
    pub bytes: u64,
}

/// Why bytes are not a frame.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WireError {
    /// The header is not a CBOR map with the required fields.
    #[error("the header cannot be read: {0}")]
    Header(#[from] CodecError),
    /// The sender's version is incompatible.
    #[error("the header has version {0}; this side understands version {VERSION}")]
    Version(u32),
    /// The message's encoding is not that of a frame.
    #[error("it is sent as `{0}`; this side understands `{ENCODING}`")]
    Encoding(String),
    /// Too many images, two of one role, a name that is too long, or an invalid pose.
    #[error("the header says something that no frame can be: {0}")]
    Impossible(&'static str),
    /// Header and payload do not match.
    #[error("the header speaks of {expected} bytes, and there are {actual}")]
    Length {
        /// Bytes that the header requires.
        expected: u64,
        /// Bytes that were received.
        actual: u64,
    },
    /// The bytes of an image do not fit its size.
    #[error("the image `{role}`: {source}")]
    RgbImage {
        /// Its role.
        role: String,
        /// What is wrong.
        source: ImageError,
    },
    /// An encoded image cannot be decoded.
    #[error("the image `{role}` {source}")]
    Coded {
        /// Its role.
        role: String,
        /// The reason.
        source: FileError,
    },
    /// The size or format of an encoded image differs from its header.
    #[error("the image `{0}` is not what its header says")]
    Other(String),
}

impl Header {
    /// The header of a frame whose images are sent raw.
    pub fn raw(frame: &RawFrame, epoch: u64, sent_ns: u64) -> Self {
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

    /// The frame's position in the provider's stream.
    pub fn position(&self) -> StreamPosition {
        StreamPosition { epoch: self.epoch, number: self.number }
    }

    /// Encodes the header, which cannot fail with a header made here.
    pub fn encode(&self) -> Result<Vec<u8>, WireError> {
        Ok(armarium_bus::encode(self)?)
    }

    /// Reads and checks a header.
    ///
    /// # Errors
    /// [`WireError`] when the bytes are not a valid header.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let version: Versioned = decode_leniently(bytes, BOUNDS)?;
        if version.version != VERSION {
            return Err(WireError::Version(version.version));
        }
        let header: Self = decode_leniently(bytes, BOUNDS)?;
        header.check()?;
        Ok(header)
    }

    fn check(&self) -> Result<(), WireError> {
        let impossible = |what| Err(WireError::Impossible(what));
        let long = |name: &str| name.len() > MAX_NAME_BYTES;
        if self.images.len() > MAX_IMAGES {
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
        if decoded.fold(0, usize::saturating_add) > MAX_DECODED_BYTES {
            return impossible("its coded images are larger than 512 MiB");
        }
        Ok(())
    }

    /// Makes the frame of these bytes. Raw images are not copied; encoded ones are decoded.
    ///
    /// # Errors
    /// [`WireError`] when the bytes do not match the header.
    pub fn frame(&self, owner: &Arc<dyn PixelOwner>) -> Result<RawFrame, WireError> {
        self.frame_at(owner, 0)
    }

    fn frame_at(&self, owner: &Arc<dyn PixelOwner>, start: usize) -> Result<RawFrame, WireError> {
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
            // At most the length of the data, as checked above.
            let end = at + usize::try_from(image.bytes).unwrap_or(usize::MAX - at);
            let part = Pixels::part(Arc::clone(owner), at, end);
            let part = part.ok_or(WireError::Length { expected, actual })?;
            images.push(image.image(part)?);
            at = end;
        }
        Ok(RawFrame {
            number: self.number,
            stamp_ns: self.stamp_ns,
            frame_id: self.frame_id.clone(),
            root_from_camera: self.root_from_camera.and_then(isometry),
            images,
        })
    }
}

/// The fields of every header version.
#[derive(Deserialize)]
struct Versioned {
    version: u32,
}

impl ImageHeader {
    fn raw(image: &RawImage) -> Self {
        Self {
            role: image.role().into(),
            format: image.format(),
            coding: ImageCoding::Raw,
            width: image.width(),
            height: image.height(),
            bytes: image.bytes().len() as u64,
        }
    }

    fn image(&self, bytes: Pixels) -> Result<RawImage, WireError> {
        let pixels = match self.coding {
            ImageCoding::Raw => bytes,
            ImageCoding::Png | ImageCoding::Jpeg => self.decoded(bytes.bytes())?.into(),
        };
        RawImage::new(&self.role, self.format, (self.width, self.height), pixels)
            .map_err(|source| WireError::RgbImage { role: self.role.clone(), source })
    }

    fn decoded(&self, file: &[u8]) -> Result<Vec<u8>, WireError> {
        let coded = |source| WireError::Coded { role: self.role.clone(), source };
        let other = || WireError::Other(self.role.clone());
        // Before decoding the pixels: the header's size was checked, the file's must be equal.
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

/// Packs a frame into one message, with raw images; see [`Header::encode`].
pub fn pack(frame: &RawFrame, epoch: u64, sent_ns: u64) -> Result<Vec<u8>, WireError> {
    let header = Header::raw(frame, epoch, sent_ns).encode()?;
    let mut bytes = Vec::with_capacity(4 + header.len() + frame.bytes());
    bytes.extend((header.len() as u32).to_le_bytes());
    bytes.extend(&header);
    frame.images.iter().for_each(|image| bytes.extend(image.bytes()));
    Ok(bytes)
}

/// Unpacks a [`pack`]ed message to its header and frame. The frame keeps the message's bytes.
pub fn unpack(message: Vec<u8>) -> Result<(Header, RawFrame), WireError> {
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
