//! From frames to a hand: chooses among the skin-coloured things the one that is a hand, and smooths over time.

use nalgebra::{Point2, Point3, Vector3};

use super::depth::{View, disparity};
use super::patterns::likelihoods;
use super::shape::{Finger, HandShape, hand_shape};
use super::skin::{HalfImage, SkinClusters};
use super::{Fingertip, Gesture, HandObservation};
use crate::camera::StereoCalibration;
use crate::components::{Component, components};
use crate::frame::{DepthImage, StereoFrame};
use crate::mask::{Mask, Region};

/// Finds a hand and its gesture in a stream of frames.
#[derive(Clone, Debug)]
pub struct HandObserver {
    calibration: StereoCalibration,
    memory: Option<Memory>,
}

/// What the last frames have shown.
#[derive(Clone, Debug)]
struct Memory {
    stamp_ns: u64,
    /// Probability of each gesture.
    belief: [f64; 4],
    /// The skin's log-chromaticities.
    skin: [f32; 2],
    /// Where the hand pointed, in the root frame.
    pointing: Option<Vector3<f64>>,
}

/// A thing of skin colour seen by both eyes, with pixels at half resolution.
struct Candidate {
    label: u8,
    left: Component,
    right: Component,
    /// Depth, m.
    z: f64,
    score: f64,
}

/// A candidate that has the shape of a hand.
struct Hand {
    candidate: Candidate,
    masks: [Mask; 2],
    shape: HandShape,
}

/// Distances at which hands are looked for, m.
const DEPTHS: (f64, f64) = (0.2, 1.7);
/// Areas that a hand can show, with a part of the arm, m^2.
const AREAS: (f64, f64) = (18e-4, 400e-4);
/// Area over which a thing of skin-like colour is scenery, m^2.
const SCENERY: f64 = 600e-4;
/// Radii of the palm's largest disc, from the edge and with a large hand, m.
const PALM_RADII: (f64, f64) = (0.0145, 0.062);
/// From a palm's surface to its middle, m.
const HALF_PALM: f64 = 0.014;
/// Share of a hand's outline behind which the scene lies deeper, at least. A patch of a surface has none, save where
/// the surface ends.
const LEAST_RELIEF: f64 = 0.3;
/// Deeper by more than this, m.
const STEP: f32 = 0.012;
/// Probability that a gesture goes on to the next frame. With [`FLOOR`], a change takes two clear frames.
const STAY: f64 = 0.94;
/// Least likelihood of a gesture in one frame.
const FLOOR: f64 = 0.04;
/// After this long without a hand, what was seen before does not matter, ns.
const FORGET_NS: u64 = 400_000_000;

impl HandObserver {
    /// An observer that has seen nothing yet.
    #[must_use]
    pub fn new(calibration: StereoCalibration) -> Self {
        Self { calibration, memory: None }
    }

    /// Takes a frame; returns the hand in it, `None` when there is none. Frames whose images do not have the
    /// calibration's size show nothing.
    pub fn update(&mut self, frame: &StereoFrame) -> Option<HandObservation> {
        if !self.calibration.fits(frame) {
            return None;
        }
        let forgotten = |m: &Memory| frame.stamp_ns < m.stamp_ns || frame.stamp_ns - m.stamp_ns > FORGET_NS;
        if self.memory.as_ref().is_some_and(forgotten) {
            self.memory = None;
        }
        let halves = [&frame.left, &frame.right].map(HalfImage::of);
        let clusters = SkinClusters::find(&halves[0]);
        let hand = self.find(frame, &halves, &clusters)?;
        self.observe(frame, &clusters, hand)
    }

