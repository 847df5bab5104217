//! Light and colour: Lambert's law with soft, directional light, and the mottling of large faces.
//!
//! Light scales a colour and never changes its hue. Brightness is an index into a table of 256 shades per shape, so
//! that a pixel costs one look-up.

use std::sync::LazyLock;

use nalgebra::{Isometry3, Vector3};
use wide::i32x8;

use super::raster::{Color, Colors, Lanes, each, packed};

/// Brightness of a face that gets no direct light.
const AMBIENT: f32 = 0.45;
/// How far the light reaches around a body: 0 is a point light, larger values are softer.
const SOFTNESS: f32 = 0.25;
/// The shade index of full light; the shades above it are for mottling.
const FULL: f32 = 240.0;

/// The direction towards the light in the camera frame.
#[derive(Clone, Copy)]
pub(super) struct Light {
    /// Unit vector, or zero for light from all directions.
    pub(super) toward: Vector3<f64>,
}

impl Light {
    /// The scene's light as the camera sees it.
    pub(super) fn new(toward_in_scene: &Vector3<f64>, camera_from_scene: &Isometry3<f64>) -> Self {
        let toward = camera_from_scene.rotation * toward_in_scene;
        Self { toward: toward.try_normalize(1e-9).unwrap_or_else(Vector3::zeros) }
    }

    /// Brightness of a face with unit normal `n` in the camera frame.
    pub(super) fn on(&self, n: &Vector3<f64>) -> f32 {
        brightness(Lanes::splat(n.dot(&self.toward) as f32)).to_array()[0]
    }
}

/// Brightnesses by the cosines between normals and light.
#[inline(always)]
pub(super) fn brightness(cosine: Lanes) -> Lanes {
    let lit = ((cosine + SOFTNESS) * (1.0 / (1.0 + SOFTNESS))).fast_max(Lanes::ZERO);
    lit * (1.0 - AMBIENT) + AMBIENT
}

/// One colour at all brightness levels.
pub(super) struct Shades([Color; 256]);

impl Shades {
    /// The shades of a colour.
    pub(super) fn new(color: [u8; 3]) -> Self {
        let shade = |index: usize| {
            let scale = index as f32 / FULL;
            packed(color.map(|channel| (f32::from(channel) * scale + 0.5) as u8))
        };
        Self(std::array::from_fn(shade))
    }

    /// The colour at a brightness: 1 is full light.
    #[inline(always)]
    pub(super) fn at(&self, brightness: f32) -> Color {
        self.0[usize::from((brightness * FULL + 0.5) as u8)]
    }

    /// The colours at some brightnesses.
    #[inline(always)]
    pub(super) fn lanes(&self, brightness: Lanes) -> Colors {
        let index = (brightness * FULL).fast_max(Lanes::ZERO).fast_min(Lanes::splat(255.0)).fast_round_int();
        let index = index.to_array();
        each(|i| self.0[(index[i] & 255) as usize])
    }
}

/// A mixture of two colours; an `amount` of 255 gives `b`.
#[inline(always)]
pub(super) fn mix(a: Color, b: Color, amount: u32) -> Color {
    // Two channels at once, each in 16 bits; the sum's quotient by 255, rounded down, is exact up to 65 534.
    let (t, s) = (amount, 255 - amount);
    let two = |a: Color, b: Color| {
        let sum = (a & 0x00ff_00ff) * s + (b & 0x00ff_00ff) * t + 127 * 0x0001_0001;
        ((sum + 0x0001_0001 + ((sum >> 8) & 0x00ff_00ff)) >> 8) & 0x00ff_00ff
    };
    two(a, b) | two(a >> 8, b >> 8) << 8
}

/// A square of smooth random values that tiles the plane.
pub(super) struct Mottling {
    /// Row by row.
    values: Box<[i8; TEXELS * TEXELS]>,
}

/// Texels along each side of [`Mottling`]; a power of two.
const TEXELS: usize = 256;

/// The mottling that all faces share, made from fixed numbers.
pub(super) static MOTTLING: LazyLock<Mottling> = LazyLock::new(Mottling::new);

impl Mottling {
    /// Value noise of three octaves.
    fn new() -> Self {
        let value = |x: usize, y: usize| {
            let octaves = [(32, 0.5), (16, 0.3), (8, 0.2)];
            let sum: f32 = octaves.iter().map(|&(cell, weight)| weight * lattice_noise(x, y, cell)).sum();
            (sum * 127.0) as i8
        };
        Self { values: Box::new(std::array::from_fn(|at| value(at % TEXELS, at / TEXELS))) }
    }

    /// The values at some points, in texels from 0 on: between about -1 and 1, mostly within 0.5.
    #[inline(always)]
    pub(super) fn lanes(&self, x: Lanes, y: Lanes) -> Lanes {
        let cell = |v: Lanes| v.fast_round_int() & i32x8::splat(TEXELS as i32 - 1);
        let at = (cell(y) * i32x8::splat(TEXELS as i32) + cell(x)).to_array();
        let values = each(|i| i32::from(self.values[at[i] as usize % (TEXELS * TEXELS)]));
        i32x8::new(values).round_float() * (1.0 / 127.0)
    }
}

/// Random values at the corners of cells, smoothly interpolated; -1 to 1.
fn lattice_noise(x: usize, y: usize, cell: usize) -> f32 {
    let cells = TEXELS / cell;
    let corner = |i: usize, j: usize| scatter((i % cells) + (j % cells) * cells + cells * cells * 7);
    let smooth = |part: usize| {
        let t = part as f32 / cell as f32;
        t * t * (3.0 - 2.0 * t)
    };
    let (i, j, s, t) = (x / cell, y / cell, smooth(x % cell), smooth(y % cell));
    let lower = corner(i, j) * (1.0 - s) + corner(i + 1, j) * s;
    let upper = corner(i, j + 1) * (1.0 - s) + corner(i + 1, j + 1) * s;
    lower * (1.0 - t) + upper * t
}

/// A fixed pseudo-random map from whole numbers to -1..1 (the finalizer of SplitMix64).
fn scatter(index: usize) -> f32 {
    let mut z = (index as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}
