//! Storing snapshots: one transaction per group, whose records are written one after the other into chunks.

use std::sync::Arc;

use indexmap::IndexMap;
use redb::{ReadableTable, Table, WriteTransaction};

use super::record::{self, Hash};
use super::{BLOB_USES, BLOBS, CHUNKS, ENTITIES, INDEX, LongTermMemory, META, NAMED, Row, StoreError};
use crate::entity::{EntityId, Snapshot};

/// Most bytes of a chunk with several records: with its overhead it fills a page of 64 kB.
const CHUNK: usize = 65_000;
/// Most entities in the cache.
const REMEMBERED: usize = 100_000;

/// Cached facts about an entity.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known {
    pub(super) number: u64,
    /// 0 when nothing is kept.
    pub(super) newest: u64,
    pub(super) newest_referenced_ns: u64,
    /// Whether referenced times never decrease from version to version.
    pub(super) ordered: bool,
}

/// The entities that were written recently.
pub(super) type Memo = IndexMap<EntityId, Known>;

/// The numbers in the table `meta`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Totals {
    pub(super) next_entity: u64,
    pub(super) next_chunk: u64,
    pub(super) snapshots: u64,
    /// Bytes of chunks and blobs.
    pub(super) bytes: u64,
}

impl Totals {
    const NAMES: [&str; 4] = ["next_entity", "next_chunk", "snapshots", "bytes"];

    pub(super) fn read(meta: &impl ReadableTable<&'static str, u64>) -> Result<Self, redb::StorageError> {
        let [mut a, mut b, mut c, mut d] = [0; 4];
        for (name, to) in Self::NAMES.into_iter().zip([&mut a, &mut b, &mut c, &mut d]) {
            *to = meta.get(name)?.map_or(0, |v| v.value());
        }
        Ok(Self { next_entity: a, next_chunk: b, snapshots: c, bytes: d })
    }

    fn write(self, meta: &mut Table<'_, &'static str, u64>) -> Result<(), redb::StorageError> {
        let numbers = [self.next_entity, self.next_chunk, self.snapshots, self.bytes];
        for (name, number) in Self::NAMES.into_iter().zip(numbers) {
            meta.insert(name, number)?;
        }
        Ok(())
    }
}

/// Writes within one transaction.
pub(super) struct Writer<'t> {
    store: &'t LongTermMemory,
    meta: Table<'t, &'static str, u64>,
    entities: Table<'t, &'static [u8], (u64, bool)>,
    pub(super) index: Table<'t, (u64, u64), Row>,
    pub(super) chunks: Table<'t, u64, &'static [u8]>,
    blobs: Table<'t, &'static [u8], &'static [u8]>,
    blob_uses: Table<'t, &'static [u8], u64>,
    named: Table<'t, &'static str, &'static [u8]>,
    pub(super) totals: Totals,
    /// The chunk that is being filled; its number is `totals.next_chunk`.
    open: Vec<u8>,
    /// What this transaction has changed.
    pub(super) known: Memo,
}

impl<'t> Writer<'t> {
    pub(super) fn new(
        store: &'t LongTermMemory,
        transaction: &'t WriteTransaction,
    ) -> Result<Self, StoreError> {
        let open = || -> Result<Self, redb::Error> {
            let meta = transaction.open_table(META)?;
            let totals = Totals::read(&meta)?;
            Ok(Self {
                store,
                meta,
                entities: transaction.open_table(ENTITIES)?,
                index: transaction.open_table(INDEX)?,
                chunks: transaction.open_table(CHUNKS)?,
                blobs: transaction.open_table(BLOBS)?,
                blob_uses: transaction.open_table(BLOB_USES)?,
                named: transaction.open_table(NAMED)?,
                totals,
                open: Vec::with_capacity(CHUNK),
                known: Memo::new(),
            })
        };
        open().map_err(|e| store.fault(e))
    }

    /// The facts about an entity; a new entity gets a number.
    fn know(&mut self, id: &EntityId, memo: &Memo) -> Result<Known, StoreError> {
        if let Some(known) = self.known.get(id).or_else(|| memo.get(id)) {
            return Ok(*known);
        }
        let key = record::entity_key(id);
        let store = self.store;
        let held = self.entities.get(key.as_slice()).map_err(|e| store.fault(e))?.map(|v| v.value());
        let Some((number, ordered)) = held else {
            let number = self.totals.next_entity;
            self.totals.next_entity += 1;
            self.entities.insert(key.as_slice(), (number, true)).map_err(|e| store.fault(e))?;
            return Ok(Known { number, newest: 0, newest_referenced_ns: 0, ordered: true });
        };
        let mut rows = self.index.range((number, 0)..=(number, u64::MAX)).map_err(|e| store.fault(e))?;
        let newest = rows.next_back().transpose().map_err(|e| store.fault(e))?;
        let (newest, referenced) = newest.map_or((0, 0), |(key, row)| (key.value().1, row.value().3));
        Ok(Known { number, newest, newest_referenced_ns: referenced, ordered })
    }

