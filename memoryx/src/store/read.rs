//! Queries to long-term memory: they read no more of the file than the answer needs.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Bound;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use redb::{AccessGuard, ReadOnlyTable, ReadTransaction, ReadableDatabase, ReadableTable};

use super::error::Fault;
use super::record::{self, Hash, RecordError, Records};
use super::write::OF_OTHERS;
use super::{
    AGES, BLOBS, CHUNKS, ENTITIES, GIVEN, INDEX, KEPT, LongTermMemory, OpenFile, RecordPlace, StoreError,
};
use crate::checked_query::{CheckedQuery, Selection, versions_between};
use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::query::{Pattern, Query, Times};
use crate::working::{Archive, Backing};

/// An empty range of versions.
const NONE: (u64, u64) = (1, 0);

/// Reads records within one transaction.
pub(super) struct Reader {
    pub(super) index: ReadOnlyTable<(u64, u64), RecordPlace>,
    pub(super) chunks: ReadOnlyTable<u64, &'static [u8]>,
    blobs: ReadOnlyTable<&'static [u8], &'static [u8]>,
    entities: ReadOnlyTable<&'static [u8], (u64, bool)>,
    given: ReadOnlyTable<u64, u64>,
    ages: ReadOnlyTable<(u64, u64), ()>,
    kept: ReadOnlyTable<u64, u64>,
    /// The last chunk read.
    last: RefCell<Option<(u64, Chunk)>>,
}

/// The bytes of a chunk, while in use.
type Chunk = AccessGuard<'static, &'static [u8]>;

/// An entity in the file.
#[derive(Clone, Debug)]
pub(super) struct Entity {
    pub(super) id: EntityId,
    pub(super) number: u64,
    ordered: bool,
}

impl Reader {
    pub(super) fn new(transaction: &ReadTransaction) -> Result<Self, Fault> {
        Ok(Self {
            index: transaction.open_table(INDEX)?,
            chunks: transaction.open_table(CHUNKS)?,
            blobs: transaction.open_table(BLOBS)?,
            entities: transaction.open_table(ENTITIES)?,
            given: transaction.open_table(GIVEN)?,
            ages: transaction.open_table(AGES)?,
            kept: transaction.open_table(KEPT)?,
            last: RefCell::new(None),
        })
    }

    /// One entity.
    pub(super) fn entity(&self, id: &EntityId) -> Result<Option<Entity>, Fault> {
        let key = record::entity_key(id);
        let held = self.entities.get(key.as_slice())?.map(|v| v.value());
        Ok(held.map(|(number, ordered)| Entity { id: id.clone(), number, ordered }))
    }

    /// The matching entities, in order of address.
    pub(super) fn entities(
        &self,
        pattern: &Pattern,
        from: Option<&EntityId>,
    ) -> Result<impl Iterator<Item = Result<Entity, Fault>>, Fault> {
        let (one, rows) = match pattern.exact() {
            Some(id) => (self.entity(&id)?, None),
            None => {
                let (first, to) = record::entity_range(pattern);
                let first = from.map_or(first.clone(), |id| first.max(record::entity_key(id)));
                let to = to.as_ref().map_or(Bound::Unbounded, |to| Bound::Excluded(to.as_slice()));
                (None, Some(self.entities.range::<&[u8]>((Bound::Included(first.as_slice()), to))?))
            }
        };
        let entities = rows.into_iter().flatten().map(|row| {
            let (key, value) = row?;
            let (id, (number, ordered)) = (record::entity_of(key.value())?, value.value());
            Ok(Entity { id, number, ordered })
        });
        let is_asked_for =
            |entity: &Result<Entity, Fault>| entity.as_ref().map_or(true, |e| pattern.matches(&e.id));
        Ok(one.map(Ok).into_iter().chain(entities.filter(is_asked_for)))
    }

    /// The newest version of an entity, and its row.
    pub(super) fn newest(&self, number: u64) -> Result<Option<(u64, RecordPlace)>, Fault> {
        version_of(self.index.range((number, 0)..=(number, u64::MAX))?.next_back())
    }

    /// When the newest record of the oldest chunk arrived that retention has not come to, ns.
    pub(super) fn oldest_chunk(&self) -> Result<Option<u64>, Fault> {
        Ok(self.ages.first()?.map(|(key, _)| key.value().0))
    }

