//! Compares square patches of two pictures, at places between pixels.

use nalgebra::{Matrix2, Point2, Vector2};

use crate::frame::RgbImage;

/// Half the edge of a patch, px, and the distance of the pixels of it that are compared.
pub(super) const HALF: u32 = 5;
const EVERY: usize = 2;

/// A picture whose edges are a little soft, so that it can be compared between pixels: weights 1 2 1 along both axes.
pub(super) fn smooth(image: &RgbImage) -> RgbImage {
    let (w, h) = (image.width() as usize, image.height() as usize);
    let pass = |data: &[u8], count: usize, step: usize, place: &dyn Fn(usize) -> usize| -> Vec<u8> {
        let mixed = |i: usize| {
            let at = place(i);
            let before = data[if at > 0 { i - step } else { i }];
            let after = data[if at + 1 < count { i + step } else { i }];
            ((u16::from(before) + 2 * u16::from(data[i]) + u16::from(after) + 2) / 4) as u8
        };
        (0..data.len()).map(mixed).collect()
    };
    let across = pass(image.data(), w, 3, &|i| i / 3 % w);
    let both = pass(&across, h, 3 * w, &|i| i / 3 / w.max(1));
    RgbImage::from_rgb(image.width(), image.height(), both).unwrap_or_else(|_| image.clone())
}

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

/// The brightness of a picture between pixels, with its slopes along x and y, a pixel; `None` at its border.
fn sample(image: &RgbImage, at: &Point2<f64>) -> Option<(f64, Vector2<f64>)> {
    let corner = at.map(f64::floor);
    let (x, y) = (corner.x as i64, corner.y as i64);
    if !(x >= 1 && y >= 1 && x + 2 < i64::from(image.width()) && y + 2 < i64::from(image.height())) {
        return None;
    }
    let level = |dx: i64, dy: i64| {
        let color = image.pixel((x + dx) as u32, (y + dy) as u32);
        color.iter().map(|c| f64::from(*c)).sum::<f64>() / 3.0
    };
    let (u, v) = (at.x - corner.x, at.y - corner.y);
    let between = |of: &dyn Fn(i64, i64) -> f64| {
        (1.0 - v) * ((1.0 - u) * of(0, 0) + u * of(1, 0)) + v * ((1.0 - u) * of(0, 1) + u * of(1, 1))
    };
    let slope_x = |dx: i64, dy: i64| (level(dx + 1, dy) - level(dx - 1, dy)) / 2.0;
    let slope_y = |dx: i64, dy: i64| (level(dx, dy + 1) - level(dx, dy - 1)) / 2.0;
    Some((between(&level), Vector2::new(between(&slope_x), between(&slope_y))))
}

/// Steps of the alignment, the difference from which on one counts less, and the largest shift, px.
const ROUNDS: usize = 4;
const OUTLIER: f64 = 8.0;
const LARGEST: f64 = 3.0;

/// The shift of all of a picture against where it is expected to be, px (Lucas and Kanade 1981, for one shift, with Huber's weights): what
/// joint angles and stamps leave of the camera's own motion. `pairs` are pixels of the first picture, and where they would be in the other.
pub(super) fn align(
    image: &RgbImage,
    other: &RgbImage,
    pairs: &[(Point2<i32>, Point2<f64>)],
) -> Vector2<f64> {
    let mut shift = Vector2::zeros();
    let level = |at: &Point2<i32>| sample(image, &at.map(f64::from)).map(|(level, _)| level);
    let known: Vec<(f64, Point2<f64>)> =
        pairs.iter().filter_map(|(at, there)| Some((level(at)?, *there))).collect();
    for _ in 0..ROUNDS {
        let (mut normal, mut side) = (Matrix2::zeros(), Vector2::zeros());
        for (level, there) in &known {
            let Some((now, slope)) = sample(other, &(there + shift)) else { continue };
            let off = now - level;
            let weight = (OUTLIER / off.abs().max(OUTLIER)).powi(2);
            normal += slope * slope.transpose() * weight;
            side -= slope * (off * weight);
        }
        let Some(step) = normal.try_inverse().map(|inverse| inverse * side) else { return Vector2::zeros() };
        shift += step;
    }
    if shift.norm() < LARGEST { shift } else { Vector2::zeros() }
}

/// How a patch of an earlier picture is found in a later one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PatchMotion {
    /// Where it would be without the motion that is looked for.
    Still,
    /// Where that motion, or 60 % of it at least, would have brought it.
    Moved,
    /// Where less of that motion would have brought it.
    MovedLittle,
    /// Nowhere on that way: something else hides it, or it has changed.
    Otherwise,
}

/// Patches that would look as like as this after the motion say nothing.
const PLAIN: f64 = 9.0;

/// Whether a patch looks the same beside itself by a motion, so that it does not tell of that.
pub(super) fn is_plain((image, at): (&RgbImage, Point2<i32>), motion: &Vector2<f64>) -> Option<bool> {
    Some(difference((image, at), (image, &(at.map(f64::from) + motion)))? < PLAIN)
}

