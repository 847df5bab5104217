//! The link to another agent's memory: queries and commits, and the incoming changes, before gaps are filled and
//! order is restored.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::session::{LivelinessSubscription, Reply};
use armarium_bus::{Key, Session, Subscription};
use async_trait::async_trait;
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{Notify, broadcast};

use super::stream::ReceivedStream;
use crate::entity::{Commit, Snapshot};
use crate::error::MemoryError;
use crate::follow::{Change, Follower};
use crate::memory::Memory;
use crate::query::{Pattern, Query};
use crate::server::unreachable_memory;
use crate::wire::{self, Changes, CommitRequest, QueryRequest, Snapshots, Versions};

/// How often connecting tries a memory that does not answer.
const MAX_TRIES: u32 = 5;
/// How long to wait before missed changes are queried again from a memory that did not answer.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);
/// Changes in `raw` above which no further message is decoded.
const MAX_RAW_WAITING: usize = 8192;
/// Changes that are put in order at once.
const MAX_BATCH: usize = 1024;

/// Queries and commits to the other memory, and its changes as they arrive, with gaps.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) session: Session,
    pub(super) agent: String,
    /// The key of its queryable.
    pub(super) questions: Key,
    pub(super) raw: broadcast::Sender<Arc<Snapshot>>,
    pub(super) stream: Mutex<ReceivedStream>,
    /// Notified when something was lost, or may have been.
    pub(super) lost: Notify,
    /// Notified when the follower has taken a change out of `raw`.
    pub(super) taken: Notify,
    /// Subscribers have received everything that arrived in the other memory before this time, ns.
    pub(super) delivered_until: AtomicU64,
}

impl Link {
    pub(super) async fn first_answer(self: &Arc<Self>) -> Result<Follower, MemoryError> {
        let mut tries = 0;
        loop {
            tries += 1;
            let shared: Arc<dyn Memory> = Arc::<Self>::clone(self);
            match Follower::from_now(shared, Pattern::any()).await {
                Ok((follower, _)) => return Ok(follower),
                Err(error) if tries == MAX_TRIES => return Err(error),
                Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
            }
        }
    }

    pub(super) async fn receive(self: Arc<Self>, mut messages: Subscription) {
        let mut dropped = 0;
        while let Some(message) = messages.next().await {
            match wire::open::<Changes>(&message.encoding, &message.payload) {
                Ok(changes) => {
                    // Further messages wait in the subscription's queue, which counts what it drops.
                    while self.raw.len() > MAX_RAW_WAITING {
                        self.taken.notified().await;
                    }
                    if self.take(changes) {
                        self.lost.notify_one();
                    }
                }
                Err(error) => {
                    let sender = self.session.sender(message.sender.as_deref()).await;
                    tracing::warn!(%error, key = message.key, sender, "changes were not understood");
                }
            }
            if messages.dropped() > dropped {
                dropped = messages.dropped();
                self.note_loss();
            }
        }
    }

    /// Puts changes into `raw`. Returns whether a gap precedes them. The lock on `stream` covers both, so that a
    /// reader of `complete_until` finds all of those changes in `raw`.
    fn take(&self, changes: Changes) -> bool {
        let mut stream = self.stream();
        let is_missing = stream.receive(&changes);
        for snapshot in changes.snapshots {
            // Having no receiver is not an error.
            let _ = self.raw.send(snapshot);
        }
        is_missing
    }

    /// Something may have been lost: schedules a new read from the last time without a gap.
    pub(super) fn note_loss(&self) {
        self.stream().note_loss();
        self.lost.notify_one();
    }

