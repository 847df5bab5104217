//! The snapshots of one entity that working memory holds. Immutable, as the content is that has it: the next snapshot makes a new history,
//! which shares what was there before.

use std::borrow::Borrow;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

use super::blocks::Blocks;
use crate::entity::{EntityId, Snapshot};

/// At least one snapshot of an entity. It stands for the entity in a map: it is found by the entity's address, and equals every other
/// history of it.
#[derive(Clone)]
pub(super) struct History(Arc<Held>);

/// Behind one pointer, because copying a part of a map counts up each pointer in it.
struct Held {
    id: EntityId,
    newest: Arc<Snapshot>,
    older: Blocks<Arc<Snapshot>>,
}

impl History {
    /// The first snapshot of an entity.
    pub(super) fn of(snapshot: &Arc<Snapshot>) -> Self {
        let (id, newest) = (snapshot.id.clone(), Arc::clone(snapshot));
        Self(Arc::new(Held { id, newest, older: Blocks::default() }))
    }

    /// With a newer snapshot, and at most `keep` of them; and the bytes of those that were dropped.
    pub(super) fn followed_by(&self, snapshot: &Arc<Snapshot>, keep: usize) -> (Self, u64) {
        let mut older = self.0.older.clone();
        older.push(Arc::clone(&self.0.newest));
        let mut dropped = 0;
        while older.len() >= keep {
            let Some(oldest) = older.take_first() else { break };
            dropped += oldest.bytes();
        }
        (Self(Arc::new(Held { id: self.0.id.clone(), newest: Arc::clone(snapshot), older })), dropped)
    }

    pub(super) fn newest(&self) -> &Arc<Snapshot> {
        &self.0.newest
    }

    pub(super) fn oldest(&self) -> &Arc<Snapshot> {
        self.0.older.first().unwrap_or(&self.0.newest)
    }

    pub(super) fn len(&self) -> usize {
        self.0.older.len() + 1
    }

    /// From the oldest to the newest.
    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = &Arc<Snapshot>> {
        self.0.older.iter().chain(std::iter::once(&self.0.newest))
    }
}

impl Borrow<EntityId> for History {
    fn borrow(&self) -> &EntityId {
        &self.0.id
    }
}

impl Hash for History {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.id.hash(state);
    }
}

impl PartialEq for History {
    fn eq(&self, other: &Self) -> bool {
        self.0.id == other.0.id
    }
}

impl Eq for History {}
