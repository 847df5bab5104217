//! Queries on long-term memory: no more of the file is read than the answer needs.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Bound;
use std::sync::Arc;

use redb::{AccessGuard, ReadOnlyTable, ReadTransaction, ReadableDatabase, ReadableTable};

use super::record::{self, Hash};
use super::{BLOBS, CHUNKS, ENTITIES, INDEX, LongTermMemory, Row, StoreError};
use crate::asked::{Answer, Asked, places};
use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::query::{Pattern, Query, Times};

/// Where records are found, in one transaction.
pub(super) struct Reader<'s> {
    store: &'s LongTermMemory,
    pub(super) index: ReadOnlyTable<(u64, u64), Row>,
    pub(super) chunks: ReadOnlyTable<u64, &'static [u8]>,
    blobs: ReadOnlyTable<&'static [u8], &'static [u8]>,
    entities: ReadOnlyTable<&'static [u8], (u64, bool)>,
    /// The chunk that was read last.
    last: RefCell<Option<(u64, Chunk)>>,
}

/// The bytes of a chunk, for as long as they are looked at.
type Chunk = AccessGuard<'static, &'static [u8]>;

/// An entity in the file.
#[derive(Clone, Debug)]
pub(super) struct Entity {
    pub(super) id: EntityId,
    pub(super) number: u64,
    ordered: bool,
}

impl<'s> Reader<'s> {
    pub(super) fn new(store: &'s LongTermMemory, transaction: &ReadTransaction) -> Result<Self, StoreError> {
        let open = || -> Result<Self, redb::Error> {
            Ok(Self {
                store,
                index: transaction.open_table(INDEX)?,
                chunks: transaction.open_table(CHUNKS)?,
                blobs: transaction.open_table(BLOBS)?,
                entities: transaction.open_table(ENTITIES)?,
                last: RefCell::new(None),
            })
        };
        open().map_err(|e| store.fault(e))
    }

    /// One entity.
    pub(super) fn entity(&self, id: &EntityId) -> Result<Option<Entity>, StoreError> {
        let key = record::entity_key(id);
        let held = self.entities.get(key.as_slice()).map_err(|e| self.store.fault(e))?.map(|v| v.value());
        Ok(held.map(|(number, ordered)| Entity { id: id.clone(), number, ordered }))
    }

    /// Gives the entities that a pattern fits to `act`, in order of address, until it says that it is enough.
    pub(super) fn entities(
        &self,
        pattern: &Pattern,
        from: Option<&EntityId>,
        mut act: impl FnMut(Entity) -> Result<bool, StoreError>,
    ) -> Result<(), StoreError> {
        if let Some(id) = pattern.exact() {
            return self.entity(&id)?.map_or(Ok(()), |entity| act(entity).map(|_| ()));
        }
        let (first, to) = record::entity_range(pattern);
        let first = from.map_or(first.clone(), |id| first.max(record::entity_key(id)));
        let to = to.as_ref().map_or(Bound::Unbounded, |to| Bound::Excluded(to.as_slice()));
        let fault = |e: redb::StorageError| self.store.fault(e);
        let rows = self.entities.range::<&[u8]>((Bound::Included(first.as_slice()), to)).map_err(fault)?;
        for row in rows {
            let (key, value) = row.map_err(fault)?;
            let id = record::entity_of(key.value()).map_err(|what| self.store.damaged(what))?;
            let (number, ordered) = value.value();
            if pattern.matches(&id) && !act(Entity { id, number, ordered })? {
                break;
            }
        }
        Ok(())
    }

    /// The newest version of an entity, and where it is.
    pub(super) fn newest(&self, number: u64) -> Result<Option<(u64, Row)>, StoreError> {
        self.one(self.index.range((number, 0)..=(number, u64::MAX)).map(|mut rows| rows.next_back()))
    }

