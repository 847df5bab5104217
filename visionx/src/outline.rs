//! Silhouettes of convex bodies in an image, and how much of them a mask covers.

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};

use crate::camera::PinholeCamera;
use crate::frame::RgbImage;
use crate::mask::{Mask, Region};

/// A convex polygon in an image, corners in px, in order (the inside is to the left when y points up, to the right
/// with the image's y down).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ConvexOutline {
    corners: Vec<Point2<f64>>,
    /// For each edge its outward unit normal and the normal's product with its first corner.
    edges: Vec<([f64; 2], f64)>,
}

/// Pixels of one kind in a part of an image, as sums along rows; integrates over parts of rows.
#[derive(Clone, Debug)]
pub(crate) struct RowSums {
    region: Region,
    sums: Vec<u32>,
}

/// The silhouette of a box of edge lengths `size` (m) about its own origin. `shift`: position of the camera along
/// the left camera's x, m. `None` when a corner is not in front of the camera.
pub(crate) fn box_outline(
    camera: &PinholeCamera,
    shift: f64,
    left_from_box: &Isometry3<f64>,
    size: &Vector3<f64>,
) -> Option<ConvexOutline> {
    let mut points = [Point2::origin(); 8];
    for (i, p) in points.iter_mut().enumerate() {
        let sign = |bit: usize| if i >> bit & 1 == 0 { -0.5 } else { 0.5 };
        let corner = Point3::new(sign(0) * size.x, sign(1) * size.y, sign(2) * size.z);
        let corner = left_from_box * corner;
        if corner.z < 0.05 {
            return None;
        }
        *p = camera.project_shifted(&corner, shift)?;
    }
    ConvexOutline::hull(&mut points)
}

impl ConvexOutline {
    /// The convex hull (Andrew's monotone chain); `None` when all points lie on one line.
    pub(crate) fn hull(points: &mut [Point2<f64>]) -> Option<Self> {
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        let cross = |o: &Point2<f64>, a: &Point2<f64>, b: &Point2<f64>| (a - o).perp(&(b - o));
        let mut hull: Vec<Point2<f64>> = Vec::with_capacity(points.len() + 1);
        let mut chain = |order: &mut dyn Iterator<Item = &Point2<f64>>| {
            let start = hull.len();
            for p in order {
                while hull.len() >= start + 2
                    && cross(&hull[hull.len() - 2], &hull[hull.len() - 1], p) <= 1e-12
                {
                    hull.pop();
                }
                hull.push(*p);
            }
            hull.pop();
        };
        chain(&mut points.iter());
        chain(&mut points.iter().rev());
        (hull.len() >= 3).then(|| Self::from_corners(hull))
    }

    fn from_corners(corners: Vec<Point2<f64>>) -> Self {
        let edges = (0..corners.len())
            .map(|i| {
                let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                let d = (b - a).normalize();
                let normal = [d.y, -d.x];
                (normal, normal[0] * a.x + normal[1] * a.y)
            })
            .collect();
        Self { corners, edges }
    }

    /// The corners, px.
    pub(crate) fn corners(&self) -> &[Point2<f64>] {
        &self.corners
    }

    /// Area, px^2.
    pub(crate) fn area(&self) -> f64 {
        area(&self.corners)
    }

    /// Centroid, px.
    pub(crate) fn centroid(&self) -> Point2<f64> {
        let next = self.corners.iter().cycle().skip(1);
        let parts =
            self.corners.iter().zip(next).map(|(a, b)| ((a.coords + b.coords), a.coords.perp(&b.coords)));
        let (sum, twice) =
            parts.fold((Vector2::zeros(), 0.0), |(sum, all), (ab, area)| (sum + ab * area, all + area));
        Point2::from(sum / (3.0 * twice))
    }

    /// Area of what is in a camera's picture, px^2: clipped at its four borders (Sutherland and Hodgman 1974).
    pub(crate) fn area_in(&self, camera: &PinholeCamera) -> f64 {
        let mut corners = self.corners.clone();
        for (axis, size) in [camera.width, camera.height].into_iter().enumerate() {
            for (border, sign) in [(-0.5, 1.0), (f64::from(size) - 0.5, -1.0)] {
                let inside = |p: &Point2<f64>| sign * (p[axis] - border);
                let mut clipped = Vec::with_capacity(corners.len() + 2);
                for (i, p) in corners.iter().enumerate() {
                    let next = corners[(i + 1) % corners.len()];
                    let (here, there) = (inside(p), inside(&next));
                    if here >= 0.0 {
                        clipped.push(*p);
                    }
                    if (here >= 0.0) != (there >= 0.0) {
                        clipped.push(p + (next - p) * (here / (here - there)));
                    }
                }
                corners = clipped;
            }
        }
        area(&corners)
    }

