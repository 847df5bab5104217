//! Consolidation: which changes of working memory are stored in long-term memory, by one policy per core segment.
//!
//! It is the [`Backing`] of a working memory: it writes the selected changes to disk before a commit is acknowledged.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};
use sha2::{Digest, Sha256};

use super::record;
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

/// So many versions are noted as given before they are, so that few commits whose snapshots are not stored wait for the
/// disk.
const GIVEN_AHEAD: u64 = 1024;

/// Most entities that are remembered of which nothing is held back. The file has what is forgotten.
const MAX_KNOWN: usize = 100_000;
/// Entities that are looked at before a commit that waits comes in between.
const PART: usize = 1000;

/// What is known of the last stored snapshot of an entity.
#[derive(Clone, Debug)]
struct StoredVersion {
    version: u64,
    referenced_ns: u64,
    arrived_ns: u64,
    is_removed: bool,
    /// SHA-256 of the instances, where a policy compares them.
    content: Option<[u8; 32]>,
}

impl StoredVersion {
    fn of(snapshot: &Snapshot, policy: &Policy) -> Self {
        Self {
            version: snapshot.version,
            referenced_ns: snapshot.referenced_ns,
            arrived_ns: snapshot.arrived_ns,
            is_removed: snapshot.is_removed(),
            content: (*policy == Policy::OnChange).then(|| content(snapshot)),
        }
    }
}

/// SHA-256 of the instances of a snapshot.
fn content(snapshot: &Snapshot) -> [u8; 32] {
    let (mut bytes, mut blobs) = (Vec::new(), Vec::new());
    record::append_instances(&mut bytes, &snapshot.instances, &mut blobs);
    Sha256::digest(&bytes).into()
}

/// The last stored snapshot of an entity, and a newer one that may still have to be stored.
#[derive(Clone, Debug, Default)]
struct LastStored {
    kept: Option<StoredVersion>,
    /// Working memory has it, too, so that this takes nothing.
    pending: Option<Arc<Snapshot>>,
    /// The last version that is noted as given on disk, and the last that was given.
    noted: u64,
    given: u64,
}

impl LastStored {
    /// Whether the last version is a removal that is stored.
    fn is_gone(&self) -> bool {
        self.pending.is_none() && self.kept.as_ref().is_some_and(|kept| kept.is_removed)
    }
}

#[derive(Debug, Default)]
struct ConsolidatorState {
    last: BTreeMap<EntityId, LastStored>,
    /// Of entities that are not stored: the last version that is noted as given on disk, and the last that was given.
    noted: u64,
    given: u64,
    /// The last that earlier processes may have given.
    given_before: u64,
}

/// Writes changes of working memory to long-term memory.
#[derive(Debug)]
pub struct Consolidator {
    store: Arc<LongTermMemory>,
    policies: Policies,
    state: Mutex<ConsolidatorState>,
}

