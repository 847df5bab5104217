//! What a working memory holds: histories found by address in constant time, and in the order of addresses.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::mem::size_of;
use std::ops::Add;
use std::sync::Arc;

use armarium_values::Value;
use indexmap::IndexMap;

use crate::checked_query::{CheckedQuery, Selection};
use crate::entity::{EntityId, Instance, Snapshot};

/// What one allocation takes beyond its content, bytes, about.
const ALLOCATION: usize = 16;
/// Changes of which it is remembered when they arrived and whose they were.
const ARRIVALS: usize = 1 << 17;

/// How many entities have to be gone at least before they are forgotten, and how long they have been then, ns: whoever
/// follows has heard of it.
const CROWD: usize = 4096;
const GONE_NS: u64 = 60_000_000_000;

#[derive(Default)]
pub(super) struct State {
    /// By address. Places stay until [`State::forget_gone`].
    histories: IndexMap<EntityId, History>,
    /// The places of the addresses of each core segment.
    segments: BTreeMap<String, BTreeMap<EntityId, usize>>,
    pub(super) read_only: BTreeSet<(String, String)>,
    bytes: u64,
    /// What is held, by owner.
    taken: BTreeMap<String, Taken>,
    /// The newest changes in their order: when they arrived, ns, and the places of their entities. So who has missed a
    /// few of them costs no more than those.
    arrivals: VecDeque<(u64, usize)>,
    /// When the newest change arrived that is in `arrivals` no more, ns.
    forgotten_until: u64,
    /// How many entities are gone, and with how many of them those that have long been are forgotten.
    gone: usize,
    crowded: usize,
}

/// A part of a memory's room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Taken {
    pub(super) entities: usize,
    pub(super) bytes: u64,
}

impl Add for Taken {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { entities: self.entities + other.entities, bytes: self.bytes + other.bytes }
    }
}

/// Whose a provider segment is: its name up to the first dot.
pub(super) fn owner(id: &EntityId) -> &str {
    id.provider().split('.').next().unwrap_or_default()
}

/// What is held of one entity. The newest snapshot is all that most questions look at.
struct History {
    newest: Arc<Snapshot>,
    older: VecDeque<Arc<Snapshot>>,
}

impl History {
    fn iter(&self) -> impl DoubleEndedIterator<Item = Arc<Snapshot>> {
        self.older.iter().chain(std::iter::once(&self.newest)).cloned()
    }
}

impl State {
    pub(super) fn len(&self) -> usize {
        self.histories.len()
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// What an owner's provider segments take.
    pub(super) fn taken(&self, owner: &str) -> Taken {
        self.taken.get(owner).copied().unwrap_or_default()
    }

    /// How many bytes the next snapshot of an entity pushes out, where `keep` are held.
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

    /// What a question takes of what is held, in order of address, then version.
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

    /// The versions that a question takes of one entity, whatever its bounds in all.
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

    /// Adds what a question takes of one entity, unless the answer is full: then it says so.
    fn add(&self, asked: &CheckedQuery<'_>, id: &EntityId, place: usize, answer: &mut Selection<'_>) -> bool {
        if answer.is_full() {
            return false;
        }
        if let Some((_, history)) = self.histories.get_index(place).filter(|_| asked.wants(id)) {
            answer.extend(asked.select(history.iter()));
        }
        true
    }

    /// The entities of which something arrived when the question asks for it, in order of address; `None` when that is
    /// not asked for or not remembered.
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
        if !self.taken.contains_key(owner) {
            self.taken.insert(owner.into(), Taken::default());
        }
        if let Some(taken) = self.taken.get_mut(owner) {
            taken.entities += entities;
            taken.bytes = (taken.bytes + bytes).saturating_sub(freed);
        }
        if self.arrivals.len() == ARRIVALS {
            let forgotten = self.arrivals.pop_front();
            self.forgotten_until = forgotten.map_or(0, |(arrived_ns, _)| arrived_ns);
        }
        // What is put back from a store may have arrived long ago; a time after the last one keeps the order.
        let last = self.arrivals.back().map_or(0, |(arrived_ns, _)| *arrived_ns);
        self.arrivals.push_back((snapshot.arrived_ns.max(last), place));
    }

    /// Forgets entities that have long been gone, when there are many: their names are free again, and their versions are
    /// counted on by whatever keeps them, or anew.
    pub(super) fn forget_gone(&mut self) {
        if self.gone < self.crowded.max(CROWD).max(self.histories.len() / 8) {
            return;
        }
        let newest = self.arrivals.back().map_or(0, |(arrived_ns, _)| *arrived_ns);
        let is_over = |history: &History| {
            history.newest.is_removed() && history.newest.arrived_ns.saturating_add(GONE_NS) < newest
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
            if let Some(taken) = self.taken.get_mut(owner(id)) {
                taken.entities = taken.entities.saturating_sub(1);
                taken.bytes = taken.bytes.saturating_sub(bytes);
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
    /// How many bytes it takes in memory, about.
    pub(crate) fn bytes(&self) -> u64 {
        bytes_of(&self.id, &self.instances)
    }
}

/// How many bytes a snapshot takes, about.
pub(super) fn bytes_of(id: &EntityId, instances: &[Instance]) -> u64 {
    let of_attribute = |(name, value): (&str, &Value)| {
        size_of::<(Box<str>, Value)>() + name.len() + ALLOCATION + outside(value)
    };
    let of_instance = |instance: &Instance| {
        let covariance =
            |(name, rows): (&String, &Vec<f64>)| 64 + name.len() + rows.len() * 8 + 2 * ALLOCATION;
        size_of::<Instance>()
            + ALLOCATION
            + instance.attributes.iter().map(of_attribute).sum::<usize>()
            + instance.covariance.iter().map(covariance).sum::<usize>()
    };
    let bytes = size_of::<Snapshot>() + id.as_str().len() + 2 * ALLOCATION;
    (bytes + instances.iter().map(of_instance).sum::<usize>()) as u64
}

/// What a value takes besides itself, bytes, about.
fn outside(value: &Value) -> usize {
    match value {
        Value::Null | Value::Bool(_) | Value::Int(_) | Value::Float(_) | Value::Duration(_) => 0,
        Value::String(text) => text.len() + ALLOCATION,
        Value::Bytes(bytes) => bytes.len() + ALLOCATION,
        Value::List(items) => {
            ALLOCATION + items.iter().map(|v| size_of::<Value>() + outside(v)).sum::<usize>()
        }
        Value::Map(fields) => {
            let field = |(name, v): (&String, &Value)| {
                size_of::<(String, Value)>() + name.len() + ALLOCATION + outside(v)
            };
            ALLOCATION + fields.iter().map(field).sum::<usize>()
        }
        Value::Vector(v) => v.frame.0.len() + ALLOCATION,
        Value::Pose(p) => p.frame.0.len() + ALLOCATION,
        Value::Wrench(w) => w.frame.0.len() + ALLOCATION,
        Value::Reference(r) => r.kind.len() + r.id.len() + 2 * ALLOCATION,
    }
}
