//! Working memory: what an agent knows now, in this process, with a bounded history of each entity.
//!
//! - The clock is passed in ([`Clock`]); arrival times come from it and from nowhere else.
//! - Typed core segments are checked, others are free ([`SegmentSchema`]).
//! - A [`Backing`] makes commits durable before they are acknowledged, and keeps the version numbers of entities
//!   that this memory has not seen yet.
//! - Writers wait for each other; those who wait together are made durable together, by one write of the backing. A
//!   reader waits only while the new snapshots are put in, never for the backing.
//! - What it holds is bounded: entities, history, bytes, how far ahead data may speak.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::broadcast;

use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::Memory;
use crate::query::{Pattern, Query};
use crate::schema::{SegmentSchema, core_segments};

mod committing;
mod held;
mod merged_view;

use committing::{CommitResult, Numbered, Request};
use held::{State, Taken};
use merged_view::MergedView;
use parking_lot::{Mutex, RwLock};

/// Tells the time, ns since an epoch that the whole memory shares.
pub type Clock = Arc<dyn Fn() -> u64 + Send + Sync>;

/// The time since this call on tokio's clock, ns: virtual time where that clock is paused.
#[must_use]
pub fn tokio_clock() -> Clock {
    let start = tokio::time::Instant::now();
    Arc::new(move || u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX))
}

/// How much a working memory holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Newest snapshots kept of each entity; at least 1.
    pub history: usize,
    /// Most entities.
    pub entities: usize,
    /// Changes that a subscriber may lag behind before it misses some.
    pub backlog: usize,
    /// Most bytes of all snapshots together, about.
    pub bytes: u64,
    /// How far ahead of this memory's clock data may speak, ns; any time where none is given.
    pub ahead_ns: Option<u64>,
    /// Into how many shares entities and bytes are divided: whoever owns a provider segment, which is its name up to the
    /// first dot, takes one of them at most, so that there is room for others. 1: nobody is held back.
    pub shares: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { history: 32, entities: 1_000_000, backlog: 4096, bytes: 4 << 30, ahead_ns: None, shares: 1 }
    }
}

impl Limits {
    /// Of a memory that others write to: no time that is more than a minute ahead, and a quarter of it for an owner at most.
    #[must_use]
    pub fn of_agent() -> Self {
        Self { ahead_ns: Some(60_000_000_000), shares: 4, ..Self::default() }
    }
}

/// What stands behind a working memory: it is asked before a commit is acknowledged.
pub trait Backing: Send + Sync {
    /// The newest version that was ever given to an entity that is not in working memory; 0 if there was none.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when that cannot be found out.
    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError>;

    /// Takes the snapshots of one commit, all or none, before it is acknowledged or seen by anybody. May block
    /// for a write to disk.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when they cannot be taken; the commit is then refused.
    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError>;

    /// What it has taken so far, where that can be asked.
    fn kept(&self) -> Option<&dyn Kept> {
        None
    }
}

/// All that a [`Backing`] was ever given.
pub trait Kept {
    /// What a query asks for.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it cannot be read; [`MemoryError::Query`].
    fn recall(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError>;

    /// Gives the versions that a query chooses of the one entity that its pattern names, whatever its bounds, to `act`, in
    /// their order or `backwards`, until it says that this is enough. The query is not about one time.
    ///
    /// # Errors
    /// As [`Self::recall`].
    fn versions(
        &self,
        query: &Query,
        backwards: bool,
        act: &mut dyn FnMut(u64) -> bool,
    ) -> Result<(), MemoryError>;
}

/// The memory of one agent, in this process.
pub struct WorkingMemory {
    clock: Clock,
    limits: Limits,
    schemas: BTreeMap<String, SegmentSchema>,
    backing: Option<Arc<dyn Backing>>,
    /// Most snapshots that the backing is asked for at once.
    part: usize,
    changes: broadcast::Sender<Arc<Snapshot>>,
    /// Commits that wait for the one who commits.
    waiting: Mutex<Vec<Request>>,
    /// Held by the one who commits, over the backing's answer; the time of the last arrival, ns.
    committing: Mutex<u64>,
    state: RwLock<State>,
}

impl WorkingMemory {
    /// An empty memory with the standard core segments and [`Limits::default`].
    #[must_use]
    pub fn new(clock: Clock) -> Self {
        let limits = Limits::default();
        Self {
            clock,
            limits,
            schemas: core_segments(),
            backing: None,
            part: merged_view::PART,
            changes: broadcast::channel(limits.backlog).0,
            waiting: Mutex::default(),
            committing: Mutex::new(0),
            state: RwLock::default(),
        }
    }

    /// The same memory with other limits. To be called before anybody subscribes.
    #[must_use]
    pub fn with_limits(mut self, limits: Limits) -> Self {
        self.limits = Limits { history: limits.history.max(1), shares: limits.shares.max(1), ..limits };
        self.changes = broadcast::channel(limits.backlog.clamp(1, 1 << 24)).0;
        self
    }

    /// The same memory with one more typed core segment; it replaces one of the same name.
    #[must_use]
    pub fn with_schema(mut self, schema: SegmentSchema) -> Self {
        self.schemas.insert(schema.segment.clone(), schema);
        self
    }

    /// The same memory on something that keeps its commits.
    #[must_use]
    pub fn with_backing(mut self, backing: Arc<dyn Backing>) -> Self {
        self.backing = Some(backing);
        self
    }

    /// The same memory, which asks its backing in smaller parts.
    #[cfg(test)]
    pub(crate) fn in_parts_of(mut self, part: usize) -> Self {
        self.part = part;
        self
    }

    /// The typed core segments by name.
    #[must_use]
    pub fn schemas(&self) -> &BTreeMap<String, SegmentSchema> {
        &self.schemas
    }

