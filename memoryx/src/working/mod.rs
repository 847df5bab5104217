//! Working memory: an agent's present knowledge, in this process, with a bounded history of each entity.
//!
//! - The clock is passed in ([`Clock`]); arrival times come only from it.
//! - Typed core segments are checked, others are not ([`SegmentSchema`]).
//! - A [`Backing`] makes commits durable before they are acknowledged, and knows the version numbers of entities that
//!   this memory does not hold.
//! - Its content is immutable; a commit replaces it by the next one, which shares what has not changed. So readers and
//!   writers never wait for each other.
//! - With a backing, one thread commits; requests that wait together are made durable by one write.
//! - Its content is bounded: entities, history, bytes, and how far in the future data may be.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, OnceLock, mpsc};

use armarium_bus::aside;
use async_trait::async_trait;
use parking_lot::{Mutex, RwLock};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::{broadcast, oneshot};

use crate::attributes::Attributes;
use crate::changes::{Changes, PublishedSnapshot};
use crate::checked_query::Answer;
use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::Memory;
use crate::query::{Pattern, Query};
use crate::schema::SegmentSchema;

mod blocks;
mod committing;
mod content;
mod history;
mod index;
mod merged_view;

use committing::{CommittingThread, Request, WriterState};
use content::Content;
use merged_view::MergedView;

/// Returns the time, ns since an epoch that the whole memory shares.
pub type Clock = Arc<dyn Fn() -> u64 + Send + Sync>;

/// A clock that counts from this call on tokio's clock, ns: virtual time where that clock is paused.
pub fn tokio_clock() -> Clock {
    let start = tokio::time::Instant::now();
    Arc::new(move || u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX))
}

/// Entities that are removed together because their time is up.
const MAX_EXPIRED: usize = 10_000;

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

/// The storage behind a working memory, which is called before a commit is acknowledged, by the thread that commits.
pub trait Backing: Send + Sync {
    /// The last version that an entity, which is not in working memory, may have been given; 0 if there is none.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it cannot be read.
    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError>;

    /// Stores the snapshots of a commit, all or none, before the commit is acknowledged or visible. May block for a
    /// write to disk.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when they cannot be stored, or it is unknown whether they are; the commit is then refused,
    /// and [`Self::holds_any`] is called before the next one.
    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError>;

    /// Whether any of the snapshots is stored that a failed [`Self::take`] was given: a failed write may be complete.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when it cannot be read.
    fn holds_any(&self, snapshots: &[Arc<Snapshot>]) -> Result<bool, MemoryError>;

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
    core: Arc<Core>,
    /// Most snapshots in one query to the backing.
    part: usize,
    /// Started by the first commit, if there is a backing.
    thread: OnceLock<Result<CommittingThread, MemoryError>>,
}

/// What readers and the committing thread share.
struct Core {
    clock: Clock,
    limits: MemoryLimits,
    schemas: BTreeMap<String, SegmentSchema>,
    backing: Option<Arc<dyn Backing>>,
    changes: broadcast::Sender<PublishedSnapshot>,
    /// Locked by whoever commits, also during the backing's write.
    writer: Mutex<WriterState>,
    /// The present content. The lock is held only while the pointer is copied or replaced.
    content: RwLock<Arc<Content>>,
}

/// The versions that a commit has made.
type CommitResult = Result<Vec<u64>, MemoryError>;

impl Core {
    fn now_ns(&self) -> u64 {
        (self.clock)()
    }

    fn content(&self) -> Arc<Content> {
        Arc::clone(&self.content.read())
    }
}

impl WorkingMemory {
    /// An empty memory with [`MemoryLimits::default`], whose core segments have any attributes.
    pub fn new(clock: Clock) -> Self {
        let limits = MemoryLimits::default();
        let core = Core {
            clock,
            limits,
            schemas: BTreeMap::new(),
            backing: None,
            changes: broadcast::channel(limits.backlog).0,
            writer: Mutex::default(),
            content: RwLock::default(),
        };
        Self { core: Arc::new(core), part: merged_view::MAX_PART, thread: OnceLock::new() }
    }

