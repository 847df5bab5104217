//! The shape of a hand's silhouette: its palm and its stretched fingers.
//!
//! The silhouette is resampled to cells of fixed metric size, so that every length below is in cells of a real hand.
//! Opening it by a disc that is slightly wider than a finger leaves the palm. What the opening removes is a finger if
//! it is as long and as wide as one. Colour, depth and gestures are not used.

use nalgebra::{Point2, Vector2};

use super::paths::along;
use crate::components::{fill_holes, largest, root};
use crate::distance::{inside, to_set};
use crate::mask::{Mask, Region};
use crate::tracking::SeenFinger;

/// Edge of a cell, m.
pub(crate) const CELL: f64 = 0.0015;
/// Radius of the opening disc, m: wider than a finger (about 10 mm), narrower than a hand seen from its edge (14 mm).
const OPENING: f64 = 0.0125;
/// Tolerance at the palm's corners, which the opening rounds off, m.
const MARGIN: f64 = 0.002;
/// Least depth of the gap between two fingers, from the nearer tip, m.
const MIN_GAP: f64 = 0.007;
/// Largest hole that is filled, m^2.
const HOLE: f64 = 8e-5;
/// Most cells along an edge; a larger silhouette is not a hand.
const MAX_CELLS: u32 = 330;

/// A stretched finger in the image.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Finger {
    /// Its end, px.
    pub(crate) tip: Point2<f64>,
    /// Where it leaves the palm, px.
    pub(crate) base: Point2<f64>,
    /// Length beyond the palm, m; measured across the line of sight unless its depth is known.
    pub(crate) length: f64,
    /// Mean width, m.
    pub(crate) width: f64,
    /// Probability that it is a stretched finger, by length and width.
    pub(crate) score: f64,
}

/// The shape of a silhouette.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HandShape {
    /// Centre of the palm, px.
    pub(crate) palm: Point2<f64>,
    /// Radius of the largest disc in the palm, m.
    pub(crate) palm_radius: f64,
    /// Area of the silhouette, m^2.
    pub(crate) area: f64,
    /// Possible fingers, sorted by their angle about the palm.
    pub(crate) fingers: Vec<Finger>,
}

impl Finger {
    /// As input of a gesture recogniser, for a hand with this palm radius, m.
    pub(crate) fn seen(&self, palm_radius: f64) -> SeenFinger {
        let length = self.length / palm_radius.max(1e-3);
        SeenFinger { direction: self.tip - self.base, length, score: self.score }
    }

    /// The same finger when its tip is `rise` m farther along the line of sight than its base, or nearer.
    pub(crate) fn reaching(&self, rise: f64) -> Self {
        let length = libm::hypot(self.length, rise);
        Self { length, score: finger_score(length, self.width), ..self.clone() }
    }
}

/// The shape of a mask's largest component; a pixel is `pixel_m` m wide at its distance. `None` when the mask is
/// empty or far too large for a hand.
pub(crate) fn hand_shape(mask: &Mask, pixel_m: f64) -> Option<HandShape> {
    let grid = Grid::of(mask, CELL / pixel_m)?;
    let inside = inside(&grid.mask);
    let (palm, palm_radius) = largest_disc(&grid.mask, &inside)?;
    let opening = (OPENING / CELL) as f32;
    let core = Mask::of(grid.mask.region(), inside.iter().map(|d| *d > opening));
    let from_core = to_set(&core);
    let fingers = fingers(&grid, &inside, &from_core, &palm);
    Some(HandShape {
        palm: grid.pixel(&palm),
        palm_radius: palm_radius * CELL,
        area: grid.mask.count() as f64 * CELL * CELL,
        fingers,
    })
}

/// A mask in metric cells.
struct Grid {
    mask: Mask,
    origin: Vector2<f64>,
    /// Pixels per cell.
    step: f64,
}

impl Grid {
    fn of(mask: &Mask, step: f64) -> Option<Self> {
        let region = mask.region();
        let cells = |pixels: u32| (f64::from(pixels) / step).ceil() as u32 + 4;
        let (w, h) = (cells(region.width), cells(region.height));
        if !(step.is_finite() && step > 0.05) || mask.count() == 0 || w.max(h) > MAX_CELLS {
            return None;
        }
        let origin = Vector2::new(f64::from(region.x), f64::from(region.y)) - Vector2::repeat(1.5 * step);
        let whole = Region::whole(w, h);
        let mut grid = Self { mask: Mask::empty(whole), origin, step };
        let is_set = |(x, y)| {
            let p = grid.pixel(&Point2::new(f64::from(x), f64::from(y)));
            mask.contains(p.x.round() as i64, p.y.round() as i64)
        };
        grid.mask = largest(&Mask::of(whole, whole.pixels().map(is_set)))?.alone(whole);
        // Fills holes of fewer cells than this.
        fill_holes(&mut grid.mask, (HOLE / (CELL * CELL)).ceil() as u32);
        Some(grid)
    }

    fn pixel(&self, cell: &Point2<f64>) -> Point2<f64> {
        Point2::from(cell.coords * self.step + self.origin)
    }
}

