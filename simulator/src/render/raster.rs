//! The canvas and its scan lines: which pixels of a row a form covers, and which form is nearest in each pixel.
//!
//! A pixel (u, v) looks along d = ((u - cx)/f, (v - cy)/f, 1) in the camera frame, so that the distance along a ray
//! is the depth. Every dot product with d is linear in u along a row: a [`LinearForm`]. The z-buffer holds 1/depth, which
//! is linear in u on a plane; 0 means that nothing is visible.

use std::ops::Range;

use armarium_visionx::{DepthImage, PinholeCamera, RgbImage};
use nalgebra::{Point3, Vector3};
use wide::f32x8;

use super::scene::Rendering;

/// Smallest depth that is drawn, m.
pub(super) const NEAR: f64 = 0.01;
const NEARNESS_LIMIT: f32 = (1.0 / NEAR) as f32;
/// Number of pixels evaluated together, with vector instructions.
const CHUNK: usize = 8;
/// The pixels of a chunk, counted from its first.
const STEPS: Lanes = Lanes::new([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);

/// A value for each pixel of a chunk.
pub(super) type Lanes = f32x8;
/// A colour in one number, red in the lowest byte.
pub(super) type Color = u32;
/// The colours of a chunk.
pub(super) type Colors = [Color; CHUNK];

/// A colour in one number.
pub(super) fn packed([red, green, blue]: [u8; 3]) -> Color {
    u32::from_le_bytes([red, green, blue, 0])
}

/// The bytes of a colour.
fn unpacked(color: Color) -> [u8; 3] {
    let [red, green, blue, _] = color.to_le_bytes();
    [red, green, blue]
}

/// `f` of each pixel of a chunk, one after the other: for what vector instructions cannot do, such as looking up.
#[inline(always)]
pub(super) fn each<T>(f: impl FnMut(usize) -> T) -> [T; CHUNK] {
    std::array::from_fn(f)
}

/// The whole number above a value from 0 on; without a call, which `ceil` is where the machine has no instruction for it.
#[inline(always)]
fn up(value: f64) -> usize {
    // Pictures have fewer pixels than 2^32, and machines have no instruction for conversions of 64 bits without a sign.
    let below = value as u32;
    below.saturating_add(u32::from(f64::from(below) < value)) as usize
}

/// Colours and inverse depths of one picture.
#[derive(Clone)]
pub(super) struct Canvas {
    camera: PinholeCamera,
    width: usize,
    height: usize,
    /// Both have a chunk more than pixels, so that every chunk is whole.
    color: Vec<[u8; 3]>,
    nearness: Vec<f32>,
}

/// One scan line of the camera.
#[derive(Clone, Copy)]
pub(super) struct ScanLine {
    /// Its index, px.
    pub(super) v: usize,
    /// The y component of all its rays.
    pub(super) y: f64,
    inverse_focal: f64,
    center_u: f64,
}

/// A linear function `slope * u + at_zero` of the column along one row.
#[derive(Clone, Copy)]
pub(super) struct LinearForm {
    slope: f64,
    at_zero: f64,
}

/// A [`LinearForm`] counted from the first pixel of a run.
#[derive(Clone, Copy)]
pub(super) struct PixelLine {
    start: f32,
    slope: f32,
}

/// Columns from `low` to `high`, inclusive; empty if `low > high`.
#[derive(Clone, Copy)]
pub(super) struct ColumnRange {
    low: f64,
    high: f64,
}

/// A rectangle of pixels, borders included.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    u: [usize; 2],
    v: [usize; 2],
}

/// Range of directions relative to the optical axis: x/z or y/z.
type Extent = [f64; 2];

impl LinearForm {
    /// The same form counted from column `u`.
    pub(super) fn line(self, u: usize) -> PixelLine {
        PixelLine { start: (self.slope * u as f64 + self.at_zero) as f32, slope: self.slope as f32 }
    }
}

impl PixelLine {
    /// The values `k` pixels after the start.
    #[inline(always)]
    pub(super) fn at(self, k: Lanes) -> Lanes {
        self.slope * k + self.start
    }
}

