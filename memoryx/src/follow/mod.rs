//! Following a memory without silent gaps: a subscription that reads missed changes again, and reports those that are
//! lost.
//!
//! Every version of every entity is reported in order and once. When a version is missing, because the reader lagged
//! or the network lost it, the follower queries the memory's history. Versions that the history no longer has become
//! [`Change::Missed`]. A memory that was restarted or away is compared with what was reported: by version and arrival time of
//! each entity, whatever its clock says. Where it counts from 1 again, its snapshots are new.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use indexmap::IndexMap;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};

use crate::changes::Changes;
use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::{Head, Memory, pages};
use crate::query::{Pattern, Query, Times};
use crate::wire;

/// Snapshots per query.
const PAGE_SIZE: usize = 4096;
/// So many entities are remembered whether the memory still has them or not.
const MIN_REPORTED: usize = 16_384;
/// If more entities differ, all are read at once.
const MAX_ONE_BY_ONE: usize = 64;

/// What a follower reports.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// An entity has a new snapshot.
    New(Arc<Snapshot>),
    /// Versions of an entity that the memory no longer has, or that it skipped when it was restarted.
    Missed {
        /// The entity.
        id: EntityId,
        /// The first of them.
        from: u64,
        /// The last of them.
        to: u64,
    },
}

/// The last reported snapshot of an entity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LastSeen {
    /// Its version.
    pub version: u64,
    /// When it arrived in the memory, ns; 0 when unknown.
    pub arrived_ns: u64,
}

impl LastSeen {
    /// Whether the version is that of another snapshot, because the memory has counted anew.
    fn is_other(self, version: u64, arrived_ns: u64) -> bool {
        self.version == version && self.arrived_ns != 0 && self.arrived_ns != arrived_ns
    }
}

/// Which changes are missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gap {
    /// Those since the last time without a gap.
    Since,
    /// Whatever differs.
    Anything,
}

/// A subscription to the entities of a pattern, without silent gaps.
pub struct Follower {
    memory: Arc<dyn Memory>,
    changes: Changes,
    /// The last reported snapshot of each entity.
    reported: IndexMap<EntityId, LastSeen>,
    /// With so many, those are forgotten that the memory has forgotten.
    most_reported: usize,
    /// Every change that arrived before this time was received, ns.
    since_ns: u64,
    /// What was noticed and not yet read again.
    gap: Option<Gap>,
    ready: VecDeque<Change>,
}

impl Follower {
    /// Follows from now on. The present content counts as reported; its heads are returned.
    ///
    /// # Errors
    /// As [`Memory::subscribe`] and [`Memory::heads`].
    pub async fn from_now(
        memory: Arc<dyn Memory>,
        pattern: Pattern,
    ) -> Result<(Self, Vec<Head>), MemoryError> {
        let mut follower = Self::from_start(memory, pattern).await?;
        let heads = follower.memory.heads(follower.changes.pattern()).await?;
        follower.since_ns = heads.until_ns;
        let last = |head: &Head| LastSeen { version: head.version, arrived_ns: head.arrived_ns };
        follower.reported = heads.entities.iter().map(|head| (head.id.clone(), last(head))).collect();
        Ok((follower, heads.entities))
    }

    /// Follows changes only. If an entity's first change is not version 1, the follower reads the history that is
    /// still held.
    ///
    /// # Errors
    /// As [`Memory::subscribe`].
    pub async fn from_start(memory: Arc<dyn Memory>, pattern: Pattern) -> Result<Self, MemoryError> {
        let changes = memory.subscribe(&pattern).await?;
        let reported = IndexMap::new();
        let (most_reported, ready) = (MIN_REPORTED, VecDeque::new());
        Ok(Self { memory, changes, reported, most_reported, since_ns: 0, gap: None, ready })
    }

