//! Another agent's memory over Zenoh, with the same trait. Every commit is answered. Connecting costs one question; what
//! is asked for later is what is transferred.
//!
//! Subscribers receive the changes of the core segments that they subscribe to, and learn of losses; a
//! [`crate::Follower`] reads what was lost.

use armarium_bus::session::Reply;
use armarium_bus::{Key, Payload, Session, SessionError, keys};
use async_trait::async_trait;
use std::sync::Arc;
use std::time::Duration;

use crate::changes::Changes;
use crate::entity::{Commit, Snapshot};
use crate::error::MemoryError;
use crate::memory::{Head, Heads, Memory};
use crate::query::{Pattern, Query};
use crate::server::unreachable_memory;
use crate::wire::{
    self, CommitRequest, HeadsPart, HeadsRequest, Maintain, MaintenanceReport, QueryRequest, Snapshots,
    Versions,
};

mod changes;

use changes::RemoteChanges;

/// How often connecting tries a memory that does not answer, and how long it waits in between.
const MAX_TRIES: u32 = 5;
const RETRY_INTERVAL: Duration = Duration::from_millis(100);
/// Messages of changes that wait to be decoded.
const QUEUE: usize = 4096;

/// The memory of another agent.
#[derive(Clone, Debug)]
pub struct RemoteMemory {
    session: Session,
    agent: String,
    /// The key of its queryable.
    questions: Key,
}

impl RemoteMemory {
    /// How far the other memory's clock is ahead of one's own, s, to about half the time of a question; `None` if it does not say.
    ///
    /// # Errors
    /// [`MemoryError::Remote`] when it does not answer.
    pub async fn clock_ahead_s(&self, own_ns: impl Fn() -> u64) -> Result<Option<f64>, MemoryError> {
        let asked_ns = own_ns();
        // Of a segment that nobody has: the answer is short.
        let heads = self.heads(&Pattern::segment("Clock")).await?;
        let middle_ns = (asked_ns as f64 + own_ns() as f64) / 2.0;
        Ok(heads.now_ns.map(|said| (said as f64 - middle_ns) * 1e-9))
    }

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
        let remote = Self { session: session.clone(), agent: agent.into(), questions };
        for _ in 1..MAX_TRIES {
            if remote.answers().await.is_ok() {
                return Ok(remote);
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
        remote.answers().await.map(|()| remote)
    }

    /// Asks for nothing, and waits for the answer.
    async fn answers(&self) -> Result<(), MemoryError> {
        let query = Query { most: Some(0), ..Query::default() };
        let _: Snapshots = self.ask(&QueryRequest { query, parts: true }).await?;
        Ok(())
    }

    /// Asks the agent for maintenance of its long-term memory.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it has none or the store fails; [`MemoryError::Remote`].
    pub async fn maintain(&self, request: &Maintain) -> Result<MaintenanceReport, MemoryError> {
        self.ask(request).await
    }

    async fn ask<Q: Payload, A: Payload>(&self, request: &Q) -> Result<A, MemoryError> {
        let (encoding, payload) = wire::seal(request).map_err(|error| self.failed(error))?;
        let answer = self.session.query_one(&self.questions, "", Some((&encoding, payload))).await;
        match answer.map_err(|error| self.failed(error))? {
            Reply::Message(message) => {
                wire::open(&message.encoding, &message.payload).map_err(|error| self.failed(error))
            }
            Reply::Refusal { encoding, payload } => Err(wire::open::<MemoryError>(&encoding, &payload)
                .unwrap_or_else(|_| self.failed(wire::of_any_kind(&payload)))),
        }
    }

    fn failed(&self, what: impl ToString) -> MemoryError {
        unreachable_memory(&self.agent, what)
    }
}

#[async_trait]
impl Memory for RemoteMemory {
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        let Versions(versions) = self.ask(&CommitRequest { updates, sent_ns: self.session.now_ns() }).await?;
        Ok(versions)
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let mut request = QueryRequest { query: query.clone(), parts: true };
        let mut all = Vec::new();
        loop {
            let found: Snapshots = self.ask(&request).await?;
            let query = &mut request.query;
            if let Some(most) = &mut query.most {
                *most = most.saturating_sub(found.snapshots.len());
            }
            if let Some(most) = &mut query.most_bytes {
                *most = most.saturating_sub(found.snapshots.iter().map(|s| s.bytes()).sum());
            }
            all.extend(found.snapshots);
            let next =
                found.next.filter(|_| found.more && query.most != Some(0) && query.most_bytes != Some(0));
            let Some(next) = next else { return Ok(all) };
            query.after = Some(next);
        }
    }

    async fn heads(&self, pattern: &Pattern) -> Result<Heads, MemoryError> {
        let mut request = HeadsRequest { pattern: pattern.clone(), after: None };
        let mut heads = Heads::default();
        loop {
            let part: HeadsPart = self.ask(&request).await?;
            let head = |(id, version, arrived_ns, removed)| Head { id, version, arrived_ns, removed };
            let is_first = request.after.is_none();
            heads.entities.extend(part.entities.into_iter().map(head));
            if is_first {
                // What changes while later parts are read may belong into the first.
                heads.now_ns = part.now_ns;
                heads.until_ns = heads.entities.iter().map(|head| head.arrived_ns).max().unwrap_or(0);
            }
            if part.next.is_none() {
                return Ok(heads);
            }
            request.after = part.next;
        }
    }

    async fn subscribe(&self, pattern: &Pattern) -> Result<Changes, MemoryError> {
        let failed = |error: SessionError| self.failed(error);
        let one = pattern.exact_segment();
        let keys = keys::memory_changes(&self.agent, one)?;
        let messages = self.session.subscribe(keys, QUEUE).await.map_err(failed)?;
        let service = keys::alive(&self.agent, "memory")?;
        let services = self.session.watch_alive(&service.into(), 16).await.map_err(failed)?;
        // An answer proves that the other side knows the subscription: declarations arrive before queries.
        self.answers().await?;
        let changes = RemoteChanges::new(self.session.clone(), messages, services, one.is_some());
        Ok(Changes::new(pattern.clone(), changes))
    }
}

#[cfg(test)]
pub(crate) mod tests;