    fn building(&mut self) -> &mut Core {
        Arc::get_mut(&mut self.core).expect("nothing is committed while a memory is put together")
    }

    /// The same memory with other limits. To be called before anyone subscribes or commits.
    #[must_use]
    pub fn with_limits(mut self, limits: MemoryLimits) -> Self {
        let core = self.building();
        core.limits = MemoryLimits { history: limits.history.max(1), shares: limits.shares.max(1), ..limits };
        core.changes = broadcast::channel(limits.backlog.clamp(1, 1 << 24)).0;
        self
    }

    /// The same memory, which checks what is committed to these core segments, and to no others. To be called before anyone commits.
    #[must_use]
    pub fn with_segments(mut self, schemas: impl IntoIterator<Item = SegmentSchema>) -> Self {
        self.building().schemas =
            schemas.into_iter().map(|schema| (schema.segment.clone(), schema)).collect();
        self
    }

    /// The same memory with storage behind it. To be called before anyone commits.
    #[must_use]
    pub fn with_backing(mut self, backing: Arc<dyn Backing>) -> Self {
        self.building().backing = Some(backing);
        self
    }

    /// The same memory, which queries its backing in smaller parts.
    #[cfg(test)]
    pub(crate) fn in_parts_of(mut self, part: usize) -> Self {
        self.part = part;
        self
    }

    /// The memory's time, ns.
    pub fn now_ns(&self) -> u64 {
        self.core.now_ns()
    }

    /// Whether the time of an entity is up.
    pub fn has_expired(&self) -> bool {
        !self.core.content().expired(self.now_ns(), 1).is_empty()
    }