impl ScanLine {
    /// The dot product of `n` (camera frame) with the row's rays.
    pub(super) fn form(&self, n: &Vector3<f64>) -> LinearForm {
        let slope = n.x * self.inverse_focal;
        LinearForm { slope, at_zero: n.y * self.y + n.z - slope * self.center_u }
    }

    /// The column of the direction `x`, relative to the optical axis.
    pub(super) fn column(&self, x: f64) -> f64 {
        x / self.inverse_focal + self.center_u
    }

    /// The x component of the rays.
    pub(super) fn x(&self) -> LinearForm {
        self.form(&Vector3::x())
    }
}

impl ColumnRange {
    /// Columns between two values.
    pub(super) fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// The part in which `form >= 0`.
    pub(super) fn keep(self, form: LinearForm) -> Self {
        let root = -form.at_zero / form.slope;
        if form.slope > 0.0 {
            Self { low: self.low.max(root), ..self }
        } else if form.slope < 0.0 {
            Self { high: self.high.min(root), ..self }
        } else if form.at_zero >= 0.0 {
            self
        } else {
            Self { low: 1.0, high: 0.0 }
        }
    }

    /// The part in another span too.
    pub(super) fn and(self, other: Self) -> Self {
        Self { low: self.low.max(other.low), high: self.high.min(other.high) }
    }

    /// First and last pixel whose centre lies in the span.
    pub(super) fn pixels(self) -> Option<(usize, usize)> {
        let low = up(self.low.max(0.0));
        // A number below zero is no pixel, and the cast of one over zero goes down.
        (self.high >= f64::from(low as u32)).then_some((low, self.high as u32 as usize))
    }
}

impl Bounds {
    /// The smallest rectangle that contains both.
    pub(super) fn union(self, other: Self) -> Self {
        let join = |a: [usize; 2], b: [usize; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Self { u: join(self.u, other.u), v: join(self.v, other.v) }
    }

    /// Whether it has few columns: then its pixels are drawn one by one.
    pub(super) fn is_narrow(self) -> bool {
        self.u[1] - self.u[0] < CHUNK / 2
    }

    /// Its columns, one by one, each with its distance from `u`.
    pub(super) fn each_column(self, u: f64) -> impl Iterator<Item = (usize, f64)> {
        counted(self.u, u)
    }

    /// Its rows, one by one, each with its distance from `v`.
    pub(super) fn each_row(self, v: f64) -> impl Iterator<Item = (usize, f64)> {
        counted(self.v, v)
    }

    /// Its columns.
    pub(super) fn columns(self) -> ColumnRange {
        ColumnRange::new(self.u[0] as f64, self.u[1] as f64)
    }
}

impl Canvas {
    /// An empty canvas of one colour.
    pub(super) fn new(camera: PinholeCamera, color: [u8; 3]) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let pixels = width * height;
        Self {
            camera,
            width,
            height,
            color: vec![color; pixels + CHUNK],
            nearness: vec![0.0; pixels + CHUNK],
        }
    }

    /// The finished pictures.
    pub(super) fn finish(self) -> Rendering {
        let (width, height) = (self.camera.width, self.camera.height);
        let (mut color, mut data) = (self.color, self.nearness);
        color.truncate(self.width * self.height);
        data.truncate(self.width * self.height);
        for value in &mut data {
            *value = if *value > 0.0 { 1.0 / *value } else { 0.0 };
        }
        let image = RgbImage::from_rgb(width, height, color.into_flattened())
            .expect("a canvas has three bytes for each of its pixels");
        Rendering { image, depth: DepthImage { width, height, data } }
    }

    /// A scan line.
    pub(super) fn row(&self, v: usize) -> ScanLine {
        ScanLine {
            v,
            y: (v as f64 - self.camera.center[1]) / self.camera.focal,
            inverse_focal: 1.0 / self.camera.focal,
            center_u: self.camera.center[0],
        }
    }

