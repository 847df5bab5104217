//! Rigid motions in the plane of the table: which one explains what is gone from where it was, and what has come where nothing was.
//!
//! Candidates on a coarse grid are counted; the best are refined by iterated closest points whose distance counts height and colour, too.
//! Cells where a surface ends only match such cells: a plain surface that slides in itself would not say how far.

use nalgebra::{Isometry2, Point2, Vector2};

use super::top_view::{CELL, CellIndex, Occupancy, TopCell, TopView, around, mean_of, middle_of, place_of};

/// Largest turn and shift that are looked for, rad and m, and their steps.
const TURNS: (f64, f64) = (1.0, 0.1);
const SHIFTS: (f64, f64) = (0.14, 2.0 * CELL);
/// Most cells of each kind that count in the coarse search.
const SAMPLES: usize = 120;
/// How many candidates are refined, and in how many steps.
const REFINED: usize = 8;
const STEPS: usize = 12;
/// A cell's match is at most so many cells away.
const REACH: i32 = 3;
/// By how much a difference in height, m, and of a colour, of 255, counts as a distance, m.
const OF_HEIGHT: f64 = 1.0;
const OF_COLOR: f64 = 2e-4;
/// The share of the nearest matches that count.
const TRIMMED: f64 = 0.85;
/// A cell where a surface ends counts as so many others.
const EDGE: f64 = 3.0;

/// A cell with what its match must be like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Feature {
    pub(super) place: CellIndex,
    pub(super) top: TopCell,
    /// Whether a surface ends there.
    pub(super) edge: bool,
}

/// Two looks at a table, and in what they differ.
pub(super) struct ViewChange<'v> {
    pub(super) before: &'v TopView,
    pub(super) after: &'v TopView,
    /// What was there before, and is gone.
    pub(super) gone: Vec<Feature>,
    /// What is there after, and was not.
    pub(super) come: Vec<Feature>,
}

impl<'v> ViewChange<'v> {
    /// The change from one look to another.
    pub(super) fn between(before: &'v TopView, after: &'v TopView) -> Self {
        let differs = |of: &TopView, from: &TopView| -> Vec<Feature> {
            let surfaces = of.occupied().filter(|(place, top)| of.is_surface(*place, top));
            let differing = surfaces
                .filter(|(place, top)| !from.shows(*place, top) && from.at(*place) != Occupancy::Unknown);
            differing.map(|(place, top)| Feature { place, top, edge: of.is_edge(place, &top) }).collect()
        };
        Self { before, after, gone: differs(before, after), come: differs(after, before) }
    }

    /// How many cells it is.
    pub(super) fn size(&self) -> usize {
        self.gone.len() + self.come.len()
    }

    /// What is left of it that a motion does not explain.
    pub(super) fn without(&self, motion: &Isometry2<f64>) -> Self {
        let back = motion.inverse();
        let gone = self.gone.iter().filter(|gone| !matches(self.after, motion, gone)).copied().collect();
        let come = self.come.iter().filter(|come| !matches(self.before, &back, come)).copied().collect();
        Self { before: self.before, after: self.after, gone, come }
    }

    /// How well a motion explains these cells: 1 each, more where a surface ends, and less where something else is.
    fn score(&self, motion: &Isometry2<f64>, gone: &[Feature], come: &[Feature]) -> f64 {
        let (back, sum) = (motion.inverse(), |view, motion, features: &[Feature]| -> f64 {
            features.iter().map(|feature| agreement(view, motion, feature)).sum()
        });
        sum(self.after, motion, gone) + sum(self.before, &back, come)
    }

