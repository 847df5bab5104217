//! Prior knowledge: what is known of kinds of objects before one is seen. It enriches what perception finds with
//! colour, size, mass, the recognition method and grasps.
//!
//! Besides classes there are [scenes](Scene): which things usually stand where.
//!
//! The classes come from a folder of YAML files ([`PriorKnowledge::load`], one class a file, see [`mod@file`] for its
//! form) or from the program ([`PriorKnowledge::add`]). [`PriorKnowledge::put_into`] makes them the read-only
//! provider segment `ObjectClasses/prior` of a working memory; skills read them back with
//! [`ObjectClass::from_snapshot`].

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_memoryx::{MemoryError, Snapshot, WorkingMemory, check_name, fields};
use armarium_source::{Finding, Source, Span, code};
use armarium_values::{Frame, Pose, Value};
use nalgebra::{Isometry3, UnitQuaternion};
use serde::Serialize;

pub mod file;
pub mod scene;

pub use scene::{Placed, SCENES, Scene};

/// The core segment of object classes.
pub const OBJECT_CLASSES: &str = "ObjectClasses";
/// The provider segment of prior knowledge.
pub const PRIOR: &str = "prior";
/// The frame of a class's own geometry: its origin is the centre of the box of its size, its axes are the box's.
pub const OBJECT_FRAME: &str = "object";

/// How an object of a class is found in images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Recognition {
    /// By the colour of its surface, segmented in both eyes.
    #[default]
    Color,
}

/// A way to hold an object.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspPose {
    /// Its name among the grasps of the class.
    pub name: String,
    /// The hand's grasp frame in the object's frame: `object_from_hand`, m.
    pub pose: Pose,
    /// How far before the object the hand begins its straight approach, m.
    pub approach: Option<f64>,
    /// How wide the hand is open on its approach, m between the fingers.
    pub aperture: Option<f64>,
}

/// What is known of a kind of object.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectClass {
    /// Its name.
    pub name: String,
    /// A sentence for people.
    pub description: String,
    /// The colour of its surface: red, green, blue.
    pub color: [u8; 3],
    /// Extent along the object's x, y and z, m.
    pub size: [f64; 3],
    /// Mass, kg.
    pub mass: Option<f64>,
    /// How it is found in images.
    pub recognition: Recognition,
    /// Ways to hold it, best first.
    pub grasps: Vec<GraspPose>,
}

/// Object classes and scenes by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PriorKnowledge {
    classes: BTreeMap<String, ObjectClass>,
    scenes: BTreeMap<String, Scene>,
}

impl Recognition {
    /// The method of that name.
    fn from_name(name: &str) -> Option<Self> {
        (name == Self::Color.name()).then_some(Self::Color)
    }

    /// The name that files and memory use.
    fn name(self) -> &'static str {
        match self {
            Self::Color => "color",
        }
    }
}

armarium_source::choice!(Recognition { "color" => Self::Color });

/// What is impossible about an object class.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {what}")]
pub struct Impossible {
    /// The key that files use.
    pub field: &'static str,
    /// What is wrong with it.
    pub what: String,
}

impl ObjectClass {
    /// A class that is found by its colour, with nothing else known. `size`: extent along x, y and z, m.
    pub fn new(name: &str, color: [u8; 3], size: [f64; 3]) -> Self {
        Self {
            name: name.into(),
            description: String::new(),
            color,
            size,
            mass: None,
            recognition: Recognition::Color,
            grasps: Vec::new(),
        }
    }

    /// The same class with its mass, kg.
    #[must_use]
    pub fn with_mass(mut self, mass: f64) -> Self {
        self.mass = Some(mass);
        self
    }

    /// Says what is impossible about the class, if anything is.
    ///
    /// # Errors
    /// The key that files use, and what is wrong with it.
    pub fn check(&self) -> Result<(), Impossible> {
        let impossible = |field, what| Err(Impossible { field, what });
        let possible = |x: f64, most: f64| x.is_finite() && x > 0.0 && x <= most;
        if let Err(error) = check_name(&self.name) {
            return impossible("object", error.to_string());
        }
        if !self.size.iter().all(|x| possible(*x, 10.0)) {
            let what = format!("{:?} m are not three lengths over 0 and up to 10 m", self.size);
            return impossible("size", what);
        }
        if let Some(mass) = self.mass.filter(|m| !possible(*m, 1000.0)) {
            return impossible("mass", format!("{mass} kg is not over 0 and up to 1000 kg"));
        }
        for (i, grasp) in self.grasps.iter().enumerate() {
            let numbers = grasp.pose.position.iter().chain(&grasp.pose.orientation);
            let lengths = grasp.approach.iter().chain(&grasp.aperture);
            if !numbers.chain(lengths).all(|x| x.is_finite()) {
                let what = format!("grasp `{}` has a number that is not finite", grasp.name);
                return impossible("grasps", what);
            }
            if self.grasps[..i].iter().any(|other| other.name == grasp.name) {
                return impossible("grasps", format!("two grasps are named `{}`", grasp.name));
            }
        }
        Ok(())
    }

