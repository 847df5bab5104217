//! The content of a working memory at one moment. It is immutable once published: the next commit changes a copy, which
//! shares everything but what has changed. So a reader keeps the moment that it has, and nobody waits for anybody.

use std::hash::{BuildHasherDefault, DefaultHasher};
use std::mem::size_of;
use std::ops::Bound::{Included, Unbounded};
use std::sync::Arc;

use armarium_values::Value;
use imbl::shared_ptr::DefaultSharedPtr;
use imbl::{GenericHashMap, OrdMap, OrdSet};

use super::blocks::Blocks;
use super::history::History;
use super::index::Index;
use crate::checked_query::{CheckedQuery, Selection};
use crate::entity::{EntityId, Instance, Snapshot};

/// Overhead of one allocation, bytes, about.
const ALLOCATION_BYTES: usize = 16;
/// How many of a core segment's recent changes are remembered: so many of each entity, and so many more.
const ARRIVALS_PER_ENTITY: usize = 4;
const MORE_ARRIVALS: usize = 4096;

/// Removed entities are forgotten when at least this many exist, so many per snapshot that is inserted; only those that
/// were removed at least this long ago, ns, so that followers have seen the removal.
const MIN_REMOVED: usize = 4096;
const FORGOTTEN_PER_SNAPSHOT: usize = 4;
const FORGET_AFTER_NS: u64 = 60_000_000_000;

/// Everything that a working memory holds. A copy costs a few counters.
#[derive(Clone, Default)]
pub(super) struct Content {
    segments: OrdMap<Arc<str>, Arc<SegmentContent>>,
    /// What is read-only: core segment and provider segment.
    read_only: OrdSet<(Arc<str>, Arc<str>)>,
    /// What the whole memory takes.
    pub(super) all: Usage,
    /// What each owner takes.
    usage: Usages,
    /// When the last of its snapshots arrived, ns.
    pub(super) last_arrival: u64,
    /// The removed entities by arrival time, ns.
    removed: OrdSet<(u64, EntityId)>,
    /// The entities that are to be removed, by when, ns.
    expiring: OrdSet<(u64, EntityId)>,
    /// Whether entities may be in the backing only, because they are still being read from it.
    pub(super) is_partial: bool,
}

#[derive(Clone, Default)]
struct SegmentContent {
    /// For looking up one by its address, which reads far fewer places of the memory than a search in an order does.
    entities: Entities,
    /// All of them in order of address.
    order: OrdSet<EntityId>,
    index: Index,
    /// The newest changes in order: arrival time, ns, and entity. So a reader that missed a few changes finds exactly
    /// those.
    arrivals: Blocks<(u64, EntityId)>,
    /// The arrival time of the newest change that was dropped from `arrivals`, ns.
    forgotten_until: u64,
    /// What each owner takes of it.
    usage: Usages,
}

/// The histories of entities, found by address (a set, which imbl does not let read its items). Hashed without a random key; nobody uses
/// the order of this map.
type Entities = GenericHashMap<History, (), BuildHasherDefault<DefaultHasher>, DefaultSharedPtr>;

/// A part of a memory's capacity, and how many snapshots were committed to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Usage {
    pub(super) entities: usize,
    pub(super) bytes: u64,
    pub(super) updates: u64,
}

impl Usage {
    fn changed(self, more: Self, less: Self) -> Self {
        Self {
            entities: (self.entities + more.entities).saturating_sub(less.entities),
            bytes: (self.bytes + more.bytes).saturating_sub(less.bytes),
            updates: (self.updates + more.updates).saturating_sub(less.updates),
        }
    }
}

/// What each owner takes.
#[derive(Clone, Default)]
struct Usages(OrdMap<Arc<str>, Usage>);

impl Usages {
    fn of(&self, owner: &str) -> Usage {
        self.0.get(owner).copied().unwrap_or_default()
    }

    fn count(&mut self, owner: &str, more: Usage, less: Usage) {
        let usage = self.of(owner).changed(more, less);
        if usage.entities == 0 {
            self.0.remove(owner);
        } else if let Some(known) = self.0.get_mut(owner) {
            *known = usage;
        } else {
            self.0.insert(owner.into(), usage);
        }
    }
}

/// The owner of an entity's provider segment: the segment's name up to the first dot.
pub(super) fn owner(id: &EntityId) -> &str {
    id.provider().split('.').next().unwrap_or_default()
}

impl SegmentContent {
    fn history(&self, id: &EntityId) -> Option<&History> {
        self.entities.get_key_value(id).map(|(history, ())| history)
    }

    /// Appends a change, and drops the oldest when there are too many.
    fn note_arrival(&mut self, snapshot: &Snapshot) {
        // A snapshot from a store may have arrived long ago; taking the last arrival time keeps the order.
        let last = self.arrivals.last().map_or(0, |(arrived_ns, _)| *arrived_ns);
        self.arrivals.push((snapshot.arrived_ns.max(last), snapshot.id.clone()));
        if self.arrivals.len() > ARRIVALS_PER_ENTITY * self.order.len() + MORE_ARRIVALS
            && let Some((arrived_ns, _)) = self.arrivals.take_first()
        {
            self.forgotten_until = arrived_ns;
        }
    }

