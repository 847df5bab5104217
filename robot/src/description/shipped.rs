//! The robots that the program carries (`robots/`), compiled in.

/// A robot: its name, and its files by name.
type Shipped = (&'static str, &'static [(&'static str, &'static [u8])]);

const ROBOTS: &[Shipped] = include!("../../../robots/shipped.rs");

/// The names of the robots that the program carries, the default one first.
pub fn shipped_robots() -> impl Iterator<Item = &'static str> {
    ROBOTS.iter().map(|(name, _)| *name)
}

/// The robot of a world that names none.
pub fn default_robot() -> &'static str {
    ROBOTS[0].0
}

/// A file of a robot that the program carries.
pub(super) fn file(robot: &str, name: &str) -> Option<&'static [u8]> {
    let (_, files) = ROBOTS.iter().find(|(known, _)| *known == robot)?;
    files.iter().find(|(known, _)| *known == name).map(|(_, bytes)| *bytes)
}
