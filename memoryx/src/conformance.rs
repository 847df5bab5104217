//! What every memory must do, whatever its implementation: one suite for memory in process and over Zenoh.
//!
//! ```ignore
//! conformance::check(&*memory).await?;
//! ```
//! The core segment `Conformance` must be empty, and have no other user during the check.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Arc;

use armarium_values::Value;
use tokio::sync::broadcast;

use crate::entity::{Commit, EntityId, Instance, Snapshot};
use crate::error::MemoryError;
use crate::memory::{Memory, modify};
use crate::query::{Pattern, Query, Times};

/// The core segment that the suite uses.
pub const SEGMENT: &str = "Conformance";

/// Runs the whole suite.
///
/// # Errors
/// A description of the first difference from the expected behaviour.
pub async fn check(memory: &dyn Memory) -> Result<(), String> {
    what_is_committed_is_there(memory).await?;
    a_commit_is_whole_or_nothing(memory).await?;
    an_expected_version_is_compared(memory).await?;
    removal_keeps_the_count(memory).await?;
    queries_take_what_they_ask_for(memory).await?;
    subscribers_hear_everything_in_order(memory).await?;
    modification_sees_the_newest(memory).await?;
    bad_commits_are_refused(memory).await
}

fn id(name: &str) -> EntityId {
    EntityId::new(SEGMENT, "suite", name).expect("the suite's names are names")
}

fn update(name: &str, time: u64, value: i64) -> Commit {
    Commit::new(id(name), time, BTreeMap::from([("value".to_owned(), Value::Int(value))]))
}

fn value(snapshot: &Snapshot) -> Option<i64> {
    snapshot.attribute("value").and_then(Value::as_int)
}

fn same<T: PartialEq + Debug>(what: &str, found: &T, expected: &T) -> Result<(), String> {
    if found == expected { Ok(()) } else { Err(format!("{what}: found {found:?}, expected {expected:?}")) }
}

fn worked<T>(what: &str, result: Result<T, MemoryError>) -> Result<T, String> {
    result.map_err(|error| format!("{what}: {error}"))
}

async fn what_is_committed_is_there(memory: &dyn Memory) -> Result<(), String> {
    let what = "what is committed is there";
    same(what, &memory.latest(&id("a")).await, &Err(MemoryError::NotFound { id: id("a").to_string() }))?;
    let sent = update("a", 5, 1).with_confidence(0.25);
    same(what, &worked(what, memory.commit(vec![sent.clone()]).await)?, &vec![1])?;
    let found = worked(what, memory.latest(&id("a")).await)?;
    same(what, &(found.version, found.referenced_ns, &found.instances), &(1, 5, &sent.instances))?;
    same(what, &worked(what, memory.commit(vec![update("a", 6, 2)]).await)?, &vec![2])?;
    same(what, &value(&*worked(what, memory.latest(&id("a")).await)?), &Some(2))
}

async fn a_commit_is_whole_or_nothing(memory: &dyn Memory) -> Result<(), String> {
    let what = "a commit is whole or nothing";
    let bad = memory.commit(vec![update("b", 1, 1), update("a", 7, 3).expecting(9)]).await;
    let conflict = MemoryError::Conflict { id: id("a").to_string(), expected: 9, actual: 2 };
    same(what, &bad, &Err(conflict))?;
    same(what, &memory.latest(&id("b")).await.is_err(), &true)?;
    let good = memory.commit(vec![update("b", 1, 1), update("a", 7, 3), update("b", 2, 2)]).await;
    same(what, &worked(what, good)?, &vec![1, 3, 2])?;
    same(what, &worked(what, memory.commit(Vec::new()).await)?, &Vec::new())
}

async fn an_expected_version_is_compared(memory: &dyn Memory) -> Result<(), String> {
    let what = "an expected version is compared";
    let new = memory.commit(vec![update("c", 1, 1).expecting(0)]).await;
    same(what, &worked(what, new)?, &vec![1])?;
    let again = memory.commit(vec![update("c", 1, 1).expecting(0)]).await;
    let conflict = MemoryError::Conflict { id: id("c").to_string(), expected: 0, actual: 1 };
    same(what, &again, &Err(conflict))?;
    let next = memory.commit(vec![update("c", 1, 2).expecting(1), update("c", 1, 3).expecting(2)]).await;
    same(what, &worked(what, next)?, &vec![2, 3])
}

async fn removal_keeps_the_count(memory: &dyn Memory) -> Result<(), String> {
    let what = "removal keeps the count";
    let gone = memory.commit(vec![Commit::removal(id("c"), 4)]).await;
    same(what, &worked(what, gone)?, &vec![4])?;
    same(what, &memory.latest(&id("c")).await.is_err(), &true)?;
    let segment = worked(what, memory.segment(SEGMENT).await)?;
    let names: Vec<&str> = segment.iter().map(|s| s.id.entity()).collect();
    same(what, &names, &vec!["a", "b"])?;
    let back = memory.commit(vec![update("c", 5, 9).expecting(0)]).await;
    same(what, &worked(what, back)?, &vec![5])
}

