//! Touching and slipping seen: while a hand approaches a thing, what stood still begins to move as the hand does.
//!
//! A wrist does not feel a thing of 20 to 100 g that it pushes along a table. The left eye sees it: patches of what rises from the
//! table near the fingers, which had been still, are then found where the hand's motion would have brought them, and not where
//! they were. While it lifts a thing that slips, what went with the hand stays behind.
//!
//! - [`OwnHand`]: where the hand is at a time, and the boxes that the own body fills, whose pixels say nothing.
//! - `picture`: a picture with what is known of its time. `patches`: compares small parts of two pictures.
//! - `witnesses`: what patches tell together. `watch`: a hand with its newest pictures.
//! - [`TouchStep`], [`SlipStep`]: the processing steps.
//!
//! It needs depth: only by that is a shadow on the table told from a thing.
//!
//! # Source
//! Schiebener, Vahrenkamp, Asfour, *Visual collision detection for corrective movements during grasping on a humanoid robot* (Humanoids 2014): optical
//! flow that neither the camera's motion nor the hand's explains, clustered in front of the fingers. Here only flow along the hand's own
//! motion is looked for, and the hand's pixels come from its description instead of from a tracked model of it.

mod patches;
mod picture;
mod slip;
mod step;
#[cfg(test)]
mod tests;
mod watch;
mod witnesses;

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::own_part::OwnPart;
pub use slip::SlipStep;
pub use step::TouchStep;

/// A finger with which a hand may touch something.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnFinger {
    /// The name of its link.
    pub name: String,
    /// Where it is.
    pub part: OwnPart,
}

/// The own hand at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnHand {
    /// Its pose in the root frame; what it pushes moves as this does.
    pub root_from_hand: Isometry3<f64>,
    /// Its fingers.
    pub fingers: Vec<OwnFinger>,
    /// All parts of the body that may hide something.
    pub parts: Vec<OwnPart>,
}

/// The surface of a table over which a hand moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchedTable {
    /// A point of it, root frame, m.
    pub at: Point3<f64>,
    /// Its normal, upwards.
    pub normal: Unit<Vector3<f64>>,
}

impl OwnHand {
    /// The finger that is nearest to a point (root frame), and its distance, m.
    pub(crate) fn nearest_finger(&self, point: &Point3<f64>) -> Option<(&OwnFinger, f64)> {
        let distances = self.fingers.iter().map(|finger| (finger, finger.part.distance(point)));
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    }
}