    /// The thing that looks most like a hand.
    fn find(&self, frame: &StereoFrame, halves: &[HalfImage; 2], clusters: &SkinClusters) -> Option<Hand> {
        let mut candidates: Vec<Candidate> =
            clusters.labels().flat_map(|label| self.candidates(halves, clusters, label)).collect();
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        candidates.into_iter().take(4).find_map(|candidate| {
            let size = (frame.left.width(), frame.left.height());
            let masks =
                [(&frame.left, &candidate.left), (&frame.right, &candidate.right)].map(|(image, part)| {
                    own_pixels(&clusters.mask(image, full(&part.bounds, size), candidate.label))
                });
            let shape = hand_shape(&masks[0], candidate.z / self.calibration.camera.focal)?;
            let fits = (PALM_RADII.0..PALM_RADII.1).contains(&shape.palm_radius)
                && (AREAS.0..AREAS.1).contains(&shape.area);
            let stands_out = frame.depth.as_ref().is_none_or(|d| relief(&masks[0], d) >= LEAST_RELIEF);
            (fits && stands_out).then_some(Hand { candidate, masks, shape })
        })
    }

    /// The things of one cluster that have a hand's size; none if the cluster is scenery.
    fn candidates(&self, halves: &[HalfImage; 2], clusters: &SkinClusters, label: u8) -> Vec<Candidate> {
        let camera = &self.calibration.camera;
        let [left, right] = halves.each_ref().map(|half| components(&clusters.half_mask(half, label), 30));
        let area_at = |c: &Component, z: f64| 4.0 * f64::from(c.area) * (z / camera.focal).powi(2);
        // Too large even at the nearest distance.
        if left.first().is_some_and(|c| area_at(c, DEPTHS.0) > SCENERY) {
            return Vec::new();
        }
        let mut found = Vec::new();
        for l in left.iter().take(6) {
            for r in right.iter().take(6) {
                let Some(z) = self.pair_depth(l, r) else { continue };
                let area = area_at(l, z);
                if area > SCENERY {
                    return Vec::new();
                }
                if (DEPTHS.0..DEPTHS.1).contains(&z) && (AREAS.0..AREAS.1).contains(&area) {
                    let score = self.likeness(clusters.peak(label), area);
                    found.push(Candidate { label, left: l.clone(), right: r.clone(), z, score });
                }
            }
        }
        found
    }

    /// The depth of a pair of components (half resolution), m, if they can be one thing.
    fn pair_depth(&self, l: &Component, r: &Component) -> Option<f64> {
        let (small, large) = (f64::from(l.area.min(r.area)), f64::from(l.area.max(r.area)));
        let height = f64::from(l.bounds.height.max(r.bounds.height));
        if small < 0.5 * large || (l.centroid.y - r.centroid.y).abs() > 2.0 + 0.12 * height {
            return None;
        }
        let disparity = 2.0 * (l.centroid.x - r.centroid.x);
        (disparity > 1.0).then(|| self.calibration.camera.focal * self.calibration.baseline / disparity)
    }

    /// How much a thing looks like skin of a hand's size: its colour near that of the last frames or else of usual
    /// skin, its area (m^2) near that of a hand.
    fn likeness(&self, peak: [f32; 2], area: f64) -> f64 {
        // Log-chromaticities of light and dark skin in white light lie about here, with these deviations.
        let (middle, deviation) = self.memory.as_ref().map_or(([0.30, 0.25], 0.12), |m| (m.skin, 0.06));
        let apart = f64::from((peak[0] - middle[0]).hypot(peak[1] - middle[1])) / deviation;
        let size = (area / 90e-4).ln() / 0.7;
        (-0.5 * (apart * apart + size * size)).exp()
    }

