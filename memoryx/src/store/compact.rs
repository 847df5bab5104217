//! Compaction: everything is written into a new file, without free space between, while commits go on. What they store
//! meanwhile is stored there, too; then the new file takes the old one's place.

use std::collections::BTreeSet;
use std::mem::take;
use std::path::Path;
use std::sync::Arc;

use redb::{ReadTransaction, ReadableDatabase, ReadableTable};

use super::backup::{COPIED_BYTES, copy_all_but_records};
use super::error::Fault;
use super::log::Given;
use super::read::row_at;
use super::record::Records;
use super::write::Totals;
use super::{AGES, CHUNKS, INDEX, KEPT, LongTermMemory, META, StoreError, Stored, beside};
use crate::entity::Snapshot;

/// When so few snapshots were stored during the last round, the rest is copied while commits wait.
const FEW: usize = 64;

impl LongTermMemory {
    /// Writes everything into a new file, in full chunks, and puts that in the place of the old one. Commits go on meanwhile,
    /// and wait for a few writes at the end. Needs as much free space as the file has content. A file of an earlier program
    /// gets checksums by it. Returns whether the file has changed.
    ///
    /// # Errors
    /// When the disk fails, or a commit meanwhile; nothing is changed then.
    pub fn compact(&self) -> Result<bool, StoreError> {
        let _alone = self.upkeep.lock();
        let Some(path) = &self.path else { return Ok(false) };
        let fresh = beside(path);
        let replaced = self.replace(path, &fresh);
        *self.journal.lock() = None;
        if replaced.is_err() {
            let _ = std::fs::remove_file(&fresh).is_ok();
        }
        self.release();
        replaced.map(|()| true)
    }

    /// Notes what is stored, if the file is being copied. Called by the writer.
    pub(super) fn journal(&self, snapshots: &[Arc<Snapshot>], given: &[Given]) {
        if let Some(journal) = &mut *self.journal.lock() {
            journal.extend(snapshots, given);
        }
    }

    fn replace(&self, path: &Path, fresh: &Path) -> Result<(), StoreError> {
        let to = Self::open_file(fresh.display().to_string(), fresh.into(), false)?;
        let mut memo = self.memo.lock();
        self.take_log(&mut memo)?;
        *self.journal.lock() = Some(Stored::default());
        let memo = self.with(|file| {
            // As long as this is open, no commit has the work of freeing pages: they go with the file.
            let from = file.database.begin_read()?;
            // The others of a shared file have to wait, because only this process keeps a journal.
            let kept_memo = self.shared.then_some(memo);
            to.with(|to| copy_all_but_records(&from, &to.database))?;
            copy_records(&from, &to)?;
            to.compact_alone()?;
            while self.catch_up(&to)? > FEW {}
            let mut memo = kept_memo.unwrap_or_else(|| self.memo.lock());
            memo.clear();
            self.catch_up(&to)?;
            let failed = |e: std::io::Error| self.failed(&format!("the new file: {e}"));
            std::fs::rename(fresh, path).map_err(failed)?;
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            std::fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)?;
            Ok(memo)
        })?;
        let new = to.database.write().take();
        let old = std::mem::replace(&mut *self.database.write(), new);
        drop(memo);
        self.closed(old);
        Ok(())
    }

    /// Returns free space between pages, in a file that nobody else uses.
    fn compact_alone(&self) -> Result<(), StoreError> {
        let mut open = self.database.write();
        let mut file = open.take().and_then(Arc::into_inner).ok_or_else(|| self.failed("it is in use"))?;
        self.contained(|| Ok(file.database.compact()?))?;
        // The copy goes on with the round of its original.
        let round =
            self.contained(|| Ok(Totals::read(&file.database.begin_read()?.open_table(META)?)?.round))?;
        file.log.get_mut().iter_mut().for_each(|log| log.begin(round));
        *open = Some(Arc::new(file));
        Ok(())
    }

    /// Stores in the copy what was stored since the last time. Returns how many snapshots.
    fn catch_up(&self, to: &Self) -> Result<usize, StoreError> {
        let journal = self.journal.lock().as_mut().map(take);
        let journal = journal.ok_or_else(|| self.failed("a commit has failed while it was copied"))?;
        to.persist_with(&journal.snapshots, &journal.given)?;
        Ok(journal.snapshots.len())
    }
}

/// Copies the records that are in the index: first those that retention is done with, which are older.
fn copy_records(from: &ReadTransaction, to: &LongTermMemory) -> Result<(), Fault> {
    let (chunks, kept, index) = (from.open_table(CHUNKS)?, from.open_table(KEPT)?, from.open_table(INDEX)?);
    let aged = from.open_table(AGES)?;
    let aged: BTreeSet<u64> = aged.iter()?.map(|row| Ok(row?.0.value().1)).collect::<Result<_, Fault>>()?;
    let mut next_chunk = 0;
    for keeps in [true, false] {
        let mut rows = chunks.iter()?.peekable();
        while rows.peek().is_some() {
            next_chunk = to.write(|writer, _| {
                (writer.totals.next_chunk, writer.keeps) = (next_chunk, keeps);
                let mut bytes = 0;
                for row in rows.by_ref() {
                    let (number, chunk) = row?;
                    let (number, chunk) = (number.value(), chunk.value());
                    if (kept.get(number)?.is_some() && !aged.contains(&number)) != keeps {
                        continue;
                    }
                    for (at, record) in (Records { chunk, at: 0 }) {
                        let (head, record) = record?;
                        if row_at(&index, head, number, at)?.is_some() {
                            writer.move_record(record, head)?;
                        }
                    }
                    // `move_record` counts the new ones.
                    writer.totals.bytes = writer.totals.bytes.saturating_sub(chunk.len() as u64);
                    bytes += chunk.len();
                    if bytes >= COPIED_BYTES {
                        break;
                    }
                }
                writer.close_chunk()?;
                Ok((writer.totals.next_chunk, true))
            })?;
        }
    }
    Ok(())
}
