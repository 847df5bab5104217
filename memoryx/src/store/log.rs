//! The log of small commits: a commit of a few snapshots is one write into a part of the file that is overwritten again and again,
//! and one sync. What is in it goes into the tables together, before anything is read from them and when it is full: a commit
//! that changes the tables alone would write a page of each of them.
//!
//! One entry after the other, from the beginning of the part, each at a multiple of 64 bytes:
//!
//! | bytes | content |
//! |---|---|
//! | 0 to 3 | the length of the entry, `u32` |
//! | 4 to 7 | CRC-32 of the rest |
//! | 8 to 15 | the round of the log: the row `log` of the table `meta` when it was written (`u64`) |
//! | 16 to 23 | how many snapshots, and how many versions that were given (`u32` each) |
//! | ... | each snapshot: the length of its entity's key (`u32`), the key, the record |
//! | ... | each version: the length of the key (`u32`; 0 for all entities that are not stored), the key, the version (`u64`) |
//!
//! The transaction that takes entries into the tables counts the round up, so that they are read no more, however it ends. An
//! entry that was not acknowledged may be there in part, and ends the log; entries behind one that is not whole show damage.

use std::sync::Arc;

use redb::StorageBackend;

use super::error::Fault;
use super::facts::{EntityCache, EntityFacts};
use super::record::{self, ByteReader, RecordError};
use crate::entity::{EntityId, Snapshot};

/// Where the part of the file begins, behind its head, and its length.
pub(super) const LOG_AT: u64 = 4096;
pub(super) const LOG_BYTES: u64 = 256 << 10;
/// A larger commit goes into the tables at once: there it costs little more than its bytes.
const MAX_ENTRY: usize = record::BLOB_FROM;
const ENTRY_HEAD: usize = 24;
const ALIGNMENT: usize = 64;

/// The last version that may have been given: to an entity, or with `None` to any that is not stored.
pub(super) type Given = (Option<EntityId>, u64);

/// Snapshots, and versions that may have been given.
#[derive(Debug, Default)]
pub(super) struct Stored {
    pub(super) snapshots: Vec<Arc<Snapshot>>,
    pub(super) given: Vec<Given>,
}

impl Stored {
    pub(super) fn extend(&mut self, snapshots: &[Arc<Snapshot>], given: &[Given]) {
        self.snapshots.extend_from_slice(snapshots);
        self.given.extend_from_slice(given);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.snapshots.is_empty() && self.given.is_empty()
    }
}

/// The log of an open file.
#[derive(Debug)]
pub(super) struct Log {
    file: Arc<dyn StorageBackend>,
    round: u64,
    /// Where the next entry goes.
    pub(super) end: usize,
    /// What the entries hold, and what they change of the facts about entities.
    pub(super) stored: Stored,
    known: EntityCache,
    /// Whether entries behind these are lost.
    pub(super) is_damaged: bool,
}

impl Log {
    /// Reads the entries of a round. Past damage only if that is asked for.
    pub(super) fn read(file: Arc<dyn StorageBackend>, round: u64, salvages: bool) -> Result<Self, Fault> {
        let mut bytes = vec![0; LOG_BYTES as usize];
        file.read(LOG_AT, &mut bytes).map_err(redb::StorageError::from)?;
        let (stored, known) = (Stored::default(), EntityCache::new());
        let mut log = Self { file, round, end: 0, stored, known, is_damaged: false };
        while let Some(length) = entry_at(&bytes, log.end, round) {
            read_entry(&bytes[log.end..log.end + length], &mut log.stored)?;
            log.end = (log.end + length).next_multiple_of(ALIGNMENT);
        }
        // Whoever salvages reads no further either, because what is behind comes after what is lost.
        let mut behind = (log.end..bytes.len()).step_by(ALIGNMENT);
        log.is_damaged = behind.any(|at| entry_at(&bytes, at, round).is_some());
        if log.is_damaged && !salvages {
            return Err(RecordError::Log { at: log.end }.into());
        }
        if !log.is_damaged && is_cut(&bytes, log.end, round) {
            tracing::warn!(
                "the last commit before the end was not completed, or is damaged: it is left out of long-term memory"
            );
        }
        Ok(log)
    }

    /// Appends a commit whose snapshots are all newer than what is stored of their entities, and syncs it. Returns false, and
    /// changes nothing, where the tables have to be looked at or the commit is too large.
    pub(super) fn append(
        &mut self,
        snapshots: &[Arc<Snapshot>],
        given: &[Given],
        memo: &EntityCache,
    ) -> Result<bool, Fault> {
        let Some((entry, known)) = self.entry(snapshots, given, memo) else { return Ok(false) };
        let written = self.file.write(LOG_AT + self.end as u64, &entry).and_then(|()| self.file.sync_data());
        written.map_err(redb::StorageError::from)?;
        self.end = (self.end + entry.len()).next_multiple_of(ALIGNMENT);
        self.known.extend(known);
        self.stored.extend(snapshots, given);
        Ok(true)
    }

