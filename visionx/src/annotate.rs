//! Draws results into images: masks, boxes, crosses, lines; and encodes PNG files. For people only; nothing
//! measures on these images.

use nalgebra::Point2;

use crate::frame::RgbImage;
use crate::localizer::ObjectEstimate;
use crate::marker::MarkerEstimate;
use crate::mask::Region;
use crate::tracking::hand::HandObservation;
use crate::tracking::{BodyLandmarks, HandInPicture, HandLandmarks, HandOutline, SkinSegmentation};

/// Why a picture could not be encoded.
#[derive(Debug, thiserror::Error)]
#[error("the picture cannot be encoded as PNG")]
pub struct EncodeError(#[source] image::ImageError);

/// Sets a pixel; does nothing outside of the image.
pub fn pixel(image: &mut RgbImage, x: i64, y: i64, color: [u8; 3]) {
    let (w, h) = (i64::from(image.width()), i64::from(image.height()));
    if x >= 0 && y >= 0 && x < w && y < h {
        let i = (y * w + x) as usize * 3;
        image.data_mut()[i..i + 3].copy_from_slice(&color);
    }
}

/// Draws a straight line, one pixel wide, clipped to the image. Draws nothing when a point is not finite.
pub fn line(image: &mut RgbImage, from: &Point2<f64>, to: &Point2<f64>, color: [u8; 3]) {
    let length = (to - from).amax();
    let limit = 4.0 * f64::from(image.width().max(image.height()));
    if !from.coords.amax().is_finite() || !length.is_finite() || length > limit {
        return;
    }
    let steps = length.ceil().max(1.0) as u32;
    for i in 0..=steps {
        let p = from + (to - from) * (f64::from(i) / f64::from(steps));
        pixel(image, p.x.round() as i64, p.y.round() as i64, color);
    }
}

/// Draws a closed polygon.
pub fn polygon(image: &mut RgbImage, corners: &[Point2<f64>], color: [u8; 3]) {
    for (i, corner) in corners.iter().enumerate() {
        line(image, corner, &corners[(i + 1) % corners.len()], color);
    }
}

/// Draws an upright cross with arms of `arm` px.
pub fn cross(image: &mut RgbImage, at: &Point2<f64>, arm: f64, color: [u8; 3]) {
    line(image, &Point2::new(at.x - arm, at.y), &Point2::new(at.x + arm, at.y), color);
    line(image, &Point2::new(at.x, at.y - arm), &Point2::new(at.x, at.y + arm), color);
}

/// Draws a circle.
pub fn circle(image: &mut RgbImage, center: &Point2<f64>, radius: f64, color: [u8; 3]) {
    let n = 48;
    let corners: Vec<_> = (0..n)
        .map(|i| f64::from(i) * std::f64::consts::TAU / f64::from(n))
        .map(|a| Point2::new(center.x + radius * libm::cos(a), center.y + radius * libm::sin(a)))
        .collect();
    polygon(image, &corners, color);
}

/// Draws a mark of at least 3 px around a position.
pub fn mark(image: &mut RgbImage, at: &Point2<f64>, radius: f64) {
    circle(image, at, radius.max(3.0), [255, 255, 0]);
    cross(image, at, 3.0, [255, 255, 0]);
}

/// Draws the border of a region.
pub fn region(image: &mut RgbImage, region: &Region, color: [u8; 3]) {
    let (x0, y0) = (f64::from(region.x), f64::from(region.y));
    let (x1, y1) = (x0 + f64::from(region.width) - 1.0, y0 + f64::from(region.height) - 1.0);
    let corners = [Point2::new(x0, y0), Point2::new(x1, y0), Point2::new(x1, y1), Point2::new(x0, y1)];
    polygon(image, &corners, color);
}

/// Draws a tracked marker into the left image: a green cross in a circle.
pub fn marker(image: &mut RgbImage, marker: &MarkerEstimate) {
    cross(image, &marker.left_px, 9.0, [0, 255, 0]);
    circle(image, &marker.left_px, 12.0, [0, 255, 0]);
}

/// Draws a located object's outline into the left image.
pub fn object(image: &mut RgbImage, object: &ObjectEstimate) {
    polygon(image, &object.outline_left, [255, 0, 255]);
}

/// Draws a hand into the left image: its box, palm, fingertips and where it points.
pub fn hand(image: &mut RgbImage, hand: &HandObservation) {
    region(image, &hand.bounding_box, [0, 255, 255]);
    circle(image, &hand.palm_px, hand.palm_radius_px, [255, 255, 0]);
    for tip in &hand.fingertips {
        circle(image, &tip.px, 5.0, [255, 0, 0]);
        line(image, &hand.palm_px, &tip.px, [255, 0, 0]);
    }
}

/// Draws a hand that was found in a single image: its box, palm and fingertips, and its bones, or the rest of the image darker.
pub fn hand_in_picture(image: &mut RgbImage, hand: &HandInPicture) {
    match &hand.outline {
        HandOutline::Silhouette(segmentation) => silhouette(image, segmentation),
        HandOutline::Landmarks(landmarks) => bones(image, landmarks),
    }
    region(image, &hand.bounding_box, [255, 40, 200]);
    circle(image, &hand.palm, hand.palm_radius, [0, 255, 0]);
    for tip in &hand.fingertips {
        for radius in [6.0, 7.0, 8.0] {
            circle(image, &tip.px, radius, [255, 255, 0]);
        }
        line(image, &hand.palm, &tip.px, [255, 255, 0]);
    }
}

/// Draws lines from the wrist along the fingers.
fn bones(image: &mut RgbImage, hand: &HandLandmarks) {
    for finger in hand.points[1..].chunks_exact(4) {
        let from = std::iter::once(&hand.points[0]).chain(finger);
        from.zip(finger).for_each(|(from, to)| line(image, from, to, [0, 255, 255]));
    }
}

/// Draws a person's arms, shoulders and head.
pub fn body(image: &mut RgbImage, body: &BodyLandmarks) {
    for arm in [[12, 14], [14, 16], [11, 13], [13, 15], [11, 12]] {
        let [from, to] = arm.map(|i| body.points[i]);
        line(image, &from, &to, [0, 255, 255]);
    }
    for joint in [7, 8, 11, 12, 13, 14, 15, 16] {
        let right = joint % 2 == 0;
        circle(image, &body.points[joint], 4.0, if right { [255, 0, 0] } else { [0, 255, 0] });
    }
}

/// Darkens all pixels outside of a segmented hand.
pub fn silhouette(image: &mut RgbImage, hand: &SkinSegmentation) {
    for (x, y) in Region::whole(image.width(), image.height()).pixels() {
        let (u, v) = ((f64::from(x) / hand.scale) as i64, (f64::from(y) / hand.scale) as i64);
        if !hand.mask.contains(u, v) {
            let dark = image.pixel(x, y).map(|c| c / 2);
            pixel(image, i64::from(x), i64::from(y), dark);
        }
    }
}

/// Encodes an image as PNG.
///
/// # Errors
/// When the encoder refuses, as for an image without pixels.
pub fn png(image: &RgbImage) -> Result<Vec<u8>, EncodeError> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let (width, height, rgb) = (image.width(), image.height(), image::ExtendedColorType::Rgb8);
    let png = image::ImageFormat::Png;
    let written = image::write_buffer_with_format(&mut bytes, image.data(), width, height, rgb, png);
    written.map(|()| bytes.into_inner()).map_err(EncodeError)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn black(width: u32, height: u32) -> RgbImage {
        RgbImage::painted(width, height, |_, _| [0; 3])
    }

    #[test]
    fn png_keeps_the_pixels() {
        let mut picture = black(20, 10);
        line(&mut picture, &Point2::new(2.0, 3.0), &Point2::new(12.0, 3.0), [1, 2, 3]);
        cross(&mut picture, &Point2::new(15.0, 5.0), 2.0, [9, 8, 7]);
        let bytes = png(&picture).unwrap();
        let read = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!(read.as_raw().as_slice(), picture.data());
        assert_eq!(picture.pixel(7, 3), [1, 2, 3]);
        assert_eq!(picture.data().iter().filter(|&&v| v == 1).count(), 11);
    }

    #[test]
    fn nothing_is_drawn_outside() {
        let mut picture = black(8, 8);
        let far = Point2::new(f64::MAX, f64::NAN);
        line(&mut picture, &far, &Point2::origin(), [255; 3]);
        circle(&mut picture, &Point2::new(-50.0, 400.0), 3.0, [255; 3]);
        region(&mut picture, &Region { x: 100, y: 100, width: 3, height: 3 }, [255; 3]);
        polygon(&mut picture, &[], [255; 3]);
        assert_eq!(picture, black(8, 8));
        assert!(png(&black(0, 0)).is_err());
    }
}