    /// Continues from the snapshots that were reported before, by entity. Changes since then come first, from the
    /// history, which is long-term memory's where working memory has forgotten.
    ///
    /// # Errors
    /// As [`Self::from_now`] and [`Memory::query`].
    pub async fn resume(
        memory: Arc<dyn Memory>,
        pattern: Pattern,
        reported: BTreeMap<EntityId, LastSeen>,
    ) -> Result<Self, MemoryError> {
        let mut follower = Self::from_start(memory, pattern).await?;
        follower.reported = reported.into_iter().collect();
        follower.gap = Some(Gap::Anything);
        follower.catch_up().await?;
        Ok(follower)
    }

    /// The next change; `None` when the memory has closed. Cancel-safe: dropping the future loses nothing.
    ///
    /// # Errors
    /// As [`Memory::query`]; the next call that notices the gap queries it again.
    pub async fn next(&mut self) -> Result<Option<Change>, MemoryError> {
        while self.ready.is_empty() {
            if self.gap.is_some() {
                self.catch_up().await?;
                continue;
            }
            match self.changes.recv().await {
                Ok(snapshot) => self.receive(snapshot).await?,
                Err(RecvError::Lagged(_)) => self.note_gap(),
                Err(RecvError::Closed) => return Ok(None),
            }
        }
        Ok(self.ready.pop_front())
    }

