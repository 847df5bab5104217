//! How commits are made: the committing thread takes all waiting requests, numbers them, has the backing store them
//! together, and makes them visible. No reader sees a snapshot that the backing has not stored.

use std::collections::BTreeMap;
use std::sync::Arc;

use indexmap::IndexMap;
use parking_lot::Mutex;

use super::WorkingMemory;
use super::content::{Content, Usage, bytes_of, owner};
use crate::entity::{Commit, EntityId, Instance, Snapshot};
use crate::error::MemoryError;
use crate::schema::check_form;

/// Updates that are committed all or none, in the queue.
pub(super) struct Request {
    pub(super) updates: Vec<Commit>,
    pub(super) sent_ns: u64,
    pub(super) prior: bool,
    pub(super) answer: Arc<Mutex<Option<CommitResult>>>,
}

/// The versions that a commit has made.
pub(super) type CommitResult = Result<Vec<u64>, MemoryError>;

/// The newest version of an entity, and whether it is a removal.
type NewestVersion = (u64, bool);

/// Versions and sizes of a group of commits, which the memory does not hold yet.
#[derive(Default)]
pub(super) struct GroupVersions {
    newest: IndexMap<EntityId, NewestVersion>,
    /// Capacity that the group takes.
    all: Usage,
    /// The same by owner, if capacity is divided.
    by_owner: BTreeMap<String, Usage>,
}

impl GroupVersions {
    fn of(&self, owner: &str) -> Usage {
        self.by_owner.get(owner).copied().unwrap_or_default()
    }

    /// Counts a snapshot of the group.
    pub(super) fn take(&mut self, owner: Option<&str>, more: Usage) {
        self.all = self.all + more;
        if let Some(owner) = owner {
            let taken = self.of(owner) + more;
            self.by_owner.insert(owner.into(), taken);
        }
    }
}

impl WorkingMemory {
    pub(super) fn write_one(&self, updates: Vec<Commit>, sent_ns: u64, prior: bool) -> CommitResult {
        self.write(vec![(updates, sent_ns, prior)]).pop().expect("one request has one answer")
    }

    /// Commits requests: their updates, when these were sent, ns, and whether they are prior knowledge. Returns the
    /// answer to each.
    pub(super) fn write(&self, requests: Vec<(Vec<Commit>, u64, bool)>) -> Vec<CommitResult> {
        let mut answers = Vec::with_capacity(requests.len());
        let requests = requests.into_iter().map(|(updates, sent_ns, prior)| {
            let answer = Arc::new(Mutex::new(None));
            answers.push(Arc::clone(&answer));
            Request { updates, sent_ns, prior, answer }
        });
        self.waiting.lock().extend(requests);
        self.commit_waiting();
        let taken = |answer: Arc<Mutex<Option<CommitResult>>>| {
            let answer = answer.lock().take();
            answer.expect("whoever takes a request from the queue answers it")
        };
        answers.into_iter().map(taken).collect()
    }

    /// Commits all waiting requests. When this returns, every request that waited before the call is answered, by
    /// this thread or by the one that was committing.
    pub(super) fn commit_waiting(&self) {
        let mut last_arrival = self.commit_lock.lock();
        let requests = std::mem::take(&mut *self.waiting.lock());
        if requests.is_empty() {
            return;
        }
        // Arrival times never go back, even if the clock does.
        *last_arrival = self.now_ns().max(*last_arrival);
        self.commit_together(requests, *last_arrival);
    }

    fn commit_together(&self, requests: Vec<Request>, arrived_ns: u64) {
        let mut numbered = GroupVersions::default();
        let mut group = Vec::new();
        let mut taken = Vec::with_capacity(requests.len());
        for request in requests {
            let from = group.len();
            match self.number(
                request.updates,
                request.sent_ns,
                arrived_ns,
                request.prior,
                &mut numbered,
                &mut group,
            ) {
                Ok(()) => taken.push((request.answer, from..group.len())),
                Err(error) => answer(&request.answer, Err(error)),
            }
        }
        let kept = self.backing.as_ref().filter(|_| !group.is_empty()).map_or(Ok(()), |b| b.take(&group));
        match kept {
            Ok(()) => {
                let versions = |range: std::ops::Range<usize>| -> Vec<u64> {
                    group.get(range).unwrap_or_default().iter().map(|s| s.version).collect()
                };
                let answers: Vec<_> = taken.into_iter().map(|(to, range)| (to, versions(range))).collect();
                self.put_in(group);
                answers.into_iter().for_each(|(to, versions)| answer(&to, Ok(versions)));
            }
            Err(error) => taken.iter().for_each(|(to, _)| answer(to, Err(error.clone()))),
        }
    }

    /// Checks updates and makes numbered snapshots of them, not yet visible. After an error `numbered` and `group`
    /// are unchanged.
    fn number(
        &self,
        updates: Vec<Commit>,
        sent_ns: u64,
        arrived_ns: u64,
        prior: bool,
        numbered: &mut GroupVersions,
        group: &mut Vec<Arc<Snapshot>>,
    ) -> Result<(), MemoryError> {
        let content = self.read();
        let from = group.len();
        let mut before = Vec::new();
        let (all, by_owner) = (numbered.all, numbered.by_owner.clone());
        let mut refused = Ok(());
        for update in updates {
            match self.number_one(update, sent_ns, arrived_ns, prior, &content, numbered) {
                Ok((snapshot, was)) => {
                    before.push((snapshot.id.clone(), was));
                    group.push(snapshot);
                }
                Err(error) => {
                    refused = Err(error);
                    break;
                }
            }
        }
        if refused.is_err() {
            group.truncate(from);
            (numbered.all, numbered.by_owner) = (all, by_owner);
            for (id, was) in before.into_iter().rev() {
                match was {
                    Some(was) => numbered.newest.insert(id, was),
                    None => numbered.newest.swap_remove(&id),
                };
            }
        }
        refused
    }

