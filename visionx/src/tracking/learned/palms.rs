//! Palms in an image: boxes with seven points.

use nalgebra::Vector2;

use super::candidates::{Candidate, Detector};
use super::square::Square;

/// The network looks at 2016 places. MediaPipe asks for a score of 0.5; the landmarks' presence refuses what is no hand.
pub(super) const PALMS: Detector =
    Detector { input: 192, range: [0.0, 1.0], grids: &[(24, 2), (12, 6)], least_score: 0.3 };
/// The wrist and the knuckle of the middle finger among the points, and the box's corners before them.
const WRIST: usize = 2;
const MIDDLE: usize = 4;
/// The side of the square around a hand, and how far it lies towards the fingers, relative to the palm's box.
const SIDE: f64 = 2.6;
const SHIFT: f64 = 0.5;

/// A palm in an image.
pub(super) type Palm = Candidate<9>;

/// The square around the whole hand, its fingers upwards; `None` where the palm has no size.
pub(super) fn square(palm: &Palm) -> Option<Square> {
    let size: Vector2<f64> = palm.place(1) - palm.place(0);
    let down = (palm.place(WRIST) - palm.place(MIDDLE)).try_normalize(1e-6)?;
    let center = nalgebra::center(&palm.place(0), &palm.place(1)) - down * (SHIFT * size.y);
    Square { center, side: SIDE * size.max(), down }.usable()
}
