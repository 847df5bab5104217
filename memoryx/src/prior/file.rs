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

use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Deserialize;
use serde_saphyr::Spanned;

use super::{GraspPose, ObjectClass, PriorKnowledge, Recognition, scene};

/// Longest file, bytes.
const LONGEST: u64 = 1 << 20;
/// Most files in a folder.
const MOST_FILES: usize = 10_000;

/// A problem in a file of prior knowledge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The file.
    pub file: PathBuf,
    /// Line and column, from 1; none where the file as a whole is meant.
    pub place: Option<(u64, u64)>,
    /// A code that stays: `prior.read`, `prior.syntax`, `prior.value`, `prior.recognition`, `prior.duplicate`,
    /// `prior.class`.
    pub code: &'static str,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    pub help: Option<String>,
}

/// The problems that keep prior knowledge from being used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("prior knowledge cannot be used: {}", .findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
pub struct PriorError {
    /// All of them, ordered by file and place.
    pub findings: Vec<Finding>,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some((line, column)) = self.place {
            write!(f, ":{line}:{column}")?;
        }
        write!(f, ": {} [{}]", self.message, self.code)?;
        self.help.as_ref().map_or(Ok(()), |help| write!(f, " ({help})"))
    }
}

/// An object class as a file says it.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Object class of prior knowledge")]
struct ClassFile {
    /// The class's name.
    #[schemars(with = "String")]
    object: Spanned<String>,
    /// A sentence for people.
    #[serde(default)]
    description: String,
    /// The colour of its surface: red, green and blue, 0 to 255.
    color: [u8; 3],
    /// Extent along the object's x, y and z, m.
    #[schemars(with = "[f64; 3]")]
    size: Spanned<[f64; 3]>,
    /// Mass, kg.
    #[schemars(with = "Option<f64>")]
    mass: Option<Spanned<f64>>,
    /// The method that finds it in images: color.
    #[schemars(with = "Option<String>")]
    recognition: Option<Spanned<String>>,
    /// Ways to hold it, best first.
    #[serde(default)]
    grasps: Vec<GraspFile>,
}

/// A way to hold an object as a file says it.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct GraspFile {
    /// Its name among the grasps of the class.
    #[schemars(with = "String")]
    name: Spanned<String>,
    /// Position of the hand's grasp frame in the object's frame, m.
    position: [f64; 3],
    /// Roll, pitch and yaw about the object's fixed x, y and z, degrees.
    #[serde(default)]
    rpy_deg: [f64; 3],
    /// How far before the object the hand begins its straight approach, m.
    approach: Option<f64>,
    /// How wide the hand is open on its approach, m between the fingers.
    aperture: Option<f64>,
}

/// The JSON schema of a file.
#[must_use]
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(ClassFile).to_value()
}

impl PriorKnowledge {
    /// Reads all files `*.yaml` and `*.yml` of a folder, in the order of their names.
    ///
    /// # Errors
    /// [`PriorError`] with every problem of every file.
    pub fn load(folder: &Path) -> Result<Self, PriorError> {
        let mut findings = Vec::new();
        let mut known = Self::new();
        let mut scenes = Vec::new();
        for file in files(folder).map_err(|finding| PriorError { findings: vec![finding] })? {
            let text = match read(&file) {
                Ok(text) => text,
                Err(found) => {
                    findings.push(found);
                    continue;
                }
            };
            if scene::is_scene(&text) {
                scenes.push((file, text));
                continue;
            }
            match parse(&file, &text) {
                Ok((class, place)) if known.class(&class.name).is_some() => findings.push(Finding {
                    place: Some(place),
                    help: Some("one of the two files has to go, or its object another name".into()),
                    ..finding(&file, "prior.duplicate", format!("`{}` is in another file too", class.name))
                }),
                Ok((class, _)) => {
                    known.classes.insert(class.name.clone(), class);
                }
                Err(found) => findings.push(found),
            }
        }
        // Scenes name classes, which all have to be known before.
        for (file, text) in scenes {
            known.add_scene(&file, &text, &mut findings);
        }
        if findings.is_empty() { Ok(known) } else { Err(PriorError { findings }) }
    }

    fn add_scene(&mut self, file: &Path, text: &str, findings: &mut Vec<Finding>) {
        let read = match scene::parse(file, text) {
            Ok(read) => read,
            Err(found) => return findings.push(found),
        };
        let unknown = read.classes.into_iter().filter(|(class, _)| self.class(class).is_none());
        findings.extend(unknown.map(|(class, place)| Finding {
            place,
            help: Some("a file of the same folder has to describe it: `object: NAME` ...".into()),
            ..finding(file, "prior.class", format!("there is no object class `{class}`"))
        }));
        if self.scene(&read.scene.name).is_some() {
            findings.push(Finding {
                place: read.place,
                help: Some("one of the two files has to go, or its scene another name".into()),
                ..finding(file, "prior.duplicate", format!("`{}` is in another file too", read.scene.name))
            });
            return;
        }
        self.scenes.insert(read.scene.name.clone(), read.scene);
    }

