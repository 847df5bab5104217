//! The files of prior knowledge: one object class a YAML file, and one scene a file, which [`super::scene`] has the form of.
//!
//! ```yaml
//! object: sponge
//! description: A kitchen sponge.
//! color: [240, 210, 40]        # red, green, blue
//! size: [0.10, 0.07, 0.04]     # along the object's x, y, z, m
//! mass: 0.15                   # kg
//! recognition: color
//! grasps:                      # the hand's grasp frame in the object's frame
//!   - {name: top, position: [0, 0, 0.02], rpy_deg: [180, 0, 0], approach: 0.10, aperture: 0.09}
//! ```
//!
//! All problems of all files are found at once, each with its place.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_source::yaml::Node;
use armarium_source::{
    Disk, Files, Finding, Findings, Rule, Source, Span, code, form, is_yaml, outermost, read_node,
};

use super::{GraspPose, ObjectClass, PriorKnowledge, Recognition, duplicate, scene};

/// Most files in a folder.
const MAX_FILES: usize = 10_000;

form! {
    /// An object class as a file says it.
    struct ClassFile: "an object class", check Self::is_possible {
        /// The class's name.
        object: String;
        /// A sentence for people.
        description: String = String::new();
        /// The colour of its surface: red, green and blue, 0 to 255.
        color: [u8; 3];
        /// Extent along the object's x, y and z, m.
        size: [f64; 3], Rule::unit("m");
        /// Mass, kg.
        mass: Option<f64> = None, Rule::unit("kg");
        /// The method that finds it in images: color.
        recognition: Recognition = Recognition::Color;
        /// Ways to hold it, best first.
        grasps: Vec<GraspFile> = Vec::new();
    }
}

form! {
    /// A way to hold an object as a file says it.
    struct GraspFile: "a grasp" {
        /// Its name among the grasps of the class.
        name: String;
        /// Position of the hand's grasp frame in the object's frame, m.
        position: [f64; 3], Rule::unit("m");
        /// Roll, pitch and yaw about the object's fixed x, y and z, degrees.
        rpy_deg: [f64; 3] = [0.0; 3], Rule::unit("deg");
        /// How far before the object the hand begins its straight approach, m.
        approach: Option<f64> = None, Rule::unit("m");
        /// How wide the hand is open on its approach, m between the fingers.
        aperture: Option<f64> = None, Rule::unit("m");
    }
}

/// The JSON schema of an object class's file.
pub fn schema() -> serde_json::Value {
    armarium_source::schema::<ClassFile>()
}

impl ClassFile {
    fn class(&self) -> ObjectClass {
        ObjectClass {
            name: self.object.clone(),
            description: self.description.clone(),
            color: self.color,
            size: self.size,
            mass: self.mass,
            recognition: self.recognition,
            grasps: self.grasps.iter().map(grasp).collect(),
        }
    }

    fn is_possible(&self, node: &Node, findings: &mut Findings) {
        if let Err(error) = self.class().check() {
            let code = if error.field == "object" { code::NAME } else { code::VALUE };
            findings.error(code, node.place(error.field), error.to_string());
        }
    }
}

impl PriorKnowledge {
    /// Reads all files `*.yaml` and `*.yml` of a folder, in the order of their names.
    ///
    /// # Errors
    /// Everything that is wrong with any file.
    pub fn load(folder: &Path) -> Result<Self, Vec<Finding>> {
        Self::of_files(files(folder)?, &Disk)
    }

    fn of_files(paths: Vec<PathBuf>, files: &dyn Files) -> Result<Self, Vec<Finding>> {
        let mut findings = Vec::new();
        let mut known = Self::new();
        let mut scenes = Vec::new();
        for file in paths {
            let source = match files.read(&file) {
                Ok(source) => source,
                Err(finding) => {
                    findings.push(*finding);
                    continue;
                }
            };
            if scene::is_scene(&source.text) {
                scenes.push(source);
                continue;
            }
            match read_node::<ClassFile>(Arc::clone(&source)) {
                Ok((class, node)) if known.class(&class.object).is_some() => {
                    findings.push(duplicate(source, node.place("object"), &class.object));
                }
                Ok((class, _)) => {
                    known.classes.insert(class.object.clone(), class.class());
                }
                Err(found) => findings.extend(found),
            }
        }
        // Scenes name classes, which all have to be known before.
        for source in scenes {
            match scene::read(source, &known) {
                Ok(scene) => {
                    known.scenes.insert(scene.name.clone(), scene);
                }
                Err(found) => findings.extend(found),
            }
        }
        if findings.is_empty() { Ok(known) } else { Err(findings) }
    }
}

/// Everything that is wrong with the file of an object class or a scene, held against the files beside it.
#[must_use]
pub fn check(source: &Source, files: &dyn Files) -> Vec<Finding> {
    let folder = source.path.parent().unwrap_or(Path::new(""));
    // By their names, because a path in the present folder may begin with `./` or not.
    let is_other = |path: &PathBuf| path.file_name() != source.path.file_name();
    let mut paths: Vec<PathBuf> = files.list(folder).into_iter().filter(is_other).collect();
    paths.retain(|path| files.head(path).is_some_and(|head| is_prior(&head)));
    paths.truncate(MAX_FILES);
    paths.push(source.path.clone());
    let mut findings = PriorKnowledge::of_files(paths, files).err().unwrap_or_default();
    findings.retain(|finding| finding.source.path == source.path);
    findings
}

