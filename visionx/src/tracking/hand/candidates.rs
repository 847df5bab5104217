//! Selects the hand among the skin-coloured regions of a frame.
//!
//! With a depth image only regions that stand out of the background are considered, so that a skin-coloured table
//! does not matter; where it has holes, as along thin fingers, colour decides. Without one, regions seen by both cameras are compared, and a colour that covers more area than a
//! hand can is background. It keeps no state between frames; the caller may pass a preferred colour.

use super::relief::{MIN_RELIEF, standing_out, surroundings};
use super::shape::{HandShape, hand_shape};
use super::skin::{HalfImage, SkinClusters};
use crate::camera::{PinholeCamera, StereoCalibration};
use crate::components::{Component, components, largest};
use crate::frame::{DepthImage, StereoFrame};
use crate::mask::{Mask, Region, beside};

/// Search range of a hand's distance, m.
const DEPTHS: (f64, f64) = (0.2, 1.7);
/// Area of a hand with a part of the arm, m^2.
const AREAS: (f64, f64) = (18e-4, 400e-4);
/// Area above which a skin-coloured region is background, m^2.
const SCENERY: f64 = 600e-4;
/// Radius of the palm's largest disc, from a hand seen edge-on to a large hand, m.
const PALM_RADII: (f64, f64) = (0.0145, 0.062);
/// Fewest pixels at half resolution.
const MIN_PIXELS: u32 = 30;
/// Depth below which the nearest region is first searched alone, and the depth extent of a hand, m.
const NEAR: f32 = 0.95;
const HAND_LENGTH: f32 = 0.22;
/// Number of candidates examined at full resolution.
const LOOKED_AT: usize = 4;
/// A colour is the hand's own if pixels around that do not stand out have it, too, in less than this share of the hand's.
const OWN_COLOR: f64 = 0.1;
/// Mean and spread of the log-chromaticities of light and dark skin in white light.
const USUAL_SKIN: ([f32; 2], f64) = ([0.30, 0.25], 0.12);
/// Spread of the skin colour of one hand from frame to frame.
const SAME_SKIN: f64 = 0.06;

/// A region with the colour, the size and the shape of a hand.
pub(crate) struct HandCandidate {
    /// Its pixels in the left image.
    pub(crate) left: Mask,
    /// Its pixels in the right image, when it was found with both cameras.
    pub(crate) right: Option<Mask>,
    /// Depth, m.
    pub(crate) z: f64,
    /// Its shape in the left image.
    pub(crate) shape: HandShape,
    /// Its colour: ln(R/G), ln(G/B).
    pub(crate) skin: [f32; 2],
    /// Share of its outline in the left image where something nearer begins; 0 without a depth image.
    pub(crate) hidden: f64,
}

/// A skin-coloured region, at half resolution.
struct Candidate {
    label: u8,
    left: Component,
    /// The same region in the right image, when stereo was used.
    right: Option<Component>,
    /// Depth, m.
    z: f64,
    score: f64,
}

/// The search in one frame.
struct Search<'a> {
    frame: &'a StereoFrame,
    /// The frame's depth image without narrow holes.
    depth: Option<&'a DepthImage>,
    calibration: &'a StereoCalibration,
    clusters: SkinClusters,
    /// The pixels that stand out by depth.
    out: Option<Mask>,
    /// The preferred colour, and its spread.
    preferred: ([f32; 2], f64),
}

/// Finds the region most similar to a hand. `skin`: the log-chromaticities of the hand in the last frames. `near`: a hand may be so near
/// that it hides much of the background, so that the nearest region is searched alone at first.
pub(crate) fn find(
    frame: &StereoFrame,
    depth: Option<&DepthImage>,
    calibration: &StereoCalibration,
    skin: Option<[f32; 2]>,
    near: bool,
) -> Option<HandCandidate> {
    let among = |out: Option<Mask>| find_among(frame, depth, calibration, skin, out);
    let nearest = depth.filter(|_| near).and_then(|d| nearest(d, &calibration.camera));
    let found = nearest.and_then(|out| among(Some(out)));
    found.or_else(|| among(depth.and_then(|d| standing_out(d, &calibration.camera))))
}