    /// The entities that changed since the query's `arrived_since`, in order of address; `None` when the query has
    /// none, or the changes since then are no longer remembered.
    fn arrived(&self, asked: &CheckedQuery<'_>) -> Option<OrdSet<EntityId>> {
        let since = asked.query.arrived_since.filter(|since| *since > self.forgotten_until)?;
        let newest_first = self.arrivals.iter().rev();
        Some(newest_first.take_while(|(arrived, _)| *arrived >= since).map(|(_, id)| id.clone()).collect())
    }
}

impl Content {
    /// What an owner's provider segments take.
    pub(super) fn usage(&self, owner: &str) -> Usage {
        self.usage.of(owner)
    }

    /// Each owner and core segment, and what the owner takes of it.
    pub(super) fn owners(&self) -> impl Iterator<Item = (&str, &str, Usage)> {
        self.segments.iter().flat_map(|(name, segment)| {
            segment.usage.0.iter().map(|(owner, usage)| (&**owner, &**name, *usage))
        })
    }

    /// The entities that are to be removed by now, with their versions; some of them if there are very many.
    pub(super) fn expired(&self, now_ns: u64, most: usize) -> Vec<(EntityId, u64)> {
        let due = self.expiring.iter().take_while(|(at, _)| *at <= now_ns).take(most);
        due.filter_map(|(_, id)| Some((id.clone(), self.newest(id)?.version))).collect()
    }

    fn history(&self, id: &EntityId) -> Option<&History> {
        self.segments.get(id.segment())?.history(id)
    }

    /// How many bytes the next snapshot of an entity drops from its history, if `keep` snapshots are held.
    pub(super) fn freed(&self, id: &EntityId, keep: usize) -> u64 {
        let history = self.history(id).filter(|history| history.len() >= keep);
        history.map_or(0, |history| history.oldest().bytes())
    }

    pub(super) fn newest(&self, id: &EntityId) -> Option<&Arc<Snapshot>> {
        self.history(id).map(History::newest)
    }

    pub(super) fn protect(&mut self, segment: &str, provider: &str) {
        self.read_only.insert((segment.into(), provider.into()));
    }

    pub(super) fn is_read_only(&self, id: &EntityId) -> bool {
        self.read_only.iter().any(|(s, p)| **s == *id.segment() && **p == *id.provider())
    }

    /// Adds a query's selection to `answer`, in order of address, then version.
    pub(super) fn select(&self, asked: &CheckedQuery<'_>, answer: &mut Selection<'_>) {
        if let Some(id) = asked.query.pattern.exact() {
            if let Some(history) = self.history(&id) {
                answer.consider(&id, || history.iter().cloned());
            }
            return;
        }
        let one = asked.query.pattern.exact_segment();
        let first = asked.query.after.as_ref().map(|after| &after.id);
        let from = one.or(first.map(EntityId::segment)).map_or(Unbounded, Included);
        for (_, segment) in self.segments.range::<_, str>((from, one.map_or(Unbounded, Included))) {
            let mut consider = |id: &EntityId| {
                answer.consider(id, || segment.history(id).into_iter().flat_map(|h| h.iter().cloned()))
            };
            let newest = |id: &EntityId| segment.history(id).map(History::newest);
            let few = segment.arrived(asked).or_else(|| segment.index.candidates(asked, newest));
            let from = (first.map_or(Unbounded, Included), Unbounded);
            let goes_on = match few {
                Some(ids) => ids.iter().all(&mut consider),
                None => segment.order.range::<_, EntityId>(from).all(&mut consider),
            };
            if !goes_on {
                return;
            }
        }
    }

    /// The versions of one entity that a query selects, ignoring the bounds of the whole answer.
    pub(super) fn versions(&self, asked: &CheckedQuery<'_>, id: &EntityId) -> Vec<u64> {
        let history = self.history(id).into_iter();
        let selected = history.flat_map(|history| asked.select(history.iter().cloned()));
        selected.map(|snapshot| snapshot.version).collect()
    }

    /// Puts in a snapshot that was committed.
    pub(super) fn put_in(&mut self, snapshot: &Arc<Snapshot>, keep: usize) {
        self.put(snapshot, keep, 1);
    }

    /// Puts in a snapshot that was committed earlier.
    pub(super) fn restore(&mut self, snapshot: &Arc<Snapshot>, keep: usize) {
        self.put(snapshot, keep, 0);
    }

