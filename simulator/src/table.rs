//! The table: a tilted plane with bumps, and the dirt on it.
//!
//! The table's frame has its origin in the middle of the top, z along the top's normal; bumps rise along that normal.
//! This file computes heights and dirt, not forces.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::render;
use crate::world::TableSpec;

/// Thickness of the table's top, m.
pub const THICKNESS: f64 = 0.03;
/// Radius of its legs, m.
pub(crate) const LEG_RADIUS: f64 = 0.02;
/// How far the middle of a leg is from the edges, m.
const LEG_FROM_EDGE: f64 = 0.05;
/// Edge of a cell of the dirt grid, m.
pub const DIRT_CELL: f64 = 0.0025;
/// The table's wiped cells are marked every this many steps; the referee uses the same interval.
pub(crate) const WIPE_EVERY: u64 = 5;

/// The top of the table.
#[derive(Clone, Debug)]
pub struct TableTop {
    root_from_top: Isometry3<f64>,
    half: [f64; 2],
    bumps: Vec<render::Bump>,
    friction: f64,
}

/// The table's surface near a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// How far the point is below the surface along the normal, m; negative above.
    pub depth: f64,
    /// Unit normal, root frame.
    pub normal: Vector3<f64>,
}

impl TableTop {
    /// The table of a world.
    pub fn new(spec: &TableSpec) -> Self {
        let [tilt_x, tilt_y] = spec.tilt_deg.map(f64::to_radians);
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt_y)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt_x);
        let center = Translation3::new(spec.center[0], spec.center[1], spec.height);
        let root_from_top = Isometry3::from_parts(center, rotation);
        let mut table = Self {
            root_from_top,
            half: spec.size.map(|s| s / 2.0),
            bumps: Vec::new(),
            friction: spec.friction,
        };
        let bumps = spec.bumps.iter().map(|b| {
            let at = root_from_top.inverse_transform_point(&Point3::new(
                b.at[0],
                b.at[1],
                table.plane_height(b.at[0], b.at[1]),
            ));
            render::Bump { at: [at.x, at.y], height: b.height, radius: b.radius }
        });
        let bumps = bumps.collect();
        table.bumps = bumps;
        table
    }

    /// The pose of the table's frame in the root frame.
    pub fn root_from_top(&self) -> &Isometry3<f64> {
        &self.root_from_top
    }

    /// Half its width and depth, m.
    pub fn half(&self) -> [f64; 2] {
        self.half
    }

    /// The middle of each of its four legs, root frame (z along it), and half the leg's length, m. They are seen, and touch nothing.
    pub(crate) fn legs(&self) -> [(Isometry3<f64>, f64); 4] {
        [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)].map(|(x, y)| {
            let [half_x, half_y] = self.half.map(|half| half - LEG_FROM_EDGE);
            let top = self.root_from_top * Point3::new(x * half_x, y * half_y, -THICKNESS);
            let half_length = (top.z / 2.0).max(0.01);
            (Isometry3::translation(top.x, top.y, half_length), half_length)
        })
    }

    /// Its bumps, in its own frame.
    pub fn bumps(&self) -> &[render::Bump] {
        &self.bumps
    }

    /// Coulomb friction of sponge on table.
    pub fn friction(&self) -> f64 {
        self.friction
    }

    /// The unit normal of its plane, root frame.
    pub fn plane_normal(&self) -> Unit<Vector3<f64>> {
        Unit::new_unchecked(self.root_from_top * Vector3::z())
    }

    /// Height of the plane without bumps at a place in the root frame, m; also beyond the table's edges.
    pub fn plane_height(&self, x: f64, y: f64) -> f64 {
        let n = self.plane_normal();
        let c = self.root_from_top.translation.vector;
        c.z - (n.x * (x - c.x) + n.y * (y - c.y)) / n.z
    }

    /// Whether a point of the root frame is above or below the top.
    pub fn is_over(&self, point: &Point3<f64>) -> bool {
        let p = self.root_from_top.inverse_transform_point(point);
        p.x.abs() <= self.half[0] && p.y.abs() <= self.half[1]
    }

    /// The surface at a point of the root frame; `None` beside the table and below the underside of its top.
    pub fn surface(&self, point: &Point3<f64>) -> Option<SurfacePoint> {
        let p = self.root_from_top.inverse_transform_point(point);
        if p.x.abs() > self.half[0] || p.y.abs() > self.half[1] {
            return None;
        }
        let mut rise = 0.0;
        let mut slope = [0.0; 2];
        for bump in &self.bumps {
            let squared = (p.x - bump.at[0]).powi(2) + (p.y - bump.at[1]).powi(2);
            if squared < bump.radius * bump.radius {
                rise += bump.height_at(p.x, p.y);
                let s = bump.slope_at(p.x, p.y);
                slope = [slope[0] + s[0], slope[1] + s[1]];
            }
        }
        let normal = Vector3::new(-slope[0], -slope[1], 1.0);
        let length = normal.norm();
        let depth = (rise - p.z) / length;
        (depth <= THICKNESS).then(|| SurfacePoint { depth, normal: self.root_from_top * (normal / length) })
    }
}

/// The wiped cells of a grid over the table.
///
/// Cells are squares of [`DIRT_CELL`], x fastest, from the corner (-half x, -half y) of the table's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DirtGrid {
    columns: usize,
    rows: usize,
    half: [f64; 2],
    marked: Vec<bool>,
}

impl DirtGrid {
    /// A grid over a table without marked cells.
    pub fn new(table: &TableTop) -> Self {
        let half = table.half();
        let [columns, rows] = half.map(|h| ((2.0 * h / DIRT_CELL).ceil() as usize).max(1));
        Self { columns, rows, half, marked: vec![false; columns * rows] }
    }

