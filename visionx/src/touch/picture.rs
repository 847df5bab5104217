//! A picture of the hand on its way, with what is known of its time: where camera and hand were, and what rises from the table near the
//! fingers.

use std::sync::Arc;

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};

use super::patches::{HALF, align, smooth};
use super::{OwnHand, OwnPart, TouchedTable};
use crate::camera::PinholeCamera;
use crate::frame::{DepthImage, RgbImage, StereoFrame};
use crate::mask::Region;
use crate::outline::{ConvexOutline, box_outline};

/// Distance of patches, px, and of the pixels by which pictures are aligned.
const GRID: u32 = 4;
/// What rises less from the table, m, may be a shadow on it.
const RAISED: f64 = 0.010;
/// What is farther from all fingers than this, m, has nothing to do with them.
const NEAR: f64 = 0.12;
/// How far from the fingers' middles they reach, m.
const FINGER: f64 = 0.05;
/// What is farther from where the hand holds is not in it, m, nor what is farther aside than its fingers by this.
const IN_HAND: f64 = 0.12;
const ASIDE: f64 = 0.015;
/// What is so much nearer than a point, or farther, is something else, m.
const BEFORE: f64 = 0.02;
/// How far apart the points are of a way of which it is asked whether something is seen behind it, m.
const FREE_STEP: f64 = 0.005;
/// Own parts may be beside where they are known to be by this, px.
const MARGIN: f64 = 3.0;

/// The left picture, smoothed.
pub(super) struct Picture {
    pub(super) left: RgbImage,
    pub(super) hand: OwnHand,
    /// The outlines of the own body.
    pub(super) own: Vec<ConvexOutline>,
    depth: Arc<DepthImage>,
    root_from_left: Isometry3<f64>,
    camera: PinholeCamera,
}

impl Picture {
    /// A frame with depth; `None` without.
    pub(super) fn new(frame: &StereoFrame, camera: &PinholeCamera, hand: OwnHand) -> Option<Self> {
        let depth = Arc::clone(frame.depth.as_ref().filter(|depth| camera.usable(depth).is_some())?);
        let left_from_root = frame.root_from_left.inverse();
        let outline =
            |part: &OwnPart| box_outline(camera, 0.0, &(left_from_root * part.root_from_box), &part.size);
        let own = hand.parts.iter().filter_map(outline).collect();
        let (left, root_from_left) = (smooth(&frame.left), frame.root_from_left);
        Some(Self { left, hand, own, depth, root_from_left, camera: *camera })
    }

    fn px(&self, at: &Point3<f64>) -> Option<Point2<f64>> {
        self.camera.project(&(self.root_from_left.inverse() * at))
    }

    /// How far the fingers have moved since an earlier picture, px of this one.
    pub(super) fn fingers_moved_since(&self, earlier: &Self) -> f64 {
        let middle_of_fingers = |picture: &Self| {
            let fingers = &picture.hand.fingers;
            let sum: Vector3<f64> = fingers.iter().map(|finger| finger.part.middle().coords).sum();
            Point3::from(sum / fingers.len().max(1) as f64)
        };
        let [then, now] = [earlier, self].map(|picture| self.px(&middle_of_fingers(picture)));
        then.zip(now).map_or(0.0, |(then, now)| (now - then).norm())
    }

    /// Whether the own body hides a pixel, or another one within so many of it.
    pub(super) fn hides(&self, px: &Point2<f64>, within: u32) -> bool {
        self.own.iter().any(|outline| outline.signed_distance(px) < MARGIN + f64::from(within))
    }

    /// Every so many pixels around the fingers.
    pub(super) fn around_fingers(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let middles: Vec<Point3<f64>> = self.hand.fingers.iter().map(|finger| finger.part.middle()).collect();
        self.around(&middles)
    }

    /// Every so many pixels around points (root frame).
    pub(super) fn around(&self, points: &[Point3<f64>]) -> impl Iterator<Item = (u32, u32)> + use<> {
        let left_from_root = self.root_from_left.inverse();
        let middles: Vec<Point3<f64>> = points.iter().map(|at| left_from_root * at).collect();
        let nearest = middles.iter().map(|at| at.z).fold(f64::INFINITY, f64::min).max(0.2);
        let PinholeCamera { focal, width, height, .. } = self.camera;
        let px = middles.iter().filter_map(|at| self.camera.project(at));
        let region = Region::around(px, focal * (NEAR + FINGER) / nearest, width, height);
        region.pixels().filter(|(x, y)| x.is_multiple_of(GRID) && y.is_multiple_of(GRID))
    }

    /// The point (root frame) that a pixel shows, or what is in front within so many pixels of it, if it rises from the table near the
    /// fingers and is not hidden by the own body.
    pub(super) fn raised(
        &self,
        (x, y): (u32, u32),
        within: u32,
        table: &TouchedTable,
    ) -> Option<Point3<f64>> {
        let at = self.shown((x, y), within)?;
        let rises = table.normal.dot(&(at - table.at)) >= RAISED;
        self.hand.nearest_finger(&at).filter(|(_, distance)| rises && *distance < NEAR).map(|_| at)
    }

    /// The same of what is in the hand, which holds at a point of its frame.
    pub(super) fn in_hand(
        &self,
        (x, y): (u32, u32),
        within: u32,
        held_in_hand: &Point3<f64>,
    ) -> Option<Point3<f64>> {
        let at = self.shown((x, y), within)?;
        let off = at - self.hand.root_from_hand * held_in_hand;
        let [first, second] =
            [self.hand.fingers.first()?, self.hand.fingers.last()?].map(|f| f.part.middle());
        let across = second - first;
        let aside = off.dot(&across.try_normalize(1e-6).unwrap_or_default()).abs();
        (off.norm() < IN_HAND && aside < across.norm() / 2.0 + ASIDE).then_some(at)
    }

