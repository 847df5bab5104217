//! The robot that a command line names: by its name, a robot file, or a URDF.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_robot::description::{self, Description};
use armarium_source::Finding;

use crate::console::show;

/// Reads a robot; `packages` are folders in which packages of `package://` are.
pub(crate) fn described(robot: &str, packages: &[PathBuf]) -> Result<Description, Vec<Finding>> {
    if description::is_file(robot) {
        return description::load(Path::new(robot), packages);
    }
    description::find(robot)
}

/// Says what is wrong with a robot. Returns the exit status.
pub(crate) fn refuse(wrong: &[Finding], out: &mut dyn Write) -> io::Result<u8> {
    show(wrong, out)?;
    Ok(2)
}
