//! Following a memory without silent gaps: a subscription that reads missed changes again, and reports those that are
//! lost.
//!
//! Every version of every entity is reported in order and once. When a version is missing, because the reader lagged
//! or the network lost it, the follower queries the memory's history. Versions that the history no longer has become
//! [`Change::Missed`]. A memory that was restarted without its versions counts from 1 again; the follower then takes
//! snapshots with a later arrival time as new, whatever their version.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use indexmap::IndexMap;
use tokio::sync::broadcast::{self, error::RecvError, error::TryRecvError};

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::{Memory, pages};
use crate::query::{Pattern, Query, Times};
use crate::wire;

/// Snapshots per query.
const PAGE_SIZE: usize = 4096;

/// What a follower reports.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// An entity has a new snapshot.
    New(Arc<Snapshot>),
    /// Versions of an entity that the memory no longer has.
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
    /// When it arrived in the memory, ns.
    pub arrived_ns: u64,
}

impl LastSeen {
    fn of(snapshot: &Snapshot) -> Self {
        Self { version: snapshot.version, arrived_ns: snapshot.arrived_ns }
    }

    /// Whether a snapshot arrived later with a version that was already reported: the memory has restarted its count.
    fn is_of_earlier_run_than(self, snapshot: &Snapshot) -> bool {
        snapshot.version <= self.version && snapshot.arrived_ns > self.arrived_ns
    }
}

/// A subscription to the entities of a pattern, without silent gaps.
pub struct Follower {
    memory: Arc<dyn Memory>,
    pattern: Pattern,
    changes: broadcast::Receiver<Arc<Snapshot>>,
    /// The last reported snapshot of each entity.
    reported: IndexMap<EntityId, LastSeen>,
    /// Every change that arrived before this time was received, ns.
    since_ns: u64,
    /// Every change that arrived before this time was reported, ns.
    complete_until: u64,
    /// A gap was noticed and not yet read again.
    behind: bool,
    ready: VecDeque<Change>,
}

