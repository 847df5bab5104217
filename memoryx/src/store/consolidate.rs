//! Consolidation: which changes of working memory are stored in long-term memory, by one policy per core segment.
//!
//! It is the [`Backing`] of a working memory: it writes the selected changes to disk before a commit is acknowledged.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use parking_lot::Mutex;

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::store::{Coding, LongTermMemory, StoreError};
use crate::working::{Archive, Backing};

/// Which snapshots of a core segment are stored.
#[derive(Clone, Debug, PartialEq)]
pub enum Policy {
    /// None.
    Nothing,
    /// Every snapshot.
    Everything,
    /// Snapshots whose instances differ from the last stored one.
    OnChange,
    /// At most this many snapshots per second of each entity, by their referenced time; and the last one.
    AtMost {
        /// How many, Hz.
        hz: f64,
    },
    /// Every snapshot of the entities with these names.
    Named(BTreeSet<String>),
}

/// The policies of all core segments.
#[derive(Clone, Debug, PartialEq)]
pub struct Policies {
    /// For core segments without their own policy.
    pub default: Policy,
    /// By core segment.
    pub by_segment: BTreeMap<String, Policy>,
    /// How attributes are encoded in long-term memory, by core segment; unchanged where there is no entry.
    pub codings: BTreeMap<String, Coding>,
}

impl Default for Policies {
    /// All motions, object classes when they change, and one snapshot per second of the rest.
    fn default() -> Self {
        let own = [("Motions", Policy::Everything), ("ObjectClasses", Policy::OnChange)];
        Self {
            default: Policy::AtMost { hz: 1.0 },
            by_segment: own.into_iter().map(|(name, policy)| (name.to_owned(), policy)).collect(),
            codings: BTreeMap::new(),
        }
    }
}

impl Policies {
    /// One policy for all core segments.
    pub fn all(policy: Policy) -> Self {
        Self { default: policy, by_segment: BTreeMap::new(), codings: BTreeMap::new() }
    }

    /// The same policies with one for a core segment.
    #[must_use]
    pub fn with(mut self, segment: &str, policy: Policy) -> Self {
        self.by_segment.insert(segment.into(), policy);
        self
    }

    /// The same policies with a coding for a core segment.
    #[must_use]
    pub fn coded(mut self, segment: &str, coding: Coding) -> Self {
        self.codings.insert(segment.into(), coding);
        self
    }

    /// A snapshot as it is stored.
    fn as_kept(&self, snapshot: &Arc<Snapshot>) -> Arc<Snapshot> {
        let coding = self.codings.get(snapshot.id.segment());
        coding.map_or_else(|| Arc::clone(snapshot), |coding| coding.of(snapshot))
    }

    fn of(&self, segment: &str) -> &Policy {
        self.by_segment.get(segment).unwrap_or(&self.default)
    }
}

/// The last stored snapshot of an entity, and a newer one that may still have to be stored.
#[derive(Clone, Debug, Default)]
struct LastStored {
    kept: Option<Arc<Snapshot>>,
    pending: Option<Arc<Snapshot>>,
}

/// Writes changes of working memory to long-term memory.
#[derive(Debug)]
pub struct Consolidator {
    store: Arc<LongTermMemory>,
    policies: Policies,
    last: Mutex<BTreeMap<EntityId, LastStored>>,
}

impl Consolidator {
    /// A consolidator that writes to `store`, as the policies say.
    pub fn new(store: Arc<LongTermMemory>, policies: Policies) -> Self {
        Self { store, policies, last: Mutex::default() }
    }

    /// The store that it writes to.
    pub fn store(&self) -> &Arc<LongTermMemory> {
        &self.store
    }

    /// Stores those of the snapshots that the policies select; they are on disk when this returns. Returns how many.
    ///
    /// # Errors
    /// As [`LongTermMemory::persist`]; then none is stored, and the same snapshots can be given again.
    pub fn consolidate(&self, snapshots: &[Arc<Snapshot>]) -> Result<u64, StoreError> {
        let mut last = self.last.lock();
        let mut changed: BTreeMap<EntityId, LastStored> = BTreeMap::new();
        let mut chosen = Vec::new();
        for snapshot in snapshots {
            let policy = self.policies.of(snapshot.id.segment());
            if policy.ignores(&snapshot.id) {
                continue;
            }
            if policy.keeps_all() {
                chosen.push(self.policies.as_kept(snapshot));
                continue;
            }
            let known = changed.get(&snapshot.id).or_else(|| last.get(&snapshot.id)).cloned();
            let mut known = match known {
                Some(known) => known,
                None => LastStored { kept: self.store.newest(&snapshot.id)?, pending: None },
            };
            if policy.keeps(snapshot, known.kept.as_deref()) {
                chosen.push(self.policies.as_kept(snapshot));
                known = LastStored { kept: Some(Arc::clone(snapshot)), pending: None };
            } else {
                known.pending = Some(Arc::clone(snapshot));
            }
            changed.insert(snapshot.id.clone(), known);
        }
        self.store.persist(&chosen)?;
        last.append(&mut changed);
        Ok(chosen.len() as u64)
    }

    /// Stores the last snapshots that a rate has held back; to be called at the end. Returns how many.
    ///
    /// # Errors
    /// As [`LongTermMemory::persist`]; then they are still held back.
    pub fn flush(&self) -> Result<u64, StoreError> {
        let mut last = self.last.lock();
        let rated = |id: &EntityId| matches!(self.policies.of(id.segment()), Policy::AtMost { .. });
        let held: Vec<_> =
            last.iter().filter(|(id, _)| rated(id)).filter_map(|(_, l)| l.pending.clone()).collect();
        let kept: Vec<_> = held.iter().map(|snapshot| self.policies.as_kept(snapshot)).collect();
        self.store.persist(&kept)?;
        for snapshot in &held {
            last.insert(snapshot.id.clone(), LastStored { kept: Some(Arc::clone(snapshot)), pending: None });
        }
        Ok(held.len() as u64)
    }
}

impl Policy {
    fn ignores(&self, id: &EntityId) -> bool {
        match self {
            Self::Nothing => true,
            Self::Named(names) => !names.contains(id.entity()),
            Self::Everything | Self::OnChange | Self::AtMost { .. } => false,
        }
    }

    /// Whether the policy selects every snapshot of an entity, independent of earlier ones.
    fn keeps_all(&self) -> bool {
        matches!(self, Self::Everything | Self::Named(_))
    }

    fn keeps(&self, snapshot: &Snapshot, kept: Option<&Snapshot>) -> bool {
        let Some(kept) = kept else { return !matches!(self, Self::Nothing) };
        match self {
            Self::Nothing | Self::Everything | Self::Named(_) => self.keeps_all(),
            Self::OnChange => kept.instances != snapshot.instances,
            // A removal is never held back. When the clock has gone back, counting starts again.
            Self::AtMost { hz } => {
                let passed = snapshot.referenced_ns.checked_sub(kept.referenced_ns);
                snapshot.is_removed() || passed.is_none_or(|ns| ns as f64 * 1e-9 * hz >= 1.0)
            }
        }
    }
}

impl Backing for Consolidator {
    fn last_version(&self, id: &EntityId) -> Result<u64, MemoryError> {
        self.store.last_version(id)
    }

    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
        self.consolidate(snapshots)?;
        Ok(())
    }

    fn archive(&self) -> Option<&dyn Archive> {
        Some(&*self.store)
    }
}
