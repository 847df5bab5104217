//! Long-term memory beyond single snapshots: large values, names, retention, exchange.

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_values::{Frame, Pose, Reference, Value, Vector, Wrench};

use super::tests::{all, removed, snapshot, store};
use super::*;
use crate::attributes::Attributes;
use crate::conformance_tests::typed;
use crate::entity::{Commit, Instance};
use crate::error::MemoryError;
use crate::working::Backing;
use crate::working::WorkingMemory;

fn image(version: u64, content: u8) -> Arc<Snapshot> {
    let attributes = [("pixels", Value::Bytes(vec![content; 100_000])), ("n", Value::Int(1))];
    let instances = vec![Instance::new(attributes)];
    Arc::new(Snapshot { instances, ..(*snapshot("Images/eye/left", version, version, 0)).clone() })
}

/// All kinds of values, nested, with covariances.
fn everything() -> Arc<Snapshot> {
    let frame = Frame::root();
    let vector = Vector { frame: frame.clone(), components: [1.0, -2.0, 0.5] };
    let values = vec![
        Value::Null,
        Value::Bool(true),
        Value::Bool(false),
        Value::Int(i64::MIN),
        Value::Float(f64::INFINITY),
        Value::String("ä\u{0}".into()),
        Value::Duration(0.1),
        Value::Bytes(vec![0, 255]),
        Value::Bytes(vec![9; record::BLOB_FROM]),
        Value::Vector(vector.clone()),
        Value::Pose(Pose { frame: frame.clone(), position: [1.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] }),
        Value::Wrench(Wrench { frame, force: [1.0; 3], torque: [2.0; 3] }),
        Value::Reference(Reference { kind: "Motion".into(), id: "a/b/c".into() }),
        Value::Map(BTreeMap::from([("x".to_owned(), Value::List(vec![]))])),
    ];
    let attributes = Attributes::from([("values", Value::List(values)), ("at", vector.into())]);
    let first =
        Instance::new(attributes).with_covariance("at", vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let instances = vec![first, Instance::new(BTreeMap::new()).with_confidence(0.1)];
    Arc::new(Snapshot { instances, ..(*snapshot("S/p/all", 1, 5, 0)).clone() })
}

#[test]
fn every_kind_of_value_comes_back() {
    let (_folder, path, store) = store();
    store.persist(&[everything()]).unwrap();
    assert_eq!(all(&store), [everything()]);
    drop(store);
    let store = LongTermMemory::open(&path).unwrap();
    let mut scanned = Vec::new();
    store
        .scan(|s| {
            scanned.push(s);
            true
        })
        .unwrap();
    assert_eq!(scanned, [(*everything()).clone()]);
    assert!(store.verify().unwrap().is_intact());
}

#[test]
fn no_bytes_of_a_record_panic() {
    let mut bytes = Vec::new();
    let everything = everything();
    record::append(&mut bytes, 0, &everything, &mut Vec::new());
    let none = |_: &record::Hash| Ok(Vec::new());
    for at in 0..bytes.len() {
        for value in [0, 1, 7, 0x7f, 0x80, 0xff] {
            let mut changed = bytes.clone();
            changed[at] = value;
            // The checksum detects it; the decoder must not panic without the checksum either.
            let _ = record::head(&changed);
            let head = record::RecordHeader { length: changed.len(), number: 0, version: 1 };
            let _ = record::decode(&everything.id, head, &changed, &none);
        }
        let cut = record::RecordHeader { length: at, number: 0, version: 1 };
        assert!(record::decode(&everything.id, cut, &bytes, &none).is_err());
    }
}

#[test]
fn large_values_are_kept_once_and_go_with_their_last_use() {
    let (_folder, _, store) = store();
    let same: Vec<_> = (1..=20).map(|v| image(v, 7)).collect();
    store.persist(&same).unwrap();
    let bytes = store.stats().unwrap().bytes;
    assert!(bytes < 103_000, "one picture, not twenty: {bytes}");
    store.persist(&[image(21, 8)]).unwrap();
    assert_eq!(all(&store).len(), 21);
    assert_eq!(*all(&store)[20], *image(21, 8));
    assert!(store.verify().unwrap().is_intact());
    let dropped = store.retain(Retention { age_ns: Some(0), bytes: None }, u64::MAX).unwrap();
    assert_eq!(dropped.snapshots, 20);
    assert!(dropped.bytes > 100_000, "the older picture has gone: {dropped:?}");
    assert_eq!(all(&store), [image(21, 8)], "the newest of an entity stays");
    assert!(store.verify().unwrap().is_intact());
}

#[test]
fn retention_is_by_age_and_by_room() {
    let (_folder, _, store) = store();
    // One chunk per commit; each arrives 2 ns after its referenced time.
    for time in 0..100 {
        store.persist(&[snapshot("S/p/e", time + 1, time, 0)]).unwrap();
    }
    store.persist(&[snapshot("S/p/old", 1, 0, 0)]).unwrap();
    let dropped = store.retain(Retention { age_ns: Some(50), bytes: None }, 102).unwrap();
    assert_eq!(dropped.snapshots, 50);
    let kept: Vec<u64> = all(&store).iter().map(|s| s.version).collect();
    assert_eq!(kept, (51..=100).chain([1]).collect::<Vec<_>>());
    assert_eq!(store.last_version(&"S/p/e".parse().unwrap()), Ok(100));
    let budget = store.stats().unwrap().bytes / 2;
    store.retain(Retention { age_ns: None, bytes: Some(budget) }, 102).unwrap();
    assert!(store.stats().unwrap().bytes <= budget);
    assert_eq!(all(&store).last().unwrap().id.entity(), "old", "the newest of each entity stays");
    assert!(store.verify().unwrap().is_intact());
    assert_eq!(store.retain(Retention::default(), 102), Ok(Dropped::default()));
    // Dropped versions become a gap, and the count continues.
    store.persist(&[snapshot("S/p/e", 101, 200, 0)]).unwrap();
    assert_eq!(store.newest(&"S/p/e".parse().unwrap()).unwrap().unwrap().version, 101);
}

#[test]
fn working_memory_comes_back_under_its_name() {
    let (_folder, path, store) = store();
    let memory = WorkingMemory::new(Arc::new(|| 9));
    let commit = |name: &str, value: i64| {
        Commit::new(format!("S/p/{name}").parse().unwrap(), 1, [("value", Value::Int(value))])
    };
    memory.commit_now(vec![commit("a", 1), commit("b", 2)]).unwrap();
    assert_eq!(store.save_named("morning", &memory), Ok(2));
    memory.commit_now(vec![commit("a", 7), commit("c", 3)]).unwrap();
    assert_eq!(store.save_named("noon", &memory), Ok(3));
    // Retention keeps what a named snapshot contains.
    store.retain(Retention { age_ns: Some(0), bytes: Some(0) }, u64::MAX).unwrap();
    drop(store);
    let store = LongTermMemory::open(&path).unwrap();
    let names: Vec<_> =
        store.list_named().unwrap().into_iter().map(|n| (n.name, n.entities, n.taken_ns)).collect();
    assert_eq!(names, [("morning".to_owned(), 2, 9), ("noon".to_owned(), 3, 9)]);
    assert_eq!(store.load_named("morning", &memory), Ok(2), "a is as it was, c has gone, b is the same");
    let held = memory.query_now(&Query::latest(Pattern::any())).unwrap();
    let held: Vec<_> = held
        .iter()
        .map(|s| (s.id.entity(), s.version, s.attribute("value").and_then(Value::as_int)))
        .collect();
    assert_eq!(held, [("a", 3, Some(1)), ("b", 1, Some(2))]);
    store.forget_named("morning").unwrap();
    assert_eq!(store.forget_named("morning"), Err(StoreError::NoSuchName { name: "morning".into() }));
    assert!(store.load_named("morning", &memory).is_err());
    assert!(store.save_named("a/b", &memory).is_err());
    store.retain(Retention { age_ns: Some(0), bytes: None }, u64::MAX).unwrap();
    assert_eq!(all(&store).len(), 3, "the newest of each");
    assert!(store.verify().unwrap().is_intact());
}

#[test]
fn what_is_exported_can_be_imported() {
    let (_folder, _, store) = store();
    let kept: Vec<_> = (1..=1500).map(|v| snapshot("S/p/e", v, v, v as i64)).chain([image(1, 3)]).collect();
    store.persist(&kept).unwrap();
    let mut lines = Vec::new();
    assert_eq!(store.export(&Pattern::any(), &mut lines), Ok(1501));
    let (_other_folder, _, other) = super::tests::store();
    assert_eq!(other.import(&mut lines.as_slice()), Ok(1501));
    assert_eq!(all(&other), all(&store));
    assert_eq!(other.import(&mut lines.as_slice()), Ok(0), "what is there already is passed over");
    let mut one = Vec::new();
    assert_eq!(store.export(&Pattern::segment("Images"), &mut one), Ok(1));
    for bad in ["{", "[]", r#"{"id":"S/p"}"#, "\n\nnull"] {
        assert!(matches!(other.import(&mut bad.as_bytes()), Err(StoreError::Import { .. })), "{bad}");
    }
    assert!(other.verify().unwrap().is_intact());
}

#[test]
fn compaction_joins_what_came_one_by_one() {
    let (_folder, _, store) = store();
    for version in 1..=300 {
        store.persist(&[snapshot("S/p/e", version, version, 0)]).unwrap();
    }
    let before = all(&store);
    assert_eq!(store.compact(), Ok(true));
    assert_eq!(all(&store), before);
    assert!(store.verify().unwrap().is_intact());
}

#[test]
fn what_is_coded_is_kept_so_and_nothing_contradicts_it() {
    let (_folder, path, store) = store();
    let code = |value: &Value| match value {
        Value::Bytes(bytes) => Some(Value::Bytes(bytes.iter().step_by(2).copied().collect())),
        _ => None,
    };
    let coded = || Policies::all(Policy::Everything).coded("Images", Coding::new("every other byte", code));
    let backing = Arc::new(Consolidator::new(Arc::clone(&store), coded()).unwrap());
    let memory = WorkingMemory::new(Arc::new(|| 1)).with_backing(backing);
    let come = [image(1, 3), image(2, 4), snapshot("Notes/p/e", 1, 1, 7)];
    for snapshot in &come {
        let update = Commit::of(snapshot.id.clone(), 1, snapshot.instances.clone());
        memory.commit_now(vec![update]).unwrap();
    }
    let bytes = |found: &Snapshot| match found.attribute("pixels") {
        Some(Value::Bytes(bytes)) => bytes.len(),
        _ => 0,
    };
    let newest = memory.latest_now(&come[1].id).unwrap();
    assert_eq!(bytes(&newest), 100_000, "working memory has it as it came");
    let kept = store.query(&Query::history(Pattern::segment("Images"))).unwrap();
    assert_eq!(kept.iter().map(|s| bytes(s)).collect::<Vec<_>>(), [50_000, 50_000]);
    assert_eq!(kept[0].attribute("n"), Some(&Value::Int(1)), "what is not coded stays");
    assert!(store.stats().unwrap().bytes < 110_000);

    // Working memory under a name, then the same snapshots again: what is stored stays as it is.
    assert_eq!(store.save_named("now", &memory), Ok(2));
    assert_eq!(bytes(&store.named("now").unwrap()[0]), 50_000);
    let again = Consolidator::new(Arc::clone(&store), coded()).unwrap();
    assert_eq!(again.consolidate(&[newest]), Ok(1));
    assert_eq!(store.stats().unwrap().snapshots, 3);
    assert!(store.verify().unwrap().is_intact());
    drop((memory, again, store));
    assert_eq!(
        LongTermMemory::open(&path).unwrap().newest(&come[1].id).unwrap().map(|s| bytes(&s)),
        Some(50_000)
    );
}

#[test]
fn what_no_memory_would_have_taken_is_not_kept_from_elsewhere() {
    let (_folder, _, store) = store();
    let memory = WorkingMemory::new(Arc::new(|| 1));
    let mut nested = Value::Int(1);
    for _ in 0..20 {
        nested = Value::List(vec![nested]);
    }
    let good = snapshot("S/p/e", 1, 1, 1);
    let with = |instance: Instance| Snapshot { instances: vec![instance], ..(*good).clone() };
    for bad in [
        Snapshot { version: 0, ..(*good).clone() },
        Snapshot { version: u64::MAX, ..(*good).clone() },
        with(Instance::new([("nested", nested)])),
        with(Instance::new([("n", Value::Int(1))]).with_confidence(f64::NAN)),
    ] {
        let keep = crate::wire::Maintain::Keep { snapshots: vec![Arc::clone(&good), Arc::new(bad.clone())] };
        assert!(crate::maintain::carry_out(keep, Some(&store), &memory).is_err(), "{bad:?}");
        let line = serde_json::to_vec(&bad).unwrap();
        assert!(matches!(store.import(&mut line.as_slice()), Err(StoreError::Import { .. })), "{bad:?}");
    }
    assert_eq!(store.stats().unwrap().snapshots, 0);
}

/// Data that violate a typed core segment are not loaded, but a file of a program without that segment still opens.
#[test]
fn what_does_not_fit_stops_no_start() {
    let (_folder, path, store) = store();
    let memory = typed(WorkingMemory::new(Arc::new(|| 1)));
    let (odd, good) = (snapshot("Typed/p/odd", 1, 1, 1), snapshot("S/p/e", 1, 1, 1));
    let keep = crate::wire::Maintain::Keep { snapshots: vec![Arc::clone(&odd)] };
    let refused = crate::maintain::carry_out(keep, Some(&store), &memory).unwrap_err();
    assert!(matches!(refused, MemoryError::Schema { .. }), "{refused}");
    store.persist(&[odd, Arc::clone(&good)]).unwrap();
    drop(store);
    let store = LongTermMemory::open(&path).unwrap();
    assert_eq!(store.load_into(&memory, Pattern::any()), Ok(1));
    assert_eq!(memory.query_now(&Query::latest(Pattern::any())), Ok(vec![good]));
    assert_eq!(store.segments(), Ok(vec!["S".into(), "Typed".into()]));
}

/// The errors and counts of a memory without a file.
#[test]
fn a_memory_without_a_file_counts_what_it_holds_and_says_what_it_lacks() {
    let memory = WorkingMemory::new(Arc::new(|| 1));
    let stats = crate::maintain::carry_out(crate::wire::Maintain::Stats, None, &memory).unwrap();
    assert_eq!(
        stats.counts.keys().collect::<Vec<_>>(),
        ["working_bytes", "working_entities", "working_updates"]
    );
    let refused = crate::maintain::carry_out(crate::wire::Maintain::Compact, None, &memory).unwrap_err();
    assert!(refused.to_string().contains("--store"), "{refused}");
}

/// Commits beside a compaction are in the new file; named snapshots, removals and versions that were given are, too.
#[test]
fn commits_beside_a_compaction_are_in_the_new_file() {
    let (_folder, path, store) = store();
    let memory = WorkingMemory::new(Arc::new(|| 7)).with_backing(Arc::<LongTermMemory>::clone(&store));
    let commit = |name: &str, value: i64| {
        let update = Commit::new(format!("S/p/{name}").parse().unwrap(), 1, [("value", Value::Int(value))]);
        memory.commit_now(vec![update]).unwrap()[0]
    };
    (0..3000).for_each(|n| assert!(commit(&format!("e{}", n % 500), n) > 0));
    memory.commit_now(vec![Commit::removal("S/p/e7".parse().unwrap(), 1)]).unwrap();
    store.save_named("morning", &memory).unwrap();
    let ended = std::sync::atomic::AtomicBool::new(false);
    let beside = std::thread::scope(|scope| {
        scope.spawn(|| {
            for _ in 0..3 {
                assert_eq!(store.compact(), Ok(true));
            }
            ended.store(true, std::sync::atomic::Ordering::Release);
        });
        let mut last = 0;
        while !ended.load(std::sync::atomic::Ordering::Acquire) {
            last = commit("beside", last as i64);
        }
        last
    });
    assert!(beside > 3, "{beside} commits");
    let held = memory.query_now(&Query::latest(Pattern::any())).unwrap();
    drop(memory);
    drop(store);
    let store = LongTermMemory::open(&path).unwrap();
    assert_eq!(store.query(&Query::latest(Pattern::any())).unwrap(), held);
    assert_eq!(store.last_given(&"S/p/beside".parse().unwrap()), Ok(beside));
    assert_eq!(all(&store).len() as u64, 3001 + beside);
    assert_eq!(store.named("morning").unwrap().len(), 499);
    assert!(store.verify().unwrap().is_intact());
    assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "nothing is left beside it");
}

