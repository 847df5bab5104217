//! The measurement of a marker in one image: coloured pixels counted in rectangles, their likelihood for a position of
//! the marker, and their centroid. It keeps no track and no time.

use nalgebra::{Point2, Point3};

use crate::camera::StereoCalibration;
use crate::mask::{Mask, Region};

/// The coloured pixels of one image near the expected position.
pub(super) struct Blob {
    /// Their centroid, px.
    pub(super) center: Point2<f64>,
    /// Number of pixels.
    pub(super) area: f64,
}

/// Summed coloured pixels of one image, for counting in rectangles.
pub(super) struct Counts {
    width: i64,
    height: i64,
    origin: (i64, i64),
    sums: Vec<u32>,
}

/// Widest occlusion of a row that counts as narrow, share of the search radius.
const NARROW: f64 = 0.5;

/// Likelihood of the images for a marker at `point`: coloured inside its disc, not coloured around it.
pub(super) fn likelihood(
    point: &Point3<f64>,
    counts: &[Counts; 2],
    calibration: &StereoCalibration,
    diameter: f64,
) -> f64 {
    let mut sum = 0.0;
    for (eye, shift) in counts.iter().zip([0.0, calibration.baseline]) {
        let Some(at) = calibration.camera.project_shifted(point, shift) else { return 0.0 };
        let radius = 0.5 * diameter * calibration.camera.focal / point.z;
        // The square inside the disc should be full, the frame around the disc's square empty.
        let (coloured, all) = eye.sum(&at, 0.7 * radius);
        let inner = (coloured / all.max(1.0)).min(1.0);
        let (outer, square) = (eye.sum(&at, 1.5 * radius), eye.sum(&at, radius));
        let ring = (outer.0 - square.0) / (outer.1 - square.1).max(1.0);
        sum += inner - 0.5 * ring;
    }
    libm::exp(4.0 * sum)
}

/// The centroid of the coloured pixels about `at`, by mean shift with a disc that is wider than the marker.
pub(super) fn centroid(mask: &Mask, mut at: Point2<f64>, radius_px: f64) -> Option<Blob> {
    let reach = 1.4 * radius_px + 2.0;
    let mut measurement = None;
    for _ in 0..6 {
        let next = disc_mean(mask, &at, reach)?;
        let moved = (next.center - at).norm();
        at = next.center;
        measurement = Some(next);
        if moved < 0.02 {
            break;
        }
    }
    measurement
}

/// Centroid and area of the coloured pixels in a disc of `reach` px. A narrow gap between coloured pixels of a row is
/// something in front of the marker, such as its handle, and counts as the marker.
fn disc_mean(mask: &Mask, at: &Point2<f64>, reach: f64) -> Option<Blob> {
    let region = mask.region();
    let (w, h) = (region.x + region.width, region.y + region.height);
    let part = Region::around([*at], reach, w, h);
    let narrow = NARROW * reach;
    let (mut n, mut sx, mut sy) = (0.0, 0.0, 0.0);
    for y in part.y.max(region.y)..part.y + part.height {
        let dy = f64::from(y) - at.y;
        let half = (reach * reach - dy * dy).max(0.0).sqrt();
        let x0 = ((at.x - half).ceil().max(f64::from(region.x))) as u32;
        let x1 = ((at.x + half).floor().min(f64::from(w) - 1.0)).max(-1.0) as i64;
        let row = mask.row((y - region.y) as usize);
        let mut end = None;
        for x in (x0..u32::try_from(x1 + 1).unwrap_or(0)).filter(|x| row[(x - region.x) as usize] != 0) {
            let from = end.filter(|&end| f64::from(x - end) <= narrow).unwrap_or(x);
            let count = f64::from(x + 1 - from);
            n += count;
            sx += count * f64::from(from + x) / 2.0;
            sy += count * f64::from(y);
            end = Some(x + 1);
        }
    }
    (n > 0.0).then(|| Blob { center: Point2::new(sx / n, sy / n), area: n })
}

impl Counts {
    /// Sums over the square of half width `reach` px about `at`, clipped to the mask.
    pub(super) fn about(mask: &Mask, at: &Point2<f64>, reach: f64) -> Self {
        let whole = mask.region();
        let region = Region::around([*at], reach, whole.width, whole.height);
        let (w, h) = (region.width as usize, region.height as usize);
        let mut sums = vec![0; (w + 1) * (h + 1)];
        for y in 0..h {
            let row = &mask.row(region.y as usize + y)[region.x as usize..][..w];
            let mut run = 0;
            for (x, v) in row.iter().enumerate() {
                run += u32::from(*v);
                sums[(y + 1) * (w + 1) + x + 1] = sums[y * (w + 1) + x + 1] + run;
            }
        }
        Self { width: w as i64, height: h as i64, origin: (i64::from(region.x), i64::from(region.y)), sums }
    }

    /// Number of coloured pixels, and of all pixels, in the square of half width `half` about `at`. Outside of
    /// the counted part nothing is coloured.
    fn sum(&self, at: &Point2<f64>, half: f64) -> (f64, f64) {
        let clip =
            |v: f64, origin: i64, end: i64| (v.round() as i64).saturating_sub(origin).clamp(0, end) as usize;
        let (x0, x1) =
            (clip(at.x - half, self.origin.0, self.width), clip(at.x + half, self.origin.0, self.width));
        let (y0, y1) =
            (clip(at.y - half, self.origin.1, self.height), clip(at.y + half, self.origin.1, self.height));
        let w = self.width as usize + 1;
        let inside = self.sums[y1 * w + x1] + self.sums[y0 * w + x0];
        let outside = self.sums[y0 * w + x1] + self.sums[y1 * w + x0];
        (f64::from(inside - outside), (2.0 * half).powi(2))
    }
}
