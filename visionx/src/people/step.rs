//! The person before the robot as a processing step.

use std::collections::BTreeMap;

use armarium_values::{Frame, Observation, ObservedPlace, Value, Vector};

use super::{BodyJoint, BodyObservation, BodyObserver, SeenJoint};
use crate::annotate;
use crate::frame::{RgbImage, StereoFrame};
use crate::own_part::OwnPart;
use crate::steps::StereoStep;

/// The core segment of people's bodies, and what they are.
const PEOPLE: &str = "HumanPoses";
const PERSON: &str = "person";

/// Where the parts of the own body were at a time (ns).
type OwnAt = Box<dyn Fn(u64) -> Vec<OwnPart> + Send>;

/// A person's body as `HumanPoses/.../person`: its place is the middle of the shoulders, `keypoints` are the joints by name, and
/// `covariances` nine numbers of each. Where nobody is, it says so with the confidence 0.
pub struct PeopleStep {
    observer: BodyObserver,
    own: OwnAt,
    last: Option<BodyObservation>,
}

impl PeopleStep {
    /// The step around an observer; `own` says where the parts of the robot's own body were at a time (ns).
    pub fn new(observer: BodyObserver, own: impl Fn(u64) -> Vec<OwnPart> + Send + 'static) -> Self {
        Self { observer, own: Box::new(own), last: None }
    }
}

impl StereoStep for PeopleStep {
    fn name(&self) -> &str {
        "people"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        let own = (self.own)(frame.stamp_ns);
        self.last = self.observer.update(frame, &own);
        let observation = Observation::new(PEOPLE, PERSON, frame.stamp_ns).named(PERSON);
        vec![match &self.last {
            Some(body) => said(observation, body),
            None => observation.with_confidence(0.0),
        }]
    }

    fn draw(&self, image: &mut RgbImage) {
        self.observer.landmarks().iter().for_each(|body| annotate::body(image, body));
    }
}

fn said(observation: Observation, body: &BodyObservation) -> Observation {
    let known = || BodyJoint::ALL.into_iter().filter_map(|joint| Some((joint, body.joint(joint)?)));
    let place = |seen: &SeenJoint| Value::Vector(Vector::new(Frame::root(), &seen.at.coords));
    let rows = |seen: &SeenJoint| Value::from(seen.covariance.transpose().as_slice().to_vec());
    let named = |value: &dyn Fn(&SeenJoint) -> Value| -> BTreeMap<String, Value> {
        known().map(|(joint, seen)| (joint.name().to_owned(), value(seen))).collect()
    };
    let said = observation
        .with_confidence(body.confidence)
        .with("keypoints", Value::Map(named(&place)))
        .with("covariances", Value::Map(named(&rows)));
    let shoulders = [BodyJoint::RightShoulder, BodyJoint::LeftShoulder].map(|joint| body.joint(joint));
    let [Some(right), Some(left)] = shoulders else { return said };
    let middle = nalgebra::center(&right.at, &left.at);
    let covariance = (right.covariance + left.covariance) / 4.0;
    said.at(ObservedPlace::new(&Frame::root(), &middle.coords, &covariance))
}
