//! Conversion of camera formats to RGB and to depth, and of frames to PNG or JPEG.

use std::borrow::Cow;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError as CodingError};

use super::frame::{PixelFormat, RawFrame, RawImage};
use super::wire::{Header, ImageCoding};
use crate::frame::{DepthImage, RgbImage};
use crate::jpeg::{JPEG_QUALITY, JpegPixel, encode_jpeg};

/// Converts the image to RGB. This includes gray and raw Bayer images; depth and organised point clouds are coloured
/// from near (red) to far (blue). `None` for an unorganised point cloud.
pub fn rgb_of(image: &RawImage) -> Option<RgbImage> {
    let (width, height) = (image.width(), image.height());
    let data = match image.format() {
        PixelFormat::Rgb8 => image.bytes().to_vec(),
        PixelFormat::Gray8 => image.bytes().iter().flat_map(|v| [*v; 3]).collect(),
        PixelFormat::BayerRggb8 => bayer(image, [0, 0]),
        PixelFormat::BayerGrbg8 => bayer(image, [1, 0]),
        PixelFormat::BayerGbrg8 => bayer(image, [0, 1]),
        PixelFormat::BayerBggr8 => bayer(image, [1, 1]),
        PixelFormat::Depth32F | PixelFormat::Depth16 | PixelFormat::Points32F => {
            return depth_of(image).and_then(|depth| colors_of(&depth));
        }
    };
    RgbImage::from_rgb(width, height, data).ok()
}

/// The depth of a depth image or of an organised point cloud. Invalid values become 0.
pub fn depth_of(image: &RawImage) -> Option<DepthImage> {
    let (width, height) = (image.width(), image.height());
    let usable = |z: f32| if z.is_finite() && z > 0.0 { z } else { 0.0 };
    let data: Vec<f32> = match image.format() {
        PixelFormat::Depth16 => words(image.bytes()).map(|mm| f32::from(mm) * 1e-3).collect(),
        PixelFormat::Depth32F => floats(image.bytes()).map(usable).collect(),
        PixelFormat::Points32F if height > 1 => {
            floats(image.bytes()).skip(2).step_by(3).map(usable).collect()
        }
        _ => return None,
    };
    Some(DepthImage { width, height, data })
}

fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

fn words(bytes: &[u8]) -> impl Iterator<Item = u16> {
    bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]))
}

/// Bilinear interpolation of a Bayer image: each colour is the mean of its pixels in the 3 x 3 neighbourhood.
/// `red` is the position of the first red pixel.
fn bayer(image: &RawImage, red: [usize; 2]) -> Vec<u8> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let bytes = image.bytes();
    let channel = |x: usize, y: usize| match ((x + red[0]) % 2, (y + red[1]) % 2) {
        (0, 0) => 0,
        (1, 1) => 2,
        _ => 1,
    };
    let mut data = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let (mut sums, mut counts) = ([0u32; 3], [0u32; 3]);
            for v in y.saturating_sub(1)..(y + 2).min(height) {
                for u in x.saturating_sub(1)..(x + 2).min(width) {
                    let own = channel(x, y) == channel(u, v);
                    if !own || (u, v) == (x, y) {
                        sums[channel(u, v)] += u32::from(bytes[v * width + u]);
                        counts[channel(u, v)] += 1;
                    }
                }
            }
            // An image of one pixel or row lacks some colours; they become black.
            data.extend([0, 1, 2].map(|c| ((sums[c] + counts[c] / 2) / counts[c].max(1)) as u8));
        }
    }
    data
}

/// Depth in colours, from red (nearest) over green to blue (farthest); black where there is none.
fn colors_of(depth: &DepthImage) -> Option<RgbImage> {
    let seen = || depth.data.iter().copied().filter(|z| *z > 0.0);
    let (near, far) = (seen().fold(f32::MAX, f32::min), seen().fold(0.0, f32::max));
    let color = |z: f32| {
        if z <= 0.0 {
            return [0; 3];
        }
        let t = (z - near) / (far - near).max(1e-6);
        let ramp = |at: f32| ((1.0 - 2.0 * (t - at).abs()).clamp(0.0, 1.0) * 255.0) as u8;
        [ramp(0.0), ramp(0.5), ramp(1.0)]
    };
    let data = depth.data.iter().flat_map(|z| color(*z)).collect();
    RgbImage::from_rgb(depth.width, depth.height, data).ok()
}

