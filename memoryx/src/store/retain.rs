//! Retention: what long-term memory forgets by age and size.
//!
//! The newest snapshot of each entity is kept, unless it is a removal, and so is the content of named snapshots. Followers
//! see forgotten snapshots as a gap in the versions; a name that is forgotten counts from 1 again.
//!
//! The work is in proportion to what is forgotten: chunks are found by their age, what stays of one is moved once, and
//! chunks of which something was forgotten are written again only when less than half of them is left. So an idle store writes
//! nothing. It is done in small parts, each a transaction, so that no commit waits long; several go to disk together, because they change
//! the same pages. A part takes one entity after the other, whose rows in the index lie together.

use std::collections::BTreeSet;

use redb::ReadableTable;

use super::error::Fault;
use super::read::row_at;
use super::record::Records;
use super::write::Writer;
use super::{LongTermMemory, RecordPlace, StoreError, record};

/// Records that one part forgets or moves. A chunk counts as at least so many.
const MAX_RECORDS: usize = 256;
const MIN_OF_CHUNK: usize = 16;
/// Parts that go to disk together.
const TOGETHER: usize = 8;

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
        if is_due {
            let pinned = self.pinned()?;
            let (mut left, mut parts) = (true, 0);
            while left {
                let part = |writer: &mut Writer<'_>, _: &_| {
                    Ok((writer.forget_some(&is_over, before, &pinned)?, true))
                };
                parts += 1;
                left = if parts % TOGETHER == 0 { self.write(part)? } else { self.write_later(part)? };
            }
            self.write(|_, _| Ok(((), true)))?;
        }
        let end = self.stats()?;
        Ok(Dropped {
            snapshots: start.snapshots.saturating_sub(end.snapshots),
            bytes: start.bytes.saturating_sub(end.bytes),
            over: (end.bytes + end.snapshots * ROW_BYTES).saturating_sub(retention.bytes.unwrap_or(u64::MAX)),
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
    /// Forgets some of what may be forgotten of the oldest chunks. Returns whether there may be more.
    fn forget_some(
        &mut self,
        is_over: &impl Fn(u64, u64) -> bool,
        before: u64,
        pinned: &Pinned,
    ) -> Result<bool, Fault> {
        self.keeps = true;
        let mut left = MAX_RECORDS;
        while left > 0 {
            let oldest = self.ages.first()?.map(|(key, _)| key.value());
            let over = is_over(self.totals.bytes, self.totals.snapshots);
            let Some((arrived_ns, chunk)) = oldest.filter(|(arrived_ns, _)| over || *arrived_ns < before)
            else {
                return Ok(false);
            };
            let newest = if arrived_ns == 0 { self.newest_arrival_in(chunk)? } else { arrived_ns };
            let done = if over || newest < before {
                self.clear(chunk, arrived_ns, before, left, pinned)?
            } else {
                self.ages.remove((arrived_ns, chunk))?;
                self.ages.insert((newest, chunk), ())?;
                0
            };
            left = left.saturating_sub(done.max(MIN_OF_CHUNK));
        }
        Ok(true)
    }

    /// Forgets or moves what is in a chunk, until so many records are done. Returns how many that were.
    fn clear(
        &mut self,
        chunk: u64,
        arrived_ns: u64,
        before: u64,
        most: usize,
        pinned: &Pinned,
    ) -> Result<usize, Fault> {
        let records = self.records_of(chunk)?;
        if !records.is_empty() {
            self.kept.insert(chunk, records.iter().map(|(_, place, _)| u64::from(place.2)).sum::<u64>())?;
        }
        let mut done = 0;
        for (head, place, record) in records {
            if done >= most {
                return Ok(done);
            }
            let is_there = |writer: &Self| row_at(&writer.index, head, chunk, place.1 as usize);
            if is_there(self)?.is_none() {
                continue;
            }
            done += self.forget_old(head, before, most - done, pinned)?;
            if done < most && is_there(self)?.is_some() {
                self.forget_entity_or_move(head, &record, pinned)?;
                self.leave(place)?;
                done += 1;
            }
        }
        if done < most {
            self.ages.remove((arrived_ns, chunk))?;
            self.remove_chunk(chunk)?;
        }
        Ok(done)
    }

    /// Forgets the versions of an entity that go with this one, at most so many: those before it that were kept as the newest, and
    /// all that are old enough, but for the newest. Returns how many.
    fn forget_old(
        &mut self,
        head: record::RecordHeader,
        before: u64,
        most: usize,
        pinned: &Pinned,
    ) -> Result<usize, Fault> {
        let mut old = Vec::new();
        let mut rows = self.index.range((head.number, 0)..=(head.number, u64::MAX))?.peekable();
        while let Some(row) = rows.next() {
            let (key, place) = row?;
            let (version, place) = (key.value().1, place.value());
            if rows.peek().is_none() || old.len() == most {
                break;
            }
            let goes = version == head.version
                || version < head.version && self.kept.get(place.0)?.is_some()
                || record::times(&self.record(place)?)?.1 < before;
            if goes && !pinned.contains(&(head.number, version)) {
                old.push(place);
            } else if !goes && version > head.version {
                break;
            }
        }
        drop(rows);
        for place in &old {
            let bytes = self.record(*place)?;
            self.forget(&bytes, record::head(&bytes)?)?;
            self.leave(*place)?;
        }
        Ok(old.len())
    }

    /// Forgets an entity of which only its removal is left, or moves a record that stays.
    fn forget_entity_or_move(
        &mut self,
        head: record::RecordHeader,
        record: &[u8],
        pinned: &Pinned,
    ) -> Result<(), Fault> {
        let mut versions = self.index.range((head.number, 0)..=(head.number, u64::MAX))?;
        let is_alone = versions.next().is_some() && versions.next().is_none();
        drop(versions);
        let goes = is_alone && record::is_removal(record) && !pinned.contains(&(head.number, head.version));
        if goes && self.forget_entity(record, head)? {
            return Ok(());
        }
        self.move_record(record, head)
    }

    /// Counts what is left of a chunk when the index has a record of it no more. What is empty is removed, and what is less than
    /// half full is the next to be written again.
    fn leave(&mut self, place: RecordPlace) -> Result<(), Fault> {
        let (chunk, bytes) = (place.0, u64::from(place.2));
        let left = match self.kept.get(chunk)?.map(|left| left.value()) {
            Some(left) => left.saturating_sub(bytes),
            None => self.records_of(chunk)?.iter().map(|(_, place, _)| u64::from(place.2)).sum(),
        };
        if left == 0 {
            return self.remove_chunk(chunk);
        }
        self.kept.insert(chunk, left)?;
        let length = self.chunks.get(chunk)?.map_or(0, |chunk| chunk.value().len() as u64);
        if 2 * left < length && 2 * (left + bytes) >= length {
            self.ages.insert((0, chunk), ())?;
        }
        Ok(())
    }

    /// The records of a chunk that are in the index.
    fn records_of(&self, chunk: u64) -> Result<Vec<(record::RecordHeader, RecordPlace, Vec<u8>)>, Fault> {
        let bytes = self.chunks.get(chunk)?;
        let bytes = bytes.as_ref().map_or(&[][..], |bytes| bytes.value());
        let mut records = Vec::new();
        for (at, record) in (Records { chunk: bytes, at: 0 }) {
            let (head, record) = record?;
            if let Some(row) = row_at(&self.index, head, chunk, at)? {
                records.push((head, row, record.to_vec()));
            }
        }
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
        let bytes = bytes.as_ref().map_or(&[][..], |bytes| bytes.value());
        let mut newest = 0;
        for (_, record) in (Records { chunk: bytes, at: 0 }) {
            newest = newest.max(record::times(record?.1)?.1);
        }
        Ok(newest)
    }
}
