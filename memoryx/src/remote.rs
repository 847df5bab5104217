//! Another agent's memory, over Zenoh: the same trait, with an answer to every commit.
//!
//! Subscribers hear every change once and in order: a gap in an entity's versions, a queue that was too short and a
//! memory that was away for a while all make this side ask for what it has missed. What the other side no longer
//! has shows as a gap in the versions, which a [`Follower`] reports.

use std::sync::Arc;

use armarium_bus::session::{Answer, Roll};
use armarium_bus::{Session, SessionError, Subscription, keys};
use async_trait::async_trait;
use tokio::sync::{Notify, broadcast};
use tokio::task::JoinSet;

use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::follow::{Change, Follower};
use crate::memory::Memory;
use crate::query::{Pattern, Query};
use crate::server::unreachable_memory;
use crate::wire::{self, CommitRequest, Snapshots, Versions};

/// Messages that wait to be looked at, and changes that a subscriber may lag behind.
const QUEUE: usize = 4096;
/// How often a memory that does not answer is asked when connecting.
const TRIES: u32 = 5;

/// The memory of another agent.
#[derive(Debug)]
pub struct RemoteMemory {
    link: Arc<Link>,
    changes: broadcast::Sender<Arc<Snapshot>>,
    _tasks: JoinSet<()>,
}

/// The questions that can be asked, and the changes as they come, gaps and all.
#[derive(Debug)]
struct Link {
    session: Session,
    agent: String,
    raw: broadcast::Sender<Arc<Snapshot>>,
    /// Something may have been lost without a gap that shows.
    lost: Notify,
}

impl RemoteMemory {
    /// Connects to the memory of `agent`, which has to answer.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when the agent's name cannot be part of a key; [`MemoryError::Remote`] when nobody
    /// answers or Zenoh fails.
    pub async fn connect(session: &Session, agent: &str) -> Result<Self, MemoryError> {
        let named = |error: armarium_bus::KeyError| MemoryError::Name { name: error.name };
        let failed = |error: SessionError| unreachable_memory(agent, &error.to_string());
        let entities = wire::every_entity(agent).map_err(named)?;
        let service = keys::alive(agent, "memory").map_err(named)?;

        let (raw, changes) = (broadcast::channel(QUEUE).0, broadcast::channel(QUEUE).0);
        let link = Link { session: session.clone(), agent: agent.into(), raw, lost: Notify::new() };
        let link = Arc::new(link);
        let messages = session.subscribe(entities, QUEUE).await.map_err(failed)?;
        let roll = session.watch_alive(&service.into(), 16).await.map_err(failed)?;
        let mut tasks = JoinSet::new();
        tasks.spawn(Arc::clone(&link).hear(messages));
        tasks.spawn(Arc::clone(&link).watch(roll));
        // An answer says that the other side knows of the subscription: declarations travel before questions.
        let follower = link.first_answer().await?;
        tasks.spawn(Arc::clone(&link).tell(follower, changes.clone()));
        Ok(Self { link, changes, _tasks: tasks })
    }
}

impl Link {
    async fn first_answer(self: &Arc<Self>) -> Result<Follower, MemoryError> {
        let mut tries = 0;
        loop {
            tries += 1;
            let shared: Arc<dyn Memory> = Arc::<Self>::clone(self);
            match Follower::from_now(shared, Pattern::any()).await {
                Ok((follower, _)) => return Ok(follower),
                Err(error) if tries == TRIES => return Err(error),
                Err(_) => tokio::time::sleep(std::time::Duration::from_millis(100)).await,
            }
        }
    }

    async fn hear(self: Arc<Self>, mut messages: Subscription) {
        let mut dropped = 0;
        while let Some(message) = messages.next().await {
            // Others put updates on the same keys; only the memory itself says what holds.
            if message.encoding.starts_with("application/cbor;memoryx/entity;") {
                match wire::open::<Snapshot>(&message.encoding, &message.payload) {
                    Ok(snapshot) if message.key.ends_with(&format!("/memory/{}", snapshot.id)) => {
                        // Nobody listening is no error.
                        let _ = self.raw.send(Arc::new(snapshot));
                    }
                    Ok(snapshot) => {
                        tracing::warn!(key = message.key, id = %snapshot.id, "a snapshot on another's key")
                    }
                    Err(error) => tracing::warn!(%error, key = message.key, "a snapshot was not understood"),
                }
            }
            if messages.dropped() > dropped {
                dropped = messages.dropped();
                self.lost.notify_one();
            }
        }
    }

    async fn watch(self: Arc<Self>, mut roll: Roll) {
        while let Some(service) = roll.next().await {
            if service.alive {
                self.lost.notify_one();
            }
        }
    }

    async fn tell(self: Arc<Self>, mut follower: Follower, changes: broadcast::Sender<Arc<Snapshot>>) {
        loop {
            let told = tokio::select! {
                biased;
                () = self.lost.notified() => follower.read_again().await.map(|()| None),
                change = follower.next() => match change {
                    Ok(None) => return,
                    change => change,
                },
            };
            match told {
                Ok(Some(Change::New(snapshot))) => {
                    let _ = changes.send(snapshot);
                }
                Ok(Some(Change::Missed { id, from, to })) => {
                    tracing::warn!(%id, from, to, agent = self.agent, "the memory no longer has these versions");
                }
                Ok(None) => {}
                Err(error) => tracing::warn!(%error, "what was missed could not be asked for"),
            }
        }
    }

