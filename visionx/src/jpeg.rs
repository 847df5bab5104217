//! Encodes JPEG files and checks that a JPEG file is complete. The decoder fills missing data with gray: good for
//! looking at a photograph, bad for measuring in it.

use std::io::{BufRead, ErrorKind, Read, Result, copy, sink};

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError as CodingError};

/// Default quality, of 100.
pub const JPEG_QUALITY: u8 = 85;

/// The pixel format of a JPEG file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JpegPixel {
    /// One byte of brightness.
    Gray,
    /// A byte each of red, green and blue.
    Rgb,
}

impl JpegPixel {
    /// Bytes of a pixel.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Gray => 1,
            Self::Rgb => 3,
        }
    }
}

/// Appends `width` by `height` pixels as a JPEG file to `file`. `quality` is 1 to 100.
///
/// # Errors
/// When the encoder fails, for instance because a side is longer than 65 535 pixels.
pub fn encode_jpeg(
    file: &mut Vec<u8>,
    pixels: &[u8],
    (width, height): (u32, u32),
    pixel: JpegPixel,
    quality: u8,
) -> std::result::Result<(), CodingError> {
    let color = match pixel {
        JpegPixel::Gray => ExtendedColorType::L8,
        JpegPixel::Rgb => ExtendedColorType::Rgb8,
    };
    // The encoder panics on a wrong length.
    let wanted = u64::from(width) * u64::from(height) * pixel.bytes() as u64;
    if pixels.len() as u64 != wanted {
        let what = image::error::ParameterErrorKind::DimensionMismatch;
        return Err(CodingError::Parameter(image::error::ParameterError::from_kind(what)));
    }
    JpegEncoder::new_with_quality(file, quality.clamp(1, 100)).write_image(pixels, width, height, color)
}

const END_OF_IMAGE: u8 = 0xD9;

/// Whether the bytes reach the marker that ends the image (ITU-T T.81, B.1.1.3), after all of its scans. The end of a
/// thumbnail inside a segment does not count.
pub(crate) fn is_whole(from: &mut impl BufRead) -> Result<bool> {
    match go_to_end(from) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
        gone => gone.map(|()| true),
    }
}

fn go_to_end(from: &mut impl BufRead) -> Result<()> {
    loop {
        match marker(from)? {
            END_OF_IMAGE => return Ok(()),
            // The start of an image, a restart and the private marker have no data.
            0x01 | 0xD0..=0xD8 => {}
            _ => {
                let mut length = [0; 2];
                from.read_exact(&mut length)?;
                let rest = u64::from(u16::from_be_bytes(length)).saturating_sub(2);
                copy(&mut from.take(rest), &mut sink())?;
            }
        }
    }
}

/// Finds the next marker and skips what lies before it: the coded data of a scan. In this data a zero follows each byte
/// that would look like a marker.
fn marker(from: &mut impl BufRead) -> Result<u8> {
    loop {
        from.skip_until(0xFF)?;
        let mut code = [0xFF];
        while code[0] == 0xFF {
            from.read_exact(&mut code)?;
        }
        if code[0] != 0 {
            return Ok(code[0]);
        }
    }
}
