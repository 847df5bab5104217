//! The smallest rectangle around points of a plane.

use imageproc::geometry::min_area_rect;
use imageproc::point::Point as Cell;
use nalgebra::{Point2, Rotation2, Vector2};

/// Largest coordinate, cells; farther points are clamped.
const MAX_COORDINATE: f64 = 20_000.0;

/// A rectangle in a plane.
pub(crate) struct Rectangle {
    pub(crate) middle: Point2<f64>,
    /// Direction of the longer edge, rad, in (-pi/2, pi/2].
    pub(crate) angle: f64,
    /// The longer and the shorter edge, in the points' unit.
    pub(crate) size: [f64; 2],
}

impl Rectangle {
    /// The smallest rectangle around points; `None` when there are none. The search rounds them to `cell`, in the
    /// points' unit, and clamps them at 20 000 cells. It leaves out a share `strays` of the points at each side.
    pub(crate) fn around(points: &[Point2<f64>], strays: f64, cell: f64) -> Option<Self> {
        let cell = |v: f64| (v / cell).clamp(-MAX_COORDINATE, MAX_COORDINATE).round() as i32;
        let cells: Vec<Cell<i32>> = points.iter().map(|p| Cell::new(cell(p.x), cell(p.y))).collect();
        if cells.is_empty() {
            return None;
        }
        let corners = min_area_rect(&cells).map(|c| Vector2::new(f64::from(c.x), f64::from(c.y)));
        let (a, b) = (corners[1] - corners[0], corners[3] - corners[0]);
        let long = if a.norm() >= b.norm() { a } else { b };
        let angle = if long.x == 0.0 { std::f64::consts::FRAC_PI_2 } else { libm::atan(long.y / long.x) };
        let turned: Vec<Vector2<f64>> = points.iter().map(|p| Rotation2::new(-angle) * p.coords).collect();
        let side = |axis: usize| {
            let mut values: Vec<f64> = turned.iter().map(|p| p[axis]).collect();
            let last = values.len() - 1;
            let cut = (last as f64 * strays / 2.0) as usize;
            let mut at = |rank: usize| *values.select_nth_unstable_by(rank, f64::total_cmp).1;
            (at(cut), at(last - cut))
        };
        let (x, y) = (side(0), side(1));
        let middle = Rotation2::new(angle) * Vector2::new(x.0 + x.1, y.0 + y.1) / 2.0;
        Some(Self { middle: Point2::from(middle), angle, size: [x.1 - x.0, y.1 - y.0] })
    }

    /// Whether a point lies inside or at most `beyond` from the sides.
    pub(crate) fn holds(&self, point: &Point2<f64>, beyond: f64) -> bool {
        let local = Rotation2::new(-self.angle) * (point - self.middle);
        (0..2).all(|i| local[i].abs() <= self.size[i] / 2.0 + beyond)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_rectangle_is_found() {
        for angle in [-1.2, -0.4, 0.0, 0.7, 1.5] {
            let points: Vec<Point2<f64>> = (0..41)
                .flat_map(|i| (0..21).map(move |j| Vector2::new(f64::from(i) - 20.0, f64::from(j) - 10.0)))
                .map(|p| Point2::new(0.3, -0.1) + Rotation2::new(angle) * p * 0.005)
                .collect();
            let found = Rectangle::around(&points, 0.0, 0.0002).unwrap();
            assert!((found.middle - Point2::new(0.3, -0.1)).norm() < 5e-4);
            assert!((found.size[0] - 0.2).abs() < 1e-3 && (found.size[1] - 0.1).abs() < 1e-3, "{angle}");
            assert!((found.angle - angle).abs() < 0.01, "{} {angle}", found.angle);
            assert!(found.holds(&Point2::new(0.3, -0.1), 0.0) && !found.holds(&Point2::new(0.6, -0.1), 0.02));
        }
        assert!(Rectangle::around(&[], 0.0, 0.0002).is_none());
        assert_eq!(Rectangle::around(&[Point2::new(1.0, 2.0); 3], 0.0, 0.0002).unwrap().size, [0.0, 0.0]);
    }
}
