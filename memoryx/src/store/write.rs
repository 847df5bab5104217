//! Storing snapshots: one transaction per group, whose records are written one after the other into chunks.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use parking_lot::MutexGuard;
use redb::{Durability, ReadableTable, Table, WriteTransaction};

use super::error::Fault;
use super::facts::{EntityCache, EntityFacts, MAX_CACHED};
use super::log::Given;
use super::record::{self, Hash};
use super::{
    AGES, BLOB_USES, BLOBS, CHUNKS, ENTITIES, FORMAT, GIVEN, INDEX, KEPT, LongTermMemory, META, NAMED,
    REMOVED, RecordPlace, StoreError,
};
use crate::entity::{EntityId, Snapshot};

/// Most bytes of a chunk with several records: with its overhead it fills a page of 64 kB.
const MAX_CHUNK_BYTES: usize = 65_000;
/// Records that arrived further apart than this, ns, are in different chunks, because retention forgets a chunk at once.
const MAX_CHUNK_NS: u64 = 1_000_000_000;
/// The key in the table `given` of all entities that are not stored.
pub(super) const OF_OTHERS: u64 = u64::MAX;
/// The numbers in the table `meta`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Totals {
    pub(super) next_entity: u64,
    pub(super) next_chunk: u64,
    pub(super) snapshots: u64,
    /// Bytes of chunks and blobs.
    pub(super) bytes: u64,
    /// The round of the log.
    pub(super) round: u64,
}

impl Totals {
    const NAMES: [&str; 5] = ["next_entity", "next_chunk", "snapshots", "bytes", "log"];

    pub(super) fn read(meta: &impl ReadableTable<&'static str, u64>) -> Result<Self, redb::StorageError> {
        let mut numbers = [0; Self::NAMES.len()];
        for (name, to) in Self::NAMES.into_iter().zip(&mut numbers) {
            *to = meta.get(name)?.map_or(0, |v| v.value());
        }
        let [next_entity, next_chunk, snapshots, bytes, round] = numbers;
        Ok(Self { next_entity, next_chunk, snapshots, bytes, round })
    }

    fn write(self, meta: &mut Table<'_, &'static str, u64>) -> Result<(), redb::StorageError> {
        let numbers = [self.next_entity, self.next_chunk, self.snapshots, self.bytes, self.round];
        for (name, number) in Self::NAMES.into_iter().zip(numbers) {
            meta.insert(name, number)?;
        }
        Ok(())
    }
}

/// Writes within one transaction.
pub(super) struct Writer<'t> {
    meta: Table<'t, &'static str, u64>,
    entities: Table<'t, &'static [u8], (u64, bool)>,
    pub(super) index: Table<'t, (u64, u64), RecordPlace>,
    pub(super) chunks: Table<'t, u64, &'static [u8]>,
    blobs: Table<'t, &'static [u8], &'static [u8]>,
    blob_uses: Table<'t, &'static [u8], u64>,
    pub(super) ages: Table<'t, (u64, u64), ()>,
    pub(super) kept: Table<'t, u64, u64>,
    removed: Table<'t, u64, &'static [u8]>,
    given: Table<'t, u64, u64>,
    pub(super) named: Table<'t, &'static str, &'static [u8]>,
    pub(super) totals: Totals,
    /// The chunk that is being filled; its number is `totals.next_chunk`.
    open: Vec<u8>,
    /// When the newest record in it arrived, ns.
    newest_arrival: u64,
    /// Whether the open chunk is one of `kept`.
    pub(super) keeps: bool,
    /// Whether entities were forgotten.
    forgets: bool,
    /// What this transaction has changed.
    pub(super) known: EntityCache,
}