/// The bytes of a JPEG file of an RGB image.
///
/// # Errors
/// When the encoder fails, for instance because a side is longer than 65535 px.
pub fn jpeg(image: &RgbImage) -> Result<Vec<u8>, CodingError> {
    let mut bytes = Vec::new();
    let size = (image.width(), image.height());
    encode_jpeg(&mut bytes, image.data(), size, JpegPixel::Rgb, JPEG_QUALITY)?;
    Ok(bytes)
}

/// Encodes the frame's images as files, with the matching header. Depth in metres is sent as millimetres in 16 bit,
/// up to 65.5 m. JPEG would corrupt raw Bayer and depth images, so these become PNG. Point clouds stay raw.
///
/// # Errors
/// When an encoder fails.
pub fn coded(
    frame: &RawFrame,
    coding: ImageCoding,
    epoch: u64,
    sent_ns: u64,
) -> Result<(Header, Vec<u8>), CodingError> {
    let mut header = Header::raw(frame, epoch, sent_ns);
    let mut bytes = Vec::new();
    for (image, said) in frame.images.iter().zip(&mut header.images) {
        let start = bytes.len();
        match (image.format(), coding) {
            (_, ImageCoding::Raw) | (PixelFormat::Points32F, _) => bytes.extend(image.bytes()),
            (format @ (PixelFormat::Rgb8 | PixelFormat::Gray8), ImageCoding::Jpeg) => {
                let pixel = if format == PixelFormat::Rgb8 { JpegPixel::Rgb } else { JpegPixel::Gray };
                said.coding = ImageCoding::Jpeg;
                let size = (image.width(), image.height());
                encode_jpeg(&mut bytes, image.bytes(), size, pixel, JPEG_QUALITY)?;
            }
            (format, _) => {
                said.coding = ImageCoding::Png;
                if format == PixelFormat::Depth32F {
                    said.format = PixelFormat::Depth16;
                }
                png(&mut bytes, image)?;
            }
        }
        said.bytes = (bytes.len() - start) as u64;
    }
    Ok((header, bytes))
}

/// Encodes a depth image as PNG, 16 bit gray, mm, as [`crate::files::read_depth`] reads it; `None` when it is not a
/// depth image.
///
/// # Errors
/// When the encoder fails.
pub fn depth_png(image: &RawImage) -> Result<Option<Vec<u8>>, CodingError> {
    if !matches!(image.format(), PixelFormat::Depth32F | PixelFormat::Depth16) {
        return Ok(None);
    }
    let mut bytes = Vec::new();
    png(&mut bytes, image)?;
    Ok(Some(bytes))
}

/// Depth in mm, 16 bit in native byte order; 0 where there is none.
fn native_mm(image: &RawImage) -> Vec<u8> {
    if image.format() == PixelFormat::Depth16 {
        return words(image.bytes()).flat_map(u16::to_ne_bytes).collect();
    }
    let mm = |z: f32| if z.is_finite() { (z * 1e3).round().clamp(0.0, 65_535.0) as u16 } else { 0 };
    floats(image.bytes()).map(mm).flat_map(u16::to_ne_bytes).collect()
}

