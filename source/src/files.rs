//! Where files that people write are read from: the disk, or an editor's texts that are not saved yet.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::finding::Finding;
use crate::text::Source;

/// Most bytes of a file's head.
const MAX_HEAD: u64 = 16_384;

/// Reads files and lists folders.
pub trait Files {
    /// A file of UTF-8 text, 10 MB at most.
    ///
    /// # Errors
    /// A finding about the file as a whole.
    fn read(&self, path: &Path) -> Result<Arc<Source>, Box<Finding>>;

    /// The first lines of a file, which say what it is; none where it cannot be read.
    fn head(&self, path: &Path) -> Option<String>;

    /// The YAML files of a folder, ordered by their names; none where it cannot be read.
    fn list(&self, folder: &Path) -> Vec<PathBuf>;
}

/// The files as they are on the disk.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disk;

impl Files for Disk {
    fn read(&self, path: &Path) -> Result<Arc<Source>, Box<Finding>> {
        Source::read(path)
    }

    fn head(&self, path: &Path) -> Option<String> {
        let mut head = Vec::new();
        File::open(path).ok()?.take(MAX_HEAD).read_to_end(&mut head).ok()?;
        Some(String::from_utf8_lossy(&head).into_owned())
    }

    fn list(&self, folder: &Path) -> Vec<PathBuf> {
        let place = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let Ok(entries) = std::fs::read_dir(place) else { return Vec::new() };
        let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        // Whatever else has such a name (a pipe, a device) is not opened: that could take for ever.
        paths.retain(|path| is_yaml(path) && path.is_file());
        paths.sort();
        paths
    }
}

/// What stands after a key at the outermost level of a YAML text, without quotes and comment. By such a key a file says what
/// it is, and it can be told from the file's head.
#[must_use]
pub fn outermost<'t>(text: &'t str, key: &str) -> Option<&'t str> {
    let rest = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    Some(rest.split('#').next().unwrap_or("").trim().trim_matches(['"', '\'']))
}

/// Whether a file's name ends as those of YAML do.
#[must_use]
pub fn is_yaml(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "yaml" || ending == "yml")
}
