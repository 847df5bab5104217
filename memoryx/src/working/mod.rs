//! Working memory: an agent's present knowledge, in this process, with a bounded history of each entity.
//!
//! - The clock is passed in ([`Clock`]); arrival times come only from it.
//! - Typed core segments are checked, others are not ([`SegmentSchema`]).
//! - A [`Backing`] makes commits durable before they are acknowledged, and knows the version numbers of entities that
//!   this memory does not hold.
//! - Writers wait for each other; those that wait together are made durable by one write of the backing. Readers wait
//!   only while new snapshots are inserted, never for the backing.
//! - Its content is bounded: entities, history, bytes, and how far in the future data may be.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::broadcast;

use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::Memory;
use crate::query::Query;
use crate::schema::{SegmentSchema, core_segments};

mod content;
mod group_commit;
mod merged_view;

use content::{Content, Usage};
use group_commit::{GroupVersions, Request};
use merged_view::MergedView;
use parking_lot::{Mutex, RwLock};

/// Returns the time, ns since an epoch that the whole memory shares.
pub type Clock = Arc<dyn Fn() -> u64 + Send + Sync>;

/// A clock that counts from this call on tokio's clock, ns: virtual time where that clock is paused.
pub fn tokio_clock() -> Clock {
    let start = tokio::time::Instant::now();
    Arc::new(move || u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX))
}

/// The capacity of a working memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryLimits {
    /// Newest snapshots that are kept of each entity; at least 1.
    pub history: usize,
    /// Most entities.
    pub entities: usize,
    /// Changes that a subscriber may lag behind before it misses some.
    pub backlog: usize,
    /// Most bytes of all snapshots together, about.
    pub bytes: u64,
    /// How far in the future of this memory's clock data may be, ns; `None`: no limit.
    pub ahead_ns: Option<u64>,
    /// Into how many shares entities and bytes are divided. The owner of provider segments, which is their name up to
    /// the first dot, gets one share at most, so that capacity remains for others. 1: no owner is limited.
    pub shares: u32,
}

impl Default for MemoryLimits {
    fn default() -> Self {
        Self { history: 32, entities: 1_000_000, backlog: 4096, bytes: 4 << 30, ahead_ns: None, shares: 1 }
    }
}

impl MemoryLimits {
    /// For a memory that others write to: data at most a minute in the future, and a quarter of the capacity per
    /// owner.
    pub fn of_agent() -> Self {
        Self { ahead_ns: Some(60_000_000_000), shares: 4, ..Self::default() }
    }
}

/// The storage behind a working memory, which is called before a commit is acknowledged.
pub trait Backing: Send + Sync {
    /// The newest version ever assigned to an entity that is not in working memory; 0 if there is none.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it cannot be read.
    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError>;

    /// Stores the snapshots of a commit, all or none, before the commit is acknowledged or visible. May block for a
    /// write to disk.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when they cannot be stored; the commit is then refused.
    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError>;

    /// Its content, if that can be queried.
    fn archive(&self) -> Option<&dyn Archive> {
        None
    }
}

/// Everything that a [`Backing`] was ever given.
pub trait Archive {
    /// Answers a query.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it cannot be read; [`MemoryError::Query`].
    fn recall(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError>;

    /// Passes the versions that a query selects from the one entity of its pattern to `act`, in order or `backwards`,
    /// until `act` returns that this is enough. Ignores the query's bounds. The query must not be about a single
    /// time.
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
    limits: MemoryLimits,
    schemas: BTreeMap<String, SegmentSchema>,
    backing: Option<Arc<dyn Backing>>,
    /// Most snapshots in one query to the backing.
    part: usize,
    changes: broadcast::Sender<Arc<Snapshot>>,
    /// Commits that wait for the committing thread.
    waiting: Mutex<Vec<Request>>,
    /// Locked by the committing thread, also during the backing's write; the last arrival time, ns.
    commit_lock: Mutex<u64>,
    content: RwLock<Content>,
}

impl WorkingMemory {
    /// An empty memory with the standard core segments and [`MemoryLimits::default`].
    pub fn new(clock: Clock) -> Self {
        let limits = MemoryLimits::default();
        Self {
            clock,
            limits,
            schemas: core_segments(),
            backing: None,
            part: merged_view::MAX_PART,
            changes: broadcast::channel(limits.backlog).0,
            waiting: Mutex::default(),
            commit_lock: Mutex::new(0),
            content: RwLock::default(),
        }
    }

    /// The same memory with other limits. To be called before anyone subscribes.
    #[must_use]
    pub fn with_limits(mut self, limits: MemoryLimits) -> Self {
        self.limits = MemoryLimits { history: limits.history.max(1), shares: limits.shares.max(1), ..limits };
        self.changes = broadcast::channel(limits.backlog.clamp(1, 1 << 24)).0;
        self
    }

