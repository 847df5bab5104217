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
use std::sync::Arc;

use armarium_memoryx::{Commit, EntityId, MemoryError, check_name, fields};
use armarium_source::yaml::Node;
use armarium_source::{Finding, Findings, Rule, Source, code, form, outermost, read_node};
use armarium_values::{Frame, Pose, Value};

use super::{PriorKnowledge, duplicate, pose};

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

form! {
    /// A scene as a file says it.
    struct SceneFile: "a scene" {
        /// The scene's name.
        scene: String;
        /// A sentence for people.
        description: String = String::new();
        /// The frame of all poses.
        frame: String = Frame::root().0;
        /// Things of known classes.
        objects: Vec<ObjectFile> = Vec::new();
        /// Tables, walls and other places.
        environment: Vec<EnvironmentFile> = Vec::new();
    }
}

form! {
    /// A thing of a known class as a file says it.
    struct ObjectFile: "an object of a scene" {
        /// Its name in the scene.
        name: String;
        /// The name of its class, which another file of the folder has.
        class: String;
        /// Its centre, m.
        position: [f64; 3], Rule::unit("m");
        /// Roll, pitch and yaw about the frame's fixed x, y and z, degrees.
        rpy_deg: [f64; 3] = [0.0; 3], Rule::unit("deg");
    }
}

form! {
    /// A part of the environment as a file says it.
    struct EnvironmentFile: "a part of the environment" {
        /// Its name in the scene.
        name: String;
        /// Its centre, m.
        position: [f64; 3], Rule::unit("m");
        /// Roll, pitch and yaw about the frame's fixed x, y and z, degrees.
        rpy_deg: [f64; 3] = [0.0; 3], Rule::unit("deg");
        /// Extent along its own x, y and z, m.
        size: [f64; 3], Rule::unit("m");
    }
}

/// The JSON schema of a scene's file.
pub fn schema() -> serde_json::Value {
    armarium_source::schema::<SceneFile>()
}

/// Whether a file is one of a scene: its outermost level has the key `scene`.
pub(super) fn is_scene(text: &str) -> bool {
    outermost(text, "scene").is_some()
}

/// The scene in a file, whose classes are known and whose name is new.
pub(super) fn read(source: Arc<Source>, known: &PriorKnowledge) -> Result<Scene, Vec<Finding>> {
    let (file, root) = read_node::<SceneFile>(Arc::clone(&source))?;
    let mut findings = Findings::new(source);
    let name = root.place("scene");
    if let Err(error) = check_name(&file.scene) {
        findings.error(code::NAME, name, format!("scene: {error}"));
    }
    if known.scene(&file.scene).is_some() {
        findings.list.push(duplicate(Arc::clone(&findings.source), name, &file.scene));
    }
    let mut scene = Scene { name: file.scene, description: file.description, things: Vec::new() };
    let nodes = |list: &str| root.get(list).map_or(&[][..], Node::items);
    let objects = file.objects.into_iter().map(|o| (o.name, Some(o.class), o.position, o.rpy_deg, None));
    let parts = file.environment.into_iter().map(|p| (p.name, None, p.position, p.rpy_deg, Some(p.size)));
    let nodes = nodes("objects").iter().chain(nodes("environment"));
    for ((name, class, position, rpy_deg, size), node) in objects.chain(parts).zip(nodes) {
        if let Some(class) = class.as_deref().filter(|class| known.class(class).is_none()) {
            let help = Some("a file of the same folder has to describe it: `object: NAME` ...".into());
            let message = format!("there is no object class `{class}`");
            findings.error_help(code::REFERENCE, node.place("class"), message, help);
        }
        let pose = pose(Frame(file.frame.clone()), position, rpy_deg.map(f64::to_radians));
        let mut numbers = pose.position.iter().chain(&pose.orientation).chain(size.iter().flatten());
        let place = node.place("name");
        if let Err(error) = check_name(&name) {
            findings.error(code::NAME, place, error.to_string());
        } else if scene.things.iter().any(|other| other.name == name) {
            findings.error(code::DUPLICATE, place, format!("two things are named `{name}`"));
        } else if numbers.any(|x| !x.is_finite()) {
            findings.error(code::VALUE, place, format!("`{name}` has a number that is not finite"));
        } else if size.is_some_and(|size| size.iter().any(|x| *x <= 0.0)) {
            findings.error(
                code::VALUE,
                place,
                format!("`{name}` has a size that is not three lengths over 0 m"),
            );
        } else {
            scene.things.push(Placed { name, class, pose, size });
        }
    }
    if findings.list.is_empty() { Ok(scene) } else { Err(findings.list) }
}

impl Scene {
    /// The scene as attributes of its entity: `description`, and `things`, a list of maps with `name`, `pose`, and `class` or
    /// `size`.
    pub fn attributes(&self) -> BTreeMap<String, Value> {
        let thing = |thing: &Placed| Value::Map(thing.attributes(Some(&thing.name)));
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
    fn attributes(&self, name: Option<&str>) -> BTreeMap<String, Value> {
        fields([
            ("name", name.map(Value::from)),
            ("class", self.class.as_deref().map(Value::from)),
            ("size", self.size.map(Value::from)),
            ("pose", Some(Value::Pose(self.pose.clone()))),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        PriorKnowledge::load(folder.path())
    }

    #[test]
    fn a_scene_is_read_only_knowledge_that_can_become_a_belief() {
        let prior = loaded(BREAKFAST).unwrap();
        let memory = crate::working_memory(Arc::new(|| 7));
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
            ("class: cup", "class: mug", code::REFERENCE, (4, 24)),
            ("name: table", "name: cup", code::DUPLICATE, (6, 12)),
            ("1.6, 0.8", "1.6, -0.8", code::VALUE, (6, 12)),
            ("name: cup", "name: a/b", code::NAME, (4, 12)),
            ("scene: breakfast", "scene: 'a*'", code::NAME, (1, 8)),
            ("rpy_deg", "angles", code::KEY, (4, 57)),
        ];
        for (from, to, code, place) in cases {
            let findings = loaded(&BREAKFAST.replacen(from, to, 1)).unwrap_err();
            let found: Vec<_> = findings.iter().map(|f| (f.code, f.position())).collect();
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