/// The centre of the widest part, cells, and the radius of the disc that fits there. The centre is the mean of all
/// places where a nearly as large disc fits.
fn largest_disc(mask: &Mask, inside: &[f32]) -> Option<(Point2<f64>, f64)> {
    let radius = inside.iter().copied().fold(0.0f32, f32::max);
    let (mut n, mut sum) = (0.0, Vector2::zeros());
    for (i, d) in inside.iter().enumerate() {
        if *d > 0.92 * radius {
            n += 1.0;
            sum += Vector2::new((i % mask.width()) as f64, (i / mask.width()) as f64);
        }
    }
    (radius > 0.0).then(|| (Point2::from(sum / n), f64::from(radius)))
}

/// A part of the hand outside of the palm, flooded from its tip towards the palm.
#[derive(Default)]
struct Branch {
    /// Cells in the order of flooding, the tip first, until the branch meets another finger.
    cells: Vec<usize>,
    /// Distance of its tip from the core, cells.
    top: f32,
    /// Whether it has met another finger; later cells then belong to both.
    met: bool,
    /// The branch that absorbed this one because it is not a finger.
    part_of: Option<usize>,
}

/// Floods the region outside of the palm from far to near. A tip is a separate finger if the flood must come
/// [`MIN_GAP`] nearer to the palm before it meets the flood of a farther tip.
fn fingers(grid: &Grid, inside: &[f32], from_core: &[f32], palm: &Point2<f64>) -> Vec<Finger> {
    let reach = ((OPENING + MARGIN) / CELL) as f32;
    let outside = |i: &usize| grid.mask.data()[*i] != 0 && from_core[*i] > reach && from_core[*i].is_finite();
    let mut order: Vec<usize> = (0..from_core.len()).filter(outside).collect();
    order.sort_by(|&a, &b| from_core[b].total_cmp(&from_core[a]).then(a.cmp(&b)));
    let branches = flood(&order, from_core, grid.mask.width());
    let measure = |branch: &Branch| measure(branch, grid, inside, from_core, reach);
    let mut found: Vec<(f64, Finger)> = branches
        .iter()
        .filter(|b| b.part_of.is_none())
        .map(measure)
        .filter(|f| f.score > 0.02)
        .map(|f| (libm::atan2(f.tip.y - palm.y, f.tip.x - palm.x), f))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, finger)| finger).collect()
}

/// The branches of the flood. `order`: the cells, farthest from the core first.
fn flood(order: &[usize], from_core: &[f32], width: usize) -> Vec<Branch> {
    let mut branches: Vec<Branch> = Vec::new();
    let mut of = vec![usize::MAX; from_core.len()];
    // For each branch the one that continues its flood.
    let mut heirs: Vec<usize> = Vec::new();
    for &cell in order {
        let mut touched: Vec<usize> =
            [cell.wrapping_sub(width + 1), cell.wrapping_sub(width), cell.wrapping_sub(width - 1)]
                .into_iter()
                .chain([cell.wrapping_sub(1), cell + 1, cell + width - 1, cell + width, cell + width + 1])
                .filter_map(|n| of.get(n).copied().filter(|&b| b != usize::MAX))
                .map(|b| root(&mut heirs, b))
                .collect();
        touched.sort_unstable();
        touched.dedup();
        let level = from_core[cell];
        // Branches are numbered from the farthest tip.
        let Some(&first) = touched.first() else {
            of[cell] = branches.len();
            heirs.push(branches.len());
            branches.push(Branch { cells: vec![cell], top: level, ..Branch::default() });
            continue;
        };
        of[cell] = first;
        for &other in &touched[1..] {
            heirs[other] = first;
            if branches[other].met || branches[other].top - level >= (MIN_GAP / CELL) as f32 {
                branches[first].met = true;
                branches[other].met = true;
            } else {
                let cells = std::mem::take(&mut branches[other].cells);
                branches[other].part_of = Some(first);
                if !branches[first].met {
                    branches[first].cells.extend(cells);
                }
            }
        }
        if !branches[first].met {
            branches[first].cells.push(cell);
        }
    }
    branches
}