    /// The number of an entity, unique in the file.
    pub(super) fn number(&mut self, id: &EntityId, memo: &Memo) -> Result<u64, StoreError> {
        Ok(self.know(id, memo)?.number)
    }

    /// Whether a version of an entity is stored.
    pub(super) fn holds(&mut self, id: &EntityId, version: u64, memo: &Memo) -> Result<bool, StoreError> {
        let number = self.know(id, memo)?.number;
        let row = self.index.get((number, version)).map_err(|e| self.store.fault(e))?;
        Ok(row.is_some())
    }

    /// Adds a snapshot unless it is already stored. Returns whether it is new.
    pub(super) fn add(&mut self, snapshot: &Snapshot, memo: &Memo) -> Result<bool, StoreError> {
        let mut known = self.know(&snapshot.id, memo)?;
        let store = self.store;
        let fault = |e: redb::StorageError| store.fault(e);
        let (start, mut blobs) = (self.open.len(), Vec::new());
        record::append(&mut self.open, known.number, snapshot, &mut blobs);
        let length = self.open.len() - start;
        let is_newer = snapshot.version > known.newest;
        if !is_newer {
            let row = self.index.get((known.number, snapshot.version)).map_err(fault)?.map(|r| r.value());
            if let Some(row) = row {
                let is_same = self.record(row)? == self.open[start..];
                self.open.truncate(start);
                let (id, version) = (snapshot.id.to_string(), snapshot.version);
                return if is_same { Ok(false) } else { Err(StoreError::Version { id, version }) };
            }
        }
        let ordered = is_newer && snapshot.referenced_ns >= known.newest_referenced_ns;
        if known.ordered && !ordered {
            known.ordered = false;
            let key = record::entity_key(&snapshot.id);
            self.entities.insert(key.as_slice(), (known.number, false)).map_err(fault)?;
        }
        if is_newer {
            (known.newest, known.newest_referenced_ns) = (snapshot.version, snapshot.referenced_ns);
        }
        if self.open.len() > CHUNK && start > 0 {
            let record = self.open.split_off(start);
            self.close_chunk()?;
            self.open.extend_from_slice(&record);
        }
        self.note(known.number, snapshot.version, length, snapshot.referenced_ns)?;
        for (hash, content) in blobs {
            self.use_blob(&hash, content)?;
        }
        self.known.insert(snapshot.id.clone(), known);
        self.totals.snapshots += 1;
        Ok(true)
    }

    /// Adds the last `length` bytes of the open chunk to the index.
    fn note(
        &mut self,
        number: u64,
        version: u64,
        length: usize,
        referenced_ns: u64,
    ) -> Result<(), StoreError> {
        let place = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let row = (self.totals.next_chunk, place(self.open.len() - length), place(length), referenced_ns);
        self.index.insert((number, version), row).map_err(|e| self.store.fault(e))?;
        Ok(())
    }

    /// Moves a record to the end.
    pub(super) fn move_record(&mut self, record: &[u8], head: record::Head) -> Result<(), StoreError> {
        self.make_room(record.len())?;
        self.open.extend_from_slice(record);
        let (referenced_ns, _) = record::times(record).map_err(|what| self.store.damaged(what))?;
        self.note(head.number, head.version, record.len(), referenced_ns)
    }

    fn make_room(&mut self, bytes: usize) -> Result<(), StoreError> {
        if !self.open.is_empty() && self.open.len() + bytes > CHUNK { self.close_chunk() } else { Ok(()) }
    }

    fn close_chunk(&mut self) -> Result<(), StoreError> {
        if !self.open.is_empty() {
            let inserted = self.chunks.insert(self.totals.next_chunk, self.open.as_slice());
            inserted.map_err(|e| self.store.fault(e))?;
            self.totals.next_chunk += 1;
            self.totals.bytes += self.open.len() as u64;
            self.open.clear();
        }
        Ok(())
    }

    /// The bytes of a record in a stored chunk, or in the open one.
    fn record(&self, row: Row) -> Result<Vec<u8>, StoreError> {
        let range = row.1 as usize..row.1 as usize + row.2 as usize;
        let missing = || self.store.damaged(format!("a record in chunk {} is missing", row.0));
        if row.0 == self.totals.next_chunk {
            return self.open.get(range).map(<[u8]>::to_vec).ok_or_else(missing);
        }
        let chunk = self.chunks.get(row.0).map_err(|e| self.store.fault(e))?.ok_or_else(missing)?;
        chunk.value().get(range).map(<[u8]>::to_vec).ok_or_else(missing)
    }