    /// Whether a record is forgotten, though its chunk is still there.
    pub(super) fn is_forgotten(
        &self,
        chunk: u64,
        offset: usize,
        head: record::RecordHeader,
    ) -> Result<bool, Fault> {
        Ok(self.kept.get(chunk)?.is_some() && row_at(&self.index, head, chunk, offset)?.is_none())
    }

    /// The last version that an entity was noted to have been given.
    fn given(&self, number: u64) -> Result<u64, Fault> {
        Ok(self.given.get(number)?.map_or(0, |row| row.value()))
    }

    /// The snapshot at a row.
    pub(super) fn snapshot(&self, id: &EntityId, row: RecordPlace) -> Result<Arc<Snapshot>, Fault> {
        let decoded = self.with_record(row, |bytes| {
            let head = record::head(bytes)?;
            record::decode(id, head, bytes, &|hash| self.blob(hash))
        })?;
        Ok(Arc::new(decoded?))
    }

    /// Passes the bytes at a row to `act`.
    fn with_record<T>(&self, row: RecordPlace, act: impl FnOnce(&[u8]) -> T) -> Result<T, Fault> {
        let missing = || Fault::no_record(row);
        let mut last = self.last.borrow_mut();
        if last.as_ref().is_none_or(|(chunk, _)| *chunk != row.0) {
            let chunk = self.chunks.get(row.0)?.ok_or_else(missing)?;
            *last = Some((row.0, chunk));
        }
        let (_, chunk) = last.as_ref().ok_or_else(missing)?;
        let range = row.1 as usize..(row.1 as usize).saturating_add(row.2 as usize);
        Ok(act(chunk.value().get(range).ok_or_else(missing)?))
    }

    pub(super) fn blob(&self, hash: &Hash) -> Result<Vec<u8>, RecordError> {
        let found = self.blobs.get(hash.as_slice())?;
        found.map(|v| v.value().to_vec()).ok_or(RecordError::NoBlob)
    }

    /// Adds a query's selection from one entity. Reads no more of its history than needed.
    fn select(
        &self,
        asked: &CheckedQuery<'_>,
        entity: &Entity,
        answer: &mut Selection<'_>,
    ) -> Result<(), Fault> {
        let one = |row: Option<(u64, RecordPlace)>| -> Result<Vec<Arc<Snapshot>>, Fault> {
            let found = row.map(|(_, row)| self.snapshot(&entity.id, row)).transpose()?;
            Ok(asked.select(found.into_iter()))
        };
        match asked.query.times {
            _ if asked.query.limit == Some(0) => {}
            Times::Latest => answer.extend(one(self.newest(entity.number)?)?),
            Times::At(time) => answer.extend(one(self.held(entity, |referenced| referenced <= time)?)?),
            Times::Before(time) => answer.extend(one(self.held(entity, |referenced| referenced < time)?)?),
            _ => {
                let (mut from, to) = self.bounds(asked, entity)?;
                if let Some(mut left) = asked.query.limit {
                    self.choose(asked, entity, (from, to), true, |version, _| {
                        left -= 1;
                        from = version;
                        Ok(left > 0)
                    })?;
                }
                self.choose(asked, entity, (from, to), false, |_, row| {
                    let is_wanted = !answer.is_full();
                    if is_wanted {
                        answer.push(self.snapshot(&entity.id, row)?);
                    }
                    Ok(is_wanted)
                })?;
            }
        }
        Ok(())
    }

    /// The first and the last version of an entity that a query can select.
    fn bounds(&self, asked: &CheckedQuery<'_>, entity: &Entity) -> Result<(u64, u64), Fault> {
        let query = asked.query;
        let after = query.after.as_ref().filter(|after| after.id == entity.id);
        let (from, to) = match query.times {
            Times::Versions(from, to) => (from, to),
            Times::Index(from, to) => {
                versions_between(from, to, |place| self.at(entity, place))?.unwrap_or(NONE)
            }
            // A continued answer is already past the versions that arrived earlier.
            _ if after.is_some() => (0, u64::MAX),
            _ => (query.arrived_since.map_or(Ok(0), |since| self.arrived(entity, since))?, u64::MAX),
        };
        Ok((after.map_or(from, |after| from.max(after.version.saturating_add(1))), to))
    }

