//! Segments the hand in one image, adapted to the scene.
//!
//! Regions that may be a hand are proposed at a low resolution and scored. The best ones are segmented again by the
//! colours of the region and of its surroundings, first coarsely and then finely; the best of them is the hand. No
//! camera model, depth or earlier image is needed. Hands with exactly the background's colour, or that fill less than
//! a hundredth of the image, are not found.
//!
//! # Source
//! The second segmentation follows Rother, Kolmogorov, Blake 2004 (GrabCut). Differs in: mean-field iterations in
//! place of a graph cut.

use super::hypotheses::{hypotheses, parts};
use super::lab::{LabImage, apart};
use super::likeness::{likeness, unlike_skin};
use super::mixture::Mixture;
use super::photograph::measured;
use super::refusal::is_other_object;
use crate::components::largest;
use crate::distance::inside;
use crate::frame::RgbImage;
use crate::mask::{Mask, Region};

/// The image's longer side for the proposals, and for the final segmentation, px.
const COARSE: u32 = 160;
const FINE: u32 = 480;
/// Number of proposals that are segmented again.
const BEST: usize = 6;
/// Overlap from which two regions are the same.
const SAME: f64 = 0.8;
/// Least score of a hand.
const MIN_SCORE: f64 = 2.0;
/// Bonus of stretched fingers for the score.
const FINGERS: f64 = 1.0;
/// Radius below which something is too thin to be a finger, share of the palm's.
const THREAD: f32 = 0.10;
/// Components of the colour mixtures of the hand and of the rest.
const PARTS: (usize, usize) = (3, 5);
/// A component of the hand's colours may be this much less like skin than the best one, squared deviations.
const LESS_LIKE_SKIN: f64 = 5.0;
/// Coupling of a pixel to its neighbours.
const COUPLING: f32 = 0.9;
/// Limits of the log-odds given by colour, and by the earlier segmentation.
const MAX_ODDS: f32 = 6.0;
const PRIOR_ODDS: f32 = 2.0;

/// A hand segmented from an image.
#[derive(Clone, Debug)]
pub struct SkinSegmentation {
    /// The hand, at the image's own resolution or lower.
    pub mask: Mask,
    /// Pixels of the image per pixel of the mask.
    pub scale: f64,
    /// Confidence, 0 to 1.
    pub confidence: f64,
}

impl SkinSegmentation {
    /// Segments the hand in an image, `None` where nothing looks like one.
    pub fn of(image: &RgbImage) -> Option<Self> {
        let coarse = LabImage::of(image, COARSE)?;
        if coarse.width.min(coarse.height) < 16 {
            return None;
        }
        let (best, score) = ranked(&coarse, hypotheses(&coarse))
            .into_iter()
            .filter_map(|(thing, _)| {
                let cut = (0..3).try_fold(thing, |thing, _| cut_out(&coarse, &thing))?;
                let score = likeness(&coarse, &cut)? + finger_bonus(&cut);
                Some((cut, score))
            })
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        if score < MIN_SCORE {
            return None;
        }
        let fine = LabImage::of(image, FINE)?;
        let enlarged = enlarge(&best, &fine);
        let mask = without_threads(cut_out(&fine, &enlarged).unwrap_or(enlarged));
        if is_other_object(&fine, &mask) {
            return None;
        }
        let confidence = 1.0 / (1.0 + libm::exp(-(score - MIN_SCORE) / 2.0));
        Some(Self { mask, scale: fine.scale, confidence })
    }
}

/// Opens the mask by a disc much thinner than a finger and keeps the largest component.
fn without_threads(mask: Mask) -> Mask {
    let distances = inside(&mask);
    let least = THREAD * distances.iter().copied().fold(0.0, f32::max);
    let core = Mask::of(mask.region(), distances.iter().map(|d| *d <= least));
    // Outside of the core, pixels farther from it than the disc's radius are threads.
    let from_core = inside(&core);
    let kept = mask.data().iter().zip(&from_core).map(|(m, d)| *m != 0 && *d < least + 0.5);
    let opened = Mask::of(mask.region(), kept);
    largest(&opened).map_or(mask, |hand| hand.alone(opened.region()))
}

/// The bonus of fingers for a region's score.
fn finger_bonus(thing: &Mask) -> f64 {
    let stretched =
        measured(thing).map_or(0, |(shape, ..)| shape.fingers.iter().filter(|f| f.score > 0.5).count());
    if (1..=5).contains(&stretched) { FINGERS } else { 0.0 }
}

/// The best regions, best first, without near duplicates.
fn ranked(lab: &LabImage, things: Vec<Mask>) -> Vec<(Mask, f64)> {
    let mut scored: Vec<(Mask, f64)> =
        things.into_iter().filter_map(|t| likeness(lab, &t).map(|score| (t, score))).collect();
    scored.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut chosen: Vec<(Mask, f64)> = Vec::new();
    for candidate in scored {
        if chosen.len() == BEST {
            break;
        }
        if chosen.iter().all(|(c, _)| overlap(c, &candidate.0) < SAME) {
            chosen.push(candidate);
        }
    }
    chosen
}

