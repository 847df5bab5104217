//! Tracks fingers in single images and in streams.
//!
//! - [`FingerTipTracking`]: the fingertips in a stream of stereo frames. It is built from [`edge_map`],
//!   [`AdaptiveHoughTransform`], [`ParticleFilterFingerTracking`] and [`FingerARModel`].
//! - [`HandInPicture`]: the hand, its fingertips and its gesture in one image of an unknown camera. A [`HandDetector`] finds it:
//!   [`LearnedHandDetector`] by trained networks, [`SkinHandDetector`] by its colour ([`SkinSegmentation`]). [`TipFollower`] joins
//!   what is seen in a sequence of images.
//! - [`GestureRecognizer`]: recognises gestures by patterns of fingers from a file.

mod ar_model;
mod contour_filter;
mod detector;
mod edges;
mod follower;
pub mod hand;
mod hough;
mod hypotheses;
mod lab;
mod labels;
mod learned;
mod likeness;
mod mixture;
mod photograph;
mod recognizer;
mod refusal;
mod skin;
mod tips;

pub use ar_model::{ArModelError, FingerARModel};
pub use contour_filter::{ContourNode, FilterFrame, ParticleFilterFingerTracking};
pub use detector::{HandDetector, HandInPicture, HandOutline};
pub use edges::{Edge, edge_map};
pub use follower::{FollowedTips, TipFollower};
pub use hough::{AdaptiveHoughTransform, HoughVotes, TipCandidate};
pub use labels::{DetectorScore, HandLabels, LabelError, LabelledHand};
pub use learned::{BodyLandmarks, FingerPosture, HandLandmarks, LearnedBodyDetector, LearnedHandDetector};
pub use photograph::SkinHandDetector;
pub use recognizer::{Expected, GesturePattern, GestureRecognizer, SeenFinger};
pub use skin::SkinSegmentation;
pub use tips::{FingerTipSettings, FingerTipTracking, TrackedFingertip};
