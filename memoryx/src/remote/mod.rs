//! Another agent's memory over Zenoh, with the same trait. Every commit is answered.
//!
//! Subscribers receive every change once and in order. A gap in an entity's versions, an overflown queue and a memory
//! that was away all make this side query what it missed. What the other side no longer has shows as a gap in the
//! versions, which a [`crate::Follower`] reports.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use armarium_bus::{Key, Session, SessionError, keys};
use async_trait::async_trait;
use tokio::sync::{Notify, broadcast};
use tokio::task::JoinSet;

use crate::entity::{Commit, Snapshot};
use crate::error::MemoryError;
use crate::memory::Memory;
use crate::query::Query;
use crate::server::unreachable_memory;
use crate::wire::{self, Maintain, MaintenanceReport};

/// Messages that wait to be decoded, and changes that a subscriber may lag behind.
const QUEUE: usize = 4096;
/// Changes that wait to be put in order; room for more than two full messages.
const RAW: usize = 16_384;

mod link;
mod stream;

use link::Link;
use parking_lot::Mutex;

/// The memory of another agent.
#[derive(Debug)]
pub struct RemoteMemory {
    link: Arc<Link>,
    changes: broadcast::Sender<Arc<Snapshot>>,
    _tasks: JoinSet<()>,
}

impl RemoteMemory {
    /// Connects to the memory of `agent`, which must answer.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when the agent's name cannot be part of a key; [`MemoryError::Remote`] when the memory
    /// does not answer or Zenoh fails.
    pub async fn connect(session: &Session, agent: &str) -> Result<Self, MemoryError> {
        Self::connect_on(session, agent, keys::memory_commit(agent)?).await
    }

    /// [`Self::connect`] as a named writer, to a memory that accepts commits of certain writers only.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub async fn connect_as(session: &Session, agent: &str, writer: &str) -> Result<Self, MemoryError> {
        Self::connect_on(session, agent, keys::memory_by(agent, writer)?).await
    }

    /// `questions`: the key of the queryable.
    async fn connect_on(session: &Session, agent: &str, questions: Key) -> Result<Self, MemoryError> {
        let failed = |error: SessionError| unreachable_memory(agent, &error.to_string());
        let stream = keys::memory_changes(agent)?;
        let service = keys::alive(agent, "memory")?;

        let (raw, changes) = (broadcast::channel(RAW).0, broadcast::channel(QUEUE).0);
        let link = Link {
            session: session.clone(),
            agent: agent.into(),
            questions,
            raw,
            stream: Mutex::default(),
            lost: Notify::new(),
            taken: Notify::new(),
            delivered_until: AtomicU64::new(0),
        };
        let link = Arc::new(link);
        let messages = session.subscribe(stream, QUEUE).await.map_err(failed)?;
        let alive = session.watch_alive(&service.into(), 16).await.map_err(failed)?;
        let mut tasks = JoinSet::new();
        tasks.spawn(Arc::clone(&link).receive(messages));
        tasks.spawn(Arc::clone(&link).watch(alive));
        // An answer proves that the other side knows the subscription: declarations arrive before queries.
        let follower = link.first_answer().await?;
        link.stream().begin(follower.complete_until());
        tasks.spawn(Arc::clone(&link).deliver(follower, changes.clone()));
        Ok(Self { link, changes, _tasks: tasks })
    }

    /// Asks the agent for maintenance of its long-term memory.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it has none or the store fails; [`MemoryError::Remote`].
    pub async fn maintain(&self, request: &Maintain) -> Result<MaintenanceReport, MemoryError> {
        let failed = |error: armarium_bus::CodecError| self.link.failed(&error.to_string());
        let (encoding, payload) = wire::seal(request).map_err(failed)?;
        let (encoding, payload) = self.link.ask(&encoding, payload).await?;
        wire::open(&encoding, &payload).map_err(failed)
    }
}

#[async_trait]
impl Memory for RemoteMemory {
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        self.link.commit(updates).await
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.link.query(query).await
    }

    fn subscribe(&self) -> broadcast::Receiver<Arc<Snapshot>> {
        self.changes.subscribe()
    }

    fn complete_until(&self) -> Option<u64> {
        Some(self.link.delivered_until.load(Ordering::Acquire))
    }
}

#[cfg(test)]
mod tests;
