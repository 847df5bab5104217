//! A person's hand in stereo frames: its position, its gesture, its pointing direction.
//!
//! [`HandObserver`] finds one hand at a time and does not know whose, in one of two ways, and joins what each frame says over time:
//!
//! - By its silhouette (`silhouette`): regions that stand out by depth (`relief`) and colour (`skin`) are combined to a silhouette of a
//!   hand's size at its distance (`candidates`), in which the palm and stretched fingers are found (`shape`), the gesture
//!   ([`crate::tracking::GestureRecognizer`]), and points and directions (`depth`). Without a depth image it uses stereo.
//! - By the landmarks of trained networks (`by_landmarks`, [`crate::tracking::LearnedHandDetector`]).
//!
//! [`GestureOverTime`] follows what the hand shows from frame to frame.

use std::fmt;

mod by_landmarks;
pub(crate) mod candidates;
pub(crate) mod depth;
mod measured;
mod observer;
mod paths;
mod relief;
pub(crate) mod shape;
mod shown;
mod silhouette;
mod skin;

use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::mask::Region;

pub use observer::{HandDetection, HandObserver};
pub use shown::{GestureOverTime, ShownGesture};

/// The gestures used for coaching.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Gesture {
    /// All fingers closed: the path is pulled towards the hand.
    #[default]
    Fist,
    /// All fingers stretched and spread: the coach is coming to take the robot by the hand.
    OpenHand,
    /// The index finger stretched: the whole motion moves along it.
    PointOne,
    /// Index and middle finger stretched: the path is pushed away from the hand.
    PointTwo,
}
armarium_source::choice!(Gesture {
    "fist" => Self::Fist, "point_one" => Self::PointOne, "point_two" => Self::PointTwo, "open_hand" => Self::OpenHand,
});

/// The end of a stretched finger.
#[derive(Clone, Debug, PartialEq)]
pub struct Fingertip {
    /// In the left image, px.
    pub px: Point2<f64>,
    /// In the left camera's frame, m, if both cameras see it.
    pub in_left: Option<Point3<f64>>,
    /// How well it fits a fingertip, 0 to 1.
    pub score: f64,
}

/// A hand in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct HandObservation {
    /// The gesture, smoothed over the last frames.
    pub gesture: Gesture,
    /// Confidence of the gesture, 0 to 1.
    pub confidence: f64,
    /// Centre of the palm in the left camera's frame, m.
    pub palm_in_left: Point3<f64>,
    /// Centre of the palm in the left image, px.
    pub palm_px: Point2<f64>,
    /// Radius of the largest circle within the palm in the left image, px.
    pub palm_radius_px: f64,
    /// Direction of the stretched fingers of a pointing hand, unit vector in the left camera's frame.
    pub pointing: Option<Vector3<f64>>,
    /// Stretched fingers, in order around the palm.
    pub fingertips: Vec<Fingertip>,
    /// Share of the hand's outline where something nearer begins that may hide a part of it, 0 to 1; 0 without a depth
    /// image, 1 where the hand extends beyond the image. While a hand is hidden, its earlier state is kept.
    pub hidden: f64,
    /// Bounding box of the hand in the left image.
    pub bounding_box: Region,
}

impl HandObservation {
    /// From this share of [`hidden`](Self::hidden) on, a part of the hand counts as hidden. A sleeve directed towards
    /// the cameras gives up to 0.15. The rest of a hidden hand says little about its gesture and position.
    pub const HIDDEN: f64 = 0.16;
}

impl Gesture {
    /// All gestures, in order.
    pub const ALL: [Self; 4] = [Self::Fist, Self::OpenHand, Self::PointOne, Self::PointTwo];

    /// Its name in files: `fist`, `open_hand`, `point_one`, `point_two`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fist => "fist",
            Self::OpenHand => "open_hand",
            Self::PointOne => "point_one",
            Self::PointTwo => "point_two",
        }
    }
}

impl fmt::Display for Gesture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
