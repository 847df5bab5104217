//! What stands there and is no flat surface, as cells of a coarse grid: a plant, a heap, a person. Cells that touch each other are one bulk,
//! which is told as the box around it.
//!
//! # Source
//! Moravec and Elfes, "High resolution maps from wide angle sonar", ICRA 1985: a cell's odds grow with what is measured in it, and fall with what
//! is measured behind it.

use std::collections::{BTreeMap, BTreeSet};

use armarium_values::distance_from_box;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::GONE_NS;
use super::surface::Visibility;

/// Edge of a cell, m.
pub(super) const EDGE: f64 = 0.1;
/// Most cells; what is beyond is not remembered.
const MAX_CELLS: usize = 16_384;
/// Fewer points of one picture in a cell say nothing.
const FEW: usize = 5;
/// What a picture that measures something in a cell, or behind it, adds to the logarithm of its odds; between what that stays, and from where on
/// the cell is filled.
const LOOK: (f32, f32) = (0.4, -0.5);
const RANGE: (f32, f32) = (-1.0, 4.0);
const FILLED: f32 = 2.0;
/// A bulk has at least so many cells.
const LEAST: usize = 6;
/// Bulks of which a memory knows are as certain as this.
const REMEMBERED: f32 = 2.4;

/// Something that is there and has no flat surface that is known.
#[derive(Clone, Debug, PartialEq)]
pub struct BulkEstimate {
    /// Its name among all: `bulk`, or that with a number.
    pub name: String,
    /// The pose of the middle of the box around its cells, along the axes of the root frame.
    pub root_from_box: Isometry3<f64>,
    /// The edges of that box, m.
    pub size: Vector3<f64>,
    /// The covariance of its middle, m².
    pub covariance: Matrix3<f64>,
    /// The probability that it is there: the mean of its cells'.
    pub probability: f64,
}

impl BulkEstimate {
    /// The class of all of them.
    pub const CLASS: &str = "bulk";
}

type Cell = [i16; 3];

/// The cells, and the bulks that were told last.
#[derive(Default)]
pub(super) struct Grid {
    odds: BTreeMap<Cell, f32>,
    /// By name; with when it was there last, ns.
    told: BTreeMap<String, (BulkEstimate, u64)>,
}

impl Grid {
    /// A grid in which the boxes of these bulks are filled.
    pub(super) fn remembering(known: Vec<BulkEstimate>) -> Self {
        let mut grid = Self::default();
        for bulk in &known {
            // The robot may have turned since then.
            let half = bulk.root_from_box.rotation.to_rotation_matrix().matrix().abs() * bulk.size / 2.0;
            let middle = bulk.root_from_box.translation.vector;
            let ends = [middle - half, middle + half].map(|at| cell_of(&at.into()));
            let [Some(low), Some(high)] = ends else { continue };
            let along = |i: usize| low[i]..=high[i];
            let cells = along(0).flat_map(|x| along(1).flat_map(move |y| along(2).map(move |z| [x, y, z])));
            let in_it =
                |cell: &Cell| distance_from_box(&middle_of(cell), &bulk.root_from_box, &bulk.size) == 0.0;
            for cell in cells.take(MAX_CELLS).filter(in_it).take(MAX_CELLS - grid.odds.len()) {
                grid.odds.insert(cell, REMEMBERED);
            }
        }
        grid.told = known.into_iter().map(|bulk| (bulk.name.clone(), (bulk, 0))).collect();
        grid
    }

    /// Takes over the points of one picture that no surface explains, and what it shows at the middle of a cell.
    pub(super) fn look(&mut self, points: &[Point3<f64>], shown: impl Fn(&Point3<f64>) -> Visibility) {
        let mut hits: BTreeMap<Cell, usize> = BTreeMap::new();
        points.iter().filter_map(cell_of).for_each(|cell| *hits.entry(cell).or_default() += 1);
        hits.retain(|_, count| *count >= FEW);
        for (cell, odds) in &mut self.odds {
            if !hits.contains_key(cell) && shown(&middle_of(cell)) == Visibility::Through {
                *odds += LOOK.1;
            }
        }
        for cell in hits.into_keys() {
            if self.odds.len() < MAX_CELLS || self.odds.contains_key(&cell) {
                let odds = self.odds.entry(cell).or_default();
                *odds = (*odds + LOOK.0).min(RANGE.1);
            }
        }
        self.odds.retain(|_, odds| *odds > RANGE.0);
    }

