//! JPEG files: pixels become one, and whether one is all there. Its decoder fills up with gray what is missing, which is good
//! for looking at a photograph and bad for saying what is on it.

use std::io::{BufRead, ErrorKind, Read, Result, copy, sink};

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError as CodingError};

/// Quality where nothing is said, of 100.
pub const JPEG_QUALITY: u8 = 85;

/// What a pixel of a JPEG file holds.
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

/// Appends a JPEG file of rows of pixels, `width` by `height`, to `file`. `quality` is 1 to 100.
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
    // The encoder takes a wrong length for a mistake of the program.
    let wanted = u64::from(width) * u64::from(height) * pixel.bytes() as u64;
    if pixels.len() as u64 != wanted {
        let what = image::error::ParameterErrorKind::DimensionMismatch;
        return Err(CodingError::Parameter(image::error::ParameterError::from_kind(what)));
    }
    JpegEncoder::new_with_quality(file, quality.clamp(1, 100)).write_image(pixels, width, height, color)
}

const END_OF_IMAGE: u8 = 0xD9;

/// Whether the bytes go on to the marker that ends the image (ITU-T T.81, B.1.1.3), behind all of its scans. A thumbnail among the
/// segments has an end of its own, which is not it.
///
/// # Errors
/// When they cannot be read.
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
            // Nothing belongs to the start of an image, a restart, and the one for private use.
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

/// The next marker. What lies before it is passed over: the coded data of a scan, in which a zero follows each byte that
/// could be taken for one.
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