impl<'t> Writer<'t> {
    pub(super) fn new(transaction: &'t WriteTransaction) -> Result<Self, Fault> {
        let meta = transaction.open_table(META)?;
        let totals = Totals::read(&meta)?;
        Ok(Self {
            meta,
            entities: transaction.open_table(ENTITIES)?,
            index: transaction.open_table(INDEX)?,
            chunks: transaction.open_table(CHUNKS)?,
            blobs: transaction.open_table(BLOBS)?,
            blob_uses: transaction.open_table(BLOB_USES)?,
            ages: transaction.open_table(AGES)?,
            kept: transaction.open_table(KEPT)?,
            removed: transaction.open_table(REMOVED)?,
            given: transaction.open_table(GIVEN)?,
            named: transaction.open_table(NAMED)?,
            totals,
            open: Vec::with_capacity(MAX_CHUNK_BYTES),
            newest_arrival: 0,
            keeps: false,
            forgets: false,
            known: EntityCache::new(),
        })
    }

    /// Makes the tables that are not there yet. Retention comes to all chunks that are there.
    pub(super) fn set_up(transaction: &'t WriteTransaction) -> Result<(), Fault> {
        let mut writer = Self::new(transaction)?;
        writer.meta.insert("format", FORMAT)?;
        for row in writer.chunks.iter()? {
            writer.ages.insert((0, row?.0.value()), ())?;
        }
        Ok(())
    }

    /// The facts about an entity; a new entity gets a number.
    fn know(&mut self, id: &EntityId, memo: &EntityCache) -> Result<EntityFacts, Fault> {
        if let Some(known) = self.known.get(id).or_else(|| memo.get(id)) {
            return Ok(*known);
        }
        let key = record::entity_key(id);
        let held = self.entities.get(key.as_slice())?.map(|v| v.value());
        let Some((number, ordered)) = held else {
            let number = self.totals.next_entity;
            self.totals.next_entity += 1;
            self.entities.insert(key.as_slice(), (number, true))?;
            return Ok(EntityFacts { number, newest: 0, newest_referenced_ns: 0, ordered: true });
        };
        let mut rows = self.index.range((number, 0)..=(number, u64::MAX))?;
        let newest = rows.next_back().transpose()?;
        let (newest, referenced) = newest.map_or((0, 0), |(key, row)| (key.value().1, row.value().3));
        Ok(EntityFacts { number, newest, newest_referenced_ns: referenced, ordered })
    }

    /// Whether a version of an entity is stored.
    pub(super) fn holds(&mut self, id: &EntityId, version: u64, memo: &EntityCache) -> Result<bool, Fault> {
        let number = self.know(id, memo)?.number;
        Ok(self.index.get((number, version))?.is_some())
    }

    /// Adds snapshots, and notes versions that were given. Returns how many snapshots are new.
    fn add_all(
        &mut self,
        snapshots: &[Arc<Snapshot>],
        given: &[Given],
        memo: &EntityCache,
        others_write: bool,
    ) -> Result<usize, Fault> {
        let mut new = 0;
        for snapshot in snapshots {
            new += usize::from(self.add(snapshot, memo, others_write)?);
        }
        for (id, version) in given {
            let number =
                id.as_ref().map_or(Ok(OF_OTHERS), |id| self.know(id, memo).map(|known| known.number))?;
            self.given.insert(number, version)?;
        }
        Ok(new)
    }

