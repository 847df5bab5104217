//! Scores how much a region looks like a hand while its distance is unknown: its outline lies on edges, it does
//! not surround the image as a wall does, it has a palm, and its colour can be skin.

use nalgebra::Vector2;

use super::lab::{LabImage, apart};
use crate::distance::inside;
use crate::mask::Mask;

/// Distance from the outline at which colours inside and outside are compared, px.
const REACH: f32 = 2.6;
/// Difference of colours that is certainly an edge, CIELAB.
const CLEAR: f32 = 14.0;
/// Share of the image that a hand fills: mean and standard deviation of its logarithm.
const SHARE: (f64, f64) = (0.17, 0.75);
/// Skin of all tones in white and in warm light: mean and standard deviation of redness and yellowness over
/// lightness, and of hue, rad.
const REDNESS: (f64, f64) = (0.20, 0.06);
const YELLOWNESS: (f64, f64) = (0.24, 0.09);
const HUE: (f64, f64) = (0.87, 0.28);

/// The log-likelihood that a region is a hand, up to a constant; `None` for an empty one.
pub(super) fn likeness(lab: &LabImage, thing: &Mask) -> Option<f64> {
    let area = thing.count() as f64;
    if area < 1.0 {
        return None;
    }
    let (border, corners) = border(thing);
    let radius = f64::from(inside(thing).into_iter().fold(0.0f32, f32::max));
    let mut color = [0.0f32; 3];
    for (c, _) in lab.data.iter().zip(thing.data()).filter(|(_, m)| **m != 0) {
        (0..3).for_each(|i| color[i] += c[i] / area as f32);
    }
    let off = |v: f64, (middle, deviation): (f64, f64)| ((v - middle) / deviation).powi(2);
    let size = off(libm::log(area / lab.data.len() as f64), (libm::log(SHARE.0), SHARE.1));
    // A hand is a palm with fingers and perhaps an arm. Ragged or long regions are not hands.
    let palm = std::f64::consts::PI * radius * radius / area;
    let palm = off(palm.clamp(0.0, 1.0), (0.50, 0.17));
    Some(
        10.0 * edge(lab, thing)
            - 0.5 * size
            - 0.5 * unlike_skin(&color)
            - 0.5 * palm
            - 9.0 * (border - 0.10).max(0.0)
            - 1.5 * corners.saturating_sub(1).min(1) as f64
            - 4.0 * corners.saturating_sub(2) as f64,
    )
}

/// The distance of a colour from skin colours, squared deviations.
pub(super) fn unlike_skin(color: &[f32; 3]) -> f64 {
    let off = |v: f64, (middle, deviation): (f64, f64)| ((v - middle) / deviation).powi(2);
    // Deep shade and warm light make skin more saturated, but nothing makes it grey.
    let light = f64::from(color[0]) + 16.0;
    // Overexposure bleaches it.
    let bleached = ((124.0 - light) / 40.0).clamp(0.15, 1.0);
    let either =
        |v: f64, (m, d): (f64, f64)| off(v, (m * bleached, if v > m * bleached { 2.5 * d } else { d }));
    let (red, yellow) = (f64::from(color[1]), f64::from(color[2]));
    let apart = either(red / light, REDNESS) + either(yellow / light, YELLOWNESS);
    apart.min(12.0) + off(libm::atan2(yellow, red), HUE).min(9.0)
}

/// The share of the image's border that a region covers, and the number of corners.
fn border(thing: &Mask) -> (f64, usize) {
    let (w, h) = (thing.width(), thing.height());
    let row = |y: usize| thing.row(y).iter().map(|&v| usize::from(v)).sum::<usize>();
    let column = |x: usize| (0..h).map(|y| usize::from(thing.row(y)[x])).sum::<usize>();
    let covered = row(0) + row(h - 1) + column(0) + column(w - 1);
    let corners = [(0, 0), (w - 1, 0), (0, h - 1), (w - 1, h - 1)];
    let count = corners.iter().filter(|(x, y)| thing.row(*y)[*x] != 0).count();
    (covered as f64 / (2 * (w + h)) as f64, count)
}

/// How well the outline lies on edges: the mean contrast between its two sides, lowered by its parts of low
/// contrast.
fn edge(lab: &LabImage, thing: &Mask) -> f64 {
    let inner = |&(x, y): &(i64, i64)| {
        x > 0 && y > 0 && x + 1 < thing.width() as i64 && y + 1 < thing.height() as i64
    };
    let (mut sum, mut unclear, mut n) = (0.0, 0.0, 0.0f64);
    for (x, y) in thing.pixels().filter(inner).filter(|at| thing.is_at_edge(*at)) {
        let Some(normal) = outward(thing, x, y) else { continue };
        let at = |t: f32| {
            lab.at((x as f32 + normal.x * t).round() as i64, (y as f32 + normal.y * t).round() as i64)
        };
        let difference = apart(&at(-REACH + 0.6), &at(REACH)).sqrt();
        let clear = f64::from((difference / CLEAR).min(1.0));
        n += 1.0;
        sum += clear;
        unclear += f64::from(u8::from(clear < 0.35));
    }
    if n > 0.0 { (sum / n - 0.7 * unclear / n).max(0.0) } else { 0.0 }
}

/// The outward direction at a pixel of a region's outline.
fn outward(thing: &Mask, x: i64, y: i64) -> Option<Vector2<f32>> {
    let mut sum = Vector2::zeros();
    for (dx, dy) in (-3i64..=3).flat_map(|dy| (-3i64..=3).map(move |dx| (dx, dy))) {
        if thing.contains(x + dx, y + dy) {
            sum -= Vector2::new(dx as f32, dy as f32);
        }
    }
    sum.try_normalize(1e-3)
}