    /// Removes the entities whose time is up ([`Snapshot::expires_ns`]), and returns how many. Those that change meanwhile stay.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the backing fails.
    pub fn remove_expired(&self) -> Result<usize, MemoryError> {
        let (now_ns, mut removed) = (self.now_ns(), 0);
        let expired = self.core.content().expired(now_ns, MAX_EXPIRED);
        let (sender, answers) = mpsc::channel();
        for (id, version) in expired {
            // Requests that wait together are stored together.
            let updates = vec![Commit::removal(id, now_ns).expecting(version)];
            let sender = sender.clone();
            let answer = Box::new(move |result| drop(sender.send(result)));
            self.request(Request { updates, sent_ns: now_ns, prior: false }, answer);
        }
        drop(sender);
        for answer in answers {
            match answer {
                Ok(_) => removed += 1,
                Err(MemoryError::Conflict { .. } | MemoryError::ReadOnly { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(removed)
    }

    /// How many entities it holds, removed ones included.
    pub fn len(&self) -> usize {
        self.core.content().all.entities
    }

    /// The size of its snapshots, bytes, about.
    pub fn bytes(&self) -> u64 {
        self.core.content().all.bytes
    }

    /// What each owner of provider segments takes of each core segment: `OWNER/SEGMENT/entities`, `OWNER/SEGMENT/bytes`, and
    /// `OWNER/SEGMENT/updates`, which is how many snapshots were committed so far.
    pub fn usage(&self) -> BTreeMap<String, u64> {
        let of_owner = |(owner, segment, usage): (&str, &str, content::Usage)| {
            [("entities", usage.entities as u64), ("bytes", usage.bytes), ("updates", usage.updates)]
                .map(|(what, count)| (format!("{owner}/{segment}/{what}"), count))
        };
        self.core.content().owners().flat_map(of_owner).collect()
    }

    /// When its last change arrived, ns.
    pub(crate) fn last_arrival_ns(&self) -> u64 {
        self.core.content().last_arrival
    }

    /// Whether entities may still be in the backing only, because they are still being read from it.
    pub(crate) fn is_partial(&self) -> bool {
        self.core.content().is_partial
    }

    /// How many snapshots were committed so far.
    pub fn updates(&self) -> u64 {
        self.core.content().all.updates
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// [`Memory::commit`] without async: blocks the thread as long as the backing takes.
    ///
    /// # Errors
    /// As [`Memory::commit`].
    pub fn commit_now(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        self.commit_waiting(updates, false)
    }

    /// Takes updates that were sent at `sent_ns` into the order of commits at once. The future gives their versions when
    /// they are durable and visible; dropping it does not withdraw them.
    pub fn enqueue(
        &self,
        updates: Vec<Commit>,
        sent_ns: u64,
    ) -> impl Future<Output = Result<Vec<u64>, MemoryError>> + Send + use<> {
        let (sender, answered) = oneshot::channel();
        let answer = Box::new(|result| drop(sender.send(result)));
        self.request(Request { updates, sent_ns, prior: false }, answer);
        async { answered.await.unwrap_or_else(|_| Err(ended())) }
    }

    /// Makes a provider segment hold these entities and no others, read-only for everybody else: prior knowledge. What is
    /// there already and has not changed keeps its version.
    ///
    /// # Errors
    /// [`MemoryError::Name`] for an invalid name; as [`Self::commit_now`].
    pub fn provide(
        &self,
        segment: &str,
        provider: &str,
        wanted: BTreeMap<&str, Attributes>,
    ) -> Result<(), MemoryError> {
        let now_ns = self.now_ns();
        let held = self.query_now(&Query::latest(Pattern::segment(segment).of_provider(provider)))?;
        let gone = held.iter().filter(|s| !wanted.contains_key(s.id.entity()));
        let mut updates: Vec<Commit> = gone.map(|s| Commit::removal(s.id.clone(), now_ns)).collect();
        for (name, attributes) in wanted {
            let id = EntityId::new(segment, provider, name)?;
            let known = held.iter().find(|s| s.id == id).and_then(|s| s.instance());
            if known.is_none_or(|instance| instance.attributes != attributes) {
                updates.push(Commit::new(id, now_ns, attributes));
            }
        }
        self.commit_waiting(updates, true)?;
        let _alone = self.core.writer.lock();
        let mut next = Content::clone(&self.core.content());
        next.protect(segment, provider);
        self.core.publish(next, &[]);
        Ok(())
    }

    /// Whether an entity is in a read-only provider segment.
    pub fn is_read_only(&self, id: &EntityId) -> bool {
        self.core.content().is_read_only(id)
    }

    fn commit_waiting(&self, updates: Vec<Commit>, prior: bool) -> CommitResult {
        let request = Request { updates, sent_ns: self.now_ns(), prior };
        if self.core.backing.is_none() {
            return self.core.commit_together(vec![request]).pop().unwrap_or_else(|| Err(ended()));
        }
        let (sender, answered) = mpsc::sync_channel(1);
        self.request(request, Box::new(move |result| drop(sender.send(result))));
        answered.recv().unwrap_or_else(|_| Err(ended()))
    }

    fn request(&self, request: Request, answer: committing::Answer) {
        if self.core.backing.is_none() {
            return answer(self.core.commit_together(vec![request]).pop().unwrap_or_else(|| Err(ended())));
        }
        match self.thread.get_or_init(|| CommittingThread::start(Arc::clone(&self.core))) {
            Ok(thread) => thread.commit(request, answer),
            Err(error) => answer(Err(error.clone())),
        }
    }

    /// Checks that a snapshot with its version, which comes from elsewhere, is valid in this memory.
    ///
    /// # Errors
    /// [`MemoryError::Store`] for an invalid version; [`MemoryError::Schema`] and [`MemoryError::Confidence`].
    pub fn check_kept(&self, snapshot: &Snapshot) -> Result<(), MemoryError> {
        snapshot.check_version()?;
        self.core.check(&snapshot.id, &snapshot.instances)
    }

    /// Inserts snapshots from a store, with their versions and times. Entities that this memory has in the same or a
    /// newer version stay; invalid snapshots are left out, and remain in the store only. Returns how many were
    /// inserted, and why the first one was left out. The backing is not called, because it is the source; subscribers are not
    /// told, because these are no changes.
    pub fn restore(&self, snapshots: Vec<Arc<Snapshot>>) -> (usize, Option<MemoryError>) {
        let mut writer = self.core.writer.lock();
        let now_ns = self.now_ns();
        let mut next = Content::clone(&self.core.content());
        let (mut count, mut refused) = (0, None);
        for snapshot in snapshots {
            if snapshot.version <= next.newest(&snapshot.id).map_or(0, |s| s.version) {
                continue;
            }
            match self.core.fits(&snapshot, &next) {
                Ok(()) => {
                    next.restore(&snapshot, self.core.limits.history);
                    writer.note_arrival(snapshot.arrived_ns, now_ns);
                    count += 1;
                }
                Err(error) => refused = refused.or(Some(error)),
            }
        }
        self.core.publish(next, &[]);
        (count, refused)
    }

    /// Whether entities may still be in the backing only, where reading and committing look for them.
    pub(crate) fn set_partial(&self, is_partial: bool) {
        let _alone = self.core.writer.lock();
        let mut next = Content::clone(&self.core.content());
        next.is_partial = is_partial;
        self.core.publish(next, &[]);
    }

    /// Counts the next versions of these entities from later ones than it holds.
    pub(crate) fn count_from(&self, given: BTreeMap<EntityId, u64>) {
        self.core.writer.lock().given.extend(given);
    }

    /// [`Memory::latest`] without async.
    ///
    /// # Errors
    /// [`MemoryError::NotFound`] when there is none.
    pub fn latest_now(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        let content = self.core.content();
        let found = match content.newest(id) {
            None if content.is_partial => self.core.backed(&Query::latest(Pattern::entity(id)))?.pop(),
            found => found.filter(|s| !s.is_removed()).cloned(),
        };
        found.ok_or_else(|| MemoryError::NotFound { id: id.to_string() })
    }

    /// [`Memory::query`] without async.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub fn query_now(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        Ok(self.query_while(query, &|| true)?.snapshots)
    }

    /// [`Self::query_now`], but as soon as `goes_on` returns false, the answer ends, and says where. `goes_on` is called
    /// every few entities.
    ///
    /// # Errors
    /// As [`Memory::query`]; [`MemoryError::Query`] when a query for the nearest ends early.
    pub fn query_while(&self, query: &Query, goes_on: &dyn Fn() -> bool) -> Result<Answer, MemoryError> {
        let asked = query.check()?;
        if query.most == Some(0) {
            return Ok(Answer::default());
        }
        let kept = self.core.backing.as_ref().filter(|_| self.looks_in_backing(query));
        if let Some(kept) = kept.and_then(|backing| backing.archive()) {
            return MergedView { memory: &self.core, kept, part: self.part }.ask(&asked, goes_on);
        }
        let mut answer = asked.answer(goes_on);
        self.core.content().select(&asked, &mut answer);
        answer.finish()
    }

    /// Whether the answer to a query depends on the backing.
    fn looks_in_backing(&self, query: &Query) -> bool {
        query.long_term || self.is_partial()
    }

    /// [`Memory::subscribe`] without async.
    pub fn changes(&self, pattern: &Pattern) -> Changes {
        Changes::here(pattern.clone(), self.core.changes.subscribe())
    }
}

fn ended() -> MemoryError {
    MemoryError::Store { what: "the thread that commits has ended".into() }
}

/// Whether the present runtime has one thread. In virtual time it has, and a run is repeatable only when nothing else
/// happens while a commit is made; so who commits then waits on this thread.
fn has_one_thread() -> bool {
    Handle::try_current().is_ok_and(|handle| handle.runtime_flavor() == RuntimeFlavor::CurrentThread)
}

/// Whoever waits for the disk lets the other tasks of his thread go on elsewhere.
#[async_trait]
impl Memory for WorkingMemory {
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        if has_one_thread() { self.commit_now(updates) } else { self.enqueue(updates, self.now_ns()).await }
    }

    async fn latest(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError> {
        if self.is_partial() { aside(|| self.latest_now(id)) } else { self.latest_now(id) }
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        if self.looks_in_backing(query) { aside(|| self.query_now(query)) } else { self.query_now(query) }
    }

    async fn subscribe(&self, pattern: &Pattern) -> Result<Changes, MemoryError> {
        Ok(self.changes(pattern))
    }
}

impl fmt::Debug for WorkingMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WorkingMemory").field("limits", &self.core.limits).finish_non_exhaustive()
    }
}
