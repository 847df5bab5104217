//! The memory model after MemoryX and its successor ArMem: memory / core segment / provider segment / entity /
//! snapshot / instance, and the trait through which all memories are used.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use async_trait::async_trait;
use serde::{Deserialize, Serialize};
use armarium_values::Value;
use tokio::sync::broadcast;

/// The address of an entity: `core segment / provider / entity`, each a name without `/`, `*`, `#`, `?`, `$`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct EntityId {
    segment: String,
    provider: String,
    entity: String,
}

/// What is known of an entity at one time, by one hypothesis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// Attributes by name.
    pub attributes: BTreeMap<String, Value>,
    /// How far it is trusted, 0 to 1.
    pub confidence: f64,
}

/// The state of an entity at one time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Whose.
    pub id: EntityId,
    /// Counts the entity's snapshots from 1.
    pub version: u64,
    /// The time that the data speak of, ns.
    pub referenced_ns: u64,
    /// When it was sent, ns.
    pub sent_ns: u64,
    /// When it arrived in this memory, ns.
    pub arrived_ns: u64,
    /// One or more hypotheses, most trusted first.
    pub instances: Vec<Instance>,
}

/// An update of one entity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Commit {
    /// Which entity.
    pub id: EntityId,
    /// The time that the data speak of, ns.
    pub referenced_ns: u64,
    /// The new state.
    pub instances: Vec<Instance>,
    /// When given, the commit is refused unless this is the entity's newest version (0: it must not exist).
    pub expected_version: Option<u64>,
}

/// Why a memory refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MemoryError {
    /// A name that cannot be part of an address.
    #[error("`{name}` cannot be part of a memory address: names are not empty and hold none of / * # ? $")]
    Name {
        /// The name.
        name: String,
    },
    /// There is no such entity.
    #[error("there is no entity `{id}` in memory")]
    NotFound {
        /// The address.
        id: String,
    },
    /// Somebody else changed the entity first.
    #[error("`{id}` is at version {actual}, not {expected}: somebody else has changed it")]
    Conflict {
        /// The address.
        id: String,
        /// What the writer expected.
        expected: u64,
        /// What it is.
        actual: u64,
    },
    /// The store under the memory failed.
    #[error("the memory's store failed: {what}")]
    Store {
        /// What happened.
        what: String,
    },
}

/// A memory as skills and processes see it: in this process, on disk, or another agent's.
#[async_trait]
pub trait Memory: Send + Sync {
    /// Applies all updates or none; returns the new versions in order.
    ///
    /// # Errors
    /// [`MemoryError::Conflict`] when an expected version is not the newest.
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError>;
    /// The newest snapshot of an entity.
    ///
    /// # Errors
    /// [`MemoryError::NotFound`] when there is none.
    async fn latest(&self, id: &EntityId) -> Result<Arc<Snapshot>, MemoryError>;
    /// The newest snapshots of all entities of a core segment, ordered by address.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the memory cannot be read.
    async fn segment(&self, segment: &str) -> Result<Vec<Arc<Snapshot>>, MemoryError>;
    /// All later changes, in order. A reader that falls behind is told how many it missed.
    fn subscribe(&self) -> broadcast::Receiver<Arc<Snapshot>>;
}

impl EntityId {
    /// An address.
    ///
    /// # Errors
    /// [`MemoryError::Name`] when a part cannot be part of an address.
    pub fn new(segment: &str, provider: &str, entity: &str) -> Result<Self, MemoryError> {
        for name in [segment, provider, entity] {
            if name.is_empty() || name.contains(['/', '*', '#', '?', '$']) {
                return Err(MemoryError::Name { name: name.into() });
            }
        }
        Ok(Self { segment: segment.into(), provider: provider.into(), entity: entity.into() })
    }

    /// The core segment.
    #[must_use]
    pub fn segment(&self) -> &str {
        &self.segment
    }

    /// The provider segment.
    #[must_use]
    pub fn provider(&self) -> &str {
        &self.provider
    }

    /// The entity's own name.
    #[must_use]
    pub fn entity(&self) -> &str {
        &self.entity
    }
}

impl fmt::Display for EntityId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.segment, self.provider, self.entity)
    }
}