    /// The class that a snapshot of `ObjectClasses` describes.
    ///
    /// # Errors
    /// [`MemoryError::NotFound`] when the snapshot says that the entity is gone; [`MemoryError::Schema`] when an
    /// attribute is missing or impossible.
    pub fn from_snapshot(snapshot: &Snapshot) -> Result<Self, MemoryError> {
        let wrong = |attribute: &str, what: String| MemoryError::Schema {
            id: snapshot.id.to_string(),
            attribute: attribute.into(),
            what,
        };
        let missing = |attribute: &str, wanted: &str| wrong(attribute, format!("is not {wanted}"));
        if snapshot.is_removed() {
            return Err(MemoryError::NotFound { id: snapshot.id.to_string() });
        }
        let text = |name: &str| snapshot.attribute(name).and_then(Value::as_str);
        let color = snapshot.attribute("color").and_then(rgb);
        let size = snapshot.attribute("size").and_then(Value::as_vector3);
        let method = text("recognition").and_then(Recognition::from_name);
        let grasps = match snapshot.attribute("grasps") {
            None => Some(Vec::new()),
            Some(value) => value.as_list().and_then(|list| list.iter().map(grasp_from).collect()),
        };
        let class = Self {
            name: snapshot.id.entity().into(),
            description: text("description").unwrap_or_default().into(),
            color: color.ok_or_else(|| missing("color", "three numbers from 0 to 255"))?,
            size: size.ok_or_else(|| missing("size", "three lengths in m"))?,
            mass: snapshot.attribute("mass").and_then(Value::as_f64),
            recognition: method.ok_or_else(|| missing("recognition", "the name of a method"))?,
            grasps: grasps.ok_or_else(|| missing("grasps", "a list of grasps with name and pose"))?,
        };
        class.check().map_err(|Impossible { field, what }| wrong(field, what))?;
        Ok(class)
    }

    /// The class as attributes of its entity.
    pub fn attributes(&self) -> BTreeMap<String, Value> {
        let color = self.color.iter().map(|c| Value::Int(i64::from(*c))).collect::<Vec<_>>();
        let description = Some(self.description.as_str()).filter(|text| !text.is_empty());
        fields([
            ("color", Some(Value::List(color))),
            ("size", Some(self.size.into())),
            ("recognition", Some(self.recognition.name().into())),
            ("grasps", Some(Value::List(self.grasps.iter().map(grasp_value).collect()))),
            ("description", description.map(Value::from)),
            ("mass", self.mass.map(Value::Float)),
        ])
    }
}

fn rgb(value: &Value) -> Option<[u8; 3]> {
    let channel = |x: f64| (x.fract() == 0.0 && (0.0..=255.0).contains(&x)).then_some(x as u8);
    let [r, g, b] = value.as_vector3()?;
    Some([channel(r)?, channel(g)?, channel(b)?])
}

fn grasp_value(grasp: &GraspPose) -> Value {
    Value::Map(fields([
        ("name", Some(grasp.name.as_str().into())),
        ("pose", Some(Value::Pose(grasp.pose.clone()))),
        ("approach", grasp.approach.map(Value::Float)),
        ("aperture", grasp.aperture.map(Value::Float)),
    ]))
}

fn grasp_from(value: &Value) -> Option<GraspPose> {
    let Value::Pose(pose) = value.get("pose")? else { return None };
    let length = |name: &str| value.get(name).and_then(Value::as_f64);
    let name = value.get("name")?.as_str()?.into();
    let (approach, aperture) = (length("approach"), length("aperture"));
    Some(GraspPose { name, pose: pose.clone(), approach, aperture })
}

impl GraspPose {
    /// A grasp from the hand's position, m, and its roll, pitch and yaw, rad, about the object's fixed x, y and z.
    pub fn new(name: &str, position: [f64; 3], rpy: [f64; 3]) -> Self {
        let pose = pose(Frame::from(OBJECT_FRAME), position, rpy);
        Self { name: name.into(), pose, approach: None, aperture: None }
    }
}

/// A pose from a position, m, and roll, pitch and yaw, rad, about the frame's fixed x, y and z.
fn pose(frame: Frame, position: [f64; 3], [roll, pitch, yaw]: [f64; 3]) -> Pose {
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Pose::new(frame, &Isometry3::from_parts(position.into(), rotation))
}

