//! The charts within reach: those of the current folder and of `--charts`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use armarium_runtime::chart::{self, Chart, Library};
use armarium_source::Disk;

/// The charts that could be read, and the rest.
#[derive(Default)]
pub(crate) struct Charts {
    /// Each with those that it names, ordered by name.
    pub(crate) read: Vec<(Arc<Chart>, Library)>,
    /// Files that begin like charts and cannot be read as such.
    pub(crate) unreadable: Vec<PathBuf>,
}

/// A folder of `--charts` that is not there.
pub(crate) fn missing(folders: &[PathBuf]) -> Option<&Path> {
    folders.iter().find(|folder| !folder.is_dir()).map(PathBuf::as_path)
}

/// The charts of the current folder and of `folders`.
pub(crate) fn within_reach(folders: &[PathBuf]) -> Charts {
    let mut places = vec![PathBuf::from(".")];
    places.extend(folders.iter().cloned());
    let mut charts = Charts::default();
    for file in chart::files(&places, &Disk).into_values().flatten() {
        let library = chart::load(&file, folders);
        match library.charts.get(&library.root) {
            Some(chart) => charts.read.push((Arc::clone(chart), library)),
            None => charts.unreadable.push(file),
        }
    }
    charts
}