    pub(super) fn stream(&self) -> MutexGuard<'_, ReceivedStream> {
        self.stream.lock()
    }

    /// Reads what was lost. Losses during the read are left to the next call.
    async fn catch_up(&self, follower: &mut Follower) -> Result<(), MemoryError> {
        let gaps = self.stream().gaps();
        // Start from what was taken out of `raw`, not from what was received: changes that still wait in `raw` come
        // later, and the versions before them must not count as lost.
        follower.catch_up().await?;
        self.stream().close_gap(gaps);
        Ok(())
    }

    pub(super) async fn watch(self: Arc<Self>, mut services: LivelinessSubscription) {
        while let Some(service) = services.next().await {
            if service.alive {
                self.note_loss();
            }
        }
    }

    pub(super) async fn deliver(
        self: Arc<Self>,
        mut follower: Follower,
        changes: broadcast::Sender<Arc<Snapshot>>,
    ) {
        loop {
            let until = self.stream().complete_until();
            let told = tokio::select! {
                biased;
                () = self.lost.notified() => self.catch_up(&mut follower).await.map(|()| Vec::new()),
                some = follower.some(MAX_BATCH) => match some {
                    Ok(some) if some.is_empty() => return,
                    some => some,
                },
            };
            match told {
                Ok(some) => {
                    some.into_iter().for_each(|change| self.pass_on(change, &changes));
                    if follower.is_caught_up() {
                        self.delivered_until.fetch_max(until, Ordering::Release);
                    }
                }
                Err(error) => {
                    tracing::warn!(%error, "what was missed could not be asked for");
                    // The memory is away: try again after a while, and when it is back.
                    tokio::time::sleep(RETRY_INTERVAL).await;
                    self.lost.notify_one();
                }
            }
        }
    }

    fn pass_on(&self, change: Change, changes: &broadcast::Sender<Arc<Snapshot>>) {
        match change {
            Change::New(snapshot) => {
                let _ = changes.send(snapshot);
            }
            Change::Missed { id, from, to } => {
                tracing::warn!(%id, from, to, agent = self.agent, "the memory no longer has these versions");
            }
        }
    }

    pub(super) async fn ask(
        &self,
        encoding: &str,
        payload: Vec<u8>,
    ) -> Result<(String, Vec<u8>), MemoryError> {
        let answer = self.session.query_one(&self.questions, "", Some((encoding, payload))).await;
        match answer.map_err(|error| self.failed(&error.to_string()))? {
            Reply::Message(message) => Ok((message.encoding, message.payload)),
            Reply::Refusal { encoding, payload } => Err(wire::open::<MemoryError>(&encoding, &payload)
                .unwrap_or_else(|_| self.failed(&String::from_utf8_lossy(&payload)))),
        }
    }

    pub(super) fn failed(&self, what: &str) -> MemoryError {
        unreachable_memory(&self.agent, what)
    }
}

#[async_trait]
impl Memory for Link {
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        let request = CommitRequest { updates, sent_ns: self.session.now_ns() };
        let (encoding, payload) = wire::seal(&request).map_err(|e| self.failed(&e.to_string()))?;
        let (encoding, payload) = self.ask(&encoding, payload).await?;
        let Versions(versions) = wire::open(&encoding, &payload).map_err(|e| self.failed(&e.to_string()))?;
        Ok(versions)
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let mut request = QueryRequest { query: query.clone(), parts: true };
        let mut all = Vec::new();
        loop {
            let (encoding, payload) = wire::seal(&request).map_err(|e| self.failed(&e.to_string()))?;
            let (encoding, payload) = self.ask(&encoding, payload).await?;
            let found: Snapshots =
                wire::open(&encoding, &payload).map_err(|e| self.failed(&e.to_string()))?;
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

    fn subscribe(&self) -> broadcast::Receiver<Arc<Snapshot>> {
        self.raw.subscribe()
    }

    /// The follower calls this after each change that it takes, even if it then reports nothing and [`Self::deliver`]
    /// does not see it. So this is where [`Self::receive`] is notified that `raw` has room.
    fn complete_until(&self) -> Option<u64> {
        self.taken.notify_one();
        Some(self.stream().complete_until())
    }
}
