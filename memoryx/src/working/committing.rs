//! How commits are made: all requests that wait are numbered, stored together by the backing, and made visible. No reader
//! sees a snapshot that the backing has not stored.
//!
//! With a backing, one thread does all this, so that no other thread waits for a disk. Without one, it takes
//! microseconds, and whoever commits does it.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, mpsc};

use super::content::{Content, Usage, bytes_of, owner};
use super::{CommitResult, Core};
use crate::awaited_thread::AwaitedThread;
use crate::changes::PublishedSnapshot;
use crate::entity::{Commit, EntityId, Instance, Snapshot};
use crate::error::MemoryError;
use crate::query::{Pattern, Query};
use crate::schema::check_form;

/// Most requests that are committed together.
const MAX_GROUP: usize = 1024;

/// An arrival time so far ahead of the clock, ns, is no clock's that was set back.
const MAX_AHEAD_NS: u64 = 3_600_000_000_000;

/// Updates that are committed all or none.
pub(super) struct Request {
    pub(super) updates: Vec<Commit>,
    pub(super) sent_ns: u64,
    /// Whether they are prior knowledge.
    pub(super) prior: bool,
}

/// Takes the result of a request.
pub(super) type Answer = Box<dyn FnOnce(CommitResult) + Send>;

/// The thread that commits for a memory with a backing. Dropping it waits until it has answered everything.
pub(super) struct CommittingThread {
    requests: mpsc::Sender<(Request, Answer)>,
    /// Dropped after `requests` (the order of the fields), which ends it.
    _thread: AwaitedThread,
}

impl CommittingThread {
    pub(super) fn start(core: Arc<Core>) -> Result<Self, MemoryError> {
        let (requests, waiting) = mpsc::channel::<(Request, Answer)>();
        // In virtual time, whoever commits waits on his own thread, so that the clock waits with him.
        let thread = AwaitedThread::start("memory", "no thread for it", move || {
            while let Ok(first) = waiting.recv() {
                let more = waiting.try_iter().take(MAX_GROUP - 1);
                let (requests, answers): (Vec<_>, Vec<_>) = std::iter::once(first).chain(more).unzip();
                let results = core.commit_together(requests);
                answers.into_iter().zip(results).for_each(|(answer, result)| answer(result));
            }
        });
        Ok(Self { requests, _thread: thread? })
    }

    pub(super) fn commit(&self, request: Request, answer: Answer) {
        // If the thread has ended, the answer is dropped here, which its receiver notices.
        let _ = self.requests.send((request, answer));
    }
}

/// What only whoever commits knows.
#[derive(Default)]
pub(super) struct WriterState {
    /// The last arrival time, ns.
    last_arrival: u64,
    /// The last versions that were given to entities, where they are not in the content: an earlier process gave them.
    pub(super) given: BTreeMap<EntityId, u64>,
    /// The snapshots of a failed write, of which it is unknown whether the backing has them.
    unsettled: Vec<Arc<Snapshot>>,
}

impl WriterState {
    /// Notes an arrival time, ns, of an earlier process, unless it makes no sense at `now_ns`.
    pub(super) fn note_arrival(&mut self, arrived_ns: u64, now_ns: u64) {
        if arrived_ns < now_ns.saturating_add(MAX_AHEAD_NS) {
            self.last_arrival = self.last_arrival.max(arrived_ns);
        }
    }
}

impl Core {
    /// Commits requests together. Returns the result of each.
    pub(super) fn commit_together(&self, requests: Vec<Request>) -> Vec<CommitResult> {
        let mut writer = self.writer.lock();
        if let Err(error) = self.settle(&mut writer) {
            return requests.iter().map(|_| Err(error.clone())).collect();
        }
        // Arrival times tell the order of commits, whatever the clock does.
        writer.last_arrival = self.now_ns().max(writer.last_arrival.saturating_add(1));
        let mut next = Content::clone(&self.content());
        let mut group = Vec::new();
        let number = |request| {
            let from = group.len();
            self.number(request, &writer, &mut next, &mut group).map(|()| from..group.len())
        };
        let numbered: Vec<_> = requests.into_iter().map(number).collect();
        if numbered.iter().all(Result::is_err) {
            return numbered.into_iter().map(|refused| refused.map(|_| Vec::new())).collect();
        }
        let stored = self.backing.as_ref().filter(|_| !group.is_empty()).map_or(Ok(()), |b| b.take(&group));
        if stored.is_ok() {
            self.publish(next, &group);
        } else {
            writer.unsettled.clone_from(&group);
            // If that is not possible now, the next commit does it.
            let _ = self.settle(&mut writer);
        }
        let versions = |range: Range<usize>| {
            stored.clone().map(|()| group.get(range).unwrap_or_default().iter().map(|s| s.version).collect())
        };
        numbered.into_iter().map(|range| range.and_then(versions)).collect()
    }

    /// Takes over the snapshots of a failed write if the backing has them after all, so that both agree.
    fn settle(&self, writer: &mut WriterState) -> Result<(), MemoryError> {
        let Some(backing) = self.backing.as_ref().filter(|_| !writer.unsettled.is_empty()) else {
            return Ok(());
        };
        if backing.holds_any(&writer.unsettled)? {
            let mut next = Content::clone(&self.content());
            writer.unsettled.iter().for_each(|snapshot| next.put_in(snapshot, self.limits.history));
            self.publish(next, &writer.unsettled);
        }
        writer.unsettled.clear();
        Ok(())
    }

