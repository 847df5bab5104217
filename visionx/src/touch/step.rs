//! The detection of a touch as a processing step.

use std::collections::VecDeque;
use std::sync::Arc;

use armarium_values::{Frame, Observation, ObservedPlace};
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector2, Vector3};

use super::patches::{Found, HALF, align, difference, find, smooth};
use super::{OwnHand, OwnPart};
use crate::annotate;
use crate::camera::PinholeCamera;
use crate::frame::{DepthImage, RgbImage, StereoFrame};
use crate::mask::Region;
use crate::outline::{ConvexOutline, box_outline};
use crate::steps::StereoStep;

/// The core segment of what hands touch.
const TOUCHES: &str = "Touches";
/// How many pictures are kept.
const KEPT: usize = 12;
/// How far the fingers must have moved in the picture between two pictures that are compared, px.
const APART: f64 = 3.0;
/// Distance of patches, px.
const GRID: usize = 4;
/// Distance of the pixels by which pictures are aligned.
const ALIGNED: u32 = 4;
/// What rises less from the table, m, may be a shadow on it.
const RAISED: f64 = 0.010;
/// Patches farther from all fingers than this, m, have nothing to do with them.
const NEAR: f64 = 0.12;
/// Own parts may be beside where they are known to be by this, px.
const MARGIN: f64 = 3.0;
/// Patches that would look as like as this after the hand's motion say nothing.
const PLAIN: f64 = 9.0;
/// How far apart patches of one thing may be, m.
const TOGETHER: f64 = 0.05;
/// So many patches of a thing, and such a share of them, must have moved.
const ENOUGH: usize = 6;
const SHARE: f64 = 0.5;
/// Standard deviation of the place of a touch, m.
const PLACE: f64 = 0.01;

/// Where the own hand was at a time (ns); `None` where that is not known.
type HandAt = Box<dyn Fn(u64) -> Option<OwnHand> + Send>;

/// A picture, with what is known of its time.
struct Kept {
    left: RgbImage,
    depth: Arc<DepthImage>,
    root_from_left: Isometry3<f64>,
    hand: OwnHand,
    /// The outlines of the own body.
    own: Vec<ConvexOutline>,
}

/// A patch near the fingers.
#[derive(Clone, Copy, Debug)]
struct Patch {
    /// Where it is in the newest picture if it is still, px.
    px: Point2<f64>,
    /// Root frame, m, as it was in the earlier picture.
    at: Point3<f64>,
    found: Found,
}

/// Sees that a hand touches something, as `Touches` named after the hand, with its `position`, the name of the `finger` that is nearest,
/// and `by: seen`. Without a touch it observes nothing.
pub struct TouchStep {
    camera: PinholeCamera,
    name: String,
    hand_at: HandAt,
    /// A point of the table's surface and its normal, root frame.
    table: (Point3<f64>, Vector3<f64>),
    kept: VecDeque<Kept>,
    last: Vec<Patch>,
}

impl TouchStep {
    /// The step for images of this camera and the hand of this name, which is where `hand_at` says, over a table: a point of it and
    /// its normal, root frame.
    pub fn new(
        camera: PinholeCamera,
        name: &str,
        table: (Point3<f64>, Vector3<f64>),
        hand_at: impl Fn(u64) -> Option<OwnHand> + Send + 'static,
    ) -> Self {
        let (name, hand_at) = (name.to_owned(), Box::new(hand_at));
        Self { camera, name, hand_at, table, kept: VecDeque::new(), last: Vec::new() }
    }

    /// The patches near the fingers that were still before, and where they are now; empty while the hand has not moved enough.
    fn patches(&self) -> Vec<Patch> {
        let Some((now, earlier)) = self.kept.iter().next_back().zip(self.kept.len().checked_sub(1)) else {
            return Vec::new();
        };
        let apart = |a: &Kept, b: &Kept| self.fingers_moved(a, b) >= APART;
        let Some(then) = (0..earlier).rev().find(|&i| apart(&self.kept[i], now)) else { return Vec::new() };
        let before = (0..then).rev().find(|&i| apart(&self.kept[i], &self.kept[then]));
        let Some(before) = before.map(|i| &self.kept[i]) else { return Vec::new() };
        self.compare(before, &self.kept[then], now)
    }