fn measure(branch: &Branch, grid: &Grid, inside: &[f32], from_core: &[f32], reach: f32) -> Finger {
    let w = grid.mask.width();
    let bottom = branch.cells.iter().map(|&i| from_core[i]).fold(f32::MAX, f32::min);
    let along = along(&branch.cells, |i| from_core[i] < bottom + 1.5, w);
    let place = |i: usize| Vector2::new((i % w) as f64, (i / w) as f64);
    let (reached, end) = along
        .iter()
        .fold((0.0, Vector2::zeros()), |far, (&i, &d)| if d > far.0 { (d, place(i)) } else { far });
    // The ends are means over a few millimetres.
    let mean = |keep: &dyn Fn(usize) -> bool| {
        let chosen = branch.cells.iter().filter(|&&i| keep(i));
        let (n, sum) = chosen.fold((0.0, Vector2::zeros()), |(n, s), &i| (n + 1.0, s + place(i)));
        grid.pixel(&Point2::from(sum / f64::max(n, 1.0)))
    };
    let is_end =
        |i: usize| along.get(&i).is_some_and(|d| *d > reached - 2.0) && (place(i) - end).norm() < 8.0;
    // The widest disc in the finger's last 4 cm, without the rounded tip.
    let widest = branch.cells.iter().filter(|&&i| from_core[i] > branch.top - (0.04 / CELL) as f32);
    let width = 2.0 * CELL * f64::from(widest.map(|&i| inside[i]).fold(0.0, f32::max));
    let length = f64::from((branch.top - bottom).max(reached) + bottom - reach) * CELL + MARGIN;
    let (tip, base) = (mean(&is_end), mean(&|i| from_core[i] < bottom + 3.0));
    Finger { tip, base, length, width, score: finger_score(length, width) }
}

/// Probability that a protrusion of this length and width (m) is a stretched finger.
fn finger_score(length: f64, width: f64) -> f64 {
    let logistic = |x: f64| 1.0 / (1.0 + libm::exp(-x));
    logistic((length - 0.018) / 0.003) * logistic((width - 0.007) / 0.001) * logistic((0.030 - width) / 0.001)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws a thick line, m, into a mask of 1 mm pixels.
    fn stroke(mask: &mut Mask, from: [f64; 2], to: [f64; 2], radius: f64) {
        let (a, b) = (Vector2::from(from), Vector2::from(to));
        let w = mask.width();
        for i in 0..mask.data().len() {
            let p = Vector2::new((i % w) as f64, (i / w) as f64);
            let t = ((p - a).dot(&(b - a)) / (b - a).norm_squared().max(1e-9)).clamp(0.0, 1.0);
            if (p - a - (b - a) * t).norm() <= radius {
                mask.data_mut()[i] = 1;
            }
        }
    }

    #[test]
    fn counts_and_measures_fingers() {
        for n in 0..=4usize {
            let mut mask = Mask::empty(Region::whole(260, 260));
            stroke(&mut mask, [130.0, 150.0], [130.0, 150.0], 40.0);
            let ends: Vec<[f64; 2]> = (0..n)
                .map(|i| -0.6 + 0.4 * i as f64)
                .map(|a| [130.0 + 115.0 * libm::sin(a), 150.0 - 115.0 * libm::cos(a)])
                .collect();
            ends.iter().for_each(|e| stroke(&mut mask, [130.0, 150.0], *e, 9.0));
            let shape = hand_shape(&mask, 0.001).unwrap();
            assert!((shape.palm - Point2::new(130.0, 150.0)).norm() < 3.0, "{shape:?}");
            assert!((shape.palm_radius - 0.04).abs() < 0.003);
            assert_eq!(shape.fingers.iter().filter(|f| f.score > 0.5).count(), n, "{shape:?}");
            for (finger, end) in shape.fingers.iter().zip(&ends) {
                let axis = (Vector2::from(*end) - Vector2::new(130.0, 150.0)).normalize();
                let tip = Point2::from(Vector2::from(*end) + axis * 9.0);
                assert!((finger.tip - tip).norm() < 3.0, "{finger:?} {tip}");
                assert!(
                    (finger.length - 0.078).abs() < 0.008 && (finger.width - 0.018).abs() < 0.004,
                    "{finger:?}"
                );
            }
        }
    }

    #[test]
    fn the_end_of_a_bent_finger_is_its_tip_and_not_its_knuckle() {
        let mut mask = Mask::empty(Region::whole(260, 260));
        stroke(&mut mask, [130.0, 170.0], [130.0, 170.0], 40.0);
        stroke(&mut mask, [130.0, 170.0], [130.0, 80.0], 9.0);
        stroke(&mut mask, [130.0, 80.0], [185.0, 95.0], 8.0);
        let shape = hand_shape(&mask, 0.001).unwrap();
        let fingers: Vec<&Finger> = shape.fingers.iter().filter(|f| f.score > 0.5).collect();
        assert_eq!(fingers.len(), 1, "{shape:?}");
        assert!((fingers[0].tip - Point2::new(192.0, 97.0)).norm() < 5.0, "{:?}", fingers[0]);
        // The shortest path inside it cuts the corner at its joint.
        assert!((fingers[0].length - 0.090).abs() < 0.008, "{:?}", fingers[0]);
    }

    #[test]
    fn nothing_and_everything_are_no_hands() {
        assert!(hand_shape(&Mask::empty(Region::whole(0, 0)), 0.001).is_none());
        assert!(hand_shape(&Mask::empty(Region::whole(30, 30)), 0.001).is_none());
        let mut full = Mask::empty(Region::whole(640, 480));
        full.data_mut().fill(1);
        assert!(hand_shape(&full, 0.002).is_none());
        let mut dot = Mask::empty(Region::whole(1, 1));
        dot.data_mut().fill(1);
        assert!(hand_shape(&dot, f64::NAN).is_none());
    }
}