    fn use_blob(&mut self, hash: &Hash, content: &[u8]) -> Result<(), StoreError> {
        let store = self.store;
        let fault = |e: redb::StorageError| store.fault(e);
        let uses = self.blob_uses.get(hash.as_slice()).map_err(fault)?.map_or(0, |v| v.value());
        if uses == 0 {
            self.blobs.insert(hash.as_slice(), content).map_err(fault)?;
            self.totals.bytes += content.len() as u64;
        }
        self.blob_uses.insert(hash.as_slice(), uses + 1).map_err(fault)?;
        Ok(())
    }

    /// Removes a record, and the blobs that no other record refers to.
    pub(super) fn forget(&mut self, bytes: &[u8], head: record::Head) -> Result<(), StoreError> {
        let store = self.store;
        let fault = |e: redb::StorageError| store.fault(e);
        self.index.remove((head.number, head.version)).map_err(fault)?;
        self.totals.snapshots = self.totals.snapshots.saturating_sub(1);
        for hash in record::blobs_of(bytes, head).map_err(|what| store.damaged(what))? {
            let uses = self.blob_uses.get(hash.as_slice()).map_err(fault)?.map_or(0, |v| v.value());
            if uses > 1 {
                self.blob_uses.insert(hash.as_slice(), uses - 1).map_err(fault)?;
                continue;
            }
            self.blob_uses.remove(hash.as_slice()).map_err(fault)?;
            let freed = self.blobs.remove(hash.as_slice()).map_err(fault)?.map_or(0, |v| v.value().len());
            self.totals.bytes = self.totals.bytes.saturating_sub(freed as u64);
        }
        Ok(())
    }

    /// Stores a list under a name, or removes it. Returns whether the name existed.
    pub(super) fn name(&mut self, name: &str, list: Option<&[u8]>) -> Result<bool, StoreError> {
        let store = self.store;
        let was = match list {
            Some(list) => self.named.insert(name, list).map_err(|e| store.fault(e))?.is_some(),
            None => self.named.remove(name).map_err(|e| store.fault(e))?.is_some(),
        };
        Ok(was)
    }

    /// Removes a chunk and returns its bytes.
    pub(super) fn take_chunk(&mut self, chunk: u64) -> Result<Vec<u8>, StoreError> {
        let taken = self.chunks.remove(chunk).map_err(|e| self.store.fault(e))?;
        let bytes = taken.map(|v| v.value().to_vec()).unwrap_or_default();
        self.totals.bytes = self.totals.bytes.saturating_sub(bytes.len() as u64);
        Ok(bytes)
    }

    /// Writes the last chunk and the totals; returns the facts learned about entities.
    pub(super) fn finish(mut self) -> Result<Memo, StoreError> {
        self.close_chunk()?;
        self.totals.write(&mut self.meta).map_err(|e| self.store.fault(e))?;
        Ok(self.known)
    }
}

impl LongTermMemory {
    /// Stores snapshots, all or none; they are on disk when this returns. Snapshots that are already stored stay
    /// unchanged. Returns how many are new.
    ///
    /// # Errors
    /// [`StoreError::Version`] when another snapshot has the same version; [`StoreError::Full`] and others when the
    /// disk fails.
    pub fn persist(&self, snapshots: &[Arc<Snapshot>]) -> Result<usize, StoreError> {
        if snapshots.is_empty() {
            return Ok(0);
        }
        self.write(|writer, memo| {
            let mut new = 0;
            for snapshot in snapshots {
                new += usize::from(writer.add(snapshot, memo)?);
            }
            Ok((new, new > 0))
        })
    }

    /// Changes the file in one transaction, unless `act` returns that nothing has changed.
    pub(super) fn write<T>(
        &self,
        act: impl FnOnce(&mut Writer<'_>, &Memo) -> Result<(T, bool), StoreError>,
    ) -> Result<T, StoreError> {
        let mut memo = self.memo.lock();
        let written = self.with(|database| {
            let transaction = database.begin_write().map_err(|e| self.fault(e))?;
            let mut writer = Writer::new(self, &transaction)?;
            let (result, changed) = act(&mut writer, &memo)?;
            let known = if changed {
                Some(writer.finish()?)
            } else {
                drop(writer);
                None
            };
            match known {
                Some(known) => {
                    transaction.commit().map_err(|e| self.fault(e))?;
                    Ok((result, known))
                }
                None => Ok((result, Memo::new())),
            }
        });
        match written {
            Ok((result, known)) => {
                if memo.len() + known.len() > REMEMBERED {
                    memo.clear();
                }
                if known.len() <= REMEMBERED {
                    memo.extend(known);
                }
                Ok(result)
            }
            Err(error) => {
                memo.clear();
                Err(error)
            }
        }
    }
}
