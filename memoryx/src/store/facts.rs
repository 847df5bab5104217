//! What whoever writes needs to know of entities, so that few of their rows are read.

use indexmap::IndexMap;

use crate::entity::EntityId;

/// Most entities in the cache.
pub(super) const MAX_CACHED: usize = 100_000;

/// Cached facts about an entity.
#[derive(Clone, Copy, Debug)]
pub(super) struct EntityFacts {
    /// Unique in the file.
    pub(super) number: u64,
    /// 0 when nothing is kept.
    pub(super) newest: u64,
    pub(super) newest_referenced_ns: u64,
    /// Whether referenced times never decrease from version to version.
    pub(super) ordered: bool,
}

/// The entities that were written recently.
pub(super) type EntityCache = IndexMap<EntityId, EntityFacts>;
