//! A hand by its silhouette: regions that stand out by depth or have the colour of skin, and the fingers of their shape.

use nalgebra::{Point2, Vector3};

use super::candidates::{HandCandidate, find};
use super::depth::Ranging;
use super::measured::MeasuredHand;
use super::shape::{Finger, HandShape};
use super::{Fingertip, Gesture, HandObservation};
use crate::camera::StereoCalibration;
use crate::components::largest;
use crate::frame::StereoFrame;
use crate::mask::Region;
use crate::tracking::{GestureRecognizer, SeenFinger};

/// Radius around a place in a finger's end, and around its base, where depth is measured, m.
const TIP_RADIUS: f64 = 0.012;
const BASE_RADIUS: f64 = 0.018;

/// Measures hands by their silhouettes.
#[derive(Clone, Debug)]
pub(crate) struct HandSilhouettes {
    recognizer: GestureRecognizer,
    /// The hand is the nearest object, and may come so near that it hides much of the rest.
    pub(crate) near: bool,
    /// The log-chromaticities of the skin that was seen last.
    skin: Option<[f32; 2]>,
}

impl HandSilhouettes {
    pub(crate) fn new() -> Self {
        Self { recognizer: GestureRecognizer::at_a_slant(), near: false, skin: None }
    }

    /// Forgets what the hand looked like.
    pub(crate) fn forget(&mut self) {
        self.skin = None;
    }

    pub(crate) fn measure(
        &mut self,
        frame: &StereoFrame,
        calibration: &StereoCalibration,
    ) -> Option<MeasuredHand> {
        // A depth camera has no depth along the hand's outline.
        let filled =
            frame.depth.as_ref().filter(|depth| depth.data.contains(&0.0)).map(|depth| depth.filled());
        let depth = filled.as_ref().or(frame.depth.as_deref());
        let hand = find(frame, depth, calibration, self.skin, self.near)?;
        let measured = self.measured(frame, calibration, &hand)?;
        self.skin = Some(hand.skin);
        Some(measured)
    }

    fn measured(
        &self,
        frame: &StereoFrame,
        calibration: &StereoCalibration,
        hand: &HandCandidate,
    ) -> Option<MeasuredHand> {
        let shape = &hand.shape;
        let ranging = Ranging::of(frame, calibration, hand)?;
        // A hand that extends beyond the image counts as hidden.
        let bounds = largest(&hand.left).map_or_else(Region::default, |hand| hand.bounds);
        let cut = !self.near && bounds.touches_border(frame.left.width(), frame.left.height());
        let hidden = if cut { 1.0 } else { hand.hidden };
        let fingers: Vec<Finger> = shape.fingers.iter().map(|f| in_depth(f, &ranging)).collect();
        let stretched: Vec<&Finger> = fingers.iter().filter(|f| f.score > 0.5).collect();
        let points = hidden < HandObservation::HIDDEN && (1..=2).contains(&stretched.len());
        let fingertip = |f: &&Finger| Fingertip {
            px: f.tip,
            in_left: ranging.point(&f.tip, &inside_tip(f), TIP_RADIUS),
            score: f.score,
        };
        Some(MeasuredHand {
            palm: MeasuredHand::under(ranging.palm(&shape.palm))?,
            palm_px: shape.palm,
            palm_radius_px: shape.palm_radius * calibration.camera.focal / hand.z,
            hidden,
            likelihoods: self.likelihoods(shape, &fingers),
            fingertips: stretched.iter().map(fingertip).collect(),
            direction: direction(&ranging, &stretched).filter(|_| points).map(|d| (d, stretched.len())),
            bounds,
        })
    }

    /// The likelihood of each gesture, in the order of [`Gesture::ALL`].
    fn likelihoods(&self, shape: &HandShape, fingers: &[Finger]) -> [f64; 4] {
        let seen: Vec<SeenFinger> = fingers.iter().map(|f| f.seen(shape.palm_radius)).collect();
        let by_name = self.recognizer.likelihoods(&seen);
        Gesture::ALL.map(|g| by_name.get(g.name()).copied().unwrap_or(0.0))
    }
}

/// The mean direction of stretched fingers, unit vector in the left camera's frame.
fn direction(ranging: &Ranging<'_>, fingers: &[&Finger]) -> Option<Vector3<f64>> {
    let mut sum = Vector3::zeros();
    for finger in fingers {
        let tip = ranging.point(&finger.tip, &inside_tip(finger), TIP_RADIUS)?;
        let base = ranging.point(&finger.base, &finger.base, BASE_RADIUS)?;
        sum += (tip - base).try_normalize(1e-6)?;
    }
    sum.try_normalize(1e-6)
}

/// The finger with its true length instead of the length across the line of sight, if the depth image
/// measures it.
fn in_depth(finger: &Finger, ranging: &Ranging<'_>) -> Finger {
    let tip = ranging.measured(&inside_tip(finger), TIP_RADIUS);
    let base = ranging.measured(&finger.base, BASE_RADIUS);
    let rise = tip.zip(base).map_or(0.0, |(tip, base)| tip - base);
    finger.reaching(rise)
}

/// A point slightly inside of a finger's end, px.
fn inside_tip(finger: &Finger) -> Point2<f64> {
    finger.tip + (finger.base - finger.tip) * (0.008 / finger.length.max(0.02))
}
