//! Proposes many segmentations of an image into hand and background; none is trusted by itself.
//!
//! A fixed range of skin colours fails in front of wood and of warm walls, and so does any single threshold. Therefore
//! each of several colour axes is split at its own best thresholds, and the scene's colour clusters are combined in
//! ones, twos and threes. [`super::likeness`] scores how much each resulting region looks like a hand.

use std::collections::BTreeSet;

use super::lab::LabImage;
use super::mixture::Mixture;
use crate::components::{Component, components, fill_holes};
use crate::mask::{Mask, Region};

/// Levels of a histogram.
const LEVELS: usize = 64;
/// Number of colour clusters, coarse and fine.
const CLUSTERS: [usize; 2] = [4, 6];
/// Least share of the image that a hand fills.
pub(super) const MIN_SHARE: f64 = 0.012;
/// Largest hole in a hand that is filled, share of the image.
const HOLE_SHARE: f64 = 0.01;

/// The regions that may be a hand, each alone in a mask of the whole image, without duplicates.
pub(super) fn hypotheses(lab: &LabImage) -> Vec<Mask> {
    let mut cuts: Vec<Vec<bool>> = Vec::new();
    for axis in AXES {
        let values: Vec<f32> = lab.data.iter().map(axis).collect();
        by_thresholds(&values, &mut cuts);
    }
    for k in CLUSTERS {
        by_clusters(lab, k, &mut cuts);
    }
    let mut seen = BTreeSet::new();
    let mut things = Vec::new();
    for cut in &cuts {
        for thing in parts(lab, cut, 2) {
            if seen.insert(thing.data().to_vec()) {
                things.push(thing);
            }
        }
    }
    things
}

/// The colour axes: lightness, redness, yellowness; the last two independent of shading; hue.
const AXES: [fn(&[f32; 3]) -> f32; 6] = [
    |c| c[0],
    |c| c[1],
    |c| c[2],
    |c| c[1] / (c[0] + 16.0),
    |c| c[2] / (c[0] + 16.0),
    |c| libm::atan2f(c[2], c[1]),
];

/// The largest `most` components of a segmentation, smoothed and without small holes.
pub(super) fn parts(lab: &LabImage, cut: &[bool], most: usize) -> Vec<Mask> {
    let region = Region::whole(lab.width as u32, lab.height as u32);
    let mask = Mask::of(region, cut.iter().copied()).majority().majority();
    let pixels = lab.data.len() as f64;
    let found = components(&mask, (MIN_SHARE * pixels) as u32);
    let alone = |c: &Component| {
        let mut thing = c.alone(region);
        fill_holes(&mut thing, (HOLE_SHARE * pixels) as u32);
        thing
    };
    found.iter().take(most).map(alone).collect()
}

/// Splits values at the two thresholds that separate three classes best, and proposes each class and each outer
/// pair.
fn by_thresholds(values: &[f32], cuts: &mut Vec<Vec<bool>>) {
    let (low, high) = range(values);
    if high - low < 1e-3 {
        return;
    }
    let level = |v: f32| (((v - low) / (high - low) * LEVELS as f32) as usize).min(LEVELS - 1);
    let mut histogram = [0.0f64; LEVELS];
    values.iter().for_each(|v| histogram[level(*v)] += 1.0);
    let one = otsu(&histogram);
    let (lower, upper) = otsu_of_three(&histogram);
    let mut propose =
        |keep: &dyn Fn(usize) -> bool| cuts.push(values.iter().map(|v| keep(level(*v))).collect());
    for threshold in [one, lower, upper] {
        propose(&|l| l >= threshold);
        propose(&|l| l < threshold);
    }
    propose(&|l| (lower..upper).contains(&l));
}

/// The range of values without the outermost 0.5 % at each end.
fn range(values: &[f32]) -> (f32, f32) {
    let mut sorted: Vec<f32> = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    let cut = sorted.len() / 200;
    match (sorted.get(cut), sorted.get(sorted.len().saturating_sub(cut + 1))) {
        (Some(low), Some(high)) => (*low, *high),
        _ => (0.0, 0.0),
    }
}

