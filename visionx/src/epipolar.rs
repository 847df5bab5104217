//! Checks whether a stereo pair fits its calibration: matches corners of the left image in the right one.
//!
//! Two identical, parallel cameras see a point in the same row. Where there is a depth image, the triangulated depth
//! must equal the measured one. This module does not calibrate.

use nalgebra::Point2;

use crate::camera::StereoCalibration;
use crate::frame::{RgbImage, StereoFrame};

/// Half the side of a compared patch, px.
const HALF: i64 = 5;
/// Largest searched distance of a match from the corner's row, px.
const ROWS: i64 = 6;
/// Side of the squares, px. Each contributes its best corner.
const GRID: i64 = 32;
/// Least mean difference of grey levels across a corner, along its weaker direction.
const MIN_CONTRAST: f64 = 8.0;
/// The best match must be better than any other by this factor; repeated patterns are ambiguous.
const DISTINCT: f64 = 0.7;

/// Deviations of stereo pairs from their calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EpipolarCheck {
    /// For each matched corner: how much lower it lies in the right image, px.
    pub rows_px: Vec<f64>,
    /// For each matched corner with a measured depth: triangulated depth over measured depth.
    pub depth_ratio: Vec<f64>,
}

impl EpipolarCheck {
    /// Checks a frame.
    pub fn of(frame: &StereoFrame, calibration: &StereoCalibration) -> Self {
        let mut check = Self::default();
        if !calibration.fits(frame) {
            return check;
        }
        let (left, right) = (Gray::of(&frame.left), Gray::of(&frame.right));
        for [x, y] in left.corners() {
            let Some(found) = left.find_in(&right, [x, y]) else { continue };
            check.rows_px.push(found.y - y as f64);
            let at = Point2::new(x as f64, y as f64);
            let depth = frame.depth.as_ref().and_then(|depth| calibration.camera.usable(depth));
            let measured = depth.map(|depth| depth.at(x as u32, y as u32)).filter(|z| *z > 0.0);
            if let (Some(point), Some(measured)) = (calibration.triangulate(&at, &found), measured) {
                check.depth_ratio.push(point.z / f64::from(measured));
            }
        }
        check
    }

    /// Adds the results of another frame.
    pub fn add(&mut self, other: Self) {
        self.rows_px.extend(other.rows_px);
        self.depth_ratio.extend(other.depth_ratio);
    }

    /// The median of the values; `None` when there are none.
    pub fn median(values: &[f64]) -> Option<f64> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied()
    }
}

struct Gray {
    width: i64,
    height: i64,
    data: Vec<i32>,
}

impl Gray {
    fn of(image: &RgbImage) -> Self {
        let data = image.data().chunks_exact(3).map(|p| p.iter().map(|v| i32::from(*v)).sum()).collect();
        Self { width: i64::from(image.width()), height: i64::from(image.height()), data }
    }

    /// Three times the grey level, for places inside the image only.
    fn at(&self, x: i64, y: i64) -> i32 {
        self.data[(y * self.width + x) as usize]
    }

    /// The best corner of each square (Shi and Tomasi: the smaller eigenvalue of the structure tensor).
    fn corners(&self) -> Vec<[i64; 2]> {
        let border = HALF + ROWS + 1;
        let mut corners = Vec::new();
        let squares = |size: i64| (border..size - border).step_by(GRID as usize);
        for top in squares(self.height) {
            for start in squares(self.width) {
                let rows = top..(top + GRID).min(self.height - border);
                let places = rows.flat_map(|y| {
                    (start..(start + GRID).min(self.width - border)).step_by(2).map(move |x| [x, y])
                });
                let scored = places.step_by(2).map(|at| (self.cornerness(at), at));
                let best = scored.max_by(|a, b| a.0.total_cmp(&b.0));
                corners.extend(best.filter(|(score, _)| score.sqrt() > MIN_CONTRAST).map(|(_, at)| at));
            }
        }
        corners
    }