    /// The point (root frame) that a pixel shows, or what is in front within so many pixels of it, if the own body does not hide it.
    fn shown(&self, (x, y): (u32, u32), within: u32) -> Option<Point3<f64>> {
        let px = Point2::new(f64::from(x), f64::from(y));
        let depth = nearest_depth(&self.depth, (x, y), within)?;
        let at = self.root_from_left * Point3::from(self.camera.ray(&px) * depth);
        (!self.hides(&px, within)).then_some(at)
    }

    /// Where in another picture a point of this one (root frame) is that is still, and how the hand's motion would move it there, px.
    pub(super) fn still_and_motion(
        &self,
        at: &Point3<f64>,
        other: &Self,
    ) -> Option<(Point2<f64>, Vector2<f64>)> {
        let still = other.px(at)?;
        let carried = other.hand.root_from_hand * (self.hand.root_from_hand.inverse() * at);
        Some((still, other.px(&carried)? - still))
    }

    /// Whether nothing but a point (root frame) is seen within so many pixels of where it would be: what is in front of it, as somebody
    /// else's hand, says nothing of it.
    pub(super) fn shows(&self, at: &Point3<f64>, px: &Point2<f64>, within: u32) -> bool {
        self.depth_beyond(at, px, within).is_some_and(|beyond| beyond.abs() < BEFORE)
    }

    /// Whether all that is seen within so many pixels of where a point (root frame) would be is behind it, so that nothing is there.
    pub(super) fn is_beyond(&self, at: &Point3<f64>, px: &Point2<f64>, within: u32) -> bool {
        self.depth_beyond(at, px, within).is_some_and(|beyond| beyond > BEFORE)
    }

    /// How much of the straight way between two points (root frame) is seen to be free, m: what is behind it is seen.
    pub(super) fn free_way(&self, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
        let steps = ((to - from).norm() / FREE_STEP).floor().min(1e3) as u32;
        let is_free = |step: &u32| {
            let at = from + (to - from) * (f64::from(*step) / f64::from(steps));
            self.px(&at).is_some_and(|px| !self.hides(&px, 0) && self.is_beyond(&at, &px, 0))
        };
        (1..=steps).filter(is_free).count() as f64 * FREE_STEP
    }

    /// By how much what is in front within so many pixels of a place is farther away than a point (root frame), m.
    fn depth_beyond(&self, at: &Point3<f64>, px: &Point2<f64>, within: u32) -> Option<f64> {
        let expected = (self.root_from_left.inverse() * at).z;
        let [x, y] = [px.x.round(), px.y.round()];
        let inside =
            x >= 0.0 && y >= 0.0 && x < f64::from(self.camera.width) && y < f64::from(self.camera.height);
        let seen = inside.then(|| nearest_depth(&self.depth, (x as u32, y as u32), within)).flatten();
        seen.map(|seen| seen - expected)
    }

    /// By how much the table in another picture is shifted against where the camera's known motion would bring it, px. What rises from the
    /// table may move by itself.
    pub(super) fn shift_of(&self, other: &Self, table: &TouchedTable) -> Vector2<f64> {
        let other_from_this = other.root_from_left.inverse() * self.root_from_left;
        let pair = |(x, y): (u32, u32)| {
            let (x, y) = (x * GRID, y * GRID);
            let px = Point2::new(f64::from(x), f64::from(y));
            let depth = f64::from(self.depth.at(x, y));
            if depth == 0.0 || self.hides(&px, HALF) {
                return None;
            }
            let at = Point3::from(self.camera.ray(&px) * depth);
            if table.normal.dot(&(self.root_from_left * at - table.at)) > RAISED {
                return None;
            }
            let there = self.camera.project(&(other_from_this * at))?;
            (!other.hides(&there, HALF)).then(|| (Point2::new(x as i32, y as i32), there))
        };
        let grid = Region::whole(self.camera.width / GRID, self.camera.height / GRID);
        align(&self.left, &other.left, &grid.pixels().filter_map(pair).collect::<Vec<_>>())
    }

    /// By how much the own hand in another picture is shifted against where its known motion would bring it, px: joints have play, and stamps
    /// are not exact. `held_in_hand` is about its middle, in its frame.
    pub(super) fn hand_shift_of(&self, other: &Self, held_in_hand: &Point3<f64>) -> Vector2<f64> {
        let middle = self.hand.root_from_hand * held_in_hand;
        let pair = |(x, y): (u32, u32)| {
            let depth = f64::from(self.depth.at(x, y));
            let px = Point2::new(f64::from(x), f64::from(y));
            let at = self.root_from_left * Point3::from(self.camera.ray(&px) * depth);
            if depth == 0.0 || (at - middle).norm() > IN_HAND || !self.hides(&px, 0) {
                return None;
            }
            let (still, motion) = self.still_and_motion(&at, other)?;
            Some((Point2::new(x as i32, y as i32), still + motion))
        };
        align(&self.left, &other.left, &self.around(&[middle]).filter_map(pair).collect::<Vec<_>>())
    }
}

/// The smallest depth within so many pixels along both axes: of what is in front, m.
fn nearest_depth(depth: &DepthImage, (x, y): (u32, u32), within: u32) -> Option<f64> {
    let offsets = [0, within, 2 * within];
    let all = offsets.iter().flat_map(|dy| offsets.iter().map(move |dx| (dx, dy)));
    let at =
        |(dx, dy): (&u32, &u32)| Some(depth.at((x + dx).checked_sub(within)?, (y + dy).checked_sub(within)?));
    all.filter_map(at).filter(|z| *z > 0.0).min_by(f32::total_cmp).map(f64::from)
}
