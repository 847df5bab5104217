//! One flat surface of the environment: where its plane is, how certain that is, how far it goes, and whether it is there at all.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector3};

use super::grid::EDGE;
use crate::plane::Plane;
use crate::points::DepthPoint;
use crate::rectangle::Rectangle;

/// Edge of a cell of a surface, m.
pub(super) const CELL: f64 = 0.04;
/// Most cells of one surface; what it has beyond is not remembered.
const MAX_CELLS: usize = 16_384;
/// Standard deviation of a near point's depth, m.
const NOISE: f64 = 0.003;
/// Standard deviations of where the camera was in one picture: across a surface, m, and in its tilt, rad.
const POSE: (f64, f64) = (0.003, 0.003);
/// How long what was measured counts, s of seeing the surface.
const KEPT_S: f64 = 10.0;
/// Standard deviations of a plane of which nothing is known: of its height at the anchor, m, and of its slopes.
const UNTOLD: (f64, f64) = (1.0, 0.5);
/// How certain a new cell is, what a look at it adds or takes away, and between what it stays; logarithms of odds.
const CELL_NEW: f32 = 0.4;
const CELL_LOOK: (f32, f32) = (0.5, -0.25);
const CELL_RANGE: (f32, f32) = (-2.0, 4.0);
/// What a look that sees all of it, or through all of it, adds to the existence of a surface or takes away, and between what that
/// stays.
const LOOK: f64 = 0.6;
const RANGE: (f64, f64) = (-6.0, 6.0);
/// Fewer cells in view say nothing of its existence.
const FEW: usize = 6;
/// Standard deviation of what was known another day, m and rad.
const MOUNTING: f64 = 0.01;
/// A surface that a memory knew is as certain as that says, at most this.
const REMEMBERED: f64 = 2.0;
const CELL_REMEMBERED: f32 = 3.0;

/// Whether a place of a surface was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Visibility {
    /// It was measured there.
    There,
    /// What is behind it was measured.
    Through,
    /// It was hidden, or out of view.
    Unknown,
}

/// A flat surface.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    /// Its name among those of its class, once it is told.
    pub(super) name: Option<(&'static str, String)>,
    /// The frame of all below: z is about the normal.
    root_from_anchor: Isometry3<f64>,
    anchor_from_root: Isometry3<f64>,
    /// Information about `[h, a, b]` of the plane `z = h + a x + b y`: the inverse of its covariance, and that times it.
    information: Matrix3<f64>,
    weighted: Vector3<f64>,
    /// The newest solution of both.
    plane: Vector3<f64>,
    /// For each cell that was ever seen, the logarithm of the odds that it belongs to the surface.
    cells: BTreeMap<[i16; 2], f32>,
    /// The logarithm of the odds that there is such a surface.
    existence: f64,
}

impl Surface {
    /// A surface with this plane, of which nothing else is known.
    pub(super) fn new(plane: &Plane) -> Self {
        let rotation = UnitQuaternion::from_rotation_matrix(&plane.axes);
        Self::at(Isometry3::from_parts(plane.middle.into(), rotation))
    }

    fn at(root_from_anchor: Isometry3<f64>) -> Self {
        let anchor_from_root = root_from_anchor.inverse();
        let (information, weighted, plane) = (untold(), Vector3::zeros(), Vector3::zeros());
        let (name, cells, existence) = (None, BTreeMap::new(), 0.0);
        Self { name, root_from_anchor, anchor_from_root, information, weighted, plane, cells, existence }
    }

    /// A surface as a memory knows it: a rectangle of this pose (z its normal) and size, m, the covariance of its plane and the
    /// probability that it is there.
    pub(super) fn remembered(
        pose: &Isometry3<f64>,
        size: [f64; 2],
        covariance: &Matrix3<f64>,
        probability: f64,
    ) -> Option<Self> {
        let mut surface = Self::at(*pose);
        // Since then the camera's mounting may have become known better.
        let covariance = covariance + Matrix3::identity() * MOUNTING.powi(2);
        surface.information = covariance.try_inverse().filter(|i| i.iter().all(|x| x.is_finite()))?;
        let p = probability.clamp(0.01, 0.99);
        surface.existence = libm::log(p / (1.0 - p)).min(REMEMBERED);
        let count = |size: f64| (size / 2.0 / CELL).clamp(0.0, 60.0) as i16;
        let (x, y) = (count(size[0]), count(size[1]));
        surface.cells =
            (-x..=x).flat_map(|i| (-y..=y).map(move |j| ([i, j], CELL_REMEMBERED))).take(MAX_CELLS).collect();
        Some(surface)
    }