    fn one(
        &self,
        found: Result<Option<Found>, redb::StorageError>,
    ) -> Result<Option<(u64, Row)>, StoreError> {
        let row = found.and_then(Option::transpose).map_err(|e| self.store.fault(e))?;
        Ok(row.map(|(key, row)| (key.value().1, row.value())))
    }

    /// The snapshot in a place.
    pub(super) fn snapshot(&self, id: &EntityId, row: Row) -> Result<Arc<Snapshot>, StoreError> {
        let decoded = self.with_record(row, |bytes| {
            let head = record::head(bytes)?;
            record::decode(id, head, bytes, &|hash| self.blob(hash))
        })?;
        decoded.map(Arc::new).map_err(|what| self.store.damaged(what))
    }

    /// Gives the bytes in a place to `act`.
    fn with_record<T>(&self, row: Row, act: impl FnOnce(&[u8]) -> T) -> Result<T, StoreError> {
        let missing = || self.store.damaged(format!("a record in chunk {} is missing", row.0));
        let mut last = self.last.borrow_mut();
        if last.as_ref().is_none_or(|(chunk, _)| *chunk != row.0) {
            let chunk = self.chunks.get(row.0).map_err(|e| self.store.fault(e))?.ok_or_else(missing)?;
            *last = Some((row.0, chunk));
        }
        let (_, chunk) = last.as_ref().ok_or_else(missing)?;
        let range = row.1 as usize..(row.1 as usize).saturating_add(row.2 as usize);
        Ok(act(chunk.value().get(range).ok_or_else(missing)?))
    }

    pub(super) fn blob(&self, hash: &Hash) -> Result<Vec<u8>, String> {
        let found = self.blobs.get(hash.as_slice()).map_err(|e| e.to_string())?;
        found.map(|v| v.value().to_vec()).ok_or_else(|| "a large value of it is missing".into())
    }

    /// Adds what a question takes of one entity, without reading more of its history than that.
    fn select(&self, asked: &Asked<'_>, entity: &Entity, answer: &mut Answer<'_>) -> Result<(), StoreError> {
        let query = asked.query();
        let all = (0, u64::MAX);
        let one = |row: Option<(u64, Row)>| -> Result<Vec<Arc<Snapshot>>, StoreError> {
            let found = row.map(|(_, row)| self.snapshot(&entity.id, row)).transpose()?;
            Ok(asked.select(found.into_iter()))
        };
        match query.times {
            _ if query.limit == Some(0) => {}
            Times::Latest => answer.extend(one(self.newest(entity.number)?)?),
            Times::At(time) => answer.extend(one(self.held(entity, |referenced| referenced <= time)?)?),
            Times::Before(time) => answer.extend(one(self.held(entity, |referenced| referenced < time)?)?),
            Times::All if query.arrived_since.is_some() => {
                let goes_on = query.after.as_ref().is_some_and(|after| after.id == entity.id);
                let since = query.arrived_since.filter(|_| !goes_on);
                let first = since.map_or(Ok(0), |since| self.arrived(entity.number, since))?;
                self.add_range(asked, entity, (first, u64::MAX), |_| true, answer)?;
            }
            Times::All => self.add_range(asked, entity, all, |_| true, answer)?,
            Times::Versions(from, to) if from > to => {}
            Times::Versions(from, to) => self.add_range(asked, entity, (from, to), |_| true, answer)?,
            Times::Between(from, to) => {
                self.add_range(asked, entity, all, |row| (from..=to).contains(&row.3), answer)?;
            }
            Times::Index(from, to) => {
                let rows = self.last_rows(entity.number, all, usize::MAX, |_| true)?;
                let chosen = rows.get(places(from, to, rows.len())).unwrap_or_default().to_vec();
                self.add(asked, entity, chosen, answer)?;
            }
        }
        Ok(())
    }

