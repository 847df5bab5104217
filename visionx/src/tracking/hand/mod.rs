//! A person's hand in stereo frames: where it is, what gesture it shows, where it points.
//!
//! [`HandObserver`] goes from what stands out of the scenery (`relief`) and from colour (`skin`) to a silhouette of a
//! hand's size at its distance (`candidates`), from there to a palm and stretched fingers (`shape`), to a gesture
//! ([`crate::tracking::GestureRecognizer`]), and to points and directions (`depth`). Without a depth image both eyes take its place.
//! One hand at a time; whose hand it is, it does not know.

use std::fmt;

pub(crate) mod candidates;
pub(crate) mod depth;
mod observer;
mod paths;
mod relief;
pub(crate) mod shape;
mod skin;

use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::mask::Region;

pub use observer::HandObserver;

/// The gestures of coaching.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Gesture {
    /// All fingers closed.
    Fist,
    /// All fingers stretched and spread.
    OpenHand,
    /// The index finger stretched.
    PointOne,
    /// Index and middle finger stretched.
    PointTwo,
}

/// The end of a stretched finger.
#[derive(Clone, Debug, PartialEq)]
pub struct Fingertip {
    /// In the left image, px.
    pub px: Point2<f64>,
    /// In the left camera's frame, m, where both eyes see it.
    pub in_left: Option<Point3<f64>>,
    /// How well it looks like a fingertip, 0 to 1.
    pub score: f64,
}

/// A hand seen in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct HandObservation {
    /// The gesture, smoothed over the last frames.
    pub gesture: Gesture,
    /// How much the gesture is trusted, 0 to 1.
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
    /// Share of the hand's outline at which something nearer begins that may hide a part of it, 0 to 1; 0 where there is
    /// no depth image to tell, 1 where the hand reaches beyond the picture. While a hand is hidden, what was seen of it
    /// before goes on.
    pub hidden: f64,
    /// Around the hand in the left image.
    pub bounding_box: Region,
    /// The frame's stamp, ns.
    pub stamp_ns: u64,
}

impl HandObservation {
    /// The share of [`hidden`](Self::hidden) from which on a part of the hand is taken to be hidden; a sleeve that comes
    /// towards the eyes makes up to 0.15. What is left of a hidden hand tells little of its gesture and of its place.
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

    /// The gesture of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|g| g.name() == name)
    }
}

impl fmt::Display for Gesture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