    /// The version at a position in an entity's history; negative positions count from the end.
    fn at(&self, entity: &Entity, place: i64) -> Result<Option<u64>, Fault> {
        let mut rows = self.rows(entity, (0, u64::MAX))?;
        let index = |place: i64| usize::try_from(place).unwrap_or(usize::MAX);
        let found = if place < 0 { rows.nth_back(index(-1 - place)) } else { rows.nth(index(place)) };
        Ok(version_of(found)?.map(|(version, _)| version))
    }

    fn rows(&self, entity: &Entity, (from, to): (u64, u64)) -> Result<Rows, Fault> {
        let from = (entity.number, from.min(to));
        Ok(self.index.range(from..=(entity.number, to))?)
    }

    /// Passes the selected versions in a range to `act`, in order or backwards, until it returns that this is enough.
    /// Data are read only when the query depends on them.
    fn choose(
        &self,
        asked: &CheckedQuery<'_>,
        entity: &Entity,
        (from, to): (u64, u64),
        backwards: bool,
        mut act: impl FnMut(u64, RecordPlace) -> Result<bool, Fault>,
    ) -> Result<(), Fault> {
        if from > to {
            return Ok(());
        }
        let mut rows = self.rows(entity, (from, to))?;
        let counts = |row: &RecordPlace| match asked.query.times {
            Times::Between(from, to) => (from..=to).contains(&row.3),
            _ => true,
        };
        while let Some((version, row)) = version_of(if backwards { rows.next_back() } else { rows.next() })? {
            let is_asked_for =
                counts(&row) && (asked.is_plain() || asked.fits(&*self.snapshot(&entity.id, row)?));
            if is_asked_for && !act(version, row)? {
                break;
            }
        }
        Ok(())
    }

    /// The first version that can have arrived at a time or later: versions arrive in order.
    fn arrived(&self, entity: &Entity, since: u64) -> Result<u64, Fault> {
        let is_before = |row: RecordPlace| Ok(self.with_record(row, record::times)??.1 < since);
        Ok(self.last_of_first(entity, is_before)?.map_or(0, |(version, _)| version + 1))
    }

    /// The row with the latest referenced time among those for which `counts` is true. `counts` is true up to some
    /// time, and false after it.
    fn held(
        &self,
        entity: &Entity,
        counts: impl Fn(u64) -> bool,
    ) -> Result<Option<(u64, RecordPlace)>, Fault> {
        if !entity.ordered {
            let mut rows = self.rows(entity, (0, u64::MAX))?;
            let mut held: Option<(u64, RecordPlace)> = None;
            while let Some((version, row)) = version_of(rows.next())? {
                if counts(row.3) && held.is_none_or(|(_, best)| best.3 <= row.3) {
                    held = Some((version, row));
                }
            }
            return Ok(held);
        }
        self.last_of_first(entity, |row| Ok(counts(row.3)))
    }

    /// The last row for which `is_first` is true, by bisection. It is true up to some version, and false after it.
    fn last_of_first(
        &self,
        entity: &Entity,
        is_first: impl Fn(RecordPlace) -> Result<bool, Fault>,
    ) -> Result<Option<(u64, RecordPlace)>, Fault> {
        let Some((newest, _)) = self.newest(entity.number)? else { return Ok(None) };
        let (mut low, mut high, mut best) = (0, newest, None);
        while low <= high {
            let middle = low + (high - low) / 2;
            // Some versions may be missing, so each step uses the last existing one.
            match version_of(self.rows(entity, (0, middle))?.next_back())? {
                Some(found) if is_first(found.1)? => {
                    best = Some(found);
                    low = middle + 1;
                }
                Some((version, _)) if version > low => high = version - 1,
                Some(_) => break,
                None => low = middle + 1,
            }
        }
        Ok(best)
    }
}

/// The version and the place of a row of the index.
fn version_of(found: Option<Found>) -> Result<Option<(u64, RecordPlace)>, Fault> {
    Ok(found.transpose()?.map(|(key, row)| (key.value().1, row.value())))
}

/// The row of a record, if the index has it at this place of a chunk.
pub(super) fn row_at(
    index: &impl ReadableTable<(u64, u64), RecordPlace>,
    head: record::RecordHeader,
    chunk: u64,
    at: usize,
) -> Result<Option<RecordPlace>, Fault> {
    let row = index.get((head.number, head.version))?.map(|row| row.value());
    Ok(row.filter(|row| (row.0, row.1 as usize) == (chunk, at)))
}

