//! The content of a working memory: histories, found by address in constant time, and iterated in the order of
//! addresses.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::mem::size_of;
use std::ops::Add;
use std::sync::Arc;

use armarium_values::Value;
use indexmap::IndexMap;

use crate::checked_query::{CheckedQuery, Selection};
use crate::entity::{EntityId, Instance, Snapshot};

/// Overhead of one allocation, bytes, about.
const ALLOCATION_BYTES: usize = 16;
/// Number of recent changes whose arrival time and entity are remembered.
const MAX_ARRIVALS: usize = 1 << 17;

/// Removed entities are forgotten when at least this many exist; only those that were removed at least this long ago,
/// ns, so that followers have seen the removal.
const MIN_REMOVED: usize = 4096;
const FORGET_AFTER_NS: u64 = 60_000_000_000;

#[derive(Default)]
pub(super) struct Content {
    /// By address. Positions are stable until [`Content::forget_removed`].
    histories: IndexMap<EntityId, History>,
    /// The positions of each core segment's addresses.
    segments: BTreeMap<String, BTreeMap<EntityId, usize>>,
    pub(super) read_only: BTreeSet<(String, String)>,
    bytes: u64,
    /// What each owner takes.
    usage: BTreeMap<String, Usage>,
    /// The newest changes in order: arrival time, ns, and position of the entity. So a reader that missed a few
    /// changes finds exactly those.
    arrivals: VecDeque<(u64, usize)>,
    /// The arrival time of the newest change that was dropped from `arrivals`, ns.
    forgotten_until: u64,
    /// The number of removed entities, and the number of them at which the next [`Content::forget_removed`] runs.
    gone: usize,
    crowded: usize,
}

/// A part of a memory's capacity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Usage {
    pub(super) entities: usize,
    pub(super) bytes: u64,
}

impl Add for Usage {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { entities: self.entities + other.entities, bytes: self.bytes + other.bytes }
    }
}

/// The owner of an entity's provider segment: the segment's name up to the first dot.
pub(super) fn owner(id: &EntityId) -> &str {
    id.provider().split('.').next().unwrap_or_default()
}

/// The snapshots of one entity. Most queries need the newest only.
struct History {
    newest: Arc<Snapshot>,
    older: VecDeque<Arc<Snapshot>>,
}

impl History {
    fn iter(&self) -> impl DoubleEndedIterator<Item = Arc<Snapshot>> {
        self.older.iter().chain(std::iter::once(&self.newest)).cloned()
    }
}

