//! Working memory and its followers, beyond what the conformance suite tests of every memory.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use armarium_values::{Frame, Value, Vector};
use proptest::prelude::*;

use crate::*;

fn update(name: &str, time: u64, value: i64) -> Commit {
    let id = EntityId::new("Things", "p", name).unwrap();
    Commit::new(id, time, BTreeMap::from([("value".to_owned(), Value::Int(value))]))
}

fn memory(limits: MemoryLimits) -> Arc<WorkingMemory> {
    Arc::new(WorkingMemory::new(Arc::new(|| 0)).with_limits(limits))
}

#[tokio::test(start_paused = true)]
async fn it_conforms() {
    let memory = conformance_tests::typed(WorkingMemory::new(tokio_clock()));
    conformance_tests::check(&memory).await;
}

#[tokio::test]
async fn three_times_are_kept_apart() {
    let now = Arc::new(AtomicU64::new(100));
    let clock = Arc::clone(&now);
    let memory = WorkingMemory::new(Arc::new(move || clock.load(Ordering::Relaxed)));
    memory.enqueue(vec![update("a", 40, 1)], 90).await.unwrap();
    now.store(200, Ordering::Relaxed);
    memory.commit_now(vec![update("a", 41, 1)]).unwrap();
    let times: Vec<_> = memory
        .query_now(&Query::history(Pattern::any()))
        .unwrap()
        .iter()
        .map(|s| (s.referenced_ns, s.sent_ns, s.arrived_ns))
        .collect();
    assert_eq!(times, [(40, 90, 100), (41, 200, 200)]);
}

#[test]
fn history_and_entities_are_bounded() {
    let memory = memory(MemoryLimits { history: 2, entities: 2, ..MemoryLimits::default() });
    for i in 0..5 {
        memory.commit_now(vec![update("a", i, 0)]).unwrap();
    }
    let held: Vec<u64> =
        memory.query_now(&Query::history(Pattern::any())).unwrap().iter().map(|s| s.version).collect();
    assert_eq!(held, [4, 5]);
    let full = memory.commit_now(vec![update("b", 0, 0), update("a", 0, 0), update("c", 0, 0)]);
    assert_eq!(full, Err(MemoryError::Full { id: "Things/p/c".into(), entities: 2 }));
    assert_eq!(memory.len(), 1, "a commit that does not fit changes nothing");
    memory.commit_now(vec![update("b", 0, 0)]).unwrap();
}

#[test]
fn a_backing_that_fails_refuses_the_commit() {
    struct Broken;
    impl Backing for Broken {
        fn last_version(&self, _: &EntityId) -> Result<u64, MemoryError> {
            Ok(41)
        }
        fn holds_any(&self, _: &[Arc<Snapshot>]) -> Result<bool, MemoryError> {
            Ok(false)
        }
        fn take(&self, snapshots: &[Arc<Snapshot>]) -> Result<(), MemoryError> {
            match snapshots.len() {
                1 => Ok(()),
                _ => Err(MemoryError::Store { what: "only one at a time".into() }),
            }
        }
    }
    let memory = WorkingMemory::new(Arc::new(|| 0)).with_backing(Arc::new(Broken));
    assert!(memory.commit_now(vec![update("a", 0, 0), update("b", 0, 0)]).is_err());
    assert!(memory.is_empty());
    assert_eq!(memory.commit_now(vec![update("a", 0, 0).expecting(0)]), Ok(vec![42]), "the backing numbers");
}

#[tokio::test(start_paused = true)]
async fn concurrent_modifications_all_count() {
    let memory = memory(MemoryLimits::default());
    let add = |memory: Arc<WorkingMemory>| async move {
        for _ in 0..50 {
            let id = EntityId::new("Things", "p", "sum").unwrap();
            modify(&*memory, &id, 0, |now| {
                let sum = now.and_then(|s| s.attribute("value")?.as_int()).unwrap_or(0);
                Some(BTreeMap::from([("value".to_owned(), Value::Int(sum + 1))]))
            })
            .await
            .unwrap();
            tokio::task::yield_now().await;
        }
    };
    tokio::join!(add(Arc::clone(&memory)), add(Arc::clone(&memory)), add(Arc::clone(&memory)));
    let sum = memory.latest_now(&EntityId::new("Things", "p", "sum").unwrap()).unwrap();
    assert_eq!((sum.version, sum.attribute("value")), (150, Some(&Value::Int(150))));
}

#[tokio::test(start_paused = true)]
async fn a_follower_resumes_where_it_was() {
    let memory = memory(MemoryLimits { history: 3, ..MemoryLimits::default() });
    let told = BTreeMap::from([("Things/p/a".parse().unwrap(), LastSeen { version: 2, arrived_ns: 0 })]);
    for i in 0..7 {
        memory.commit_now(vec![update("a", i, 0)]).unwrap();
    }
    let mut follower =
        Follower::resume(Arc::<WorkingMemory>::clone(&memory), Pattern::any(), told).await.unwrap();
    let mut seen = Vec::new();
    for change in follower.drain(100).await.unwrap() {
        seen.push(match change {
            Change::New(s) => (s.version, s.version),
            Change::Missed { from, to, .. } => (from, to),
        });
    }
    assert_eq!(seen, [(3, 4), (5, 5), (6, 6), (7, 7)]);
    assert_eq!(follower.drain(1).await.unwrap(), []);
}

