//! Retention: what long-term memory forgets by age and size, and the joining of small chunks.
//!
//! The newest snapshot of each entity is kept, and so is the content of named snapshots. Followers see forgotten
//! snapshots as a gap in the versions.

use std::collections::BTreeSet;

use redb::{ReadableTable, ReadableTableMetadata};

use super::error::Fault;
use super::write::Writer;
use super::{LongTermMemory, StoreError, record};

/// Chunks per transaction.
const MAX_BATCH: usize = 256;
/// A chunk below this many bytes is joined with others.
const SMALL_CHUNK_BYTES: usize = 32_000;

/// How much is kept. `None` is unlimited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retention {
    /// How long after their arrival snapshots are kept, ns.
    pub age_ns: Option<u64>,
    /// Most bytes of records and blobs.
    pub bytes: Option<u64>,
}

/// What retention has removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Snapshots.
    pub snapshots: u64,
    /// Bytes of records and blobs.
    pub bytes: u64,
}

impl LongTermMemory {
    /// Removes what is older than the age, at `now_ns`, and then the oldest until the rest fits. The next
    /// [`Self::compact`] shrinks the file; until then the free space is reused.
    ///
    /// # Errors
    /// When the disk fails; snapshots removed before that stay removed.
    pub fn retain(&self, retention: Retention, now_ns: u64) -> Result<Dropped, StoreError> {
        let pinned = self.pinned()?;
        let before = retention.age_ns.map_or(0, |age| now_ns.saturating_sub(age));
        let last = self.write(|writer, _| Ok((writer.totals.next_chunk, false)))?;
        let start = self.stats()?;
        let mut from = 0;
        while let Some(next) = self.write(|writer, _| {
            let next = forget_some(writer, (from, last), retention.bytes, before, &pinned)?;
            Ok((next, true))
        })? {
            from = next;
        }
        let end = self.stats()?;
        Ok(Dropped {
            snapshots: start.snapshots.saturating_sub(end.snapshots),
            bytes: start.bytes.saturating_sub(end.bytes),
        })
    }

    /// Joins small chunks, in order. Returns whether there were any.
    pub(super) fn join_chunks(&self) -> Result<bool, StoreError> {
        let last = self.write(|writer, _| Ok((writer.totals.next_chunk, false)))?;
        let mut joined = false;
        let mut from = 0;
        loop {
            let (next, any) = self.write(|writer, _| {
                let (small, next) = small_chunks(writer, from, last)?;
                if small.len() > 1 {
                    for chunk in &small {
                        let bytes = writer.take_chunk(*chunk)?;
                        each_record(&bytes, |head, record| writer.move_record(record, head))?;
                    }
                }
                Ok(((next, small.len() > 1), small.len() > 1))
            })?;
            joined |= any;
            match next {
                Some(next) => from = next,
                None => return Ok(joined),
            }
        }
    }
}

/// Removes snapshots in at most [`MAX_BATCH`] chunks of a range, whose end is excluded. Returns where to continue.
fn forget_some(
    writer: &mut Writer<'_>,
    (from, last): (u64, u64),
    budget: Option<u64>,
    before: u64,
    pinned: &BTreeSet<(u64, u64)>,
) -> Result<Option<u64>, Fault> {
    let rows = writer.chunks.range(from..last)?;
    let mut numbers = Vec::new();
    for row in rows.take(MAX_BATCH) {
        numbers.push(row?.0.value());
    }
    for number in &numbers {
        let over = budget.is_some_and(|most| writer.totals.bytes > most);
        let bytes = writer.chunks.get(*number)?.map(|v| v.value().to_vec()).unwrap_or_default();
        let mut newest_arrival = 0;
        each_record(&bytes, |_, record| {
            let (_, arrived) = record::times(record)?;
            newest_arrival = newest_arrival.max(arrived);
            Ok(())
        })?;
        if !over && newest_arrival >= before {
            continue;
        }
        let bytes = writer.take_chunk(*number)?;
        each_record(&bytes, |head, record| {
            let last = writer.index.range((head.number, 0)..=(head.number, u64::MAX))?.next_back();
            let newest = last.transpose()?.map(|(key, _)| key.value().1);
            if newest == Some(head.version) || pinned.contains(&(head.number, head.version)) {
                writer.move_record(record, head)
            } else {
                writer.forget(record, head)
            }
        })?;
    }
    Ok(numbers.last().filter(|_| numbers.len() == MAX_BATCH).map(|n| n + 1))
}

/// Up to [`MAX_BATCH`] small chunks of a range, and where to continue.
fn small_chunks(writer: &Writer<'_>, from: u64, last: u64) -> Result<(Vec<u64>, Option<u64>), Fault> {
    if writer.chunks.len()? == 0 {
        return Ok((Vec::new(), None));
    }
    let mut small = Vec::new();
    for row in writer.chunks.range(from..last)? {
        let (number, bytes) = row?;
        if bytes.value().len() < SMALL_CHUNK_BYTES {
            small.push(number.value());
            if small.len() == MAX_BATCH {
                let next = number.value() + 1;
                return Ok((small, Some(next)));
            }
        }
    }
    Ok((small, None))
}

/// Passes the records of a chunk to `act`, one after the other.
fn each_record(
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
