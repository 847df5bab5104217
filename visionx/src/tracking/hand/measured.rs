//! What one frame alone says of a hand, however it was found.

use nalgebra::{Point2, Point3, Vector3};

use super::Fingertip;
use crate::mask::Region;

/// A hand as it was measured in one frame, left camera's frame.
#[derive(Clone, Debug)]
pub(crate) struct MeasuredHand {
    /// Centre of the palm, m.
    pub(crate) palm: Point3<f64>,
    /// The same in the image, and the radius of the largest circle within the palm, px.
    pub(crate) palm_px: Point2<f64>,
    pub(crate) palm_radius_px: f64,
    /// As [`HandObservation::hidden`](super::HandObservation::hidden).
    pub(crate) hidden: f64,
    /// The likelihood of each gesture in this frame alone, in the order of [`Gesture::ALL`](super::Gesture::ALL).
    pub(crate) likelihoods: [f64; 4],
    /// Stretched fingers, in order around the palm.
    pub(crate) fingertips: Vec<Fingertip>,
    /// The mean direction of one or two stretched fingers of a hand that is seen whole, unit vector, and of how many.
    pub(crate) direction: Option<(Vector3<f64>, usize)>,
    /// Bounding box in the left image.
    pub(crate) bounds: Region,
}

impl MeasuredHand {
    /// Distance from the palm's surface to its centre, m.
    const HALF_PALM: f64 = 0.014;

    /// The palm's centre behind its visible surface.
    pub(crate) fn under(surface: Point3<f64>) -> Option<Point3<f64>> {
        Some(surface + surface.coords.try_normalize(1e-6)? * Self::HALF_PALM)
    }
}
