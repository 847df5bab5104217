//! Retention: what long-term memory forgets by age and size.
//!
//! The newest snapshot of each entity is kept, unless it is a removal, and so is the content of named snapshots. Followers
//! see forgotten snapshots as a gap in the versions; a name that is forgotten counts from 1 again.
//!
//! The work is in proportion to what is forgotten: chunks are found by their age, what stays of one is moved once, and
//! chunks of what was moved are written again only when half of them is forgotten. So an idle store writes nothing.

use std::collections::BTreeSet;

use redb::ReadableTable;

use super::error::Fault;
use super::write::Writer;
use super::{LongTermMemory, StoreError, record};

/// Chunks that are forgotten in one transaction, and entities of which something is, so that no commit waits long: each entity may
/// have a page of its own in the index.
const MAX_FORGOTTEN: usize = 8;
const MAX_CHANGED: usize = 250;

/// What the rows of a record take in the file beside it, about: in the index, and of its entity.
const ROW_BYTES: u64 = 100;

/// How much is kept. `None` is unlimited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retention {
    /// How long after their arrival snapshots are kept, ns.
    pub age_ns: Option<u64>,
    /// Most bytes of records and blobs, with 100 for each record's rows.
    pub bytes: Option<u64>,
}

/// What retention has removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Snapshots.
    pub snapshots: u64,
    /// Bytes of records and blobs.
    pub bytes: u64,
    /// Bytes above the limit that are left, because everything that may be forgotten is.
    pub over: u64,
}

/// Entity numbers and versions that named snapshots contain.
type Pinned = BTreeSet<(u64, u64)>;

impl LongTermMemory {
    /// Removes what is older than the age, at `now_ns`, and then the oldest until the rest fits. The next
    /// [`Self::compact`] shrinks the file; until then the free space is reused.
    ///
    /// # Errors
    /// When the disk fails; snapshots removed before that stay removed.
    pub fn retain(&self, retention: Retention, now_ns: u64) -> Result<Dropped, StoreError> {
        let _alone = self.upkeep.lock();
        let before = retention.age_ns.map_or(0, |age| now_ns.saturating_sub(age));
        let start = self.stats()?;
        let is_over = |bytes: u64, snapshots: u64| {
            retention.bytes.is_some_and(|most| bytes + snapshots * ROW_BYTES > most)
        };
        let oldest = self.read(|reader| reader.oldest_chunk())?;
        let is_due =
            oldest.is_some_and(|arrived_ns| arrived_ns < before || is_over(start.bytes, start.snapshots));
        let mut left = is_due;
        if is_due {
            let pinned = self.pinned()?;
            while left {
                left = self.write(|writer, _| Ok((writer.forget_some(&is_over, before, &pinned)?, true)))?;
            }
        }
        let end = self.stats()?;
        Ok(Dropped {
            snapshots: start.snapshots.saturating_sub(end.snapshots),
            bytes: start.bytes.saturating_sub(end.bytes),
            over: retention
                .bytes
                .map_or(0, |most| (end.bytes + end.snapshots * ROW_BYTES).saturating_sub(most)),
        })
    }

    /// As [`Self::retain`]; a file that is larger than the limit is brought to three quarters of it, so that it is written anew
    /// only after as much has come as was forgotten. [`Dropped::over`] is what the file has above the limit.
    ///
    /// # Errors
    /// As [`Self::retain`] and [`Self::compact`].
    pub fn keep_within(&self, retention: Retention, now_ns: u64) -> Result<Dropped, StoreError> {
        let start = self.stats()?;
        let mut dropped = self.retain(retention, now_ns)?;
        let Some(most) = retention.bytes else { return Ok(dropped) };
        if self.stats()?.file_bytes > most {
            self.retain(Retention { bytes: Some(most / 4 * 3), ..retention }, now_ns)?;
            let kept = self.stats()?;
            // Without a gain, the file would be written anew every time.
            if (kept.bytes + kept.snapshots * ROW_BYTES) / 9 * 10 < kept.file_bytes {
                self.compact()?;
            }
        }
        let end = self.stats()?;
        dropped.snapshots = start.snapshots.saturating_sub(end.snapshots);
        dropped.bytes = start.bytes.saturating_sub(end.bytes);
        dropped.over = end.file_bytes.saturating_sub(most);
        Ok(dropped)
    }
}