    /// Takes over what is seen of it in one picture, `dt` s after the last one.
    pub(super) fn measure<'p>(&mut self, seen: impl Iterator<Item = &'p DepthPoint>, dt: f64) {
        let (mut points, mut weighted) = (Matrix3::zeros(), Vector3::zeros());
        for point in seen {
            let at = self.anchor_from_root * point.at;
            let row = Vector3::new(1.0, at.x, at.y);
            let weight = (NOISE * point.scale()).powi(-2);
            points += row * row.transpose() * weight;
            weighted += row * (weight * at.z);
            let cell = cell_of(&Point2::new(at.x, at.y));
            if let Some(cell) = cell.filter(|_| self.cells.len() < MAX_CELLS) {
                self.cells.entry(cell).or_insert(CELL_NEW);
            }
        }
        // All points of one picture share the error of where the camera was: (points⁻¹ + pose⁻¹)⁻¹ is what both tell, by Woodbury's
        // identity pose (points + pose)⁻¹ points. A narrow strip leaves `points` singular, which is not inverted here.
        let (across, tilt) = POSE;
        let pose = Matrix3::from_diagonal(&Vector3::new(across, tilt, tilt).map(|sd| sd.powi(-2)));
        let Some(shared) = (points + pose).cholesky().map(|sum| pose * sum.inverse()) else { return };
        let kept = libm::exp(-dt / KEPT_S);
        let information = self.information * kept + shared * points + untold() * (1.0 - kept);
        let information = (information + information.transpose()) * 0.5;
        let weighted = self.weighted * kept + shared * weighted;
        if let Some(known) = information.cholesky() {
            (self.plane, self.information, self.weighted) = (known.solve(&weighted), information, weighted);
        }
    }

    /// Looks at each of its cells, by what the picture shows at a place (root frame, m).
    pub(super) fn look(&mut self, shown: impl Fn(&Point3<f64>) -> Visibility) {
        let (plane, root_from_anchor) = (self.plane, self.root_from_anchor);
        let (mut there, mut through) = (0, 0);
        for (cell, odds) in &mut self.cells {
            let change = match shown(&(root_from_anchor * in_anchor(&plane, cell))) {
                Visibility::Unknown => continue,
                Visibility::There => CELL_LOOK.0,
                Visibility::Through => CELL_LOOK.1,
            };
            if *odds > 0.0 {
                there += usize::from(change > 0.0);
                through += usize::from(change < 0.0);
            }
            *odds = (*odds + change).clamp(CELL_RANGE.0, CELL_RANGE.1);
        }
        if there + through >= FEW {
            let share = (there as f64 - through as f64) / (there + through) as f64;
            self.existence = (self.existence + LOOK * share).clamp(RANGE.0, RANGE.1);
        }
    }

    /// A point's distance from its plane, m, positive outside.
    pub(super) fn above(&self, point: &Point3<f64>) -> f64 {
        let at = self.anchor_from_root * point;
        let [h, a, b] = self.plane.into();
        (at.z - h - a * at.x - b * at.y) / (1.0 + a * a + b * b).sqrt()
    }

    /// The unit normal of its plane, root frame.
    pub(super) fn normal(&self) -> Vector3<f64> {
        self.root_from_anchor.rotation * Vector3::new(-self.plane.y, -self.plane.z, 1.0).normalize()
    }

    /// Whether one of its cells is at most so many cells from the foot of a point.
    pub(super) fn reaches(&self, point: &Point3<f64>, cells: i16) -> bool {
        let at = self.anchor_from_root * point;
        let Some([x, y]) = cell_of(&at.xy()) else { return false };
        let mut around = (-cells..=cells).flat_map(|i| (-cells..=cells).map(move |j| (i, j)));
        around.any(|(i, j)| {
            let cell = [x.saturating_add(i), y.saturating_add(j)];
            self.cells.get(&cell).is_some_and(|odds| *odds > 0.0)
        })
    }

    /// Whether a place is so near to it that a cell of the grid there has its points.
    pub(super) fn is_near(&self, place: &Point3<f64>) -> bool {
        self.above(place).abs() < EDGE / 2.0 && self.reaches(place, 1)
    }

    /// The places of its cells, root frame, m.
    pub(super) fn places(&self) -> impl Iterator<Item = Point3<f64>> {
        let occupied = self.cells.iter().filter(|(_, odds)| **odds > 0.0);
        occupied.map(|(cell, _)| self.root_from_anchor * in_anchor(&self.plane, cell))
    }

    /// The share of its places for which something holds, of some forty of them.
    pub(super) fn share(&self, holds: impl Fn(&Point3<f64>) -> bool) -> f64 {
        let count = self.places().count().max(1);
        let step = count.div_ceil(40);
        (self.places().step_by(step).filter(holds).count() * step) as f64 / count as f64
    }

    /// Takes over the cells of another one, which is the same surface.
    pub(super) fn join(&mut self, other: &Self) {
        for place in other.places() {
            let cell = cell_of(&(self.anchor_from_root * place).xy());
            if let Some(cell) = cell.filter(|_| self.cells.len() < MAX_CELLS) {
                let odds = self.cells.entry(cell).or_insert(CELL_NEW);
                *odds = odds.max(CELL_NEW);
            }
        }
        self.existence = self.existence.max(other.existence);
    }

    /// How much is known of its plane; more is better.
    pub(super) fn certainty(&self) -> f64 {
        self.information[(0, 0)]
    }

    /// The probability that it is there.
    pub(super) fn probability(&self) -> f64 {
        if self.cells.values().all(|odds| *odds <= 0.0) {
            return 0.0;
        }
        1.0 / (1.0 + libm::exp(-self.existence))
    }

    /// The covariance of its height, m, and of its tilts about its y and x, rad, at its middle: that of noise. An error of the
    /// camera's mounting is not in it.
    pub(super) fn covariance(&self, pose: &Isometry3<f64>) -> Option<Matrix3<f64>> {
        let middle = self.anchor_from_root * pose;
        let turned = middle.rotation * Vector3::x();
        let (sin, cos) = libm::sincos(libm::atan2(turned.y, turned.x));
        let at = middle.translation.vector;
        // The plane's [h, a, b] in axes that are moved and turned.
        let change = Matrix3::new(1.0, at.x, at.y, 0.0, cos, sin, 0.0, -sin, cos);
        let covariance = change * self.information.try_inverse()? * change.transpose();
        Some((covariance + covariance.transpose()) * 0.5)
    }

    /// The pose of the middle of the smallest rectangle around it, root frame (z its normal, x along the longer edge), and that
    /// rectangle's size, m.
    pub(super) fn rectangle(&self) -> Option<(Isometry3<f64>, [f64; 2])> {
        let occupied = self.cells.iter().filter(|(_, odds)| **odds > 0.0);
        let corners = occupied.flat_map(|([i, j], _)| {
            [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]]
                .map(|[x, y]| Point2::new((f64::from(*i) + x) * CELL, (f64::from(*j) + y) * CELL))
        });
        let rectangle = Rectangle::around(&corners.collect::<Vec<_>>(), STRAYS, CELL / 20.0)?;
        let [h, a, b] = self.plane.into();
        let normal = Vector3::new(-a, -b, 1.0).normalize();
        let x = Vector3::y().cross(&normal).normalize();
        let axes = Matrix3::from_columns(&[x, normal.cross(&x), normal]);
        let axes = Rotation3::from_matrix_unchecked(axes)
            * Rotation3::from_axis_angle(&Vector3::z_axis(), rectangle.angle);
        let middle = rectangle.middle;
        let middle = Vector3::new(middle.x, middle.y, h + a * middle.x + b * middle.y);
        let pose = Isometry3::from_parts(middle.into(), UnitQuaternion::from_rotation_matrix(&axes));
        Some((self.root_from_anchor * pose, rectangle.size))
    }
}

