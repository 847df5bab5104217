//! Publishes a memory's changes and, when there are no more, their number: so a reader that missed the last ones soon
//! notices. Answers no queries.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::stream::{StreamPosition, StreamWriter};
use armarium_bus::{Interest, Key, Session, SessionError, keys};

use super::{log_failure, unreachable_memory};
use crate::entity::Snapshot;
use crate::error::MemoryError;
use crate::follow::{Change, Follower};
use crate::wire::{self, Changes};

/// Most changes in one round.
const MAX_BATCH: usize = 2048;
/// Time without changes after which their number is published; then again after twice the time, and so on. So a
/// paused connection only delays it, and an idle memory publishes ever more rarely.
const QUIET_INTERVAL: Duration = Duration::from_millis(80);
/// How long to wait before a failed read of the memory is repeated.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// Publishes what a follower reports.
pub(super) struct ChangePublisher {
    session: Session,
    agent: String,
    key: Key,
    stream: StreamWriter,
    /// Everything that arrived before this time was published, ns.
    until_ns: u64,
    /// Subscribers to single entities, which do not read [`Changes`].
    each: Interest,
    /// While this is declared, Zenoh sends nothing to a router without followers behind it.
    _followers: Interest,
}

impl ChangePublisher {
    pub(super) async fn new(session: &Session, agent: &str) -> Result<Self, MemoryError> {
        let failed = |error: SessionError| unreachable_memory(agent, &error.to_string());
        let entities = wire::every_entity(agent)?;
        let key = keys::memory_changes(agent)?;
        Ok(Self {
            session: session.clone(),
            agent: agent.into(),
            stream: StreamWriter::new(session.now_ns()),
            until_ns: 0,
            each: session.interest(&entities).await.map_err(failed)?,
            _followers: session.interest(&key.clone().into()).await.map_err(failed)?,
            key,
        })
    }

    /// Runs until the memory closes.
    pub(super) async fn publish(mut self, mut follower: Follower) {
        let mut quiet = QUIET_INTERVAL;
        loop {
            let changes = tokio::select! {
                biased;
                changes = follower.some(MAX_BATCH) => changes,
                // If nothing was published, nothing was missed.
                () = tokio::time::sleep(quiet), if self.stream.sent() > 0 => {
                    self.publish_together(Vec::new(), self.until_ns).await;
                    quiet = quiet.saturating_mul(2);
                    continue;
                }
            };
            let news = match changes {
                Ok(changes) if changes.is_empty() => return,
                Ok(changes) => news(changes),
                Err(error) => {
                    tracing::warn!(%error, "changes could not be read");
                    tokio::time::sleep(RETRY_INTERVAL).await;
                    continue;
                }
            };
            if self.each.has_subscribers() {
                self.publish_each(&news).await;
            }
            self.publish_together(news, follower.complete_until()).await;
            quiet = QUIET_INTERVAL;
        }
    }

    /// Publishes changes in as many messages as needed. An empty list gives one message with the number of changes
    /// before it. Everything that arrived before `until_ns` is contained up to the last message.
    async fn publish_together(&mut self, mut news: Vec<Arc<Snapshot>>, until_ns: u64) {
        loop {
            let rest = news.split_off(wire::in_one_answer(&news));
            if rest.is_empty() {
                self.until_ns = until_ns;
            }
            let StreamPosition { epoch, number: first } = self.stream.advance(news.len());
            let changes = Changes { epoch, first, until_ns: self.until_ns, snapshots: news };
            match wire::seal(&changes) {
                Ok((encoding, payload)) => log_failure(self.session.put(&self.key, &encoding, payload).await),
                Err(error) => tracing::warn!(%error, "changes could not be told"),
            }
            if rest.is_empty() {
                return;
            }
            news = rest;
        }
    }

    /// Publishes changes on the keys of their entities.
    async fn publish_each(&self, news: &[Arc<Snapshot>]) {
        for snapshot in news {
            let (Ok(key), Ok((encoding, payload))) =
                (wire::entity_key(&self.agent, snapshot), wire::seal(&**snapshot))
            else {
                continue;
            };
            log_failure(self.session.put(&key, &encoding, payload).await);
        }
    }
}

fn news(changes: Vec<Change>) -> Vec<Arc<Snapshot>> {
    let new = |change| match change {
        Change::New(snapshot) => Some(snapshot),
        Change::Missed { id, from, to } => {
            tracing::warn!(%id, from, to, "versions were overtaken before they could be told");
            None
        }
    };
    changes.into_iter().filter_map(new).collect()
}
