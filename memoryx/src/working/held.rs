//! What a working memory holds: histories found by address in constant time, and in the order of addresses.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::mem::size_of;
use std::sync::Arc;

use armarium_values::Value;
use indexmap::IndexMap;

use crate::entity::{EntityId, Instance, Snapshot};
use crate::query::Asked;

/// What one allocation takes beyond its content, bytes, about.
const ALLOCATION: usize = 16;

#[derive(Default)]
pub(super) struct State {
    /// By address. Nothing is ever taken out, so that places stay.
    histories: IndexMap<EntityId, VecDeque<Arc<Snapshot>>>,
    /// The places of the addresses of each core segment.
    segments: BTreeMap<String, BTreeMap<EntityId, usize>>,
    pub(super) read_only: BTreeSet<(String, String)>,
    bytes: u64,
}

impl State {
    pub(super) fn len(&self) -> usize {
        self.histories.len()
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    pub(super) fn newest(&self, id: &EntityId) -> Option<&Arc<Snapshot>> {
        self.histories.get(id)?.back()
    }

    pub(super) fn is_read_only(&self, id: &EntityId) -> bool {
        !self.read_only.is_empty()
            && self.read_only.iter().any(|(s, p)| s == id.segment() && p == id.provider())
    }

    /// What a question takes of what is held, in order of address, then version.
    pub(super) fn select(&self, asked: &Asked<'_>) -> Vec<Arc<Snapshot>> {
        let mut found = Vec::new();
        if let Some(id) = asked.query().pattern.exact() {
            if let Some(history) = self.histories.get(&id).filter(|_| asked.wants(&id)) {
                found = asked.select(history.iter().cloned());
            }
            return found;
        }
        let one = asked.query().pattern.exact_segment();
        let segments = self.segments.iter().filter(|(name, _)| one.is_none_or(|one| one == name.as_str()));
        for (_, entities) in segments {
            let first = asked.query().after.as_ref().map(|after| &after.id);
            let range = first.map_or_else(|| entities.range::<EntityId, _>(..), |id| entities.range(id..));
            for (id, place) in range {
                if asked.is_full(found.len()) {
                    return found;
                }
                if let Some((_, history)) = self.histories.get_index(*place).filter(|_| asked.wants(id)) {
                    found.extend(asked.select(history.iter().cloned()));
                }
            }
        }
        found
    }

    pub(super) fn put_in(&mut self, snapshot: &Arc<Snapshot>, keep: usize) {
        let place = match self.histories.get_index_of(&snapshot.id) {
            Some(place) => place,
            None => {
                let (place, _) = self.histories.insert_full(snapshot.id.clone(), VecDeque::with_capacity(1));
                if !self.segments.contains_key(snapshot.id.segment()) {
                    self.segments.insert(snapshot.id.segment().into(), BTreeMap::new());
                }
                if let Some(segment) = self.segments.get_mut(snapshot.id.segment()) {
                    segment.insert(snapshot.id.clone(), place);
                }
                place
            }
        };
        let history = &mut self.histories[place];
        while history.len() >= keep {
            if let Some(old) = history.pop_front() {
                self.bytes -= bytes_of(&old.id, &old.instances).min(self.bytes);
            }
        }
        history.push_back(Arc::clone(snapshot));
        self.bytes += bytes_of(&snapshot.id, &snapshot.instances);
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
