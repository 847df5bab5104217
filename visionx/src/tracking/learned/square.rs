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
        if self.down == Vector2::y() && samples >= MANY_SAMPLES && outside == Outside::Black {
            let places = 0..size * samples;
            let start = |y: usize| self.in_image(0.5 * step, (y as f64 + 0.5) * step);
            let columns: Vec<_> = places.clone().map(|x| start(0).x + along.x * x as f64).collect();
            let rows: Vec<_> = places.map(|y| start(y).y).collect();
            sum_upright(image, [&columns, &rows], samples, &mut values);
            values.iter_mut().for_each(|value| *value *= weight);
            return values;
        }
        for (row, values) in values.chunks_exact_mut(3 * size).enumerate() {
            for part in 0..samples {
                let y = ((row * samples + part) as f64 + 0.5) * step;
                let start = self.in_image(0.5 * step, y);
                for (column, value) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                    for i in 0..samples {
                        let at = start + along * (column * samples + i) as f64;
                        let color = match samples >= MANY_SAMPLES {
                            true => pixel(image, floor(at.x + 0.5), floor(at.y + 0.5), outside),
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

/// The sums of the pixels at these columns and rows, of which `samples` x `samples` each make a pixel of the output; black outside of
/// the image. All sums are whole numbers, so their order changes no bit.
fn sum_upright(image: &RgbImage, [columns, rows]: [&[f64]; 2], samples: usize, values: &mut [f32]) {
    let width = image.width() as usize;
    let inside = |at: f64, length: u32| {
        let nearest = floor(at + 0.5);
        (0..i64::from(length)).contains(&nearest).then_some(nearest as usize)
    };
    let columns: Vec<_> = columns.iter().map(|x| inside(*x, image.width())).collect();
    let size = columns.len() / samples;
    let mut down = vec![0_u16; 3 * width];
    for (rows, values) in rows.chunks_exact(samples).zip(values.chunks_exact_mut(3 * size)) {
        down.fill(0);
        for y in rows.iter().filter_map(|y| inside(*y, image.height())) {
            let row = &image.data()[3 * width * y..][..3 * width];
            down.iter_mut().zip(row).for_each(|(sum, value)| *sum += u16::from(*value));
        }
        let (pixels, _) = down.as_chunks::<3>();
        for (columns, value) in columns.chunks_exact(samples).zip(values.as_chunks_mut::<3>().0) {
            for x in columns.iter().flatten() {
                value.iter_mut().zip(pixels[*x]).for_each(|(sum, value)| *sum += f32::from(value));
            }
        }
    }
}

/// The largest whole number that is not above a value. Common processors have no instruction for `f64::floor`, which is a call then.
fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole.saturating_sub(i64::from(whole as f64 > value))
}

/// The colour at a pixel, 0 to 255.
fn pixel(image: &RgbImage, x: i64, y: i64, outside: Outside) -> [f32; 3] {
    let (right, bottom) = (i64::from(image.width()) - 1, i64::from(image.height()) - 1);
    let inside = x >= 0 && y >= 0 && x <= right && y <= bottom;
    if !inside && (outside == Outside::Black || right < 0 || bottom < 0) {
        return [0.0; 3];
    }
    image.pixel(x.clamp(0, right) as u32, y.clamp(0, bottom) as u32).map(f32::from)
}

/// The colour between four pixels, 0 to 255.
fn blend(image: &RgbImage, at: &Point2<f64>, outside: Outside) -> [f32; 3] {
    let (left, top) = (floor(at.x), floor(at.y));
    let (right, below) = (left.saturating_add(1), top.saturating_add(1));
    let [a, b] = [left, right].map(|x| pixel(image, x, top, outside));
    let [c, d] = [left, right].map(|x| pixel(image, x, below, outside));
    let (along, down) = ((at.x - left as f64) as f32, (at.y - top as f64) as f32);
    std::array::from_fn(|i| {
        let (upper, lower) = (a[i] + (b[i] - a[i]) * along, c[i] + (d[i] - c[i]) * along);
        upper + (lower - upper) * down
    })
}
