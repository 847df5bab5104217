//! Tracks the fingertips of a person's hand in a stream of frames.
//!
//! The hand's silhouette gives an edge map, the edges give circles of a fingertip's radius at the hand's distance, and
//! a particle filter tracks them. Each tip is then moved to the mean of the votes around it.

use nalgebra::{Point2, Point3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::ar_model::FingerARModel;
use super::contour_filter::{FilterFrame, ParticleFilterFingerTracking};
use super::edges::edge_map;
use super::hough::{AdaptiveHoughTransform, TipCandidate};
use crate::camera::StereoCalibration;
use crate::frame::StereoFrame;
use crate::tracking::hand::candidates::{HandCandidate, find};
use crate::tracking::hand::depth::Ranging;
use crate::tracking::hand::shape::Finger;

/// Parameters of the fingertip tracking. The parts can be switched off one by one, to measure their effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerTipSettings {
    /// The detector of circles of a fingertip's size.
    pub hough: AdaptiveHoughTransform,
    /// The motion model of the tips.
    pub model: FingerARModel,
    /// Whether each tip is moved to the mean of the votes around it.
    pub mean_shift: bool,
    /// Whether the particle filter tracks the tips; otherwise each frame's candidates are used directly.
    pub filter: bool,
    /// Number of particles.
    pub particles: usize,
    /// Seed of the filter.
    pub seed: u64,
}

/// A tracked fingertip.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedFingertip {
    /// Number of the finger, constant while it is tracked; 0 without the filter.
    pub id: u64,
    /// Centre of the circle fitted to the fingertip in the left image, px.
    pub px: Point2<f64>,
    /// Radius of the circle, px.
    pub radius: f64,
    /// The surface point there in the left camera's frame, m, if it can be measured.
    pub in_left: Option<Point3<f64>>,
    /// Similarity to a tip, 0 to 1; lower while it is only predicted.
    pub score: f64,
}

/// Tracks the fingertips of one hand.
#[derive(Clone, Debug)]
pub struct FingerTipTracking {
    calibration: StereoCalibration,
    settings: FingerTipSettings,
    filter: ParticleFilterFingerTracking,
    rng: ChaCha8Rng,
    skin: Option<[f32; 2]>,
    last: Option<(u64, f64)>,
}

/// After this long without a frame the earlier state is discarded, ns.
const FORGET_NS: u64 = 600_000_000;
/// Largest distance of a candidate from the end of a finger of the silhouette, tip radii.
const AT_A_FINGER: f64 = 2.0;
/// Least probability of a finger whose end is used.
const LIKELY: f64 = 0.3;

impl Default for FingerTipSettings {
    fn default() -> Self {
        Self {
            hough: AdaptiveHoughTransform::default(),
            model: FingerARModel::default(),
            mean_shift: true,
            filter: true,
            particles: 150,
            seed: 1,
        }
    }
}

impl FingerTipTracking {
    /// A tracker without earlier frames.
    pub fn new(calibration: StereoCalibration, settings: FingerTipSettings) -> Self {
        Self {
            calibration,
            settings,
            filter: ParticleFilterFingerTracking::new(settings.model, settings.particles),
            rng: ChaCha8Rng::seed_from_u64(settings.seed),
            skin: None,
            last: None,
        }
    }

    /// Processes a frame; returns the fingertips in order around the palm. Tips that are hidden for a moment are
    /// predicted. Empty when the images do not have the calibration's size.
    pub fn update(&mut self, frame: &StereoFrame) -> Vec<TrackedFingertip> {
        if !self.calibration.fits(frame) {
            return Vec::new();
        }
        if self.last.is_some_and(|(t, _)| frame.stamp_ns < t || frame.stamp_ns - t > FORGET_NS) {
            self.filter.clear();
            (self.skin, self.last) = (None, None);
        }
        match find(frame, frame.depth.as_deref(), &self.calibration, self.skin, true) {
            Some(hand) => self.seen(frame, &hand),
            None => self.unseen(frame),
        }
    }

