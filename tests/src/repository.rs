//! The workspace as cargo sees it, and the location of its files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// One member of the workspace.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Room {
    /// Its name without the project's prefix.
    pub name: String,
    /// Its dependencies, with build dependencies.
    pub uses: BTreeSet<String>,
    /// Its dev-dependencies.
    pub tests_use: BTreeSet<String>,
    /// The description in its manifest.
    pub description: String,
    /// Path of its manifest.
    pub manifest: PathBuf,
}

/// The repository's root.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .map(Path::to_path_buf)
        .expect("the crate lies in the repository")
}

/// All members, from cargo's metadata.
pub fn rooms() -> Vec<Room> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(root())
        .output()
        .expect("cargo can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo writes JSON");
    let packages = metadata["packages"].as_array().expect("cargo lists packages");
    packages.iter().map(room).collect()
}

fn room(package: &Value) -> Room {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let name = text(&package["name"]);
    let mut room = Room {
        name: name.strip_prefix("armarium-").map(str::to_owned).unwrap_or(name),
        description: text(&package["description"]),
        manifest: text(&package["manifest_path"]).into(),
        ..Room::default()
    };
    for dependency in package["dependencies"].as_array().into_iter().flatten() {
        let tests = dependency["kind"] == "dev";
        let set = if tests { &mut room.tests_use } else { &mut room.uses };
        set.insert(text(&dependency["name"]));
    }
    room
}