/// The pixels at most a hand's length behind the nearest one; `None` when that is not near or they fill most of
/// the image.
fn nearest(depth: &DepthImage, camera: &PinholeCamera) -> Option<Mask> {
    let depth = camera.usable(depth)?;
    let mut sampled: Vec<f32> = depth.data.iter().copied().step_by(37).filter(|z| *z > 0.0).collect();
    let place = sampled.len() / 100;
    if sampled.len() < 100 {
        return None;
    }
    let front = *sampled.select_nth_unstable_by(place, f32::total_cmp).1;
    if front > NEAR {
        return None;
    }
    let near = depth.data.iter().map(|z| *z > 0.0 && *z < front + HAND_LENGTH);
    let mask = Mask::of(Region::whole(depth.width, depth.height), near);
    (mask.count() < depth.data.len() * 7 / 10).then_some(mask)
}

/// Finds the hand among the pixels `out` that stand out by depth; without a depth image, by stereo.
fn find_among(
    frame: &StereoFrame,
    depth: Option<&DepthImage>,
    calibration: &StereoCalibration,
    skin: Option<[f32; 2]>,
    out: Option<Mask>,
) -> Option<HandCandidate> {
    let left = HalfImage::of(&frame.left);
    let clusters = SkinClusters::find(&left, out.as_ref());
    let preferred = skin.map_or(USUAL_SKIN, |s| (s, SAME_SKIN));
    let search = Search { frame, depth, calibration, clusters, out, preferred };
    let mut candidates: Vec<Candidate> = match (depth, &search.out) {
        (Some(depth), Some(out)) => {
            search.clusters.labels().flat_map(|l| search.by_depth(&left, depth, out, l)).collect()
        }
        (Some(_), None) => return None,
        (None, _) => {
            let halves = [left, HalfImage::of(&frame.right)];
            search.clusters.labels().flat_map(|l| search.by_both_eyes(&halves, l)).collect()
        }
    };
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    candidates.into_iter().take(LOOKED_AT).find_map(|c| search.look_closely(&c))
}