/// Depth becomes 16 bit gray, mm; raw Bayer 8 bit gray.
fn png(into: &mut Vec<u8>, image: &RawImage) -> Result<(), CodingError> {
    let (data, color) = match image.format() {
        PixelFormat::Depth32F | PixelFormat::Depth16 => (native_mm(image).into(), ExtendedColorType::L16),
        PixelFormat::Rgb8 => (Cow::from(image.bytes()), ExtendedColorType::Rgb8),
        _ => (image.bytes().into(), ExtendedColorType::L8),
    };
    let encoder = PngEncoder::new_with_quality(into, CompressionType::Fast, FilterType::Adaptive);
    encoder.write_image(&data, image.width(), image.height(), color)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::providers::PixelOwner;

    fn image(role: &str, format: PixelFormat, size: (u32, u32), bytes: Vec<u8>) -> RawImage {
        RawImage::new(role, format, size, bytes).unwrap()
    }

    #[test]
    fn a_flat_colour_behind_each_bayer_filter_is_that_colour() {
        let color = [200u8, 100, 50];
        let (width, height) = (6usize, 5usize);
        for (format, rows) in [
            (PixelFormat::BayerRggb8, [[0, 1], [1, 2]]),
            (PixelFormat::BayerBggr8, [[2, 1], [1, 0]]),
            (PixelFormat::BayerGrbg8, [[1, 0], [2, 1]]),
            (PixelFormat::BayerGbrg8, [[1, 2], [0, 1]]),
        ] {
            let raw = (0..height).flat_map(|y| (0..width).map(move |x| color[rows[y % 2][x % 2]])).collect();
            let rgb = rgb_of(&image("left", format, (6, 5), raw)).unwrap();
            assert!(rgb.data().chunks(3).all(|pixel| pixel == color), "{format:?}");
        }
        assert!(rgb_of(&image("left", PixelFormat::BayerRggb8, (1, 1), vec![9])).is_some());
    }

    #[test]
    fn depth_is_read_in_metres_from_each_format() {
        let metres = [0.5f32, f32::NAN, -1.0, 2.0];
        let bytes: Vec<u8> = metres.iter().flat_map(|z| z.to_le_bytes()).collect();
        let depth = depth_of(&image("depth", PixelFormat::Depth32F, (2, 2), bytes)).unwrap();
        assert_eq!(depth.data, [0.5, 0.0, 0.0, 2.0]);
        let bytes: Vec<u8> = [500u16, 0, 0, 2000].iter().flat_map(|z| z.to_le_bytes()).collect();
        assert_eq!(depth_of(&image("depth", PixelFormat::Depth16, (2, 2), bytes)).unwrap(), depth);
        let points =
            metres.iter().flat_map(|z| [0.0, 1.0, *z]).flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
        let organised = image("points", PixelFormat::Points32F, (2, 2), points.clone());
        assert_eq!(depth_of(&organised).unwrap(), depth);
        let list = image("points", PixelFormat::Points32F, (4, 1), points);
        assert!(depth_of(&list).is_none() && rgb_of(&list).is_none());
        let colors = rgb_of(&organised).unwrap();
        assert_eq!(
            [colors.pixel(0, 0), colors.pixel(1, 0), colors.pixel(1, 1)],
            [[255, 0, 0], [0; 3], [0, 0, 255]]
        );
    }

    #[test]
    fn depth_as_a_file_is_read_back_in_millimetres() {
        let metres: Vec<u8> =
            [0.5f32, f32::NAN, f32::INFINITY, 70.0].iter().flat_map(|z| z.to_le_bytes()).collect();
        let file = depth_png(&image("depth", PixelFormat::Depth32F, (2, 2), metres)).unwrap().unwrap();
        let (_, _, bytes) = crate::files::decode_gray(&file, true).unwrap();
        assert_eq!(words(&bytes).collect::<Vec<u16>>(), [500, 0, 0, u16::MAX]);
        assert!(depth_png(&image("gray", PixelFormat::Gray8, (1, 1), vec![1])).unwrap().is_none());
    }

    #[test]
    fn png_is_lossless_and_jpeg_close() {
        let (width, height) = (16u32, 12u32);
        let ramp =
            |n: usize| (0..width as usize * height as usize * n).map(|i| (i / n) as u8).collect::<Vec<u8>>();
        let depth: Vec<u8> = (0..192u16).flat_map(|i| (f32::from(i) * 0.01).to_le_bytes()).collect();
        let frame = RawFrame {
            images: vec![
                image("left", PixelFormat::Rgb8, (width, height), ramp(3)),
                image("gray", PixelFormat::Gray8, (width, height), ramp(1)),
                image("raw", PixelFormat::BayerBggr8, (width, height), ramp(1)),
                image("mm", PixelFormat::Depth16, (width, height), ramp(2)),
                image("depth", PixelFormat::Depth32F, (width, height), depth),
                image("points", PixelFormat::Points32F, (3, 1), vec![0; 36]),
            ],
            ..RawFrame::default()
        };
        for coding in [ImageCoding::Png, ImageCoding::Jpeg] {
            let (header, bytes) = coded(&frame, coding, 1, 1).unwrap();
            let owner: Arc<dyn PixelOwner> = Arc::new(bytes);
            let back = header.frame(&owner).unwrap();
            for (image, sent) in back.images.iter().zip(&frame.images) {
                let lossy = coding == ImageCoding::Jpeg && matches!(image.role(), "left" | "gray");
                if image.role() == "depth" {
                    let metres = depth_of(image).unwrap().data;
                    assert!(metres.iter().zip(0..).all(|(z, i)| (z - 0.01 * i as f32).abs() < 6e-4));
                } else if lossy {
                    let far = |(a, b): (&u8, &u8)| a.abs_diff(*b) > 12;
                    assert!(!image.bytes().iter().zip(sent.bytes()).any(far), "{}", image.role());
                } else {
                    assert_eq!(image, sent);
                }
            }
        }
    }
}
