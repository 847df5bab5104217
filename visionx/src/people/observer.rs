//! Finds and follows the body of one person in stereo frames.

use nalgebra::Isometry3;

use super::follower::BodyFollower;
use super::lifting::{Measured, joints};
use super::own_body::{own_pixels, without};
use super::{BodyJoint, BodyObservation, SeenJoint};
use crate::camera::StereoCalibration;
use crate::frame::{RgbImage, StereoFrame};
use crate::own_part::OwnPart;
use crate::tracking::{BodyLandmarks, LearnedBodyDetector};

/// A shoulder that is less probably visible than this shows no person: networks take a single arm for one.
const LEAST_VISIBLE: f64 = 0.5;
/// How far apart shoulders may be, m.
const SHOULDERS: [f64; 2] = [0.20, 0.60];
/// How thick the flesh around a joint is at least, m.
const FLESH: f64 = 0.03;
/// How many frames that follow each other must show a person before it is believed.
const SURE: u32 = 3;

/// Finds and follows the body of one person.
#[derive(Clone, Debug)]
pub struct BodyObserver {
    calibration: StereoCalibration,
    left: LearnedBodyDetector,
    right: LearnedBodyDetector,
    follower: BodyFollower,
    shown: u32,
    confidence: f64,
    last: Option<BodyLandmarks>,
}

impl BodyObserver {
    /// An observer of the frames of these cameras.
    #[must_use]
    pub fn new(calibration: StereoCalibration) -> Self {
        let detector = LearnedBodyDetector::default();
        let (left, right) = (detector.clone(), detector);
        let follower = BodyFollower::default();
        Self { calibration, left, right, follower, shown: 0, confidence: 0.0, last: None }
    }

    /// The person in a frame, root frame; `own` are the parts of the robot's own body at its time. `None` where nobody is.
    pub fn update(&mut self, frame: &StereoFrame, own: &[OwnPart]) -> Option<BodyObservation> {
        if !self.calibration.fits(frame) {
            return None;
        }
        let seen = self.look(frame, own);
        match seen {
            Some((body, seen)) => {
                self.shown = (self.shown + 1).min(SURE);
                self.confidence = body.presence;
                self.last = Some(body);
                self.follower.update(frame.stamp_ns, seen);
            }
            None => {
                self.shown = if self.follower.is_empty() { 0 } else { self.shown };
                self.last = None;
                self.left.forget();
            }
        }
        // What is followed may move on into the robot, too.
        let joints = beside(own, self.follower.at(frame.stamp_ns));
        let is_known = joints.iter().any(Option::is_some) && self.shown >= SURE;
        is_known.then_some(BodyObservation { joints, confidence: self.confidence })
    }

    /// The landmarks in the left image of the last frame.
    pub(crate) fn landmarks(&self) -> Option<&BodyLandmarks> {
        self.last.as_ref()
    }

    /// The body in one frame: its landmarks in the left image, and its joints in the root frame.
    fn look(
        &mut self,
        frame: &StereoFrame,
        own: &[OwnPart],
    ) -> Option<(BodyLandmarks, [Option<SeenJoint>; 7])> {
        let StereoCalibration { camera, baseline } = self.calibration;
        let left_from_root = frame.root_from_left.inverse();
        let depth = frame.depth.as_deref().and_then(|depth| camera.usable(depth));
        let mask = own_pixels(own, &camera, (&left_from_root, 0.0), depth);
        let body = self.left.find(&without(&frame.left, &mask)).filter(shows_shoulders)?;
        let body = facing(body, &frame.left);
        let seen = match depth {
            Some(depth) => joints(&body, &Measured::Depth(depth, &mask), &self.calibration),
            None => {
                let mask = own_pixels(own, &camera, (&left_from_root, baseline), None);
                let right = self.right.find(&without(&frame.right, &mask)).filter(shows_shoulders)?;
                let right = facing(right, &frame.right);
                joints(&body, &Measured::Eyes(&right), &self.calibration)
            }
        };
        let seen = in_root(seen?, &frame.root_from_left);
        is_person(&seen).then(|| (body, beside(own, seen)))
    }
}

fn shows_shoulders(body: &BodyLandmarks) -> bool {
    [11, 12].into_iter().all(|shoulder| body.visible[shoulder] > LEAST_VISIBLE)
}

/// The body with its right shoulder to the left, if its face is not in the image: without a face networks cannot tell front from
/// back, and people face a robot that they are before.
fn facing(body: BodyLandmarks, image: &RgbImage) -> BodyLandmarks {
    let nose = body.points[0];
    let inside = |at: f64, size: u32| (0.0..f64::from(size)).contains(&at);
    let shows_face = inside(nose.x, image.width()) && inside(nose.y, image.height());
    if shows_face || body.points[12].x <= body.points[11].x { body } else { body.mirrored() }
}

fn in_root(seen: [Option<SeenJoint>; 7], root_from_left: &Isometry3<f64>) -> [Option<SeenJoint>; 7] {
    let turn = root_from_left.rotation.to_rotation_matrix();
    seen.map(|seen| {
        let SeenJoint { at, covariance } = seen?;
        let covariance = turn.matrix() * covariance * turn.matrix().transpose();
        Some(SeenJoint { at: root_from_left * at, covariance: (covariance + covariance.transpose()) / 2.0 })
    })
}

/// The joints that are beside the own body: a person's are neither in it nor nearer to it than their flesh is thick.
fn beside(own: &[OwnPart], seen: [Option<SeenJoint>; 7]) -> [Option<SeenJoint>; 7] {
    let is_beside = |joint: &SeenJoint| own.iter().all(|part| part.distance(&joint.at) > FLESH);
    seen.map(|seen| seen.filter(is_beside))
}

/// Whether joints are those of a person: shoulders as far apart as a person's.
fn is_person(seen: &[Option<SeenJoint>; 7]) -> bool {
    let [right, left] = [BodyJoint::RightShoulder, BodyJoint::LeftShoulder].map(|joint| seen[joint as usize]);
    right.zip(left).is_some_and(|(right, left)| {
        let apart = (right.at - left.at).norm();
        (SHOULDERS[0]..=SHOULDERS[1]).contains(&apart)
    })
}
