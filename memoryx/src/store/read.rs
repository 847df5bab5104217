//! Queries on long-term memory: no more of the file is read than the answer needs.

use std::ops::Bound;
use std::sync::Arc;

use redb::{ReadTransaction, ReadableDatabase};

use super::{LATEST, LongTermMemory, SNAPSHOTS, StoreError, TIMES, record};
use crate::entity::{EntityId, Snapshot};
use crate::query::{Pattern, Query, Times};

impl LongTermMemory {
    /// What a query asks for, ordered by address, then version: the same as [`crate::Memory::query`], of everything
    /// that was ever kept.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] and others when it cannot be read.
    pub fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, StoreError> {
        self.with(|database| {
            let transaction = database.begin_read().map_err(|e| self.fault(e))?;
            let mut found = Vec::new();
            for (id, newest) in self.entities(&transaction, &query.pattern)? {
                self.query_entity(&transaction, query, &id, newest, &mut found)?;
            }
            Ok(found)
        })
    }

    /// The entities that a pattern fits, with their newest versions.
    fn entities(
        &self,
        transaction: &ReadTransaction,
        pattern: &Pattern,
    ) -> Result<Vec<(EntityId, u64)>, StoreError> {
        let latest = transaction.open_table(LATEST).map_err(|e| self.fault(e))?;
        let (from, to) = record::entity_range(pattern);
        let to = to.as_ref().map_or(Bound::Unbounded, |to| Bound::Excluded(to.as_slice()));
        let rows =
            latest.range::<&[u8]>((Bound::Included(from.as_slice()), to)).map_err(|e| self.fault(e))?;
        let mut found = Vec::new();
        for row in rows {
            let (key, version) = row.map_err(|e| self.fault(e))?;
            let id = record::entity_of(key.value()).map_err(|what| self.damaged(what))?;
            if pattern.matches(&id) {
                found.push((id, version.value()));
            }
        }
        Ok(found)
    }

    /// Adds what a query takes of one entity, without reading more of its history than that.
    fn query_entity(
        &self,
        transaction: &ReadTransaction,
        query: &Query,
        id: &EntityId,
        newest: u64,
        found: &mut Vec<Arc<Snapshot>>,
    ) -> Result<(), StoreError> {
        let limit = query.limit.unwrap_or(usize::MAX);
        let snapshots = transaction.open_table(SNAPSHOTS).map_err(|e| self.fault(e))?;
        let get = |version: u64| -> Result<Arc<Snapshot>, StoreError> {
            let key = record::key(id, version);
            let row = snapshots.get(key.as_slice()).map_err(|e| self.fault(e))?;
            let row = row.ok_or_else(|| self.damaged(format!("version {version} of `{id}` is missing")))?;
            record::decode(&key, row.value()).map(Arc::new).map_err(|what| self.damaged(what))
        };
        let times = || transaction.open_table(TIMES).map_err(|e| self.fault(e));
        let held = |before: u64| -> Result<Option<u64>, StoreError> {
            let (from, to) = (record::time_key(id, 0, 0), record::time_key(id, before, u64::MAX));
            let times = times()?;
            let mut rows =
                times.range::<&[u8]>(from.as_slice()..=to.as_slice()).map_err(|e| self.fault(e))?;
            let row = rows.next_back().transpose().map_err(|e| self.fault(e))?;
            Ok(row.map(|(key, _)| record::last_number(key.value())))
        };
        if limit == 0 {
            return Ok(());
        }
        let taken = match query.times {
            Times::Latest => vec![get(newest)?],
            Times::At(time) => held(time)?.map(get).transpose()?.into_iter().collect(),
            Times::Before(0) => Vec::new(),
            Times::Before(time) => held(time - 1)?.map(get).transpose()?.into_iter().collect(),
            Times::All => {
                let (from, to) = (record::key(id, 0), record::key(id, u64::MAX));
                let rows =
                    snapshots.range::<&[u8]>(from.as_slice()..=to.as_slice()).map_err(|e| self.fault(e))?;
                let mut taken = Vec::new();
                for row in rows.rev().take(limit) {
                    let (key, value) = row.map_err(|e| self.fault(e))?;
                    let snapshot = record::decode(key.value(), value.value());
                    taken.push(Arc::new(snapshot.map_err(|what| self.damaged(what))?));
                }
                taken.reverse();
                found.extend(taken);
                return Ok(());
            }
            Times::Between(from, to) if from <= to => {
                let (from, to) = (record::time_key(id, from, 0), record::time_key(id, to, u64::MAX));
                let times = times()?;
                let rows =
                    times.range::<&[u8]>(from.as_slice()..=to.as_slice()).map_err(|e| self.fault(e))?;
                let mut versions = Vec::new();
                for row in rows {
                    versions.push(record::last_number(row.map_err(|e| self.fault(e))?.0.value()));
                }
                versions.sort_unstable();
                let first = versions.len().saturating_sub(limit);
                found.extend(versions[first..].iter().map(|v| get(*v)).collect::<Result<Vec<_>, _>>()?);
                return Ok(());
            }
            Times::Between(..) => Vec::new(),
        };
        found.extend(taken.into_iter().filter(|s| !s.is_removed()));
        Ok(())
    }
}