/// An operation of the test on both memories.
#[derive(Clone, Debug)]
enum Act {
    Commit(Vec<(u8, bool, Option<u64>)>),
    Drain,
}

fn acts() -> impl Strategy<Value = Vec<Act>> {
    let commit = proptest::collection::vec((0u8..4, any::<bool>(), proptest::option::of(0u64..4)), 1..4);
    let act = prop_oneof![4 => commit.prop_map(Act::Commit), 1 => Just(Act::Drain)];
    proptest::collection::vec(act, 0..60)
}

proptest! {
    /// Compared with a plain map from names to versions: both accept and refuse the same commits, and a follower with
    /// a short backlog reports each version exactly once, as new or missed.
    #[test]
    fn commits_and_followers_agree_with_a_plain_map(acts in acts()) {
        let limits = MemoryLimits { history: 2, backlog: 4, ..MemoryLimits::default() };
        let memory = memory(limits);
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let shared: Arc<dyn Memory> = Arc::<WorkingMemory>::clone(&memory);
        let (mut follower, _) = runtime.block_on(Follower::from_now(shared, Pattern::any())).unwrap();
        let mut model: BTreeMap<u8, (u64, bool)> = BTreeMap::new();
        let mut told: BTreeMap<EntityId, u64> = BTreeMap::new();
        let mut drain = |follower: &mut Follower| {
            for change in runtime.block_on(follower.drain(usize::MAX)).unwrap() {
                let (id, from, to) = match change {
                    Change::New(s) => (s.id.clone(), s.version, s.version),
                    Change::Missed { id, from, to } => (id, from, to),
                };
                let last = told.insert(id, to).unwrap_or(0);
                assert_eq!(from, last + 1);
            }
            told.clone()
        };
        for act in acts {
            let Act::Commit(updates) = act else {
                drain(&mut follower);
                continue;
            };
            let mut next = model.clone();
            let mut fits = true;
            let mut commits = Vec::new();
            for (name, there, expected) in updates {
                let (version, held) = next.get(&name).copied().unwrap_or((0, false));
                fits &= expected.is_none_or(|e| e == if held { version } else { 0 });
                next.insert(name, (version + 1, there));
                let mut commit = update(&format!("e{name}"), version, 0);
                commit.expected_version = expected;
                if !there {
                    commit.instances.clear();
                }
                commits.push(commit);
            }
            prop_assert_eq!(memory.commit_now(commits).is_ok(), fits);
            if fits {
                model = next;
            }
        }
        let told = drain(&mut follower);
        for (name, (version, held)) in model {
            let id = EntityId::new("Things", "p", &format!("e{name}")).unwrap();
            let latest = memory.latest_now(&id).ok().map(|s| s.version);
            prop_assert_eq!(latest, held.then_some(version));
            prop_assert_eq!(told.get(&id).copied(), Some(version));
        }
    }
}

/// Creating and removing names without end does not fill the memory, and changes nothing else.
#[test]
fn names_that_are_gone_are_free_again() {
    let time = std::sync::atomic::AtomicU64::new(0);
    let clock = move || time.fetch_add(1_000_000, std::sync::atomic::Ordering::Relaxed);
    let limits = MemoryLimits { entities: 100_000, shares: 1, ..MemoryLimits::default() };
    let memory = WorkingMemory::new(Arc::new(clock)).with_limits(limits);
    let id = |i: u64| {
        EntityId::new("Things", if i.is_multiple_of(2) { "p" } else { "q" }, &format!("e{i}")).unwrap()
    };
    for i in 0..300_000 {
        memory.commit_now(vec![Commit::new(id(i), i, [("value", Value::Int(1))])]).unwrap();
        if !i.is_multiple_of(1000) {
            memory.commit_now(vec![Commit::removal(id(i), i)]).unwrap();
        }
    }
    assert!((300..90_000).contains(&memory.len()), "{} entities", memory.len());
    let held = memory.query_now(&Query::latest(Pattern::any())).unwrap();
    assert_eq!(held.len(), 300);
    let since = held[299].arrived_ns;
    let later = Query { arrived_since: Some(since), ..Query::history(Pattern::any()) };
    assert!(memory.query_now(&later).unwrap().iter().all(|s| s.arrived_ns >= since));
    assert_eq!(memory.commit_now(vec![Commit::new(id(1), 1, [("value", Value::Int(1))])]), Ok(vec![1]));
    assert_eq!(memory.commit_now(vec![Commit::new(id(1000), 1, [("value", Value::Int(1))])]), Ok(vec![2]));
    memory.query_now(&Query::latest(Pattern::any())).unwrap().iter().for_each(|s| {
        assert_eq!(memory.latest_now(&s.id).as_ref(), Ok(s));
    });
}

