//! What rises from a table, seen from above: a grid of cells, each with the height and the colour of what is highest in it.
//!
//! Columns and rows go along the root frame's x and y. A cell is occupied, free (the table was seen there) or unknown.

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};

use crate::camera::PinholeCamera;
use crate::frame::{DepthImage, RgbImage};
use crate::plane::{Plane, upwards};
use crate::points::DepthPoints;
use crate::rectangle::Rectangle;

/// Edge of a cell, m.
pub(super) const CELL: f64 = 0.004;
/// Lowest and highest of what rises from the table, m.
pub(super) const RISES: (f64, f64) = (0.012, 0.30);
/// Points that are lower than the highest of their cell by more than this, m, are not of its upper surface.
const SURFACE: f64 = 0.005;
/// Of the same surface are neighbours whose heights, m, and colours, of 255, differ by less than this.
pub(super) const SAME: (f64, f64) = (0.007, 26.0);
/// Every so many pixels the plane of the table is sampled; the least share of points on it, and its least height, m.
const SAMPLED: (u32, f64, f64) = (2, 0.05, 0.3);
/// What stands farther inside of the table's seen border than this, m, is looked at.
const INSIDE: f64 = 0.01;
/// Most cells of a grid along an edge.
const MOST: i32 = 800;

/// A column and a row.
pub(super) type CellIndex = (i32, i32);

/// The upper surface in a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TopCell {
    /// Height above the table, m.
    pub height: f64,
    /// Mean colour: red, green, blue, 0 to 255.
    pub color: Vector3<f64>,
}

impl TopCell {
    /// Whether another cell may show the same surface.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        (self.height - other.height).abs() < SAME.0 && (self.color - other.color).amax() < SAME.1
    }
}

/// What a cell holds, as far as it was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Occupancy {
    /// Nothing was seen in it.
    #[default]
    Unknown,
    /// The table.
    Free,
    /// A surface above the table.
    Occupied(TopCell),
}

/// A grid over the table.
#[derive(Clone, Debug, PartialEq)]
pub struct TopView {
    low: CellIndex,
    size: CellIndex,
    cells: Vec<Occupancy>,
}

/// The cell of a place, root frame, m.
pub(super) fn place_of(at: &Point2<f64>) -> CellIndex {
    ((at.x / CELL).floor() as i32, (at.y / CELL).floor() as i32)
}

/// The middle of a cell, root frame, m.
pub(super) fn middle_of((x, y): CellIndex) -> Point2<f64> {
    Point2::new((f64::from(x) + 0.5) * CELL, (f64::from(y) + 0.5) * CELL)
}

/// The cells around a cell, with it, up to so many columns and rows away.
pub(super) fn around((x, y): CellIndex, reach: i32) -> impl Iterator<Item = CellIndex> {
    (-reach..=reach).flat_map(move |dy| (-reach..=reach).map(move |dx| (x + dx, y + dy)))
}

