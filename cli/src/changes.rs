//! Repeats work whenever files change, for authors with a terminal beside their editor.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use armarium_source::{Disk, Files as _};

/// How often the files are checked.
const POLL_INTERVAL: Duration = Duration::from_millis(250);

/// Modification time and length of files.
type Stamps = BTreeMap<PathBuf, (Option<SystemTime>, u64)>;

/// Does the work now, and again whenever one of the files, or a YAML file beside them or in `folders`, changes. Ends
/// only with the program, or when `out` cannot be written.
pub(crate) fn follow(
    files: &[PathBuf],
    folders: &[PathBuf],
    out: &mut dyn Write,
    mut work: impl FnMut(&mut dyn Write) -> io::Result<u8>,
) -> io::Result<u8> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
    loop {
        let before = stamps(files, folders);
        work(out)?;
        writeln!(out, "-- waiting for changes; Ctrl-C ends --")?;
        out.flush()?;
        runtime.block_on(async {
            while stamps(files, folders) == before {
                tokio::time::sleep(POLL_INTERVAL).await;
            }
        });
    }
}

fn stamps(files: &[PathBuf], folders: &[PathBuf]) -> Stamps {
    let beside = files
        .iter()
        .filter_map(|f| f.parent())
        .map(|p| if p.as_os_str().is_empty() { Path::new(".") } else { p });
    let mut paths: Vec<PathBuf> = files.to_vec();
    for folder in beside.chain(folders.iter().map(PathBuf::as_path)) {
        paths.extend(Disk.list(folder));
    }
    let stamp = |path: PathBuf| {
        let data = std::fs::metadata(&path).ok();
        let changed = data.as_ref().and_then(|d| d.modified().ok());
        (path, (changed, data.map_or(0, |d| d.len())))
    };
    paths.into_iter().map(stamp).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_beside_and_one_in_a_folder_are_seen_and_others_are_not() {
        let here = tempfile::tempdir().expect("a temporary folder");
        let there = tempfile::tempdir().expect("a temporary folder");
        let file = here.path().join("a.yaml");
        let look = || stamps(std::slice::from_ref(&file), &[there.path().to_owned()]);
        let write = |path: PathBuf| std::fs::write(path, "statechart: A\n").expect("it can be written");
        let mut before = look();
        for (path, seen) in [
            (file.clone(), true),
            (here.path().join("b.yml"), true),
            (there.path().join("c.yaml"), true),
            (here.path().join("notes.txt"), false),
        ] {
            write(path.clone());
            let after = look();
            assert_eq!(after != before, seen, "{}", path.display());
            before = after;
        }
    }
}
