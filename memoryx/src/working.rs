//! Working memory: what an agent knows now, in this process, with a bounded history of each entity.
//!
//! - The clock is passed in ([`Clock`]); arrival times come from it and from nowhere else.
//! - Typed core segments are checked, others are free ([`SegmentSchema`]).
//! - A [`Backing`] makes commits durable before they are acknowledged, and keeps the version numbers of entities
//!   that this memory has not seen yet.
//! - Writers wait for each other; a reader waits only while the new snapshots are put in, never for the backing.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use async_trait::async_trait;
use tokio::sync::broadcast;

use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::Memory;
use crate::query::{Query, Times};
use crate::schema::{SegmentSchema, core_segments, too_deep};

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
}

impl Default for Limits {
    fn default() -> Self {
        Self { history: 32, entities: 1_000_000, backlog: 4096 }
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
}

/// The memory of one agent, in this process.
pub struct WorkingMemory {
    clock: Clock,
    limits: Limits,
    schemas: BTreeMap<String, SegmentSchema>,
    backing: Option<Arc<dyn Backing>>,
    changes: broadcast::Sender<Arc<Snapshot>>,
    /// Held by the one who commits, over the backing's answer.
    committing: Mutex<()>,
    state: RwLock<State>,
}

#[derive(Default)]
struct State {
    segments: BTreeMap<String, BTreeMap<EntityId, VecDeque<Arc<Snapshot>>>>,
    entities: usize,
    read_only: BTreeSet<(String, String)>,
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
            changes: broadcast::channel(limits.backlog).0,
            committing: Mutex::new(()),
            state: RwLock::default(),
        }
    }

    /// The same memory with other limits. To be called before anybody subscribes.
    #[must_use]
    pub fn with_limits(mut self, limits: Limits) -> Self {
        self.limits = Limits { history: limits.history.max(1), ..limits };
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

    /// How many entities it holds, the removed ones included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.read().entities
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

    /// Makes a provider segment read-only for everybody: prior knowledge.
    pub fn protect(&self, segment: &str, provider: &str) {
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        state.read_only.insert((segment.into(), provider.into()));
    }

    /// Commits into read-only provider segments too.
    pub(crate) fn commit_prior(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        let now = self.now_ns();
        self.write(updates, now, true)
    }

    /// Puts back what a store has kept, with its versions and times; what this memory knows as new or newer stays.
    /// Returns how many snapshots were put back. The backing is not asked: it is where they come from.
    ///
    /// # Errors
    /// As [`Memory::commit`]; nothing has changed then.
    pub fn restore(&self, snapshots: Vec<Arc<Snapshot>>) -> Result<usize, MemoryError> {
        let _one_writer = self.committing.lock().unwrap_or_else(PoisonError::into_inner);
        let state = self.read();
        let newest = |id: &EntityId| state.newest(id).map_or(0, |s| s.version);
        let wanted: Vec<_> = snapshots.into_iter().filter(|s| s.version > newest(&s.id)).collect();
        for snapshot in &wanted {
            self.check(&snapshot.id, &snapshot.instances)?;
        }
        self.check_room(&state, wanted.iter().map(|s| &s.id))?;
        drop(state);
        let count = wanted.len();
        self.put_in(wanted);
        Ok(count)
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
    #[must_use]
    pub fn query_now(&self, query: &Query) -> Vec<Arc<Snapshot>> {
        let state = self.read();
        let one = |id: &EntityId, history: &VecDeque<Arc<Snapshot>>| {
            if query.pattern.matches(id) { query.select(history.iter().cloned()) } else { Vec::new() }
        };
        let in_segment = |segment: &BTreeMap<EntityId, VecDeque<Arc<Snapshot>>>| {
            segment.iter().flat_map(|(id, history)| one(id, history)).collect::<Vec<_>>()
        };
        let pattern = &query.pattern;
        if let (Some(s), Some(p), Some(e)) = (&pattern.segment, &pattern.provider, &pattern.entity) {
            let Ok(id) = EntityId::new(s, p, e) else { return Vec::new() };
            return state.history(&id).map(|history| one(&id, history)).unwrap_or_default();
        }
        match &pattern.segment {
            Some(name) => state.segments.get(name).map(in_segment).unwrap_or_default(),
            None => state.segments.values().flat_map(in_segment).collect(),
        }
    }

    fn read(&self) -> std::sync::RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, updates: Vec<Commit>, sent_ns: u64, prior: bool) -> Result<Vec<u64>, MemoryError> {
        let _one_writer = self.committing.lock().unwrap_or_else(PoisonError::into_inner);
        let snapshots = self.number(updates, sent_ns, prior)?;
        if let Some(backing) = &self.backing {
            backing.take(&snapshots)?;
        }
        let versions = snapshots.iter().map(|s| s.version).collect();
        self.put_in(snapshots);
        Ok(versions)
    }

    /// Checks updates and makes numbered snapshots of them, which nobody sees yet.
    fn number(
        &self,
        updates: Vec<Commit>,
        sent_ns: u64,
        prior: bool,
    ) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let arrived_ns = self.now_ns();
        let state = self.read();
        for update in &updates {
            if !prior && state.is_read_only(&update.id) {
                return Err(MemoryError::ReadOnly { id: update.id.to_string() });
            }
            self.check(&update.id, &update.instances)?;
        }
        self.check_room(&state, updates.iter().map(|u| &u.id))?;
        let mut numbered: BTreeMap<EntityId, u64> = BTreeMap::new();
        let mut gone: BTreeSet<EntityId> = BTreeSet::new();
        let mut snapshots = Vec::with_capacity(updates.len());
        for update in updates {
            let (version, is_gone) = match (numbered.get(&update.id), state.newest(&update.id)) {
                (Some(version), _) => (*version, gone.contains(&update.id)),
                (None, Some(newest)) => (newest.version, newest.is_removed()),
                (None, None) => (self.backing_version(&update.id)?, true),
            };
            expect(&update, if is_gone { 0 } else { version })?;
            if snapshots.capacity() > 1 {
                numbered.insert(update.id.clone(), version + 1);
                if update.instances.is_empty() {
                    gone.insert(update.id.clone());
                } else {
                    gone.remove(&update.id);
                }
            }
            snapshots.push(Arc::new(Snapshot {
                id: update.id,
                version: version + 1,
                referenced_ns: update.referenced_ns,
                sent_ns,
                arrived_ns,
                instances: update.instances,
            }));
        }
        Ok(snapshots)
    }

    fn backing_version(&self, id: &EntityId) -> Result<u64, MemoryError> {
        self.backing.as_ref().map_or(Ok(0), |backing| backing.last_version(id))
    }

    fn check(&self, id: &EntityId, instances: &[crate::entity::Instance]) -> Result<(), MemoryError> {
        let schema = self.schemas.get(id.segment());
        for instance in instances {
            if !(0.0..=1.0).contains(&instance.confidence) {
                return Err(MemoryError::Confidence { id: id.to_string() });
            }
            if let Some((name, _)) = instance.attributes.iter().find(|(_, value)| too_deep(value)) {
                let what = "is nested too deep".into();
                return Err(MemoryError::Schema { id: id.to_string(), attribute: name.clone(), what });
            }
            if let Some(schema) = schema {
                schema.check(id, instance)?;
            }
        }
        Ok(())
    }

    fn check_room<'a>(
        &self,
        state: &State,
        ids: impl Iterator<Item = &'a EntityId>,
    ) -> Result<(), MemoryError> {
        let mut new = BTreeSet::new();
        for id in ids {
            if state.newest(id).is_none()
                && new.insert(id)
                && state.entities + new.len() > self.limits.entities
            {
                return Err(MemoryError::Full { id: id.to_string(), entities: self.limits.entities as u64 });
            }
        }
        Ok(())
    }

    /// Makes snapshots visible, and tells the subscribers in the same order.
    fn put_in(&self, snapshots: Vec<Arc<Snapshot>>) {
        let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
        for snapshot in snapshots {
            state.put_in(&snapshot, self.limits.history);
            // Nobody listening is no error.
            let _ = self.changes.send(snapshot);
        }
    }
}

