//! Gestures from the bends of fingers.

use nalgebra::Point3;

use super::landmarks::HandLandmarks;
use crate::tracking::hand::Gesture;

/// How far each finger is bent: the sum of the angles at its three joints, degrees; thumb, index, middle, ring, little finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerBends(pub [f64; 5]);

/// A finger that is bent less than this is stretched, degrees. A pointing index finger is often half bent. These were chosen before
/// any photograph was looked at: straight fingers are bent by at most 103 degrees, and folded ones by 112 at least, mostly 150.
const STRETCHED: [f64; 5] = [60.0, 130.0, 110.0, 110.0, 110.0];
/// Over this difference from the limit, degrees, a finger becomes e times as likely to be what it seems.
const SOFT: f64 = 6.0;

impl FingerBends {
    /// The bends of a hand's fingers.
    #[must_use]
    pub fn of(hand: &HandLandmarks) -> Self {
        Self(hand.chains().map(|chain| bend(&chain)))
    }

    /// The probability of each finger to be stretched.
    #[must_use]
    pub fn stretched(&self) -> [f64; 5] {
        std::array::from_fn(|i| 1.0 / (1.0 + libm::exp((self.0[i] - STRETCHED[i]) / SOFT)))
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

/// The sum of the angles between the pieces of a chain, degrees.
fn bend(chain: &[Point3<f64>; 5]) -> f64 {
    let pieces: [_; 4] = std::array::from_fn(|i| chain[i + 1] - chain[i]);
    let angle = |i: usize| libm::atan2(pieces[i].cross(&pieces[i + 1]).norm(), pieces[i].dot(&pieces[i + 1]));
    (0..3).map(angle).sum::<f64>().to_degrees()
}