async fn queries_take_what_they_ask_for(memory: &dyn Memory) -> Result<(), String> {
    let what = "queries take what they ask for";
    let ask = async |query: Query| -> Result<Vec<(String, u64)>, String> {
        let found = worked(what, memory.query(&query).await)?;
        Ok(found.iter().map(|s| (s.id.entity().to_owned(), s.version)).collect())
    };
    let versions = |name: &str, versions: &[u64]| -> Vec<(String, u64)> {
        versions.iter().map(|v| (name.to_owned(), *v)).collect()
    };
    let c = Pattern::entity(&id("c"));
    same(what, &ask(Query::history(c.clone())).await?, &versions("c", &[1, 2, 3, 4, 5]))?;
    same(what, &ask(Query::history(c.clone()).limit(2)).await?, &versions("c", &[4, 5]))?;
    same(what, &ask(Query::latest(c.clone()).times(Times::At(4))).await?, &Vec::new())?;
    same(what, &ask(Query::latest(c.clone()).times(Times::Before(4))).await?, &versions("c", &[3]))?;
    same(what, &ask(Query::latest(c).times(Times::Between(4, 5))).await?, &versions("c", &[4, 5]))?;
    let latest = ask(Query::latest(Pattern::segment(SEGMENT).of_provider("suite"))).await?;
    same(what, &latest, &[versions("a", &[3]), versions("b", &[2]), versions("c", &[5])].concat())?;
    same(what, &ask(Query::latest(Pattern::segment(SEGMENT).of_provider("nobody"))).await?, &Vec::new())?;
    same(what, &ask(Query::latest(Pattern::segment("NoSuchSegment"))).await?, &Vec::new())
}

async fn subscribers_hear_everything_in_order(memory: &dyn Memory) -> Result<(), String> {
    let what = "subscribers hear everything in order";
    let mut changes = memory.subscribe();
    for i in 0..20 {
        worked(what, memory.commit(vec![update("d", i, 0), update("e", i, 0)]).await)?;
    }
    worked(what, memory.commit(vec![Commit::removal(id("d"), 20)]).await)?;
    let mut heard: BTreeMap<EntityId, Vec<u64>> = BTreeMap::new();
    let mut last: Option<Arc<Snapshot>> = None;
    while !last.is_some_and(|s| s.is_removed()) {
        let snapshot = match changes.recv().await {
            Ok(snapshot) => snapshot,
            Err(broadcast::error::RecvError::Lagged(n)) => return Err(format!("{what}: missed {n}")),
            Err(broadcast::error::RecvError::Closed) => return Err(format!("{what}: the memory has gone")),
        };
        if ["d", "e"].contains(&snapshot.id.entity()) {
            heard.entry(snapshot.id.clone()).or_default().push(snapshot.version);
        }
        last = Some(snapshot);
    }
    let expected = [(id("d"), (1..=21).collect()), (id("e"), (1..=20).collect())];
    same(what, &heard, &BTreeMap::from(expected))
}

async fn modification_sees_the_newest(memory: &dyn Memory) -> Result<(), String> {
    let what = "modification sees the newest";
    for expected in 1..=3 {
        let version = modify(memory, &id("f"), 1, |now| {
            let count = now.and_then(value).unwrap_or(0);
            Some(BTreeMap::from([("value".to_owned(), Value::Int(count + 1))]))
        })
        .await;
        same(what, &worked(what, version)?, &expected)?;
    }
    same(what, &value(&*worked(what, memory.latest(&id("f")).await)?), &Some(3))?;
    let untouched = modify(memory, &id("f"), 1, |_| None).await;
    same(what, &worked(what, untouched)?, &3)
}

async fn bad_commits_are_refused(memory: &dyn Memory) -> Result<(), String> {
    let what = "bad commits are refused";
    let unsure = update("g", 1, 1).with_confidence(f64::NAN);
    same(
        what,
        &memory.commit(vec![unsure]).await,
        &Err(MemoryError::Confidence { id: id("g").to_string() }),
    )?;
    let relation = EntityId::new("ObjectRelations", "suite", "bad").expect("names");
    let instances = vec![Instance::new(BTreeMap::from([("subject".to_owned(), Value::Int(1))]))];
    let typed = Commit { id: relation, referenced_ns: 0, instances, expected_version: None };
    match memory.commit(vec![typed]).await {
        Err(MemoryError::Schema { attribute, .. }) => same(what, &attribute.as_str(), &"subject"),
        other => Err(format!("{what}: a relation between a number and nothing gave {other:?}")),
    }
}
