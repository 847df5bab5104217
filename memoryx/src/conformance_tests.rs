//! What every memory must do, whatever its implementation: one suite for memory in process and over Zenoh.

use std::collections::BTreeMap;

use armarium_values::{Type, Value};

use crate::entity::{Commit, EntityId, Snapshot};
use crate::error::MemoryError;
use crate::memory::{Memory, modify};
use crate::query::{Pattern, Query, Times};
use crate::schema::SegmentSchema;
use crate::working::WorkingMemory;

/// The core segment that the suite uses. It must be empty, and have no other user during the check.
const SEGMENT: &str = "Conformance";
/// One in which `subject` must be a text.
pub(crate) const TYPED: &str = "Typed";

/// A memory that checks [`TYPED`].
pub(crate) fn typed(memory: WorkingMemory) -> WorkingMemory {
    memory.with_segments([SegmentSchema::new(TYPED, "").required("subject", Type::String, "a text")])
}

fn id(name: &str) -> EntityId {
    EntityId::new(SEGMENT, "suite", name).unwrap()
}

fn update(name: &str, time: u64, value: i64) -> Commit {
    Commit::new(id(name), time, [("value", Value::Int(value))])
}

fn value(snapshot: &Snapshot) -> Option<i64> {
    snapshot.attribute("value").and_then(Value::as_int)
}

fn conflict(name: &str, expected: u64, actual: u64) -> MemoryError {
    MemoryError::Conflict { id: id(name).to_string(), expected, actual }
}

/// Runs the whole suite; its parts build on each other.
pub(crate) async fn check(memory: &dyn Memory) {
    what_is_committed_is_there(memory).await;
    a_commit_is_whole_or_nothing(memory).await;
    an_expected_version_is_compared(memory).await;
    removal_keeps_the_count(memory).await;
    queries_take_what_they_ask_for(memory).await;
    times_of_two_clocks_are_refused(memory).await;
    subscribers_hear_everything_in_order(memory).await;
    modification_sees_the_newest(memory).await;
    bad_commits_are_refused(memory).await;
}

async fn what_is_committed_is_there(memory: &dyn Memory) {
    assert_eq!(memory.latest(&id("a")).await, Err(MemoryError::NotFound { id: id("a").to_string() }));
    let sent = update("a", 5, 1).with_confidence(0.25);
    assert_eq!(memory.commit(vec![sent.clone()]).await, Ok(vec![1]));
    let found = memory.latest(&id("a")).await.unwrap();
    assert_eq!((found.version, found.referenced_ns, &found.instances), (1, 5, &sent.instances));
    assert_eq!(memory.commit(vec![update("a", 6, 2)]).await, Ok(vec![2]));
    assert_eq!(value(&memory.latest(&id("a")).await.unwrap()), Some(2));
}

async fn a_commit_is_whole_or_nothing(memory: &dyn Memory) {
    let bad = memory.commit(vec![update("b", 1, 1), update("a", 7, 3).expecting(9)]).await;
    assert_eq!(bad, Err(conflict("a", 9, 2)));
    assert!(memory.latest(&id("b")).await.is_err());
    let good = memory.commit(vec![update("b", 1, 1), update("a", 7, 3), update("b", 2, 2)]).await;
    assert_eq!(good, Ok(vec![1, 3, 2]));
    assert_eq!(memory.commit(Vec::new()).await, Ok(Vec::new()));
}

async fn an_expected_version_is_compared(memory: &dyn Memory) {
    assert_eq!(memory.commit(vec![update("c", 1, 1).expecting(0)]).await, Ok(vec![1]));
    assert_eq!(memory.commit(vec![update("c", 1, 1).expecting(0)]).await, Err(conflict("c", 0, 1)));
    let next = memory.commit(vec![update("c", 1, 2).expecting(1), update("c", 1, 3).expecting(2)]).await;
    assert_eq!(next, Ok(vec![2, 3]));
}

async fn removal_keeps_the_count(memory: &dyn Memory) {
    assert_eq!(memory.commit(vec![Commit::removal(id("c"), 4)]).await, Ok(vec![4]));
    assert!(memory.latest(&id("c")).await.is_err());
    let segment = memory.segment(SEGMENT).await.unwrap();
    assert_eq!(segment.iter().map(|s| s.id.entity()).collect::<Vec<_>>(), ["a", "b"]);
    assert_eq!(memory.commit(vec![update("c", 5, 9).expecting(0)]).await, Ok(vec![5]));
}