/// The cumulative weight and first moment below each level.
fn cumulated(histogram: &[f64; LEVELS]) -> ([f64; LEVELS + 1], [f64; LEVELS + 1]) {
    let (mut weight, mut moment) = ([0.0; LEVELS + 1], [0.0; LEVELS + 1]);
    for (i, h) in histogram.iter().enumerate() {
        weight[i + 1] = weight[i] + h;
        moment[i + 1] = moment[i] + h * i as f64;
    }
    (weight, moment)
}

/// The first level of the upper class (Otsu 1979), which maximises the variance between the classes.
fn otsu(histogram: &[f64; LEVELS]) -> usize {
    let sums = cumulated(histogram);
    let between = |t: &usize| spread(&sums, 0, *t) + spread(&sums, *t, LEVELS);
    (1..LEVELS).max_by(|a, b| between(a).total_cmp(&between(b))).unwrap_or(1)
}

/// The first levels of the middle and of the upper class, likewise.
fn otsu_of_three(histogram: &[f64; LEVELS]) -> (usize, usize) {
    let sums = cumulated(histogram);
    let mut best = (1, 2, f64::NEG_INFINITY);
    for s in 1..LEVELS - 1 {
        for t in s + 1..LEVELS {
            let between = spread(&sums, 0, s) + spread(&sums, s, t) + spread(&sums, t, LEVELS);
            if between > best.2 {
                best = (s, t, between);
            }
        }
    }
    (best.0, best.1)
}

/// The contribution of a class of levels to the variance between classes, up to a constant.
fn spread((weight, moment): &([f64; LEVELS + 1], [f64; LEVELS + 1]), from: usize, to: usize) -> f64 {
    let (w, m) = (weight[to] - weight[from], moment[to] - moment[from]);
    if w > 0.0 { m * m / w } else { 0.0 }
}

/// Proposes the scene's colour clusters in ones, twos and threes.
fn by_clusters(lab: &LabImage, k: usize, cuts: &mut Vec<Vec<bool>>) {
    let Some(mixture) = Mixture::fit(&lab.data, k) else { return };
    let of: Vec<usize> = lab.data.iter().map(|c| mixture.part_of(c)).collect();
    for chosen in 1u32..1 << k {
        if chosen.count_ones() <= 3 {
            cuts.push(of.iter().map(|&o| chosen >> o & 1 == 1).collect());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn otsu_cuts_between_the_hills() {
        let mut histogram = [0.0; LEVELS];
        for (middle, height) in [(10i32, 100.0), (30, 60.0), (52, 80.0)] {
            (-3..=3).for_each(|d: i32| histogram[(middle + d) as usize] += height / (1.0 + f64::from(d * d)));
        }
        let (lower, upper) = otsu_of_three(&histogram);
        assert!((14..28).contains(&lower) && (34..50).contains(&upper), "{lower} {upper}");
        assert!((14..50).contains(&otsu(&histogram)));
    }

    #[test]
    fn a_disc_before_a_wall_is_among_the_things_and_its_hole_is_filled() {
        let (width, height) = (60, 80);
        let inside = |x: i32, y: i32, r: i32| (x - 30).pow(2) + (y - 40).pow(2) < r * r;
        let color = |i: i32| {
            let (x, y) = (i % width, i / width);
            if inside(x, y, 15) && !inside(x, y, 3) { [65.0, 18.0, 20.0] } else { [70.0, 8.0, 28.0] }
        };
        let data: Vec<[f32; 3]> = (0..width * height).map(color).collect();
        let lab = LabImage { width: 60, height: 80, data, scale: 1.0 };
        let found = hypotheses(&lab);
        let disc = (0..width * height).map(|i| u8::from(inside(i % width, i / width, 15)));
        let disc: Vec<u8> = disc.collect();
        let differ = |m: &Mask| m.data().iter().zip(&disc).filter(|(a, b)| a != b).count();
        assert!(found.iter().map(differ).min().unwrap() < 12);
        assert!(hypotheses(&LabImage { data: vec![[50.0, 0.0, 0.0]; 4800], ..lab }).len() <= 2);
    }
}
