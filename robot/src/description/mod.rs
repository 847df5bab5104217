//! Reads a robot: a robot file with its URDF, or a URDF alone. Start at [`Model::shipped`] and [`load`].
//!
//! - `urdf`: links and joints, with their `meshes`. `file`: the form of the robot file. `resolve`: both together make a
//!   [`Model`].
//! - `srdf`: groups, hands and postures from SRDF. `guess`: the robot file of a URDF that has none.
//! - `shipped`: the robots that the program carries.
//!
//! Everything that is wrong is a finding with its place. What is left out and can be assumed is a warning.

mod file;
mod guess;
mod meshes;
mod platform;
mod resolve;
mod shipped;
mod srdf;
mod urdf;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_source::{Files, Finding, Findings, Source, Span, code, is_yaml};

pub use self::file::RobotFile;
use self::meshes::Meshes;
pub use self::meshes::mesh_file;
pub use self::shipped::{default_robot, shipped_robots};
use crate::Model;

/// A robot that was read.
#[derive(Clone, Debug)]
pub struct Description {
    /// The robot.
    pub model: Arc<Model>,
    /// What was assumed, or may not be meant.
    pub warnings: Vec<Finding>,
}

impl Model {
    /// A robot that the program carries; `armarium robot list` names them.
    ///
    /// # Errors
    /// Everything that is wrong with its files; a finding that names all robots where there is none of this name.
    pub fn shipped(name: &str) -> Result<Arc<Self>, Vec<Finding>> {
        let path = Path::new("robots").join(name).join("robot.yaml");
        let Some(bytes) = shipped::file(name, "robot.yaml") else {
            let known = shipped_robots().collect::<Vec<_>>().join(", ");
            let message = format!("there is no robot `{name}`");
            let source = Arc::new(Source::new(name, ""));
            let help = Some(format!("the program carries {known}; others are named by their file"));
            return Err(vec![Finding::error(source, code::REFERENCE, Span::default(), message, help)]);
        };
        let read = |file: &Path| match file.file_name().and_then(|file| shipped::file(name, file.to_str()?)) {
            Some(bytes) => Ok(Arc::new(Source::new(file, String::from_utf8_lossy(bytes)))),
            None => Source::read(file),
        };
        let source = Arc::new(Source::new(path, String::from_utf8_lossy(bytes)));
        Ok(robot_file(source, &[], read)?.model)
    }
}

/// Reads a robot that is called by its name, or by its file.
///
/// # Errors
/// As [`Model::shipped`] and [`load`].
pub fn find(robot: &str) -> Result<Description, Vec<Finding>> {
    if is_file(robot) {
        return load(Path::new(robot), &[]);
    }
    Model::shipped(robot).map(|model| Description { model, warnings: Vec::new() })
}

/// Whether a robot is called by its file, and not by the name of one that the program carries.
pub fn is_file(robot: &str) -> bool {
    let path = Path::new(robot);
    is_yaml(path) || is_description(path)
}

/// Whether a file is a description (URDF or xacro) and not a robot file.
fn is_description(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "urdf" || ending == "xacro" || ending == "xml")
}

/// Reads a robot file (`.yaml`) with the URDF that it names, or a URDF alone, whose robot file is then guessed
/// ([`guessed`]). Meshes of `package://` are searched in `packages` too.
///
/// # Errors
/// Everything that is wrong with the files, in the order of their texts.
pub fn load(path: &Path, packages: &[PathBuf]) -> Result<Description, Vec<Finding>> {
    let source = if is_description(path) {
        let text = guessed(path, None, path.parent().unwrap_or(Path::new("")), packages)?;
        Arc::new(Source::new(path.with_extension("yaml"), text))
    } else {
        Source::read(path).map_err(|finding| vec![*finding])?
    };
    robot_file(source, packages, Source::read)
}