/// A thing with a class and a place in one of two frames; some are removed.
fn placed() -> impl Strategy<Value = (u8, u8, bool, [f64; 3], bool)> {
    (0..30u8, 0..3u8, any::<bool>(), prop::array::uniform3(-2.0..2.0f64), prop::bool::weighted(0.1))
}

#[test]
fn what_expires_is_removed_unless_it_is_written_again() {
    let now = Arc::new(AtomicU64::new(0));
    let clock = Arc::clone(&now);
    let memory = WorkingMemory::new(Arc::new(move || clock.load(Ordering::Relaxed)));
    let until = |name: &str, expires_ns: Option<i64>| {
        let id = EntityId::new("Things", "p", name).unwrap();
        let expires = expires_ns.map(|ns| ("expires_ns".to_owned(), Value::Int(ns)));
        Commit::new(id, 0, expires.into_iter().collect::<BTreeMap<_, _>>())
    };
    memory
        .commit_now(vec![until("a", Some(10)), until("b", Some(20)), until("c", None), until("d", Some(10))])
        .unwrap();
    memory.commit_now(vec![until("d", Some(30))]).unwrap();
    let left = || -> Vec<String> {
        let all = memory.query_now(&Query::latest(Pattern::any())).unwrap();
        all.iter().map(|snapshot| snapshot.id.entity().to_owned()).collect()
    };
    for (time, removed, expected) in
        [(9, 0, "abcd"), (10, 1, "bcd"), (10, 0, "bcd"), (25, 1, "cd"), (30, 1, "c")]
    {
        now.store(time, Ordering::Relaxed);
        assert_eq!(memory.remove_expired(), Ok(removed), "at {time}");
        assert_eq!(left().concat(), expected, "at {time}");
    }
}

proptest! {
    /// What is found by class or place is what looking at everything finds.
    #[test]
    fn an_index_changes_no_answer(
        commits in prop::collection::vec(placed(), 1..80),
        center in prop::array::uniform3(-2.0..2.0f64),
        radius in 0.0..1.5f64,
        count in 0..6usize,
    ) {
        let memory = memory(MemoryLimits::default());
        for (time, (name, class, root, place, removed)) in (1..).zip(commits) {
            let id = EntityId::new("Things", "p", &format!("e{name}")).unwrap();
            let frame = if root { Frame::root() } else { Frame("camera".into()) };
            let data = [
                ("class", Value::String(["cup", "plate", "fork"][usize::from(class)].into())),
                ("position", Value::Vector(Vector { frame, components: place })),
            ];
            let commit = if removed { Commit::removal(id, time) } else { Commit::new(id, time, data) };
            memory.commit_now(vec![commit]).unwrap();
        }
        let all = memory.query_now(&Query::latest(Pattern::any())).unwrap();
        let frame = Frame::root();
        let regions = [
            None,
            Some(SpatialRegion::Within { frame: frame.clone(), of: center, radius }),
            Some(SpatialRegion::Box { frame: frame.clone(), min: center, max: center.map(|x| x + radius) }),
            Some(SpatialRegion::Nearest { frame, to: center, count }),
        ];
        for region in regions {
            for filter in [None, Some("class == 'cup'"), Some("'plate' == class && position.z > 0.0"), Some("class != 'cup'")] {
                let query = Query { region: region.clone(), filter: filter.map(str::to_owned), ..Query::latest(Pattern::any()) };
                let asked = query.check().unwrap();
                let expected = asked.finish(all.iter().filter(|snapshot| asked.fits(snapshot)).cloned().collect());
                prop_assert_eq!(memory.query_now(&query).unwrap(), expected, "{:?}", query);
            }
        }
    }
}

/// An answer that ends early says where, and goes on there; one that cannot go on is refused.
#[test]
fn an_answer_says_what_was_not_looked_at() {
    let memory = WorkingMemory::new(Arc::new(|| 0));
    memory.commit_now((0..1000).map(|n| update(&format!("e{n:03}"), 0, n)).collect()).unwrap();
    let mut query = Query::latest(Pattern::any()).filter("value >= 500");
    let (mut found, mut parts) = (0, 0);
    loop {
        let left = std::cell::Cell::new(3);
        let goes_on = || left.replace(left.get() - 1) > 1;
        let answer = memory.query_while(&query, &goes_on).unwrap();
        found += answer.snapshots.len();
        parts += 1;
        let Some(next) = answer.next else { break };
        assert!(next > query.after.replace(next.clone()).unwrap_or(Cursor::behind(&update("e000", 0, 0).id)));
    }
    assert!(found == 500 && parts > 10, "{found} in {parts} parts");
    let nearest = SpatialRegion::Nearest { frame: Frame::root(), to: [0.0; 3], count: 3 };
    let refused = memory.query_while(&Query::latest(Pattern::any()).region(nearest), &|| false).unwrap_err();
    assert!(refused.to_string().contains("was looked at"), "{refused}");
}