    /// The memory's time, ns.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        (self.clock)()
    }

    /// Whether something keeps its commits, so that they may take as long as a disk does.
    #[must_use]
    pub fn has_backing(&self) -> bool {
        self.backing.is_some()
    }

    /// How many entities it holds, the removed ones included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.read().len()
    }

    /// How many bytes its snapshots take, about.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.read().bytes()
    }

    /// Whether it holds nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// [`Memory::commit`] without a task: blocks only as long as the backing does.
    ///
    /// # Errors
    /// As [`Memory::commit`].
    pub fn commit_now(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        let now = self.now_ns();
        self.commit_sent(updates, now)
    }

    /// [`Self::commit_now`] of updates that were sent at `sent_ns`.
    ///
    /// # Errors
    /// As [`Memory::commit`].
    pub fn commit_sent(&self, updates: Vec<Commit>, sent_ns: u64) -> Result<Vec<u64>, MemoryError> {
        self.write(updates, sent_ns, false)
    }

    /// Several commits at once: each is taken or refused for itself, and those that are taken are made durable
    /// together.
    pub fn commit_group(&self, commits: Vec<(Vec<Commit>, u64)>) -> Vec<Result<Vec<u64>, MemoryError>> {
        let answers: Vec<_> = commits.iter().map(|_| Arc::new(Mutex::new(None))).collect();
        let requests = commits.into_iter().zip(&answers).map(|((updates, sent_ns), answer)| Request {
            updates,
            sent_ns,
            prior: false,
            answer: Arc::clone(answer),
        });
        let requests: Vec<_> = requests.collect();
        self.waiting.lock().extend(requests);
        self.commit_waiting();
        let taken = |answer: Arc<Mutex<Option<CommitResult>>>| {
            let answer = answer.lock().take();
            answer.expect("whoever takes a request from the queue answers it")
        };
        answers.into_iter().map(taken).collect()
    }

    /// Makes a provider segment read-only for everybody: prior knowledge.
    pub fn protect(&self, segment: &str, provider: &str) {
        let mut state = self.state.write();
        state.read_only.insert((segment.into(), provider.into()));
    }

    /// Whether an entity is in a read-only provider segment.
    #[must_use]
    pub fn is_read_only(&self, id: &EntityId) -> bool {
        self.read().is_read_only(id)
    }

    /// Commits into read-only provider segments too.
    pub(crate) fn commit_prior(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        let now = self.now_ns();
        self.write(updates, now, true)
    }

    /// Whether a snapshot that comes from elsewhere, with its version, is one that this memory could have made.
    ///
    /// # Errors
    /// [`MemoryError::Store`] for its version; [`MemoryError::Schema`] and [`MemoryError::Confidence`].
    pub fn check_kept(&self, snapshot: &Snapshot) -> Result<(), MemoryError> {
        snapshot.check_version()?;
        self.check(&snapshot.id, &snapshot.instances)
    }

    /// Puts back what a store has kept, with its versions and times; what this memory knows as new or newer stays, and
    /// what it would not take is left out: that is in the store only. Returns how many snapshots were put back, and why
    /// the first one was left out. The backing is not asked: it is where they come from.
    pub fn restore(&self, snapshots: Vec<Arc<Snapshot>>) -> (usize, Option<MemoryError>) {
        let _one_writer = self.committing.lock();
        let state = self.read();
        let (mut room, mut restored) = (Numbered::default(), BTreeSet::new());
        let (mut fitting, mut refused) = (Vec::with_capacity(snapshots.len()), None);
        for snapshot in snapshots {
            let newest = state.newest(&snapshot.id).map_or(0, |s| s.version);
            if snapshot.version <= newest {
                continue;
            }
            let is_new = newest == 0 && !restored.contains(&snapshot.id);
            let put = (&snapshot.id, snapshot.instances.as_slice());
            let fits = self.check_kept(&snapshot);
            match fits.and_then(|()| self.check_room(&state, &room, put, is_new, None)) {
                Ok(bytes) => {
                    room.take(None, Taken { entities: usize::from(is_new), bytes });
                    restored.insert(snapshot.id.clone());
                    fitting.push(snapshot);
                }
                Err(error) => refused = refused.or(Some(error)),
            }
        }
        drop(state);
        let count = fitting.len();
        self.put_in(fitting);
        (count, refused)
    }

    /// [`Memory::latest`] without a task.
    ///
    /// # Errors
    /// [`MemoryError::NotFound`] when there is none.
    pub fn latest_now(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        let found = self.read().newest(id).filter(|s| !s.is_removed()).cloned();
        found.ok_or_else(|| MemoryError::NotFound { id: id.to_string() })
    }

    /// [`Memory::query`] without a task.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub fn query_now(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let asked = query.check()?;
        let kept = self.backing.as_ref().filter(|_| query.long_term).and_then(|backing| backing.kept());
        match kept {
            Some(kept) => MergedView { memory: self, kept }.ask(&asked),
            None => Ok(self.read().select(&asked)),
        }
    }

    fn read(&self) -> parking_lot::RwLockReadGuard<'_, State> {
        self.state.read()
    }
}

#[async_trait]
impl Memory for WorkingMemory {
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        self.commit_now(updates)
    }

    async fn latest(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        self.latest_now(id)
    }

    async fn segment(&self, segment: &str) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.query_now(&Query::latest(Pattern::segment(segment)))
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        self.query_now(query)
    }

    fn subscribe(&self) -> broadcast::Receiver<Arc<Snapshot>> {
        self.changes.subscribe()
    }
}

impl fmt::Debug for WorkingMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WorkingMemory").field("limits", &self.limits).finish_non_exhaustive()
    }
}
