//! Long-term memory in normal use: store, query, load, consolidate.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use armarium_values::Value;

use super::*;
use crate::entity::{Commit, Instance};
use crate::query::Times;
use crate::working::Backing;
use crate::working::WorkingMemory;

pub(super) fn snapshot(path: &str, version: u64, time: u64, value: i64) -> Arc<Snapshot> {
    let (id, instances) = (path.parse().unwrap(), vec![Instance::new([("value", Value::Int(value))])]);
    let (referenced_ns, sent_ns, arrived_ns) = (time, time + 1, time + 2);
    Arc::new(Snapshot { id, version, referenced_ns, sent_ns, arrived_ns, instances })
}

pub(super) fn removed(path: &str, version: u64, time: u64) -> Arc<Snapshot> {
    Arc::new(Snapshot { instances: Vec::new(), ..(*snapshot(path, version, time, 0)).clone() })
}

pub(super) fn store() -> (tempfile::TempDir, PathBuf, Arc<LongTermMemory>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("memory.redb");
    let store = Arc::new(LongTermMemory::open(&path).unwrap());
    (folder, path, store)
}

/// The history of everything in a store.
pub(super) fn all(store: &LongTermMemory) -> Vec<Arc<Snapshot>> {
    store.query(&Query::history(Pattern::any())).unwrap()
}

/// What stores by one policy in a store.
pub(crate) fn keeping(store: &Arc<LongTermMemory>, policy: Policy) -> Arc<Consolidator> {
    Arc::new(Consolidator::new(Arc::clone(store), Policies::all(policy)).unwrap())
}

pub(super) fn versions(found: &[Arc<Snapshot>]) -> Vec<(String, u64)> {
    found.iter().map(|s| (s.id.to_string(), s.version)).collect()
}

#[test]
fn what_is_kept_is_there_after_opening_again() {
    let (_folder, path, store) = store();
    let kept = [snapshot("Motions/a/wipe", 1, 10, 7), snapshot("Motions/a/wipe", 2, 20, 8)];
    assert_eq!(store.persist(&kept), Ok(2));
    assert_eq!(store.persist(&kept), Ok(0), "what is there already stays");
    drop(store);
    let store = LongTermMemory::open(&path).unwrap();
    assert_eq!(store.newest(&kept[0].id).unwrap().unwrap(), kept[1]);
    assert_eq!(store.last_version(&kept[0].id), Ok(2));
    let stats = store.stats().unwrap();
    assert_eq!((stats.entities, stats.snapshots), (1, 2));
    assert!(stats.file_bytes > 0);
    assert_eq!(store.verify().unwrap(), Verification { intact: 2, ..Verification::default() });
}

#[test]
fn a_version_is_not_overwritten() {
    let (_folder, _, store) = store();
    store.persist(&[snapshot("S/p/e", 1, 10, 7)]).unwrap();
    let other = store.persist(&[snapshot("S/p/new", 1, 1, 1), snapshot("S/p/e", 1, 10, 8)]);
    assert_eq!(other, Err(StoreError::Version { id: "S/p/e".into(), version: 1 }));
    assert_eq!(store.newest(&"S/p/new".parse().unwrap()), Ok(None), "all or none");
}

#[test]
fn a_second_opening_is_refused() {
    let (_folder, path, store) = store();
    let second = LongTermMemory::open(&path).unwrap_err();
    assert_eq!(second, StoreError::Locked { path: path.display().to_string() });
    drop(store);
    LongTermMemory::open(&path).unwrap();
}

#[test]
fn a_second_run_goes_on_where_the_first_ended() {
    let (_folder, _, store) = store();
    let id: EntityId = "Motions/learned/wipe".parse().unwrap();
    let commit = |value: f64| Commit::new(id.clone(), 5, [("frequency", Value::Float(value))]);
    let run = || WorkingMemory::new(Arc::new(|| 5)).with_backing(keeping(&store, Policy::Everything));
    let first = run();
    first.commit_now(vec![commit(0.5), commit(0.6)]).unwrap();
    drop(first);

    let second = run();
    assert_eq!(store.load_into(&second, Pattern::segment("Motions")), Ok(1));
    let found = second.latest_now(&id).unwrap();
    assert_eq!((found.version, found.attribute("frequency")), (2, Some(&Value::Float(0.6))));
    assert_eq!(second.commit_now(vec![commit(0.7).expecting(2)]), Ok(vec![3]));
    assert_eq!(store.load_into(&second, Pattern::segment("Motions")), Ok(0), "what is newer stays");

    let third = run();
    assert_eq!(third.commit_now(vec![commit(0.8)]), Ok(vec![4]), "numbered on without having been loaded");
}

