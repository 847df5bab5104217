//! A hand by the landmarks of trained networks: where it is in space, by depth or by both eyes, and which fingers are stretched.
//!
//! The networks tell where the joints are relative to each other, for a hand of usual size. How far away the hand is, is the median over
//! all landmarks of what is measured there, so a few that something hides, or that lie beside a thin finger, do not matter. What is measured
//! at the palm and at a finger counts if it fits that.

use nalgebra::{Point2, Point3, Vector3};

use super::candidates::median;
use super::depth::depth_about;
use super::measured::MeasuredHand;
use super::{Fingertip, HandObservation};
use crate::camera::StereoCalibration;
use crate::frame::StereoFrame;
use crate::tracking::{FingerBends, HandLandmarks, LearnedHandDetector};

/// Radius around a landmark, and around the palm's middle, in which its depth is measured, relative to the palm's.
const ABOUT: f64 = 0.12;
const ABOUT_PALM: f64 = 0.75;
/// What is measured farther than this from where a landmark is told to be is something else, m; what is nearer by more than this hides it.
const ELSEWHERE: f64 = 0.05;
/// Fewer landmarks tell nothing of how far away the hand is.
const FEWEST: usize = 8;

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
    /// The depth of what is seen at each landmark, m, if it was measured.
    depths: [Option<f64>; HandLandmarks::COUNT],
    /// The same at the palm's middle.
    palm_depth: Option<f64>,
    /// The depth of the landmarks' own origin, m.
    origin: f64,
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
        let landmarks = self.left.landmarks(&frame.left)?;
        let (palm, palm_radius) = landmarks.palm();
        let (depths, palm_depth) = match frame.depth.as_deref() {
            Some(depth) => {
                let is_inside = |at: i64, size: u32| (0..i64::from(size)).contains(&at);
                let counts = |x, y| is_inside(x, depth.width) && is_inside(y, depth.height);
                let about = |px: &Point2<f64>, radius| depth_about(depth, px, radius * palm_radius, counts);
                (landmarks.points.map(|px| about(&px, ABOUT)), about(&palm, ABOUT_PALM))
            }
            None => {
                let right = self.right.landmarks(&frame.right)?;
                let depth = |left, right| Some(calibration.triangulate(left, right)?.z);
                let depths = std::array::from_fn(|i| depth(&landmarks.points[i], &right.points[i]));
                (depths, depth(&palm, &right.palm().0))
            }
        };
        let offsets = depths.iter().zip(&landmarks.in_hand);
        let offsets: Vec<f32> = offsets.filter_map(|(z, told)| Some(((*z)? - told.z) as f32)).collect();
        if offsets.len() < FEWEST {
            return None;
        }
        let origin = median(offsets)?;
        Hand { landmarks: &landmarks, calibration, depths, palm_depth, origin }.measured(frame)
    }
}

impl Hand<'_> {
    fn measured(&self, frame: &StereoFrame) -> Option<MeasuredHand> {
        let (palm_px, palm_radius_px) = self.landmarks.palm();
        let bends = FingerBends::of(self.landmarks);
        let bounds = self.landmarks.bounds(palm_radius_px, &frame.left);
        let cut = bounds.touches_border(frame.left.width(), frame.left.height());
        let hidden = if cut { 1.0 } else { self.hidden(frame) };
        let fingers = HandLandmarks::FINGERS.into_iter().zip(bends.stretched());
        let stretched: Vec<([usize; 4], f64)> = fingers.filter(|(_, score)| *score > 0.5).collect();
        // A thumb beside a pointing finger does not point.
        let thumb = HandLandmarks::FINGERS[0];
        let pointing: Vec<[usize; 4]> =
            stretched.iter().map(|(finger, _)| *finger).filter(|finger| *finger != thumb).collect();
        let points = hidden < HandObservation::HIDDEN && (1..=2).contains(&pointing.len());
        let fingertip = |(finger, score): &([usize; 4], f64)| {
            let px = self.landmarks.fingertip(*finger);
            let z = self.depth(finger[3]);
            Fingertip { px, in_left: Some(self.at(&px, z)), score: *score }
        };
        let palm = self.fitting(self.palm_depth, self.landmarks.palm_in_hand().z);
        let palm = self.at(&palm_px, palm);
        Some(MeasuredHand {
            // A depth image shows the skin; the landmarks that both eyes see are within the hand.
            palm: if frame.depth.is_some() { MeasuredHand::under(palm)? } else { palm },
            palm_px,
            palm_radius_px,
            hidden,
            likelihoods: bends.likelihoods(),
            fingertips: stretched.iter().map(fingertip).collect(),
            direction: self.direction(&pointing).filter(|_| points).map(|d| (d, pointing.len())),
            bounds,
        })
    }

    /// The share of the landmarks that something nearer hides; 0 without a depth image.
    fn hidden(&self, frame: &StereoFrame) -> f64 {
        if frame.depth.is_none() {
            return 0.0;
        }
        let told = self.landmarks.in_hand.iter().map(|at| at.z + self.origin);
        let hidden = self.depths.iter().zip(told).filter(|(z, told)| z.is_some_and(|z| z < told - ELSEWHERE));
        hidden.count() as f64 / self.depths.len() as f64
    }

    /// The depth of a landmark, m.
    fn depth(&self, landmark: usize) -> f64 {
        self.fitting(self.depths[landmark], self.landmarks.in_hand[landmark].z)
    }

    /// A depth as measured, unless that is of something else than what the landmarks tell there.
    fn fitting(&self, measured: Option<f64>, in_hand: f64) -> f64 {
        let told = in_hand + self.origin;
        measured.filter(|z| (z - told).abs() < ELSEWHERE).unwrap_or(told)
    }

    fn at(&self, px: &Point2<f64>, z: f64) -> Point3<f64> {
        Point3::from(self.calibration.camera.ray(px) * z)
    }

    /// The mean direction of fingers from their second joint to their tip: a thumb or curled fingers may lie before the knuckle.
    fn direction(&self, fingers: &[[usize; 4]]) -> Option<Vector3<f64>> {
        let mut sum = Vector3::zeros();
        for [_, joint, _, tip] in fingers {
            let [base, end] = [*joint, *tip].map(|i| self.at(&self.landmarks.points[i], self.depth(i)));
            sum += (end - base).try_normalize(1e-6)?;
        }
        sum.try_normalize(1e-6)
    }
}
