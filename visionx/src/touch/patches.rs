//! Compares square patches of two pictures, at places between pixels.

use nalgebra::{Point2, Vector2};

use crate::frame::RgbImage;

/// Half the edge of a patch, px, and the distance of the pixels of it that are compared.
pub(super) const HALF: i32 = 4;
const EVERY: usize = 2;

/// How unlike two patches are: the root of the mean squared difference of their colours, 0 to 255; `None` where one is not wholly in
/// its picture.
///
/// `at`: the middle of the first patch; `there`: that of the second, which may be between pixels.
pub(super) fn difference(
    (image, at): (&RgbImage, Point2<i32>),
    (other, there): (&RgbImage, &Point2<f64>),
) -> Option<f64> {
    let (corner, part) = (there.map(f64::floor), there - there.map(f64::floor));
    let corner = Point2::new(corner.x as i64, corner.y as i64);
    let (half, [w, h]) = (i64::from(HALF), [other.width(), other.height()].map(i64::from));
    let inside = |p: Point2<i64>, w: i64, h: i64| {
        p.x >= half && p.y >= half && p.x + half + 1 < w && p.y + half + 1 < h
    };
    let at = at.map(i64::from);
    if !there.iter().all(|x| x.is_finite())
        || !inside(corner, w, h)
        || !inside(at, i64::from(image.width()), i64::from(image.height()))
    {
        return None;
    }
    let weights =
        [(1.0 - part.x) * (1.0 - part.y), part.x * (1.0 - part.y), (1.0 - part.x) * part.y, part.x * part.y]
            .map(|weight| weight as f32);
    let start = |image: &RgbImage, x: i64, y: i64| 3 * (y as usize * image.width() as usize + x as usize);
    let row = 3 * other.width() as usize;
    let (mut sum, mut n) = (0.0f32, 0u32);
    for dy in (-half..=half).step_by(EVERY) {
        for dx in (-half..=half).step_by(EVERY) {
            let a = &image.data()[start(image, at.x + dx, at.y + dy)..];
            let b = start(other, corner.x + dx, corner.y + dy);
            let (above, below) = (&other.data()[b..b + 6], &other.data()[b + row..b + row + 6]);
            for channel in 0..3 {
                let four = [above[channel], above[channel + 3], below[channel], below[channel + 3]];
                let mixed: f32 = four.iter().zip(&weights).map(|(c, weight)| f32::from(*c) * weight).sum();
                sum += (f32::from(a[channel]) - mixed).powi(2);
                n += 1;
            }
        }
    }
    Some(f64::from(sum / n as f32).sqrt())
}

/// How a patch of an earlier picture is found in a later one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// Where it was.
    Still,
    /// Where the hand's motion, or a part of it, would have brought it.
    Moved,
    /// Nowhere on that way: something else hides it, or it has changed.
    Otherwise,
}

/// Differences up to this are the sensor's noise.
const NOISE: f64 = 6.0;
/// A patch has moved where it fits better by this factor, at least by this share of the hand's motion.
const BETTER: f64 = 0.6;
const MOVED: f64 = 0.35;
/// How far along the hand's motion and across it a patch is looked for, in steps of a part of that motion.
const STEPS: [i32; 2] = [6, 2];
const STEP: f64 = 0.2;

/// Where a patch has gone that would be at `still` in the other picture, or at `still + motion` if it moved with the hand.
pub(super) fn find(
    patch: (&RgbImage, Point2<i32>),
    other: &RgbImage,
    (still, motion): (&Point2<f64>, &Vector2<f64>),
) -> Option<Found> {
    let unmoved = difference(patch, (other, still))?;
    if unmoved <= NOISE {
        return Some(Found::Still);
    }
    let across = Vector2::new(-motion.y, motion.x);
    let [far, wide] = STEPS;
    let mut best = (unmoved, 0);
    for along in 0..=far {
        for aside in -wide..=wide {
            let there = still + (motion * f64::from(along) + across * f64::from(aside)) * STEP;
            let Some(difference) = difference(patch, (other, &there)) else { continue };
            if difference < best.0 {
                best = (difference, along);
            }
        }
    }
    let (least, along) = best;
    Some(match f64::from(along) * STEP >= MOVED && least < BETTER * unmoved && least < 2.0 * NOISE {
        true => Found::Moved,
        false => Found::Otherwise,
    })
}