#[test]
fn policies_choose() {
    let seconds = |s: f64| (s * 1e9) as u64;
    let five: Vec<_> = [0.0, 0.4, 1.0, 1.5, 1.9]
        .iter()
        .enumerate()
        .map(|(i, t)| snapshot("S/p/e", i as u64 + 1, seconds(*t), i as i64 / 2))
        .collect();
    let named = |name: &str| Policy::Named([name.to_owned()].into());
    for (policy, at_once, at_the_end) in [
        (Policy::Nothing, vec![], vec![]),
        (Policy::Everything, vec![1, 2, 3, 4, 5], vec![1, 2, 3, 4, 5]),
        (Policy::OnChange, vec![1, 3, 5], vec![1, 3, 5]),
        (Policy::AtMost { hz: 1.0 }, vec![1, 3], vec![1, 3, 5]),
        (named("e"), vec![1, 2, 3, 4, 5], vec![1, 2, 3, 4, 5]),
        (named("f"), vec![], vec![]),
    ] {
        let (_folder, _, store) = store();
        let consolidator = keeping(&store, policy.clone());
        let kept = |expected: &[u64]| {
            assert_eq!(all(&store).iter().map(|s| s.version).collect::<Vec<_>>(), expected, "{policy:?}");
        };
        for part in five.chunks(2) {
            consolidator.consolidate(part).unwrap();
        }
        kept(&at_once);
        consolidator.flush().unwrap();
        consolidator.flush().unwrap();
        kept(&at_the_end);
    }
}

#[test]
fn a_change_is_one_after_opening_again_too() {
    let (_folder, _, store) = store();
    let on_change = || keeping(&store, Policy::OnChange);
    assert_eq!(on_change().consolidate(&[snapshot("S/p/e", 1, 0, 7)]), Ok(1));
    assert_eq!(on_change().consolidate(&[snapshot("S/p/e", 2, 0, 7)]), Ok(0));
    assert_eq!(on_change().consolidate(&[snapshot("S/p/e", 3, 0, 8)]), Ok(1));
}

#[test]
fn compaction_keeps_everything() {
    let (_folder, path, store) = store();
    let many: Vec<_> = (1..2000).map(|v| snapshot("S/p/e", v, v, v as i64)).collect();
    for part in many.chunks(50) {
        store.persist(part).unwrap();
    }
    let before = std::fs::metadata(&path).unwrap().len();
    assert_eq!(store.compact(), Ok(true));
    assert!(std::fs::metadata(&path).unwrap().len() < before);
    assert_eq!(all(&store), many);
    assert_eq!(store.verify().unwrap().intact, 1999);
}

/// A snapshot with a referenced time far in the future must not hide later ones.
#[test]
fn a_time_from_the_future_hides_nothing_that_comes_later() {
    let now = 1_000_000_000_000_u64;
    let future = 100 * now;
    let come = [(1, now), (2, future), (3, now + 2_000_000_000), (4, now + 4_000_000_000)];
    let one = |(version, time): (u64, u64)| {
        Arc::new(Snapshot { arrived_ns: now + version, ..(*snapshot("S/p/e", version, time, 0)).clone() })
    };
    let come = come.map(one);
    let (_folder, path, store) = store();
    let kept = keeping(&store, Policy::AtMost { hz: 1.0 });
    for one in &come {
        kept.consolidate(std::slice::from_ref(one)).unwrap();
    }
    drop((kept, store));
    let store = LongTermMemory::open(&path).unwrap();
    let all = |times: Times| {
        let found = store.query(&Query::latest(Pattern::any()).times(times)).unwrap();
        found.iter().map(|s| s.version).collect::<Vec<_>>()
    };
    assert_eq!(all(Times::All), [1, 2, 3, 4], "a rate goes on after it");
    assert_eq!(all(Times::Latest), [4], "the newest is what came last");
    assert_eq!(all(Times::At(now + 3_000_000_000)), [3], "and what held at a time is asked by that time");
    let dropped = store.retain(Retention { age_ns: Some(0), bytes: None }, now * 2).unwrap();
    assert_eq!((dropped.snapshots, all(Times::All)), (3, vec![4]), "and it is forgotten by when it came");
}