pub(super) fn query_error(error: MemoryError) -> StoreError {
    match error {
        MemoryError::Query { what } => StoreError::Query { what },
        error => StoreError::Query { what: error.to_string() },
    }
}

type Rows = redb::Range<'static, (u64, u64), RecordPlace>;
type Found =
    Result<(AccessGuard<'static, (u64, u64)>, AccessGuard<'static, RecordPlace>), redb::StorageError>;

impl LongTermMemory {
    /// Answers a query over everything stored, as [`crate::Memory::query`].
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read; [`StoreError::Query`] when the query is invalid.
    pub fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, StoreError> {
        let asked = query.check().map_err(query_error)?;
        self.read_again(|reader| {
            let mut answer = asked.answer(&|| true);
            for entity in reader.entities(&query.pattern, query.after.as_ref().map(|a| &a.id))? {
                let entity = entity?;
                if asked.wants(&entity.id) {
                    if asked.clock.is_some() {
                        let newest = reader.newest(entity.number)?;
                        answer.note_clock(&entity.id, || newest.map(|(_, row)| row.3));
                    }
                    reader.select(&asked, &entity, &mut answer)?;
                }
                if answer.is_full() {
                    break;
                }
            }
            Ok(answer.finish().map_err(query_error)?.snapshots)
        })
    }

    /// The core segments with stored snapshots, in order.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read.
    pub fn segments(&self) -> Result<Vec<String>, StoreError> {
        self.read(|reader| {
            let mut segments: Vec<String> = Vec::new();
            for entity in reader.entities(&Pattern::any(), None)? {
                let id = entity?.id;
                if segments.last().is_none_or(|last| last != id.segment()) {
                    segments.push(id.segment().into());
                }
            }
            Ok(segments)
        })
    }

    /// Passes every snapshot to `act`, in about the order of arrival, until it returns `false`. Reads the file
    /// sequentially, which is faster than any query for the same amount.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read.
    pub fn scan(&self, mut act: impl FnMut(Snapshot) -> bool) -> Result<(), StoreError> {
        let mut damage = None;
        self.scan_intact(|snapshot| match snapshot {
            Ok(snapshot) => act(snapshot),
            Err(what) => {
                damage = Some(what);
                false
            }
        })?;
        damage.map_or(Ok(()), |what| Err(self.damaged(what.to_string())))
    }

    /// As [`Self::scan`], but continues after damage: `act` also gets a description of each damaged place.
    pub(super) fn scan_intact(
        &self,
        mut act: impl FnMut(Result<Snapshot, RecordError>) -> bool,
    ) -> Result<(), StoreError> {
        let mut from = (0, 0);
        match self.read(|reader| reader.scan(&mut from, &mut act)) {
            Err(StoreError::Damaged { .. }) => self.salvage(|| {
                self.read(|reader| reader.scan(&mut from, &mut act))?;
                self.with(|file| {
                    let log = file.log.lock();
                    let Some(log) = &*log else { return Ok(()) };
                    let damage = log.is_damaged.then_some(Err(RecordError::Log { at: log.end }));
                    let logged = log.stored.snapshots.iter().map(|logged| Ok(Snapshot::clone(logged)));
                    // Whoever has enough is asked no more.
                    let _ = logged.chain(damage).all(act);
                    Ok(())
                })
            }),
            scanned => scanned,
        }
    }

    /// The last version that an entity may have been given; 0 when it has none.
    pub(super) fn last_given(&self, id: &EntityId) -> Result<u64, StoreError> {
        self.read_again(|reader| {
            let Some(entity) = reader.entity(id)? else { return Ok(0) };
            let newest = reader.newest(entity.number)?.map_or(0, |(version, _)| version);
            Ok(newest.max(reader.given(entity.number)?))
        })
    }

    /// The last version that any entity which is not stored may have been given.
    pub(super) fn given_to_others(&self) -> Result<u64, StoreError> {
        self.read(|reader| reader.given(OF_OTHERS))
    }

    /// The entities that may have been given later versions than are stored, with the last of these.
    pub(super) fn given_ahead(&self) -> Result<BTreeMap<EntityId, u64>, StoreError> {
        self.read(|reader| {
            let mut ahead = BTreeMap::new();
            for row in reader.given.range(..OF_OTHERS)? {
                let (number, version) = row.map(|(number, version)| (number.value(), version.value()))?;
                if reader.newest(number)?.is_none_or(|(newest, _)| newest < version) {
                    ahead.insert(number, version);
                }
            }
            let ids = if ahead.is_empty() { BTreeMap::new() } else { reader.addresses()? };
            Ok(ahead.into_iter().filter_map(|(number, v)| Some((ids.get(&number)?.clone(), v))).collect())
        })
    }

