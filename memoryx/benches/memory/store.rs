//! Long-term memory, beside a bare redb file with the same rows.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use armarium_memoryx::{
    Consolidator, Instance, LongTermMemory, MemoryLimits, Pattern, Policies, Policy, Query, Retention,
    Snapshot, WorkingMemory,
};
use armarium_values::Value;
use redb::{Database, TableDefinition};

use super::{Meter, commit, id, median, say};

const BARE: TableDefinition<'_, (u64, u64), &[u8]> = TableDefinition::new("bare");
/// Snapshots that one part stores.
const KEPT: u64 = 100_000;

fn snapshot(entity: u64, version: u64, bytes: usize) -> Arc<Snapshot> {
    let instances = vec![Instance::new([("data", Value::Bytes(vec![version as u8; bytes]))])];
    Arc::new(Snapshot {
        id: id(entity),
        version,
        referenced_ns: version,
        sent_ns: 0,
        arrived_ns: version,
        instances,
    })
}

fn put_bare(bare: &Database, rows: impl Iterator<Item = (u64, u64)>) {
    let write = bare.begin_write().expect("a transaction");
    {
        let mut table = write.open_table(BARE).expect("a table");
        for row in rows {
            table.insert(row, [7; 1000].as_slice()).expect("room");
        }
    }
    write.commit().expect("a disk");
}

pub(super) fn long_term() {
    let folder = tempfile::tempdir().expect("a folder");
    one_by_one(folder.path());
    for (group, entities) in [(1000, 10), (1000, 1000), (10_000, 1000)] {
        in_groups(folder.path(), group, entities);
    }
    small(folder.path());
    super::frames::as_fast_as_they_go(folder.path());
    starts(folder.path());
}

fn one_by_one(folder: &Path) {
    let bare = Database::create(folder.join("bare.redb")).expect("a file");
    let store = LongTermMemory::open(&folder.join("ours.redb")).expect("a file");
    let (mut raw, mut ours) = (Vec::new(), Vec::new());
    // In turn, so that both see the same disk.
    for version in 1..=300 {
        let start = Meter::start();
        put_bare(&bare, [(0, version)].into_iter());
        raw.push(start.elapsed());
        let one = [snapshot(0, version, 1000)];
        let start = Meter::start();
        store.persist(&one).expect("a disk");
        ours.push(start.elapsed());
    }
    let (raw, ours) = (median(raw), median(ours));
    say("bare redb commit, 1 kB, durable, median", raw, "us", "");
    say("durable commit of one snapshot, 1 kB, median", ours, "us", "");
    say("  times the bare one", ours / raw, "", "asked: at most 2");
}

fn in_groups(folder: &Path, group: u64, entities: u64) {
    let what = format!("1 kB in groups of {group}, of {entities} entities");
    let row = |n: u64| (n % entities, n / entities + 1);
    let groups = || (0..KEPT / group).map(|g| g * group..(g + 1) * group);
    let bare = Database::create(folder.join(format!("bare-{group}-{entities}.redb"))).expect("a file");
    let start = Meter::start();
    for group in groups() {
        put_bare(&bare, group.map(row));
    }
    let raw = start.say(&format!("bare redb, {what}"), KEPT, "");
    drop(bare);
    let store = LongTermMemory::open(&folder.join(format!("{group}-{entities}.redb"))).expect("a file");
    let groups: Vec<Vec<_>> = groups()
        .map(|group| group.map(row).map(|(entity, version)| snapshot(entity, version, 1000)).collect())
        .collect();
    let start = Meter::start();
    for group in &groups {
        store.persist(group).expect("a disk");
    }
    let ours = start.say(&format!("snapshots of {what}"), KEPT, "asked: 100 000");
    say("  times the bare rate", ours / raw, "", "");
    scan(&store, &format!("scan, {what}"));
    let start = Meter::start();
    let found = store.query(&Query::history(Pattern::entity(&id(1)))).expect("it can be read");
    start.say(&format!("history of one entity, {what}"), found.len() as u64, "");
}

fn scan(store: &LongTermMemory, what: &str) {
    let start = Meter::start();
    let mut count = 0;
    let counted = store.scan(|_| {
        count += 1;
        true
    });
    counted.expect("it can be read");
    start.say(what, count, "asked: 1 000 000");
}

fn small(folder: &Path) {
    let store = LongTermMemory::open(&folder.join("small.redb")).expect("a file");
    for g in 0..50 {
        let group: Vec<_> = (0..10_000).map(|i| snapshot(i % 100, g * 100 + i / 100 + 1, 100)).collect();
        store.persist(&group).expect("a disk");
    }
    scan(&store, "scan, 100 B");
}

