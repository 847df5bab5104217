//! The trait through which all memories are used, and read-modify-write on top of it.
//!
//! Knows of no particular memory: [`crate::WorkingMemory`] and [`crate::RemoteMemory`] implement it, skills take
//! an `Arc<dyn Memory>`.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::Value;
use async_trait::async_trait;
use tokio::sync::broadcast;

use crate::entity::{Commit, EntityId, Instance, Snapshot};
use crate::error::MemoryError;
use crate::query::{Cursor, Query};

/// How often [`modify`] begins again before it reports the conflict.
const MODIFY_TRIES: u32 = 64;

/// A memory as skills and processes see it: in this process, on disk, or another agent's.
#[async_trait]
pub trait Memory: Send + Sync {
    /// Applies all updates or none; returns the new versions in order.
    ///
    /// # Errors
    /// [`MemoryError::Conflict`] when an expected version is not the newest; [`MemoryError::Schema`],
    /// [`MemoryError::Confidence`], [`MemoryError::ReadOnly`] and [`MemoryError::Full`] when an update cannot
    /// be taken; [`MemoryError::Store`] and [`MemoryError::Remote`] when the memory cannot be reached.
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError>;
    /// The newest snapshot of an entity.
    ///
    /// # Errors
    /// [`MemoryError::NotFound`] when there is none.
    async fn latest(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError>;
    /// The newest snapshots of all entities of a core segment, ordered by address.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the memory cannot be read.
    async fn segment(&self, segment: &str) -> Result<Vec<Arc<Snapshot>>, MemoryError>;
    /// What a query asks for, ordered by address, then version; the nearest ones by distance. [`pages`] asks for a
    /// long answer piece by piece.
    ///
    /// # Errors
    /// [`MemoryError::Query`] when the question is none; [`MemoryError::Store`] when the memory cannot be read.
    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError>;
    /// All later changes; of each entity in order. A reader that falls behind is told how many it missed; [`crate::Follower`]
    /// says which, and reads them again where the memory still has them.
    fn subscribe(&self) -> broadcast::Receiver<Arc<Snapshot>>;
    /// Subscribers were given everything that arrived before then, ns; `None` where they get all changes in the order of
    /// their arrival, so that each says this of those before it.
    fn told_until(&self) -> Option<u64> {
        None
    }
}

/// Most bytes of snapshots in a piece, about.
const PIECE_BYTES: u64 = 16 << 20;

/// The pieces of a long answer: at most `size` snapshots each, and no more bytes than a process can do with, until all
/// were given.
#[derive(Clone, Debug)]
pub struct Pages {
    query: Query,
    left: bool,
}

/// The answer to `query` in pieces of at most `size` snapshots. What is committed meanwhile may be in later pieces;
/// nothing is there twice, and nothing that stays is left out.
#[must_use]
pub fn pages(query: Query, size: usize) -> Pages {
    let bytes = query.most_bytes.unwrap_or(PIECE_BYTES);
    Pages { query: Query { most: Some(size.max(1)), most_bytes: Some(bytes), ..query }, left: true }
}

impl Pages {
    /// The next piece; `None` after the last one.
    ///
    /// # Errors
    /// As [`Memory::query`]; the same piece is asked for again next.
    pub async fn next(&mut self, memory: &dyn Memory) -> Result<Option<Vec<Arc<Snapshot>>>, MemoryError> {
        if !self.left {
            return Ok(None);
        }
        let found = memory.query(&self.query).await?;
        self.left = self.query.is_filled_by(&found);
        self.query.after = found.last().map(|s| Cursor { id: s.id.clone(), version: s.version });
        Ok((!found.is_empty()).then_some(found))
    }
}

/// Changes an entity by what it is now: reads it, lets `change` make the new attributes, and commits them unless
/// somebody else was faster, in which case it begins again. `change` sees `None` when there is no such entity, and
/// may give `None` to leave everything as it is. Returns the version that holds now (0: there is none).
///
/// The first hypothesis keeps its confidence; other hypotheses are dropped. `referenced_ns`: the time that the new
/// data speak of.
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
        let update = Commit {
            id: id.clone(),
            referenced_ns,
            instances: vec![Instance::new(attributes).with_confidence(confidence)],
            expected_version: Some(version),
        };
        tries += 1;
        match memory.commit(vec![update]).await {
            Ok(versions) => return Ok(versions.first().copied().unwrap_or(version + 1)),
            Err(MemoryError::Conflict { .. }) if tries < MODIFY_TRIES => tokio::task::yield_now().await,
            Err(error) => return Err(error),
        }
    }
}
