//! Reads images from files and folders. Memory is bounded, and no file can make the program panic.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::{Path, PathBuf};

use armarium_source::Finding;
use image::{DynamicImage, ImageReader, Limits};

use crate::frame::RgbImage;
use crate::jpeg;

/// Most pixels of an image.
pub const MAX_PIXELS: u64 = 128_000_000;
/// Longest side of an image, px.
const MAX_SIDE: u32 = 32_768;
/// Largest file, bytes.
const MAX_FILE_BYTES: u64 = 512 << 20;
/// Memory limit of a decoder beside the pixels, bytes: for colour profiles and text in the file.
const MAX_METADATA_BYTES: u64 = 32 << 20;
/// Memory limit of a decoder for the pixels, bytes: 4 bytes a pixel and some reserve.
const MAX_PIXEL_BYTES: u64 = 768 << 20;
/// Most bytes per pixel: four channels of 16 bit.
const MAX_BYTES_PER_PIXEL: u64 = 8;
/// The first bytes of a JPEG file.
const JPEG: [u8; 2] = [0xFF, 0xD8];
/// File name extensions of images.
const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Why a file is not a usable image.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// It cannot be read.
    #[error("cannot be read: {0}")]
    Read(#[source] std::io::Error),
    /// It is not a PNG or JPEG image, or it is damaged.
    #[error("is not a PNG or JPEG image that can be decoded: {}", .0.to_string().trim_end())]
    Decode(#[source] image::ImageError),
    /// It is an image, but not a depth image.
    #[error("is no depth image: that is 16 bit gray, mm, as PNG, and this is {0}")]
    NotDepth(String),
    /// It is a JPEG image whose end is missing.
    #[error("is a JPEG image that is cut short: its end is missing; copy it again from where it came")]
    CutShort,
    /// It has too many pixels, or a side that is too long.
    #[error("{width} x {height} pixels are more than {MAX_PIXELS}, or a side is longer than {MAX_SIDE}")]
    TooLarge {
        /// Width, px.
        width: u32,
        /// Height, px.
        height: u32,
    },
    /// The file is larger than any accepted image.
    #[error("is {0} bytes long; at most {MAX_FILE_BYTES} are read")]
    TooLong(u64),
    /// The folder contains no image.
    #[error("there is no PNG or JPEG file in it")]
    Empty,
    /// A file that describes cameras does not.
    #[error("does not describe cameras: {}", .0.first().map_or_else(String::new, ToString::to_string))]
    Calibration(Vec<Finding>),
}

/// Reads a PNG or JPEG file with the pixels as stored: the file's orientation tag is not applied. Transparency is
/// dropped, grey becomes RGB.
///
/// # Errors
/// [`FileError`] when there is no such image or it is too large.
pub fn read_image(path: &Path) -> Result<RgbImage, FileError> {
    rgb(open(path)?)
}

/// Decodes the bytes of a PNG or JPEG file; see [`read_image`].
///
/// # Errors
/// [`FileError`] when they are not such an image or it is too large.
pub fn decode_image(bytes: &[u8]) -> Result<RgbImage, FileError> {
    rgb(Cursor::new(bytes))
}

/// Reads a depth image: a PNG file of 16 bit gray, millimetres. Returns width and height, px, and two little-endian
/// bytes per pixel.
///
/// # Errors
/// [`FileError`] when there is no such image or it is too large.
pub fn read_depth(path: &Path) -> Result<(u32, u32, Vec<u8>), FileError> {
    gray(open(path)?, true)
}

/// Decodes the bytes of a gray PNG or JPEG file to width and height, px, and one byte per pixel. With `wide` it decodes
/// a depth image; see [`read_depth`].
///
/// # Errors
/// [`FileError`] when they are not such an image or it is too large.
pub fn decode_gray(bytes: &[u8], wide: bool) -> Result<(u32, u32, Vec<u8>), FileError> {
    gray(Cursor::new(bytes), wide)
}

fn gray<R: BufRead + Seek>(from: R, wide: bool) -> Result<(u32, u32, Vec<u8>), FileError> {
    let image = decoded(from)?;
    let (width, height) = (image.width(), image.height());
    let bytes = match image {
        DynamicImage::ImageLuma16(depth) if wide => {
            depth.into_raw().into_iter().flat_map(u16::to_le_bytes).collect()
        }
        // Grey levels computed from colours are not distances.
        other if wide => return Err(FileError::NotDepth(kind(&other))),
        other => other.into_luma8().into_raw(),
    };
    Ok((width, height, bytes))
}

/// The kind of an image, for messages.
fn kind(image: &DynamicImage) -> String {
    let color = image.color();
    let bits = color.bits_per_pixel() / u16::from(color.channel_count().max(1));
    let what = if color.has_color() { "in colours" } else { "gray" };
    let alpha = if color.has_alpha() { ", with transparency" } else { "" };
    format!("{bits} bit {what}{alpha}")
}

/// Lists the images that `paths` name. A file stands for itself, a folder for the images in it, sorted by name, without
/// hidden files.
///
/// # Errors
/// The path and [`FileError`] when a folder cannot be read or has no image.
pub fn images_in(paths: &[PathBuf]) -> Result<Vec<PathBuf>, (PathBuf, FileError)> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            files.extend(folder(path).map_err(|error| (path.clone(), error))?);
        } else {
            files.push(path.clone());
        }
    }
    Ok(files)
}

