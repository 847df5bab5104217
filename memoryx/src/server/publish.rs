//! Tells a memory's changes as they come, and when nothing more comes, how many there were: so whoever has missed the last
//! ones learns it soon. Answers nobody.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::stream::{StreamPosition, StreamWriter};
use armarium_bus::{Interest, Key, Session, SessionError, keys};

use super::{log_failure, unreachable_memory};
use crate::entity::Snapshot;
use crate::error::MemoryError;
use crate::follow::{Change, Follower};
use crate::wire::{self, Changes};

/// Changes that are told together.
const TOGETHER: usize = 2048;
/// After how long without changes their number is told. It is told again after twice as long, and so on: a line that takes
/// nothing for a while delays it, and a memory in which nothing happens ever more rarely says so.
const QUIET: Duration = Duration::from_millis(80);
/// How long to wait before a memory that could not be read is read again.
const RETRY: Duration = Duration::from_millis(500);

/// Publishes what a follower hears.
pub(super) struct ChangePublisher {
    session: Session,
    agent: String,
    key: Key,
    stream: StreamWriter,
    /// What arrived before was told, ns.
    until_ns: u64,
    /// Those who know nothing of [`Changes`].
    each: Interest,
    /// While this is declared, nothing goes to a router behind which nobody follows.
    _followers: Interest,
}

impl ChangePublisher {
    pub(super) async fn new(session: &Session, agent: &str) -> Result<Self, MemoryError> {
        let failed = |error: SessionError| unreachable_memory(agent, &error.to_string());
        let named = |error: armarium_bus::KeyError| MemoryError::Name { name: error.name };
        let entities = wire::every_entity(agent).map_err(named)?;
        let key = keys::memory_changes(agent).map_err(named)?;
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

    /// Until the memory has gone.
    pub(super) async fn publish(mut self, mut follower: Follower) {
        let mut quiet = QUIET;
        loop {
            let changes = tokio::select! {
                biased;
                changes = follower.some(TOGETHER) => changes,
                // Where nothing was told, nothing was missed.
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
                    tokio::time::sleep(RETRY).await;
                    continue;
                }
            };
            if self.each.is_there() {
                self.publish_each(&news).await;
            }
            self.publish_together(news, follower.told_until()).await;
            quiet = QUIET;
        }
    }

    /// Tells changes in as many messages as it takes; none at all in one, which says how many there were before.
    /// What arrived before `until_ns` is told with the last of them.
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

    /// Tells changes on the keys of their entities.
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