async fn queries_take_what_they_ask_for(memory: &dyn Memory) {
    let c = || Pattern::entity(&id("c"));
    for (query, expected) in [
        (Query::history(c()), &[("c", 1), ("c", 2), ("c", 3), ("c", 4), ("c", 5)][..]),
        (Query::history(c()).limit(2), &[("c", 4), ("c", 5)]),
        (Query::latest(c()).times(Times::At(4)), &[]),
        (Query::latest(c()).times(Times::Before(4)), &[("c", 3)]),
        (Query::latest(c()).times(Times::Between(4, 5)), &[("c", 4), ("c", 5)]),
        (Query::latest(Pattern::segment(SEGMENT).of_provider("suite")), &[("a", 3), ("b", 2), ("c", 5)]),
        (Query::latest(Pattern::segment(SEGMENT).of_provider("nobody")), &[]),
        (Query::latest(Pattern::segment("NoSuchSegment")), &[]),
    ] {
        let found = memory.query(&query).await.unwrap();
        let found: Vec<_> = found.iter().map(|s| (s.id.entity(), s.version)).collect();
        assert_eq!(found, expected, "{query:?}");
    }
}

async fn times_of_two_clocks_are_refused(memory: &dyn Memory) {
    let day = 1_800_000_000_000_000_000;
    let refused =
        |query: Query| async move { matches!(memory.query(&query).await, Err(MemoryError::Query { .. })) };
    let c = || Query::latest(Pattern::entity(&id("c")));
    assert!(refused(c().times(Times::At(day))).await, "`c` is of a run");
    assert!(refused(c().times(Times::Before(day)).with_long_term()).await);
    assert!(refused(c().times(Times::Between(day, u64::MAX))).await);
    assert!(refused(c().times(Times::Between(4, day))).await, "from one clock to the other");
    assert_eq!(memory.query(&c().times(Times::Between(0, u64::MAX))).await.unwrap().len(), 5);
}

async fn subscribers_hear_everything_in_order(memory: &dyn Memory) {
    let mut changes = memory.subscribe(&Pattern::segment(SEGMENT)).await.unwrap();
    for i in 0..20 {
        memory.commit(vec![update("d", i, 0), update("e", i, 0)]).await.unwrap();
    }
    memory.commit(vec![Commit::removal(id("d"), 20)]).await.unwrap();
    let mut heard: BTreeMap<EntityId, Vec<u64>> = BTreeMap::new();
    let mut is_last = false;
    while !is_last {
        let snapshot = changes.recv().await.unwrap();
        if ["d", "e"].contains(&snapshot.id.entity()) {
            heard.entry(snapshot.id.clone()).or_default().push(snapshot.version);
        }
        is_last = snapshot.is_removed();
    }
    assert_eq!(heard, BTreeMap::from([(id("d"), (1..=21).collect()), (id("e"), (1..=20).collect())]));
}

async fn modification_sees_the_newest(memory: &dyn Memory) {
    for expected in 1..=3 {
        let add = |now: Option<&Snapshot>| {
            let count = now.and_then(value).unwrap_or(0);
            Some(BTreeMap::from([("value".to_owned(), Value::Int(count + 1))]))
        };
        assert_eq!(modify(memory, &id("f"), 1, add).await, Ok(expected));
    }
    assert_eq!(value(&memory.latest(&id("f")).await.unwrap()), Some(3));
    assert_eq!(modify(memory, &id("f"), 1, |_| None).await, Ok(3));
}

async fn bad_commits_are_refused(memory: &dyn Memory) {
    let unsure = memory.commit(vec![update("g", 1, 1).with_confidence(f64::NAN)]).await;
    assert_eq!(unsure, Err(MemoryError::Confidence { id: id("g").to_string() }));
    let relation = EntityId::new(TYPED, "suite", "bad").unwrap();
    let typed = memory.commit(vec![Commit::new(relation, 0, [("subject", Value::Int(1))])]).await;
    assert!(
        matches!(&typed, Err(MemoryError::Schema { attribute, .. }) if attribute == "subject"),
        "{typed:?}"
    );
}