fn folder(path: &Path) -> Result<Vec<PathBuf>, FileError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(FileError::Read)? {
        let file = entry.map_err(FileError::Read)?.path();
        if file.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b".")) {
            continue;
        }
        let ending = file.extension().map(|e| e.to_string_lossy().to_lowercase());
        if ending.is_some_and(|e| ENDINGS.contains(&e.as_str())) {
            files.push(file);
        }
    }
    files.sort();
    if files.is_empty() { Err(FileError::Empty) } else { Ok(files) }
}

fn open(path: &Path) -> Result<BufReader<File>, FileError> {
    let file = File::open(path).map_err(FileError::Read)?;
    let bytes = file.metadata().map_err(FileError::Read)?.len();
    if bytes > MAX_FILE_BYTES { Err(FileError::TooLong(bytes)) } else { Ok(BufReader::new(file)) }
}

/// Width and height, px, of an image that is not too large; does not decode the pixels.
pub(crate) fn size_of<R: BufRead + Seek>(from: R) -> Result<(u32, u32), FileError> {
    let size = decoder(from, MAX_METADATA_BYTES)?.into_dimensions().map_err(FileError::Decode)?;
    let (width, height) = size;
    if u64::from(width) * u64::from(height) > MAX_PIXELS || width.max(height) > MAX_SIDE {
        return Err(FileError::TooLarge { width, height });
    }
    Ok(size)
}

/// A decoder that takes at most `most_bytes` of memory.
fn decoder<R: BufRead + Seek>(from: R, most_bytes: u64) -> Result<ImageReader<R>, FileError> {
    let mut reader = ImageReader::new(from).with_guessed_format().map_err(FileError::Read)?;
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(most_bytes);
    reader.limits(limits);
    Ok(reader)
}

fn rgb<R: BufRead + Seek>(from: R) -> Result<RgbImage, FileError> {
    let rgb = decoded(from)?.into_rgb8();
    let (width, height) = (rgb.width(), rgb.height());
    RgbImage::from_rgb(width, height, rgb.into_raw()).map_err(|_| FileError::TooLarge { width, height })
}