    async fn ask(&self, encoding: &str, payload: Vec<u8>) -> Result<(String, Vec<u8>), MemoryError> {
        let key = keys::memory_commit(&self.agent).map_err(|e| MemoryError::Name { name: e.name })?;
        let answer = self.session.ask_one(&key, "", Some((encoding, payload))).await;
        match answer.map_err(|error| self.failed(&error.to_string()))? {
            Answer::Message(message) => Ok((message.encoding, message.payload)),
            Answer::Refusal { encoding, payload } => Err(wire::open::<MemoryError>(&encoding, &payload)
                .unwrap_or_else(|_| self.failed(&String::from_utf8_lossy(&payload)))),
        }
    }

    fn failed(&self, what: &str) -> MemoryError {
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

    async fn latest(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        let found = self.query(&Query::latest(Pattern::entity(id))).await?.pop();
        found.ok_or_else(|| MemoryError::NotFound { id: id.to_string() })
    }

    async fn segment(&self, segment: &str) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.query(&Query::latest(Pattern::segment(segment))).await
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let (encoding, payload) = wire::seal(query).map_err(|e| self.failed(&e.to_string()))?;
        let (encoding, payload) = self.ask(&encoding, payload).await?;
        let Snapshots(found) = wire::open(&encoding, &payload).map_err(|e| self.failed(&e.to_string()))?;
        Ok(found.into_iter().map(Arc::new).collect())
    }

    fn subscribe(&self) -> broadcast::Receiver<Arc<Snapshot>> {
        self.raw.subscribe()
    }
}

#[async_trait]
impl Memory for RemoteMemory {
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        self.link.commit(updates).await
    }

    async fn latest(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        self.link.latest(id).await
    }

    async fn segment(&self, segment: &str) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.link.segment(segment).await
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.link.query(query).await
    }

    fn subscribe(&self) -> broadcast::Receiver<Arc<Snapshot>> {
        self.changes.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use armarium_bus::SessionConfig;
    use armarium_values::Value;

    use super::*;
    use crate::conformance;
    use crate::server::MemoryServer;
    use crate::working::{Limits, WorkingMemory};

    struct Pair {
        memory: Arc<WorkingMemory>,
        remote: RemoteMemory,
        near: Session,
        far: Session,
        _server: MemoryServer,
    }

    async fn pair() -> Pair {
        let memory = WorkingMemory::new(Arc::new(|| 0));
        let memory = Arc::new(memory.with_limits(Limits { history: 64, ..Limits::default() }));
        let far = Session::open(&SessionConfig::default()).await.unwrap();
        let server = MemoryServer::start(&far, "alice", Arc::clone(&memory)).await.unwrap();
        let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.unwrap();
        let remote = RemoteMemory::connect(&near, "alice").await.unwrap();
        Pair { memory, remote, near, far, _server: server }
    }

    fn commit(name: &str, value: i64) -> Commit {
        let id = EntityId::new("Things", "p", name).unwrap();
        Commit::new(id, 1, BTreeMap::from([("value".to_owned(), Value::Int(value))]))
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn it_conforms() {
        let pair = pair().await;
        conformance::check(&pair.remote).await.unwrap();
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn updates_that_are_put_and_gets_by_key_work_without_this_program() {
        let pair = pair().await;
        let mut changes = pair.remote.subscribe();
        let key = keys::memory("alice", "Things", "p", "a").unwrap();
        let (encoding, payload) = wire::seal(&commit("a", 7)).unwrap();
        let update = commit("a", 7);
        pair.near.put_waiting(&key, "application/cbor;memoryx/update;v9", payload.clone()).await.unwrap();
        pair.near.put_waiting(&key, &encoding, vec![0xff; 10]).await.unwrap();
        pair.near.put_waiting(&key, &encoding, payload).await.unwrap();
        let heard = changes.recv().await.unwrap();
        assert_eq!((heard.version, &heard.instances), (1, &update.instances), "the bad ones changed nothing");
        assert!(heard.sent_ns > 0);

        let every = wire::every_entity("alice").unwrap();
        let answers =
            pair.near.ask(every, "history", None, 10, armarium_bus::session::ANSWER_TIMEOUT).await.unwrap();
        let [Answer::Message(message)] = &answers[..] else { panic!("one answer, not {answers:?}") };
        assert_eq!(message.key, "alice/memory/Things/p/a");
        assert_eq!(wire::open::<Snapshot>(&message.encoding, &message.payload).unwrap(), *heard);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn what_was_missed_is_asked_for() {
        let pair = pair().await;
        let mut changes = pair.remote.subscribe();
        for i in 0..5 {
            pair.memory.commit_now(vec![commit("a", i)]).unwrap();
        }
        // Somebody who repeats old news, tells them on another's key, or tells nonsense changes nothing.
        let known = pair.memory.latest_now(&commit("a", 0).id).unwrap();
        let (encoding, payload) = wire::seal(&*known).unwrap();
        for name in ["a", "b"] {
            let key = keys::memory("alice", "Things", "p", name).unwrap();
            pair.far.put_waiting(&key, &encoding, payload.clone()).await.unwrap();
        }
        pair.remote.link.lost.notify_one();
        pair.memory.commit_now(vec![commit("end", 0)]).unwrap();
        let mut heard = Vec::new();
        while heard.last().is_none_or(|(name, _)| name != "end") {
            let snapshot = changes.recv().await.unwrap();
            heard.push((snapshot.id.entity().to_owned(), snapshot.version));
        }
        let expected: Vec<_> = (1..=5).map(|v| ("a".to_owned(), v)).chain([("end".to_owned(), 1)]).collect();
        assert_eq!(heard, expected);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_memory_that_is_not_there_is_an_error() {
        let session = Session::open(&SessionConfig::default()).await.unwrap();
        let error = RemoteMemory::connect(&session, "nobody").await.unwrap_err();
        assert!(matches!(error, MemoryError::Remote { .. }), "{error}");
        assert!(matches!(RemoteMemory::connect(&session, "no/body").await, Err(MemoryError::Name { .. })));
    }
}