    /// Distance from the outline, px, negative inside. Outside of a corner it is the distance from the nearer edge's
    /// line.
    pub(crate) fn signed_distance(&self, p: &Point2<f64>) -> f64 {
        self.edges.iter().map(|(n, c)| n[0] * p.x + n[1] * p.y - c).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Smallest and largest x and y: `[x0, y0, x1, y1]`, px.
    pub(crate) fn bounds(&self) -> [f64; 4] {
        self.corners.iter().fold([f64::MAX, f64::MAX, f64::MIN, f64::MIN], |b, p| {
            [b[0].min(p.x), b[1].min(p.y), b[2].max(p.x), b[3].max(p.y)]
        })
    }

    /// The columns where the outline crosses the height `y`, px.
    fn span(&self, y: f64) -> Option<(f64, f64)> {
        let (mut x0, mut x1) = (f64::MAX, f64::MIN);
        let n = self.corners.len();
        for i in 0..n {
            let (a, b) = (self.corners[i], self.corners[(i + 1) % n]);
            if (a.y <= y) != (b.y <= y) {
                let x = a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y);
                (x0, x1) = (x0.min(x), x1.max(x));
            }
        }
        (x0 < x1).then_some((x0, x1))
    }

    /// The number of pixels of each kind inside, with fractions at the border. Changes smoothly with the corners.
    pub(crate) fn integrate<const N: usize>(&self, kinds: [&RowSums; N]) -> [f64; N] {
        const LINES: i64 = 4;
        let [_, y0, _, y1] = self.bounds();
        let region = kinds[0].region;
        let clip =
            |y: f64| (y.round() as i64).clamp(i64::from(region.y), i64::from(region.y + region.height));
        let mut totals = [0.0; N];
        for row in clip(y0)..(clip(y1) + 1).min(i64::from(region.y + region.height)) {
            for line in 0..LINES {
                let y = row as f64 + (line as f64 + 0.5) / LINES as f64 - 0.5;
                let Some((x0, x1)) = self.span(y) else { continue };
                for (total, kind) in totals.iter_mut().zip(kinds) {
                    *total += (kind.up_to(row, x1) - kind.up_to(row, x0)) / LINES as f64;
                }
            }
        }
        totals
    }
}

/// Area of a polygon, px^2.
fn area(corners: &[Point2<f64>]) -> f64 {
    let n = corners.len();
    (0..n).map(|i| corners[i].coords.perp(&corners[(i + 1) % n].coords)).sum::<f64>().abs() / 2.0
}

impl RowSums {
    /// Sums of a mask's rows.
    pub(crate) fn of(mask: &Mask) -> Self {
        let (w, h) = (mask.width(), mask.height());
        let mut sums = vec![0; (w + 1) * h];
        for y in 0..h {
            let mut run = 0;
            for (x, v) in mask.row(y).iter().enumerate() {
                run += u32::from(*v);
                sums[y * (w + 1) + x + 1] = run;
            }
        }
        Self { region: mask.region(), sums }
    }

    /// Pixels of a row (in the region) left of `x` px, where pixel `i` covers `i - 1/2 .. i + 1/2`.
    fn up_to(&self, row: i64, x: f64) -> f64 {
        let w = self.region.width as usize;
        let sums = &self.sums[(row - i64::from(self.region.y)) as usize * (w + 1)..][..=w];
        let at = (x + 0.5 - f64::from(self.region.x)).clamp(0.0, w as f64);
        let i = at as usize;
        let part = if i < w { (at - i as f64) * f64::from(sums[i + 1] - sums[i]) } else { 0.0 };
        f64::from(sums[i]) + part
    }
}

/// A point half way between neighbouring pixels of which only one is set, px, and the way to the one that is not set.
pub(crate) struct BorderPoint {
    pub(crate) at: Point2<f64>,
    outwards: (i64, i64),
}

