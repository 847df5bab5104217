//! The detection of a touch as a processing step.

use armarium_values::{Frame, Observation, ObservedPlace};
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};

use super::patches::{ANY_PART, HALF, PatchMotion, find, is_plain};
use super::picture::Picture;
use super::watch::HandWatch;
use super::witnesses::Patch;
use super::{OwnHand, TouchedTable};
use crate::camera::PinholeCamera;
use crate::frame::{RgbImage, StereoFrame};
use crate::steps::StereoStep;

/// The core segment of what hands touch.
const TOUCHES: &str = "Touches";
/// How far apart neighbouring points of a thing's surface may be, m.
const CONNECTED: f64 = 0.012;
/// Nothing is touched where so much of the way to it is seen to be free, m.
const FREE: f64 = 0.02;
/// Standard deviation of the place of a touch, m.
const PLACE: f64 = 0.01;

/// Sees that a hand touches something, as `Touches` named after the hand, with its `position`, the name of the `finger` that is nearest,
/// and `by: seen`. Without a touch it observes nothing. It looks at frames with depth only.
pub struct TouchStep {
    watch: HandWatch,
    table: TouchedTable,
}

impl TouchStep {
    /// The step for images of this camera and the hand of this name, which is where `hand_at` says, over a table.
    pub fn new(
        camera: PinholeCamera,
        name: &str,
        table: TouchedTable,
        hand_at: impl Fn(u64) -> Option<OwnHand> + Send + 'static,
    ) -> Self {
        Self { watch: HandWatch::new(camera, name, hand_at), table }
    }

    /// The patches near the fingers that were still before, and where they are now; empty while the hand has not moved enough.
    fn patches(&self) -> Vec<Patch> {
        let Some((Some(before), then, now)) = self.watch.moved() else { return Vec::new() };
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
        if before.hides(&was, HALF)
            || find(patch, &before.left, (&was, &moved), &ANY_PART)? != PatchMotion::Still
        {
            return None;
        }
        let found = match find(patch, &now.left, (&px, &motion), &ANY_PART)? {
            PatchMotion::Moved | PatchMotion::MovedLittle if !now.shows(&at, &(px + motion), HALF) => {
                PatchMotion::Otherwise
            }
            found => found,
        };
        Some(Patch { px, at, found })
    }

    /// The touch that the patches show.
    fn touch(&mut self, stamp_ns: u64) -> Option<Observation> {
        let moved = self.watch.witnesses.agree()?;
        let mean = moved.iter().fold(Vector3::zeros(), |sum, at| sum + at.coords) / moved.len() as f64;
        let now = self.watch.newest()?;
        let thing = self.thing_of(now, moved);
        if !may_touch(now, &thing) {
            return None;
        }
        let place = self.middle_of(&thing, mean)?;
        let (finger, _) = now.hand.nearest_finger(&place)?;
        let place = ObservedPlace::new(&Frame::root(), &place.coords, &(Matrix3::identity() * PLACE * PLACE));
        let seen = Observation::new(TOUCHES, "touch", stamp_ns).named(&self.watch.name).at(place);
        Some(seen.with("finger", finger.name.as_str()).with("by", "seen"))
    }

    /// All that is seen now of the thing of which these points have moved; root frame, m.
    fn thing_of(&self, now: &Picture, moved: Vec<Point3<f64>>) -> Vec<Point3<f64>> {
        let mut others: Vec<_> =
            now.around_fingers().filter_map(|px| now.raised(px, 0, &self.table)).collect();
        let (mut thing, mut next) = (moved, 0);
        while let Some(at) = thing.get(next).copied() {
            let (near, far): (Vec<_>, _) =
                others.into_iter().partition(|other: &Point3<f64>| (other - at).norm() < CONNECTED);
            thing.extend(near);
            (others, next) = (far, next + 1);
        }
        thing
    }

    /// The middle of a thing of which these points are seen, and of which those that have moved have this mean (root frame): across the hand's
    /// way the middle of all that is seen of it, as only its edges show how it moves.
    fn middle_of(&self, thing: &[Point3<f64>], moved: Vector3<f64>) -> Option<Point3<f64>> {
        let (first, now) = (self.watch.oldest()?, self.watch.newest()?);
        let [from, to] = [first, now].map(|kept| kept.hand.root_from_hand.translation.vector);
        let across = self.table.normal.cross(&(to - from)).try_normalize(1e-6)?;
        let places = thing.iter().map(|at| across.dot(&at.coords));
        let [low, high] = [f64::min, f64::max].map(|most| places.clone().reduce(most));
        Some(Point3::from(moved + across * ((low? + high?) / 2.0 - across.dot(&moved))))
    }
}

/// Whether a finger may touch a thing of which these points (root frame, m) are seen: not where nothing is seen to be between them.
fn may_touch(now: &Picture, thing: &[Point3<f64>]) -> bool {
    now.hand.fingers.iter().any(|finger| {
        let ways = thing.iter().map(|at| (*at, finger.part.nearest(at)));
        let shortest = ways.min_by(|a, b| (a.1 - a.0).norm().total_cmp(&(b.1 - b.0).norm()));
        shortest.is_some_and(|(at, there)| now.free_way(&at, &there) < FREE)
    })
}

impl StereoStep for TouchStep {
    fn name(&self) -> &str {
        "touch"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        if !self.watch.take(frame) {
            return Vec::new();
        }
        let patches = self.patches();
        self.watch.witnesses.see(patches, false);
        self.touch(frame.stamp_ns).into_iter().collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        self.watch.draw(image);
    }
}
