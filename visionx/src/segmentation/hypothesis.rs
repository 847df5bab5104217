//! What may be one thing, and the first hypotheses about a table of which nothing is known.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use imageproc::geometry::convex_hull;
use imageproc::point::Point as Corner;
use nalgebra::{Isometry3, Point2, UnitQuaternion, Vector3};

use super::top_view::{CELL, CellIndex, TopCell, TopView, around, beside, mean_of, middle_of};
use crate::plane::Plane;
use crate::rectangle::Rectangle;

/// Fewer cells are no thing.
pub(super) const LEAST: usize = 14;
/// What touches in at least so many cells and differs in height by less than this, m, is taken for one thing at first.
const BORDER: usize = 5;
const LEVEL: f64 = 0.0015;
/// Bytes of a packed cell: column, row, height in 0.1 mm (two each), and three of colour.
const PACKED: usize = 9;
/// No thing is wider than so many cells (2 m), whatever memory says.
const WIDEST: i32 = 500;

/// What may be one thing: its upper surface, and what is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Hypothesis {
    /// Its name.
    pub name: String,
    /// Its upper surface, by cells.
    pub(super) cells: BTreeMap<CellIndex, TopCell>,
    /// Whether it has moved as one while what is around it did not, so that it is a thing.
    pub confirmed: bool,
    /// How often it was pushed.
    pub pushes: u32,
}

impl Hypothesis {
    /// One of which nothing is known but these cells.
    pub(super) fn new(name: String, cells: BTreeMap<CellIndex, TopCell>) -> Self {
        Self { name, cells, confirmed: false, pushes: 0 }
    }

    /// Its surface as bytes, for memory.
    pub fn packed(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.cells.len() * PACKED);
        for ((x, y), top) in &self.cells {
            bytes.extend((*x as i16).to_le_bytes());
            bytes.extend((*y as i16).to_le_bytes());
            bytes.extend(((top.height * 1e4).clamp(0.0, 65535.0) as u16).to_le_bytes());
            bytes.extend(top.color.iter().map(|channel| channel.round().clamp(0.0, 255.0) as u8));
        }
        bytes
    }

    /// The hypothesis whose surface these bytes are; what is left over at their end is ignored, and so are cells
    /// that are too far from the first one.
    pub fn unpacked(name: &str, bytes: &[u8]) -> Self {
        let cells = bytes.as_chunks::<PACKED>().0.iter().map(|[a, b, c, d, e, f, red, green, blue]| {
            let place = (i32::from(i16::from_le_bytes([*a, *b])), i32::from(i16::from_le_bytes([*c, *d])));
            let height = f64::from(u16::from_le_bytes([*e, *f])) * 1e-4;
            (place, TopCell { height, color: Vector3::new(*red, *green, *blue).map(f64::from) })
        });
        let mut cells = cells.peekable();
        let (x, y) = cells.peek().map_or((0, 0), |(place, _)| *place);
        let is_near = |(place, _): &(CellIndex, TopCell)| {
            (place.0 - x).abs() <= WIDEST && (place.1 - y).abs() <= WIDEST
        };
        Self::new(name.to_owned(), cells.filter(is_near).collect())
    }

    /// The middle of its surface, root frame, m.
    pub fn middle(&self) -> Point2<f64> {
        mean_of(self.cells.keys().copied()).unwrap_or_else(Point2::origin)
    }

    /// Its height above the table, m.
    pub fn height(&self) -> f64 {
        let mut heights: Vec<f64> = self.cells.values().map(|top| top.height).collect();
        heights.sort_by(f64::total_cmp);
        heights.get(heights.len() * 9 / 10).copied().unwrap_or(0.0)
    }

    /// Its mean colour.
    pub fn color(&self) -> [u8; 3] {
        let sum: Vector3<f64> = self.cells.values().map(|top| top.color).sum();
        let mean = sum / (self.cells.len().max(1) as f64);
        [mean.x, mean.y, mean.z].map(|channel| channel.round().clamp(0.0, 255.0) as u8)
    }

    /// The smallest box around it, down to the table: the pose of its middle in the root frame, x along the longer edge, and its edges.
    pub(super) fn surrounding_box(&self, plane: &Plane) -> Option<(Isometry3<f64>, Vector3<f64>)> {
        let points: Vec<Point2<f64>> = self.cells.keys().map(|place| middle_of(*place)).collect();
        let flat = Rectangle::around(&points, 0.0, 2e-4)?;
        let height = self.height();
        let on_plane = plane.over(&flat.middle);
        let middle = on_plane + Vector3::z() * (height / 2.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), flat.angle);
        let size = Vector3::new(flat.size[0] + CELL, flat.size[1] + CELL, height);
        Some((Isometry3::from_parts(middle.coords.into(), turn), size))
    }

    /// Its share of the cells in its convex hull: 1 where it is convex.
    pub(super) fn convexity(&self) -> f64 {
        let cells: Vec<Corner<i32>> = self.cells.keys().map(|place| Corner::new(place.0, place.1)).collect();
        let hull = convex_hull(cells);
        let Some(begin) = hull.first() else { return 1.0 };
        let (mut twice_area, mut border) = (0, 0);
        for (i, a) in hull.iter().enumerate() {
            let b = &hull[(i + 1) % hull.len()];
            twice_area += (a.x - begin.x) * (b.y - begin.y) - (a.y - begin.y) * (b.x - begin.x);
            border += gcd((b.x - a.x).unsigned_abs(), (b.y - a.y).unsigned_abs()) as i32;
        }
        // Pick's theorem: how many cells a polygon between middles of cells holds.
        let held = (twice_area.abs() + border) / 2 + 1;
        self.cells.len() as f64 / f64::from(held)
    }

    /// Whether a cell of another one is within `reach` cells of one of its own.
    pub(super) fn is_near(&self, other: &BTreeMap<CellIndex, TopCell>, reach: i32) -> bool {
        other.keys().any(|place| around(*place, reach).any(|near| self.cells.contains_key(&near)))
    }
}

