//! A hand that is watched: its newest pictures, and the witnesses of the last of them. What is looked for there, it does not know.

use std::collections::VecDeque;

use super::OwnHand;
use super::picture::Picture;
use super::witnesses::Witnesses;
use crate::annotate;
use crate::camera::PinholeCamera;
use crate::frame::{RgbImage, StereoFrame};

/// How many pictures are kept.
const KEPT: usize = 12;
/// How far the fingers must have moved in the picture between two pictures that are compared, px.
const APART: f64 = 3.0;

/// Where the own hand was at a time (ns); `None` where that is not known.
type HandAt = Box<dyn Fn(u64) -> Option<OwnHand> + Send>;

/// The own hand before a camera.
pub(super) struct HandWatch {
    camera: PinholeCamera,
    /// The hand's name.
    pub(super) name: String,
    hand_at: HandAt,
    kept: VecDeque<Picture>,
    pub(super) witnesses: Witnesses,
}

impl HandWatch {
    /// The hand of this name, which is where `hand_at` says, in images of this camera.
    pub(super) fn new(
        camera: PinholeCamera,
        name: &str,
        hand_at: impl Fn(u64) -> Option<OwnHand> + Send + 'static,
    ) -> Self {
        let (name, hand_at) = (name.to_owned(), Box::new(hand_at));
        Self { camera, name, hand_at, kept: VecDeque::new(), witnesses: Witnesses::default() }
    }

    /// Takes a new picture; `false` where it shows nothing: it has no depth, or nobody knows where the hand was at its time.
    pub(super) fn take(&mut self, frame: &StereoFrame) -> bool {
        let hand = (self.hand_at)(frame.stamp_ns);
        let Some(picture) = hand.and_then(|hand| Picture::new(frame, &self.camera, hand)) else {
            self.witnesses.see_nothing();
            return false;
        };
        self.kept.push_back(picture);
        if self.kept.len() > KEPT {
            self.kept.pop_front();
        }
        true
    }

    pub(super) fn oldest(&self) -> Option<&Picture> {
        self.kept.front()
    }

    pub(super) fn newest(&self) -> Option<&Picture> {
        self.kept.back()
    }

    /// Three pictures, the newest last, between which the hand has moved enough; where it has only once, without the first.
    pub(super) fn moved(&self) -> Option<(Option<&Picture>, &Picture, &Picture)> {
        let apart = |later: &Picture, earlier: &&Picture| later.fingers_moved_since(earlier) >= APART;
        let mut pictures = self.kept.iter().rev();
        let now = pictures.next()?;
        let then = pictures.find(|earlier| apart(now, earlier))?;
        Some((pictures.find(|earlier| apart(then, earlier)), then, now))
    }

    /// Draws where the own body is, and the witnesses.
    pub(super) fn draw(&self, image: &mut RgbImage) {
        for outline in self.newest().iter().flat_map(|picture| &picture.own) {
            annotate::polygon(image, outline.corners(), [255, 255, 0]);
        }
        self.witnesses.draw(image);
    }
}
