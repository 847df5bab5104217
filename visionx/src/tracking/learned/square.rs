//! A square part of an image, which may be turned, as the input of a network.

use nalgebra::{Point2, Vector2};

use crate::frame::RgbImage;

/// A square in an image. Whole numbers are the centres of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Square {
    /// Its centre, px.
    pub(super) center: Point2<f64>,
    /// Its side, px.
    pub(super) side: f64,
    /// Unit vector from its top to its bottom.
    pub(super) down: Vector2<f64>,
}

/// What is outside of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outside {
    Black,
    /// The nearest pixel of the image.
    Nearest,
}

/// Most places along a side of an output pixel at which the image is looked at.
const MOST_SAMPLES: usize = 8;
/// From so many places on, the nearest pixel is exact enough for each.
const MANY_SAMPLES: usize = 3;

impl Square {
    /// The smallest upright square around an image.
    pub(super) fn around(image: &RgbImage) -> Self {
        let (width, height) = (f64::from(image.width()), f64::from(image.height()));
        let center = Point2::new((width - 1.0) / 2.0, (height - 1.0) / 2.0);
        Self { center, side: width.max(height), down: Vector2::y() }
    }

    /// Unit vector from its left to its right.
    pub(super) fn right(&self) -> Vector2<f64> {
        Vector2::new(self.down.y, -self.down.x)
    }

    /// The square, if it can be sampled.
    pub(super) fn usable(self) -> Option<Self> {
        (self.side >= 1.0 && self.side.is_finite() && self.center.coords.amax().is_finite()).then_some(self)
    }

    /// A point of the image, px, from its place in the square: 0 to 1 from the left and from the top.
    pub(super) fn in_image(&self, x: f64, y: f64) -> Point2<f64> {
        self.center + self.right() * ((x - 0.5) * self.side) + self.down * ((y - 0.5) * self.side)
    }

    /// The square as an image of `size` x `size` pixels: red, green and blue from 0 to 1, rows from the top. Where it shrinks the
    /// image, pixels are averaged.
    pub(super) fn sample(&self, image: &RgbImage, size: usize, outside: Outside) -> Vec<f32> {
        let samples = (self.side / size as f64).ceil().clamp(1.0, MOST_SAMPLES as f64) as usize;
        let step = 1.0 / (size * samples) as f64;
        let weight = 1.0 / (255.0 * (samples * samples) as f32);
        let along = self.right() * (self.side * step);
        let mut values = vec![0.0; size * size * 3];
        for (row, values) in values.chunks_exact_mut(3 * size).enumerate() {
            for part in 0..samples {
                let y = ((row * samples + part) as f64 + 0.5) * step;
                let start = self.in_image(0.5 * step, y);
                for (column, value) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                    for i in 0..samples {
                        let at = start + along * (column * samples + i) as f64;
                        let color = match samples >= MANY_SAMPLES {
                            true => pixel(image, (at.x + 0.5).floor(), (at.y + 0.5).floor(), outside),
                            false => blend(image, &at, outside),
                        };
                        value.iter_mut().zip(color).for_each(|(value, color)| *value += color);
                    }
                }
            }
            values.iter_mut().for_each(|value| *value *= weight);
        }
        values
    }
}

/// The colour at a pixel, 0 to 255.
fn pixel(image: &RgbImage, x: f64, y: f64, outside: Outside) -> [f32; 3] {
    let (right, bottom) = (f64::from(image.width()) - 1.0, f64::from(image.height()) - 1.0);
    let inside = x >= 0.0 && y >= 0.0 && x <= right && y <= bottom;
    if !inside && (outside == Outside::Black || right < 0.0 || bottom < 0.0) {
        return [0.0; 3];
    }
    image.pixel(x.clamp(0.0, right) as u32, y.clamp(0.0, bottom) as u32).map(f32::from)
}

/// The colour between four pixels, 0 to 255.
fn blend(image: &RgbImage, at: &Point2<f64>, outside: Outside) -> [f32; 3] {
    let (left, top) = (at.x.floor(), at.y.floor());
    let (along, down) = ((at.x - left) as f32, (at.y - top) as f32);
    let [a, b] = [0.0, 1.0].map(|x| pixel(image, left + x, top, outside));
    let [c, d] = [0.0, 1.0].map(|x| pixel(image, left + x, top + 1.0, outside));
    std::array::from_fn(|i| {
        let (upper, lower) = (a[i] + (b[i] - a[i]) * along, c[i] + (d[i] - c[i]) * along);
        upper + (lower - upper) * down
    })
}
