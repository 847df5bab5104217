//! What perception observed at one time, addressed to a core segment of memory. A processor of images gives these, an updater
//! joins them with what is known.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use crate::frame_change::FrameChange;
use crate::{Frame, Value, Vector};

/// Something that was observed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// The core segment that it is about: `ObjectInstances`, `HumanHands`, `EnvironmentModels`, or a new one.
    pub segment: String,
    /// Its class, by which it is told from others in the segment: `sponge`, `hand`, `table`.
    pub class: String,
    /// The time of the observation, ns; for images that of the exposure.
    pub stamp_ns: u64,
    /// Where its centre is; `None` when it was not seen, or has no place.
    pub place: Option<ObservedPlace>,
    /// Confidence, 0 to 1.
    pub confidence: f64,
    /// Other attributes, as the segment's schema names them.
    pub attributes: BTreeMap<String, Value>,
}

/// A position with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObservedPlace {
    /// The position, m.
    pub position: Vector,
    /// Its covariance in the same frame, m², row by row.
    pub covariance: [f64; 9],
}

impl ObservedPlace {
    /// A position in a frame, m, with its covariance, m².
    #[must_use]
    pub fn new(frame: &Frame, position: &Vector3<f64>, covariance: &Matrix3<f64>) -> Self {
        let covariance = std::array::from_fn(|i| covariance[(i / 3, i % 3)]);
        Self { position: Vector::new(frame.clone(), position), covariance }
    }
}

impl Observation {
    /// An observation without a place, of confidence 1.
    #[must_use]
    pub fn new(segment: &str, class: &str, stamp_ns: u64) -> Self {
        let (segment, class) = (segment.into(), class.into());
        Self { segment, class, stamp_ns, place: None, confidence: 1.0, attributes: BTreeMap::new() }
    }

    /// The same at a place.
    #[must_use]
    pub fn at(self, place: ObservedPlace) -> Self {
        Self { place: Some(place), ..self }
    }

    /// The same with a confidence; it is kept within 0 and 1.
    #[must_use]
    pub fn with_confidence(self, confidence: f64) -> Self {
        Self { confidence: confidence.clamp(0.0, 1.0), ..self }
    }

    /// The same with one more attribute.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.attributes.insert(name.into(), value.into());
        self
    }

    /// For people and other programs: the attributes, `class`, `confidence`, and of a place `position` and `frame`.
    pub fn to_json(&self) -> Json {
        let mut said = Value::Map(self.attributes.clone()).to_json();
        (said["class"], said["confidence"]) = (self.class.as_str().into(), self.confidence.into());
        if let Some(ObservedPlace { position, .. }) = &self.place {
            (said["position"], said["frame"]) =
                (position.components.to_vec().into(), position.frame.0.clone().into());
        }
        said
    }

    /// The same with all that is expressed in `from` expressed in `to`; `to_from_from` is the pose of `from` in `to`.
    #[must_use]
    pub fn moved(mut self, from: &Frame, to: &Frame, to_from_from: &Isometry3<f64>) -> Self {
        let change = FrameChange { from, to, to_from_from };
        for (name, value) in &mut self.attributes {
            *value = change.value(name, value);
        }
        if let Some(place) = self.place.as_mut().filter(|place| place.position.frame == *from) {
            let moved = to_from_from * nalgebra::Point3::from(place.position.vector());
            place.position = Vector::new(to.clone(), &moved.coords);
            let rows = change.covariance(&place.covariance);
            place.covariance = rows.try_into().unwrap_or(place.covariance);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;
    use nalgebra::UnitQuaternion;

    use super::*;

    #[test]
    fn a_moved_observation_says_the_same_in_the_other_frame() {
        let (camera, root) = (Frame::from("camera"), Frame::root());
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let root_from_camera = Isometry3::from_parts(Translation3::new(1.0, 2.0, 3.0), turn);
        let spread = Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 9.0));
        let seen = Observation::new("HumanHands", "hand", 5)
            .at(ObservedPlace::new(&camera, &Vector3::new(1.0, 0.0, 0.0), &spread))
            .with("direction", Value::Vector(Vector::new(camera.clone(), &Vector3::x())))
            .with("fingertips", vec![Value::Vector(Vector::new(camera.clone(), &Vector3::x()))])
            .with("elsewhere", Value::Vector(Vector::new(Frame::from("world"), &Vector3::x())));
        let moved = seen.moved(&camera, &root, &root_from_camera);
        let near = |value: &Value, expected: [f64; 3]| {
            let Value::Vector(v) = value else { panic!("{value:?}") };
            assert!((v.vector() - Vector3::from(expected)).norm() < 1e-12, "{v:?}");
            v.frame.clone()
        };
        let place = moved.place.unwrap();
        assert_eq!(near(&Value::Vector(place.position), [1.0, 3.0, 3.0]), root);
        assert!((place.covariance[0] - 1.0).abs() < 1e-12 && (place.covariance[4] - 4.0).abs() < 1e-12);
        assert_eq!(near(&moved.attributes["direction"], [0.0, 1.0, 0.0]), root);
        let Value::List(tips) = &moved.attributes["fingertips"] else { panic!("no list") };
        near(&tips[0], [1.0, 3.0, 3.0]);
        assert_eq!(near(&moved.attributes["elsewhere"], [1.0, 0.0, 0.0]), Frame::from("world"));
    }
}
