//! Durable commits through working memory: of one writer beside bare redb, of ten, and beside the upkeep of the file.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use armarium_memoryx::{
    Consolidator, LongTermMemory, MemoryLimits, Policies, Policy, Retention, WorkingMemory,
};
use redb::Database;

use super::store::{KEPT, put_bare, put_to_open_at_once, snapshot};
use super::{Meter, at_most, commit, median, say};

/// Pairs of commits, in turn.
const PAIRS: u64 = 300;
/// Writers beside each other, and the updates in each of their commits.
const WRITERS: u64 = 10;
const TOGETHER: u64 = 100;

pub(super) fn durable() {
    let folder = tempfile::tempdir().expect("a folder");
    groups(folder.path());
    ten_writers(folder.path());
    let (store, memory) = filled(folder.path());
    let bare = Database::create(folder.path().join("bare.redb")).expect("a file");
    for g in 0..KEPT / 1000 {
        put_bare(&bare, (0..1000).map(|i| (i, g + 1)));
    }
    one_writer(&bare, &memory);
    beside(&bare, &memory, "verification", &|| {
        store.verify().expect("it can be read");
    });
    beside(&bare, &memory, "a named snapshot", &|| {
        store.save_named("morning", &memory).expect("a disk");
    });
    memory.commit_now((0..1000).map(|n| commit(n, 100)).collect()).expect("it fits");
    beside(&bare, &memory, "the loading of it", &|| {
        store.load_named("morning", &memory).expect("a disk");
    });
    beside(&bare, &memory, "compaction", &|| {
        store.compact().expect("a disk");
    });
    beside(&bare, &memory, "retention", &|| {
        let retention = Retention { age_ns: Some(KEPT - KEPT / 3000), bytes: None };
        store.retain(retention, KEPT).expect("a disk");
    });
}

fn agent(file: &Path) -> (Arc<LongTermMemory>, WorkingMemory) {
    let store = Arc::new(LongTermMemory::open(file).expect("a file"));
    let kept = Consolidator::new(Arc::clone(&store), Policies::all(Policy::Everything));
    let memory = WorkingMemory::new(Arc::new(|| KEPT)).with_limits(MemoryLimits::default());
    (store, memory.with_backing(Arc::new(kept.expect("it can be read"))))
}

/// A store of a hundred thousand snapshots.
fn filled(folder: &Path) -> (Arc<LongTermMemory>, WorkingMemory) {
    let (store, memory) = agent(&folder.join("agent.redb"));
    for g in 0..KEPT / 1000 {
        let group: Vec<_> = (0..1000).map(|i| snapshot(i, g + 1, 1000)).collect();
        store.persist(&group).expect("a disk");
    }
    (store, memory)
}

fn groups(folder: &Path) {
    let (_, memory) = agent(&folder.join("groups.redb"));
    for group in [1000, 10_000] {
        let start = Meter::start();
        for g in 0..KEPT / group {
            let updates = (0..group).map(|i| commit((g * group + i) % 1000, 1000));
            memory.commit_now(updates.collect()).expect("it fits");
        }
        start.say(&format!("durable commits of {group} x 1 kB through working memory"), KEPT);
    }
}

fn ten_writers(folder: &Path) {
    let (_, memory) = agent(&folder.join("writers.redb"));
    let mut ours = 0.0;
    for bytes in [100, 1000] {
        let start = of_all_writers(|writer, g| {
            let name = |i| writer * 1000 + (g * TOGETHER + i) % 1000;
            let updates = (0..TOGETHER).map(|i| commit(name(i), bytes));
            memory.commit_now(updates.collect()).expect("it fits");
        });
        let what = format!("durable updates of {WRITERS} writers, {TOGETHER} x {bytes} B at once");
        // With a kilobyte each it is the disk that is measured, beside bare redb.
        ours = if bytes == 100 { start.at_least(&what, KEPT, 100_000.0) } else { start.say(&what, KEPT) };
    }
    let bare = Database::create(folder.join("writers.bare.redb")).expect("a file");
    let start = of_all_writers(|writer, g| {
        put_bare(&bare, (0..TOGETHER).map(|i| (writer, g * TOGETHER + i)));
    });
    let raw = start.say("  bare redb, 1000 B each", KEPT);
    at_most("  bare redb's rate, times ours", raw / ours, "", 1.5);
}

/// Writes all groups of all writers, each on a thread of its own.
fn of_all_writers(write: impl Fn(u64, u64) + Sync) -> Meter {
    let (start, write) = (Meter::start(), &write);
    std::thread::scope(|scope| {
        for writer in 0..WRITERS {
            scope.spawn(move || (0..KEPT / WRITERS / TOGETHER).for_each(|g| write(writer, g)));
        }
    });
    start
}

fn committed(memory: &WorkingMemory) -> Duration {
    let update = vec![commit(1_000_000, 1000)];
    let start = Meter::start();
    memory.commit_now(update).expect("it fits");
    start.elapsed()
}

fn committed_bare(bare: &Database, version: u64) -> Duration {
    let start = Meter::start();
    put_bare(bare, [(1_000_000, version)].into_iter());
    start.elapsed()
}

fn one_writer(bare: &Database, memory: &WorkingMemory) {
    let (mut raw, mut at_once, mut ours) = (Vec::new(), Vec::new(), Vec::new());
    for version in 1..=PAIRS {
        raw.push(committed_bare(bare, version));
        let start = Meter::start();
        put_to_open_at_once(bare, [(1_000_000, version)].into_iter());
        at_once.push(start.elapsed());
        ours.push(committed(memory));
    }
    say("slowest commit of bare redb", slowest(&raw), "ms", "");
    say("slowest durable commit", slowest(&ours), "ms", "");
    let (raw, at_once, ours) = (median(raw), median(at_once), median(ours));
    say("durable commit of one writer, median", ours, "us", "");
    at_most("  times that of a bare redb file of as many rows", ours / raw, "", 1.3);
    say("  times that of one that is opened at once after a kill, too", ours / at_once, "", "");
}

fn slowest(times: &[Duration]) -> f64 {
    times.iter().max().map_or(0.0, |time| time.as_secs_f64() * 1e3)
}

/// Commits while `work` is done, and commits of bare redb while the same work is done again: both have the same disk to wait for.
fn beside(bare: &Database, memory: &WorkingMemory, what: &str, work: &(dyn Fn() + Sync)) {
    let until_done = |one: &mut dyn FnMut() -> Duration| {
        let ended = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                work();
                ended.store(true, Ordering::Release);
            });
            let mut times = vec![one()];
            while !ended.load(Ordering::Acquire) {
                times.push(one());
            }
            times
        })
    };
    let ours = until_done(&mut || committed(memory));
    let mut version = PAIRS;
    let raw = until_done(&mut || {
        version += 1;
        committed_bare(bare, version)
    });
    let words = format!("slowest durable commit of {} beside {what}", ours.len());
    at_most(&words, slowest(&ours), "ms", 20.0);
    say(&format!("  of {} in bare redb, in a file of its own", raw.len()), slowest(&raw), "ms", "");
}