    /// The changes that are available without waiting, at most `most`.
    ///
    /// # Errors
    /// As [`Self::next`].
    pub async fn drain(&mut self, most: usize) -> Result<Vec<Change>, MemoryError> {
        while self.ready.len() < most {
            if self.gap.is_some() {
                self.catch_up().await?;
                continue;
            }
            match self.changes.try_recv() {
                Ok(snapshot) => self.receive(snapshot).await?,
                Err(TryRecvError::Lagged(_)) => self.note_gap(),
                Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
        }
        let count = most.min(self.ready.len());
        Ok(self.ready.drain(..count).collect())
    }

    fn note_gap(&mut self) {
        self.gap = Some(if self.changes.began_anew() { Gap::Anything } else { Gap::Since });
    }

    async fn receive(&mut self, snapshot: Arc<Snapshot>) -> Result<(), MemoryError> {
        let known = self.reported.get(&snapshot.id).copied().unwrap_or_default();
        if snapshot.version > known.version + 1 {
            // Set until the read ends, because the caller may drop this future before.
            self.gap = Some(Gap::Since);
            if known.version > 0 {
                // One gap rarely comes alone, and one query closes all.
                self.read_since().await?;
            }
            let known = self.reported.get(&snapshot.id).map_or(0, |reported| reported.version);
            if snapshot.version > known + 1 {
                let missing = Times::Versions(known + 1, snapshot.version - 1);
                let found = self.read(Query::latest(Pattern::entity(&snapshot.id)).times(missing)).await?;
                self.report_all(found.0);
            }
            self.gap = None;
        }
        self.report(snapshot);
        self.since_ns = self.since_ns.max(self.changes.until_ns());
        if self.reported.len() > self.most_reported {
            let heads = self.memory.heads(self.changes.pattern()).await?;
            let there: BTreeSet<&EntityId> = heads.entities.iter().map(|head| &head.id).collect();
            self.reported.retain(|id, _| there.contains(id));
            self.most_reported = MIN_REPORTED.max(2 * self.reported.len());
        }
        Ok(())
    }

    /// Reads what is missing. After an error, it is still missing.
    async fn catch_up(&mut self) -> Result<(), MemoryError> {
        match self.gap {
            Some(Gap::Anything) => self.compare().await?,
            Some(Gap::Since) => self.read_since().await?,
            None => {}
        }
        self.gap = None;
        Ok(())
    }

    /// Reads all unreported snapshots since the last time without a gap.
    async fn read_since(&mut self) -> Result<(), MemoryError> {
        let query = Query::history(self.changes.pattern().clone());
        let (found, until_ns) = self.read(Query { arrived_since: Some(self.since_ns), ..query }).await?;
        self.report_all(found);
        self.since_ns = self.since_ns.max(until_ns);
        Ok(())
    }

    /// Compares what was reported with what the memory has, and reads what differs.
    async fn compare(&mut self) -> Result<(), MemoryError> {
        let heads = self.memory.heads(self.changes.pattern()).await?;
        let there: BTreeSet<&EntityId> = heads.entities.iter().map(|head| &head.id).collect();
        // What the memory no longer knows begins anew when it comes back.
        self.reported.retain(|id, _| there.contains(id));
        let mut differing = Vec::new();
        for head in &heads.entities {
            let reported = self.reported.entry(head.id.clone()).or_default();
            if head.version < reported.version || reported.is_other(head.version, head.arrived_ns) {
                *reported = LastSeen::default();
            }
            if head.version > reported.version {
                differing.push((&head.id, *reported));
            }
        }
        let mut found = Vec::new();
        if differing.len() > MAX_ONE_BY_ONE {
            found = self.read(Query::history(self.changes.pattern().clone())).await?.0;
        } else {
            for (id, reported) in differing {
                let from =
                    |version| Query::history(Pattern::entity(id)).times(Times::Versions(version, u64::MAX));
                let mut history = self.read(from(reported.version)).await?.0;
                if history.iter().any(|s| reported.is_other(s.version, s.arrived_ns)) {
                    history = self.read(from(0)).await?.0;
                }
                found.extend(history);
            }
        }
        for snapshot in &found {
            if let Some(reported) = self.reported.get_mut(&snapshot.id)
                && reported.is_other(snapshot.version, snapshot.arrived_ns)
            {
                *reported = LastSeen::default();
            }
        }
        self.report_all(found);
        self.since_ns = heads.until_ns;
        Ok(())
    }

    /// Reads an answer, and the arrival time, ns, until which it is certainly complete.
    async fn read(&self, query: Query) -> Result<(Vec<Arc<Snapshot>>, u64), MemoryError> {
        let mut pieces = pages(query.with_long_term(), PAGE_SIZE);
        let (mut until, mut found) = (None, Vec::new());
        while let Some(piece) = pieces.next(&*self.memory).await? {
            // A change that arrives while later pieces are read may belong into an earlier one: only the first message counts.
            until.get_or_insert_with(|| {
                let first = &piece[..wire::in_one_answer(&piece)];
                first.iter().map(|snapshot| snapshot.arrived_ns).max().unwrap_or(0)
            });
            found.extend(piece);
        }
        Ok((found, until.unwrap_or(0)))
    }

    /// Reports snapshots, which are ordered by entity and version, in the order of their arrival.
    fn report_all(&mut self, found: Vec<Arc<Snapshot>>) {
        let mut ordered: Vec<(u64, Arc<Snapshot>)> = Vec::with_capacity(found.len());
        for snapshot in found {
            // Versions of one entity stay in order, whatever the clock did.
            let before = ordered.last().filter(|(_, last)| last.id == snapshot.id).map_or(0, |last| last.0);
            ordered.push((snapshot.arrived_ns.max(before), snapshot));
        }
        ordered.sort_by_key(|(arrived_ns, _)| *arrived_ns);
        ordered.into_iter().for_each(|(_, snapshot)| self.report(snapshot));
    }

    /// Reports a snapshot unless it was reported, and before it the gap, if there is one.
    fn report(&mut self, snapshot: Arc<Snapshot>) {
        let reported = self.reported.entry(snapshot.id.clone()).or_default();
        if snapshot.version <= reported.version {
            return;
        }
        if snapshot.version > reported.version + 1 {
            let (from, to) = (reported.version + 1, snapshot.version - 1);
            self.ready.push_back(Change::Missed { id: snapshot.id.clone(), from, to });
        }
        *reported = LastSeen { version: snapshot.version, arrived_ns: snapshot.arrived_ns };
        self.ready.push_back(Change::New(snapshot));
    }
}

#[cfg(test)]
mod tests;
