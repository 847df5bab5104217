//! Gestures from how far fingers are bent and how far the thumb stands out.

use nalgebra::Point3;

use super::landmarks::HandLandmarks;
use crate::tracking::hand::Gesture;

/// How a hand holds its fingers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerPosture {
    /// How far the thumb's tip is from the nearest joint or tip of another finger (knuckles do not count), relative to the distance from
    /// the wrist to the middle finger's knuckle.
    pub thumb: f64,
    /// How far each other finger is bent, from index to little finger: the sum of the angles at its three joints, degrees.
    pub bends: [f64; 4],
}

/// From this distance on the thumb stands out, and how fast that becomes sure. A straight thumb that lies over a fist is at most 0.42 away
/// from the fingers in the images that were looked at, one that is held up 0.56 at least.
const STANDS_OUT: f64 = 0.5;
const SOFT_DISTANCE: f64 = 0.03;
/// A finger that is bent less than this is stretched, degrees, and how fast that becomes sure. A pointing index finger is often half bent.
/// In photographs straight fingers are bent by at most 103 degrees, folded ones, also those that a thumb holds, by 108 at least, mostly 150.
const STRETCHED: [f64; 4] = [130.0, 105.0, 105.0, 105.0];
const SOFT_BEND: f64 = 6.0;

impl FingerPosture {
    /// How this hand holds its fingers.
    #[must_use]
    pub fn of(hand: &HandLandmarks) -> Self {
        let [[.., thumb], others @ ..] = HandLandmarks::FINGERS;
        let at = &hand.in_hand;
        let joints = others.iter().flat_map(|[_, joints @ ..]| joints);
        let nearest = joints.map(|joint| (at[thumb] - at[*joint]).norm()).fold(f64::INFINITY, f64::min);
        let palm = (at[9] - at[0]).norm().max(1e-6);
        Self { thumb: nearest / palm, bends: hand.chains().map(|chain| bend(&chain)) }
    }

    /// The probability of each finger to be stretched, and of the thumb, which comes first, to stand out.
    #[must_use]
    pub fn stretched(&self) -> [f64; 5] {
        let thumb = probability((self.thumb - STANDS_OUT) / SOFT_DISTANCE);
        let finger = |i: usize| probability((STRETCHED[i] - self.bends[i]) / SOFT_BEND);
        [thumb, finger(0), finger(1), finger(2), finger(3)]
    }

    /// The probability of each gesture, in the order of [`Gesture::ALL`]. What is missing to 1 is that it is none of them, as a
    /// fist whose thumb stands out.
    #[must_use]
    pub fn likelihoods(&self) -> [f64; 4] {
        let [thumb, index, middle, ring, little] = self.stretched();
        let folded = (1.0 - ring) * (1.0 - little);
        Gesture::ALL.map(|gesture| match gesture {
            Gesture::Fist => (1.0 - thumb) * (1.0 - index) * (1.0 - middle) * folded,
            Gesture::OpenHand => index * middle * ring * little,
            Gesture::PointOne => index * (1.0 - middle) * folded,
            Gesture::PointTwo => index * middle * folded,
        })
    }

    /// The gesture and its probability; `None` where it is more likely none of them.
    #[must_use]
    pub fn gesture(&self) -> Option<(Gesture, f64)> {
        let best = Gesture::ALL.into_iter().zip(self.likelihoods()).max_by(|a, b| a.1.total_cmp(&b.1));
        best.filter(|(_, likelihood)| *likelihood > 0.5)
    }
}

fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-log_odds))
}

/// The sum of the angles between the pieces of a chain, degrees.
fn bend(chain: &[Point3<f64>; 5]) -> f64 {
    let pieces: [_; 4] = std::array::from_fn(|i| chain[i + 1] - chain[i]);
    let angle = |i: usize| libm::atan2(pieces[i].cross(&pieces[i + 1]).norm(), pieces[i].dot(&pieces[i + 1]));
    (0..3).map(angle).sum::<f64>().to_degrees()
}
