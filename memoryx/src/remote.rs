//! Another agent's memory, over Zenoh: the same trait, with an answer to every commit.
//!
//! Subscribers hear every change once and in order: a gap in an entity's versions, a queue that was too short and a
//! memory that was away for a while all make this side ask for what it has missed. What the other side no longer
//! has shows as a gap in the versions, which a [`Follower`] reports.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use armarium_bus::session::{Answer, Roll};
use armarium_bus::{Session, SessionError, Subscription, keys};
use async_trait::async_trait;
use tokio::sync::{Notify, broadcast};
use tokio::task::JoinSet;

use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::follow::{Change, Follower};
use crate::memory::Memory;
use crate::query::{Cursor, Pattern, Query};
use crate::server::unreachable_memory;
use crate::wire::{self, Changes, CommitRequest, Maintain, Report, Snapshots, Versions};

/// Messages that wait to be looked at, and changes that a subscriber may lag behind.
const QUEUE: usize = 4096;
/// How often a memory that does not answer is asked when connecting.
const TRIES: u32 = 5;
/// How long to wait before a memory that did not answer is asked again for what was missed.
const RETRY: Duration = Duration::from_millis(500);

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
    stream: Mutex<Stream>,
    /// Something was lost, or may have been.
    lost: Notify,
}

/// How far the stream of changes was heard.
#[derive(Debug, Default)]
struct Stream {
    epoch: u64,
    /// The count of the next change, once one was heard.
    next: Option<u64>,
    /// When the last change arrived in the other memory before anything was lost, ns.
    whole_until: u64,
    /// The same of the last change that was heard.
    heard_until: u64,
    /// Gaps so far, and how many of them were closed.
    gaps: u64,
    closed: u64,
}

impl Stream {
    /// What arrived until then is known, ns.
    fn begin(&mut self, until: u64) {
        self.whole_until = self.whole_until.max(until);
        self.heard_until = self.heard_until.max(until);
    }

    /// Takes note of a message of changes. Returns whether something before it is missing.
    fn hear(&mut self, changes: &Changes) -> bool {
        let follows = self.epoch == changes.epoch && self.next.is_none_or(|next| next == changes.first);
        let is_first = self.next.is_none();
        self.epoch = changes.epoch;
        self.next = Some(changes.first + changes.snapshots.len() as u64);
        if !follows && !is_first {
            self.gaps += 1;
        }
        let last = changes.snapshots.last().map_or(0, |s| s.arrived_ns);
        self.heard_until = self.heard_until.max(last);
        if self.gaps == self.closed {
            self.whole_until = self.heard_until;
        }
        !follows && !is_first
    }
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
        let stream = keys::memory_changes(agent).map_err(named)?;
        let service = keys::alive(agent, "memory").map_err(named)?;

        let (raw, changes) = (broadcast::channel(QUEUE).0, broadcast::channel(QUEUE).0);
        let link = Link {
            session: session.clone(),
            agent: agent.into(),
            raw,
            stream: Mutex::default(),
            lost: Notify::new(),
        };
        let link = Arc::new(link);
        let messages = session.subscribe(stream, QUEUE).await.map_err(failed)?;
        let roll = session.watch_alive(&service.into(), 16).await.map_err(failed)?;
        let mut tasks = JoinSet::new();
        tasks.spawn(Arc::clone(&link).hear(messages));
        tasks.spawn(Arc::clone(&link).watch(roll));
        // An answer says that the other side knows of the subscription: declarations travel before questions.
        let follower = link.first_answer().await?;
        link.stream().begin(follower.since_ns());
        tasks.spawn(Arc::clone(&link).tell(follower, changes.clone()));
        Ok(Self { link, changes, _tasks: tasks })
    }
}

impl RemoteMemory {
    /// Has the agent do something with its long-term memory.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it has none, or it fails; [`MemoryError::Remote`].
    pub async fn maintain(&self, request: &Maintain) -> Result<Report, MemoryError> {
        let failed = |error: armarium_bus::CodecError| self.link.failed(&error.to_string());
        let (encoding, payload) = wire::seal(request).map_err(failed)?;
        let (encoding, payload) = self.link.ask(&encoding, payload).await?;
        wire::open(&encoding, &payload).map_err(failed)
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
            match wire::open::<Changes>(&message.encoding, &message.payload) {
                Ok(changes) => {
                    let is_missing = self.stream().hear(&changes);
                    for snapshot in changes.snapshots {
                        // Nobody listening is no error.
                        let _ = self.raw.send(snapshot);
                    }
                    if is_missing {
                        self.lost.notify_one();
                    }
                }
                Err(error) => tracing::warn!(%error, key = message.key, "changes were not understood"),
            }
            if messages.dropped() > dropped {
                dropped = messages.dropped();
                self.lose();
            }
        }
    }

    /// Something may have been lost: what was whole until now has to be looked at again.
    fn lose(&self) {
        self.stream().gaps += 1;
        self.lost.notify_one();
    }

    fn stream(&self) -> MutexGuard<'_, Stream> {
        self.stream.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads what was lost. What is lost meanwhile is read by the next call.
    async fn catch_up(&self, follower: &mut Follower) -> Result<(), MemoryError> {
        let (since, gaps) = {
            let stream = self.stream();
            (stream.whole_until, stream.gaps)
        };
        follower.read_since(since).await?;
        let mut stream = self.stream();
        stream.closed = gaps;
        if stream.gaps == gaps {
            stream.whole_until = stream.heard_until;
        }
        Ok(())
    }

    async fn watch(self: Arc<Self>, mut roll: Roll) {
        while let Some(service) = roll.next().await {
            if service.alive {
                self.lose();
            }
        }
    }

    async fn tell(self: Arc<Self>, mut follower: Follower, changes: broadcast::Sender<Arc<Snapshot>>) {
        loop {
            let told = tokio::select! {
                biased;
                () = self.lost.notified() => self.catch_up(&mut follower).await.map(|()| None),
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
                Err(error) => {
                    tracing::warn!(%error, "what was missed could not be asked for");
                    // The memory is away; it is asked again when it is back, and now and then.
                    tokio::time::sleep(RETRY).await;
                    self.lost.notify_one();
                }
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
        let mut query = query.clone();
        let mut all = Vec::new();
        loop {
            let (encoding, payload) = wire::seal(&query).map_err(|e| self.failed(&e.to_string()))?;
            let (encoding, payload) = self.ask(&encoding, payload).await?;
            let found: Snapshots =
                wire::open(&encoding, &payload).map_err(|e| self.failed(&e.to_string()))?;
            if let Some(most) = &mut query.most {
                *most = most.saturating_sub(found.snapshots.len());
            }
            all.extend(found.snapshots);
            let last = all.last().filter(|_| found.more);
            let Some(last) = last.filter(|_| query.most != Some(0)) else { return Ok(all) };
            query.after = Some(Cursor { id: last.id.clone(), version: last.version });
        }
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
        // Somebody who repeats old news, or tells nonsense, changes nothing.
        let known = pair.memory.latest_now(&commit("a", 0).id).unwrap();
        let (encoding, payload) =
            wire::seal(&Changes { epoch: 7, first: 9, snapshots: vec![known] }).unwrap();
        let key = keys::memory_changes("alice").unwrap();
        pair.far.put_waiting(&key, &encoding, payload.clone()).await.unwrap();
        pair.far.put_waiting(&key, &encoding, vec![0xff; 9]).await.unwrap();
        pair.remote.link.lose();
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
