//! Follows the fingertips of one hand through a sequence of images: a detector finds the hand in each image, and the
//! filter of the tips joins them. It knows no depth and no calibration; [`FingerTipTracking`](super::FingerTipTracking)
//! is for stereo streams.

use nalgebra::Vector2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::{
    ContourNode, FilterFrame, FingerARModel, HandDetector, HandInPicture, ParticleFilterFingerTracking,
    TipCandidate,
};
use crate::RgbImage;
use crate::tracking::hand::Fingertip;

/// Number of particles; analysing an image takes far longer than they do.
const PARTICLES: usize = 300;
/// Radius of a fingertip, palm radii.
const TIP: f64 = 0.2;
/// Default focal length, relative to the longer side of the image.
const USUAL_FOCAL: f64 = 1.2;

/// Tracks the fingertips of one hand through the images of one unknown camera.
pub struct TipFollower {
    detector: Box<dyn HandDetector>,
    filter: ParticleFilterFingerTracking,
    rng: ChaCha8Rng,
    focal: Option<f64>,
    /// Width and height of the last image, px.
    size: Option<(u32, u32)>,
}

/// The detections in one image of a sequence.
pub struct FollowedTips {
    /// The hand, if one is seen.
    pub hand: Option<HandInPicture>,
    /// The tracked tips, px.
    pub nodes: Vec<ContourNode>,
    /// Focal length, px.
    pub focal: f64,
    /// Principal point, px.
    pub center: [f64; 2],
}

impl TipFollower {
    /// With `model` of how tips move, and a focal length, px; without one, a usual one for the size of the images.
    pub fn new(detector: Box<dyn HandDetector>, model: FingerARModel, focal: Option<f64>) -> Self {
        let filter = ParticleFilterFingerTracking::new(model, PARTICLES);
        Self { detector, filter, rng: ChaCha8Rng::seed_from_u64(1), focal, size: None }
    }

    /// Processes the next image. Tracking restarts when the image size changes, because positions would not
    /// correspond. Tips that leave the image are dropped.
    pub fn update(&mut self, image: &RgbImage) -> FollowedTips {
        let size = (image.width(), image.height());
        if self.size.replace(size).is_some_and(|last| last != size) {
            self.filter.clear();
        }
        let (w, h) = (f64::from(image.width()), f64::from(image.height()));
        let focal = self.focal.unwrap_or(USUAL_FOCAL * w.max(h));
        let center = [(w - 1.0) / 2.0, (h - 1.0) / 2.0];
        let hand = self.detector.find(image);
        if let Some(hand) = &hand {
            let radius = TIP * hand.palm_radius;
            let outward = |t: &Fingertip| (t.px - hand.palm).try_normalize(1e-9);
            let candidate = |t: &Fingertip| TipCandidate {
                center: t.px,
                radius,
                outward: outward(t).unwrap_or_else(Vector2::y),
                score: t.score,
            };
            let candidates: Vec<TipCandidate> = hand.fingertips.iter().map(candidate).collect();
            let told = FilterFrame { focal, center, radius, palm: hand.palm, candidates: &candidates };
            self.filter.update(&told, &mut self.rng);
        } else {
            self.filter.predict(&mut self.rng);
        }
        let inside = |n: &ContourNode| (0.0..w).contains(&n.px.x) && (0.0..h).contains(&n.px.y);
        let nodes = self.filter.nodes(focal, center).into_iter().filter(inside).collect();
        FollowedTips { hand, nodes, focal, center }
    }
}