    /// Adds a snapshot unless it is already stored; where others write too, behind what they have stored meanwhile. Returns
    /// whether it is new.
    pub(super) fn add(
        &mut self,
        snapshot: &Snapshot,
        memo: &EntityCache,
        others_write: bool,
    ) -> Result<bool, Fault> {
        let mut known = self.know(&snapshot.id, memo)?;
        let (start, mut blobs) = (self.open.len(), Vec::new());
        record::append(&mut self.open, known.number, snapshot, &mut blobs);
        let length = self.open.len() - start;
        let is_newer = snapshot.version > known.newest;
        if !is_newer {
            let row = self.index.get((known.number, snapshot.version))?.map(|r| r.value());
            let is_same =
                row.map_or(Ok(false), |row| self.record(row).map(|old| old == self.open[start..]))?;
            if row.is_some() || others_write {
                self.open.truncate(start);
            }
            match row {
                _ if is_same => return Ok(false),
                _ if others_write => {
                    let version = known.newest.saturating_add(1);
                    return self.add(&Snapshot { version, ..snapshot.clone() }, memo, false);
                }
                Some(_) => {
                    let (id, version) = (snapshot.id.to_string(), snapshot.version);
                    return Err(StoreError::Version { id, version }.into());
                }
                None => {}
            }
        }
        let ordered = is_newer && snapshot.referenced_ns >= known.newest_referenced_ns;
        if known.ordered && !ordered {
            known.ordered = false;
            let key = record::entity_key(&snapshot.id);
            self.entities.insert(key.as_slice(), (known.number, false))?;
        }
        if is_newer {
            (known.newest, known.newest_referenced_ns) = (snapshot.version, snapshot.referenced_ns);
        }
        let is_later = snapshot.arrived_ns > self.newest_arrival.saturating_add(MAX_CHUNK_NS);
        if (self.open.len() > MAX_CHUNK_BYTES || is_later) && start > 0 {
            let record = self.open.split_off(start);
            self.close_chunk()?;
            self.open.extend_from_slice(&record);
        }
        self.newest_arrival = self.newest_arrival.max(snapshot.arrived_ns);
        self.note(known.number, snapshot.version, length, snapshot.referenced_ns)?;
        if snapshot.is_removed() {
            self.removed.insert(known.number, record::entity_key(&snapshot.id).as_slice())?;
        }
        for (hash, content) in blobs {
            self.use_blob(&hash, content)?;
        }
        self.known.insert(snapshot.id.clone(), known);
        self.totals.snapshots += 1;
        Ok(true)
    }

    /// Adds the last `length` bytes of the open chunk to the index.
    fn note(&mut self, number: u64, version: u64, length: usize, referenced_ns: u64) -> Result<(), Fault> {
        let place = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let row = (self.totals.next_chunk, place(self.open.len() - length), place(length), referenced_ns);
        self.index.insert((number, version), row)?;
        Ok(())
    }

    /// Moves a record to the end.
    pub(super) fn move_record(&mut self, record: &[u8], head: record::RecordHeader) -> Result<(), Fault> {
        if !self.open.is_empty() && self.open.len() + record.len() > MAX_CHUNK_BYTES {
            self.close_chunk()?;
        }
        self.open.extend_from_slice(record);
        let (referenced_ns, arrived_ns) = record::times(record)?;
        self.newest_arrival = self.newest_arrival.max(arrived_ns);
        self.note(head.number, head.version, record.len(), referenced_ns)
    }

    pub(super) fn close_chunk(&mut self) -> Result<(), Fault> {
        if !self.open.is_empty() {
            self.chunks.insert(self.totals.next_chunk, self.open.as_slice())?;
            if self.keeps {
                self.kept.insert(self.totals.next_chunk, self.open.len() as u64)?;
            } else {
                self.ages.insert((self.newest_arrival, self.totals.next_chunk), ())?;
            }
            self.totals.next_chunk += 1;
            self.totals.bytes += self.open.len() as u64;
            self.open.clear();
            self.newest_arrival = 0;
        }
        Ok(())
    }

    /// The bytes of a record in a stored chunk, or in the open one.
    pub(super) fn record(&self, row: RecordPlace) -> Result<Vec<u8>, Fault> {
        let range = row.1 as usize..row.1 as usize + row.2 as usize;
        let missing = || Fault::no_record(row);
        if row.0 == self.totals.next_chunk {
            return self.open.get(range).map(<[u8]>::to_vec).ok_or_else(missing);
        }
        let chunk = self.chunks.get(row.0)?.ok_or_else(missing)?;
        chunk.value().get(range).map(<[u8]>::to_vec).ok_or_else(missing)
    }