/// Measures how long it takes to open a file that was not closed, and to load its newest snapshots into working
/// memory.
fn starts(folder: &Path) {
    let path = folder.join("started.redb");
    let store = LongTermMemory::open(&path).expect("a file");
    for g in 0..KEPT / 1000 {
        let group: Vec<_> = (0..1000).map(|i| snapshot(i, g + 1, 1000)).collect();
        store.persist(&group).expect("a disk");
    }
    // A copy of an open file stands for the file of a killed process.
    let killed = folder.join("killed.redb");
    std::fs::copy(&path, &killed).expect("room");
    drop(store);
    for (what, path) in [("closed", path), ("killed", killed)] {
        let start = Meter::start();
        let store = LongTermMemory::open(&path).expect("a file");
        let memory = WorkingMemory::new(Arc::new(|| 0));
        let loaded = store.load_into(&memory, Pattern::any()).expect("it can be read");
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let words = format!("start on 100 000 x 1 kB of {loaded} entities, {what}");
        say(&words, ms, "ms", "asked: under 1000");
    }
}

pub(super) fn durable_agent() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = Arc::new(LongTermMemory::open(&folder.path().join("agent.redb")).expect("a file"));
    let kept = Consolidator::new(store, Policies::all(Policy::Everything)).expect("it can be read");
    let memory =
        WorkingMemory::new(Arc::new(|| 0)).with_limits(MemoryLimits::default()).with_backing(Arc::new(kept));
    for group in [1000, 10_000] {
        let start = Meter::start();
        for g in 0..KEPT / group {
            let updates = (0..group).map(|i| commit((g * group + i) % 1000, 1000));
            memory.commit_now(updates.collect()).expect("it fits");
        }
        let what = format!("durable commits of {group} x 1 kB through working memory");
        start.say(&what, KEPT, "asked: 100 000");
    }
}

/// How long durable commits take while retention drops a third of a store, beside those of an idle store and of bare redb.
pub(super) fn beside_retention() {
    let folder = tempfile::tempdir().expect("a folder");
    let bare = Database::create(folder.path().join("bare.redb")).expect("a file");
    let store = Arc::new(LongTermMemory::open(&folder.path().join("agent.redb")).expect("a file"));
    for g in 0..KEPT / 1000 {
        let group: Vec<_> = (0..1000).map(|i| snapshot(i, g + 1, 1000)).collect();
        store.persist(&group).expect("a disk");
    }
    let kept = Consolidator::new(Arc::clone(&store), Policies::all(Policy::Everything));
    let memory = WorkingMemory::new(Arc::new(|| KEPT)).with_backing(Arc::new(kept.expect("it can be read")));
    let commits = |name: u64, until: &dyn Fn(usize) -> bool| {
        let mut times = Vec::new();
        while !until(times.len()) {
            let update = vec![commit(1_000_000 + name, 1000)];
            let start = Meter::start();
            memory.commit_now(update).expect("it fits");
            times.push(start.elapsed());
        }
        times
    };
    let raw: Vec<_> = (0..300)
        .map(|version| {
            let start = Meter::start();
            put_bare(&bare, [(0, version)].into_iter());
            start.elapsed()
        })
        .collect();
    let idle = commits(0, &|count| count == 300);
    let ended = AtomicBool::new(false);
    let start = Meter::start();
    let (beside, dropped) = std::thread::scope(|scope| {
        let retaining = scope.spawn(|| {
            let retention = Retention { age_ns: Some(KEPT - KEPT / 3000), bytes: None };
            let dropped = store.retain(retention, KEPT).expect("a disk");
            ended.store(true, Ordering::Release);
            dropped
        });
        let beside = commits(1, &|count| count > 0 && ended.load(Ordering::Acquire));
        (beside, retaining.join().expect("it ends"))
    });
    let rate = dropped.snapshots as f64 / start.elapsed().as_secs_f64();
    say("retention beside durable commits", rate, "/s", &format!("dropped {}", dropped.snapshots));
    let slowest = |times: &[std::time::Duration]| times.iter().max().map_or(0.0, |t| t.as_secs_f64() * 1e3);
    say("slowest commit of bare redb", slowest(&raw), "ms", "");
    say("slowest durable commit, idle", slowest(&idle), "ms", "");
    say(
        &format!("slowest durable commit of {} beside retention", beside.len()),
        slowest(&beside),
        "ms",
        "asked: 20",
    );
    let (raw, idle, beside) = (median(raw), median(idle), median(beside));
    say("durable commit through one thread, median", idle, "us", "");
    say("  times the bare one", idle / raw, "", "asked: at most 1.3");
    say("  beside retention, times the idle one", beside / idle, "", "");
}