/// Whether a file describes an object class or a scene.
fn is_prior(head: &str) -> bool {
    scene::is_scene(head) || outermost(head, "object").is_some()
}

fn files(folder: &Path) -> Result<Vec<PathBuf>, Vec<Finding>> {
    let wrong = |what: String| {
        let source = Arc::new(Source::new(folder, ""));
        vec![Finding::error(source, code::FILE, Span::default(), what, None)]
    };
    let unreadable = |error: std::io::Error| wrong(format!("the folder cannot be read: {error}"));
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if is_yaml(&path) {
            files.push(path);
        }
        if files.len() > MAX_FILES {
            return Err(wrong(format!("the folder has more than {MAX_FILES} files")));
        }
    }
    files.sort();
    Ok(files)
}

fn grasp(file: &GraspFile) -> GraspPose {
    let grasp = GraspPose::new(&file.name, file.position, file.rpy_deg.map(f64::to_radians));
    GraspPose { approach: file.approach, aperture: file.aperture, ..grasp }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPONGE: &str = "\
object: sponge
description: A kitchen sponge.
color: [240, 210, 40]
size: [0.10, 0.07, 0.04]
mass: 0.15
recognition: color
grasps:
  - {name: top, position: [0, 0, 0.02], rpy_deg: [180, 0, 0], approach: 0.10, aperture: 0.09}
";

    fn parsed(text: &str) -> Result<ObjectClass, Vec<Finding>> {
        let source = Arc::new(Source::new("sponge.yaml", text));
        armarium_source::read::<ClassFile>(source).map(|class| class.class())
    }

    #[test]
    fn a_file_becomes_a_class() {
        let class = parsed(SPONGE).unwrap();
        assert_eq!((class.name.as_str(), class.color, class.mass), ("sponge", [240, 210, 40], Some(0.15)));
        let grasp = &class.grasps[0];
        assert_eq!((grasp.approach, grasp.aperture), (Some(0.10), Some(0.09)));
        let in_mm = SPONGE.replace("approach: 0.10", "approach: 100 mm").replace("0.15", "150 g");
        let in_mm = parsed(&in_mm).unwrap();
        assert_eq!((in_mm.mass, in_mm.grasps[0].approach), (Some(0.15), Some(0.1)));
        let turned = grasp.pose.isometry() * nalgebra::Point3::new(0.0, 0.0, 1.0);
        assert!((turned.coords - nalgebra::Vector3::new(0.0, 0.0, -0.98)).norm() < 1e-12);
    }

    #[test]
    fn problems_are_named_with_their_place() {
        let cases = [
            ("size: [0.10, 0.07, 0.04]", "size: [0.10, 0, 0.04]", code::VALUE, (4, 7)),
            ("mass: 0.15", "mass: -1", code::VALUE, (5, 7)),
            ("recognition: color", "recognition: smell", code::VALUE, (6, 14)),
            ("color: [240, 210, 40]", "color: [240, 210, 400]", code::VALUE, (3, 19)),
            ("mass: 0.15", "weight: 0.15", code::KEY, (5, 1)),
            ("object: sponge", "object: a/b", code::NAME, (1, 9)),
        ];
        for (from, to, code, place) in cases {
            let text = SPONGE.replace(from, to);
            let findings = parsed(&text).unwrap_err();
            let found: Vec<_> = findings.iter().map(|f| (f.code, f.position())).collect();
            assert_eq!(found, [(code, place)], "{to}: {findings:?}");
        }
    }

    #[test]
    fn a_folder_is_read_whole_and_all_problems_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write("sponge.yaml", SPONGE);
        write("tool.yml", "object: tool\ncolor: [40, 170, 60]\nsize: [0.04, 0.04, 0.1]\n");
        write("readme.txt", "not read");
        let known = PriorKnowledge::load(folder.path()).unwrap();
        assert_eq!(known.classes().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["sponge", "tool"]);

        write("again.yaml", SPONGE);
        write("broken.yaml", "object: [");
        let findings = PriorKnowledge::load(folder.path()).unwrap_err();
        let codes: Vec<&str> = findings.iter().map(|f| f.code).collect();
        assert_eq!(codes, [code::YAML, code::DUPLICATE]);
        assert!(PriorKnowledge::load(&folder.path().join("missing")).is_err());
    }

    #[test]
    fn the_schema_names_every_field() {
        let schema = schema();
        let names: Vec<&String> = schema["properties"].as_object().unwrap().keys().collect();
        assert_eq!(names, ["color", "description", "grasps", "mass", "object", "recognition", "size"]);
        assert_eq!(schema["additionalProperties"], serde_json::json!(false));
    }
}
