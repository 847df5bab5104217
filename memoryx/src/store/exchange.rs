//! Export and import as JSON lines: one snapshot per line, as
//! `{"id", "version", "referenced_ns", "sent_ns", "arrived_ns", "instances"}`, values with their kind (`{"float": 0.5}`).

use std::io::{BufRead, Write};
use std::sync::Arc;

use super::{LongTermMemory, StoreError};
use crate::entity::Snapshot;
use crate::error::MemoryError;
use crate::query::Pattern;

/// Snapshots per transaction of an import.
const MAX_BATCH: usize = 1000;
/// Longest accepted line, bytes.
const MAX_LINE_BYTES: u64 = 256 << 20;

/// Highest version accepted from elsewhere: no real count reaches it.
const MAX_VERSION: u64 = 1 << 62;

impl Snapshot {
    /// Checks that a version from elsewhere is one that a memory could have assigned.
    pub(crate) fn check_version(&self) -> Result<(), MemoryError> {
        if (1..=MAX_VERSION).contains(&self.version) {
            return Ok(());
        }
        Err(MemoryError::Store { what: format!("`{}` cannot have version {}", self.id, self.version) })
    }

    /// Checks that a snapshot from elsewhere is one that a memory without typed segments could hold.
    fn check_kept(&self) -> Result<(), MemoryError> {
        self.check_version()?;
        self.instances.iter().try_for_each(|instance| crate::schema::check_form(&self.id, instance))
    }
}

impl LongTermMemory {
    /// Writes the snapshots of matching entities, ordered by arrival. Returns the number of lines.
    ///
    /// # Errors
    /// [`StoreError::Failed`] when `to` cannot be written; [`StoreError::Damaged`] when a part is damaged: everything
    /// intact has then been written.
    pub fn export(&self, pattern: &Pattern, to: &mut impl Write) -> Result<u64, StoreError> {
        let (mut count, mut damages, mut first) = (0_u64, 0_u64, None);
        let mut failure = None;
        self.scan_intact(|snapshot| {
            match snapshot {
                Ok(snapshot) if pattern.matches(&snapshot.id) => {
                    let line = serde_json::to_vec(&snapshot).map_err(std::io::Error::from);
                    let written = line.and_then(|line| to.write_all(&[&line[..], b"\n"].concat()));
                    count += 1;
                    failure = written.err();
                }
                Ok(_) => {}
                Err(what) => {
                    damages += 1;
                    first.get_or_insert(what);
                }
            }
            failure.is_none()
        })?;
        if let Err(what) = failure.map_or_else(|| to.flush(), Err) {
            return Err(self.failed(&format!("the export cannot be written: {what}")));
        }
        let Some(what) = first else { return Ok(count) };
        Err(self.damaged(format!(
            "{damages} places cannot be read, the first: {what}; the {count} snapshots that are intact were written"
        )))
    }

    /// Stores the snapshots of all lines, skipping those already stored. Returns how many were new.
    ///
    /// # Errors
    /// [`StoreError::Import`] with the invalid line; [`StoreError::Version`] when another snapshot has the same
    /// version. Lines before the last full thousand remain stored then.
    pub fn import(&self, from: &mut impl BufRead) -> Result<u64, StoreError> {
        let (mut line, mut number, mut new) = (Vec::new(), 0, 0);
        let mut batch = Vec::with_capacity(MAX_BATCH);
        loop {
            line.clear();
            number += 1;
            let wrong = |what: String| StoreError::Import { line: number, what };
            let read = std::io::Read::take(&mut *from, MAX_LINE_BYTES).read_until(b'\n', &mut line);
            let read = read.map_err(|e| wrong(e.to_string()))?;
            if read == 0 {
                break;
            }
            if line.iter().all(u8::is_ascii_whitespace) {
                continue;
            }
            let snapshot: Snapshot = serde_json::from_slice(&line).map_err(|e| wrong(e.to_string()))?;
            snapshot.check_kept().map_err(|e| wrong(e.to_string()))?;
            batch.push(Arc::new(snapshot));
            if batch.len() == MAX_BATCH {
                new += self.persist(&batch)? as u64;
                batch.clear();
            }
        }
        Ok(new + self.persist(&batch)? as u64)
    }
}
