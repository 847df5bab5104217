//! Scenes of prior knowledge: which things usually stand where, before any is seen. One scene a YAML file, in the folder of the
//! object classes.
//!
//! ```yaml
//! scene: breakfast
//! description: The table as it is laid in the morning.
//! objects:                     # things of known classes, poses in the frame, m
//!   - {name: cup, class: cup, position: [0.2, 0.6, 0.85], rpy_deg: [0, 0, 30]}
//! environment:                 # tables, walls and other places
//!   - {name: table, position: [0, 0.6, 0.78], size: [1.6, 0.8, 0.04]}
//! ```
//!
//! `frame` is `root` if not given. A scene is no belief about now: [`Scene::commits`] makes one of it.

use std::collections::BTreeMap;
use std::path::Path;

use armarium_values::{Frame, Pose, Value};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_saphyr::Spanned;

use super::file::{Finding, finding, place};
use crate::entity::{Commit, EntityId, check_name};
use crate::error::MemoryError;

/// The core segment of scenes.
pub const SCENES: &str = "Scenes";

/// A thing in a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// Its name among the things of the scene.
    pub name: String,
    /// Its class; none for a part of the environment.
    pub class: Option<String>,
    /// Where it is, m.
    pub pose: Pose,
    /// Extent along its own axes, m, of a part of the environment.
    pub size: Option<[f64; 3]>,
}

/// A scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Its name.
    pub name: String,
    /// A sentence for people.
    pub description: String,
    /// Its objects, then the parts of its environment.
    pub things: Vec<Placed>,
}

/// A scene as a file says it.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Scene of prior knowledge")]
struct SceneFile {
    /// The scene's name.
    #[schemars(with = "String")]
    scene: Spanned<String>,
    /// A sentence for people.
    #[serde(default)]
    description: String,
    /// The frame of all poses.
    #[serde(default = "root")]
    frame: String,
    /// Things of known classes.
    #[serde(default)]
    objects: Vec<ObjectFile>,
    /// Tables, walls and other places.
    #[serde(default)]
    environment: Vec<EnvironmentFile>,
}

/// A thing of a known class as a file says it.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ObjectFile {
    /// Its name in the scene.
    #[schemars(with = "String")]
    name: Spanned<String>,
    /// The name of its class, which another file of the folder has.
    #[schemars(with = "String")]
    class: Spanned<String>,
    /// Its centre, m.
    position: [f64; 3],
    /// Roll, pitch and yaw about the frame's fixed x, y and z, degrees.
    #[serde(default)]
    rpy_deg: [f64; 3],
}

/// A part of the environment as a file says it.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct EnvironmentFile {
    /// Its name in the scene.
    #[schemars(with = "String")]
    name: Spanned<String>,
    /// Its centre, m.
    position: [f64; 3],
    /// Roll, pitch and yaw about the frame's fixed x, y and z, degrees.
    #[serde(default)]
    rpy_deg: [f64; 3],
    /// Extent along its own x, y and z, m.
    size: [f64; 3],
}

fn root() -> String {
    Frame::root().0
}

/// The JSON schema of a file.
#[must_use]
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(SceneFile).to_value()
}

/// A scene that was read, with the places of its name and of the classes that it names.
pub(super) struct Read {
    pub(super) scene: Scene,
    pub(super) place: Option<(u64, u64)>,
    pub(super) classes: Vec<(String, Option<(u64, u64)>)>,
}

/// Whether a file is one of a scene: its outermost level has the key `scene`.
pub(super) fn is_scene(text: &str) -> bool {
    text.lines().any(|line| line.starts_with("scene:"))
}

