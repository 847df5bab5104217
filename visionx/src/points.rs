//! The points of a depth image in the root frame, on a reduced grid of pixels.

use nalgebra::{Isometry3, Point2, Point3};

use crate::camera::PinholeCamera;
use crate::frame::DepthImage;
use crate::mask::Region;

/// From this distance on a point is less certain, m: the error of depth grows with its square.
const CERTAIN: f64 = 1.25;

/// A point of a depth image.
pub(crate) struct DepthPoint {
    /// Its position in the reduced image, row by row.
    pub(crate) place: usize,
    /// Its distance along the optical axis, m.
    pub(crate) depth: f32,
    /// Root frame, m.
    pub(crate) at: Point3<f64>,
}

/// The points of a depth image, of every so many pixels.
pub(crate) struct DepthPoints {
    /// The reduced image has every so many pixels.
    step: u32,
    /// Size of the reduced image.
    pub(crate) size: [usize; 2],
    pub(crate) points: Vec<DepthPoint>,
    /// For each place of the reduced image, one more than the index of its point; 0 without one.
    index: Vec<u32>,
}

impl DepthPoint {
    /// How uncertain its depth is, of a point that is near.
    pub(crate) fn scale(&self) -> f64 {
        uncertainty(f64::from(self.depth))
    }
}

/// How uncertain a depth is, of a near one: 1 up to 1.25 m, then its square over that.
pub(crate) fn uncertainty(depth: f64) -> f64 {
    (depth / CERTAIN).powi(2).max(1.0)
}

impl DepthPoints {
    /// The points of every `step`-th pixel along both axes, up to a depth of `farthest` m.
    pub(crate) fn of(
        depth: &DepthImage,
        camera: &PinholeCamera,
        root_from_left: &Isometry3<f64>,
        (step, farthest): (u32, f64),
    ) -> Self {
        let (w, h) = (depth.width / step, depth.height / step);
        let (mut points, mut index) = (Vec::new(), vec![0; (w * h) as usize]);
        for (x, y) in Region::whole(w, h).pixels() {
            let (u, v) = (x * step, y * step);
            let z = depth.data[(v * depth.width + u) as usize];
            if !(z > 0.0 && f64::from(z) <= farthest) {
                continue;
            }
            let ray = camera.ray(&Point2::new(f64::from(u), f64::from(v)));
            let at = root_from_left * Point3::from(ray * f64::from(z));
            let place = (y * w + x) as usize;
            points.push(DepthPoint { place, depth: z, at });
            index[place] = points.len() as u32;
        }
        Self { step, size: [w as usize, h as usize], points, index }
    }

    /// The index of the point that is nearest to a pixel of the depth image.
    pub(crate) fn nearest(&self, px: &Point2<f64>) -> Option<usize> {
        let [x, y] = [px.x, px.y].map(|v| (v / f64::from(self.step)).round() as i32);
        self.beside(0, (x, y))
    }

    /// The index of the point at a place of the reduced image, beside another place by so many columns and rows.
    pub(crate) fn beside(&self, place: usize, (right, down): (i32, i32)) -> Option<usize> {
        let [w, h] = self.size.map(|n| n as i64);
        let (x, y) = (place as i64 % w + i64::from(right), place as i64 / w + i64::from(down));
        let inside = (0..w).contains(&x) && (0..h).contains(&y);
        let index = inside.then(|| self.index[(y * w + x) as usize])?;
        (index as usize).checked_sub(1)
    }
}