    /// Cells along x.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Cells along y.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// All cells, x fastest.
    pub fn cells(&self) -> &[bool] {
        &self.marked
    }

    /// Marks the cells within `radius` of `center` (table frame, m) whose centres pass the test. Returns whether
    /// any was new.
    pub fn mark(&mut self, center: [f64; 2], radius: f64, mut test: impl FnMut(f64, f64) -> bool) -> bool {
        let range = |k: usize, count: usize| {
            let low = ((center[k] - radius + self.half[k]) / DIRT_CELL).floor().max(0.0) as usize;
            let high = ((center[k] + radius + self.half[k]) / DIRT_CELL).ceil().max(0.0) as usize;
            low.min(count)..high.min(count)
        };
        let (columns, rows) = (range(0, self.columns), range(1, self.rows));
        let mut new = false;
        for row in rows {
            let y = (row as f64 + 0.5) * DIRT_CELL - self.half[1];
            for column in columns.clone() {
                let cell = &mut self.marked[row * self.columns + column];
                let x = (column as f64 + 0.5) * DIRT_CELL - self.half[0];
                if !*cell && test(x, y) {
                    *cell = true;
                    new = true;
                }
            }
        }
        new
    }

    /// Marks cells by their indices in [`Self::cells`]; invalid indices are ignored.
    pub fn mark_cells(&mut self, cells: &[u32]) {
        for cell in cells {
            if let Some(marked) = usize::try_from(*cell).ok().and_then(|at| self.marked.get_mut(at)) {
                *marked = true;
            }
        }
    }

    /// The share of this grid's marked cells that `other` has marked too; `None` if none is marked.
    pub fn covered_by(&self, other: &Self) -> Option<f64> {
        let total = self.marked.iter().filter(|m| **m).count();
        let both = self.marked.iter().zip(&other.marked).filter(|(a, b)| **a && **b).count();
        (total > 0).then(|| both as f64 / total as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::BumpSpec;

    fn table(tilt_deg: [f64; 2], bumps: Vec<BumpSpec>) -> TableTop {
        TableTop::new(&TableSpec { tilt_deg, bumps, ..TableSpec::default() })
    }

    #[test]
    fn tilt_raises_the_far_edge_and_lowers_the_right_one() {
        let t = table([2.0, 0.0], vec![]);
        assert!((t.plane_height(0.25, 0.8) - (0.95 + 0.2 * libm::tan(2f64.to_radians()))).abs() < 1e-12);
        let t = table([0.0, 2.0], vec![]);
        assert!((t.plane_height(0.45, 0.6) - (0.95 - 0.2 * libm::tan(2f64.to_radians()))).abs() < 1e-12);
    }

    #[test]
    fn depth_is_along_the_normal() {
        let t = table([3.0, -2.0], vec![]);
        let on = Point3::new(0.3, 0.5, t.plane_height(0.3, 0.5));
        let s = t.surface(&(on - t.plane_normal().into_inner() * 0.01)).unwrap();
        assert!((s.depth - 0.01).abs() < 1e-12);
        assert!((s.normal - t.plane_normal().into_inner()).norm() < 1e-12);
        assert_eq!(t.surface(&Point3::new(2.0, 0.5, 0.9)), None);
        assert_eq!(t.surface(&Point3::new(0.3, 0.5, 0.5)), None);
    }

    #[test]
    fn a_bump_stands_where_the_file_says() {
        let t = table([4.0, 4.0], vec![BumpSpec { at: [0.3, 0.5], height: 0.004, radius: 0.05 }]);
        let top = Point3::new(0.3, 0.5, t.plane_height(0.3, 0.5));
        assert!((t.surface(&top).unwrap().depth - 0.004).abs() < 1e-12);
    }

    #[test]
    fn the_normal_is_the_gradient_of_depth() {
        let t = table([1.0, 2.0], vec![BumpSpec { at: [0.3, 0.5], height: 0.005, radius: 0.05 }]);
        let p = Point3::new(0.32, 0.51, 0.952);
        let h = 1e-6;
        // The gradient of the level sets of (rise - z) has the direction of the surface's normal.
        let depth = |d: Vector3<f64>| {
            let s = t.surface(&(p + d)).unwrap();
            s.depth / (t.root_from_top.inverse() * s.normal).z
        };
        let g = Vector3::new(
            depth(Vector3::x() * h) - depth(-Vector3::x() * h),
            depth(Vector3::y() * h) - depth(-Vector3::y() * h),
            depth(Vector3::z() * h) - depth(-Vector3::z() * h),
        );
        assert!((-g.normalize() - t.surface(&p).unwrap().normal).norm() < 1e-5);
    }

    #[test]
    fn dirt_is_marked_within_and_compared() {
        let t = table([0.0, 0.0], vec![]);
        let (mut a, mut b) = (DirtGrid::new(&t), DirtGrid::new(&t));
        assert!(a.mark([0.0, 0.0], 0.1, |x, y| x.abs() < 0.05 && y.abs() < 0.05));
        assert!(!a.mark([0.0, 0.0], 0.1, |x, y| x.abs() < 0.05 && y.abs() < 0.05));
        assert_eq!(a.cells().iter().filter(|m| **m).count(), 1600);
        b.mark([0.0, 0.0], 0.1, |x, _| x < 0.0);
        assert_eq!(a.covered_by(&b), Some(0.5));
        assert_eq!(DirtGrid::new(&t).covered_by(&a), None);
    }
}