    /// The scan lines of a rectangle.
    pub(super) fn rows(&self, bounds: Bounds) -> impl Iterator<Item = ScanLine> + use<> {
        let (first, last) = (self.row(0), bounds.v);
        let step = first.inverse_focal;
        (last[0]..=last[1]).map(move |v| ScanLine { v, y: first.y + v as f64 * step, ..first })
    }

    /// All rows.
    pub(super) fn all_rows(&self) -> Range<usize> {
        0..self.height
    }

    /// The rows in which the convex hull of some points (camera frame) can appear.
    pub(super) fn rows_of(&self, points: &[Point3<f64>]) -> Range<usize> {
        self.hull(points).map_or(0..0, |bounds| bounds.v[0]..bounds.v[1] + 1)
    }

    /// Takes over some rows of another canvas of the same size.
    pub(super) fn copy(&mut self, rows: &Range<usize>, from: &Self) {
        let pixels = rows.start * self.width..rows.end * self.width;
        self.color[pixels.clone()].copy_from_slice(&from.color[pixels.clone()]);
        self.nearness[pixels.clone()].copy_from_slice(&from.nearness[pixels]);
    }

    /// The bytes of some rows' colours.
    pub(super) fn bytes(&mut self, rows: &Range<usize>) -> &mut [u8] {
        self.color[rows.start * self.width..rows.end * self.width].as_flattened_mut()
    }

    /// The whole canvas.
    pub(super) fn bounds(&self) -> Option<Bounds> {
        let (right, bottom) = (self.width.checked_sub(1)?, self.height.checked_sub(1)?);
        Some(Bounds { u: [0, right], v: [0, bottom] })
    }

    /// The rectangle in which a ball (centre in the camera frame) can appear.
    pub(super) fn ball(&self, center: &Vector3<f64>, radius: f64) -> Option<Bounds> {
        if center.z + radius < NEAR {
            return None;
        }
        self.window(extent(center.x, center.z, radius), extent(center.y, center.z, radius))
    }

