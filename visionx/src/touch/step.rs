//! The detection of a touch as a processing step.

use std::collections::VecDeque;

use armarium_values::{Frame, Observation, ObservedPlace};
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};

use super::patches::{HALF, PatchMotion, difference, find};
use super::picture::Picture;
use super::{OwnHand, TouchedTable};
use crate::annotate;
use crate::camera::PinholeCamera;
use crate::frame::{RgbImage, StereoFrame};
use crate::steps::StereoStep;

/// The core segment of what hands touch.
const TOUCHES: &str = "Touches";
/// How many pictures are kept.
const KEPT: usize = 12;
/// How far the fingers must have moved in the picture between two pictures that are compared, px.
const APART: f64 = 3.0;
/// Patches that would look as like as this after the hand's motion say nothing.
const PLAIN: f64 = 9.0;
/// How far apart patches of one thing may be, and neighbouring points of its surface, m.
const TOGETHER: f64 = 0.10;
const CONNECTED: f64 = 0.012;
/// So many patches of a thing, and such a share of them, must have moved in one picture, or in two that follow each other.
const SURE: (usize, f64) = (16, 0.75);
const LIKELY: (usize, f64) = (8, 0.35);
/// Standard deviation of the place of a touch, m.
const PLACE: f64 = 0.01;

/// Where the own hand was at a time (ns); `None` where that is not known.
type HandAt = Box<dyn Fn(u64) -> Option<OwnHand> + Send>;

/// A patch near the fingers.
#[derive(Clone, Copy, Debug)]
struct Patch {
    /// Where it is in the newest picture if it is still, px.
    px: Point2<f64>,
    /// Root frame, m, as it was in the earlier picture.
    at: Point3<f64>,
    found: PatchMotion,
}

/// Sees that a hand touches something, as `Touches` named after the hand, with its `position`, the name of the `finger` that is nearest,
/// and `by: seen`. Without a touch it observes nothing. It looks at frames with depth only.
pub struct TouchStep {
    camera: PinholeCamera,
    name: String,
    hand_at: HandAt,
    table: TouchedTable,
    kept: VecDeque<Picture>,
    last: Vec<Patch>,
    /// Whether the last picture showed what may be a touch.
    likely: bool,
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
        Self { camera, name, hand_at, table, kept: VecDeque::new(), last: Vec::new(), likely: false }
    }

    /// The patches near the fingers that were still before, and where they are now; empty while the hand has not moved enough.
    fn patches(&self) -> Vec<Patch> {
        let apart = |later: &Picture, earlier: &&Picture| later.fingers_moved_since(earlier) >= APART;
        let mut pictures = self.kept.iter().rev();
        let Some(now) = pictures.next() else { return Vec::new() };
        let Some(then) = pictures.find(|earlier| apart(now, earlier)) else { return Vec::new() };
        let Some(before) = pictures.find(|earlier| apart(then, earlier)) else { return Vec::new() };
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
        let carried = Point2::new(f64::from(x), f64::from(y)) + motion;
        if difference(patch, (&then.left, &carried))? < PLAIN
            || now.hides(&px, HALF)
            || now.hides(&(px + motion), HALF)
        {
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
        let of = |found: PatchMotion| {
            self.last.iter().filter(move |patch| patch.found == found).map(|patch| patch.at)
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
        self.likely = is(LIKELY);
        if !(is(SURE) || before && self.likely) {
            return None;
        }
        let place = self.middle_of(moved)?;
        let (finger, _) = self.kept.back()?.hand.nearest_finger(&place)?;
        let place = ObservedPlace::new(&Frame::root(), &place.coords, &(Matrix3::identity() * PLACE * PLACE));
        let seen = Observation::new(TOUCHES, "touch", stamp_ns).named(&self.name).at(place);
        Some(seen.with("finger", finger.name.as_str()).with("by", "seen"))
    }

    /// The middle of the thing of which these points (root frame) have moved: across the hand's way the middle of all that is seen of it, as
    /// only its edges show how it moves.
    fn middle_of(&self, moved: Vec<Point3<f64>>) -> Option<Point3<f64>> {
        let (first, now) = (self.kept.front()?, self.kept.back()?);
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
        self.last.clear();
        let hand = (self.hand_at)(frame.stamp_ns);
        let Some(picture) = hand.and_then(|hand| Picture::new(frame, &self.camera, hand)) else {
            return Vec::new();
        };
        self.kept.push_back(picture);
        if self.kept.len() > KEPT {
            self.kept.pop_front();
        }
        self.last = self.patches();
        self.touch(frame.stamp_ns).into_iter().collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        for outline in self.kept.back().iter().flat_map(|picture| &picture.own) {
            annotate::polygon(image, outline.corners(), [255, 255, 0]);
        }
        for patch in &self.last {
            let color = match patch.found {
                PatchMotion::Still => [0, 200, 0],
                PatchMotion::Moved => [255, 0, 0],
                PatchMotion::Otherwise => [0, 0, 255],
            };
            annotate::cross(image, &patch.px, 1.0, color);
        }
    }
}
