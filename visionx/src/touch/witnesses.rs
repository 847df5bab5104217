//! What patches tell together: one alone may be mistaken.

use nalgebra::{Point2, Point3};

use super::patches::PatchMotion;
use crate::annotate;
use crate::frame::RgbImage;

/// How far apart patches of one thing may be, m.
const TOGETHER: f64 = 0.10;
/// So many patches of a thing, and such a share of them, must have moved, at least a little, in one picture, or in two that follow each other.
const SURE: (usize, f64) = (24, 0.75);
const LIKELY: (usize, f64) = (8, 0.35);
/// In the second of two pictures this share of those that moved must have made most of the motion.
const MOSTLY: f64 = 0.25;

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
    /// Takes those of a new picture instead. They have to be sure `at_once` where it is only taken for granted that they had not moved before.
    pub(super) fn see(&mut self, patches: Vec<Patch>, at_once: bool) {
        (self.patches, self.at_once) = (patches, at_once);
        self.likely &= !at_once;
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
        let any: Vec<_> = moved.iter().copied().chain(of(PatchMotion::MovedLittle)).collect();
        let around = |middle: &Point3<f64>, all: &[Point3<f64>]| {
            all.iter().filter(|at| (*at - middle).norm() < TOGETHER).count()
        };
        // The one with the most others around it.
        let before = std::mem::take(&mut self.likely);
        let middle = *any.iter().max_by_key(|at| around(at, &any))?;
        let still = around(&middle, &still);
        let [far, moving] = [&moved, &any].map(|moved| around(&middle, moved));
        let is = |(enough, share): (usize, f64)| {
            moving >= enough && moving as f64 >= share * (moving + still) as f64
        };
        self.likely = is(LIKELY) && !self.at_once;
        let again = before && self.likely && far as f64 >= MOSTLY * moving as f64;
        (is(SURE) || again).then_some(any)
    }

    /// Draws a cross at each: green where it has not moved, red where it has, orange where it has a little, blue where neither is seen.
    pub(super) fn draw(&self, image: &mut RgbImage) {
        for patch in &self.patches {
            let color = match patch.found {
                PatchMotion::Still => [0, 200, 0],
                PatchMotion::Moved => [255, 0, 0],
                PatchMotion::MovedLittle => [255, 140, 0],
                PatchMotion::Otherwise => [0, 0, 255],
            };
            annotate::cross(image, &patch.px, 1.0, color);
        }
    }
}