/// While entities are still being read, everything answers and counts as if they were there.
#[test]
fn what_was_not_read_yet_is_looked_up() {
    let (_folder, _, store) = store();
    let many: Vec<_> =
        (1..=3).flat_map(|v| [snapshot("S/p/a", v, v, 1), snapshot("S/p/b", v, v, 1)]).collect();
    store.persist(&many).unwrap();
    store.persist(&[snapshot("S/p/gone", 1, 1, 1), removed("S/p/gone", 2, 2)]).unwrap();
    let memory = WorkingMemory::new(Arc::new(|| 7)).with_backing(Arc::<LongTermMemory>::clone(&store));
    memory.set_partial(true);
    let id = |name: &str| -> EntityId { format!("S/p/{name}").parse().unwrap() };
    assert_eq!(memory.latest_now(&id("a")).unwrap().version, 3);
    assert!(memory.latest_now(&id("gone")).is_err() && memory.latest_now(&id("new")).is_err());
    let newest = |memory: &WorkingMemory| {
        let found = memory.query_now(&Query::latest(Pattern::any())).unwrap();
        found.iter().map(|s| format!("{} {}", s.id, s.version)).collect::<Vec<_>>().join(", ")
    };
    assert_eq!(newest(&memory), "S/p/a 3, S/p/b 3");
    let commit =
        |name: &str, expected: u64| memory.commit_now(vec![Commit::new(id(name), 9, []).expecting(expected)]);
    assert!(commit("a", 0).is_err() && commit("a", 2).is_err());
    assert_eq!(commit("a", 3), Ok(vec![4]));
    assert_eq!(commit("gone", 0), Ok(vec![3]));
    assert_eq!(newest(&memory), "S/p/a 4, S/p/b 3, S/p/gone 3");
    let mut told = memory.changes(&Pattern::any());
    assert_eq!(store.load_into(&memory, Pattern::any()), Ok(1), "only `b` was missing");
    memory.set_partial(false);
    assert_eq!(newest(&memory), "S/p/a 4, S/p/b 3, S/p/gone 3");
    assert!(told.try_recv().is_err(), "what was read is no change");
}