    /// One numbered snapshot; `numbered` gives the entity's earlier version in this group.
    fn number_one(
        &self,
        update: Commit,
        sent_ns: u64,
        arrived_ns: u64,
        prior: bool,
        content: &Content,
        numbered: &mut GroupVersions,
    ) -> Result<(Arc<Snapshot>, Option<NewestVersion>), MemoryError> {
        if !prior && content.is_read_only(&update.id) {
            return Err(MemoryError::ReadOnly { id: update.id.to_string() });
        }
        self.check(&update.id, &update.instances)?;
        self.check_time(&update, arrived_ns)?;
        let known = numbered.newest.get(&update.id).copied();
        let newest = if known.is_some() { None } else { content.newest(&update.id) };
        let (version, is_gone) = match (known, newest) {
            (Some(known), _) => known,
            (None, Some(newest)) => (newest.version, newest.is_removed()),
            (None, None) => (self.backing_version(&update.id)?, true),
        };
        expect(&update, if is_gone { 0 } else { version })?;
        let is_new = known.is_none() && newest.is_none();
        let owner = Some(owner(&update.id)).filter(|_| self.limits.shares > 1 && !prior);
        let put = (&update.id, update.instances.as_slice());
        let bytes = self.check_room(content, numbered, put, is_new, owner)?;
        numbered.take(owner, Usage { entities: usize::from(is_new), bytes });
        numbered.newest.insert(update.id.clone(), (version.saturating_add(1), update.instances.is_empty()));
        let snapshot = Snapshot {
            id: update.id,
            version: version.saturating_add(1),
            referenced_ns: update.referenced_ns,
            sent_ns,
            arrived_ns,
            instances: update.instances,
        };
        Ok((Arc::new(snapshot), known))
    }

    fn backing_version(&self, id: &EntityId) -> Result<u64, MemoryError> {
        self.backing.as_ref().map_or(Ok(0), |backing| backing.last_version(id))
    }

    pub(super) fn check(&self, id: &EntityId, instances: &[Instance]) -> Result<(), MemoryError> {
        let schema = self.schemas.get(id.segment());
        for instance in instances {
            check_form(id, instance)?;
            if let Some(schema) = schema {
                schema.check(id, instance)?;
            }
        }
        Ok(())
    }

    fn check_time(&self, update: &Commit, now_ns: u64) -> Result<(), MemoryError> {
        let ahead_ns = update.referenced_ns.saturating_sub(now_ns);
        match self.limits.ahead_ns {
            Some(most) if ahead_ns > most => {
                Err(MemoryError::Future { id: update.id.to_string(), ahead_s: ahead_ns / 1_000_000_000 })
            }
            _ => Ok(()),
        }
    }

    /// How many bytes a snapshot adds, if there is capacity in the whole memory and in its owner's share, if given.
    /// The snapshot that drops out of the entity's history counts as freed. A removal is always accepted.
    pub(super) fn check_room(
        &self,
        content: &Content,
        numbered: &GroupVersions,
        (id, instances): (&EntityId, &[Instance]),
        is_new: bool,
        owner: Option<&str>,
    ) -> Result<u64, MemoryError> {
        let whole = Usage { entities: self.limits.entities, bytes: self.limits.bytes };
        let shares = self.limits.shares;
        let share =
            Usage { entities: whole.entities / shares as usize, bytes: whole.bytes / u64::from(shares) };
        let of_all = Usage { entities: content.len(), bytes: content.bytes() } + numbered.all;
        let of_owner = owner.map(|owner| (content.usage(owner) + numbered.of(owner), share));
        let bytes = bytes_of(id, instances);
        let is_gone = instances.is_empty() && !is_new;
        let mut added = bytes;
        for (held, most) in std::iter::once((of_all, whole)).chain(of_owner) {
            if is_new && held.entities >= most.entities {
                return Err(MemoryError::Full { id: id.to_string(), entities: most.entities as u64 });
            }
            if held.bytes + bytes > most.bytes && !is_gone {
                // Of several updates of an entity in one group, only the first frees a snapshot.
                let is_first = !numbered.newest.contains_key(id);
                let freed = if is_first { content.freed(id, self.limits.history) } else { 0 };
                added = bytes.saturating_sub(freed);
                if held.bytes + added > most.bytes {
                    return Err(MemoryError::TooLarge { id: id.to_string(), bytes, most: most.bytes });
                }
            }
        }
        Ok(added)
    }

    /// Makes snapshots visible, and sends them to subscribers in the same order.
    pub(super) fn put_in(&self, snapshots: Vec<Arc<Snapshot>>) {
        let mut content = self.content.write();
        for snapshot in snapshots {
            content.put_in(&snapshot, self.limits.history);
            // Having no receiver is not an error.
            let _ = self.changes.send(snapshot);
        }
        content.forget_removed();
    }
}

fn answer(to: &Mutex<Option<CommitResult>>, answer: CommitResult) {
    *to.lock() = Some(answer);
}

fn expect(update: &Commit, actual: u64) -> Result<(), MemoryError> {
    match update.expected_version {
        Some(expected) if expected != actual => {
            Err(MemoryError::Conflict { id: update.id.to_string(), expected, actual })
        }
        _ => Ok(()),
    }
}