impl Follower {
    /// Follows from now on. The present content counts as reported, and is returned: the newest snapshot of each
    /// entity that has one.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn from_now(
        memory: Arc<dyn Memory>,
        pattern: Pattern,
    ) -> Result<(Self, Vec<Arc<Snapshot>>), MemoryError> {
        let mut follower = Self::from_start(memory, pattern);
        let query = Query::history(follower.pattern.clone()).limit(1);
        let mut pieces = pages(query, PAGE_SIZE);
        let mut held = Vec::new();
        while let Some(piece) = pieces.next(&*follower.memory).await? {
            if held.is_empty() {
                follower.since_ns = seen_until(&piece);
            }
            held.extend(piece);
        }
        follower.complete_until = follower.since_ns;
        follower.reported = held.iter().map(|s| (s.id.clone(), LastSeen::of(s))).collect();
        Ok((follower, held.into_iter().filter(|s| !s.is_removed()).collect()))
    }

    /// Follows changes only. If an entity's first change is not version 1, the follower reads the history that is
    /// still held.
    pub fn from_start(memory: Arc<dyn Memory>, pattern: Pattern) -> Self {
        let changes = memory.subscribe();
        Self {
            memory,
            pattern,
            changes,
            reported: IndexMap::new(),
            since_ns: 0,
            complete_until: 0,
            behind: false,
            ready: VecDeque::new(),
        }
    }

    /// Continues from the snapshots that were reported before, by entity. Changes since then come first, from the
    /// history, which is long-term memory's where working memory has forgotten. `since_ns`: everything that arrived
    /// before was reported; 0 when unknown.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn resume(
        memory: Arc<dyn Memory>,
        pattern: Pattern,
        reported: BTreeMap<EntityId, LastSeen>,
        since_ns: u64,
    ) -> Result<Self, MemoryError> {
        let mut follower = Self::from_start(memory, pattern);
        follower.reported = reported.into_iter().collect();
        follower.read_since(since_ns).await?;
        Ok(follower)
    }

    /// The next change; `None` when the memory has closed. Cancel-safe: dropping the future loses nothing.
    ///
    /// # Errors
    /// As [`Memory::query`]; the next call that notices the gap queries it again.
    pub async fn next(&mut self) -> Result<Option<Change>, MemoryError> {
        loop {
            if let Some(change) = self.ready.pop_front() {
                self.note_reported();
                return Ok(Some(change));
            }
            if self.behind {
                self.catch_up().await?;
                continue;
            }
            match self.changes.recv().await {
                Ok(snapshot) => self.receive(snapshot).await?,
                Err(RecvError::Lagged(_)) => self.behind = true,
                Err(RecvError::Closed) => return Ok(None),
            }
        }
    }

    /// Waits for the next change, and returns it with the changes that wait behind it, at most `most`; empty when the
    /// memory has closed. Cancel-safe.
    ///
    /// # Errors
    /// As [`Self::next`].
    pub async fn some(&mut self, most: usize) -> Result<Vec<Change>, MemoryError> {
        let Some(first) = self.next().await? else { return Ok(Vec::new()) };
        self.ready.push_front(first);
        self.drain(most.max(1)).await
    }

    /// The changes that are available without waiting, at most `most`.
    ///
    /// # Errors
    /// As [`Self::next`].
    pub async fn drain(&mut self, most: usize) -> Result<Vec<Change>, MemoryError> {
        while self.ready.len() < most {
            if self.behind {
                self.catch_up().await?;
                continue;
            }
            match self.changes.try_recv() {
                Ok(snapshot) => self.receive(snapshot).await?,
                Err(TryRecvError::Lagged(_)) => self.behind = true,
                Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
        }
        let count = most.min(self.ready.len());
        let some = self.ready.drain(..count).collect();
        self.note_reported();
        Ok(some)
    }

    fn note_reported(&mut self) {
        if self.ready.is_empty() {
            self.complete_until = self.since_ns;
        }
    }

    /// Whether all changes so far were reported.
    pub fn is_caught_up(&self) -> bool {
        self.ready.is_empty() && self.changes.is_empty() && !self.behind
    }

    async fn receive(&mut self, snapshot: Arc<Snapshot>) -> Result<(), MemoryError> {
        let arrived_ns = snapshot.arrived_ns;
        if self.pattern.matches(&snapshot.id) {
            self.accept(snapshot).await?;
        }
        // Ask the memory first: a change that arrives meanwhile is in the queue, where `is_empty` sees it.
        let until = match self.memory.complete_until() {
            None => arrived_ns,
            Some(until) if self.changes.is_empty() => until,
            Some(_) => 0,
        };
        self.since_ns = self.since_ns.max(until);
        Ok(())
    }

    async fn accept(&mut self, snapshot: Arc<Snapshot>) -> Result<(), MemoryError> {
        let known = match self.reported.get_mut(&snapshot.id) {
            Some(reported) if snapshot.version == reported.version + 1 => {
                *reported = LastSeen::of(&snapshot);
                self.ready.push_back(Change::New(snapshot));
                return Ok(());
            }
            reported => reported.copied(),
        };
        let begins = known.is_some_and(|reported| reported.is_of_earlier_run_than(&snapshot));
        if begins || snapshot.version > known.map_or(0, |reported| reported.version) + 1 {
            // Set until the read ends, because the caller may drop this future before.
            self.behind = true;
            if known.is_some() {
                // One gap rarely comes alone, and one query closes all.
                self.read_since(self.since_ns).await?;
            }
            self.notice_restart(&snapshot).await?;
            let reported = self.reported.get(&snapshot.id).map_or(0, |reported| reported.version);
            if snapshot.version > reported + 1 {
                let missing = Times::Versions(reported + 1, snapshot.version - 1);
                self.read(Query::latest(Pattern::entity(&snapshot.id)).times(missing)).await?;
            }
            self.behind = false;
        }
        self.report(snapshot);
        Ok(())
    }

    /// Reads all unreported snapshots since the last time without a gap.
    ///
    /// # Errors
    /// As [`Memory::query`]; the gap is still remembered then.
    pub async fn catch_up(&mut self) -> Result<(), MemoryError> {
        self.read_since(self.since_ns).await?;
        self.behind = false;
        Ok(())
    }

    /// After a gap: reads all unreported snapshots that arrived at `since_ns` or later.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn read_since(&mut self, since_ns: u64) -> Result<(), MemoryError> {
        let query = Query::history(self.pattern.clone());
        let seen_until = self.read(Query { arrived_since: Some(since_ns), ..query }).await?;
        self.since_ns = self.since_ns.max(since_ns).max(seen_until);
        Ok(())
    }

    /// Reports the snapshots of an answer in the order of their arrival. Returns the arrival time, ns, until which
    /// the answer is certainly complete.
    async fn read(&mut self, query: Query) -> Result<u64, MemoryError> {
        let mut pieces = pages(query.with_long_term(), PAGE_SIZE);
        let mut until = None;
        let mut found: Vec<(u64, Arc<Snapshot>)> = Vec::new();
        while let Some(piece) = pieces.next(&*self.memory).await? {
            until.get_or_insert_with(|| seen_until(&piece));
            for snapshot in piece {
                // Versions of one entity stay in order, whatever the clock did.
                let before = found.last().filter(|(_, last)| last.id == snapshot.id).map_or(0, |last| last.0);
                found.push((snapshot.arrived_ns.max(before), snapshot));
            }
        }
        found.sort_by_key(|(arrived_ns, _)| *arrived_ns);
        for (_, snapshot) in found {
            self.notice_restart(&snapshot).await?;
            self.report(snapshot);
        }
        Ok(until.unwrap_or(0))
    }

    /// If a snapshot is the first one after its memory restarted its count: finds the last version that the memory
    /// had kept, from which it counts on.
    async fn notice_restart(&mut self, first: &Snapshot) -> Result<(), MemoryError> {
        if !self.reported.get(&first.id).is_some_and(|reported| reported.is_of_earlier_run_than(first)) {
            return Ok(());
        }
        let earlier = Times::Versions(0, first.version.saturating_sub(1));
        let query = Query::latest(Pattern::entity(&first.id)).times(earlier).limit(1).with_long_term();
        let kept = self.memory.query(&query).await?.pop();
        if let Some(reported) = self.reported.get_mut(&first.id) {
            reported.version = kept.map_or(0, |kept| kept.version);
        }
        Ok(())
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
        *reported = LastSeen::of(&snapshot);
        self.ready.push_back(Change::New(snapshot));
    }

    /// Every change that arrived before this time was reported, ns.
    pub fn complete_until(&self) -> u64 {
        self.complete_until
    }
}

/// The arrival time, ns, until which an answer is certainly complete. A change that arrives while later pieces are
/// read may belong into an earlier one: so only the first message counts.
fn seen_until(first: &[Arc<Snapshot>]) -> u64 {
    let together = &first[..wire::in_one_answer(first)];
    together.iter().map(|snapshot| snapshot.arrived_ns).max().unwrap_or(0)
}

#[cfg(test)]
mod tests;
