//! Hands found by networks that were trained on photographs: [`LearnedHandDetector`].
//!
//! One network finds palms in the whole image (`palms`), another one 21 landmarks in the turned square around a palm
//! (`landmarks`), and how the fingers are held is the gesture (`fingers`). Colour does not matter to the gesture. The networks are
//! those of MediaPipe (`visionx/models/NOTICE.md`); the pipeline around them follows it, except that shrinking averages pixels.
//!
//! # Source
//! Zhang et al. 2020, "MediaPipe Hands: On-device Real-time Hand Tracking".

mod body;
mod candidates;
mod fingers;
mod landmarks;
mod palms;
mod square;

use std::sync::LazyLock;

use nalgebra::{Point2, Vector2};

use super::detector::{HandDetector, HandInPicture, HandOutline};
use super::recognizer::{GestureRecognizer, SeenFinger};
use crate::frame::RgbImage;
use crate::network::Network;
use crate::tracking::hand::Fingertip;
pub use body::{BodyLandmarks, LearnedBodyDetector};
pub use fingers::FingerPosture;
pub use landmarks::HandLandmarks;
use square::Square;

static PALMS: LazyLock<Network> = LazyLock::new(|| {
    shipped(include_bytes!("../../../models/palm_detection_full.tflite"), &candidates::OUTPUTS)
});
static LANDMARKS: LazyLock<Network> = LazyLock::new(|| {
    shipped(include_bytes!("../../../models/hand_landmark_full.tflite"), &landmarks::OUTPUTS)
});

fn shipped(file: &[u8], outputs: &[&str]) -> Network {
    Network::read(file, outputs).expect("the models that ship are tested")
}

/// The sizes of the square in which the network sees an image, relative to the smallest around it. A hand that fills an image is
/// found when it is shown smaller.
const SCALES: [f64; 3] = [1.0, 2.0, 3.0];
/// Most palms of an image that are looked at.
const PALMS_TRIED: usize = 3;

/// Finds a hand by its palm and its landmarks.
#[derive(Clone, Debug)]
pub struct LearnedHandDetector {
    palms: Network,
    landmarks: Network,
    patterns: Option<GestureRecognizer>,
    follows: bool,
    /// Where the hand is expected in the next image, and the size of the last one, px.
    expected: Option<(Square, [u32; 2])>,
}

impl LearnedHandDetector {
    /// A detector for images that have nothing to do with each other.
    #[must_use]
    pub fn of_images() -> Self {
        let (palms, landmarks) = (PALMS.clone(), LANDMARKS.clone());
        Self { palms, landmarks, patterns: None, follows: false, expected: None }
    }

    /// A detector for the images of one camera: where a hand was, it is looked for first, and palms are only searched for when it is
    /// not there.
    #[must_use]
    pub fn of_sequence() -> Self {
        Self { follows: true, ..Self::of_images() }
    }

    /// The same with gestures by patterns of stretched fingers instead of the built-in ones.
    #[must_use]
    pub fn with_patterns(self, patterns: GestureRecognizer) -> Self {
        Self { patterns: Some(patterns), ..self }
    }

    /// The landmarks of the hand in an image, `None` where there is none.
    pub fn landmarks(&mut self, image: &RgbImage) -> Option<HandLandmarks> {
        let size = [image.width(), image.height()];
        let expected = self.expected.take().filter(|(_, last)| *last == size);
        let followed =
            expected.and_then(|(square, _)| landmarks::in_square(&mut self.landmarks, image, &square));
        let hand = followed.or_else(|| self.search(image))?;
        if self.follows {
            self.expected = hand.square().map(|square| (square, size));
        }
        Some(hand)
    }

    /// Forgets where the hand was, so that it is searched for in the next image.
    pub(crate) fn forget(&mut self) {
        self.expected = None;
    }

    fn search(&mut self, image: &RgbImage) -> Option<HandLandmarks> {
        // In a sequence the hand may come later; a single image is searched thoroughly.
        let scales = if self.follows { &SCALES[..1] } else { &SCALES[..] };
        let hand = scales.iter().find_map(|scale| {
            let palms: Vec<palms::Palm> = palms::PALMS.find(&mut self.palms, image, *scale);
            let mut squares = palms.iter().take(PALMS_TRIED).filter_map(palms::square);
            squares.find_map(|square| landmarks::in_square(&mut self.landmarks, image, &square))
        })?;
        // A square around the landmarks fits the hand better than one around its palm.
        let again =
            hand.square().and_then(|square| landmarks::in_square(&mut self.landmarks, image, &square));
        Some(again.unwrap_or(hand))
    }
}

impl HandDetector for LearnedHandDetector {
    fn find(&mut self, image: &RgbImage) -> Option<HandInPicture> {
        let hand = self.landmarks(image)?;
        let posture = FingerPosture::of(&hand);
        let (palm, palm_radius) = hand.palm();
        let fingers: Vec<(SeenFinger, Point2<f64>)> = posture
            .stretched()
            .into_iter()
            .zip(HandLandmarks::FINGERS)
            .map(|(score, finger)| {
                let tip = hand.fingertip(finger);
                let along: Vector2<f64> = tip - hand.points[finger[0]];
                let direction = along.try_normalize(1e-9).unwrap_or_else(Vector2::y);
                (SeenFinger { direction, length: along.norm() / palm_radius, score }, tip)
            })
            .collect();
        let tip = |(finger, px): &(SeenFinger, Point2<f64>)| Fingertip {
            px: *px,
            in_left: None,
            score: finger.score,
        };
        let fingertips = fingers.iter().filter(|(finger, _)| finger.score > 0.5).map(tip).collect();
        let fingers: Vec<SeenFinger> = fingers.into_iter().map(|(finger, _)| finger).collect();
        let (gesture, sure) = match &self.patterns {
            Some(patterns) => {
                let (name, sure) = patterns.recognize(&fingers);
                (Some(name).filter(|name| !name.is_empty()), sure)
            }
            None => match posture.gesture() {
                Some((gesture, sure)) => (Some(gesture.name().to_owned()), sure),
                None => (None, 1.0),
            },
        };
        Some(HandInPicture {
            bounding_box: hand.bounds(palm_radius, image),
            palm,
            palm_radius,
            fingertips,
            fingers,
            gesture,
            confidence: hand.presence * sure,
            outline: HandOutline::Landmarks(Box::new(hand)),
        })
    }
}

#[cfg(test)]
mod tests;
