//! The detection of a slip as a processing step: the same as that of a touch, with hand and world exchanged. What went with the hand before,
//! and now stays behind, or is not there any more, slips.

use armarium_values::{Frame, Observation, ObservedPlace};
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};

use super::patches::{HALF, MOST, PatchMotion, find, is_plain};
use super::picture::Picture;
use super::watch::HandWatch;
use super::witnesses::Patch;
use super::{OwnHand, TouchedTable};
use crate::camera::PinholeCamera;
use crate::frame::{RgbImage, StereoFrame};
use crate::steps::StereoStep;

/// The core segment of what slips in hands.
const SLIPS: &str = "Slips";
/// Standard deviation of the place of a slip, m.
const PLACE: f64 = 0.02;
/// What is farther than this from all fingers is not held, m.
const AT_FINGERS: f64 = 0.04;

/// Sees that what a hand holds slips while the hand moves, as `Slips` named after the hand, with its `position`, and `by: seen`. Where nothing
/// slips it observes nothing. It looks at frames with depth only.
pub struct SlipStep {
    watch: HandWatch,
    /// Where the hand holds, in the hand's frame, m.
    held_in_hand: Point3<f64>,
    table: Option<TouchedTable>,
}

impl SlipStep {
    /// The step for images of this camera and the hand of this name, which is where `hand_at` says, and holds something at a point of
    /// its frame. What is seen of a table tells how the camera moves, as for a touch; without one it is where the joints say. How the hand
    /// itself moves, its own pixels tell.
    pub fn new(
        camera: PinholeCamera,
        name: &str,
        held_in_hand: Point3<f64>,
        table: Option<TouchedTable>,
        hand_at: impl Fn(u64) -> Option<OwnHand> + Send + 'static,
    ) -> Self {
        Self { watch: HandWatch::new(camera, name, hand_at), held_in_hand, table }
    }

    /// The patches in the hand that went with it before, and where they are now; empty while the hand has not moved enough. When it sets out,
    /// what rises from the table between its fingers is taken to be held; whether that is so comes with them.
    fn patches(&self) -> (Vec<Patch>, bool) {
        let Some((before, then, now)) = self.watch.moved() else { return (Vec::new(), true) };
        let around = then.around(&[then.hand.root_from_hand * self.held_in_hand]);
        let shift = |other| self.table.map_or_else(Vector2::zeros, |table| then.shift_of(other, &table));
        let with_shifts = |other| {
            let hand = then.hand_shift_of(other, &self.held_in_hand);
            Compared { picture: other, world: shift(other), hand }
        };
        let (before, now) = (before.map(with_shifts), with_shifts(now));
        let patches = around.filter_map(|px| self.patch(before.as_ref(), then, &now, px)).collect();
        (patches, before.is_none())
    }

    /// The patch about a pixel of the second picture; `None` where it says nothing, or did not go with the hand before.
    fn patch(
        &self,
        before: Option<&Compared<'_>>,
        then: &Picture,
        now: &Compared<'_>,
        (x, y): (u32, u32),
    ) -> Option<Patch> {
        let at = then.in_hand((x, y), HALF, &self.held_in_hand)?;
        let patch = (&then.left, Point2::new(x as i32, y as i32));
        let (px, behind) = now.held_and_behind(then, &at)?;
        if is_plain(patch, &behind)?
            || now.picture.hides(&px, HALF)
            || now.picture.hides(&(px + behind), HALF)
        {
            return None;
        }
        match before {
            Some(before) => {
                let (was, back) = before.held_and_behind(then, &at)?;
                let found = find(patch, &before.picture.left, (&was, &back), &MOST)?;
                if before.picture.hides(&was, HALF) || found != PatchMotion::Still {
                    return None;
                }
            }
            None => {
                then.raised((x, y), HALF, &self.table?)?;
            }
        }
        let held = now.picture.hand.root_from_hand * (then.hand.root_from_hand.inverse() * at);
        let found = match find(patch, &now.picture.left, (&px, &behind), &MOST)? {
            PatchMotion::Moved if !now.picture.shows(&at, &(px + behind), HALF) => PatchMotion::Otherwise,
            PatchMotion::Otherwise if now.picture.is_beyond(&held, &px, HALF) => PatchMotion::Moved,
            found => found,
        };
        Some(Patch { px, at, found })
    }

    fn slip(&mut self, stamp_ns: u64) -> Option<Observation> {
        let moved = self.watch.witnesses.agree()?;
        let (_, then, _) = self.watch.moved()?;
        let distance = |at| then.hand.nearest_finger(at).map(|(_, distance)| distance);
        if !moved.iter().filter_map(distance).any(|distance| distance < AT_FINGERS) {
            return None;
        }
        let middle = moved.iter().fold(Vector3::zeros(), |sum, at| sum + at.coords) / moved.len() as f64;
        let place = ObservedPlace::new(&Frame::root(), &middle, &(Matrix3::identity() * PLACE * PLACE));
        let slip = Observation::new(SLIPS, "slip", stamp_ns).named(&self.watch.name).at(place);
        Some(slip.with("by", "seen"))
    }
}

/// A picture that is compared with an earlier one, and by how much what is still and what goes with the hand are shifted in it against where
/// the joints say, px.
struct Compared<'p> {
    picture: &'p Picture,
    world: Vector2<f64>,
    hand: Vector2<f64>,
}

impl Compared<'_> {
    /// Where in this picture a point of another one (root frame) is if it goes with the hand, and from there to where it is if it stays behind, px.
    fn held_and_behind(&self, then: &Picture, at: &Point3<f64>) -> Option<(Point2<f64>, Vector2<f64>)> {
        let (still, motion) = then.still_and_motion(at, self.picture)?;
        let held = still + motion + self.hand;
        Some((held, still + self.world - held))
    }
}

impl StereoStep for SlipStep {
    fn name(&self) -> &str {
        "slip"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        if !self.watch.take(frame) {
            return Vec::new();
        }
        let (patches, sets_out) = self.patches();
        self.watch.witnesses.see(patches, sets_out);
        self.slip(frame.stamp_ns).into_iter().collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        self.watch.draw(image);
    }
}