/// The intersection of two masks over their union.
fn overlap(a: &Mask, b: &Mask) -> f64 {
    let pairs = a.data().iter().zip(b.data());
    let (both, either) = pairs.fold((0, 0), |(n, m), (a, b)| (n + (a & b) as usize, m + (a | b) as usize));
    both as f64 / (either as f64).max(1.0)
}

/// Segments the region again, by its colours and those of the rest, its position, and similarly coloured neighbours.
fn cut_out(lab: &LabImage, thing: &Mask) -> Option<Mask> {
    let colors = |set: u8| -> Vec<[f32; 3]> {
        lab.data.iter().zip(thing.data()).filter(|(_, m)| **m == set).map(|(c, _)| *c).collect()
    };
    let (hand, rest) = (Mixture::fit(&colors(1), PARTS.0)?, Mixture::fit(&colors(0), PARTS.1)?);
    // A sleeve or a shadow inside the region is recognised by its colour.
    let most = hand.means().map(|m| unlike_skin(&m)).fold(f64::INFINITY, f64::min) + LESS_LIKE_SKIN;
    let (hand, other) = hand.divided(|color| unlike_skin(color) <= most);
    let hand = hand?;
    let off_hand = |c: &[f32; 3]| {
        let along = other.as_ref().map_or(f32::NEG_INFINITY, |o| o.log_density(c));
        rest.log_density(c).max(along)
    };
    let near = smoothed(thing, lab.data.len());
    let odds: Vec<f32> = lab
        .data
        .iter()
        .zip(&near)
        .map(|(c, near)| {
            let by_color = (hand.log_density(c) - off_hand(c)).clamp(-MAX_ODDS, MAX_ODDS);
            by_color + PRIOR_ODDS * (2.0 * near - 1.0)
        })
        .collect();
    let shares = mean_field(lab, &odds);
    let cut: Vec<bool> = shares.iter().map(|s| *s > 0.0).collect();
    parts(lab, &cut, 1).into_iter().next()
}

/// The mask as values 0 to 1, blurred over 1/30 of the image.
fn smoothed(thing: &Mask, pixels: usize) -> Vec<f32> {
    let (w, h) = (thing.width(), thing.height());
    let radius = ((pixels as f64).sqrt() / 30.0).ceil() as usize;
    let rows: Vec<f32> = box_blur(&thing.data().iter().map(|v| f32::from(*v)).collect::<Vec<_>>(), w, radius);
    let turned = transposed(&rows, w, h);
    transposed(&box_blur(&turned, h, radius), h, w)
}

fn transposed(values: &[f32], w: usize, h: usize) -> Vec<f32> {
    (0..w).flat_map(|x| (0..h).map(move |y| values[y * w + x])).collect()
}

/// The mean of each value and its `radius` neighbours on either side in its row of `w`.
fn box_blur(values: &[f32], w: usize, radius: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(values.len());
    for row in values.chunks_exact(w) {
        let mut sums = vec![0.0f32; w + 1];
        (0..w).for_each(|x| sums[x + 1] = sums[x] + row[x]);
        for x in 0..w {
            let (from, to) = (x.saturating_sub(radius), (x + radius + 1).min(w));
            out.push((sums[to] - sums[from]) / (to - from) as f32);
        }
    }
    out
}

/// Twice the probability that each pixel is hand, minus 1; neighbours of similar colour support each other.
fn mean_field(lab: &LabImage, odds: &[f32]) -> Vec<f32> {
    let (w, h) = (lab.width, lab.height);
    let step = |i: usize, j: usize| apart(&lab.data[i], &lab.data[j]);
    let across = |i: usize| (i % w + 1 < w).then_some(i + 1);
    let down = |i: usize| (i + w < w * h).then_some(i + w);
    let all = || (0..w * h).flat_map(|i| [across(i), down(i)].into_iter().flatten().map(move |j| (i, j)));
    let mean = all().map(|(i, j)| step(i, j)).sum::<f32>() / (2 * w * h) as f32;
    let weight = |(i, j): (usize, usize)| COUPLING * libm::expf(-step(i, j) / (2.0 * mean).max(0.5));
    let links: Vec<(usize, usize, f32)> = all().map(|pair| (pair.0, pair.1, weight(pair))).collect();
    let mut shares: Vec<f32> = odds.iter().map(|o| libm::tanhf(o / 2.0)).collect();
    for _ in 0..6 {
        let mut fields = odds.to_vec();
        for &(i, j, weight) in &links {
            fields[i] += 2.0 * weight * shares[j];
            fields[j] += 2.0 * weight * shares[i];
        }
        shares.iter_mut().zip(&fields).for_each(|(s, f)| *s = libm::tanhf(f / 2.0));
    }
    shares
}

/// Scales a mask to the size of a larger version of its image.
fn enlarge(mask: &Mask, lab: &LabImage) -> Mask {
    let large = Region::whole(lab.width as u32, lab.height as u32);
    let small = |(x, y): (u32, u32)| {
        mask.row(y as usize * mask.height() / lab.height)[x as usize * mask.width() / lab.width] != 0
    };
    Mask::of(large, large.pixels().map(small))
}