    fn seen(&mut self, frame: &StereoFrame, hand: &HandCandidate) -> Vec<TrackedFingertip> {
        let camera = self.calibration.camera;
        self.skin = Some(hand.skin);
        let radius = self.settings.hough.radius_px(camera.focal, hand.z);
        self.last = Some((frame.stamp_ns, radius));
        let edges = edge_map(&frame.left, &hand.left);
        let votes = self.settings.hough.votes(&edges, radius);
        let candidates = votes.as_ref().map_or_else(Vec::new, |v| v.candidates(&edges));
        let candidates: Vec<TipCandidate> =
            candidates.into_iter().filter(|c| at_a_finger(c, &hand.shape.fingers, radius)).collect();
        let mut tips = if self.settings.filter {
            let (focal, center, palm) = (camera.focal, camera.center, hand.shape.palm);
            let told = FilterFrame { focal, center, radius, palm, candidates: &candidates };
            self.filter.update(&told, &mut self.rng);
            self.followed(radius)
        } else {
            candidates.iter().map(|c| tip(0, c.center, radius, c.score)).collect()
        };
        let ranging = Ranging::of(frame, &self.calibration, hand);
        for tip in &mut tips {
            if let Some(votes) = votes.as_ref().filter(|_| self.settings.mean_shift) {
                let shifted = votes.mean_shift(&tip.px);
                if (shifted - tip.px).norm() < tip.radius {
                    tip.px = shifted;
                }
            }
            let metres = 0.9 * radius * hand.z / camera.focal;
            tip.in_left = ranging.as_ref().and_then(|r| r.point(&tip.px, &tip.px, metres));
        }
        tips
    }

    /// Without a hand in the frame the motion model predicts the tips.
    fn unseen(&mut self, frame: &StereoFrame) -> Vec<TrackedFingertip> {
        let Some((_, radius)) = self.last.filter(|_| self.settings.filter) else { return Vec::new() };
        if self.filter.predict(&mut self.rng) == 0 {
            self.last = None;
            return Vec::new();
        }
        self.last = Some((frame.stamp_ns, radius));
        self.followed(radius)
    }

    fn followed(&self, radius: f64) -> Vec<TrackedFingertip> {
        let camera = self.calibration.camera;
        let nodes = self.filter.nodes(camera.focal, camera.center);
        nodes.iter().map(|n| tip(n.id, n.px, radius, 1.0 / (1.0 + f64::from(n.unseen)))).collect()
    }
}

fn tip(id: u64, px: Point2<f64>, radius: f64, score: f64) -> TrackedFingertip {
    TrackedFingertip { id, px, radius, in_left: None, score }
}

/// Whether a circle is at the end of a finger of the silhouette and points along it.
fn at_a_finger(candidate: &TipCandidate, fingers: &[Finger], radius: f64) -> bool {
    fingers.iter().filter(|f| f.score > LIKELY).any(|f| {
        let along = f.tip - f.base;
        (f.tip - candidate.center).norm() < AT_A_FINGER * radius && along.dot(&candidate.outward) > 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Gesture;
    use crate::scenes::{CALIBRATION, TABLE, frame, hand, table};

    #[test]
    fn a_pointing_hand_has_one_tip_and_an_open_one_five() {
        for (gesture, n) in
            [(Gesture::PointOne, 1), (Gesture::PointTwo, 2), (Gesture::OpenHand, 5), (Gesture::Fist, 0)]
        {
            let (mut things, direction) = hand(gesture, Point3::new(0.02, -0.02, 0.6), 0.2, true, 0.1);
            things.push(table(TABLE));
            let mut tracking = FingerTipTracking::new(CALIBRATION, FingerTipSettings::default());
            let mut tips = Vec::new();
            for t in 0..3 {
                tips = tracking.update(&frame(&things, t * 33_000_000, t));
            }
            assert_eq!(tips.len(), n, "{gesture}: {tips:?}");
            if gesture == Gesture::PointOne {
                let reach = (tips[0].in_left.unwrap() - Point3::new(0.02, -0.02, 0.6)).dot(&direction);
                assert!((0.07..0.16).contains(&reach), "{reach}");
            }
        }
    }

    #[test]
    fn pictures_of_another_size_show_nothing() {
        let mut calibration = CALIBRATION;
        calibration.camera.width += 1;
        let mut tracking = FingerTipTracking::new(calibration, FingerTipSettings::default());
        assert!(tracking.update(&frame(&[table(TABLE)], 0, 0)).is_empty());
    }
}