impl Search<'_> {
    /// Examines the candidate at full resolution; `None` if its shape is not a hand's.
    fn look_closely(&self, candidate: &Candidate) -> Option<HandCandidate> {
        let size = (self.frame.left.width(), self.frame.left.height());
        let region = |part: &Component| full(&part.bounds, size);
        let of_color = |image, part| self.clusters.mask(image, region(part), candidate.label, None);
        let left = own_pixels(&match &self.out {
            Some(out) => self.standing_out(out, region(&candidate.left), candidate.label),
            None => of_color(&self.frame.left, &candidate.left),
        });
        let shape = hand_shape(&left, candidate.z / self.calibration.camera.focal)?;
        let fits = (PALM_RADII.0..PALM_RADII.1).contains(&shape.palm_radius)
            && (AREAS.0..AREAS.1).contains(&shape.area);
        let about = self.depth.map(|d| surroundings(&left, d));
        let stands_out = about.is_none_or(|a| a.deeper >= MIN_RELIEF);
        let hidden = about.map_or(0.0, |a| a.nearer);
        let right = candidate.right.as_ref().map(|part| own_pixels(&of_color(&self.frame.right, part)));
        let skin = self.clusters.peak(candidate.label);
        (fits && stands_out).then_some(HandCandidate { left, right, z: candidate.z, shape, skin, hidden })
    }

    /// The pixels of a colour that stand out, and those that follow them where depth was not measured, if elsewhere in the
    /// region nothing has that colour.
    fn standing_out(&self, out: &Mask, region: Region, label: u8) -> Mask {
        let image = &self.frame.left;
        let mut hand = self.clusters.mask(image, region, label, Some(out));
        let Some(depth) = self.frame.depth.as_ref().filter(|depth| depth.data.contains(&0.0)) else {
            return hand;
        };
        let colored = self.clusters.mask(image, region, label, None);
        let colors = colored.data().iter().zip(hand.region().pixels());
        let follows: Vec<bool> = colors.map(|(bit, (x, y))| *bit != 0 && depth.at(x, y) == 0.0).collect();
        let both = colored.data().iter().zip(hand.data()).zip(&follows);
        let elsewhere = both.filter(|((color, hand), hole)| **color != 0 && **hand == 0 && !**hole).count();
        if elsewhere as f64 > OWN_COLOR * hand.count() as f64 {
            return hand;
        }
        let size = [hand.width(), hand.height()];
        let bits = hand.data_mut();
        let mut open: Vec<usize> = (0..bits.len()).filter(|i| bits[*i] != 0).collect();
        while let Some(i) = open.pop() {
            for next in beside(i, size).filter(|next| follows[*next]) {
                if std::mem::replace(&mut bits[next], 1) == 0 {
                    open.push(next);
                }
            }
        }
        hand
    }

    /// The area of a region at a depth, m^2.
    fn area(&self, thing: &Component, z: f64) -> f64 {
        4.0 * f64::from(thing.area) * (z / self.calibration.camera.focal).powi(2)
    }

    /// The regions of one colour that stand out and have a hand's size.
    fn by_depth(&self, left: &HalfImage, depth: &DepthImage, out: &Mask, label: u8) -> Vec<Candidate> {
        let things = components(&self.clusters.half_mask(left, label, Some(out)), MIN_PIXELS);
        let candidate = |thing: &Component| {
            let z = median_depth(thing, depth)?;
            let area = self.area(thing, z);
            let fits = (DEPTHS.0..DEPTHS.1).contains(&z) && (AREAS.0..AREAS.1).contains(&area);
            let score = self.likeness(label, area);
            fits.then(|| Candidate { label, left: thing.clone(), right: None, z, score })
        };
        things.iter().take(6).filter_map(candidate).collect()
    }

    /// The regions of one colour that both cameras see with a hand's size; none if the colour is background.
    fn by_both_eyes(&self, halves: &[HalfImage; 2], label: u8) -> Vec<Candidate> {
        let [left, right] =
            halves.each_ref().map(|half| components(&self.clusters.half_mask(half, label, None), MIN_PIXELS));
        // Too large even at the smallest distance.
        if left.first().is_some_and(|c| self.area(c, DEPTHS.0) > SCENERY) {
            return Vec::new();
        }
        let mut found = Vec::new();
        for l in left.iter().take(6) {
            for r in right.iter().take(6) {
                let Some(z) = self.pair_depth(l, r) else { continue };
                let area = self.area(l, z);
                if area > SCENERY {
                    return Vec::new();
                }
                if (DEPTHS.0..DEPTHS.1).contains(&z) && (AREAS.0..AREAS.1).contains(&area) {
                    let score = self.likeness(label, area);
                    found.push(Candidate { label, left: l.clone(), right: Some(r.clone()), z, score });
                }
            }
        }
        found
    }

    /// The depth of a pair of components (half resolution), m, if they can be the same region.
    fn pair_depth(&self, l: &Component, r: &Component) -> Option<f64> {
        let (small, large) = (f64::from(l.area.min(r.area)), f64::from(l.area.max(r.area)));
        let height = f64::from(l.bounds.height.max(r.bounds.height));
        if small < 0.5 * large || (l.centroid.y - r.centroid.y).abs() > 2.0 + 0.12 * height {
            return None;
        }
        let disparity = 2.0 * (l.centroid.x - r.centroid.x);
        (disparity > 1.0).then(|| self.calibration.camera.focal * self.calibration.baseline / disparity)
    }

    /// How well a region fits a hand: its colour near the preferred one, its area (m^2) near a hand's.
    fn likeness(&self, label: u8, area: f64) -> f64 {
        let (peak, (middle, deviation)) = (self.clusters.peak(label), self.preferred);
        let apart = f64::from(libm::hypotf(peak[0] - middle[0], peak[1] - middle[1])) / deviation;
        let size = libm::log(area / 90e-4) / 0.7;
        libm::exp(-0.5 * (apart * apart + size * size))
    }
}

/// The median depth of a region (half resolution), m; `None` without measurements.
fn median_depth(thing: &Component, depth: &DepthImage) -> Option<f64> {
    let pixels = thing.runs.iter().flat_map(|run| (run.x0..run.x1).map(|x| depth.at(2 * x, 2 * run.y)));
    median(pixels.filter(|z| *z > 0.0).collect())
}

/// The median of some depths, m.
pub(crate) fn median(mut values: Vec<f32>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1))
}

/// A region at half resolution in full-resolution pixels, slightly enlarged.
fn full(half: &Region, size: (u32, u32)) -> Region {
    let whole = Region { x: 2 * half.x, y: 2 * half.y, width: 2 * half.width, height: 2 * half.height };
    whole.grown(6, size.0, size.1)
}

/// Keeps only the largest component.
fn own_pixels(mask: &Mask) -> Mask {
    largest(mask).map_or_else(|| Mask::empty(mask.region()), |own| own.alone(mask.region()))
}
