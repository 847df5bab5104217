//! Measures the 3D position of a part of a hand: by the depth image, or by its disparity, comparing brightness
//! and silhouette in both images.

use nalgebra::{Point2, Point3};

use super::candidates::{HandCandidate, median};
use crate::camera::StereoCalibration;
use crate::frame::{DepthImage, RgbImage, StereoFrame};
use crate::mask::Mask;

/// Measures parts of one hand in one frame.
pub(crate) struct Ranging<'a> {
    calibration: &'a StereoCalibration,
    left: MaskedImage<'a>,
    by: By<'a>,
    /// Depth of the palm, m.
    z: f64,
}

enum By<'a> {
    Depth(&'a DepthImage),
    Eyes(MaskedImage<'a>),
}

impl<'a> Ranging<'a> {
    /// For a hand; `None` when there is neither a depth image nor a second image to measure with.
    pub(crate) fn of(
        frame: &'a StereoFrame,
        calibration: &'a StereoCalibration,
        hand: &'a HandCandidate,
    ) -> Option<Self> {
        let by = match (&hand.right, &frame.depth) {
            (Some(right), _) => By::Eyes(MaskedImage { image: &frame.right, hand: right }),
            (None, Some(depth)) => By::Depth(depth),
            (None, None) => return None,
        };
        let left = MaskedImage { image: &frame.left, hand: &hand.left };
        let mut ranging = Self { calibration, left, by, z: hand.z };
        let palm = ranging.depth(&hand.shape.palm, 0.75 * hand.shape.palm_radius);
        ranging.z = palm.unwrap_or(hand.z);
        Some(ranging)
    }

    /// The centre of the palm's visible surface at a pixel, left camera frame, m.
    pub(crate) fn palm(&self, px: &Point2<f64>) -> Point3<f64> {
        Point3::from(self.calibration.camera.ray(px) * self.z)
    }

    /// The surface point of the hand at a pixel, measured from the part within `radius` m of another one beside it, left camera frame, m.
    pub(crate) fn point(&self, px: &Point2<f64>, beside: &Point2<f64>, radius: f64) -> Option<Point3<f64>> {
        let z = self.depth(beside, radius)?;
        Some(Point3::from(self.calibration.camera.ray(px) * z))
    }

    /// The depth of the hand's part within `radius` m of a pixel, m, if the depth image measures it.
    pub(crate) fn measured(&self, px: &Point2<f64>, radius: f64) -> Option<f64> {
        matches!(self.by, By::Depth(_)).then(|| self.depth(px, radius)).flatten()
    }

    fn depth(&self, px: &Point2<f64>, radius: f64) -> Option<f64> {
        let (focal, baseline) = (self.calibration.camera.focal, self.calibration.baseline);
        let radius_px = radius * focal / self.z;
        match self.by {
            By::Depth(depth) => depth_about(depth, px, radius_px, |x, y| self.left.hand.contains(x, y)),
            By::Eyes(right) => {
                let guess = focal * baseline / self.z;
                // All parts of a hand lie within 0.1 m of its palm in depth.
                let range = (0.1 * guess / self.z).ceil().clamp(3.0, 40.0) as i64 + 1;
                let disparity = disparity(self.left, right, px, radius_px, guess, range)?;
                (disparity > 0.1).then(|| focal * baseline / disparity)
            }
        }
    }
}

/// The median depth of the pixels within `radius` px that count, m.
pub(crate) fn depth_about(
    depth: &DepthImage,
    center: &Point2<f64>,
    radius: f64,
    counts: impl Fn(i64, i64) -> bool,
) -> Option<f64> {
    if !(radius.is_finite() && center.coords.amax().is_finite()) {
        return None;
    }
    let (cx, cy, r) = (center.x.round() as i64, center.y.round() as i64, radius.clamp(2.0, 60.0) as i64);
    let about = (cy - r..=cy + r).flat_map(|y| (cx - r..=cx + r).map(move |x| (x, y)));
    let inside = |&(x, y): &(i64, i64)| (x - cx) * (x - cx) + (y - cy) * (y - cy) <= r * r && counts(x, y);
    let depths = about.filter(inside).map(|(x, y)| depth.at(x as u32, y as u32));
    median(depths.filter(|z| *z > 0.0).collect())
}

/// One camera's image with the mask of the hand.
#[derive(Clone, Copy)]
struct MaskedImage<'a> {
    image: &'a RgbImage,
    hand: &'a Mask,
}

/// Highest cost of one pixel, and the cost of a pixel that is hand in one image only, grey levels.
const MAX_BRIGHTNESS_STEP: f64 = 30.0;