/// Decodes an image that is not too large.
fn decoded<R: BufRead + Seek>(mut from: R) -> Result<DynamicImage, FileError> {
    let (width, height) = size_of(&mut from)?;
    from.rewind().map_err(FileError::Read)?;
    let is_jpeg = from.fill_buf().map_err(FileError::Read)?.starts_with(&JPEG);
    if is_jpeg && !jpeg::is_whole(&mut from).map_err(FileError::Read)? {
        return Err(FileError::CutShort);
    }
    from.rewind().map_err(FileError::Read)?;
    let pixels = u64::from(width) * u64::from(height);
    let most_bytes = (pixels * MAX_BYTES_PER_PIXEL + MAX_METADATA_BYTES).min(MAX_PIXEL_BYTES);
    decoder(from, most_bytes)?.decode().map_err(FileError::Decode)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::annotate::png;

    #[test]
    fn a_file_is_read_as_it_was_written_and_a_folder_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let image = RgbImage::from_rgb(3, 2, (0..18).collect()).unwrap();
        for name in ["b.png", "a.PNG", "c.txt", "._a.PNG"] {
            std::fs::write(folder.path().join(name), png(&image).unwrap()).unwrap();
        }
        let files = images_in(&[folder.path().into()]).unwrap();
        let names: Vec<_> =
            files.iter().map(|f| f.file_name().unwrap().to_string_lossy().into_owned()).collect();
        assert_eq!(names, ["a.PNG", "b.png"]);
        assert_eq!(read_image(&files[0]).unwrap(), image);
        assert!(matches!(read_image(&folder.path().join("none.png")), Err(FileError::Read(_))));
        std::fs::create_dir(folder.path().join("empty")).unwrap();
        assert!(matches!(images_in(&[folder.path().join("empty")]), Err((_, FileError::Empty))));
    }

    /// A PNG whose header gives a size that its data do not have.
    fn promising(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = png(&RgbImage::from_rgb(1, 1, vec![7; 3]).unwrap()).unwrap();
        bytes[16..20].copy_from_slice(&width.to_be_bytes());
        bytes[20..24].copy_from_slice(&height.to_be_bytes());
        // Corrects the header's checksum, so that only the size is wrong.
        let mut crc = u32::MAX;
        for byte in &bytes[12..29] {
            crc ^= u32::from(*byte);
            (0..8).for_each(|_| crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 });
        }
        bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
        bytes
    }

    #[test]
    fn bombs_and_broken_files_are_errors() {
        assert!(decode_image(&promising(1, 1)).is_ok());
        assert!(matches!(decode_image(&promising(20_000, 20_000)), Err(FileError::TooLarge { .. })));
        assert!(decode_image(&promising(u32::MAX, u32::MAX)).is_err());
        assert!(decode_image(&promising(0, 10)).is_err());
        assert!(decode_image(&promising(9000, 9000)).is_err());
        let whole = png(&RgbImage::from_rgb(8, 8, vec![99; 192]).unwrap()).unwrap();
        for end in 0..whole.len() - 13 {
            assert!(decode_image(&whole[..end]).is_err(), "cut at {end}");
        }
        assert!(decode_image(b"\xff\xd8\xff\xe0 not much of a photograph").is_err());
    }

    #[test]
    fn only_gray_of_16_bit_is_depth() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a_depth.png");
        let gray = |value: u16| image::ImageBuffer::from_pixel(3, 2, image::Luma([value]));
        DynamicImage::ImageLuma16(gray(1234)).save(&file).unwrap();
        let (width, height, bytes) = read_depth(&file).unwrap();
        assert_eq!((width, height, bytes), (3, 2, [210, 4].repeat(6)));
        std::fs::write(&file, png(&RgbImage::from_rgb(1, 1, vec![7; 3]).unwrap()).unwrap()).unwrap();
        let error = read_depth(&file).unwrap_err().to_string();
        assert!(error.contains("16 bit gray") && error.ends_with("8 bit in colours"), "{error}");
    }

    #[test]
    fn a_photograph_that_is_cut_short_is_an_error() {
        let name = "tests/photographs/real_point_one.jpg";
        let whole = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap();
        let image = decode_image(&whole).unwrap();
        for end in (0..whole.len()).step_by(501).chain([whole.len() - 1]) {
            let error = decode_image(&whole[..end]).unwrap_err();
            let is_known = matches!(error, FileError::CutShort | FileError::Decode(_));
            assert!(
                is_known && (end < 5000 || matches!(error, FileError::CutShort)),
                "cut at {end}: {error}"
            );
        }
        // A camera may append more data after the image. A thumbnail before it has an end marker of its own.
        let mut more = whole.clone();
        more.extend_from_slice(b"\xff\xd8\xff\xd9 and more");
        assert_eq!(decode_image(&more).unwrap(), image);
        let thumbnail = b"\xff\xe1\x00\x0a\xff\xd8 123\xff\xd9";
        let with_thumbnail = [&whole[..2], thumbnail, &whole[2..]].concat();
        assert_eq!(decode_image(&with_thumbnail).unwrap(), image);
        let cut = &with_thumbnail[..with_thumbnail.len() / 2];
        assert!(matches!(decode_image(cut), Err(FileError::CutShort)));
    }
}