    fn use_blob(&mut self, hash: &Hash, content: &[u8]) -> Result<(), Fault> {
        let uses = self.blob_uses.get(hash.as_slice())?.map_or(0, |v| v.value());
        if uses == 0 {
            self.blobs.insert(hash.as_slice(), content)?;
            self.totals.bytes += content.len() as u64;
        }
        self.blob_uses.insert(hash.as_slice(), uses + 1)?;
        Ok(())
    }

    /// Removes a record, and the blobs that no other record refers to.
    pub(super) fn forget(&mut self, bytes: &[u8], head: record::RecordHeader) -> Result<(), Fault> {
        self.index.remove((head.number, head.version))?;
        self.totals.snapshots = self.totals.snapshots.saturating_sub(1);
        for hash in record::blobs_of(bytes, head)? {
            let uses = self.blob_uses.get(hash.as_slice())?.map_or(0, |v| v.value());
            if uses > 1 {
                self.blob_uses.insert(hash.as_slice(), uses - 1)?;
                continue;
            }
            self.blob_uses.remove(hash.as_slice())?;
            let freed = self.blobs.remove(hash.as_slice())?.map_or(0, |v| v.value().len());
            self.totals.bytes = self.totals.bytes.saturating_sub(freed as u64);
        }
        Ok(())
    }

    /// Removes an entity whose only record is its removal, with that record. Returns false if its key is not known.
    pub(super) fn forget_entity(&mut self, bytes: &[u8], head: record::RecordHeader) -> Result<bool, Fault> {
        let Some(key) = self.removed.remove(head.number)?.map(|key| key.value().to_vec()) else {
            return Ok(false);
        };
        self.forget(bytes, head)?;
        self.entities.remove(key.as_slice())?;
        self.given.remove(head.number)?;
        self.forgets = true;
        Ok(true)
    }

    /// Removes a chunk of which nothing is in the index.
    pub(super) fn remove_chunk(&mut self, chunk: u64) -> Result<(), Fault> {
        let length = self.chunks.remove(chunk)?.map_or(0, |removed| removed.value().len());
        self.kept.remove(chunk)?;
        self.totals.bytes = self.totals.bytes.saturating_sub(length as u64);
        Ok(())
    }

    /// Writes the last chunk and the totals; returns the facts learned about entities, and whether facts about others are
    /// no longer true.
    pub(super) fn finish(mut self) -> Result<(EntityCache, bool), Fault> {
        self.close_chunk()?;
        self.totals.write(&mut self.meta)?;
        Ok((self.known, self.forgets))
    }
}

impl LongTermMemory {
    /// Stores snapshots, all or none; they are on disk when this returns. Snapshots that are already stored stay
    /// unchanged. Returns how many are new.
    ///
    /// # Errors
    /// [`StoreError::Version`] when another snapshot has the same version, in a file that is not shared;
    /// [`StoreError::Full`] and others when the disk fails.
    pub fn persist(&self, snapshots: &[Arc<Snapshot>]) -> Result<usize, StoreError> {
        self.persist_with(snapshots, &[])
    }

    /// As [`Self::persist`]; also notes the last versions that may have been given. Not where several processes write: there a
    /// version counts once it is stored.
    pub(super) fn persist_with(
        &self,
        snapshots: &[Arc<Snapshot>],
        given: &[Given],
    ) -> Result<usize, StoreError> {
        let given = if self.shared { &[] } else { given };
        if snapshots.is_empty() && given.is_empty() {
            return Ok(0);
        }
        let mut memo = self.memo.lock();
        let stored = match self.append(snapshots, given, &memo) {
            Ok(true) => {
                self.journal(snapshots, given);
                Ok(snapshots.len())
            }
            Ok(false) => self.write_in(&mut memo, Durability::Immediate, |writer, memo| {
                let new = writer.add_all(snapshots, given, memo, self.shared)?;
                self.journal(snapshots, given);
                Ok((new, new > 0 || !given.is_empty()))
            }),
            Err(error) => {
                *self.journal.lock() = None;
                Err(error)
            }
        };
        MutexGuard::unlock_fair(memo);
        stored
    }