/// The disparity (px, positive: farther left in the right image) of the part within `radius` px of `center` in the
/// left image, searched within `range` px of `guess`, with subpixel accuracy. `None` when the best is at the end of
/// the range or the part has too few pixels of the hand.
fn disparity(
    left: MaskedImage<'_>,
    right: MaskedImage<'_>,
    center: &Point2<f64>,
    radius: f64,
    guess: f64,
    range: i64,
) -> Option<f64> {
    if !(radius.is_finite() && guess.is_finite() && center.coords.amax().is_finite()) {
        return None;
    }
    let pixels = disc(left, center, radius.min(60.0));
    if pixels.iter().filter(|p| p.2).count() < 12 {
        return None;
    }
    let middle = guess.round() as i64;
    let costs: Vec<f64> = (middle - range..=middle + range).map(|d| cost(&pixels, right, d)).collect();
    let best = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
    if best == 0 || best + 1 == costs.len() {
        return None;
    }
    let (before, at, after) = (costs[best - 1], costs[best], costs[best + 1]);
    let curvature = before - 2.0 * at + after;
    let part = if curvature > 1e-12 { 0.5 * (before - after) / curvature } else { 0.0 };
    Some((middle - range + best as i64) as f64 + part)
}

/// The disc's pixels: column, row, whether the pixel is hand, brightness.
fn disc(view: MaskedImage<'_>, center: &Point2<f64>, radius: f64) -> Vec<(i64, i64, bool, f64)> {
    let (cx, cy, r) = (center.x.round() as i64, center.y.round() as i64, radius.ceil() as i64);
    let mut pixels = Vec::new();
    for y in cy.saturating_sub(r)..=cy.saturating_add(r) {
        for x in cx.saturating_sub(r)..=cx.saturating_add(r) {
            if ((x - cx) * (x - cx) + (y - cy) * (y - cy)) as f64 <= radius * radius
                && let Some(brightness) = brightness(view.image, x, y)
            {
                pixels.push((x, y, view.hand.contains(x, y), brightness));
            }
        }
    }
    pixels
}

fn cost(pixels: &[(i64, i64, bool, f64)], right: MaskedImage<'_>, d: i64) -> f64 {
    let one = |&(x, y, hand, value): &(i64, i64, bool, f64)| match (hand, right.hand.contains(x - d, y)) {
        (false, false) => 0.0,
        (true, true) => brightness(right.image, x - d, y)
            .map_or(MAX_BRIGHTNESS_STEP, |v| (v - value).abs().min(MAX_BRIGHTNESS_STEP)),
        _ => MAX_BRIGHTNESS_STEP,
    };
    pixels.iter().map(one).sum()
}

fn brightness(image: &RgbImage, x: i64, y: i64) -> Option<f64> {
    let inside = x >= 0 && y >= 0 && x < i64::from(image.width()) && y < i64::from(image.height());
    inside.then(|| image.pixel(x as u32, y as u32).iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::Region;

    /// A shaded disc about (`x`, 40).
    fn eye(x: f64) -> (RgbImage, Mask) {
        let off = |u: u32, v: u32| (f64::from(u) - x, f64::from(v) - 40.0);
        let inside = |(dx, dy): (f64, f64)| dx * dx + dy * dy <= 400.0;
        let level = |(dx, dy)| if inside((dx, dy)) { (120.0 + 4.0 * dx + 2.0 * dy) as u8 } else { 10 };
        let whole = Region::whole(120, 80);
        let mask = Mask::of(whole, whole.pixels().map(|(u, v)| inside(off(u, v))));
        (RgbImage::painted(120, 80, |u, v| [level(off(u, v)); 3]), mask)
    }

    #[test]
    fn finds_fractions_of_a_pixel() {
        let (left_image, left_mask) = eye(70.0);
        for shift in [20.0, 20.3, 20.5, 21.8] {
            let (image, mask) = eye(70.0 - shift);
            let left = MaskedImage { image: &left_image, hand: &left_mask };
            let right = MaskedImage { image: &image, hand: &mask };
            let d = disparity(left, right, &Point2::new(70.0, 40.0), 15.0, 19.0, 6).unwrap();
            assert!((d - shift).abs() < 0.2, "{d} for {shift}");
            assert!(disparity(left, right, &Point2::new(70.0, 40.0), 15.0, 30.0, 3).is_none());
            assert!(disparity(left, right, &Point2::new(f64::NAN, 40.0), 15.0, 30.0, 3).is_none());
        }
    }
}