/// The scene in a file.
pub(super) fn parse(file: &Path, text: &str) -> Result<Read, Finding> {
    let options = serde_saphyr::options! { strict_booleans: true, with_snippet: false };
    let parsed: SceneFile = serde_saphyr::from_str_with_options(text, options).map_err(|error| {
        let place = error.location().map(|at| (at.line(), at.column()));
        Finding { place, ..finding(file, "prior.syntax", error.to_string()) }
    })?;
    let wrong =
        |at: Option<(u64, u64)>, what: String| Finding { place: at, ..finding(file, "prior.value", what) };
    check_name(&parsed.scene.value).map_err(|e| wrong(place(&parsed.scene), format!("scene: {e}")))?;
    let mut scene =
        Scene { name: parsed.scene.value.clone(), description: parsed.description, things: Vec::new() };
    let mut classes = Vec::new();
    for object in &parsed.objects {
        classes.push((object.class.value.clone(), place(&object.class)));
        let class = Some(object.class.value.clone());
        let pose = pose(&parsed.frame, object.position, object.rpy_deg);
        let thing = Placed { name: object.name.value.clone(), class, pose, size: None };
        scene.add(thing).map_err(|what| wrong(place(&object.name), what))?;
    }
    for part in &parsed.environment {
        let pose = pose(&parsed.frame, part.position, part.rpy_deg);
        let thing = Placed { name: part.name.value.clone(), class: None, pose, size: Some(part.size) };
        scene.add(thing).map_err(|what| wrong(place(&part.name), what))?;
    }
    Ok(Read { scene, place: place(&parsed.scene), classes })
}

fn pose(frame: &str, position: [f64; 3], rpy_deg: [f64; 3]) -> Pose {
    let [roll, pitch, yaw] = rpy_deg.map(f64::to_radians);
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Pose::new(Frame(frame.to_owned()), &Isometry3::from_parts(Translation3::from(position), rotation))
}

impl Scene {
    /// Adds a thing.
    ///
    /// # Errors
    /// What is impossible about it.
    pub fn add(&mut self, thing: Placed) -> Result<(), String> {
        check_name(&thing.name).map_err(|error| error.to_string())?;
        if self.things.iter().any(|other| other.name == thing.name) {
            return Err(format!("two things are named `{}`", thing.name));
        }
        let numbers = thing.pose.position.iter().chain(&thing.pose.orientation);
        if !numbers.chain(thing.size.iter().flatten()).all(|x| x.is_finite()) {
            return Err(format!("`{}` has a number that is not finite", thing.name));
        }
        if thing.size.is_some_and(|size| size.iter().any(|x| *x <= 0.0)) {
            return Err(format!("`{}` has a size that is not three lengths over 0 m", thing.name));
        }
        self.things.push(thing);
        Ok(())
    }

    /// The scene as attributes of its entity: `description`, and `things`, a list of maps with `name`, `pose`, and `class` or
    /// `size`.
    #[must_use]
    pub fn attributes(&self) -> BTreeMap<String, Value> {
        let thing = |thing: &Placed| Value::Map(thing.attributes(Some(("name", thing.name.as_str().into()))));
        BTreeMap::from([
            ("description".to_owned(), Value::from(self.description.as_str())),
            ("things".to_owned(), Value::List(self.things.iter().map(thing).collect())),
        ])
    }

    /// The belief that the scene holds now: its objects in `ObjectInstances/{provider}`, its environment in
    /// `EnvironmentModels/{provider}`. `confidence`: how far it is trusted, 0 to 1; `referenced_ns`: when it holds.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when the provider's name cannot be part of an address.
    pub fn commits(
        &self,
        provider: &str,
        confidence: f64,
        referenced_ns: u64,
    ) -> Result<Vec<Commit>, MemoryError> {
        let commit = |thing: &Placed| {
            let segment = if thing.class.is_some() { "ObjectInstances" } else { "EnvironmentModels" };
            let id = EntityId::new(segment, provider, &thing.name)?;
            Ok(Commit::new(id, referenced_ns, thing.attributes(None)).with_confidence(confidence))
        };
        self.things.iter().map(commit).collect()
    }
}

