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
    /// The name of the entity that it is of, from an observer who follows its entities himself; otherwise whoever remembers it finds
    /// out. One of no confidence says that the entity is no longer there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub entity: Option<String>,
    /// The time of the observation, ns; for images that of the exposure.
    pub stamp_ns: u64,
    /// Where its centre is; `None` when it was not seen, or has no place.
    pub place: Option<ObservedPlace>,
    /// Confidence, 0 to 1.
    pub confidence: f64,
    /// Other attributes, as the segment's schema names them.
    pub attributes: BTreeMap<String, Value>,
}

/// Why something is no observation.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an observation needs {0}")]
pub struct NotAnObservation(String);

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
        Self {
            segment,
            class,
            entity: None,
            stamp_ns,
            place: None,
            confidence: 1.0,
            attributes: BTreeMap::new(),
        }
    }

    /// The same of the entity with this name.
    #[must_use]
    pub fn named(self, entity: &str) -> Self {
        Self { entity: Some(entity.into()), ..self }
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
        if let Some(entity) = &self.entity {
            said["entity"] = entity.as_str().into();
        }
        if let Some(ObservedPlace { position, .. }) = &self.place {
            (said["position"], said["frame"]) =
                (position.components.to_vec().into(), position.frame.0.clone().into());
        }
        said
    }

    /// What other programs say: `segment`, `class`, `stamp_ns`, `confidence` (1 unless it is said), `entity` if its observer follows it, of a place `position` (m) with its
    /// `frame` and `covariance` (nine numbers, m²), and all else as attributes.
    ///
    /// # Errors
    /// What is missing or not of its kind, for people.
    pub fn from_json(json: &Json) -> Result<Self, NotAnObservation> {
        let Json::Object(fields) = json else {
            return Err(NotAnObservation("a map of names and values".into()));
        };
        let wanted = |name: &str, what: &str| NotAnObservation(format!("`{name}`: {what}"));
        let text = |name: &str| {
            let said = fields.get(name).and_then(Json::as_str).filter(|said| !said.is_empty());
            said.ok_or_else(|| wanted(name, "a word"))
        };
        let numbers = |name: &str, count: usize| {
            let said = fields.get(name).and_then(Json::as_array).filter(|said| said.len() == count);
            let said: Option<Vec<f64>> = said.and_then(|said| said.iter().map(Json::as_f64).collect());
            said.ok_or_else(|| wanted(name, &format!("{count} numbers")))
        };
        let stamp_ns = fields.get("stamp_ns").and_then(Json::as_u64);
        let stamp_ns = stamp_ns.ok_or_else(|| wanted("stamp_ns", "a time, ns"))?;
        let mut seen = Self::new(text("segment")?, text("class")?, stamp_ns);
        if fields.contains_key("entity") {
            seen = seen.named(text("entity")?);
        }
        if let Some(confidence) = fields.get("confidence") {
            seen = seen.with_confidence(
                confidence.as_f64().ok_or_else(|| wanted("confidence", "a number, 0 to 1"))?,
            );
        }
        if fields.contains_key("position") {
            let frame = Frame(text("frame")?.to_owned());
            let covariance = Matrix3::from_row_slice(&numbers("covariance", 9)?);
            let position = numbers("position", 3)?;
            seen = seen.at(ObservedPlace::new(&frame, &Vector3::from_column_slice(&position), &covariance));
        }
        let own = ["segment", "class", "entity", "stamp_ns", "confidence", "position", "frame", "covariance"];
        for (name, value) in fields.iter().filter(|(name, _)| !own.contains(&name.as_str())) {
            seen = seen.with(name, Value::from_json(value));
        }
        Ok(seen)
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
    fn other_programs_say_observations_as_json() {
        let said = serde_json::json!({
            "segment": "ObjectInstances", "class": "cup", "stamp_ns": 7, "confidence": 0.5, "full": true,
            "position": [1, 2, 3], "frame": "root", "covariance": [4, 0, 0, 0, 1, 0, 0, 0, 9],
        });
        let seen = Observation::from_json(&said).unwrap();
        let spread = Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 9.0));
        let place = ObservedPlace::new(&Frame::root(), &Vector3::new(1.0, 2.0, 3.0), &spread);
        let same =
            Observation::new("ObjectInstances", "cup", 7).with_confidence(0.5).at(place).with("full", true);
        assert_eq!(seen, same);
        let without = |name: &str, value: Json| {
            let mut said = said.clone();
            said[name] = value;
            Observation::from_json(&said).unwrap_err().to_string()
        };
        assert_eq!(without("class", Json::Null), "an observation needs `class`: a word");
        assert_eq!(without("stamp_ns", (-1).into()), "an observation needs `stamp_ns`: a time, ns");
        assert_eq!(without("position", "here".into()), "an observation needs `position`: 3 numbers");
        assert_eq!(without("covariance", Json::Null), "an observation needs `covariance`: 9 numbers");
        assert_eq!(
            Observation::from_json(&Json::Null).unwrap_err().to_string(),
            "an observation needs a map of names and values"
        );
    }

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
