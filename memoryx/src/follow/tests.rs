//! A follower of a memory that changes during a read.

use std::sync::atomic::{AtomicU64, Ordering};

use armarium_values::Value;
use async_trait::async_trait;
use parking_lot::Mutex;

use super::*;
use crate::entity::Commit;
use crate::working::{MemoryLimits, WorkingMemory};

/// A memory that changes after each of the first queries.
struct Busy {
    memory: WorkingMemory,
    after: Mutex<VecDeque<Vec<Commit>>>,
}

#[async_trait]
impl Memory for Busy {
    async fn commit(&self, updates: Vec<Commit>) -> Result<Vec<u64>, MemoryError> {
        self.memory.commit_now(updates)
    }

    async fn query(&self, query: &Query) -> Result<Vec<Arc<Snapshot>>, MemoryError> {
        let found = self.memory.query_now(query);
        let updates = self.after.lock().pop_front().unwrap_or_default();
        updates.into_iter().for_each(|update| drop(self.memory.commit_now(vec![update]).unwrap()));
        found
    }

    async fn subscribe(&self, pattern: &Pattern) -> Result<Changes, MemoryError> {
        Ok(self.memory.changes(pattern))
    }
}

fn update(entity: usize) -> Commit {
    let id = EntityId::new("Things", "p", &format!("e{entity:05}")).unwrap();
    Commit::new(id, 1, [("value", Value::Int(1))])
}

/// A change in a part that was already read, while a later part is read; the queue overflows too.
#[tokio::test]
async fn what_changes_while_it_is_read_is_not_missed() {
    let time = AtomicU64::new(0);
    let memory = WorkingMemory::new(Arc::new(move || time.fetch_add(1, Ordering::Relaxed) + 1));
    let memory = memory.with_limits(MemoryLimits { backlog: 2, ..MemoryLimits::default() });
    let (first, last) = (0, PAGE_SIZE + 10);
    let overtaking = (1..10).map(update).collect();
    let after = VecDeque::from([vec![update(first), update(last)], overtaking]);
    let memory = Arc::new(Busy { memory, after: Mutex::new(after) });
    let shared = Arc::<Busy>::clone(&memory);
    let mut follower = Follower::from_start(shared, Pattern::any()).await.unwrap();
    memory.memory.commit_now((first..=last).map(update).collect()).unwrap();

    let mut told = BTreeMap::new();
    loop {
        let changes = follower.drain(PAGE_SIZE).await.unwrap();
        if changes.is_empty() {
            break;
        }
        for change in changes {
            let Change::New(snapshot) = change else { panic!("{change:?}") };
            let before = told.insert(snapshot.id.clone(), snapshot.version).unwrap_or(0);
            assert_eq!(snapshot.version, before + 1, "{}", snapshot.id);
        }
    }
    let newest = memory.memory.query_now(&Query::latest(Pattern::any())).unwrap();
    let newest: BTreeMap<_, _> = newest.iter().map(|s| (s.id.clone(), s.version)).collect();
    assert_eq!(told[&update(first).id], 2);
    assert_eq!(told, newest);
}

/// A memory that restarted without its versions counts from 1: its snapshots are new.
#[tokio::test]
async fn a_memory_that_begins_anew_is_followed_on() {
    for (history, expected) in [(32, "1 2 3 4"), (2, "missed 1-1 2 3 4")] {
        let time = AtomicU64::new(100);
        let memory = WorkingMemory::new(Arc::new(move || time.fetch_add(1, Ordering::Relaxed)));
        let memory = Arc::new(memory.with_limits(MemoryLimits { history, ..MemoryLimits::default() }));
        let told = BTreeMap::from([(update(0).id, LastSeen { version: 5, arrived_ns: 99 })]);
        let shared = Arc::<WorkingMemory>::clone(&memory);
        for _ in 0..3 {
            memory.commit_now(vec![update(0)]).unwrap();
        }
        let mut follower = Follower::resume(shared, Pattern::any(), told).await.unwrap();
        memory.commit_now(vec![update(0)]).unwrap();
        let words = |change| match change {
            Change::New(snapshot) => snapshot.version.to_string(),
            Change::Missed { from, to, .. } => format!("missed {from}-{to}"),
        };
        let told: Vec<_> = follower.drain(100).await.unwrap().into_iter().map(words).collect();
        assert_eq!(told.join(" "), expected);
    }
}

/// Large snapshots that nobody has taken wait only as long as the memory has them; who missed some is told, and reads the rest.
#[tokio::test]
async fn what_waits_for_a_slow_subscriber_is_bounded_in_bytes() {
    let memory = WorkingMemory::new(Arc::new(|| 0));
    let memory = Arc::new(memory.with_limits(MemoryLimits { history: 2, ..MemoryLimits::default() }));
    let mut changes = memory.changes(&Pattern::any());
    let (mut follower, _) = Follower::from_now(memory.clone(), Pattern::any()).await.unwrap();
    let id: EntityId = "S/p/image".parse().unwrap();
    let mut weak = Vec::new();
    for _ in 0..10 {
        let frame = Commit::new(id.clone(), 1, [("data", Value::Bytes(vec![7; 100_000]))]);
        memory.commit_now(vec![frame]).unwrap();
        weak.push(Arc::downgrade(&memory.latest_now(&id).unwrap()));
    }
    let held = weak.iter().filter(|snapshot| snapshot.upgrade().is_some()).count();
    assert_eq!(held, 2, "what memory has forgotten is not kept for subscribers");
    assert_eq!(changes.recv().await, Err(RecvError::Lagged(1)));
    let told = follower.drain(100).await.unwrap();
    assert_eq!(told.first(), Some(&Change::Missed { id: id.clone(), from: 1, to: 8 }));
    assert_eq!(told.len(), 3);
}

/// Names that come and go: a follower remembers those that the memory remembers.
#[tokio::test]
async fn a_follower_forgets_the_names_that_are_gone() {
    let now = Arc::new(AtomicU64::new(0));
    let clock = Arc::clone(&now);
    let memory = Arc::new(WorkingMemory::new(Arc::new(move || clock.load(Ordering::Relaxed))));
    let mut follower = Follower::from_start(memory.clone(), Pattern::any()).await.unwrap();
    for minute in 0..60_u64 {
        now.store(minute * 61_000_000_000, Ordering::Relaxed);
        for n in 0..1000 {
            let id: EntityId = format!("S/p/e{minute}-{n}").parse().unwrap();
            memory.commit_now(vec![Commit::new(id.clone(), 1, [])]).unwrap();
            memory.commit_now(vec![Commit::removal(id, 2)]).unwrap();
        }
        let told = follower.drain(usize::MAX).await.unwrap();
        assert_eq!(told.len(), 2000);
    }
    let remembered = follower.reported.len();
    assert!(remembered <= 17_000, "{remembered} of {}", memory.len());
}
