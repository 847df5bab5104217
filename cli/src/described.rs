//! The robot that a command line names: by its name, a robot file, or a URDF.

use std::path::{Path, PathBuf};

use armarium_robot::description::{self, Description};
use armarium_source::Finding;

/// Reads a robot; `packages` are folders in which packages of `package://` are.
pub(crate) fn described(robot: &str, packages: &[PathBuf]) -> Result<Description, Vec<Finding>> {
    if description::is_file(robot) {
        return description::load(Path::new(robot), packages);
    }
    description::find(robot)
}