    /// The rectangle in which the convex hull of some points (camera frame) can appear.
    pub(super) fn hull(&self, points: &[Point3<f64>]) -> Option<Bounds> {
        if points.iter().all(|p| p.z < NEAR) {
            return None;
        }
        if points.iter().any(|p| p.z < NEAR) {
            return self.bounds();
        }
        let span = |ratio: fn(&Point3<f64>) -> f64| {
            points
                .iter()
                .map(ratio)
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], r| [low.min(r), high.max(r)])
        };
        self.window(span(|p| p.x / p.z), span(|p| p.y / p.z))
    }

    /// Where a point (camera frame) appears, px, and its 1/depth; not a number where it is too near.
    pub(super) fn project(&self, point: &Point3<f64>) -> [f64; 3] {
        if point.z < NEAR {
            return [f64::NAN; 3];
        }
        let nearness = 1.0 / point.z;
        let scale = self.camera.focal * nearness;
        [point.x * scale + self.camera.center[0], point.y * scale + self.camera.center[1], nearness]
    }

    /// The pixels whose centres can lie between some pixels; `None` where there are none.
    pub(super) fn between(&self, corners: [[f64; 2]; 3]) -> Option<Bounds> {
        const ROUNDING: f64 = 1e-6;
        let range = |axis: usize, size: usize| {
            let [a, b, c] = corners.map(|corner| corner[axis]);
            let low = up((a.min(b).min(c) - ROUNDING).max(0.0));
            let high = (a.max(b).max(c) + ROUNDING).min(size as f64 - 1.0);
            (high >= f64::from(low as u32)).then_some([low, high as u32 as usize])
        };
        Some(Bounds { u: range(0, self.width)?, v: range(1, self.height)? })
    }

    /// The pixels between two directions on each axis, widened by one pixel against rounding.
    fn window(&self, x: Extent, y: Extent) -> Option<Bounds> {
        let pixels = |extent: Extent, center: f64, size: usize| {
            let low = (extent[0] * self.camera.focal + center - 1.0).max(0.0);
            let high = (extent[1] * self.camera.focal + center + 1.0).min(size as f64 - 1.0);
            (low <= high).then_some([low as usize, high as usize])
        };
        let u = pixels(x, self.camera.center[0], self.width)?;
        let v = pixels(y, self.camera.center[1], self.height)?;
        Some(Bounds { u, v })
    }

    /// Whether 1/depth at a pixel is nearer than what was drawn before.
    #[inline(always)]
    pub(super) fn is_nearer(&self, v: usize, u: usize, near: f32) -> bool {
        near > self.nearness[v * self.width + u] && near < NEARNESS_LIMIT
    }

    /// Draws one pixel.
    #[inline(always)]
    pub(super) fn dot(&mut self, v: usize, u: usize, near: f32, color: Color) {
        self.nearness[v * self.width + u] = near;
        self.color[v * self.width + u] = unpacked(color);
    }

    /// Draws a run of pixels of row `v`, where it is nearer than what was drawn before.
    ///
    /// `sample(k)` returns 1/depth of the pixels `k` after the first (nothing is drawn unless it is positive), and one
    /// more number. `paint(k, nearness, more)` returns the colours, also of pixels that are not visible.
    #[inline(always)]
    pub(super) fn fill(
        &mut self,
        v: usize,
        (first, last): (usize, usize),
        sample: impl Fn(Lanes) -> (Lanes, Lanes),
        paint: impl Fn(Lanes, Lanes, Lanes) -> Colors,
    ) {
        let last = last.min(self.width - 1);
        let end = Lanes::splat(last as f32 - first as f32);
        let mut k = STEPS;
        let mut at = v * self.width + first;
        for _ in 0..(last + CHUNK).saturating_sub(first) / CHUNK {
            let (near, more) = sample(k);
            let Some(depths) = self.nearness[at..].first_chunk_mut::<CHUNK>() else { return };
            let before = Lanes::new(*depths);
            // The last chunk may reach beyond the run.
            let visible = near.simd_gt(before) & near.simd_lt(NEARNESS_LIMIT) & k.simd_le(end);
            let bits = visible.to_bitmask();
            if bits != 0 {
                *depths = visible.select(near, before).to_array();
                self.store(at, bits, &paint(k, near, more));
            }
            k += CHUNK as f32;
            at += CHUNK;
        }
    }

    /// Writes the colours of the visible pixels of a chunk: one bit each.
    #[inline(always)]
    fn store(&mut self, at: usize, visible: u32, colors: &Colors) {
        let Some(into) = self.color[at..].first_chunk_mut::<CHUNK>() else { return };
        if visible.trailing_ones() < CHUNK as u32 {
            for (i, (into, color)) in into.iter_mut().zip(colors).enumerate() {
                if visible & 1 << i != 0 {
                    *into = unpacked(*color);
                }
            }
            return;
        }
        // Four colours are three words.
        let (words, _) = into.as_flattened_mut().as_chunks_mut::<4>();
        for (words, [a, b, c, d]) in words.as_chunks_mut::<3>().0.iter_mut().zip(colors.as_chunks::<4>().0) {
            *words = [a | b << 24, b >> 8 | c << 16, c >> 16 | d << 8].map(u32::to_le_bytes);
        }
    }
}

fn counted([first, last]: [usize; 2], from: f64) -> impl Iterator<Item = (usize, f64)> {
    let start = f64::from(first as u32) - from;
    (first..last + 1).zip(0u32..).map(move |(at, n)| (at, start + f64::from(n)))
}

/// The range of directions in which a circle appears that lies in the plane of one image axis and the optical axis.
fn extent(across: f64, along: f64, radius: f64) -> Extent {
    let squared = along * along - radius * radius;
    if along <= radius || squared <= 0.0 {
        return [f64::NEG_INFINITY, f64::INFINITY];
    }
    let tangent = (squared + across * across).sqrt();
    [(across * along - radius * tangent) / squared, (across * along + radius * tangent) / squared]
}