    /// The motion that explains the most; `None` where nothing has changed.
    pub(super) fn best_motion(&self) -> Option<Isometry2<f64>> {
        let pivot = mean_of(self.gone.iter().map(|gone| gone.place))?;
        let (gone, come) = (sampled(&self.gone), sampled(&self.come));
        let mut candidates: Vec<(f64, Isometry2<f64>)> = Vec::new();
        let turns = (TURNS.0 / TURNS.1) as i32;
        let shifts = (SHIFTS.0 / SHIFTS.1) as i32;
        for turn in -turns..=turns {
            for (x, y) in around((0, 0), shifts) {
                let shift = Vector2::new(f64::from(x), f64::from(y)) * SHIFTS.1;
                let motion = about(&pivot, f64::from(turn) * TURNS.1, shift);
                candidates.push((self.score(&motion, &gone, &come), motion));
            }
        }
        candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
        let refined =
            candidates.into_iter().take(REFINED).flat_map(|(_, motion)| [motion, self.refined(motion)]);
        let scored = refined.map(|motion| (self.score(&motion, &self.gone, &self.come), motion));
        scored.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(score, _)| *score > 0.0).map(|(_, motion)| motion)
    }

    /// A motion, refined by iterated closest points in both directions.
    fn refined(&self, mut motion: Isometry2<f64>) -> Isometry2<f64> {
        for _ in 0..STEPS {
            let back = motion.inverse();
            let forwards = self.gone.iter().filter_map(|gone| {
                let (distance, to) = closest(self.after, &(motion * middle_of(gone.place)), gone)?;
                Some((distance, middle_of(gone.place), to))
            });
            let backwards = self.come.iter().filter_map(|come| {
                let (distance, from) = closest(self.before, &(back * middle_of(come.place)), come)?;
                Some((distance, from, middle_of(come.place)))
            });
            let mut pairs: Vec<_> = forwards.chain(backwards).collect();
            pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
            pairs.truncate((pairs.len() as f64 * TRIMMED).ceil() as usize);
            let pairs: Vec<_> = pairs.into_iter().map(|(_, from, to)| (from, to)).collect();
            let Some(next) = rigid(&pairs) else { return motion };
            let step = motion.inverse() * next;
            motion = next;
            if step.translation.vector.norm() < 1e-5 && step.rotation.angle().abs() < 1e-4 {
                break;
            }
        }
        motion
    }
}

/// A turn about a point, and then a shift.
pub(super) fn about(pivot: &Point2<f64>, angle: f64, shift: Vector2<f64>) -> Isometry2<f64> {
    let turned = Isometry2::rotation(angle);
    Isometry2::new(pivot.coords + shift - turned * pivot.coords, angle)
}

/// The rigid motion that brings points nearest to others, in the sense of least squares (Umeyama 1991, in the plane and without
/// scale); `None` of fewer than two.
pub(super) fn rigid(pairs: &[(Point2<f64>, Point2<f64>)]) -> Option<Isometry2<f64>> {
    if pairs.len() < 2 {
        return None;
    }
    let n = pairs.len() as f64;
    let from = pairs.iter().map(|(from, _)| from.coords).sum::<Vector2<f64>>() / n;
    let to = pairs.iter().map(|(_, to)| to.coords).sum::<Vector2<f64>>() / n;
    let (dot, cross) = pairs.iter().fold((0.0, 0.0), |(dot, cross), (a, b)| {
        let (a, b) = (a.coords - from, b.coords - to);
        (dot + a.dot(&b), cross + a.perp(&b))
    });
    Some(about(&from.into(), libm::atan2(cross, dot), to - from))
}

/// Whether something like a feature is where a motion brings it.
pub(super) fn matches(view: &TopView, motion: &Isometry2<f64>, feature: &Feature) -> bool {
    view.shows(place_of(&(motion * middle_of(feature.place))), &feature.top)
}

/// How well a feature agrees with what is where a motion brings it.
fn agreement(view: &TopView, motion: &Isometry2<f64>, feature: &Feature) -> f64 {
    let place = place_of(&(motion * middle_of(feature.place)));
    if view.shows(place, &feature.top) {
        if !feature.edge {
            return 1.0;
        }
        let ends = |place| view.top(place).is_some_and(|top| view.is_edge(place, &top));
        return if around(place, 1).any(ends) { EDGE } else { 0.0 };
    }
    if view.at(place) == Occupancy::Unknown { 0.0 } else { -1.0 }
}

/// The closest cell that is like a feature, around a point: its distance with that of height and colour, m, and its middle.
fn closest(view: &TopView, at: &Point2<f64>, feature: &Feature) -> Option<(f64, Point2<f64>)> {
    let near = around(place_of(at), REACH).filter_map(|place| {
        let top = view.top(place).filter(|top| top.is_like(&feature.top))?;
        if feature.edge && !view.is_edge(place, &top) {
            return None;
        }
        let middle = middle_of(place);
        let off = (middle - at).norm_squared()
            + (OF_HEIGHT * (top.height - feature.top.height)).powi(2)
            + ((top.color - feature.top.color) * OF_COLOR).norm_squared();
        Some((off.sqrt(), middle))
    });
    near.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Some of many, evenly.
fn sampled(features: &[Feature]) -> Vec<Feature> {
    features.iter().step_by(features.len().div_ceil(SAMPLES).max(1)).copied().collect()
}