fn expect(update: &Commit, actual: u64) -> Result<(), MemoryError> {
    match update.expected_version {
        Some(expected) if expected != actual => {
            Err(MemoryError::Conflict { id: update.id.to_string(), expected, actual })
        }
        _ => Ok(()),
    }
}

impl State {
    fn history(&self, id: &EntityId) -> Option<&VecDeque<Arc<Snapshot>>> {
        self.segments.get(id.segment())?.get(id)
    }

    fn newest(&self, id: &EntityId) -> Option<&Arc<Snapshot>> {
        self.history(id)?.back()
    }

    fn is_read_only(&self, id: &EntityId) -> bool {
        !self.read_only.is_empty()
            && self.read_only.iter().any(|(s, p)| s == id.segment() && p == id.provider())
    }

    fn put_in(&mut self, snapshot: &Arc<Snapshot>, keep: usize) {
        if !self.segments.contains_key(snapshot.id.segment()) {
            self.segments.insert(snapshot.id.segment().into(), BTreeMap::new());
        }
        let segment =
            self.segments.get_mut(snapshot.id.segment()).expect("it was put there if it was missing");
        let history = segment.entry(snapshot.id.clone()).or_insert_with(|| {
            self.entities += 1;
            VecDeque::new()
        });
        while history.len() >= keep {
            history.pop_front();
        }
        history.push_back(Arc::clone(snapshot));
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
        let pattern = crate::query::Pattern::segment(segment);
        Ok(self.query_now(&Query { pattern, times: Times::Latest, limit: None }))
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        Ok(self.query_now(query))
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