    fn observe(
        &mut self,
        frame: &StereoFrame,
        clusters: &SkinClusters,
        hand: Hand,
    ) -> Option<HandObservation> {
        let camera = &self.calibration.camera;
        let (shape, z) = (&hand.shape, hand.candidate.z);
        let coarse = camera.focal * self.calibration.baseline / z;
        let at_palm = self.part_disparity(frame, &hand, &shape.palm, 0.75 * shape.palm_radius, coarse);
        let surface = self.point(&shape.palm, at_palm.unwrap_or(coarse))?;
        let palm_in_left = surface + surface.coords.try_normalize(1e-6)? * HALF_PALM;

        let belief = self.believe(&likelihoods(&shape.fingers));
        let best = (0..4).max_by(|&a, &b| belief[a].total_cmp(&belief[b]))?;
        let gesture = Gesture::ALL[best];
        let stretched: Vec<&Finger> = shape.fingers.iter().filter(|f| f.score > 0.5).collect();
        let guess = at_palm.unwrap_or(coarse);
        let direction = match (gesture, stretched.len()) {
            (Gesture::PointOne, 1) | (Gesture::PointTwo, 2) => {
                self.direction(frame, &hand, &stretched, guess)
            }
            _ => None,
        };
        let tips = stretched.iter().map(|f| Fingertip {
            px: f.tip,
            in_left: self.tip_disparity(frame, &hand, f, guess).and_then(|d| self.point(&f.tip, d)),
            score: f.score,
        });
        let fingertips = tips.collect();
        let points = matches!(gesture, Gesture::PointOne | Gesture::PointTwo);
        let pointing = self.smooth(direction, points, frame);
        self.memory = Some(Memory {
            stamp_ns: frame.stamp_ns,
            belief,
            skin: clusters.peak(hand.candidate.label),
            pointing: pointing.map(|p| frame.root_from_left * p),
        });
        Some(HandObservation {
            gesture,
            confidence: belief[best],
            palm_in_left,
            palm_px: shape.palm,
            palm_radius_px: shape.palm_radius * camera.focal / z,
            pointing,
            fingertips,
            bounding_box: bounds(&hand.masks[0]),
            stamp_ns: frame.stamp_ns,
        })
    }

    /// The gestures' probabilities after one more frame: a hidden Markov chain.
    fn believe(&self, likelihoods: &[f64; 4]) -> [f64; 4] {
        let before = self.memory.as_ref().map_or([0.25; 4], |m| m.belief);
        let mut belief = [0.0; 4];
        for i in 0..4 {
            let predicted = before[i] * STAY + (1.0 - before[i]) * (1.0 - STAY) / 3.0;
            belief[i] = predicted * (likelihoods[i] + FLOOR);
        }
        let sum: f64 = belief.iter().sum();
        belief.map(|b| b / sum)
    }

    /// The direction with the last frames' mixed in; remembered while the hand goes on pointing.
    fn smooth(&self, now: Option<Vector3<f64>>, points: bool, frame: &StereoFrame) -> Option<Vector3<f64>> {
        let before =
            self.memory.as_ref().and_then(|m| m.pointing).map(|p| frame.root_from_left.inverse() * p);
        match (now, before) {
            _ if !points => None,
            (Some(now), Some(before)) if now.dot(&before) > 0.5 => (now + before).try_normalize(1e-9),
            (Some(now), _) => Some(now),
            (None, before) => before,
        }
    }

    /// The mean direction of stretched fingers, unit vector in the left camera's frame.
    fn direction(
        &self,
        frame: &StereoFrame,
        hand: &Hand,
        fingers: &[&Finger],
        guess: f64,
    ) -> Option<Vector3<f64>> {
        let mut sum = Vector3::zeros();
        for finger in fingers {
            let tip = self.point(&finger.tip, self.tip_disparity(frame, hand, finger, guess)?)?;
            let base =
                self.point(&finger.base, self.part_disparity(frame, hand, &finger.base, 0.018, guess)?)?;
            sum += (tip - base).try_normalize(1e-6)?;
        }
        sum.try_normalize(1e-6)
    }

    /// The disparity at a finger's end, px, compared a little inside of the tip.
    fn tip_disparity(&self, frame: &StereoFrame, hand: &Hand, finger: &Finger, guess: f64) -> Option<f64> {
        let inside = finger.tip + (finger.base - finger.tip) * (0.008 / finger.length.max(0.02));
        self.part_disparity(frame, hand, &inside, 0.012, guess)
    }