impl Writer<'_> {
    /// Forgets what may be forgotten of the oldest chunks. Returns whether there may be more of them.
    fn forget_some(
        &mut self,
        is_over: &impl Fn(u64, u64) -> bool,
        before: u64,
        pinned: &Pinned,
    ) -> Result<bool, Fault> {
        self.keeps = true;
        let mut oldest = Vec::with_capacity(MAX_FORGOTTEN);
        for row in self.ages.iter()?.take(MAX_FORGOTTEN) {
            oldest.push(row?.0.value());
        }
        let is_full = oldest.len() == MAX_FORGOTTEN;
        let (mut thin, mut changed) = (BTreeSet::new(), BTreeSet::new());
        for (arrived_ns, chunk) in oldest {
            if changed.len() >= MAX_CHANGED {
                return self.thin_out(thin).map(|()| true);
            }
            let over = is_over(self.totals.bytes, self.totals.snapshots);
            if !over && arrived_ns >= before {
                return self.thin_out(thin).map(|()| false);
            }
            self.ages.remove((arrived_ns, chunk))?;
            let newest = if arrived_ns == 0 { self.newest_arrival_in(chunk)? } else { arrived_ns };
            if !over && newest >= before {
                self.ages.insert((newest, chunk), ())?;
                continue;
            }
            for (head, record) in self.take_records(chunk)? {
                changed.insert(head.number);
                self.forget_or_move(head, &record, pinned, &mut thin)?;
            }
        }
        self.thin_out(thin).map(|()| is_full)
    }

    /// Forgets a record of a chunk that was taken, or moves it if it stays. `thin`: the chunks of `kept` of which less than
    /// half is left.
    fn forget_or_move(
        &mut self,
        head: record::Head,
        record: &[u8],
        pinned: &Pinned,
        thin: &mut BTreeSet<u64>,
    ) -> Result<(), Fault> {
        let mut versions = self.index.range((head.number, 0)..=(head.number, u64::MAX))?;
        let newest = versions.next_back().transpose()?.map(|(key, _)| key.value().1);
        let oldest = versions.next().transpose()?.map(|(key, _)| key.value().1);
        drop(versions);
        if oldest.is_some_and(|oldest| oldest < head.version) {
            self.forget_kept_before(head, pinned, thin)?;
        }
        let is_pinned = pinned.contains(&(head.number, head.version));
        if newest != Some(head.version) && !is_pinned {
            return self.forget(record, head);
        }
        let is_alone = newest == Some(head.version) && !is_pinned && record::is_removal(record);
        let is_alone =
            is_alone && self.index.range((head.number, 0)..(head.number, head.version))?.next().is_none();
        if is_alone && self.forget_entity(record, head)? {
            return Ok(());
        }
        self.move_record(record, head)
    }

    /// Forgets the versions of an entity before one that is itself old enough, as far as they were kept as the newest.
    fn forget_kept_before(
        &mut self,
        head: record::Head,
        pinned: &Pinned,
        thin: &mut BTreeSet<u64>,
    ) -> Result<(), Fault> {
        let mut older = Vec::new();
        for row in self.index.range((head.number, 0)..(head.number, head.version))? {
            let (key, row) = row?;
            older.push((key.value().1, row.value()));
        }
        for (version, row) in older {
            let live = self.kept.get(row.0)?.map(|live| live.value());
            let Some(live) = live.filter(|_| !pinned.contains(&(head.number, version))) else { continue };
            let bytes = self.record(row)?;
            self.forget(&bytes, record::head(&bytes)?)?;
            let live = live.saturating_sub(u64::from(row.2));
            self.kept.insert(row.0, live)?;
            let length = self.chunks.get(row.0)?.map_or(0, |chunk| chunk.value().len() as u64);
            if 2 * live < length {
                thin.insert(row.0);
            }
        }
        Ok(())
    }

    /// Writes again what is left of chunks.
    fn thin_out(&mut self, thin: BTreeSet<u64>) -> Result<(), Fault> {
        thin.into_iter().try_for_each(|chunk| self.move_chunk(chunk))
    }

    /// Moves the records of a chunk of `kept` that are in the index to the end.
    fn move_chunk(&mut self, chunk: u64) -> Result<(), Fault> {
        self.take_records(chunk)?.into_iter().try_for_each(|(head, record)| self.move_record(&record, head))
    }

    /// Removes a chunk, and returns the records of it that are not forgotten.
    fn take_records(&mut self, chunk: u64) -> Result<Vec<(record::Head, Vec<u8>)>, Fault> {
        let bytes = self.take_chunk(chunk)?;
        let (mut offset, mut records) = (0, Vec::new());
        each_record(&bytes, |head, record| {
            let row = self.index.get((head.number, head.version))?.map(|row| row.value());
            if row.is_some_and(|row| (row.0, row.1 as usize) == (chunk, offset)) {
                records.push((head, record.to_vec()));
            }
            offset += record.len();
            Ok(())
        })?;
        Ok(records)
    }

    /// Lets retention come again to what was kept because a named snapshot contained it. Returns whether there is any.
    pub(super) fn unpin(&mut self, entries: &[(u64, u64)]) -> Result<bool, Fault> {
        let mut any = false;
        for entry in entries {
            let Some(row) = self.index.get(*entry)?.map(|row| row.value()) else { continue };
            if self.kept.get(row.0)?.is_some() {
                self.ages.insert((0, row.0), ())?;
                any = true;
            }
        }
        Ok(any)
    }

    /// When the newest record of a chunk arrived, ns.
    fn newest_arrival_in(&self, chunk: u64) -> Result<u64, Fault> {
        let bytes = self.chunks.get(chunk)?;
        let mut newest = 0;
        if let Some(bytes) = &bytes {
            each_record(bytes.value(), |_, record| {
                newest = newest.max(record::times(record)?.1);
                Ok(())
            })?;
        }
        Ok(newest)
    }
}

/// Passes the records of a chunk to `act`, one after the other.
pub(super) fn each_record(
    bytes: &[u8],
    mut act: impl FnMut(record::Head, &[u8]) -> Result<(), Fault>,
) -> Result<(), Fault> {
    let mut rest = bytes;
    while !rest.is_empty() {
        let head = record::head(rest)?;
        let (record, after) = rest.split_at(head.length);
        act(head, record)?;
        rest = after;
    }
    Ok(())
}