/// The four cells beside a cell.
pub(super) fn beside((x, y): CellIndex) -> [CellIndex; 4] {
    [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
}

impl TopView {
    /// A view without anything between two corners, inclusive.
    pub(super) fn unknown(low: CellIndex, high: CellIndex) -> Self {
        let size = ((high.0 - low.0 + 1).clamp(0, MOST), (high.1 - low.1 + 1).clamp(0, MOST));
        Self { low, size, cells: vec![Occupancy::Unknown; (size.0 * size.1) as usize] }
    }

    /// The view of a table, by what its pictures show; `None` where there is no table. Also its plane.
    pub(super) fn of(
        (depth, colors): (&DepthImage, &RgbImage),
        camera: &PinholeCamera,
        root_from_left: &Isometry3<f64>,
    ) -> Option<(Self, Plane)> {
        let (step, share, floor) = SAMPLED;
        let sampled = DepthPoints::of(depth, camera, root_from_left, (step, f64::MAX));
        let wanted = |at: &Point3<f64>, normal: &Vector3<f64>| upwards(normal).filter(|_| at.z >= floor);
        let plane = Plane::largest(&sampled, &|_| true, share, &wanted)?;
        let on_it = sampled.points.iter().filter(|p| plane.above(&p.at).abs() < RISES.0);
        let flat: Vec<Point2<f64>> = on_it.map(|p| plane.flat(&p.at)).collect();
        let border = Rectangle::around(&flat, 0.01, 2e-4)?;
        let all = DepthPoints::of(depth, camera, root_from_left, (1, f64::MAX));
        let over: Vec<(CellIndex, f64, Vector3<f64>)> = all
            .points
            .iter()
            .filter(|p| border.holds(&plane.flat(&p.at), -INSIDE))
            .filter_map(|p| {
                let height = plane.above(&p.at);
                let (x, y) = (p.place as u32 % depth.width, p.place as u32 / depth.width);
                let color = Vector3::from(colors.pixel(x, y).map(f64::from));
                (-RISES.0..RISES.1).contains(&height).then(|| (place_of(&p.at.xy()), height, color))
            })
            .collect();
        Some((Self::of_points(&over), plane))
    }

    fn of_points(points: &[(CellIndex, f64, Vector3<f64>)]) -> Self {
        let extent = |f: &dyn Fn(&CellIndex) -> i32| {
            points
                .iter()
                .map(|(place, ..)| f(place))
                .fold((i32::MAX, i32::MIN), |(a, b), v| (a.min(v), b.max(v)))
        };
        let (x, y) = (extent(&|place| place.0), extent(&|place| place.1));
        if points.is_empty() {
            return Self::unknown((0, 0), (-1, -1));
        }
        let mut view = Self::unknown((x.0, y.0), (x.1, y.1));
        let mut highest = vec![f64::NEG_INFINITY; view.cells.len()];
        for (place, height, _) in points {
            if let Some(i) = view.index(*place) {
                highest[i] = highest[i].max(*height);
            }
        }
        let mut sums = vec![(0.0, 0.0, Vector3::zeros()); view.cells.len()];
        for (place, height, color) in points {
            if let Some(i) = view.index(*place).filter(|i| *height > highest[*i] - SURFACE) {
                let (n, heights, colors) = &mut sums[i];
                (*n, *heights, *colors) = (*n + 1.0, *heights + height, *colors + color);
            }
        }
        for (cell, (n, height, color)) in view.cells.iter_mut().zip(sums).filter(|(_, (n, ..))| *n > 0.0) {
            let top = TopCell { height: height / n, color: color / n };
            *cell = if top.height > RISES.0 { Occupancy::Occupied(top) } else { Occupancy::Free };
        }
        view
    }

    fn index(&self, (x, y): CellIndex) -> Option<usize> {
        let (x, y) = (x - self.low.0, y - self.low.1);
        let inside = (0..self.size.0).contains(&x) && (0..self.size.1).contains(&y);
        inside.then(|| (y * self.size.0 + x) as usize)
    }

    /// What is known of a cell.
    pub(super) fn at(&self, place: CellIndex) -> Occupancy {
        self.index(place).map_or(Occupancy::Unknown, |i| self.cells[i])
    }

    /// Sets a cell inside of the grid.
    pub(super) fn set(&mut self, place: CellIndex, known: Occupancy) {
        if let Some(i) = self.index(place) {
            self.cells[i] = known;
        }
    }

    /// The surface in a cell, if it is occupied.
    pub(super) fn top(&self, place: CellIndex) -> Option<TopCell> {
        match self.at(place) {
            Occupancy::Occupied(top) => Some(top),
            Occupancy::Free | Occupancy::Unknown => None,
        }
    }

    /// All occupied cells, row by row.
    pub(super) fn occupied(&self) -> impl Iterator<Item = (CellIndex, TopCell)> + '_ {
        let place = |i: usize| (self.low.0 + i as i32 % self.size.0, self.low.1 + i as i32 / self.size.0);
        self.cells.iter().enumerate().filter_map(move |(i, known)| match known {
            Occupancy::Occupied(top) => Some((place(i), *top)),
            Occupancy::Free | Occupancy::Unknown => None,
        })
    }

    /// Whether a surface like this one is in or beside a cell.
    pub(super) fn shows(&self, place: CellIndex, top: &TopCell) -> bool {
        around(place, 1).any(|place| self.top(place).is_some_and(|other| other.is_like(top)))
    }

    /// Whether a cell is of an upper surface: at least two of those beside it continue it. What is seen of an upright side is not.
    pub(super) fn is_surface(&self, place: CellIndex, top: &TopCell) -> bool {
        let level = |place| self.top(place).is_some_and(|other| (other.height - top.height).abs() < SAME.0);
        beside(place).into_iter().filter(|place| level(*place)).count() >= 2
    }

    /// Whether a surface ends in this cell: one beside it is not like it.
    pub(super) fn is_edge(&self, place: CellIndex, top: &TopCell) -> bool {
        beside(place).into_iter().any(|place| !self.top(place).is_some_and(|other| other.is_like(top)))
    }
}

/// The mean of places, m.
pub(super) fn mean_of(places: impl Iterator<Item = CellIndex>) -> Option<Point2<f64>> {
    let (n, sum) =
        places.fold((0.0, Vector2::zeros()), |(n, sum), place| (n + 1.0, sum + middle_of(place).coords));
    (n > 0.0).then(|| Point2::from(sum / n))
}