    /// How far the fingers have moved between two pictures, in the second one, px.
    fn fingers_moved(&self, then: &Kept, now: &Kept) -> f64 {
        let middle = |kept: &Kept| {
            let sum = kept.hand.fingers.iter().map(|finger| finger.part.root_from_box.translation.vector);
            Point3::from(sum.sum::<Vector3<f64>>() / kept.hand.fingers.len().max(1) as f64)
        };
        let px = |point: Point3<f64>| self.camera.project(&(now.root_from_left.inverse() * point));
        px(middle(then)).zip(px(middle(now))).map_or(0.0, |(a, b)| (a - b).norm())
    }

    /// `then` is compared with `now`; what was still between `before` and `then` counts.
    fn compare(&self, before: &Kept, then: &Kept, now: &Kept) -> Vec<Patch> {
        let fingers = then.hand.fingers.iter().filter_map(|finger| self.middle_px(then, &finger.part));
        let focal = self.camera.focal;
        let depth =
            then.hand.fingers.iter().map(|finger| {
                (then.root_from_left.inverse() * finger.part.root_from_box).translation.vector.z
            });
        let reach = focal * (NEAR + 0.05) / depth.fold(f64::INFINITY, f64::min).max(0.2);
        let region = Region::around(fingers, reach, self.camera.width, self.camera.height);
        let shifts = [before, now].map(|other| self.shift(then, other));
        let grid = region
            .pixels()
            .filter(|(x, y)| (*x as usize).is_multiple_of(GRID) && (*y as usize).is_multiple_of(GRID));
        grid.filter_map(|(x, y)| self.patch([before, then, now], &shifts, (x, y))).collect()
    }

    /// By how much another picture is shifted against where the camera's known motion would bring it, px.
    fn shift(&self, then: &Kept, other: &Kept) -> Vector2<f64> {
        let left_from_left = other.root_from_left.inverse() * then.root_from_left;
        let pair = |(x, y): (u32, u32)| {
            let (x, y) = (x * ALIGNED, y * ALIGNED);
            let px = Point2::new(f64::from(x), f64::from(y));
            let depth = f64::from(then.depth.at(x, y));
            if depth == 0.0 || then.hides(&px) {
                return None;
            }
            let there =
                self.camera.project(&(left_from_left * Point3::from(self.camera.ray(&px) * depth)))?;
            (!other.hides(&there)).then(|| (Point2::new(x as i32, y as i32), there))
        };
        let grid = Region::whole(self.camera.width / ALIGNED, self.camera.height / ALIGNED);
        let pairs: Vec<_> = grid.pixels().filter_map(pair).collect();
        align(&then.left, &other.left, &pairs)
    }

    fn middle_px(&self, kept: &Kept, part: &OwnPart) -> Option<Point2<f64>> {
        self.camera
            .project(&(kept.root_from_left.inverse() * Point3::from(part.root_from_box.translation.vector)))
    }

    /// The patch about a pixel of the second picture; `None` where it says nothing.
    fn patch(
        &self,
        [before, then, now]: [&Kept; 3],
        [shift_before, shift_now]: &[Vector2<f64>; 2],
        (x, y): (u32, u32),
    ) -> Option<Patch> {
        let px = Point2::new(f64::from(x), f64::from(y));
        if then.hides(&px) {
            return None;
        }
        let at =
            then.root_from_left * Point3::from(self.camera.ray(&px) * nearest_depth(&then.depth, (x, y))?);
        let (on_table, normal) = &self.table;
        if normal.dot(&(at - on_table)) < RAISED {
            return None;
        }
        then.hand.nearest_finger(&at).filter(|(_, distance)| *distance < NEAR)?;
        let patch = (&then.left, Point2::new(x as i32, y as i32));
        let (still, motion) = self.still_and_motion(then, now, &at)?;
        let still = still + shift_now;
        if difference(patch, (&then.left, &(px + motion)))? < PLAIN {
            return None;
        }
        let (was, moved) = self.still_and_motion(then, before, &at)?;
        let was = was + shift_before;
        let was_still = !before.hides(&was) && find(patch, &before.left, (&was, &moved))? == Found::Still;
        if !was_still || now.hides(&still) || now.hides(&(still + motion)) {
            return None;
        }
        let found = find(patch, &now.left, (&still, &motion))?;
        Some(Patch { px: still, at, found })
    }