    fn put(&mut self, snapshot: &Arc<Snapshot>, keep: usize, updates: u64) {
        let id = &snapshot.id;
        if !self.segments.contains_key(id.segment()) {
            self.segments.insert(id.segment().into(), Arc::default());
        }
        let Some(segment) = self.segments.get_mut(id.segment()).map(Arc::make_mut) else { return };
        let held = segment.history(id).cloned();
        let (next, freed) = match &held {
            Some(held) => held.followed_by(snapshot, keep),
            None => (History::of(snapshot), 0),
        };
        let before = held.as_ref().map(History::newest);
        segment.index.change(id, before.map(|before| &**before), Some(snapshot));
        if before.is_none() {
            segment.order.insert(id.clone());
        }
        segment.entities.insert(next, ());
        segment.note_arrival(snapshot);
        if let Some(before) = before.filter(|before| before.is_removed()) {
            self.removed.remove(&(before.arrived_ns, id.clone()));
        }
        if let Some(expires_ns) = before.and_then(|before| before.expires_ns()) {
            self.expiring.remove(&(expires_ns, id.clone()));
        }
        if let Some(expires_ns) = snapshot.expires_ns() {
            self.expiring.insert((expires_ns, id.clone()));
        }
        if snapshot.is_removed() {
            self.removed.insert((snapshot.arrived_ns, id.clone()));
        }
        self.last_arrival = self.last_arrival.max(snapshot.arrived_ns);
        let more = Usage { entities: usize::from(before.is_none()), bytes: snapshot.bytes(), updates };
        self.count(id, more, Usage { bytes: freed, ..Usage::default() });
        for _ in 0..FORGOTTEN_PER_SNAPSHOT {
            self.forget_removed(snapshot.arrived_ns);
        }
    }

    fn count(&mut self, id: &EntityId, more: Usage, less: Usage) {
        self.all = self.all.changed(more, less);
        self.usage.count(owner(id), more, less);
        if let Some(segment) = self.segments.get_mut(id.segment()).map(Arc::make_mut) {
            segment.usage.count(owner(id), more, less);
        }
    }

    /// Forgets the entity that was removed first, when there are many. Its name is free again; its version count
    /// continues if the backing has it, and restarts otherwise.
    fn forget_removed(&mut self, now_ns: u64) {
        if self.removed.len() < MIN_REMOVED.max(self.all.entities / 8) {
            return;
        }
        let is_over =
            |(arrived_ns, _): &&(u64, EntityId)| arrived_ns.saturating_add(FORGET_AFTER_NS) < now_ns;
        let Some(oldest) = self.removed.get_min().filter(is_over).cloned() else { return };
        self.removed.remove(&oldest);
        let (_, id) = oldest;
        let Some(segment) = self.segments.get_mut(id.segment()).map(Arc::make_mut) else { return };
        segment.order.remove(&id);
        let history = segment.entities.remove_with_key(&id).map(|(history, ())| history);
        segment.index.change(&id, history.as_ref().map(|history| &**history.newest()), None);
        if segment.order.is_empty() {
            self.segments.remove(id.segment());
        }
        let bytes = history.iter().flat_map(History::iter).map(|snapshot| snapshot.bytes()).sum();
        self.count(&id, Usage::default(), Usage { entities: 1, bytes, updates: 0 });
    }
}

impl Snapshot {
    /// Its size in memory, bytes, about.
    pub(crate) fn bytes(&self) -> u64 {
        bytes_of(&self.id, &self.instances)
    }
}

/// The size of a snapshot in memory, bytes, about.
pub(super) fn bytes_of(id: &EntityId, instances: &[Instance]) -> u64 {
    let of_attribute = |(name, value): (&str, &Value)| {
        size_of::<(Box<str>, Value)>() + name.len() + ALLOCATION_BYTES + outside(value)
    };
    let of_instance = |instance: &Instance| {
        let covariance =
            |(name, rows): (&String, &Vec<f64>)| 64 + name.len() + rows.len() * 8 + 2 * ALLOCATION_BYTES;
        size_of::<Instance>()
            + ALLOCATION_BYTES
            + instance.attributes.iter().map(of_attribute).sum::<usize>()
            + instance.covariance.iter().map(covariance).sum::<usize>()
    };
    let bytes = size_of::<Snapshot>() + id.as_str().len() + 2 * ALLOCATION_BYTES;
    (bytes + instances.iter().map(of_instance).sum::<usize>()) as u64
}

/// The heap size of a value, bytes, about.
fn outside(value: &Value) -> usize {
    match value {
        Value::Null | Value::Bool(_) | Value::Int(_) | Value::Float(_) | Value::Duration(_) => 0,
        Value::String(text) => text.len() + ALLOCATION_BYTES,
        Value::Bytes(bytes) => bytes.len() + ALLOCATION_BYTES,
        Value::List(items) => {
            ALLOCATION_BYTES + items.iter().map(|v| size_of::<Value>() + outside(v)).sum::<usize>()
        }
        Value::Map(fields) => {
            let field = |(name, v): (&String, &Value)| {
                size_of::<(String, Value)>() + name.len() + ALLOCATION_BYTES + outside(v)
            };
            ALLOCATION_BYTES + fields.iter().map(field).sum::<usize>()
        }
        Value::Vector(v) => v.frame.0.len() + ALLOCATION_BYTES,
        Value::Pose(p) => p.frame.0.len() + ALLOCATION_BYTES,
        Value::Wrench(w) => w.frame.0.len() + ALLOCATION_BYTES,
        Value::Reference(r) => r.kind.len() + r.id.len() + 2 * ALLOCATION_BYTES,
    }
}