    /// Adds versions from one to another whose rows count.
    fn add_range(
        &self,
        asked: &Asked<'_>,
        entity: &Entity,
        (from, to): (u64, u64),
        counts: impl Fn(&Row) -> bool,
        answer: &mut Answer<'_>,
    ) -> Result<(), StoreError> {
        if let Some(limit) = asked.query().limit {
            let limit = if asked.is_plain() { limit } else { usize::MAX };
            let rows = self.last_rows(entity.number, (from, to), limit, counts)?;
            return self.add(asked, entity, rows, answer);
        }
        let after = asked.query().after.as_ref().filter(|after| after.id == entity.id);
        let from = after.map_or(from, |after| from.max(after.version.saturating_add(1)));
        if from > to {
            return Ok(());
        }
        let fault = |e: redb::StorageError| self.store.fault(e);
        for row in self.index.range((entity.number, from)..=(entity.number, to)).map_err(fault)? {
            if answer.is_full() {
                break;
            }
            let row = row.map_err(fault)?.1.value();
            if counts(&row) {
                self.add_one(asked, entity, row, answer)?;
            }
        }
        Ok(())
    }

    /// Adds what is asked for of these rows, given in order of version: the newest ones where there is a limit.
    fn add(
        &self,
        asked: &Asked<'_>,
        entity: &Entity,
        mut rows: Vec<(u64, Row)>,
        answer: &mut Answer<'_>,
    ) -> Result<(), StoreError> {
        if let Some(limit) = asked.query().limit {
            let mut left = limit;
            let mut first = rows.len();
            while first > 0 && left > 0 {
                first -= 1;
                left -= usize::from(asked.fits(&*self.snapshot(&entity.id, rows[first].1)?));
            }
            rows.drain(..first);
        }
        for (_, row) in rows {
            if answer.is_full() {
                break;
            }
            self.add_one(asked, entity, row, answer)?;
        }
        Ok(())
    }

    fn add_one(
        &self,
        asked: &Asked<'_>,
        entity: &Entity,
        row: Row,
        answer: &mut Answer<'_>,
    ) -> Result<(), StoreError> {
        let snapshot = self.snapshot(&entity.id, row)?;
        if asked.fits(&snapshot) {
            answer.push(snapshot);
        }
        Ok(())
    }

    /// The last `limit` rows of an entity that count, in order of version.
    fn last_rows(
        &self,
        number: u64,
        versions: (u64, u64),
        limit: usize,
        counts: impl Fn(&Row) -> bool,
    ) -> Result<Vec<(u64, Row)>, StoreError> {
        let fault = |e: redb::StorageError| self.store.fault(e);
        let rows = self.index.range((number, versions.0)..=(number, versions.1)).map_err(fault)?;
        let mut found = Vec::new();
        for row in rows.rev() {
            let (key, row) = row.map_err(fault)?;
            if counts(&row.value()) {
                found.push((key.value().1, row.value()));
                if found.len() == limit {
                    break;
                }
            }
        }
        found.reverse();
        Ok(found)
    }

    /// The first version that arrived at a time or later, by bisection: versions arrive in their order.
    fn arrived(&self, number: u64, since: u64) -> Result<u64, StoreError> {
        let fault = |e: redb::StorageError| self.store.fault(e);
        let (mut low, mut high) = (0, self.newest(number)?.map_or(0, |(version, _)| version + 1));
        while low < high {
            let middle = low + (high - low) / 2;
            let row = self.index.range((number, middle)..=(number, u64::MAX)).map_err(fault)?.next();
            let Some((key, row)) = row.transpose().map_err(fault)? else { break };
            let times = self.with_record(row.value(), record::times)?;
            if times.map_err(|what| self.store.damaged(what))?.1 < since {
                low = key.value().1 + 1;
            } else {
                high = middle;
            }
        }
        Ok(low)
    }