    /// Where in another picture something is that is still, and how the hand's motion would move it, px.
    fn still_and_motion(
        &self,
        then: &Kept,
        other: &Kept,
        at: &Point3<f64>,
    ) -> Option<(Point2<f64>, Vector2<f64>)> {
        let left_from_root = other.root_from_left.inverse();
        let still = self.camera.project(&(left_from_root * at))?;
        let carried = other.hand.root_from_hand * (then.hand.root_from_hand.inverse() * at);
        Some((still, self.camera.project(&(left_from_root * carried))? - still))
    }

    /// The touch that the patches show.
    fn touch(&self, stamp_ns: u64) -> Option<Observation> {
        let hand = &self.kept.back()?.hand;
        let moved = self.last.iter().filter(|patch| patch.found == Found::Moved);
        // The one with the most others around it.
        let around = |middle: &Point3<f64>, found: Found| {
            self.last.iter().filter(|p| p.found == found && (p.at - middle).norm() < TOGETHER).count()
        };
        let middle = moved.max_by_key(|patch| around(&patch.at, Found::Moved))?.at;
        let (moving, still) = (around(&middle, Found::Moved), around(&middle, Found::Still));
        if moving < ENOUGH || (moving as f64) < SHARE * (moving + still) as f64 {
            return None;
        }
        let near =
            self.last.iter().filter(|p| p.found == Found::Moved && (p.at - middle).norm() < 2.0 * TOGETHER);
        let (sum, count) = near.fold((Vector3::zeros(), 0.0), |(sum, n), p| (sum + p.at.coords, n + 1.0));
        let place = sum / count;
        let (finger, _) = hand.nearest_finger(&place.into())?;
        let place = ObservedPlace::new(&Frame::root(), &place, &(Matrix3::identity() * PLACE * PLACE));
        let seen = Observation::new(TOUCHES, "touch", stamp_ns).named(&self.name).at(place);
        Some(seen.with("finger", finger.name.as_str()).with("by", "seen"))
    }
}

impl Kept {
    /// Whether the own body hides a part of the patch about a pixel.
    fn hides(&self, px: &Point2<f64>) -> bool {
        self.own.iter().any(|outline| outline.signed_distance(px) < MARGIN + f64::from(HALF))
    }
}

/// The smallest depth in a patch: of what is in front, m.
fn nearest_depth(depth: &DepthImage, (x, y): (u32, u32)) -> Option<f64> {
    let half = HALF as u32;
    let offsets = [0, half, 2 * half];
    let all = offsets.iter().flat_map(|dy| offsets.iter().map(move |dx| (dx, dy)));
    let depths =
        all.filter_map(|(dx, dy)| Some(depth.at((x + dx).checked_sub(half)?, (y + dy).checked_sub(half)?)));
    depths.filter(|z| *z > 0.0).min_by(f32::total_cmp).map(f64::from)
}

impl StereoStep for TouchStep {
    fn name(&self) -> &str {
        "touch"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        self.last.clear();
        let depth = frame.depth.as_ref().filter(|depth| self.camera.usable(depth).is_some());
        let Some((depth, hand)) = depth.zip((self.hand_at)(frame.stamp_ns)) else { return Vec::new() };
        let left_from_root = frame.root_from_left.inverse();
        let outline = |part: &OwnPart| {
            box_outline(&self.camera, 0.0, &(left_from_root * part.root_from_box), &part.size)
        };
        let own = hand.parts.iter().filter_map(outline).collect();
        let (left, depth, root_from_left) = (smooth(&frame.left), Arc::clone(depth), frame.root_from_left);
        self.kept.push_back(Kept { left, depth, root_from_left, hand, own });
        if self.kept.len() > KEPT {
            self.kept.pop_front();
        }
        self.last = self.patches();
        self.touch(frame.stamp_ns).into_iter().collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        for outline in self.kept.back().iter().flat_map(|kept| &kept.own) {
            annotate::polygon(image, outline.corners(), [255, 255, 0]);
        }
        for patch in &self.last {
            let color = match patch.found {
                Found::Still => [0, 200, 0],
                Found::Moved => [255, 0, 0],
                Found::Otherwise => [0, 0, 255],
            };
            annotate::cross(image, &patch.px, 1.0, color);
        }
    }
}