    /// The disparity of the part of the hand within `radius` m of a pixel, px.
    fn part_disparity(
        &self,
        frame: &StereoFrame,
        hand: &Hand,
        px: &Point2<f64>,
        radius: f64,
        guess: f64,
    ) -> Option<f64> {
        let focal = self.calibration.camera.focal;
        let z = focal * self.calibration.baseline / guess;
        // A hand's parts lie within a decimetre of its palm in depth.
        let range = (0.1 * guess / z).ceil().clamp(3.0, 40.0) as i64 + 1;
        let left = View { image: &frame.left, hand: &hand.masks[0] };
        let right = View { image: &frame.right, hand: &hand.masks[1] };
        disparity(left, right, px, radius * focal / z, guess, range)
    }

    fn point(&self, px: &Point2<f64>, disparity: f64) -> Option<Point3<f64>> {
        self.calibration.triangulate(px, &Point2::new(px.x - disparity, px.y))
    }
}

/// The share of a mask's outline behind which the scene lies deeper by [`STEP`] or more. Along rows and columns, from
/// inside the outline to outside of it; outlines at the image's border do not count. 0 without an outline.
fn relief(mask: &Mask, depth: &DepthImage) -> f64 {
    let at = |x: i64, y: i64| {
        let inside = x >= 0 && y >= 0 && x < i64::from(depth.width) && y < i64::from(depth.height);
        inside.then(|| depth.data.get(y as usize * depth.width as usize + x as usize).copied()).flatten()
    };
    let (mut outline, mut deeper) = (0usize, 0usize);
    let region = mask.region();
    for y in i64::from(region.y)..i64::from(region.y + region.height) {
        for x in i64::from(region.x)..i64::from(region.x + region.width) {
            if !mask.contains(x, y) {
                continue;
            }
            for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if mask.contains(x + dx, y + dy) {
                    continue;
                }
                let (Some(here), Some(there)) = (at(x - 2 * dx, y - 2 * dy), at(x + 4 * dx, y + 4 * dy))
                else {
                    continue;
                };
                outline += 1;
                // Nothing measured outside is nothing near.
                deeper += usize::from(here > 0.0 && (there == 0.0 || there > here + STEP));
            }
        }
    }
    if outline == 0 { 0.0 } else { deeper as f64 / outline as f64 }
}

/// A region at half resolution in whole pixels, a little larger.
fn full(half: &Region, size: (u32, u32)) -> Region {
    let whole = Region { x: 2 * half.x, y: 2 * half.y, width: 2 * half.width, height: 2 * half.height };
    whole.grown(6, size.0, size.1)
}

/// The largest component alone.
fn own_pixels(mask: &Mask) -> Mask {
    let mut own = Mask::empty(mask.region());
    if let Some(largest) = components(mask, 1).first() {
        own.add(&largest.runs);
    }
    own
}

