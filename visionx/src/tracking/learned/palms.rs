//! Palms in an image: the network gives a score, a box and seven points at each of 2016 places of a grid, of which the best that
//! do not overlap are kept.

use nalgebra::{Point2, Vector2};

use super::square::{Outside, Square};
use crate::frame::RgbImage;
use crate::network::{Network, sigmoid};

/// The network's outputs: boxes and points, and scores.
pub(super) const OUTPUTS: [&str; 2] = ["Identity", "Identity_1"];
/// Values of a place: the box's centre, width and height, and seven points.
const VALUES: usize = 18;
/// Width of the network's input, px.
const INPUT: usize = 192;
/// Cells along a side of each grid, and places in each cell.
const GRIDS: [(usize, usize); 2] = [(24, 2), (12, 6)];
/// Least score. MediaPipe asks for 0.5; the landmarks' presence refuses what is no hand.
const LEAST_SCORE: f32 = 0.3;
/// Boxes whose intersection is a larger part of their union than this are one palm.
const OVERLAP: f32 = 0.3;
/// The wrist and the knuckle of the middle finger among the points, and the box's corners before them.
const WRIST: usize = 2;
const MIDDLE: usize = 4;
/// The side of the square around a hand, and how far it lies towards the fingers, relative to the palm's box.
const SIDE: f64 = 2.6;
const SHIFT: f64 = 0.5;

/// A palm in an image.
#[derive(Clone, Debug)]
pub(super) struct Palm {
    score: f32,
    /// The box's upper left and lower right corner, then its points; relative to the square around the image.
    places: [[f32; 2]; 9],
    image: Square,
}

/// The palms in an image, the most certain first. The network sees the image in the middle of a square `scale` times as large.
pub(super) fn find(network: &mut Network, image: &RgbImage, scale: f64) -> Vec<Palm> {
    let around = Square::around(image);
    let square = Square { side: scale * around.side, ..around };
    let input = square.sample(image, INPUT, Outside::Black);
    let outputs = network.run(&input);
    let anchors = GRIDS.into_iter().flat_map(|(cells, each)| {
        (0..cells * cells * each).map(move |i| {
            let cell = i / each;
            [cell % cells, cell / cells].map(|at| (at as f32 + 0.5) / cells as f32)
        })
    });
    let places = outputs[0].as_chunks::<VALUES>().0.iter().zip(outputs[1]).zip(anchors);
    let palms = places.filter_map(|((values, score), anchor)| {
        let score = sigmoid(*score);
        (score >= LEAST_SCORE).then(|| Palm::at(anchor, values, score, square))
    });
    distinct(palms.collect())
}

/// One palm of all that overlap: their mean, weighted by their scores.
fn distinct(mut palms: Vec<Palm>) -> Vec<Palm> {
    palms.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept = Vec::new();
    while let Some(best) = palms.first().cloned() {
        let (same, others): (Vec<_>, Vec<_>) =
            palms.into_iter().partition(|palm| palm.overlap(&best) > OVERLAP);
        let sum: f32 = same.iter().map(|palm| palm.score).sum();
        let mean = |i: usize, j: usize| same.iter().map(|p| p.places[i][j] * p.score).sum::<f32>() / sum;
        let places = std::array::from_fn(|i| [mean(i, 0), mean(i, 1)]);
        // A box without an area overlaps with nothing, not even itself.
        palms = others.into_iter().filter(|palm| palm.area() > 0.0).collect();
        kept.push(Palm { places: if same.is_empty() { best.places } else { places }, ..best });
    }
    kept
}

impl Palm {
    fn at(anchor: [f32; 2], values: &[f32; VALUES], score: f32, image: Square) -> Self {
        let scaled = values.map(|value| value / INPUT as f32);
        let ([x, y], [half_width, half_height]) =
            ([scaled[0], scaled[1]], [scaled[2] / 2.0, scaled[3] / 2.0]);
        let places = std::array::from_fn(|i| {
            let [x, y] = match i {
                0 => [x - half_width, y - half_height],
                1 => [x + half_width, y + half_height],
                i => [scaled[2 * i], scaled[2 * i + 1]],
            };
            [x + anchor[0], y + anchor[1]]
        });
        Self { score, places, image }
    }

    fn area(&self) -> f32 {
        let [[left, top], [right, bottom], ..] = self.places;
        (right - left).max(0.0) * (bottom - top).max(0.0)
    }

    /// The area of the intersection of two boxes, relative to that of their union.
    fn overlap(&self, other: &Self) -> f32 {
        let ([[a, b], [c, d], ..], [[e, f], [g, h], ..]) = (self.places, other.places);
        let common = (c.min(g) - a.max(e)).max(0.0) * (d.min(h) - b.max(f)).max(0.0);
        let union = self.area() + other.area() - common;
        if union > 0.0 { common / union } else { 0.0 }
    }

    /// The square around the whole hand, its fingers upwards; `None` where the palm has no size.
    pub(super) fn square(&self) -> Option<Square> {
        let place = |i: usize| -> Point2<f64> {
            let [x, y] = self.places[i].map(f64::from);
            self.image.in_image(x, y)
        };
        let size: Vector2<f64> = place(1) - place(0);
        let down = (place(WRIST) - place(MIDDLE)).try_normalize(1e-6)?;
        let center = nalgebra::center(&place(0), &place(1)) - down * (SHIFT * size.y);
        let square = Square { center, side: SIDE * size.max(), down };
        (square.side >= 1.0 && square.side.is_finite() && center.coords.amax().is_finite()).then_some(square)
    }
}
