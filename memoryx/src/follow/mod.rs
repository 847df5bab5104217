//! Following a memory without silent gaps: a subscription that reads again what it missed, and says what it could
//! not.
//!
//! Every version of every entity is told in order and once. Where a version is missing, because the reader lagged
//! or the network lost it, the memory's history is asked; what that no longer has becomes [`Change::Missed`]. A memory that
//! was started again and has not kept its versions counts them anew: what arrived later is new, whatever its number.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use indexmap::IndexMap;
use tokio::sync::broadcast::{self, error::RecvError, error::TryRecvError};

use crate::entity::{EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::{Memory, pages};
use crate::query::{Pattern, Query, Times};
use crate::wire;

/// Snapshots that are asked for at once.
const PIECE: usize = 4096;

/// What a follower tells.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// An entity has a new snapshot.
    New(Arc<Snapshot>),
    /// Versions of an entity that the memory no longer has.
    Missed {
        /// Whose.
        id: EntityId,
        /// The first of them.
        from: u64,
        /// The last of them.
        to: u64,
    },
}

/// What was told last of an entity.
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

    /// Whether a snapshot has come later under a version that was told: the memory has begun to count anew.
    fn is_before_life_of(self, snapshot: &Snapshot) -> bool {
        snapshot.version <= self.version && snapshot.arrived_ns > self.arrived_ns
    }
}

/// A subscription to what a pattern fits, without silent gaps.
pub struct Follower {
    memory: Arc<dyn Memory>,
    pattern: Pattern,
    changes: broadcast::Receiver<Arc<Snapshot>>,
    /// What was told last of each entity.
    told: IndexMap<EntityId, LastSeen>,
    /// What arrived before was received, ns.
    since_ns: u64,
    /// What arrived before was told, ns.
    told_until: u64,
    /// Something was missed that was not read again yet.
    behind: bool,
    ready: VecDeque<Change>,
}