    /// Appends a commit to the log. Returns whether it belongs there.
    fn append(
        &self,
        snapshots: &[Arc<Snapshot>],
        given: &[Given],
        memo: &EntityCache,
    ) -> Result<bool, StoreError> {
        if self.shared {
            return Ok(false);
        }
        self.with(|file| {
            let Some(log) = &mut *file.log.lock() else { return Ok(false) };
            let is_logged = log.append(snapshots, given, memo)?;
            file.is_logged.fetch_or(is_logged, Ordering::AcqRel);
            Ok(is_logged)
        })
    }

    /// Takes what is in the log into the tables.
    pub(super) fn take_log(&self, memo: &mut EntityCache) -> Result<(), StoreError> {
        self.write_in(memo, Durability::Immediate, |_, _| Ok(((), false)))
    }

    /// Changes the file in one transaction, unless `act` returns that nothing has changed.
    pub(super) fn write<T>(
        &self,
        act: impl FnOnce(&mut Writer<'_>, &EntityCache) -> Result<(T, bool), Fault>,
    ) -> Result<T, StoreError> {
        self.write_as(Durability::Immediate, act)
    }

    /// As [`Self::write`], but it is on disk only together with the next transaction that is, whoever makes that.
    pub(super) fn write_later<T>(
        &self,
        act: impl FnOnce(&mut Writer<'_>, &EntityCache) -> Result<(T, bool), Fault>,
    ) -> Result<T, StoreError> {
        self.write_as(Durability::None, act)
    }

    fn write_as<T>(
        &self,
        durability: Durability,
        act: impl FnOnce(&mut Writer<'_>, &EntityCache) -> Result<(T, bool), Fault>,
    ) -> Result<T, StoreError> {
        let mut memo = self.memo.lock();
        let written = self.write_in(&mut memo, durability, act);
        // Whoever changes much, part by part, lets a commit that waits come in between.
        MutexGuard::unlock_fair(memo);
        written
    }

    /// As [`Self::write`]. What is in the log goes into the tables before.
    fn write_in<T>(
        &self,
        memo: &mut EntityCache,
        durability: Durability,
        act: impl FnOnce(&mut Writer<'_>, &EntityCache) -> Result<(T, bool), Fault>,
    ) -> Result<T, StoreError> {
        if self.shared {
            // Others have written since.
            memo.clear();
        }
        let written = self.with(|file| {
            let mut log = file.log.lock();
            let log = log.as_mut().filter(|log| !log.stored.is_empty());
            let mut transaction = file.database.begin_write()?;
            // What is in the log is written over as soon as the tables have it, and so they have it on disk.
            if log.is_none() && matches!(durability, Durability::None) {
                transaction.set_durability(Durability::None)?;
            } else {
                // So the file is opened at once after a kill.
                transaction.set_quick_repair(true);
            }
            let mut writer = Writer::new(&transaction)?;
            if let Some(log) = &log {
                writer.add_all(&log.stored.snapshots, &log.stored.given, memo, self.shared)?;
                writer.totals.round = log.next_round();
            }
            let (result, changed) = act(&mut writer, memo)?;
            if !changed && log.is_none() {
                return Ok((result, EntityCache::new(), false));
            }
            let round = writer.totals.round;
            let (known, forgets) = writer.finish()?;
            transaction.commit()?;
            if let Some(log) = log {
                log.begin(round);
                file.is_logged.store(false, Ordering::Release);
            }
            Ok((result, known, forgets))
        });
        match written {
            Ok((result, known, forgets)) => {
                if forgets || memo.len() + known.len() > MAX_CACHED {
                    memo.clear();
                }
                if known.len() <= MAX_CACHED {
                    memo.extend(known);
                }
                Ok(result)
            }
            Err(error) => {
                memo.clear();
                // Whoever makes a copy would not know whether this is in it.
                *self.journal.lock() = None;
                Err(error)
            }
        }
    }
}