    /// The same memory with storage behind it.
    #[must_use]
    pub fn with_backing(mut self, backing: Arc<dyn Backing>) -> Self {
        self.backing = Some(backing);
        self
    }

    /// The same memory, which queries its backing in smaller parts.
    #[cfg(test)]
    pub(crate) fn in_parts_of(mut self, part: usize) -> Self {
        self.part = part;
        self
    }

    /// The typed core segments by name.
    pub fn schemas(&self) -> &BTreeMap<String, SegmentSchema> {
        &self.schemas
    }

    /// The memory's time, ns.
    pub fn now_ns(&self) -> u64 {
        (self.clock)()
    }

    /// Whether a backing stores its commits, so that they may take as long as a disk.
    pub fn has_backing(&self) -> bool {
        self.backing.is_some()
    }

    /// How many entities it holds, removed ones included.
    pub fn len(&self) -> usize {
        self.read().len()
    }

    /// The size of its snapshots, bytes, about.
    pub fn bytes(&self) -> u64 {
        self.read().bytes()
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// [`Memory::commit`] without async: blocks only as long as the backing does.
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
        self.write_one(updates, sent_ns, false)
    }

    /// Several commits at once: each is accepted or refused individually, and the accepted ones are made durable
    /// together.
    pub fn commit_group(&self, commits: Vec<(Vec<Commit>, u64)>) -> Vec<Result<Vec<u64>, MemoryError>> {
        let request = |(updates, sent_ns)| (updates, sent_ns, false);
        self.write(commits.into_iter().map(request).collect())
    }

    /// Makes a provider segment read-only: prior knowledge.
    pub fn protect(&self, segment: &str, provider: &str) {
        let mut content = self.content.write();
        content.read_only.insert((segment.into(), provider.into()));
    }

    /// Whether an entity is in a read-only provider segment.
    pub fn is_read_only(&self, id: &EntityId) -> bool {
        self.read().is_read_only(id)
    }

    /// Commits, also into read-only provider segments.
    pub(crate) fn commit_prior(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        let now = self.now_ns();
        self.write_one(updates, now, true)
    }

    /// Checks that a snapshot with its version, which comes from elsewhere, is valid in this memory.
    ///
    /// # Errors
    /// [`MemoryError::Store`] for an invalid version; [`MemoryError::Schema`] and [`MemoryError::Confidence`].
    pub fn check_kept(&self, snapshot: &Snapshot) -> Result<(), MemoryError> {
        snapshot.check_version()?;
        self.check(&snapshot.id, &snapshot.instances)
    }

    /// Inserts snapshots from a store, with their versions and times. Entities that this memory has in the same or a
    /// newer version stay; invalid snapshots are left out, and remain in the store only. Returns how many were
    /// inserted, and why the first one was left out. The backing is not called, because it is the source.
    pub fn restore(&self, snapshots: Vec<Arc<Snapshot>>) -> (usize, Option<MemoryError>) {
        let _one_writer = self.commit_lock.lock();
        let content = self.read();
        let (mut room, mut restored) = (GroupVersions::default(), BTreeSet::new());
        let (mut fitting, mut refused) = (Vec::with_capacity(snapshots.len()), None);
        for snapshot in snapshots {
            let newest = content.newest(&snapshot.id).map_or(0, |s| s.version);
            if snapshot.version <= newest {
                continue;
            }
            let is_new = newest == 0 && !restored.contains(&snapshot.id);
            let put = (&snapshot.id, snapshot.instances.as_slice());
            let fits = self.check_kept(&snapshot);
            match fits.and_then(|()| self.check_room(&content, &room, put, is_new, None)) {
                Ok(bytes) => {
                    room.take(None, Usage { entities: usize::from(is_new), bytes });
                    restored.insert(snapshot.id.clone());
                    fitting.push(snapshot);
                }
                Err(error) => refused = refused.or(Some(error)),
            }
        }
        drop(content);
        let count = fitting.len();
        self.put_in(fitting);
        (count, refused)
    }

    /// [`Memory::latest`] without async.
    ///
    /// # Errors
    /// [`MemoryError::NotFound`] when there is none.
    pub fn latest_now(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        let found = self.read().newest(id).filter(|s| !s.is_removed()).cloned();
        found.ok_or_else(|| MemoryError::NotFound { id: id.to_string() })
    }

    /// [`Memory::query`] without async.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub fn query_now(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let asked = query.check()?;
        let kept = self.backing.as_ref().filter(|_| query.long_term).and_then(|backing| backing.archive());
        match kept {
            Some(kept) => MergedView { memory: self, kept }.ask(&asked),
            None => Ok(self.read().select(&asked)),
        }
    }

    fn read(&self) -> parking_lot::RwLockReadGuard<'_, Content> {
        self.content.read()
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