impl PriorKnowledge {
    /// Nothing known.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a class; it replaces one of the same name.
    ///
    /// # Errors
    /// [`MemoryError::Schema`] when it is impossible.
    pub fn add(&mut self, class: ObjectClass) -> Result<(), MemoryError> {
        class.check().map_err(|Impossible { field, what }| MemoryError::Schema {
            id: format!("{OBJECT_CLASSES}/{PRIOR}/{}", class.name),
            attribute: field.into(),
            what,
        })?;
        self.classes.insert(class.name.clone(), class);
        Ok(())
    }

    /// The class of that name.
    pub fn class(&self, name: &str) -> Option<&ObjectClass> {
        self.classes.get(name)
    }

    /// All classes, ordered by name.
    pub fn classes(&self) -> impl Iterator<Item = &ObjectClass> {
        self.classes.values()
    }

    /// The scene of that name.
    pub fn scene(&self, name: &str) -> Option<&Scene> {
        self.scenes.get(name)
    }

    /// All scenes, ordered by name.
    pub fn scenes(&self) -> impl Iterator<Item = &Scene> {
        self.scenes.values()
    }

    /// Makes the classes the provider segment `ObjectClasses/prior` of a memory and the scenes `Scenes/prior`, read-only for
    /// everybody else. What is there already and has not changed keeps its version; what is no longer known goes.
    ///
    /// # Errors
    /// As [`WorkingMemory::provide`].
    pub fn put_into(&self, memory: &WorkingMemory) -> Result<(), MemoryError> {
        let classes = self.classes.values().map(|class| (class.name.as_str(), class.attributes().into()));
        memory.provide(OBJECT_CLASSES, PRIOR, classes.collect())?;
        let scenes = self.scenes.values().map(|scene| (scene.name.as_str(), scene.attributes().into()));
        memory.provide(SCENES, PRIOR, scenes.collect())
    }
}

/// Something that another file has already.
fn duplicate(source: Arc<Source>, at: Span, name: &str) -> Finding {
    let help = Some("one of the two files has to go, or what it describes another name".into());
    Finding::error(source, code::DUPLICATE, at, format!("`{name}` is in another file too"), help)
}

#[cfg(test)]
mod tests {
    use armarium_memoryx::{Commit, EntityId};

    use super::*;

    fn sponge() -> ObjectClass {
        let mut grasp = GraspPose::new("top", [0.0, 0.0, 0.02], [std::f64::consts::PI, 0.0, 0.5]);
        grasp.approach = Some(0.1);
        let class = ObjectClass::new("sponge", [240, 210, 40], [0.10, 0.07, 0.04]).with_mass(0.15);
        ObjectClass { description: "A kitchen sponge.".into(), grasps: vec![grasp], ..class }
    }

    #[test]
    fn classes_are_read_only_entities_and_come_back_whole() {
        let memory = crate::working_memory(Arc::new(|| 7));
        let mut prior = PriorKnowledge::new();
        prior.add(sponge()).unwrap();
        prior.add(ObjectClass::new("tool", [40, 170, 60], [0.04, 0.04, 0.1])).unwrap();
        prior.put_into(&memory).unwrap();
        prior.put_into(&memory).unwrap();

        let id: EntityId = "ObjectClasses/prior/sponge".parse().unwrap();
        let snapshot = memory.latest_now(&id).unwrap();
        assert_eq!(snapshot.version, 1, "what has not changed keeps its version");
        assert_eq!(ObjectClass::from_snapshot(&snapshot).unwrap(), sponge());
        let refused = memory.commit_now(vec![Commit::removal(id.clone(), 7)]);
        assert_eq!(refused, Err(MemoryError::ReadOnly { id: id.to_string() }));

        PriorKnowledge::new().put_into(&memory).unwrap();
        assert!(memory.latest_now(&id).is_err(), "what is no longer known is gone");
    }

    #[test]
    fn impossible_classes_are_refused() {
        let base = sponge;
        for (class, field) in [
            (ObjectClass { size: [0.1, -0.1, 0.1], ..base() }, "size"),
            (ObjectClass { size: [0.1, f64::NAN, 0.1], ..base() }, "size"),
            (ObjectClass { mass: Some(0.0), ..base() }, "mass"),
            (ObjectClass { name: "a/b".into(), ..base() }, "object"),
            (ObjectClass { grasps: [base().grasps, base().grasps].concat(), ..base() }, "grasps"),
        ] {
            assert_eq!(class.check().unwrap_err().field, field);
            assert!(PriorKnowledge::new().add(class).is_err());
        }
    }
}