    /// Makes content visible, and sends its new snapshots to subscribers in the same order.
    pub(super) fn publish(&self, next: Content, new: &[Arc<Snapshot>]) {
        let before = std::mem::replace(&mut *self.content.write(), Arc::new(next));
        for snapshot in new {
            // Having no receiver is not an error.
            let _ = self.changes.send(PublishedSnapshot::of(snapshot));
        }
        drop(before);
    }

    /// Checks updates, and adds numbered snapshots of them to `next` and `group`, which are unchanged after an error.
    fn number(
        &self,
        request: Request,
        writer: &WriterState,
        next: &mut Content,
        group: &mut Vec<Arc<Snapshot>>,
    ) -> Result<(), MemoryError> {
        let Request { updates, sent_ns, prior } = request;
        let from = group.len();
        // A single update changes nothing when it is refused.
        let before = (updates.len() > 1).then(|| next.clone());
        for update in updates {
            let read = self.read_in(&update.id, next);
            match read.and_then(|()| self.number_one(update, sent_ns, prior, writer, next)) {
                Ok(snapshot) => {
                    next.put_in(&snapshot, self.limits.history);
                    group.push(snapshot);
                }
                Err(error) => {
                    group.truncate(from);
                    *next = before.unwrap_or_else(|| std::mem::take(next));
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    /// Takes an entity's newest snapshot over from the backing, if it may be there only.
    fn read_in(&self, id: &EntityId, next: &mut Content) -> Result<(), MemoryError> {
        if next.is_partial && next.newest(id).is_none() {
            let found = self.backed(&Query { removed: true, ..Query::latest(Pattern::entity(id)) })?;
            let fitting = found.into_iter().find(|snapshot| self.fits(snapshot, next).is_ok());
            fitting.inspect(|snapshot| next.restore(snapshot, self.limits.history));
        }
        Ok(())
    }

    /// What the backing answers.
    pub(super) fn backed(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let archive = self.backing.as_ref().and_then(|backing| backing.archive());
        archive.map_or(Ok(Vec::new()), |archive| archive.recall(query))
    }

    /// Checks that a snapshot from a store is valid, and that there is room for it.
    pub(super) fn fits(&self, snapshot: &Snapshot, held: &Content) -> Result<(), MemoryError> {
        snapshot.check_version()?;
        self.check(&snapshot.id, &snapshot.instances)?;
        let is_new = held.newest(&snapshot.id).is_none();
        self.check_room(held, &snapshot.id, &snapshot.instances, is_new, None)
    }

    fn number_one(
        &self,
        update: Commit,
        sent_ns: u64,
        prior: bool,
        writer: &WriterState,
        next: &Content,
    ) -> Result<Arc<Snapshot>, MemoryError> {
        if !prior && next.is_read_only(&update.id) {
            return Err(MemoryError::ReadOnly { id: update.id.to_string() });
        }
        self.check(&update.id, &update.instances)?;
        let ahead_ns = update.referenced_ns.saturating_sub(writer.last_arrival);
        if self.limits.ahead_ns.is_some_and(|most| ahead_ns > most) {
            let (id, ahead_s) = (update.id.to_string(), ahead_ns / 1_000_000_000);
            return Err(MemoryError::Future { id, ahead_s });
        }
        let newest = next.newest(&update.id);
        let backed = || self.backing.as_ref().map_or(Ok(0), |b| b.last_version(&update.id));
        let (version, is_gone) = match newest {
            Some(newest) => (newest.version, newest.is_removed()),
            None => (backed()?, true),
        };
        let actual = if is_gone { 0 } else { version };
        if let Some(expected) = update.expected_version.filter(|expected| *expected != actual) {
            return Err(MemoryError::Conflict { id: update.id.to_string(), expected, actual });
        }
        let given =
            if next.is_partial { backed()? } else { writer.given.get(&update.id).copied().unwrap_or(0) };
        let version = version.max(given);
        let owner = Some(owner(&update.id)).filter(|_| self.limits.shares > 1 && !prior);
        self.check_room(next, &update.id, &update.instances, newest.is_none(), owner)?;
        let Commit { id, referenced_ns, instances, .. } = update;
        let (version, arrived_ns) = (version.saturating_add(1), writer.last_arrival);
        Ok(Arc::new(Snapshot { id, version, referenced_ns, sent_ns, arrived_ns, instances }))
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

    /// Checks that there is capacity for a snapshot in the whole memory and in its owner's share, if given. The snapshot
    /// that drops out of the entity's history counts as freed. A removal is always accepted.
    pub(super) fn check_room(
        &self,
        held: &Content,
        id: &EntityId,
        instances: &[Instance],
        is_new: bool,
        owner: Option<&str>,
    ) -> Result<(), MemoryError> {
        if instances.is_empty() && !is_new {
            return Ok(());
        }
        let limit = |entities, bytes| Usage { entities, bytes, ..Usage::default() };
        let whole = limit(self.limits.entities, self.limits.bytes);
        let shares = self.limits.shares;
        let share = limit(whole.entities / shares as usize, whole.bytes / u64::from(shares));
        let of_owner = owner.map(|owner| (held.usage(owner), share));
        let bytes = bytes_of(id, instances);
        for (taken, most) in std::iter::once((held.all, whole)).chain(of_owner) {
            if is_new && taken.entities >= most.entities {
                return Err(MemoryError::Full { id: id.to_string(), entities: most.entities as u64 });
            }
            let is_over = taken.bytes + bytes > most.bytes;
            if is_over && taken.bytes + bytes > most.bytes + held.freed(id, self.limits.history) {
                return Err(MemoryError::TooLarge { id: id.to_string(), bytes, most: most.bytes });
            }
        }
        Ok(())
    }
}
