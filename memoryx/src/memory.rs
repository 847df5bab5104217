//! The trait that all memories implement, and read-modify-write on top of it.
//!
//! This file knows no implementation: [`crate::WorkingMemory`] and [`crate::RemoteMemory`] implement it, skills take
//! an `Arc<dyn Memory>`.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::Value;
use async_trait::async_trait;

use crate::changes::Changes;
use crate::entity::{Commit, EntityId, Instance, Snapshot};
use crate::error::MemoryError;
use crate::query::{Cursor, Pattern, Query};

/// How often [`modify`] tries before it reports the conflict.
const MAX_TRIES: u32 = 64;

/// A memory as skills and processes see it: in this process, on disk, or another agent's.
#[async_trait]
pub trait Memory: Send + Sync {
    /// Applies all updates or none; returns the new versions in order.
    ///
    /// # Errors
    /// [`MemoryError::Conflict`] when an expected version is not the newest; [`MemoryError::Schema`],
    /// [`MemoryError::Confidence`], [`MemoryError::ReadOnly`] and [`MemoryError::Full`] when an update is refused;
    /// [`MemoryError::Store`] and [`MemoryError::Remote`] when the memory cannot be reached.
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError>;
    /// The newest snapshot of an entity.
    ///
    /// # Errors
    /// [`MemoryError::NotFound`] when there is none.
    async fn latest(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        let found = self.query(&Query::latest(Pattern::entity(id))).await?.pop();
        found.ok_or_else(|| MemoryError::NotFound { id: id.to_string() })
    }
    /// The newest snapshots of all entities of a core segment, ordered by address.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the memory cannot be read.
    async fn segment(&self, segment: &str) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.query(&Query::latest(Pattern::segment(segment))).await
    }
    /// The snapshots that match a query, ordered by address, then version; the nearest ones by distance. [`pages`]
    /// reads a long answer piece by piece.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when the query is invalid; [`MemoryError::Store`] when the memory cannot be read.
    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError>;
    /// The newest version of each entity that matches, removed ones included, without its content. An answer costs about
    /// 60 bytes an entity.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the memory cannot be read.
    async fn heads(&self, pattern: &Pattern) -> Result<Heads, MemoryError> {
        let all = Query { removed: true, ..Query::latest(pattern.clone()) };
        Ok(Heads::of(&self.query(&all).await?))
    }
    /// All later changes of the entities that match, those of each entity in order. A subscriber that lags learns how many
    /// he missed; [`crate::Follower`] reads them again where the memory still has them.
    ///
    /// # Errors
    /// [`MemoryError::Remote`] when the memory cannot be reached.
    async fn subscribe(&self, pattern: &Pattern) -> Result<Changes, MemoryError>;
}

/// The newest versions of entities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Heads {
    /// In order of address.
    pub entities: Vec<Head>,
    /// Every change that arrived in the memory before this time is in it, ns.
    pub until_ns: u64,
    /// What the memory's clock said, ns, if it is another process's and says so.
    pub now_ns: Option<u64>,
}

/// The newest version of an entity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Head {
    /// The entity.
    pub id: EntityId,
    /// Its newest version.
    pub version: u64,
    /// When that arrived in the memory, ns.
    pub arrived_ns: u64,
    /// Whether it is a removal.
    pub removed: bool,
}

impl Heads {
    /// The heads of the newest snapshots of entities.
    pub(crate) fn of(newest: &[Arc<Snapshot>]) -> Self {
        let head = |snapshot: &Arc<Snapshot>| Head {
            id: snapshot.id.clone(),
            version: snapshot.version,
            arrived_ns: snapshot.arrived_ns,
            removed: snapshot.is_removed(),
        };
        let until_ns = newest.iter().map(|snapshot| snapshot.arrived_ns).max().unwrap_or(0);
        Self { entities: newest.iter().map(head).collect(), until_ns, now_ns: None }
    }
}

/// Most bytes of snapshots in a piece, about.
const MAX_PAGE_BYTES: u64 = 16 << 20;

/// Reads a long answer in pieces of at most `size` snapshots and a bounded number of bytes.
#[derive(Clone, Debug)]
pub struct Pages {
    query: Query,
    left: bool,
}

/// The answer to `query` in pieces of at most `size` snapshots. Commits meanwhile may appear in later pieces. No
/// snapshot is returned twice, and none that stays is left out.
pub fn pages(query: Query, size: usize) -> Pages {
    let bytes = query.most_bytes.unwrap_or(MAX_PAGE_BYTES);
    Pages { query: Query { most: Some(size.max(1)), most_bytes: Some(bytes), ..query }, left: true }
}

impl Pages {
    /// The next piece; `None` after the last one.
    ///
    /// # Errors
    /// As [`Memory::query`]; the next call repeats the failed piece.
    pub async fn next(&mut self, memory: &dyn Memory) -> Result<Option<Vec<Arc<Snapshot>>>, MemoryError> {
        if !self.left {
            return Ok(None);
        }
        let found = memory.query(&self.query).await?;
        self.left = self.query.is_filled_by(&found);
        self.query.after = found.last().map(|s| Cursor::after(s));
        Ok((!found.is_empty()).then_some(found))
    }
}

/// Reads an entity, lets `change` compute its new attributes, and commits them. If another writer was faster, it
/// begins again. `change` gets `None` when there is no such entity, and may return `None` to change nothing. Returns
/// the newest version (0: the entity does not exist).
///
/// The first hypothesis keeps its confidence; other hypotheses are dropped. `referenced_ns`: the time that the new
/// data describe.
///
/// # Errors
/// [`MemoryError::Conflict`] after many tries in a row; otherwise as [`Memory::commit`].
pub async fn modify<F>(
    memory: &dyn Memory,
    id: &EntityId,
    referenced_ns: u64,
    mut change: F,
) -> Result<u64, MemoryError>
where
    F: FnMut(Option<&Snapshot>) -> Option<BTreeMap<String, Value>> + Send,
{
    let mut tries = 0;
    loop {
        let now = match memory.latest(id).await {
            Ok(snapshot) => Some(snapshot),
            Err(MemoryError::NotFound { .. }) => None,
            Err(error) => return Err(error),
        };
        let version = now.as_ref().map_or(0, |s| s.version);
        let Some(attributes) = change(now.as_deref()) else { return Ok(version) };
        let confidence = now.as_ref().and_then(|s| s.instance()).map_or(1.0, |i| i.confidence);
        let instance = Instance::new(attributes).with_confidence(confidence);
        let update = Commit::of(id.clone(), referenced_ns, vec![instance]).expecting(version);
        tries += 1;
        match memory.commit(vec![update]).await {
            Ok(versions) => return Ok(versions.first().copied().unwrap_or(version + 1)),
            Err(MemoryError::Conflict { .. }) if tries < MAX_TRIES => tokio::task::yield_now().await,
            Err(error) => return Err(error),
        }
    }
}
