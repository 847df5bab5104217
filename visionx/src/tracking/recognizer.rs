//! Recognises gestures by comparing the detected fingers with labelled patterns, which a file may define.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_source::yaml::Node;
use armarium_source::{Finding, Findings, Rule, Source, code, form};
use nalgebra::Vector2;

/// A detected finger.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenFinger {
    /// Direction from the palm to the fingertip; only angles between directions matter.
    pub direction: Vector2<f64>,
    /// Its length, palm radii.
    pub length: f64,
    /// Probability that it is a stretched finger, 0 to 1.
    pub score: f64,
}

form! {
    /// A mean and a standard deviation.
    #[derive(Copy)]
    pub struct Expected: "what is expected", check Self::is_possible {
        /// Mean.
        pub mean: f64;
        /// Standard deviation, positive.
        pub deviation: f64;
    }
}

form! {
    /// A configuration of stretched fingers that means a gesture.
    pub struct GesturePattern: "a pattern of a gesture", check Self::is_possible {
        /// The gesture's name.
        pub name: String, Rule::NAME;
        /// Number of stretched fingers; 5 stands for five and more.
        pub fingers: usize, Rule::number("", 0.0, 5.0);
        /// Angle between the outermost fingers, rad.
        pub span: Option<Expected> = None;
        /// Length of the longest finger, palm radii.
        pub length: Option<Expected> = None;
        /// How often the pattern means this gesture, among patterns of as many fingers.
        pub weight: f64 = 1.0;
    }
}

form! {
    struct PatternFile: "a file of gestures", check Self::is_possible {
        gestures: Vec<GesturePattern>;
    }
}

impl Expected {
    fn is_possible(&self, node: &Node, findings: &mut Findings) {
        if self.deviation <= 0.0 {
            findings.error(code::VALUE, node.place("deviation"), "the deviation must be positive");
        }
    }
}

impl GesturePattern {
    fn is_possible(&self, node: &Node, findings: &mut Findings) {
        if self.weight <= 0.0 {
            findings.error(code::VALUE, node.place("weight"), "the weight must be positive");
        }
    }
}

impl PatternFile {
    fn is_possible(&self, node: &Node, findings: &mut Findings) {
        if self.gestures.is_empty() {
            findings.error(code::VALUE, node.place("gestures"), "there is no gesture");
        }
    }
}

/// Knows gestures by their patterns.
#[derive(Clone, Debug, PartialEq)]
pub struct GestureRecognizer {
    gestures: Vec<GesturePattern>,
}

/// Least likelihood of a gesture that has a pattern.
const MIN_LIKELIHOOD: f64 = 0.02;
/// The built-in patterns.
const BUILT_IN: &str = include_str!("gestures.yaml");
const AT_A_SLANT: &str = include_str!("gestures_at_a_slant.yaml");

impl Default for GestureRecognizer {
    fn default() -> Self {
        Self::shipped(BUILT_IN)
    }
}

impl GestureRecognizer {
    fn shipped(text: &str) -> Self {
        Self::read(Arc::new(Source::new("gestures", text))).expect("the patterns that ship are tested")
    }

    /// A recogniser of hands that are seen from anywhere, whose pointing fingers may look short.
    pub fn at_a_slant() -> Self {
        Self::shipped(AT_A_SLANT)
    }

    /// A recogniser with the patterns of a file.
    ///
    /// # Errors
    /// Everything that is wrong with the file.
    pub fn read(source: Arc<Source>) -> Result<Self, Vec<Finding>> {
        armarium_source::read(source).map(|file: PatternFile| Self { gestures: file.gestures })
    }

    /// The most likely gesture for these possible fingers, and its probability.
    pub fn recognize(&self, fingers: &[SeenFinger]) -> (String, f64) {
        let likelihoods = self.likelihoods(fingers);
        let sum: f64 = likelihoods.values().map(|l| l + MIN_LIKELIHOOD).sum();
        let best = likelihoods.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
        best.map_or_else(|| (String::new(), 0.0), |(name, l)| (name, (l + MIN_LIKELIHOOD) / sum))
    }

    /// The likelihood of each gesture by name; they sum to about 1 at most.
    pub fn likelihoods(&self, fingers: &[SeenFinger]) -> BTreeMap<String, f64> {
        let counts = count_distribution(fingers);
        let likely = || fingers.iter().filter(|f| f.score > 0.5);
        let longest = likely().map(|f| f.length).fold(0.0, f64::max);
        let span = likely()
            .enumerate()
            .flat_map(|(i, a)| likely().take(i).map(|b| a.direction.angle(&b.direction)))
            .fold(0.0, f64::max);
        let fit = |value: f64, expected: Option<Expected>| {
            expected.map_or(1.0, |e| libm::exp(-0.5 * ((value - e.mean) / e.deviation).powi(2)))
        };
        let mut result = BTreeMap::new();
        for p in &self.gestures {
            let count = if p.fingers == 5 { counts[5..].iter().sum() } else { counts[p.fingers] };
            let span = if p.fingers >= 2 { fit(span, p.span) } else { 1.0 };
            let length = if p.fingers >= 1 { fit(longest, p.length) } else { 1.0 };
            *result.entry(p.name.clone()).or_insert(0.0) += p.weight * count * span * length;
        }
        result
    }
}