    /// All bulks now, ns. One keeps its name as long as it touches the box that it had; one that is gone is told for some time more, with the
    /// probability 0.
    pub(super) fn bulks(&mut self, now_ns: u64) -> Vec<BulkEstimate> {
        let mut names: BTreeSet<String> = BTreeSet::new();
        let mut left: BTreeSet<Cell> = self.filled().collect();
        let mut parts: Vec<Vec<Cell>> = Vec::new();
        while let Some(start) = left.pop_first() {
            let (mut part, mut open) = (vec![start], vec![start]);
            while let Some(here) = open.pop() {
                for next in around(here) {
                    if left.remove(&next) {
                        part.push(next);
                        open.push(next);
                    }
                }
            }
            parts.push(part);
        }
        parts.retain(|part| part.len() >= LEAST);
        parts.sort_by_key(|part| std::cmp::Reverse(part.len()));
        for part in parts {
            let bulk = self.bulk(&part);
            let own = self.told.iter().find(|(name, (old, _))| !names.contains(*name) && touch(old, &bulk));
            let name = own.map_or_else(|| self.free_name(), |(name, _)| name.clone());
            names.insert(name.clone());
            self.told.insert(name.clone(), (BulkEstimate { name, ..bulk }, now_ns));
        }
        self.told.retain(|_, (_, there_ns)| now_ns.saturating_sub(*there_ns) < GONE_NS);
        let there = |name: &String| names.contains(name);
        let told = self.told.iter().map(|(name, (bulk, _))| match there(name) {
            true => bulk.clone(),
            false => BulkEstimate { probability: 0.0, ..bulk.clone() },
        });
        told.collect()
    }

    /// `bulk`, `bulk_2`, `bulk_3` ..., the first that none has.
    fn free_name(&self) -> String {
        let class = BulkEstimate::CLASS;
        let numbered = (2..=MAX_CELLS).map(|n| format!("{class}_{n}"));
        let mut all = std::iter::once(class.to_owned()).chain(numbered);
        all.find(|name| !self.told.contains_key(name)).unwrap_or_default()
    }

    fn filled(&self) -> impl Iterator<Item = Cell> {
        self.odds.iter().filter(|(_, odds)| **odds >= FILLED).map(|(cell, _)| *cell)
    }

    /// The box around some cells, without a name.
    fn bulk(&self, part: &[Cell]) -> BulkEstimate {
        let end = |i: usize, pick: fn(i16, i16) -> i16| {
            part.iter().map(|cell| cell[i]).reduce(pick).unwrap_or_default()
        };
        let low = Vector3::from_fn(|i, _| (f64::from(end(i, i16::min)) - 0.5) * EDGE);
        let high = Vector3::from_fn(|i, _| (f64::from(end(i, i16::max)) + 0.5) * EDGE);
        let probability = |cell: &Cell| 1.0 / (1.0 + libm::exp(-f64::from(self.odds[cell])));
        BulkEstimate {
            name: String::new(),
            root_from_box: Isometry3::from_parts(((low + high) / 2.0).into(), Default::default()),
            size: high - low,
            // Of a place that is anywhere in a cell.
            covariance: Matrix3::identity() * (EDGE * EDGE / 12.0),
            probability: part.iter().map(probability).sum::<f64>() / part.len() as f64,
        }
    }
}

fn cell_of(at: &Point3<f64>) -> Option<Cell> {
    let cell = at.coords.map(|v| (v / EDGE).round());
    cell.iter().all(|v| v.abs() < f64::from(i16::MAX / 2)).then(|| [0, 1, 2].map(|i| cell[i] as i16))
}

fn middle_of(cell: &Cell) -> Point3<f64> {
    Point3::from(cell.map(|v| f64::from(v) * EDGE))
}

/// The 26 cells beside one.
fn around([x, y, z]: Cell) -> impl Iterator<Item = Cell> {
    let all = (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [i, j, k])));
    all.filter(|step| *step != [0, 0, 0]).map(move |[i, j, k]| [x + i, y + j, z + k])
}

/// Whether two boxes touch each other.
fn touch(a: &BulkEstimate, b: &BulkEstimate) -> bool {
    let apart = a.root_from_box.translation.vector - b.root_from_box.translation.vector;
    (0..3).all(|i| apart[i].abs() <= (a.size[i] + b.size[i]) / 2.0)
}