    /// The bytes of a commit, and the facts about its entities afterwards.
    fn entry(
        &self,
        snapshots: &[Arc<Snapshot>],
        given: &[Given],
        memo: &EntityCache,
    ) -> Option<(Vec<u8>, EntityCache)> {
        let mut entry = vec![0; 8];
        entry.extend_from_slice(&self.round.to_le_bytes());
        for count in [snapshots.len(), given.len()] {
            entry.extend_from_slice(&u32::try_from(count).ok()?.to_le_bytes());
        }
        let mut known = EntityCache::new();
        for snapshot in snapshots {
            let facts = known.get(&snapshot.id).or_else(|| self.known.get(&snapshot.id));
            let facts = *facts.or_else(|| memo.get(&snapshot.id))?;
            if snapshot.version <= facts.newest {
                return None;
            }
            put_key(&mut entry, Some(&snapshot.id));
            let mut blobs = Vec::new();
            record::append(&mut entry, facts.number, snapshot, &mut blobs);
            if !blobs.is_empty() || entry.len() > MAX_ENTRY {
                return None;
            }
            known.insert(snapshot.id.clone(), EntityFacts { newest: snapshot.version, ..facts });
        }
        for (id, version) in given {
            put_key(&mut entry, id.as_ref());
            entry.extend_from_slice(&version.to_le_bytes());
        }
        let length = u32::try_from(entry.len()).ok()?;
        let has_room = entry.len() <= MAX_ENTRY && self.end + entry.len() <= LOG_BYTES as usize;
        let sum = crc32fast::hash(&entry[8..]);
        entry[..4].copy_from_slice(&length.to_le_bytes());
        entry[4..8].copy_from_slice(&sum.to_le_bytes());
        has_room.then_some((entry, known))
    }

    /// The round after this one.
    pub(super) fn next_round(&self) -> u64 {
        self.round + 1
    }

    /// Begins the next round: the tables have what was in this one.
    pub(super) fn begin(&mut self, round: u64) {
        (self.round, self.end) = (round, 0);
        self.stored = Stored::default();
        self.known.clear();
    }
}

/// So many bytes from a place.
fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Whether an entry of this round, whole or not, is at a place.
fn is_begun(bytes: &[u8], at: usize, round: u64) -> bool {
    let is_empty = array(bytes, at).is_none_or(|length| length == [0; 4]);
    !is_empty && array(bytes, at + 8).is_some_and(|found| u64::from_le_bytes(found) == round)
}

/// Whether a place has an entry of this round that is not whole: it says this round, or would be whole if it did.
pub(super) fn is_cut(bytes: &[u8], at: usize, round: u64) -> bool {
    let mut entry = bytes.get(at..).unwrap_or_default().to_vec();
    if let Some(place) = entry.get_mut(8..16) {
        place.copy_from_slice(&round.to_le_bytes());
    }
    is_begun(bytes, at, round) || entry_at(&entry, 0, round).is_some()
}

/// The length of the entry at a place, if a whole one of this round is there.
fn entry_at(bytes: &[u8], at: usize, round: u64) -> Option<usize> {
    if !is_begun(bytes, at, round) {
        return None;
    }
    let length = u32::from_le_bytes(array(bytes, at)?) as usize;
    let content = bytes.get(at + 8..at.checked_add(length)?)?;
    let is_whole = length >= ENTRY_HEAD && array(bytes, at + 4)? == crc32fast::hash(content).to_le_bytes();
    is_whole.then_some(length)
}

/// Appends an entity's key with its length before it; without an entity, the length 0.
fn put_key(to: &mut Vec<u8>, id: Option<&EntityId>) {
    let key = id.map(record::entity_key).unwrap_or_default();
    to.extend_from_slice(&u32::try_from(key.len()).unwrap_or(u32::MAX).to_le_bytes());
    to.extend_from_slice(&key);
}

/// Adds what a whole entry holds.
fn read_entry(entry: &[u8], to: &mut Stored) -> Result<(), RecordError> {
    let mut cursor = ByteReader { rest: entry.get(16..).ok_or(RecordError::Short)? };
    let (snapshots, given) = (cursor.u32()?, cursor.u32()?);
    for _ in 0..snapshots {
        let length = cursor.u32()? as usize;
        let id = record::entity_of(cursor.take(length)?)?;
        let head = record::head(cursor.rest)?;
        let no_blobs = |_: &record::Hash| Err(RecordError::NoBlob);
        to.snapshots.push(Arc::new(record::decode(&id, head, cursor.take(head.length)?, &no_blobs)?));
    }
    for _ in 0..given {
        let id = match cursor.u32()? as usize {
            0 => None,
            length => Some(record::entity_of(cursor.take(length)?)?),
        };
        to.given.push((id, cursor.u64()?));
    }
    Ok(())
}