    /// Reads one class from YAML; `file` is its name in messages.
    ///
    /// # Errors
    /// [`PriorError`] with the problem and its place.
    pub fn parse_class(file: &Path, text: &str) -> Result<ObjectClass, PriorError> {
        parse(file, text).map(|(class, _)| class).map_err(|finding| PriorError { findings: vec![finding] })
    }
}

pub(super) fn finding(file: &Path, code: &'static str, message: String) -> Finding {
    Finding { file: file.into(), place: None, code, message, help: None }
}

fn files(folder: &Path) -> Result<Vec<PathBuf>, Finding> {
    let unreadable = |e: std::io::Error| finding(folder, "prior.read", format!("cannot be read: {e}"));
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.extension().is_some_and(|e| e == "yaml" || e == "yml") {
            files.push(path);
        }
        if files.len() > MOST_FILES {
            return Err(finding(folder, "prior.read", format!("has more than {MOST_FILES} files")));
        }
    }
    files.sort();
    Ok(files)
}

fn read(file: &Path) -> Result<String, Finding> {
    let unreadable = |e: std::io::Error| finding(file, "prior.read", format!("cannot be read: {e}"));
    let length = std::fs::metadata(file).map_err(unreadable)?.len();
    if length > LONGEST {
        return Err(finding(file, "prior.read", format!("has {length} bytes, more than {LONGEST}")));
    }
    std::fs::read_to_string(file).map_err(unreadable)
}

/// The class in a file, and where its name stands.
fn parse(file: &Path, text: &str) -> Result<(ObjectClass, (u64, u64)), Finding> {
    let options = serde_saphyr::options! { strict_booleans: true, with_snippet: false };
    let parsed: ClassFile = serde_saphyr::from_str_with_options(text, options).map_err(|error| {
        let place = error.location().map(|at| (at.line(), at.column()));
        Finding { place, ..finding(file, "prior.syntax", error.to_string()) }
    })?;
    let recognition = match &parsed.recognition {
        None => Recognition::default(),
        Some(name) => Recognition::from_name(&name.value).ok_or_else(|| Finding {
            place: place(name),
            help: Some(format!("known are: {}", Recognition::NAMES.map(|(n, _)| n).join(", "))),
            ..finding(file, "prior.recognition", format!("there is no recognition method `{}`", name.value))
        })?,
    };
    let class = ObjectClass {
        name: parsed.object.value.clone(),
        description: parsed.description.clone(),
        color: parsed.color,
        size: parsed.size.value,
        mass: parsed.mass.as_ref().map(|m| m.value),
        recognition,
        grasps: parsed.grasps.iter().map(grasp).collect(),
    };
    class.check().map_err(|(field, message)| Finding {
        place: match field {
            "size" => place(&parsed.size),
            "mass" => parsed.mass.as_ref().and_then(place),
            "grasps" => parsed.grasps.last().and_then(|g| place(&g.name)),
            _ => place(&parsed.object),
        },
        ..finding(file, "prior.value", format!("{field}: {message}"))
    })?;
    Ok((class, place(&parsed.object).unwrap_or((1, 1))))
}

pub(super) fn place<T>(spanned: &Spanned<T>) -> Option<(u64, u64)> {
    let at = spanned.referenced;
    (at.line() > 0).then(|| (at.line(), at.column()))
}

fn grasp(file: &GraspFile) -> GraspPose {
    let grasp = GraspPose::new(&file.name.value, file.position, file.rpy_deg.map(f64::to_radians));
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

    #[test]
    fn a_file_becomes_a_class() {
        let class = PriorKnowledge::parse_class(Path::new("sponge.yaml"), SPONGE).unwrap();
        assert_eq!((class.name.as_str(), class.color, class.mass), ("sponge", [240, 210, 40], Some(0.15)));
        let grasp = &class.grasps[0];
        assert_eq!((grasp.approach, grasp.aperture), (Some(0.10), Some(0.09)));
        let turned = grasp.pose.isometry() * nalgebra::Point3::new(0.0, 0.0, 1.0);
        assert!((turned.coords - nalgebra::Vector3::new(0.0, 0.0, -0.98)).norm() < 1e-12);
    }

    #[test]
    fn problems_are_named_with_their_place() {
        let cases = [
            ("size: [0.10, 0.07, 0.04]", "size: [0.10, 0, 0.04]", "prior.value", Some((4, 7))),
            ("mass: 0.15", "mass: -1", "prior.value", Some((5, 7))),
            ("recognition: color", "recognition: smell", "prior.recognition", Some((6, 14))),
            ("color: [240, 210, 40]", "color: [240, 210, 400]", "prior.syntax", Some((3, 19))),
            ("mass: 0.15", "weight: 0.15", "prior.syntax", Some((5, 1))),
            ("object: sponge", "object: a/b", "prior.value", Some((1, 9))),
        ];
        for (from, to, code, place) in cases {
            let text = SPONGE.replace(from, to);
            let error = PriorKnowledge::parse_class(Path::new("sponge.yaml"), &text).unwrap_err();
            let finding = &error.findings[0];
            assert_eq!((finding.code, finding.place), (code, place), "{to}: {finding}");
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
        let error = PriorKnowledge::load(folder.path()).unwrap_err();
        let codes: Vec<&str> = error.findings.iter().map(|f| f.code).collect();
        assert_eq!(codes, ["prior.syntax", "prior.duplicate"]);
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