/// The share of a surface's cells that its rectangle leaves out at each side.
const STRAYS: f64 = 0.01;

/// The information about a plane of which nothing is known.
fn untold() -> Matrix3<f64> {
    let (height, slope) = UNTOLD;
    Matrix3::from_diagonal(&Vector3::new(height, slope, slope).map(|sd| sd.powi(-2)))
}

fn cell_of(at: &Point2<f64>) -> Option<[i16; 2]> {
    let cell = [at.x, at.y].map(|v| (v / CELL).round());
    cell.iter().all(|v| v.abs() < f64::from(i16::MAX / 2)).then(|| cell.map(|v| v as i16))
}

/// The middle of a cell on the plane, in its anchor's frame.
fn in_anchor(plane: &Vector3<f64>, [i, j]: &[i16; 2]) -> Point3<f64> {
    let (x, y) = (f64::from(*i) * CELL, f64::from(*j) * CELL);
    Point3::new(x, y, plane.x + plane.y * x + plane.z * y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_that_is_seen_as_a_narrow_strip_is_not_turned_by_its_noise() {
        let level =
            Plane { middle: Point3::new(0.0, 0.0, 0.9), axes: Rotation3::identity(), deviation: 0.003 };
        for turned in 0..40 {
            let (sin, cos) = libm::sincos(0.08 * f64::from(turned));
            let mut surface = Surface::new(&level);
            let point = |n: usize| {
                let (along, across) = (0.01 * n as f64 - 0.3, 3e-8 * (n * 7 % 5) as f64);
                let (x, y) = (0.6 + along * cos - across * sin, 0.9 + along * sin + across * cos);
                DepthPoint { place: n, depth: 1.0, at: Point3::new(x, y, 0.9 + 0.002 * (n % 5) as f64) }
            };
            let strip: Vec<_> = (0..60).map(point).collect();
            for _ in 0..20 {
                surface.measure(strip.iter(), 0.07);
            }
            assert!(surface.normal().angle(&Vector3::z()) < 0.02, "{turned}: {}", surface.normal());
        }
    }
}