    /// The smaller eigenvalue of the mean structure tensor around a place, grey levels squared.
    fn cornerness(&self, [x, y]: [i64; 2]) -> f64 {
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for v in y - 2..=y + 2 {
            for u in x - 2..=x + 2 {
                let dx = f64::from(self.at(u + 1, v) - self.at(u - 1, v)) / 6.0;
                let dy = f64::from(self.at(u, v + 1) - self.at(u, v - 1)) / 6.0;
                (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
            }
        }
        let (half, difference) = ((xx + yy) / 2.0, (xx - yy) / 2.0);
        (half - libm::hypot(difference, xy)).max(0.0) / 25.0
    }

    /// Finds a patch of this image in `other`, in about the same row and not further right, with subpixel accuracy
    /// along both axes. `None` when there is no match or more than one.
    fn find_in(&self, other: &Self, [x, y]: [i64; 2]) -> Option<Point2<f64>> {
        let cost = |u: i64, v: i64| {
            let mut sum = 0i64;
            for dy in -HALF..=HALF {
                for dx in -HALF..=HALF {
                    sum += i64::from((self.at(x + dx, y + dy) - other.at(u + dx, v + dy)).abs());
                }
            }
            sum
        };
        let inside = |u: i64| u > HALF && u < other.width - HALF - 1;
        let mut best = (i64::MAX, x, y);
        let mut costs = Vec::new();
        for v in y - ROWS..=y + ROWS {
            for u in (x - self.width / 3..=x).filter(|u| inside(*u)) {
                let c = cost(u, v);
                costs.push((c, u, v));
                best = best.min((c, u, v));
            }
        }
        let (least, u, v) = best;
        let elsewhere = costs.iter().filter(|(_, a, b)| (a - u).abs() > 2 || (b - v).abs() > 2);
        let second = elsewhere.map(|(c, _, _)| *c).min()?;
        let distinct = (least as f64) < DISTINCT * second as f64;
        // At the border of the search range the true minimum may lie beyond it.
        if !distinct || (v - y).abs() == ROWS || !inside(u - 1) || !inside(u + 1) {
            return None;
        }
        let vertex = |before: i64, after: i64| {
            let curvature = before + after - 2 * least;
            if curvature > 0 { (before - after) as f64 / (2 * curvature) as f64 } else { 0.0 }
        };
        let dx = vertex(cost(u - 1, v), cost(u + 1, v));
        let dy = vertex(cost(u, v - 1), cost(u, v + 1));
        Some(Point2::new(u as f64 + dx, v as f64 + dy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::DepthImage;
    use nalgebra::Isometry3;
    use rand::{RngExt, SeedableRng};
    use std::sync::Arc;

    const CALIBRATION: StereoCalibration = StereoCalibration {
        camera: crate::PinholeCamera { width: 320, height: 240, focal: 250.0, center: [160.0, 120.0] },
        baseline: 0.1,
    };

    /// A wall of random squares at 1 m, so the disparity is 25 px. The right camera stands `low` px too high.
    fn wall(low: i64) -> StereoFrame {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let texture: Vec<u8> = (0..80 * 80).map(|_| rng.random_range(40..220)).collect();
        let eye = |shift: i64, low: i64| {
            let level = |x: i64, y: i64| texture[((y + 20 - low) / 6 * 80 + (x + 20 + shift) / 6) as usize];
            RgbImage::painted(320, 240, |x, y| [level(x.into(), y.into()); 3])
        };
        StereoFrame {
            stamp_ns: 0,
            left: eye(0, 0).into(),
            right: eye(25, low).into(),
            depth: Some(Arc::new(DepthImage { width: 320, height: 240, data: vec![1.0; 320 * 240] })),
            root_from_left: Isometry3::identity(),
        }
    }

    #[test]
    fn a_pair_as_calibrated_shows_it_and_a_shifted_eye_or_wrong_baseline_too() {
        for low in [0, 3, -2] {
            let check = EpipolarCheck::of(&wall(low), &CALIBRATION);
            assert!(check.rows_px.len() > 30, "{}", check.rows_px.len());
            let rows = EpipolarCheck::median(&check.rows_px).unwrap();
            assert!((rows - low as f64).abs() < 0.1, "{rows} for {low}");
            let ratio = EpipolarCheck::median(&check.depth_ratio).unwrap();
            assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
        }
        let wide = StereoCalibration { baseline: 0.11, ..CALIBRATION };
        let ratio = EpipolarCheck::median(&EpipolarCheck::of(&wall(0), &wide).depth_ratio).unwrap();
        assert!((ratio - 1.1).abs() < 0.01, "{ratio}");
    }

    #[test]
    fn flat_and_small_pictures_show_nothing() {
        let eye = |level, (width, height)| RgbImage::painted(width, height, |_, _| [level; 3]);
        for (level, size) in [(0, (320, 240)), (255, (320, 240)), (90, (1, 1))] {
            let (left, right) = (eye(level, size), eye(level, size));
            let frame = StereoFrame { left: left.into(), right: right.into(), depth: None, ..wall(0) };
            assert_eq!(EpipolarCheck::of(&frame, &CALIBRATION), EpipolarCheck::default());
        }
        assert_eq!(EpipolarCheck::median(&[]), None);
    }
}
