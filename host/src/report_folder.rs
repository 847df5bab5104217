//! The folder that a run writes its report and its recording to: no two runs write to one at the same time.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use crate::error::HostError;

/// A folder that this run alone writes to, for as long as this lives.
#[derive(Debug)]
pub(crate) struct ReportFolder {
    pub(crate) path: PathBuf,
    /// It was not there before.
    made: bool,
    _lock: Option<File>,
}

/// A run that does not begin leaves no empty folder.
impl Drop for ReportFolder {
    fn drop(&mut self) {
        if self.made {
            // Only an empty folder is removed.
            let _ = std::fs::remove_dir(&self.path);
        }
    }
}

impl ReportFolder {
    /// Takes a folder; makes it if it is not there. With `keep`, one that holds a report, or that another run writes to, is left
    /// alone, and the first of `DIR-2`, `DIR-3` ... that is free is taken; without, one that another run writes to is refused.
    pub(crate) fn take(folder: &Path, keep: bool) -> Result<Self, HostError> {
        let mut number = 1;
        loop {
            let path = match number {
                1 => folder.to_owned(),
                n => PathBuf::from(format!("{}-{n}", folder.display())),
            };
            let made = !path.exists();
            std::fs::create_dir_all(&path).map_err(|source| HostError::File {
                what: "the report's folder cannot be made:",
                path: path.clone(),
                source,
            })?;
            match locked(&path) {
                // A run that did not begin has just removed it.
                _ if !path.exists() => continue,
                Err(TryLockError::WouldBlock) if keep => {}
                Err(TryLockError::WouldBlock) => return Err(HostError::ReportInUse { path }),
                // A report that is there is looked for under the lock: its writer has gone then.
                _ if keep && path.join("report.json").exists() => {}
                // Some file systems cannot lock folders: then two runs are kept apart by their reports only.
                lock => return Ok(Self { path, made, _lock: lock.ok() }),
            }
            number += 1;
        }
    }
}

fn locked(folder: &Path) -> Result<File, TryLockError> {
    let folder = File::open(folder).map_err(TryLockError::Error)?;
    folder.try_lock()?;
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_does_not_begin_leaves_no_folder_and_removes_none_of_others() {
        let folder = tempfile::tempdir().unwrap();
        let report = folder.path().join("report");
        drop(ReportFolder::take(&report, true).unwrap());
        assert!(!report.exists());
        std::fs::create_dir(&report).unwrap();
        drop(ReportFolder::take(&report, true).unwrap());
        assert!(report.exists());
    }

    #[test]
    fn a_folder_has_one_writer_and_keeps_its_report() {
        let folder = tempfile::tempdir().unwrap();
        let report = folder.path().join("a/report");
        let take = |keep| ReportFolder::take(&report, keep);
        let first = take(true).unwrap();
        assert_eq!(first.path, report);
        let second = take(true).unwrap();
        assert_eq!(second.path, folder.path().join("a/report-2"));
        assert!(matches!(take(false), Err(HostError::ReportInUse { path }) if path == report));
        std::fs::write(second.path.join("report.json"), "{}").unwrap();
        drop(second);
        assert_eq!(take(true).unwrap().path, folder.path().join("a/report-3"));
        drop(first);
        let again = take(true).unwrap();
        assert_eq!(again.path, report, "a run that left no report");
        std::fs::write(report.join("report.json"), "{}").unwrap();
        drop(again);
        assert_eq!(take(false).unwrap().path, report);
        std::fs::write(folder.path().join("file"), "").unwrap();
        assert!(matches!(
            ReportFolder::take(&folder.path().join("file/report"), true),
            Err(HostError::File { .. })
        ));
    }
}
