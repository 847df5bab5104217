//! What patches tell together: one alone may be mistaken.

use nalgebra::{Point2, Point3};

use super::patches::PatchMotion;
use crate::annotate;
use crate::frame::RgbImage;

/// How far apart patches of one thing may be, m.
const TOGETHER: f64 = 0.10;
/// So many patches of a thing, and such a share of them, must have moved in one picture, or in two that follow each other.
const SURE: (usize, f64) = (16, 0.75);
const LIKELY: (usize, f64) = (8, 0.35);

/// A patch of a thing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// Where it is in the newest picture if it has not moved, px.
    pub(super) px: Point2<f64>,
    /// Root frame, m, as it was in the earlier picture.
    pub(super) at: Point3<f64>,
    pub(super) found: PatchMotion,
}

/// The patches of the newest picture that had not moved before.
#[derive(Debug, Default)]
pub(super) struct Witnesses {
    patches: Vec<Patch>,
    /// Whether they have to be sure at once.
    at_once: bool,
    /// Whether the last picture made it likely.
    likely: bool,
}

impl Witnesses {
    /// Takes those of a new picture instead.
    pub(super) fn see(&mut self, patches: Vec<Patch>) {
        (self.patches, self.at_once) = (patches, false);
    }

    /// The same of those of which it is only taken for granted that they had not moved before: they have to be sure at once.
    pub(super) fn see_at_first(&mut self, patches: Vec<Patch>) {
        (self.patches, self.at_once, self.likely) = (patches, true, false);
    }

    /// Forgets them, and what was likely, where a picture shows nothing.
    pub(super) fn see_nothing(&mut self) {
        *self = Self::default();
    }

    /// Where what has moved was (root frame, m), if enough of them agree that a thing has; to be asked once a picture.
    pub(super) fn agree(&mut self) -> Option<Vec<Point3<f64>>> {
        let of = |found: PatchMotion| {
            self.patches.iter().filter(move |patch| patch.found == found).map(|patch| patch.at)
        };
        let (moved, still): (Vec<_>, Vec<_>) =
            (of(PatchMotion::Moved).collect(), of(PatchMotion::Still).collect());
        let around = |middle: &Point3<f64>, all: &[Point3<f64>]| {
            all.iter().filter(|at| (*at - middle).norm() < TOGETHER).count()
        };
        // The one with the most others around it.
        let before = std::mem::take(&mut self.likely);
        let middle = *moved.iter().max_by_key(|at| around(at, &moved))?;
        let (moving, still) = (around(&middle, &moved), around(&middle, &still));
        let is = |(enough, share): (usize, f64)| {
            moving >= enough && moving as f64 >= share * (moving + still) as f64
        };
        self.likely = is(LIKELY) && !self.at_once;
        (is(SURE) || before && self.likely).then_some(moved)
    }

    /// Draws a cross at each: green where it has not moved, red where it has, blue where neither is seen.
    pub(super) fn draw(&self, image: &mut RgbImage) {
        for patch in &self.patches {
            let color = match patch.found {
                PatchMotion::Still => [0, 200, 0],
                PatchMotion::Moved => [255, 0, 0],
                PatchMotion::Otherwise => [0, 0, 255],
            };
            annotate::cross(image, &patch.px, 1.0, color);
        }
    }
}