/// The text of a robot file in the folder `beside` for a URDF, with what could be told; what was guessed is marked in it.
/// With an SRDF nothing is guessed: it says what the groups are.
///
/// # Errors
/// Everything that is wrong with the URDF.
pub fn guessed(
    urdf: &Path,
    semantics: Option<&Path>,
    beside: &Path,
    packages: &[PathBuf],
) -> Result<String, Vec<Finding>> {
    let source = Source::read(urdf).map_err(|finding| vec![*finding])?;
    let (tree, findings) = urdf::read(&source, &mut Meshes::new(urdf, packages));
    let tree = tree.ok_or(findings)?;
    let name = urdf.file_stem().unwrap_or_default().to_string_lossy();
    let packages: Vec<String> = packages.iter().map(|folder| seen_from(folder, beside)).collect();
    let urdf = seen_from(urdf, beside);
    Ok(match semantics {
        Some(srdf) => guess::with_semantics(&name, &urdf, &seen_from(srdf, beside), &packages),
        None => guess::robot_file(&name, &urdf, &packages, &tree),
    })
}

#[cfg(test)]
pub(crate) fn read_mesh(bytes: &[u8], name: &str, scale: [f64; 3]) -> Option<crate::Mesh> {
    meshes::read(bytes, Path::new(name), &scale.into())
}

/// The path of a file as seen from a folder: relative where it is inside of it.
fn seen_from(path: &Path, folder: &Path) -> String {
    let whole = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let (path, folder) = (whole(path), whole(folder));
    path.strip_prefix(&folder).unwrap_or(&path).to_string_lossy().into_owned()
}

/// Reads a robot from the texts of its robot file and its URDF.
///
/// # Errors
/// As [`load`].
pub fn from_texts(robot_file_text: &str, urdf: &str) -> Result<Description, Vec<Finding>> {
    let source = Arc::new(Source::new("robot.yaml", robot_file_text));
    robot_file(source, &[], |file| Ok(Arc::new(Source::new(file, urdf))))
}

/// Everything that is wrong with a robot file, and what is assumed of its URDF, which is read from `files`.
pub fn check(source: Arc<Source>, files: &dyn Files) -> Vec<Finding> {
    match robot_file(source, &[], |path| files.read(path)) {
        Ok(description) => description.warnings,
        Err(findings) => findings,
    }
}

/// Reads a robot file; `read` reads the URDF beside it.
fn robot_file(
    source: Arc<Source>,
    packages: &[PathBuf],
    read: impl Fn(&Path) -> Result<Arc<Source>, Box<Finding>>,
) -> Result<Description, Vec<Finding>> {
    let (mut file, node) = armarium_source::read_node::<RobotFile>(Arc::clone(&source))?;
    let folder = source.path.parent().unwrap_or(Path::new("")).to_owned();
    let path = folder.join(&file.description);
    let mut findings = Findings::new(source);
    let beside = |findings: &mut Findings, key: &str, path: &Path| match read(path) {
        Ok(text) => Some(text),
        Err(finding) => {
            let message = format!("the {key} cannot be used: {}", finding.message);
            let help = Some("it is searched beside this file".into());
            findings.error_help(code::FILE, node.place(key), message, help);
            None
        }
    };
    let urdf = beside(&mut findings, "description", &path);
    let semantics = file.semantics.as_ref().map(|srdf| folder.join(srdf));
    let semantics = semantics.and_then(|path| beside(&mut findings, "semantics", &path));
    let Some(urdf) = urdf.filter(|_| findings.list.is_empty()) else { return Err(findings.list) };
    let packages: Vec<PathBuf> =
        packages.iter().cloned().chain(file.packages.iter().map(|package| folder.join(package))).collect();
    let (tree, mut warnings) = urdf::read(&urdf, &mut Meshes::new(&path, &packages));
    let Some(tree) = tree else { return Err(warnings) };
    let mut disabled = srdf::Pairs::new();
    if let Some(srdf) = semantics {
        let (pairs, found) = srdf::merge(&srdf, &tree, &mut file);
        disabled = pairs;
        warnings.extend(found);
        if warnings.iter().any(Finding::is_error) {
            return Err(warnings);
        }
    }
    let mut model = resolve::model(&file, &node, tree, &mut findings);
    model.may_touch = disabled;
    if findings.list.iter().any(Finding::is_error) {
        findings.list.sort_by_key(|finding| finding.span.start);
        return Err(findings.list);
    }
    warnings.append(&mut findings.list);
    Ok(Description { model: Arc::new(model), warnings })
}