impl BorderPoint {
    /// What an image shows so far outside, px.
    pub(crate) fn outside(&self, image: &RgbImage, px: i64) -> [u8; 3] {
        let (dx, dy) = self.outwards;
        let along =
            |from: f64, way: i64| u32::try_from((from + (px as f64 - 0.5) * way as f64).round() as i64);
        match (along(self.at.x, dx), along(self.at.y, dy)) {
            (Ok(x), Ok(y)) => image.pixel(x, y),
            _ => [0; 3],
        }
    }
}

/// The border of a mask. There are no points at the border of the image (`width` x `height`), because what lies beyond it is unknown.
pub(crate) fn border_points(mask: &Mask, width: u32, height: u32) -> Vec<BorderPoint> {
    let mut points = Vec::new();
    for (x, y) in mask.pixels() {
        for outwards in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            let (dx, dy) = outwards;
            let (nx, ny) = (x + dx, y + dy);
            let inside = nx >= 0 && ny >= 0 && nx < i64::from(width) && ny < i64::from(height);
            if inside && !mask.contains(nx, ny) {
                let at = Point2::new(x as f64 + 0.5 * dx as f64, y as f64 + 0.5 * dy as f64);
                points.push(BorderPoint { at, outwards });
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, half: f64) -> ConvexOutline {
        let mut points: Vec<_> = [(-1.0, -1.0), (1.0, -1.0), (0.0, 0.2), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(dx, dy)| Point2::new(x + dx * half, y + dy * half))
            .to_vec();
        ConvexOutline::hull(&mut points).unwrap()
    }

    #[test]
    fn a_square_has_four_corners_and_signed_distances() {
        let s = square(10.0, 20.0, 4.0);
        assert_eq!(s.corners().len(), 4);
        assert!((s.area() - 64.0).abs() < 1e-12);
        assert!((s.signed_distance(&Point2::new(10.0, 20.0)) + 4.0).abs() < 1e-12);
        assert!((s.signed_distance(&Point2::new(16.0, 21.0)) - 2.0).abs() < 1e-12);
        assert!(
            ConvexOutline::hull(&mut [Point2::new(0.0, 0.0), Point2::new(1.0, 1.0), Point2::new(2.0, 2.0)])
                .is_none()
        );
    }

    #[test]
    fn of_what_the_picture_cuts_off_the_part_inside_counts() {
        let camera = PinholeCamera { width: 640, height: 480, focal: 500.0, center: [320.0, 240.0] };
        for (at, inside) in
            [((100.0, 100.0), 64.0), ((-0.5, 100.0), 32.0), ((639.5, 479.5), 16.0), ((-9.0, 9.0), 0.0)]
        {
            assert!((square(at.0, at.1, 4.0).area_in(&camera) - inside).abs() < 1e-9, "{at:?}");
        }
    }

    #[test]
    fn integration_counts_covered_fractions() {
        let mut mask = Mask::empty(Region { x: 2, y: 3, width: 20, height: 30 });
        mask.data_mut().fill(1);
        let sums = RowSums::of(&mask);
        // Fully inside the mask, so the result is the area. From x 2.25 to 10.25 and y 20.5 to 28.5.
        assert!((square(6.25, 24.5, 4.0).integrate([&sums])[0] - 64.0).abs() < 1e-9);
        // The mask's left border is at x = 1.5: half of the square is outside.
        assert!((square(1.5, 20.5, 4.0).integrate([&sums])[0] - 32.0).abs() < 1e-9);
        assert_eq!(square(500.0, -700.0, 4.0).integrate([&sums])[0], 0.0);
    }

    #[test]
    fn a_box_seen_from_the_front_is_its_front_face() {
        let camera = PinholeCamera { width: 640, height: 480, focal: 500.0, center: [320.0, 240.0] };
        let pose = Isometry3::translation(0.0, 0.0, 1.05);
        let outline = box_outline(&camera, 0.0, &pose, &Vector3::new(0.2, 0.1, 0.1)).unwrap();
        assert_eq!(outline.bounds(), [270.0, 215.0, 370.0, 265.0]);
        assert!(box_outline(&camera, 0.0, &Isometry3::identity(), &Vector3::new(0.2, 0.1, 0.1)).is_none());
    }
}