/// A patch is taken to be where it fits better than elsewhere by this factor.
const BETTER: f64 = 0.65;
/// A patch that fits nowhere better than this has changed.
const CHANGED: f64 = 14.0;
/// A still patch may be beside its place by this along both axes, px: pictures have pixels, and the camera's motion is not known exactly.
const BESIDE: f64 = 0.5;
/// The shares of the motion along which a patch is looked for that may have made a part of it, or that has made most of it, and across which.
pub(super) const ANY_PART: [f64; 6] = [0.25, 0.4, 0.6, 0.8, 1.0, 1.2];
pub(super) const MOST: [f64; 4] = [0.6, 0.8, 1.0, 1.2];
const ACROSS: [f64; 5] = [-0.4, -0.2, 0.0, 0.2, 0.4];

/// Where a patch has gone that would be at `still` in the other picture, or at `still + motion` if it made that motion. The shares of it count
/// `along`: [`ANY_PART`] or [`MOST`].
pub(super) fn find(
    patch: (&RgbImage, Point2<i32>),
    other: &RgbImage,
    (still, motion): (&Point2<f64>, &Vector2<f64>),
    along: &[f64],
) -> Option<PatchMotion> {
    let beside = [-BESIDE, 0.0, BESIDE];
    let around = beside.iter().flat_map(|x| beside.iter().map(move |y| Vector2::new(*x, *y)));
    let across = Vector2::new(-motion.y, motion.x);
    let at = |shift: Vector2<f64>| difference(patch, (other, &(still + shift)));
    let unmoved = around.filter_map(at).min_by(f64::total_cmp)?;
    let best_of = |share: &f64| {
        let carried = ACROSS.iter().map(|aside| motion * *share + across * *aside);
        Some((carried.filter_map(at).min_by(f64::total_cmp)?, *share))
    };
    let (moved, share) = along.iter().filter_map(best_of).min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(if unmoved < CHANGED && unmoved < BETTER * moved {
        PatchMotion::Still
    } else if moved < CHANGED && moved < BETTER * unmoved {
        if share < MOST[0] { PatchMotion::MovedLittle } else { PatchMotion::Moved }
    } else {
        PatchMotion::Otherwise
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth pattern, shifted by so many pixels.
    fn pattern(shift: Vector2<f64>) -> RgbImage {
        RgbImage::painted(80, 60, |x, y| {
            let (x, y) = (f64::from(x) - shift.x, f64::from(y) - shift.y);
            let level = 120.0 + 50.0 * libm::sin(x / 5.0) + 40.0 * libm::cos(y / 4.0 + x / 9.0);
            [level as u8, (level * 0.9) as u8, (level * 0.6) as u8]
        })
    }

    #[test]
    fn pictures_are_aligned_to_a_twentieth_of_a_pixel_while_a_part_of_them_moves_otherwise() {
        let shift = Vector2::new(0.4, -0.7);
        let (first, mut second) = (pattern(Vector2::zeros()), pattern(shift));
        let elsewhere = pattern(shift + Vector2::new(4.0, 3.0));
        for (x, y) in (10..25).flat_map(|y| (10..35).map(move |x| (x, y))) {
            let at = 3 * (y * 80 + x);
            second.data_mut()[at..at + 3].copy_from_slice(&elsewhere.data()[at..at + 3]);
        }
        let all = (2..58).flat_map(|y| (2..78).map(move |x| Point2::new(x, y)));
        let pairs: Vec<_> = all.map(|at| (at, at.map(f64::from))).collect();
        assert!((align(&first, &second, &pairs) - shift).norm() < 0.05);
        assert_eq!(align(&first, &second, &[]), Vector2::zeros());
    }

    #[test]
    fn a_patch_is_found_where_it_is() {
        let first = smooth(&pattern(Vector2::zeros()));
        let patch = (&first, Point2::new(40, 30));
        let (still, motion) = (Point2::new(40.0, 30.0), Vector2::new(4.0, 1.0));
        for (shift, found) in [
            (Vector2::new(0.3, -0.2), PatchMotion::Still),
            (motion, PatchMotion::Moved),
            (0.6 * motion, PatchMotion::Moved),
            (Vector2::new(-3.0, 4.0), PatchMotion::Otherwise),
        ] {
            let second = smooth(&pattern(shift));
            assert_eq!(find(patch, &second, (&still, &motion), &ANY_PART), Some(found), "{shift}");
            assert_eq!(find(patch, &second, (&still, &motion), &MOST), Some(found), "{shift}");
        }
        assert_eq!(find(patch, &first, (&Point2::new(2.0, 30.0), &motion), &ANY_PART), None);
        let little = smooth(&pattern(0.25 * motion));
        assert_eq!(find(patch, &little, (&still, &motion), &ANY_PART), Some(PatchMotion::MovedLittle));
        assert_ne!(find(patch, &little, (&still, &motion), &MOST), Some(PatchMotion::Moved));
    }
}