fn bounds(mask: &Mask) -> Region {
    components(mask, 1).first().map_or_else(Region::default, |c| c.bounds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{CALIBRATION, TABLE, Thing, empty_frames, frame, hand, table};
    use nalgebra::Isometry3;

    const PLACE: Point3<f64> = Point3::new(0.02, -0.02, 0.7);

    fn scene(gesture: Gesture, roll: f64, back: bool, tilt: f64) -> (Vec<Thing>, Vector3<f64>) {
        let (mut things, direction) = hand(gesture, PLACE, roll, back, tilt);
        things.push(table(TABLE));
        (things, direction)
    }

    #[test]
    fn knows_the_gestures_from_both_sides() {
        for gesture in Gesture::ALL {
            for (i, (roll, back, tilt)) in
                [(-1.6, true, 0.0), (0.2, false, 0.3), (2.9, true, -0.3)].into_iter().enumerate()
            {
                let (things, _) = scene(gesture, roll, back, tilt);
                let seen = HandObserver::new(CALIBRATION).update(&frame(&things, 0, i as u64)).unwrap();
                assert_eq!(seen.gesture, gesture, "roll {roll} back {back} tilt {tilt}: {seen:?}");
                assert!((seen.palm_in_left - PLACE).norm() < 0.04, "{:?}", seen.palm_in_left);
            }
        }
    }

    #[test]
    fn only_what_stands_out_has_relief() {
        let mut mask = Mask::empty(Region { x: 20, y: 20, width: 30, height: 30 });
        mask.data_mut().fill(1);
        let depth = |inside: f32, outside: f32| {
            let at = |i: u32| (20..50).contains(&(i % 80)) && (20..50).contains(&(i / 80));
            let data = (0..80 * 80).map(|i| if at(i) { inside } else { outside }).collect();
            DepthImage { width: 80, height: 80, data }
        };
        assert_eq!(relief(&mask, &depth(0.7, 0.8)), 1.0);
        assert_eq!(relief(&mask, &depth(0.7, 0.0)), 1.0);
        assert_eq!(relief(&mask, &depth(0.7, 0.705)), 0.0);
        assert_eq!(relief(&mask, &depth(0.7, 0.6)), 0.0);
        assert_eq!(relief(&mask, &DepthImage { width: 80, height: 80, data: Vec::new() }), 0.0);
    }

    #[test]
    fn a_patch_of_the_surface_around_is_no_hand() {
        let (things, _) = scene(Gesture::Fist, 0.2, false, 0.3);
        let mut flat = frame(&things, 0, 1);
        let (width, height) = (flat.left.width(), flat.left.height());
        assert!(HandObserver::new(CALIBRATION).update(&flat).is_some());
        let data = vec![0.7; (width * height) as usize];
        flat.depth = Some(DepthImage { width, height, data });
        assert_eq!(HandObserver::new(CALIBRATION).update(&flat), None);
    }

    #[test]
    fn measures_where_a_finger_points() {
        for (roll, tilt) in [(-1.6, 0.0), (0.3, 0.3), (0.3, -0.3), (2.5, 0.2)] {
            let (things, direction) = scene(Gesture::PointOne, roll, true, tilt);
            let seen = HandObserver::new(CALIBRATION).update(&frame(&things, 0, 1)).unwrap();
            let angle = seen.pointing.unwrap().angle(&direction);
            assert!(angle < 0.2, "{angle} at roll {roll}, tilt {tilt}");
            let tip = seen.fingertips[0].in_left.unwrap();
            assert!((tip - PLACE).dot(&direction) > 0.1, "{tip}");
        }
    }

    #[test]
    fn notices_a_change_within_four_frames() {
        let mut observer = HandObserver::new(CALIBRATION);
        let mut late = 0;
        for (i, gesture) in
            [[Gesture::Fist; 4], [Gesture::PointTwo; 4], [Gesture::OpenHand; 4]].concat().iter().enumerate()
        {
            let (things, _) = scene(*gesture, -1.6, true, 0.1);
            let seen = observer.update(&frame(&things, i as u64 * 66_000_000, i as u64)).unwrap();
            late = if seen.gesture == *gesture { 0 } else { late + 1 };
            assert!(late < 4, "frame {i}");
        }
    }

    #[test]
    fn without_a_hand_there_is_none() {
        let mut observer = HandObserver::new(CALIBRATION);
        for frame in empty_frames() {
            assert_eq!(observer.update(&frame), None);
        }
        for color in [TABLE, [205, 190, 165], [180, 140, 100], [224, 172, 138]] {
            let at = |x, y| Isometry3::translation(x, y, 0.93);
            let block =
                |x, y, color| Thing::Block { root_from_block: at(x, y), size: Vector3::repeat(0.07), color };
            let things = [
                table(color),
                block(0.1, 0.5, [240, 210, 40]),
                block(0.3, 0.5, [40, 170, 60]),
                block(0.3, 0.65, [120, 122, 128]),
                block(0.1, 0.65, [230, 120, 20]),
            ];
            assert_eq!(observer.update(&frame(&things, 0, 4)), None, "{color:?}");
        }
    }
}