/// What is connected in height and colour, each as a hypothesis, named from `next` on.
pub fn first_hypotheses(view: &TopView, next: &mut usize) -> Vec<Hypothesis> {
    of_rest(view, &BTreeSet::new(), next)
}

/// The same of the cells that are not taken.
pub(super) fn of_rest(view: &TopView, taken: &BTreeSet<CellIndex>, next: &mut usize) -> Vec<Hypothesis> {
    let mut left: BTreeMap<CellIndex, TopCell> = view
        .occupied()
        .filter(|(place, top)| !taken.contains(place) && view.is_surface(*place, top))
        .collect();
    let mut found: Vec<BTreeMap<CellIndex, TopCell>> = Vec::new();
    let mut rest = BTreeMap::new();
    while let Some((start, top)) = left.pop_first() {
        let (mut cells, mut open) = (BTreeMap::from([(start, top)]), vec![(start, top)]);
        while let Some((here, top)) = open.pop() {
            for place in beside(here) {
                if left.get(&place).is_some_and(|next| next.is_like(&top))
                    && let Some(next) = left.remove(&place)
                {
                    cells.insert(place, next);
                    open.push((place, next));
                }
            }
        }
        match cells.len() >= LEAST {
            true => found.push(cells),
            false => rest.extend(cells),
        }
    }
    // What is between two colours belongs to the one that is reached first.
    let sources: Vec<(CellIndex, usize)> =
        found.iter().enumerate().flat_map(|(i, cells)| cells.keys().map(move |place| (*place, i))).collect();
    for (place, of) in spread(sources, |_, to| rest.contains_key(&to)) {
        if let Some(top) = rest.get(&place) {
            found[of].insert(place, *top);
        }
    }
    let mut found = level_joined(found);
    found.sort_by_key(|cells| std::cmp::Reverse(cells.len()));
    let named = |cells| {
        *next += 1;
        Hypothesis::new(format!("thing_{next}"), cells)
    };
    found.into_iter().map(named).collect()
}

/// Joins what is of one height and touches: most of it is one thing with several colours.
fn level_joined(found: Vec<BTreeMap<CellIndex, TopCell>>) -> Vec<BTreeMap<CellIndex, TopCell>> {
    let mean = |cells: &BTreeMap<CellIndex, TopCell>| {
        cells.values().map(|top| top.height).sum::<f64>() / cells.len().max(1) as f64
    };
    let mut joined: Vec<(Vec<f64>, BTreeMap<CellIndex, TopCell>)> = Vec::new();
    for cells in found {
        let (mut heights, mut all) = (vec![mean(&cells)], cells);
        let is_one = |(others, other): &(Vec<f64>, BTreeMap<CellIndex, TopCell>)| {
            let level = others.iter().any(|other| heights.iter().any(|own| (own - other).abs() < LEVEL));
            let touching = |place: &&CellIndex| around(**place, 1).any(|near| other.contains_key(&near));
            level && all.keys().filter(touching).count() >= BORDER
        };
        let (same, rest): (Vec<_>, Vec<_>) = joined.into_iter().partition(is_one);
        for (others, other) in same {
            heights.extend(others);
            all.extend(other);
        }
        joined = rest;
        joined.push((heights, all));
    }
    joined.into_iter().map(|(_, cells)| cells).collect()
}

/// Spreads labels from cells to cells around them to which the way is open, the nearest first; gives the cells that were reached.
pub(super) fn spread(
    sources: Vec<(CellIndex, usize)>,
    open: impl Fn(CellIndex, CellIndex) -> bool,
) -> Vec<(CellIndex, usize)> {
    let mut reached: BTreeSet<CellIndex> = sources.iter().map(|(place, _)| *place).collect();
    let mut waiting: VecDeque<(CellIndex, usize)> = sources.into();
    let mut found = Vec::new();
    while let Some((here, label)) = waiting.pop_front() {
        for place in around(here, 1) {
            if !reached.contains(&place) && open(here, place) {
                reached.insert(place);
                found.push((place, label));
                waiting.push_back((place, label));
            }
        }
    }
    found
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The connected patches of cells of one label, each with its label.
pub(super) fn patches(labels: &BTreeMap<CellIndex, usize>) -> Vec<(usize, BTreeSet<CellIndex>)> {
    let mut left = labels.clone();
    let mut patches = Vec::new();
    while let Some((start, label)) = left.pop_first() {
        let (mut patch, mut open) = (BTreeSet::from([start]), vec![start]);
        while let Some(here) = open.pop() {
            for place in around(here, 1).filter(|place| labels.get(place) == Some(&label)) {
                if left.remove(&place).is_some() {
                    patch.insert(place);
                    open.push(place);
                }
            }
        }
        patches.push((label, patch));
    }
    patches
}