impl Content {
    pub(super) fn len(&self) -> usize {
        self.histories.len()
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// What an owner's provider segments take.
    pub(super) fn usage(&self, owner: &str) -> Usage {
        self.usage.get(owner).copied().unwrap_or_default()
    }

    /// How many bytes the next snapshot of an entity drops from its history, if `keep` snapshots are held.
    pub(super) fn freed(&self, id: &EntityId, keep: usize) -> u64 {
        let Some(history) = self.histories.get(id) else { return 0 };
        let is_full = history.older.len() + 1 >= keep;
        let oldest = history.older.front().unwrap_or(&history.newest);
        if is_full { oldest.bytes() } else { 0 }
    }

    pub(super) fn newest(&self, id: &EntityId) -> Option<&Arc<Snapshot>> {
        self.histories.get(id).map(|history| &history.newest)
    }

    pub(super) fn is_read_only(&self, id: &EntityId) -> bool {
        !self.read_only.is_empty()
            && self.read_only.iter().any(|(s, p)| s == id.segment() && p == id.provider())
    }

    /// A query's answer, in order of address, then version.
    pub(super) fn select(&self, asked: &CheckedQuery<'_>) -> Vec<Arc<Snapshot>> {
        let mut answer = asked.answer();
        if let Some(id) = asked.query().pattern.exact() {
            if let Some(history) = self.histories.get(&id).filter(|_| asked.wants(&id)) {
                answer.extend(asked.select(history.iter()));
            }
        } else if let Some(places) = self.arrived(asked) {
            for (id, place) in places {
                if !self.add(asked, id, place, &mut answer) {
                    break;
                }
            }
        } else {
            self.add_all(asked, &mut answer);
        }
        answer.finish()
    }

    /// The versions of one entity that a query selects, ignoring the bounds of the whole answer.
    pub(super) fn versions(&self, asked: &CheckedQuery<'_>, id: &EntityId) -> Vec<u64> {
        let history = self.histories.get(id).into_iter();
        history.flat_map(|history| asked.select(history.iter())).map(|snapshot| snapshot.version).collect()
    }

    fn add_all(&self, asked: &CheckedQuery<'_>, answer: &mut Selection<'_>) {
        let one = asked.query().pattern.exact_segment();
        let segments = self.segments.iter().filter(|(name, _)| one.is_none_or(|one| one == name.as_str()));
        for (_, entities) in segments {
            let first = asked.query().after.as_ref().map(|after| &after.id);
            let range = first.map_or_else(|| entities.range::<EntityId, _>(..), |id| entities.range(id..));
            for (id, place) in range {
                if !self.add(asked, id, *place, answer) {
                    return;
                }
            }
        }
    }

    /// Adds a query's selection from one entity to `answer`. Returns false when the answer was full already.
    fn add(&self, asked: &CheckedQuery<'_>, id: &EntityId, place: usize, answer: &mut Selection<'_>) -> bool {
        if answer.is_full() {
            return false;
        }
        if let Some((_, history)) = self.histories.get_index(place).filter(|_| asked.wants(id)) {
            answer.extend(asked.select(history.iter()));
        }
        true
    }

    /// The entities that changed since the query's `arrived_since`, in order of address; `None` when the query has
    /// none, or the changes since then are no longer remembered.
    fn arrived(&self, asked: &CheckedQuery<'_>) -> Option<BTreeMap<&EntityId, usize>> {
        let since = asked.query().arrived_since.filter(|since| *since > self.forgotten_until)?;
        let first = self.arrivals.partition_point(|(arrived_ns, _)| *arrived_ns < since);
        let entity = |(_, place): &(u64, usize)| Some((self.histories.get_index(*place)?.0, *place));
        Some(self.arrivals.range(first..).filter_map(entity).collect())
    }

    pub(super) fn put_in(&mut self, snapshot: &Arc<Snapshot>, keep: usize) {
        let (mut freed, mut entities) = (0, 0);
        let mut was_gone = false;
        let place = match self.histories.get_full_mut(&snapshot.id) {
            Some((place, _, history)) => {
                let before = std::mem::replace(&mut history.newest, Arc::clone(snapshot));
                was_gone = before.is_removed();
                history.older.push_back(before);
                while history.older.len() >= keep {
                    if let Some(old) = history.older.pop_front() {
                        freed += old.bytes();
                    }
                }
                place
            }
            None => {
                entities = 1;
                self.put_in_new(snapshot)
            }
        };
        self.gone = self.gone + usize::from(snapshot.is_removed()) - usize::from(was_gone);
        let bytes = snapshot.bytes();
        self.bytes = (self.bytes + bytes).saturating_sub(freed);
        let owner = owner(&snapshot.id);
        if !self.usage.contains_key(owner) {
            self.usage.insert(owner.into(), Usage::default());
        }
        if let Some(usage) = self.usage.get_mut(owner) {
            usage.entities += entities;
            usage.bytes = (usage.bytes + bytes).saturating_sub(freed);
        }
        if self.arrivals.len() == MAX_ARRIVALS {
            let forgotten = self.arrivals.pop_front();
            self.forgotten_until = forgotten.map_or(0, |(arrived_ns, _)| arrived_ns);
        }
        // A snapshot from a store may have arrived long ago; taking the last arrival time keeps the order.
        let last = self.arrivals.back().map_or(0, |(arrived_ns, _)| *arrived_ns);
        self.arrivals.push_back((snapshot.arrived_ns.max(last), place));
    }

    /// Forgets entities that were removed long ago, when there are many. Their names are free again; their version
    /// count continues if the backing has it, and restarts otherwise.
    pub(super) fn forget_removed(&mut self) {
        if self.gone < self.crowded.max(MIN_REMOVED).max(self.histories.len() / 8) {
            return;
        }
        let newest = self.arrivals.back().map_or(0, |(arrived_ns, _)| *arrived_ns);
        let is_over = |history: &History| {
            history.newest.is_removed() && history.newest.arrived_ns.saturating_add(FORGET_AFTER_NS) < newest
        };
        let mut places = Vec::with_capacity(self.histories.len());
        let mut stays = 0;
        for (id, history) in &self.histories {
            places.push((!is_over(history)).then_some(stays));
            if !is_over(history) {
                stays += 1;
                continue;
            }
            self.gone -= 1;
            let bytes: u64 = history.iter().map(|snapshot| snapshot.bytes()).sum();
            self.bytes = self.bytes.saturating_sub(bytes);
            if let Some(usage) = self.usage.get_mut(owner(id)) {
                usage.entities = usage.entities.saturating_sub(1);
                usage.bytes = usage.bytes.saturating_sub(bytes);
            }
        }
        self.histories.retain(|_, history| !is_over(history));
        let moved = |place: &mut usize| match places.get(*place) {
            Some(Some(to)) => {
                *place = *to;
                true
            }
            _ => false,
        };
        self.segments.values_mut().for_each(|entities| entities.retain(|_, place| moved(place)));
        self.arrivals.retain_mut(|(_, place)| moved(place));
        self.crowded = 2 * self.gone;
    }

    fn put_in_new(&mut self, snapshot: &Arc<Snapshot>) -> usize {
        let history = History { newest: Arc::clone(snapshot), older: VecDeque::new() };
        let (place, _) = self.histories.insert_full(snapshot.id.clone(), history);
        if !self.segments.contains_key(snapshot.id.segment()) {
            self.segments.insert(snapshot.id.segment().into(), BTreeMap::new());
        }
        if let Some(segment) = self.segments.get_mut(snapshot.id.segment()) {
            segment.insert(snapshot.id.clone(), place);
        }
        place
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