/// The probability of each number of stretched fingers (index; the last is seven); the fingers are
/// independent.
fn count_distribution(fingers: &[SeenFinger]) -> [f64; 8] {
    let mut p = [0.0; 8];
    p[0] = 1.0;
    for finger in fingers.iter().take(7) {
        let score = finger.score.clamp(0.0, 1.0);
        for n in (0..8).rev() {
            p[n] = p[n] * (1.0 - score) + if n > 0 { p[n - 1] * score } else { 0.0 };
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<GestureRecognizer, Vec<Finding>> {
        GestureRecognizer::read(Arc::new(Source::new("gestures.yaml", text)))
    }

    fn seen(angle: f64, score: f64) -> SeenFinger {
        SeenFinger { direction: Vector2::new(libm::sin(angle), -libm::cos(angle)), length: 2.0, score }
    }

    fn best(angles: &[f64], length: f64, score: f64) -> String {
        let fingers: Vec<SeenFinger> =
            angles.iter().map(|a| SeenFinger { length, ..seen(*a, score) }).collect();
        GestureRecognizer::default().recognize(&fingers).0
    }

    #[test]
    fn the_patterns_that_ship_know_the_gestures_of_coaching() {
        assert_eq!(best(&[], 0.0, 0.0), "fist");
        assert_eq!(best(&[0.3], 1.5, 0.1), "fist");
        assert_eq!(best(&[0.3], 1.5, 0.9), "point_one");
        assert_eq!(best(&[0.0, 0.25], 1.5, 0.9), "point_two");
        assert_eq!(best(&[0.0, 1.25], 1.5, 0.9), "open_hand");
        assert_eq!(best(&[-0.3, -0.1, 0.1], 1.5, 0.9), "open_hand");
        assert_eq!(best(&[-0.3, -0.1, 0.1, 0.3, 1.0], 1.5, 0.9), "open_hand");
    }

    #[test]
    fn a_short_finger_points_where_hands_are_seen_from_anywhere() {
        let short = [SeenFinger { length: 0.5, ..seen(0.3, 0.95) }];
        assert_eq!(GestureRecognizer::at_a_slant().recognize(&short).0, "point_one");
        assert_eq!(GestureRecognizer::at_a_slant().recognize(&[]).0, "fist");
    }

    #[test]
    fn a_thumb_along_a_fist_does_not_point() {
        assert_eq!(best(&[0.4], 0.5, 0.95), "fist");
        assert_eq!(best(&[0.0, 0.3], 0.4, 0.95), "fist");
        assert_eq!(best(&[0.4], 0.9, 0.95), "point_one");
    }

    #[test]
    fn likelihoods_of_any_fingers_sum_to_no_more_than_one() {
        for n in 0..7 {
            let fingers: Vec<_> = (1..=n).map(|i| seen(0.1, 0.15 * f64::from(i))).collect();
            let sum: f64 = count_distribution(&fingers).iter().sum();
            assert!((sum - 1.0).abs() < 1e-12);
            let sum: f64 = GestureRecognizer::default().likelihoods(&fingers).values().sum();
            assert!(sum <= 1.0 + 1e-12, "{n}: {sum}");
        }
    }

    #[test]
    fn a_file_can_teach_another_gesture() {
        let taught = read(
            "gestures:\n  - {name: stop, fingers: 5}\n  - {name: hook, fingers: 1, length: {mean: 1.0, deviation: 0.3}}\n  \
             - {name: point, fingers: 1, length: {mean: 2.2, deviation: 0.4}}\n",
        )
        .unwrap();
        assert_eq!(taught.recognize(&[seen(0.0, 0.95)]).0, "point");
        assert_eq!(taught.recognize(&[SeenFinger { length: 1.1, ..seen(0.0, 0.95) }]).0, "hook");
        assert_eq!(taught.recognize(&[-0.4, -0.2, 0.0, 0.2, 0.9].map(|a| seen(a, 0.9))).0, "stop");
        assert!(taught.recognize(&[]).1 < 0.5);
    }

    #[test]
    fn what_is_no_pattern_is_refused() {
        for text in [
            "",
            "gestures: []",
            "gestures:\n  - {name: a, fingers: 6}",
            "gestures:\n  - {name: a, fingers: 1, weight: -1}",
            "gestures:\n  - {name: a, fingers: 2, span: {mean: 0, deviation: 0}}",
            "gestures:\n  - {name: a, fingers: 2, colour: red}",
            "a: [",
        ] {
            assert!(read(text).is_err(), "{text}");
        }
    }
}
