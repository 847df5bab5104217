//! By what a thing is known again: its edges, the area of its upper surface, and how its colours are distributed.

use nalgebra::Point2;

use super::hypothesis::Hypothesis;
use super::top_view::{CELL, middle_of};
use crate::rectangle::Rectangle;

/// Number of quantiles of each channel.
const QUANTILES: usize = 9;
/// Numbers of an appearance.
const NUMBERS: usize = 4 + 3 * QUANTILES;
/// What counts as a difference of 1: of an edge or of the root of the area, m, and of colours, of 255.
const OF_LENGTH: f64 = 0.004;
const OF_COLOR: f64 = 12.0;
/// What differs by more than this is not the same, and what is the same is nearer than the next by this factor.
const SAME: f64 = 3.5;
const NEXT: f64 = 0.75;

/// The looks of a thing, wherever it stands and however it is turned.
#[derive(Clone, Debug, PartialEq)]
pub struct Appearance {
    /// Longer edge, shorter edge, height, and the root of the area of its upper surface, m.
    lengths: [f64; 4],
    /// For each channel its quantiles over the upper surface, 0 to 255.
    colors: [[f64; QUANTILES]; 3],
}

impl Appearance {
    /// The looks of a hypothesis.
    pub fn of(hypothesis: &Hypothesis) -> Self {
        let points: Vec<Point2<f64>> = hypothesis.cells.keys().map(|place| middle_of(*place)).collect();
        let [long, short] = Rectangle::around(&points, 0.0, 2e-4).map_or([0.0; 2], |around| around.size);
        let area = (hypothesis.cells.len() as f64).sqrt() * CELL;
        let colors = [0, 1, 2].map(|channel| {
            let mut values: Vec<f64> = hypothesis.cells.values().map(|top| top.color[channel]).collect();
            values.sort_by(f64::total_cmp);
            let last = values.len().saturating_sub(1) as f64;
            std::array::from_fn(|k| {
                let at = last * (k as f64 + 0.5) / QUANTILES as f64;
                values.get(at.round() as usize).copied().unwrap_or(0.0)
            })
        });
        Self { lengths: [long, short, hypothesis.height(), area], colors }
    }

    /// Its numbers, for memory.
    pub fn numbers(&self) -> Vec<f64> {
        self.lengths.iter().chain(self.colors.iter().flatten()).copied().collect()
    }

    /// The appearance of which these are the numbers; `None` where they are not as many.
    pub fn from_numbers(numbers: &[f64]) -> Option<Self> {
        let numbers: &[f64; NUMBERS] = numbers.try_into().ok()?;
        let colors = |channel: usize| std::array::from_fn(|k| numbers[4 + channel * QUANTILES + k]);
        Some(Self { lengths: std::array::from_fn(|k| numbers[k]), colors: [0, 1, 2].map(colors) })
    }

    /// How much it differs from another one: 0 where they are equal; from about 3 on they are of different things.
    pub fn difference(&self, other: &Self) -> f64 {
        let lengths = self.lengths.iter().zip(&other.lengths).map(|(a, b)| ((a - b) / OF_LENGTH).powi(2));
        let channels = self.colors.iter().zip(&other.colors).map(|(a, b)| {
            let off: f64 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
            (off / QUANTILES as f64 / OF_COLOR).powi(2)
        });
        lengths.chain(channels).sum::<f64>().sqrt()
    }
}

/// The index of the appearance that is the same as `seen`: near enough, and clearly nearer than the next.
pub fn most_alike(seen: &Appearance, known: &[Appearance]) -> Option<usize> {
    let mut all: Vec<(f64, usize)> = known.iter().enumerate().map(|(i, k)| (seen.difference(k), i)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (best, index) = *all.first()?;
    let next = all.get(1).map_or(f64::INFINITY, |(next, _)| *next);
    (best < SAME && best < NEXT * next).then_some(index)
}