impl Follower {
    /// Follows from now on. What the memory holds already counts as told, and is returned: the newest snapshot
    /// of each entity that has one.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn from_now(
        memory: Arc<dyn Memory>,
        pattern: Pattern,
    ) -> Result<(Self, Vec<Arc<Snapshot>>), MemoryError> {
        let mut follower = Self::from_start(memory, pattern);
        let query = Query::history(follower.pattern.clone()).limit(1);
        let mut pieces = pages(query, PIECE);
        let mut held = Vec::new();
        while let Some(piece) = pieces.next(&*follower.memory).await? {
            if held.is_empty() {
                follower.since_ns = seen_until(&piece);
            }
            held.extend(piece);
        }
        follower.told_until = follower.since_ns;
        follower.told = held.iter().map(|s| (s.id.clone(), LastSeen::of(s))).collect();
        Ok((follower, held.into_iter().filter(|s| !s.is_removed()).collect()))
    }

    /// Follows changes only; the first one of an entity that is not version 1 brings the history that is still held.
    #[must_use]
    pub fn from_start(memory: Arc<dyn Memory>, pattern: Pattern) -> Self {
        let changes = memory.subscribe();
        Self {
            memory,
            pattern,
            changes,
            told: IndexMap::new(),
            since_ns: 0,
            told_until: 0,
            behind: false,
            ready: VecDeque::new(),
        }
    }

    /// Follows on from what was told before, by entity: what has changed since comes first, from the history, which is
    /// long-term memory's where working memory has forgotten. `since_ns`: what arrived before was told; 0 when that is
    /// not known.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn resume(
        memory: Arc<dyn Memory>,
        pattern: Pattern,
        told: BTreeMap<EntityId, LastSeen>,
        since_ns: u64,
    ) -> Result<Self, MemoryError> {
        let mut follower = Self::from_start(memory, pattern);
        follower.told = told.into_iter().collect();
        follower.read_since(since_ns).await?;
        Ok(follower)
    }

    /// The next change; `None` when the memory has gone. Dropping the future loses nothing.
    ///
    /// # Errors
    /// As [`Memory::query`]; the same versions are asked for again by the next call that finds them missing.
    pub async fn next(&mut self) -> Result<Option<Change>, MemoryError> {
        loop {
            if let Some(change) = self.ready.pop_front() {
                self.note_told();
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

    /// The next change and those that wait behind it, at most `most` but one; nothing when the memory has gone. Dropping
    /// the future loses nothing.
    ///
    /// # Errors
    /// As [`Self::next`].
    pub async fn some(&mut self, most: usize) -> Result<Vec<Change>, MemoryError> {
        let Some(first) = self.next().await? else { return Ok(Vec::new()) };
        self.ready.push_front(first);
        self.drain(most.max(1)).await
    }

    /// What can be told without waiting for a change, about `most` of it.
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
        self.note_told();
        Ok(some)
    }

    fn note_told(&mut self) {
        if self.ready.is_empty() {
            self.told_until = self.since_ns;
        }
    }

    /// Takes back what was told last, to tell it again first.
    pub fn give_back(&mut self, changes: Vec<Change>) {
        for change in changes.into_iter().rev() {
            self.ready.push_front(change);
        }
    }

    /// Whether everything that has happened was told.
    #[must_use]
    pub fn told_all(&self) -> bool {
        self.ready.is_empty() && self.changes.is_empty() && !self.behind
    }

    async fn receive(&mut self, snapshot: Arc<Snapshot>) -> Result<(), MemoryError> {
        let arrived_ns = snapshot.arrived_ns;
        if self.pattern.matches(&snapshot.id) {
            self.take(snapshot).await?;
        }
        // What the memory says is asked for first: what it tells meanwhile waits, and is seen to wait.
        let until = match self.memory.told_until() {
            None => arrived_ns,
            Some(until) if self.changes.is_empty() => until,
            Some(_) => 0,
        };
        self.since_ns = self.since_ns.max(until);
        Ok(())
    }

    async fn take(&mut self, snapshot: Arc<Snapshot>) -> Result<(), MemoryError> {
        let known = match self.told.get_mut(&snapshot.id) {
            Some(told) if snapshot.version == told.version + 1 => {
                *told = LastSeen::of(&snapshot);
                self.ready.push_back(Change::New(snapshot));
                return Ok(());
            }
            told => told.copied(),
        };
        let begins = known.is_some_and(|told| told.is_before_life_of(&snapshot));
        if begins || snapshot.version > known.map_or(0, |told| told.version) + 1 {
            // Until they are read: nobody may wait for that to its end.
            self.behind = true;
            if known.is_some() {
                // Where one is missing, others are, and one question brings them all.
                self.read_since(self.since_ns).await?;
            }
            self.begin_if_anew(&snapshot).await?;
            let told = self.told.get(&snapshot.id).map_or(0, |told| told.version);
            if snapshot.version > told + 1 {
                let missing = Times::Versions(told + 1, snapshot.version - 1);
                self.read(Query::latest(Pattern::entity(&snapshot.id)).times(missing)).await?;
            }
            self.behind = false;
        }
        self.tell(snapshot);
        Ok(())
    }

    /// Reads what the memory has and was not told, from the last moment on at which nothing was missing.
    ///
    /// # Errors
    /// As [`Memory::query`]; nothing is forgotten then.
    pub async fn catch_up(&mut self) -> Result<(), MemoryError> {
        self.read_since(self.since_ns).await?;
        self.behind = false;
        Ok(())
    }

    /// After a gap: whatever the memory has that arrived at a time or later, ns, and was not told.
    ///
    /// # Errors
    /// As [`Memory::query`].
    pub async fn read_since(&mut self, since_ns: u64) -> Result<(), MemoryError> {
        let query = Query::history(self.pattern.clone());
        let seen_until = self.read(Query { arrived_since: Some(since_ns), ..query }).await?;
        self.since_ns = self.since_ns.max(since_ns).max(seen_until);
        Ok(())
    }

    /// Tells what an answer holds, in the order in which it arrived. Returns until when, by arrival, ns, it certainly holds
    /// everything that was asked for.
    async fn read(&mut self, query: Query) -> Result<u64, MemoryError> {
        let mut pieces = pages(query.with_long_term(), PIECE);
        let mut until = None;
        let mut found: Vec<(u64, Arc<Snapshot>)> = Vec::new();
        while let Some(piece) = pieces.next(&*self.memory).await? {
            until.get_or_insert_with(|| seen_until(&piece));
            for snapshot in piece {
                // No version comes before an earlier one, whatever the clock did.
                let before = found.last().filter(|(_, last)| last.id == snapshot.id).map_or(0, |last| last.0);
                found.push((snapshot.arrived_ns.max(before), snapshot));
            }
        }
        found.sort_by_key(|(arrived_ns, _)| *arrived_ns);
        for (_, snapshot) in found {
            self.begin_if_anew(&snapshot).await?;
            self.tell(snapshot);
        }
        Ok(until.unwrap_or(0))
    }

    /// Where a snapshot is the first one that has come since its memory began to count anew: finds the version from which it
    /// counts, the last one that it had kept.
    async fn begin_if_anew(&mut self, first: &Snapshot) -> Result<(), MemoryError> {
        if !self.told.get(&first.id).is_some_and(|told| told.is_before_life_of(first)) {
            return Ok(());
        }
        let earlier = Times::Versions(0, first.version.saturating_sub(1));
        let query = Query::latest(Pattern::entity(&first.id)).times(earlier).limit(1).with_long_term();
        let kept = self.memory.query(&query).await?.pop();
        if let Some(told) = self.told.get_mut(&first.id) {
            told.version = kept.map_or(0, |kept| kept.version);
        }
        Ok(())
    }

    /// Tells a snapshot unless it was told, and first what is missing before it.
    fn tell(&mut self, snapshot: Arc<Snapshot>) {
        let told = self.told.entry(snapshot.id.clone()).or_default();
        if snapshot.version <= told.version {
            return;
        }
        if snapshot.version > told.version + 1 {
            let (from, to) = (told.version + 1, snapshot.version - 1);
            self.ready.push_back(Change::Missed { id: snapshot.id.clone(), from, to });
        }
        *told = LastSeen::of(&snapshot);
        self.ready.push_back(Change::New(snapshot));
    }

    /// What arrived in the memory before was told, ns.
    #[must_use]
    pub fn told_until(&self) -> u64 {
        self.told_until
    }
}

/// Until when, by arrival, ns, the first piece of an answer and those after it certainly hold everything. What arrives
/// while the later ones are read may belong into one that was read before: so only the first answer counts.
fn seen_until(first: &[Arc<Snapshot>]) -> u64 {
    let together = &first[..wire::in_one_answer(first)];
    together.iter().map(|snapshot| snapshot.arrived_ns).max().unwrap_or(0)
}

#[cfg(test)]
mod tests;