impl Placed {
    fn attributes(&self, name: Option<(&str, Value)>) -> BTreeMap<String, Value> {
        let class = self.class.as_ref().map(|class| ("class", Value::from(class.as_str())));
        let size = self.size.map(|size| ("size", Value::from(size)));
        let pose = Some(("pose", Value::Pose(self.pose.clone())));
        [name, class, size, pose]
            .into_iter()
            .flatten()
            .map(|(name, value)| (name.to_owned(), value))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::prior::PriorKnowledge;
    use crate::working::WorkingMemory;

    const BREAKFAST: &str = "\
scene: breakfast
description: The table as it is laid in the morning.
objects:
  - {name: cup, class: cup, position: [0.2, 0.6, 0.85], rpy_deg: [0, 0, 90]}
environment:
  - {name: table, position: [0, 0.6, 0.78], size: [1.6, 0.8, 0.04]}
";

    fn loaded(scene: &str) -> Result<PriorKnowledge, Vec<Finding>> {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write("a_scene.yaml", scene);
        write("cup.yaml", "object: cup\ncolor: [40, 170, 60]\nsize: [0.08, 0.08, 0.1]\n");
        PriorKnowledge::load(folder.path()).map_err(|error| error.findings)
    }

    #[test]
    fn a_scene_is_read_only_knowledge_that_can_become_a_belief() {
        let prior = loaded(BREAKFAST).unwrap();
        let memory = WorkingMemory::new(Arc::new(|| 7));
        prior.put_into(&memory).unwrap();
        let id: EntityId = "Scenes/prior/breakfast".parse().unwrap();
        let held = memory.latest_now(&id).unwrap();
        let things = held.attribute("things").unwrap().as_list().unwrap();
        assert_eq!(things[1].get("name"), Some(&Value::from("table")));
        let refused = memory.commit_now(vec![Commit::removal(id.clone(), 7)]);
        assert_eq!(refused, Err(MemoryError::ReadOnly { id: id.to_string() }));

        memory.commit_now(prior.scene("breakfast").unwrap().commits("expected", 0.6, 7).unwrap()).unwrap();
        let cup = memory.latest_now(&"ObjectInstances/expected/cup".parse().unwrap()).unwrap();
        let Some(Value::Pose(pose)) = cup.attribute("pose") else { panic!("no pose") };
        let ahead = pose.isometry().rotation * nalgebra::Vector3::x();
        assert!((ahead - nalgebra::Vector3::y()).norm() < 1e-12, "turned to the left: {ahead}");
        assert_eq!(cup.instance().unwrap().confidence, 0.6);
        let table = memory.latest_now(&"EnvironmentModels/expected/table".parse().unwrap()).unwrap();
        assert_eq!(table.attribute("size").and_then(Value::as_vector3), Some([1.6, 0.8, 0.04]));
    }

    #[test]
    fn problems_are_named_with_their_place() {
        let cases = [
            ("class: cup", "class: mug", "prior.class", Some((4, 24))),
            ("name: table", "name: cup", "prior.value", Some((6, 12))),
            ("1.6, 0.8", "1.6, -0.8", "prior.value", Some((6, 12))),
            ("name: cup", "name: a/b", "prior.value", Some((4, 12))),
            ("scene: breakfast", "scene: 'a*'", "prior.value", Some((1, 8))),
            ("rpy_deg", "angles", "prior.syntax", Some((4, 57))),
        ];
        for (from, to, code, place) in cases {
            let findings = loaded(&BREAKFAST.replacen(from, to, 1)).unwrap_err();
            let found: Vec<_> = findings.iter().map(|f| (f.code, f.place)).collect();
            assert_eq!(found, [(code, place)], "{to}: {findings:?}");
        }
    }

    #[test]
    fn the_schema_names_every_field() {
        let schema = schema();
        let names: Vec<&String> = schema["properties"].as_object().unwrap().keys().collect();
        assert_eq!(names, ["description", "environment", "frame", "objects", "scene"]);
    }
}
