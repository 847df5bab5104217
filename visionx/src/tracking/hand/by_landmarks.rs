//! A hand by the landmarks of trained networks: where it is in space, by depth or by both eyes, and which fingers are stretched.
//!
//! The networks tell where the joints are relative to each other, for a hand of usual size. How far away the hand is, is the median over
//! all landmarks of what is measured there, so a few that something hides, or that lie beside a thin finger, do not matter. What is measured
//! at the palm counts if it fits that. Along a stretched finger the networks tell too little depth, so that is measured from joint to joint.
//! What is much larger or smaller there than a hand is none.

use std::ops::RangeInclusive;

use nalgebra::{Point2, Point3, Vector2, Vector3};

use super::candidates::median;
use super::depth::depth_about;
use super::measured::MeasuredHand;
use super::{Fingertip, HandObservation};
use crate::camera::StereoCalibration;
use crate::frame::{DepthImage, StereoFrame};
use crate::tracking::{FingerPosture, HandLandmarks, LearnedHandDetector};

/// Radius around a landmark, and around the palm's middle, in which its depth is measured, relative to the palm's.
const ABOUT: f64 = 0.12;
const ABOUT_PALM: f64 = 0.75;
/// What is measured farther than this from where a landmark is told to be is something else, m; what is nearer by more than this hides it.
const ELSEWHERE: f64 = 0.05;
/// How much longer than told a piece of a finger may be.
const LONGER: f64 = 1.3;
/// Fewer landmarks tell nothing of how far away the hand is.
const FEWEST: usize = 8;
/// How large a hand is, relative to a usual one. Rendered hands are measured 0.75 to 1.1 times as large, what was taken for a hand in a
/// pattern on a table 3.6 to 4.1 times.
const SIZES: RangeInclusive<f64> = 0.5..=2.0;

/// Measures hands by their landmarks.
#[derive(Clone, Debug)]
pub(crate) struct HandsByLandmarks {
    left: LearnedHandDetector,
    /// Only where there is no depth.
    right: LearnedHandDetector,
}

impl Default for HandsByLandmarks {
    fn default() -> Self {
        let detector = LearnedHandDetector::of_sequence();
        Self { left: detector.clone(), right: detector }
    }
}

/// A hand in a frame.
struct Hand<'a> {
    landmarks: &'a HandLandmarks,
    calibration: &'a StereoCalibration,
    by: By<'a>,
    /// The depth of what is seen at each landmark, m, if it was measured.
    depths: [Option<f64>; HandLandmarks::COUNT],
    /// The depth of the landmarks' own origin, m.
    origin: f64,
}

/// What depths are measured by.
enum By<'a> {
    /// The depth image shows the skin over the landmarks.
    Depth(&'a DepthImage),
    /// Both eyes see the landmarks themselves: those in the right image.
    Eyes(Box<HandLandmarks>),
}

impl HandsByLandmarks {
    /// Forgets where the hand was.
    pub(crate) fn forget(&mut self) {
        self.left.forget();
        self.right.forget();
    }

    pub(crate) fn measure(
        &mut self,
        frame: &StereoFrame,
        calibration: &StereoCalibration,
    ) -> Option<MeasuredHand> {
        let landmarks = &self.left.landmarks(&frame.left)?;
        let depth = frame.depth.as_deref().and_then(|depth| calibration.camera.usable(depth));
        let by = match depth {
            Some(depth) => By::Depth(depth),
            None => By::Eyes(Box::new(self.right.landmarks(&frame.right)?)),
        };
        let mut hand = Hand { landmarks, calibration, by, depths: [None; HandLandmarks::COUNT], origin: 0.0 };
        hand.depths = std::array::from_fn(|i| hand.seen(i, |_| true));
        let depths = &hand.depths;
        let offsets = depths.iter().zip(&landmarks.in_hand);
        let offsets: Vec<f32> = offsets.filter_map(|(z, told)| Some(((*z)? - told.z) as f32)).collect();
        if offsets.len() < FEWEST {
            return None;
        }
        hand.origin = median(offsets)?;
        if !SIZES.contains(&hand.size()) {
            // A hand may be elsewhere in the next frame.
            self.forget();
            return None;
        }
        hand.measured(frame)
    }
}