#[test]
fn removals_come_back_as_removals() {
    let (_folder, _, store) = store();
    store.persist(&[snapshot("S/p/e", 1, 1, 1), removed("S/p/e", 2, 2)]).unwrap();
    assert_eq!(store.query(&Query::latest(Pattern::any())), Ok(vec![]));
    assert_eq!(store.newest(&"S/p/e".parse().unwrap()).unwrap().unwrap().version, 2);
}

#[test]
fn a_copy_is_whole_and_of_one_moment() {
    let (_folder, path, store) = store();
    let many: Vec<_> = (0..6000).map(|n| snapshot(&format!("S/p/e{n}"), 1, n, 7)).collect();
    store.persist(&many).unwrap();
    let memory = WorkingMemory::new(Arc::new(|| 0));
    store.load_into(&memory, Pattern::any()).unwrap();
    store.save_named("morning", &memory).unwrap();
    let copy = store.back_up("copy.redb").unwrap();
    store.persist(&[snapshot("S/p/later", 1, 9, 7)]).unwrap();
    assert_eq!(copy, path.with_file_name("copy.redb"));
    let copied = LongTermMemory::open(&copy).unwrap();
    let (own, other) = (store.stats().unwrap(), copied.stats().unwrap());
    assert_eq!((other.entities, other.snapshots), (own.entities - 1, own.snapshots - 1));
    assert!(copied.verify().unwrap().is_intact());
    assert_eq!(copied.named("morning").unwrap(), store.named("morning").unwrap());
    assert_eq!(copied.persist(&[snapshot("S/p/later", 1, 9, 7)]), Ok(1), "it can be written");
    // Nothing is overwritten, and nothing is written elsewhere.
    for name in ["copy.redb", "memory.redb", "../copy.redb", "/tmp/copy.redb", "a/b", "..", ""] {
        assert!(store.back_up(name).is_err(), "{name}");
    }
}

#[test]
fn what_has_changed_since_a_named_snapshot_is_said() {
    let (_folder, _, store) = store();
    let memory = WorkingMemory::new(Arc::new(|| 0));
    let put = |name: &str, data: &[(&str, i64)]| {
        let id = format!("Things/p/{name}").parse().unwrap();
        let data: BTreeMap<String, Value> =
            data.iter().map(|(name, value)| ((*name).to_owned(), Value::Int(*value))).collect();
        memory.commit_now(vec![Commit::new(id, 0, data)]).unwrap();
    };
    put("stays", &[("x", 1)]);
    put("goes", &[("x", 1)]);
    put("turns", &[("x", 1), ("y", 2), ("z", 3)]);
    store.save_named("before", &memory).unwrap();
    put("comes", &[("x", 1)]);
    put("stays", &[("x", 1)]);
    put("turns", &[("x", 1), ("y", 3)]);
    memory.commit_now(vec![Commit::removal("Things/p/goes".parse().unwrap(), 0)]).unwrap();
    let said = |to: Option<&str>| -> Vec<String> {
        let changes = store.compare_named("before", to, &memory).unwrap();
        changes.iter().map(ToString::to_string).collect()
    };
    let expected = ["+ Things/p/comes", "- Things/p/goes", "~ Things/p/turns y z"];
    assert_eq!(said(None), expected);
    store.save_named("after", &memory).unwrap();
    put("comes", &[("x", 2)]);
    assert_eq!(said(Some("after")), expected);
    assert_eq!(said(Some("before")), [""; 0]);
    assert!(store.compare_named("nobody", None, &memory).is_err());
}

/// A chunk of which retention has forgotten a part is come to again, also after a compaction.
#[test]
fn a_part_of_a_chunk_is_forgotten_and_later_the_rest() {
    let (_folder, _, store) = store();
    let (half, whole) = (500_000_000, 1_000_000_000);
    let together =
        [snapshot("S/p/e", 1, 0, 1), snapshot("S/p/gone", 1, half, 1), removed("S/p/gone", 2, half)];
    store.persist(&together).unwrap();
    store.persist(&[snapshot("S/p/e", 2, 1, 2)]).unwrap();
    store.persist(&[snapshot("S/p/e", 3, 3 * whole, 3)]).unwrap();
    let retain = |now: u64| store.retain(Retention { age_ns: Some(0), bytes: None }, now).unwrap();
    assert_eq!(retain(20).snapshots, 2, "both old ones of `e`");
    assert!(store.verify().unwrap().is_intact());
    store.compact().unwrap();
    assert_eq!(retain(4 * whole).snapshots, 2, "what is gone, with its name");
    assert_eq!(store.stats().unwrap().entities, 1);
    assert!(store.verify().unwrap().is_intact());
}