impl Consolidator {
    /// A consolidator that writes to `store`, as the policies say.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn new(store: Arc<LongTermMemory>, policies: Policies) -> Result<Self, StoreError> {
        let noted = store.given_to_others()?;
        let state = ConsolidatorState { noted, given: noted, given_before: noted, ..Default::default() };
        Ok(Self { store, policies, state: Mutex::new(state) })
    }

    /// The store that it writes to.
    pub fn store(&self) -> &Arc<LongTermMemory> {
        &self.store
    }

    /// Stores those of the snapshots that the policies select; they are on disk when this returns. Of the others, it is on
    /// disk that their versions were given. Returns how many were selected.
    ///
    /// # Errors
    /// As [`LongTermMemory::persist`]; then none is stored, and the same snapshots can be given again.
    pub fn consolidate(&self, snapshots: &[Arc<Snapshot>]) -> Result<u64, StoreError> {
        let mut state = self.state.lock();
        let mut changed: BTreeMap<EntityId, LastStored> = BTreeMap::new();
        let mut chosen = Vec::new();
        let mut given_to_others = state.given;
        for snapshot in snapshots {
            let policy = self.policies.of(snapshot.id.segment());
            if policy.ignores(&snapshot.id) {
                given_to_others = given_to_others.max(snapshot.version);
                continue;
            }
            if matches!(policy, Policy::Everything | Policy::Named(_)) {
                chosen.push(self.policies.as_kept(snapshot));
                continue;
            }
            let known = changed.get(&snapshot.id).or_else(|| state.last.get(&snapshot.id)).cloned();
            let mut known = match known {
                Some(known) => known,
                None => {
                    let newest = self.store.newest(&snapshot.id)?;
                    let kept = newest.map(|newest| StoredVersion::of(&newest, policy));
                    LastStored { kept, ..LastStored::default() }
                }
            };
            known.given = snapshot.version;
            if policy.keeps(snapshot, known.kept.as_ref()) {
                chosen.push(self.policies.as_kept(snapshot));
                (known.kept, known.pending) = (Some(StoredVersion::of(snapshot, policy)), None);
            } else if matches!(policy, Policy::AtMost { .. }) {
                known.pending = Some(Arc::clone(snapshot));
            }
            changed.insert(snapshot.id.clone(), known);
        }
        let mut notes = Vec::new();
        for (id, last) in &mut changed {
            // What is gone is stored as that, and needs no place in this table.
            if last.is_gone() {
                last.noted = last.given;
                notes.push((Some(id.clone()), last.given));
                continue;
            }
            // A stored version need not be noted; while something is written, the next versions are noted along with it.
            let stored = last.kept.as_ref().map_or(0, |kept| kept.version);
            let is_soon = !chosen.is_empty() && last.given + GIVEN_AHEAD / 2 > last.noted;
            if last.given > last.noted.max(stored) || is_soon {
                last.noted = last.given + GIVEN_AHEAD;
                notes.push((Some(id.clone()), last.noted));
            }
        }
        let is_noted = given_to_others <= state.noted;
        let noted_of_others = if is_noted { state.noted } else { given_to_others + GIVEN_AHEAD };
        if !is_noted {
            notes.push((None, noted_of_others));
        }
        self.store.persist_with(&chosen, &notes)?;
        (state.given, state.noted) = (given_to_others, noted_of_others);
        for (id, last) in changed {
            match last.is_gone() {
                true => drop(state.last.remove(&id)),
                false => drop(state.last.insert(id, last)),
            }
        }
        if state.last.len() > MAX_KNOWN {
            state.last.retain(|_, last| last.pending.is_some());
        }
        Ok(chosen.len() as u64)
    }

    /// Stores the last snapshots that a rate has held back. To be called at the end; then the version counts go on where
    /// they are. Returns how many.
    ///
    /// # Errors
    /// As [`LongTermMemory::persist`]; then they are still held back.
    pub fn flush(&self) -> Result<u64, StoreError> {
        let flushed = self.flush_if(|_, _| true)?;
        let mut state = self.state.lock();
        let mut notes = Vec::new();
        let ahead = state.last.iter().filter(|(_, last)| last.noted > last.given);
        notes.extend(ahead.map(|(id, last)| (Some(id.clone()), last.given)));
        notes.extend((state.noted > state.given).then_some((None, state.given)));
        self.store.persist_with(&[], &notes)?;
        state.last.values_mut().for_each(|last| last.noted = last.given);
        state.noted = state.given;
        Ok(flushed)
    }

    /// Stores the last snapshots that a rate has held back for as long as it asks, at the memory's time `now_ns`. To be
    /// called now and then, so that an entity that changes no more is stored as it is. Returns how many.
    ///
    /// # Errors
    /// As [`Self::flush`].
    pub fn flush_due(&self, now_ns: u64) -> Result<u64, StoreError> {
        self.flush_if(|hz, kept| {
            now_ns.saturating_sub(kept.map_or(0, |kept| kept.arrived_ns)) as f64 * 1e-9 * hz >= 1.0
        })
    }

    fn flush_if(&self, is_due: impl Fn(f64, Option<&StoredVersion>) -> bool) -> Result<u64, StoreError> {
        let is_held = |id: &EntityId, last: &LastStored| match self.policies.of(id.segment()) {
            Policy::AtMost { hz } => last.pending.is_some() && is_due(*hz, last.kept.as_ref()),
            _ => false,
        };
        let (mut flushed, mut after) = (0, Some(Bound::Unbounded));
        while let Some(from) = after {
            let mut state = self.state.lock();
            let part = || state.last.range((from.clone(), Bound::Unbounded)).take(PART);
            after = part().nth(PART - 1).map(|(id, _)| Bound::Excluded(id.clone()));
            let held = part().filter(|(id, last)| is_held(id, last));
            let held: Vec<_> = held.filter_map(|(_, last)| last.pending.clone()).collect();
            let kept: Vec<_> = held.iter().map(|snapshot| self.policies.as_kept(snapshot)).collect();
            self.store.persist_with(&kept, &[])?;
            for snapshot in &held {
                if let Some(last) = state.last.get_mut(&snapshot.id) {
                    let policy = self.policies.of(snapshot.id.segment());
                    (last.kept, last.pending) = (Some(StoredVersion::of(snapshot, policy)), None);
                }
            }
            flushed += held.len() as u64;
            // A commit that waits comes in between.
            MutexGuard::unlock_fair(state);
        }
        Ok(flushed)
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

    /// Whether the policy selects a snapshot of an entity that it does not ignore, after the last one that was stored.
    fn keeps(&self, snapshot: &Snapshot, kept: Option<&StoredVersion>) -> bool {
        let Some(kept) = kept else { return true };
        match self {
            Self::Nothing | Self::Everything | Self::Named(_) => true,
            Self::OnChange => kept.content != Some(content(snapshot)),
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
        let is_stored = !self.policies.of(id.segment()).ignores(id);
        Ok(if is_stored { self.store.last_given(id)? } else { self.state.lock().given_before })
    }

    fn holds_any(&self, snapshots: &[Arc<Snapshot>]) -> Result<bool, MemoryError> {
        self.store.holds_any(snapshots)
    }

    fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
        self.consolidate(snapshots)?;
        Ok(())
    }

    fn archive(&self) -> Option<&dyn Archive> {
        Some(&*self.store)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{snapshot, store};
    use super::*;

    #[test]
    fn what_is_remembered_of_entities_is_bounded() {
        let (_folder, _, store) = store();
        let kept = Consolidator::new(store, Policies::all(Policy::OnChange)).unwrap();
        for group in 0..12 {
            let names = (0..10_000).map(|n| snapshot(&format!("S/p/e{group}-{n}"), 1, 1, 1));
            assert_eq!(kept.consolidate(&names.collect::<Vec<_>>()), Ok(10_000));
            let known = kept.state.lock().last.len();
            assert!(known <= MAX_KNOWN, "{known} are remembered");
        }
        // The file knows the others.
        let other = snapshot("S/p/e0-0", 2, 2, 1);
        assert_eq!(kept.consolidate(&[other]), Ok(0), "it has not changed");
    }
}
