//! The detection of a touch as a processing step.

use armarium_values::{Frame, Observation, ObservedPlace};
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};

use super::patches::{HALF, PatchMotion, find, is_plain};
use super::picture::{Picture, Pictures};
use super::witnesses::{Patch, Witnesses};
use super::{HandAt, OwnHand, TouchedTable};
use crate::camera::PinholeCamera;
use crate::frame::{RgbImage, StereoFrame};
use crate::steps::StereoStep;

/// The core segment of what hands touch.
const TOUCHES: &str = "Touches";
/// How far apart neighbouring points of a thing's surface may be, m.
const CONNECTED: f64 = 0.012;
/// Standard deviation of the place of a touch, m.
const PLACE: f64 = 0.01;

/// Sees that a hand touches something, as `Touches` named after the hand, with its `position`, the name of the `finger` that is nearest,
/// and `by: seen`. Without a touch it observes nothing. It looks at frames with depth only.
pub struct TouchStep {
    camera: PinholeCamera,
    name: String,
    hand_at: HandAt,
    table: TouchedTable,
    kept: Pictures,
    witnesses: Witnesses,
}

impl TouchStep {
    /// The step for images of this camera and the hand of this name, which is where `hand_at` says, over a table.
    pub fn new(
        camera: PinholeCamera,
        name: &str,
        table: TouchedTable,
        hand_at: impl Fn(u64) -> Option<OwnHand> + Send + 'static,
    ) -> Self {
        let (name, hand_at) = (name.to_owned(), Box::new(hand_at));
        Self { camera, name, hand_at, table, kept: Pictures::default(), witnesses: Witnesses::default() }
    }

    /// The patches near the fingers that were still before, and where they are now; empty while the hand has not moved enough.
    fn patches(&self) -> Vec<Patch> {
        let Some([before, then, now]) = self.kept.compared() else { return Vec::new() };
        let shifts = [before, now].map(|other| then.shift_of(other, &self.table));
        then.around_fingers().filter_map(|px| self.patch([before, then, now], &shifts, px)).collect()
    }

    /// The patch about a pixel of the second picture; `None` where it says nothing, or was not still before.
    fn patch(
        &self,
        [before, then, now]: [&Picture; 3],
        [shift_before, shift_now]: &[Vector2<f64>; 2],
        (x, y): (u32, u32),
    ) -> Option<Patch> {
        let at = then.raised((x, y), HALF, &self.table)?;
        let patch = (&then.left, Point2::new(x as i32, y as i32));
        let (still, motion) = then.still_and_motion(&at, now)?;
        let px = still + shift_now;
        if is_plain(patch, &motion)? || now.hides(&px, HALF) || now.hides(&(px + motion), HALF) {
            return None;
        }
        let (was, moved) = then.still_and_motion(&at, before)?;
        let was = was + shift_before;
        if before.hides(&was, HALF) || find(patch, &before.left, (&was, &moved))? != PatchMotion::Still {
            return None;
        }
        let found = match find(patch, &now.left, (&px, &motion))? {
            PatchMotion::Moved if !now.shows(&at, &(px + motion), HALF) => PatchMotion::Otherwise,
            found => found,
        };
        Some(Patch { px, at, found })
    }

    /// The touch that the patches show.
    fn touch(&mut self, stamp_ns: u64) -> Option<Observation> {
        let moved = self.witnesses.agree()?;
        let place = self.middle_of(moved)?;
        let (finger, _) = self.kept.newest()?.hand.nearest_finger(&place)?;
        let place = ObservedPlace::new(&Frame::root(), &place.coords, &(Matrix3::identity() * PLACE * PLACE));
        let seen = Observation::new(TOUCHES, "touch", stamp_ns).named(&self.name).at(place);
        Some(seen.with("finger", finger.name.as_str()).with("by", "seen"))
    }

    /// The middle of the thing of which these points (root frame) have moved: across the hand's way the middle of all that is seen of it, as
    /// only its edges show how it moves.
    fn middle_of(&self, moved: Vec<Point3<f64>>) -> Option<Point3<f64>> {
        let (first, now) = (self.kept.oldest()?, self.kept.newest()?);
        let [from, to] = [first, now].map(|kept| kept.hand.root_from_hand.translation.vector);
        let across = self.table.normal.cross(&(to - from)).try_normalize(1e-6)?;
        let mean = moved.iter().fold(Vector3::zeros(), |sum, at| sum + at.coords) / moved.len().max(1) as f64;
        let mut others: Vec<_> =
            now.around_fingers().filter_map(|px| now.raised(px, 0, &self.table)).collect();
        let (mut thing, mut next) = (moved, 0);
        while let Some(at) = thing.get(next).copied() {
            let (near, far): (Vec<_>, _) =
                others.into_iter().partition(|other: &Point3<f64>| (other - at).norm() < CONNECTED);
            thing.extend(near);
            (others, next) = (far, next + 1);
        }
        let places = thing.iter().map(|at| across.dot(&at.coords));
        let [low, high] = [f64::min, f64::max].map(|most| places.clone().reduce(most));
        Some(Point3::from(mean + across * ((low? + high?) / 2.0 - across.dot(&mean))))
    }
}

impl StereoStep for TouchStep {
    fn name(&self) -> &str {
        "touch"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        let hand = (self.hand_at)(frame.stamp_ns);
        let Some(picture) = hand.and_then(|hand| Picture::new(frame, &self.camera, hand)) else {
            self.witnesses.see_nothing();
            return Vec::new();
        };
        self.kept.push(picture);
        self.witnesses.see(self.patches());
        self.touch(frame.stamp_ns).into_iter().collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        self.kept.draw(image);
        self.witnesses.draw(image);
    }
}
