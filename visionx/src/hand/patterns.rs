//! Gestures as labelled patterns of stretched fingers, and how well a hand's fingers match them.

use super::Gesture;
use super::shape::Finger;

/// A configuration of stretched fingers that means a gesture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pattern {
    gesture: Gesture,
    /// Number of stretched fingers.
    fingers: usize,
    /// Angle between the outermost fingers, rad: mean and standard deviation; for two fingers or more.
    span: (f64, f64),
    /// How often the pattern means this gesture, among patterns of the same number of fingers.
    weight: f64,
}

/// The patterns that are known. An open hand is also known by fewer fingers than five, because some lie before others
/// when the hand is seen from the side; two fingers far apart are thumb and another finger of an open hand.
pub(crate) const PATTERNS: [Pattern; 7] = [
    Pattern { gesture: Gesture::Fist, fingers: 0, span: (0.0, 1.0), weight: 1.0 },
    Pattern { gesture: Gesture::PointOne, fingers: 1, span: (0.0, 1.0), weight: 1.0 },
    Pattern { gesture: Gesture::PointTwo, fingers: 2, span: (0.25, 0.3), weight: 1.0 },
    Pattern { gesture: Gesture::OpenHand, fingers: 2, span: (1.2, 0.3), weight: 0.5 },
    Pattern { gesture: Gesture::OpenHand, fingers: 3, span: (0.9, 0.7), weight: 1.0 },
    Pattern { gesture: Gesture::OpenHand, fingers: 4, span: (1.0, 0.7), weight: 1.0 },
    Pattern { gesture: Gesture::OpenHand, fingers: 5, span: (1.2, 0.7), weight: 1.0 },
];

/// The likelihood of each gesture, in the order of [`Gesture::ALL`], given what may be fingers. They sum to at most 1.
pub(crate) fn likelihoods(fingers: &[Finger]) -> [f64; 4] {
    let counts = count_distribution(fingers);
    let span = span(fingers);
    let mut result = [0.0; 4];
    for p in &PATTERNS {
        let count = if p.fingers == 5 { counts[5..].iter().sum() } else { counts[p.fingers] };
        let deviation = if p.fingers >= 2 { (span - p.span.0) / p.span.1 } else { 0.0 };
        result[p.gesture as usize] += p.weight * count * (-0.5 * deviation * deviation).exp();
    }
    result
}

/// The probability of each number of stretched fingers (index; the last is seven), each being one on its own.
fn count_distribution(fingers: &[Finger]) -> [f64; 8] {
    let mut p = [0.0; 8];
    p[0] = 1.0;
    for finger in fingers.iter().take(7) {
        for n in (0..8).rev() {
            p[n] = p[n] * (1.0 - finger.score) + if n > 0 { p[n - 1] * finger.score } else { 0.0 };
        }
    }
    p
}

/// The largest angle between two likely fingers, rad.
fn span(fingers: &[Finger]) -> f64 {
    let likely: Vec<_> = fingers.iter().filter(|f| f.score > 0.5).map(|f| f.tip - f.base).collect();
    let pairs = likely.iter().enumerate().flat_map(|(i, a)| likely[..i].iter().map(move |b| a.angle(b)));
    pairs.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;

    fn finger(angle: f64, score: f64) -> Finger {
        let tip = Point2::new(60.0 * angle.sin(), -60.0 * angle.cos());
        Finger { tip, base: Point2::origin(), length: 0.08, width: 0.018, score }
    }

    fn best(fingers: &[Finger]) -> Gesture {
        let l = likelihoods(fingers);
        Gesture::ALL.into_iter().max_by(|a, b| l[*a as usize].total_cmp(&l[*b as usize])).unwrap()
    }

    #[test]
    fn fingers_make_gestures() {
        assert_eq!(best(&[]), Gesture::Fist);
        assert_eq!(best(&[finger(0.3, 0.1)]), Gesture::Fist);
        assert_eq!(best(&[finger(0.3, 0.9), finger(1.9, 0.1)]), Gesture::PointOne);
        assert_eq!(best(&[finger(0.0, 0.9), finger(0.25, 0.9)]), Gesture::PointTwo);
        assert_eq!(best(&[finger(0.0, 0.9), finger(1.25, 0.9)]), Gesture::OpenHand);
        let open: Vec<_> = [-0.3, -0.1, 0.1, 0.3, 1.0].map(|a| finger(a, 0.9)).to_vec();
        assert_eq!(best(&open), Gesture::OpenHand);
        assert_eq!(best(&open[..3]), Gesture::OpenHand);
    }

    #[test]
    fn count_probabilities_sum_to_one() {
        let fingers: Vec<_> = (1..=5).map(|i| finger(0.1, 0.17 * f64::from(i))).collect();
        assert!((count_distribution(&fingers).iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
}