    pub(super) fn read<T>(&self, act: impl FnOnce(&Reader) -> Result<T, Fault>) -> Result<T, StoreError> {
        self.read_tables(|transaction| act(&Reader::new(transaction)?))
    }

    /// As [`Self::read`], once more where another reader's damage has ended the first time.
    fn read_again<T>(&self, act: impl Fn(&Reader) -> Result<T, Fault>) -> Result<T, StoreError> {
        match self.read(&act) {
            Err(StoreError::Reopened { .. }) => self.read(&act),
            read => read,
        }
    }

    /// Reads the tables, which have everything that is stored.
    pub(super) fn read_tables<T>(
        &self,
        act: impl FnOnce(&ReadTransaction) -> Result<T, Fault>,
    ) -> Result<T, StoreError> {
        let is_logged = |file: &OpenFile| Ok(file.is_logged.load(Ordering::Acquire));
        if !self.salvages.load(Ordering::Acquire) && self.with(is_logged)? {
            self.take_log(&mut self.memo.lock())?;
        }
        self.with(|file| act(&file.database.begin_read()?))
    }
}

impl Backing for LongTermMemory {
    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError> {
        Ok(self.last_given(id)?)
    }

    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
        self.persist(snapshots)?;
        Ok(())
    }

    fn holds_any(&self, snapshots: &[Arc<Snapshot>]) -> Result<bool, MemoryError> {
        let holds = self.read(|reader| {
            for snapshot in snapshots {
                let Some(entity) = reader.entity(&snapshot.id)? else { continue };
                let row = reader.index.get((entity.number, snapshot.version))?;
                if let Some(row) = row
                    && reader.snapshot(&snapshot.id, row.value())?.arrived_ns == snapshot.arrived_ns
                {
                    return Ok(true);
                }
            }
            Ok(false)
        });
        Ok(holds?)
    }

    fn archive(&self) -> Option<&dyn Archive> {
        Some(self)
    }
}

impl Archive for LongTermMemory {
    fn recall(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        Ok(self.query(query)?)
    }

    fn versions(
        &self,
        query: &Query,
        backwards: bool,
        act: &mut dyn FnMut(u64) -> bool,
    ) -> Result<(), MemoryError> {
        let asked = query.check()?;
        let Some(id) = query.pattern.exact() else { return Ok(()) };
        let chosen = self.read(|reader| {
            let Some(entity) = reader.entity(&id)? else { return Ok(()) };
            let bounds = reader.bounds(&asked, &entity)?;
            reader.choose(&asked, &entity, bounds, backwards, |version, _| Ok(act(version)))
        });
        chosen?;
        asked.is_known()
    }
}

impl Reader {
    /// Passes every record to `act`, or a description of the damaged place, from a chunk and an offset in it, which are moved on.
    fn scan(
        &self,
        from: &mut (u64, usize),
        act: &mut impl FnMut(Result<Snapshot, RecordError>) -> bool,
    ) -> Result<(), Fault> {
        let ids = self.addresses()?;
        for row in self.chunks.range(from.0..)? {
            let (number, chunk) = row?;
            if number.value() != from.0 {
                *from = (number.value(), 0);
            }
            let mut records = Records { chunk: chunk.value(), at: from.1 };
            while let Some((at, record)) = records.next() {
                let snapshot = match record {
                    Ok((head, _)) if self.is_forgotten(from.0, at, head)? => continue,
                    Ok((head, record)) => {
                        let id = ids.get(&head.number).ok_or(RecordError::NoAddress { number: head.number });
                        id.and_then(|id| record::decode(id, head, record, &|hash| self.blob(hash)))
                    }
                    Err(what) => Err(what),
                };
                if let Err(RecordError::Storage(error)) = snapshot {
                    return Err(error.into());
                }
                from.1 = records.at;
                if !act(snapshot) {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    /// The addresses of all entities by number.
    pub(super) fn addresses(&self) -> Result<BTreeMap<u64, EntityId>, Fault> {
        self.entities(&Pattern::any(), None)?.map(|entity| entity.map(|e| (e.number, e.id))).collect()
    }
}
