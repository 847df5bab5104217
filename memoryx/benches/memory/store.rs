//! Long-term memory, beside a bare redb file with the same rows.

use std::path::Path;
use std::sync::Arc;

use armarium_memoryx::{Instance, LongTermMemory, Pattern, Query, Snapshot};
use armarium_values::Value;
use redb::{Database, TableDefinition};

use super::{Meter, at_most, id, median, say};

pub(super) const BARE: TableDefinition<'_, (u64, u64), &[u8]> = TableDefinition::new("bare");
/// Snapshots that one part stores.
pub(super) const KEPT: u64 = 100_000;

pub(super) fn snapshot(entity: u64, version: u64, bytes: usize) -> Arc<Snapshot> {
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

pub(super) fn put_bare(bare: &Database, rows: impl Iterator<Item = (u64, u64)>) {
    put(bare.begin_write().expect("a transaction"), rows);
}

/// As [`put_bare`]; and the file is opened at once after a kill, as long-term memory is.
pub(super) fn put_to_open_at_once(bare: &Database, rows: impl Iterator<Item = (u64, u64)>) {
    let mut write = bare.begin_write().expect("a transaction");
    write.set_quick_repair(true);
    put(write, rows);
}

fn put(write: redb::WriteTransaction, rows: impl Iterator<Item = (u64, u64)>) {
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
    at_most("  times the bare one", ours / raw, "", 2.0);
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
    let raw = start.say(&format!("bare redb, {what}"), KEPT);
    drop(bare);
    let store = LongTermMemory::open(&folder.join(format!("{group}-{entities}.redb"))).expect("a file");
    let groups: Vec<Vec<_>> = groups()
        .map(|group| group.map(row).map(|(entity, version)| snapshot(entity, version, 1000)).collect())
        .collect();
    let start = Meter::start();
    for group in &groups {
        store.persist(group).expect("a disk");
    }
    let ours = start.at_least(&format!("snapshots of {what}"), KEPT, 100_000.0);
    say("  times the bare rate", ours / raw, "", "");
    scan(&store, &format!("scan, {what}"));
    let start = Meter::start();
    let found = store.query(&Query::history(Pattern::entity(&id(1)))).expect("it can be read");
    start.say(&format!("history of one entity, {what}"), found.len() as u64);
}

fn scan(store: &LongTermMemory, what: &str) {
    let start = Meter::start();
    let mut count = 0;
    let counted = store.scan(|_| {
        count += 1;
        true
    });
    counted.expect("it can be read");
    start.at_least(what, count, 1_000_000.0);
}

fn small(folder: &Path) {
    let store = LongTermMemory::open(&folder.join("small.redb")).expect("a file");
    for g in 0..50 {
        let group: Vec<_> = (0..10_000).map(|i| snapshot(i % 100, g * 100 + i / 100 + 1, 100)).collect();
        store.persist(&group).expect("a disk");
    }
    scan(&store, "scan, 100 B");
}