impl Hand<'_> {
    /// The depth of what counts at a landmark, m, if it can be measured.
    fn seen(&self, landmark: usize, counts: impl Fn(f64) -> bool) -> Option<f64> {
        let px = &self.landmarks.points[landmark];
        match &self.by {
            By::Depth(depth) => self.shown(depth, px, ABOUT, counts),
            By::Eyes(right) => self
                .calibration
                .triangulate(px, &right.points[landmark])
                .map(|at| at.z)
                .filter(|z| counts(*z)),
        }
    }

    /// The depth of what counts within a radius (relative to the palm's) about a pixel of the depth image, m.
    fn shown(
        &self,
        depth: &DepthImage,
        px: &Point2<f64>,
        radius: f64,
        counts: impl Fn(f64) -> bool,
    ) -> Option<f64> {
        // Beside the picture there is no depth, which counts for nothing.
        let counts = |x: i64, y: i64| counts(f64::from(depth.at(x as u32, y as u32)));
        depth_about(depth, px, radius * self.landmarks.palm().1, counts)
    }

    /// The centre of the palm, left camera's frame, m.
    fn palm(&self) -> Option<Point3<f64>> {
        let (px, _) = self.landmarks.palm();
        let told = self.landmarks.palm_in_hand().z + self.origin;
        let fits = |z: f64| (z - told).abs() < ELSEWHERE;
        match &self.by {
            By::Depth(depth) => {
                let z = self.shown(depth, &px, ABOUT_PALM, |_| true).filter(|z| fits(*z));
                MeasuredHand::under(self.at(&px, z.unwrap_or(told)))
            }
            By::Eyes(right) => {
                let z = self.calibration.triangulate(&px, &right.palm().0).map(|at| at.z);
                Some(self.at(&px, z.filter(|z| fits(*z)).unwrap_or(told)))
            }
        }
    }

    /// How large the hand is in space, across the picture, relative to a usual one.
    fn size(&self) -> f64 {
        let told = &self.landmarks.in_hand;
        let places = self.landmarks.points.iter().zip(told);
        let places: Vec<_> = places.map(|(px, told)| self.at(px, told.z + self.origin).xy()).collect();
        let told: Vec<_> = told.iter().map(Point3::xy).collect();
        spread(&places) / spread(&told).max(f64::MIN_POSITIVE)
    }

    fn measured(&self, frame: &StereoFrame) -> Option<MeasuredHand> {
        let (palm_px, palm_radius_px) = self.landmarks.palm();
        let posture = FingerPosture::of(self.landmarks);
        let bounds = self.landmarks.bounds(palm_radius_px, &frame.left);
        let cut = bounds.touches_border(frame.left.width(), frame.left.height());
        let hidden = if cut { 1.0 } else { self.hidden() };
        let fingers = HandLandmarks::FINGERS.into_iter().zip(posture.stretched());
        let stretched: Vec<([usize; 4], f64)> = fingers.filter(|(_, score)| *score > 0.5).collect();
        // A thumb beside a pointing finger does not point.
        let thumb = HandLandmarks::FINGERS[0];
        let pointing: Vec<[usize; 4]> =
            stretched.iter().map(|(finger, _)| *finger).filter(|finger| *finger != thumb).collect();
        let points = hidden < HandObservation::HIDDEN && (1..=2).contains(&pointing.len());
        let fingertip = |(finger, score): &([usize; 4], f64)| {
            let px = self.landmarks.fingertip(*finger);
            let [_, z] = self.finger_depths(finger);
            Fingertip { px, in_left: Some(self.at(&px, z)), score: *score }
        };
        Some(MeasuredHand {
            palm: self.palm()?,
            palm_px,
            palm_radius_px,
            hidden,
            likelihoods: posture.likelihoods(),
            fingertips: stretched.iter().map(fingertip).collect(),
            direction: self.direction(&pointing).filter(|_| points).map(|d| (d, pointing.len())),
            bounds,
        })
    }

    /// The share of the landmarks that something nearer hides; 0 without a depth image.
    fn hidden(&self) -> f64 {
        if let By::Eyes(_) = self.by {
            return 0.0;
        }
        let told = self.landmarks.in_hand.iter().map(|at| at.z + self.origin);
        let hidden = self.depths.iter().zip(told).filter(|(z, told)| z.is_some_and(|z| z < told - ELSEWHERE));
        hidden.count() as f64 / self.depths.len() as f64
    }

    /// The depths of a stretched finger's second joint and of its tip, m. From joint to joint the depth changes by hardly more than
    /// their distance; what changes more is before or behind the finger.
    fn finger_depths(&self, [_, joint, middle, tip]: &[usize; 4]) -> [f64; 2] {
        let in_hand = &self.landmarks.in_hand;
        let told = in_hand[*joint].z + self.origin;
        let begin = self.seen(*joint, |z| (z - told).abs() < ELSEWHERE).unwrap_or(told);
        let next = |z: f64, [from, to]: [usize; 2]| {
            let piece = in_hand[to] - in_hand[from];
            let farthest = LONGER * piece.norm();
            self.seen(to, |at| (at - z).abs() < farthest).unwrap_or(z + piece.z)
        };
        [begin, next(next(begin, [*joint, *middle]), [*middle, *tip])]
    }

    fn at(&self, px: &Point2<f64>, z: f64) -> Point3<f64> {
        Point3::from(self.calibration.camera.ray(px) * z)
    }

    /// The mean direction of fingers from their second joint to their tip: a thumb or curled fingers may lie before the knuckle.
    fn direction(&self, fingers: &[[usize; 4]]) -> Option<Vector3<f64>> {
        let mut sum = Vector3::zeros();
        for finger in fingers {
            let [from, to] = self.finger_depths(finger);
            let [_, joint, _, tip] = finger.map(|i| &self.landmarks.points[i]);
            sum += (self.at(tip, to) - self.at(joint, from)).try_normalize(1e-6)?;
        }
        sum.try_normalize(1e-6)
    }
}

/// How far points are from their middle, as the root of the mean square.
fn spread(points: &[Point2<f64>]) -> f64 {
    let n = points.len() as f64;
    let middle = points.iter().map(|p| p.coords).sum::<Vector2<f64>>() / n;
    (points.iter().map(|p| (p.coords - middle).norm_squared()).sum::<f64>() / n).sqrt()
}