    /// The row with the latest time among those that count; `counts` holds up to some time and not after it.
    fn held(&self, entity: &Entity, counts: impl Fn(u64) -> bool) -> Result<Option<(u64, Row)>, StoreError> {
        if !entity.ordered {
            let rows = self.last_rows(entity.number, (0, u64::MAX), usize::MAX, |row| counts(row.3))?;
            return Ok(rows.into_iter().max_by_key(|(version, row)| (row.3, *version)));
        }
        let Some((newest, _)) = self.newest(entity.number)? else { return Ok(None) };
        let before = |version: u64| {
            self.one(
                self.index.range((entity.number, 0)..=(entity.number, version)).map(|mut r| r.next_back()),
            )
        };
        // Bisection over versions: some may be missing, so each step looks at the last one there is.
        let (mut low, mut high, mut best) = (0, newest, None);
        while low <= high {
            let middle = low + (high - low) / 2;
            match before(middle)? {
                Some(found) if counts(found.1.3) => {
                    best = Some(found);
                    low = middle + 1;
                }
                Some((version, _)) if version > 0 && version > low => high = version - 1,
                Some(_) => break,
                None => low = middle + 1,
            }
        }
        Ok(best)
    }
}

type Found = Result<(AccessGuard<'static, (u64, u64)>, AccessGuard<'static, Row>), redb::StorageError>;

impl LongTermMemory {
    /// What a query asks for: the same as [`crate::Memory::query`], of everything that is kept.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read; [`StoreError::Query`] when the question is none.
    pub fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, StoreError> {
        let asked = query.ask().map_err(|error| match error {
            MemoryError::Query { what } => StoreError::Query { what },
            error => StoreError::Query { what: error.to_string() },
        })?;
        self.read(|reader| {
            let mut answer = asked.answer();
            reader.entities(&query.pattern, query.after.as_ref().map(|a| &a.id), |entity| {
                if asked.wants(&entity.id) {
                    reader.select(&asked, &entity, &mut answer)?;
                }
                Ok(!answer.is_full())
            })?;
            Ok(answer.finish())
        })
    }

    /// Gives every snapshot to `act`, in about the order in which they came, until it gives `false`. Reads the file from
    /// its beginning to its end, which is faster than any query for as much.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read.
    pub fn scan(&self, mut act: impl FnMut(Snapshot) -> bool) -> Result<(), StoreError> {
        self.read(|reader| {
            let ids = reader.addresses()?;
            let rows = reader.chunks.iter().map_err(|e| self.fault(e))?;
            for row in rows {
                let (_, chunk) = row.map_err(|e| self.fault(e))?;
                let mut rest = chunk.value();
                while !rest.is_empty() {
                    let head = record::head(rest).map_err(|what| self.damaged(what))?;
                    let unknown = || self.damaged(format!("entity number {} has no address", head.number));
                    let id = ids.get(&head.number).ok_or_else(unknown)?;
                    let snapshot = record::decode(id, head, rest, &|hash| reader.blob(hash));
                    if !act(snapshot.map_err(|what| self.damaged(what))?) {
                        return Ok(());
                    }
                    rest = &rest[head.length..];
                }
            }
            Ok(())
        })
    }

    /// The newest version of an entity; 0 when nothing is kept.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(super) fn newest_version(&self, id: &EntityId) -> Result<u64, StoreError> {
        self.read(|reader| {
            let Some(entity) = reader.entity(id)? else { return Ok(0) };
            Ok(reader.newest(entity.number)?.map_or(0, |(version, _)| version))
        })
    }

    pub(super) fn read<T>(
        &self,
        act: impl FnOnce(&Reader<'_>) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.with(|database| {
            let transaction = database.begin_read().map_err(|e| self.fault(e))?;
            act(&Reader::new(self, &transaction)?)
        })
    }
}

impl Reader<'_> {
    /// The addresses of all entities by number.
    pub(super) fn addresses(&self) -> Result<BTreeMap<u64, EntityId>, StoreError> {
        let mut ids = BTreeMap::new();
        self.entities(&Pattern::any(), None, |entity| {
            ids.insert(entity.number, entity.id);
            Ok(true)
        })?;
        Ok(ids)
    }
}
