//! Where a detecting network sees something in an image: at each place of its grids it gives a score, a box and some points, of
//! which the best that do not overlap are kept. What the points mean is up to who asks.
//!
//! # Source
//! Liu et al. 2016, "SSD: Single Shot MultiBox Detector"; boxes that overlap are averaged as by Bazarevsky et al. 2019, "BlazeFace".

use nalgebra::Point2;

use super::square::{Outside, Square};
use crate::frame::RgbImage;
use crate::network::{Network, sigmoid};

/// The outputs of detecting networks: boxes and points, and scores.
pub(super) const OUTPUTS: [&str; 2] = ["Identity", "Identity_1"];
/// Boxes whose intersection is a larger part of their union than this are one thing.
const OVERLAP: f32 = 0.3;

/// How a detecting network sees an image, and where it looks.
pub(super) struct Detector {
    /// Width of the network's input, px.
    pub(super) input: usize,
    /// The values of black and white in the input.
    pub(super) range: [f32; 2],
    /// Cells along a side of each grid, and places in each cell.
    pub(super) grids: &'static [(usize, usize)],
    /// Least score.
    pub(super) least_score: f32,
}

/// Something in an image, with `P` - 2 points.
#[derive(Clone, Debug)]
pub(super) struct Candidate<const P: usize> {
    score: f32,
    /// The box's upper left and lower right corner, then the points; relative to the square around the image.
    places: [[f32; 2]; P],
    image: Square,
}

impl Detector {
    /// What the network sees, the most certain first. It sees the image in the middle of a square `scale` times as large.
    pub(super) fn find<const P: usize>(
        &self,
        network: &mut Network,
        image: &RgbImage,
        scale: f64,
    ) -> Vec<Candidate<P>> {
        let around = Square::around(image);
        let square = Square { side: scale * around.side, ..around };
        let mut input = square.sample(image, self.input, Outside::Black);
        let [black, white] = self.range;
        input.iter_mut().for_each(|value| *value = black + (white - black) * *value);
        let outputs = network.run(&input);
        let anchors = self.grids.iter().flat_map(|&(cells, each)| {
            (0..cells * cells * each).map(move |i| {
                let cell = i / each;
                [cell % cells, cell / cells].map(|at| (at as f32 + 0.5) / cells as f32)
            })
        });
        let places = outputs[0].chunks_exact(2 * P).zip(outputs[1]).zip(anchors);
        let found = places.filter_map(|((values, score), anchor)| {
            let score = sigmoid(*score);
            let places = || self.places(anchor, values);
            (score >= self.least_score).then(|| Candidate { score, places: places(), image: square })
        });
        distinct(found.collect())
    }

    /// The corners and points that the values of a place mean: the box's centre, width and height, then the points.
    fn places<const P: usize>(&self, anchor: [f32; 2], values: &[f32]) -> [[f32; 2]; P] {
        let scaled = |i: usize| values[i] / self.input as f32;
        let (center, half) = ([scaled(0), scaled(1)], [scaled(2) / 2.0, scaled(3) / 2.0]);
        std::array::from_fn(|i| {
            std::array::from_fn(|axis| {
                anchor[axis]
                    + match i {
                        0 => center[axis] - half[axis],
                        1 => center[axis] + half[axis],
                        i => scaled(2 * i + axis),
                    }
            })
        })
    }
}

/// One of all that overlap: their mean, weighted by their scores.
fn distinct<const P: usize>(mut found: Vec<Candidate<P>>) -> Vec<Candidate<P>> {
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept = Vec::new();
    while let Some(best) = found.first().cloned() {
        let (same, others): (Vec<_>, Vec<_>) =
            found.into_iter().partition(|other| other.overlap(&best) > OVERLAP);
        let sum: f32 = same.iter().map(|one| one.score).sum();
        let mean = |i: usize, j: usize| same.iter().map(|p| p.places[i][j] * p.score).sum::<f32>() / sum;
        let places = std::array::from_fn(|i| [mean(i, 0), mean(i, 1)]);
        // A box without an area overlaps with nothing, not even itself.
        found = others.into_iter().filter(|other| other.area() > 0.0).collect();
        kept.push(Candidate { places: if same.is_empty() { best.places } else { places }, ..best });
    }
    kept
}

impl<const P: usize> Candidate<P> {
    /// A corner (0 or 1) or a point (2 and more) in the image, px.
    pub(super) fn place(&self, i: usize) -> Point2<f64> {
        let [x, y] = self.places[i].map(f64::from);
        self.image.in_image(x, y)
    }

    fn area(&self) -> f32 {
        let [left, top] = self.places[0];
        let [right, bottom] = self.places[1];
        (right - left).max(0.0) * (bottom - top).max(0.0)
    }

    /// The area of the intersection of two boxes, relative to that of their union.
    fn overlap(&self, other: &Self) -> f32 {
        let ([[a, b], [c, d]], [[e, f], [g, h]]) = (self.corners(), other.corners());
        let common = (c.min(g) - a.max(e)).max(0.0) * (d.min(h) - b.max(f)).max(0.0);
        let union = self.area() + other.area() - common;
        if union > 0.0 { common / union } else { 0.0 }
    }

    fn corners(&self) -> [[f32; 2]; 2] {
        [self.places[0], self.places[1]]
    }
}
