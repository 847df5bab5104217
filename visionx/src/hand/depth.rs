//! The disparity of a part of a hand, by comparing its brightness and its silhouette in both eyes.

use nalgebra::Point2;

use crate::frame::Image;
use crate::mask::Mask;

/// One eye: its image, and the hand's pixels in it.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) image: &'a Image,
    pub(super) hand: &'a Mask,
}

/// What one pixel costs at most, and what it costs to be hand in one eye and not in the other, grey levels.
const MOST: f64 = 30.0;

/// The disparity (px, positive: farther left in the right image) of what lies within `radius` px of `center` in the
/// left eye, searched within `range` px of `guess`; to a fraction of a pixel. `None` when the best is at the end of
/// the range or the part has too few pixels of the hand.
pub(super) fn disparity(
    left: View<'_>,
    right: View<'_>,
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

/// The disc's pixels: column, row, whether it is hand, brightness.
fn disc(view: View<'_>, center: &Point2<f64>, radius: f64) -> Vec<(i64, i64, bool, f64)> {
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

fn cost(pixels: &[(i64, i64, bool, f64)], right: View<'_>, d: i64) -> f64 {
    let one = |&(x, y, hand, value): &(i64, i64, bool, f64)| match (hand, right.hand.contains(x - d, y)) {
        (false, false) => 0.0,
        (true, true) => brightness(right.image, x - d, y).map_or(MOST, |v| (v - value).abs().min(MOST)),
        _ => MOST,
    };
    pixels.iter().map(one).sum()
}

fn brightness(image: &Image, x: i64, y: i64) -> Option<f64> {
    let inside = x >= 0 && y >= 0 && x < i64::from(image.width()) && y < i64::from(image.height());
    inside.then(|| image.pixel(x as u32, y as u32).iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::Region;

    /// A shaded disc about (`x`, 40).
    fn eye(x: f64) -> (Image, Mask) {
        let mut mask = Mask::empty(Region::whole(120, 80));
        let mut data = Vec::new();
        for i in 0..120 * 80 {
            let (dx, dy) = ((i % 120) as f64 - x, (i / 120) as f64 - 40.0);
            let inside = dx * dx + dy * dy <= 400.0;
            mask.data_mut()[i] = u8::from(inside);
            data.extend([if inside { (120.0 + 4.0 * dx + 2.0 * dy) as u8 } else { 10 }; 3]);
        }
        (Image::from_rgb(120, 80, data).unwrap(), mask)
    }

    #[test]
    fn finds_fractions_of_a_pixel() {
        let (left_image, left_mask) = eye(70.0);
        for shift in [20.0, 20.3, 20.5, 21.8] {
            let (image, mask) = eye(70.0 - shift);
            let left = View { image: &left_image, hand: &left_mask };
            let right = View { image: &image, hand: &mask };
            let d = disparity(left, right, &Point2::new(70.0, 40.0), 15.0, 19.0, 6).unwrap();
            assert!((d - shift).abs() < 0.2, "{d} for {shift}");
            assert!(disparity(left, right, &Point2::new(70.0, 40.0), 15.0, 30.0, 3).is_none());
            assert!(disparity(left, right, &Point2::new(f64::NAN, 40.0), 15.0, 30.0, 3).is_none());
        }
    }
}
