//! What forgetting costs: a store of a gigabyte of which a hundredth becomes too old each minute, and names that come and go for a day.
//! Both take minutes, and are measured when they are named.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use armarium_memoryx::{
    Commit, Consolidator, LongTermMemory, MemoryLimits, Policies, Policy, Retention, WorkingMemory,
};
use armarium_values::Value;

use super::store::snapshot;
use super::{Meter, at_most, id, resident_mb, say};

const MINUTE_NS: u64 = 60_000_000_000;

/// Bytes that this process has written so far, to whatever file.
fn written() -> f64 {
    let io = std::fs::read_to_string("/proc/self/io").unwrap_or_default();
    io.lines().find_map(|line| line.strip_prefix("wchar: ")?.parse().ok()).unwrap_or(f64::NAN)
}

/// A hundred minutes of 10 000 snapshots of 1 kB, of which the first becomes too old with each minute more.
pub(super) fn by_age() {
    let (minutes, each) = (100, 10_000);
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("ages.redb");
    let store = LongTermMemory::open(&file).expect("a file");
    let minute = |minute: u64| {
        for part in 0..each / 1000 {
            let one = |n| {
                let one = snapshot((minute * each + part * 1000 + n) % 50_000, minute + 1, 1000);
                Arc::new(armarium_memoryx::Snapshot { arrived_ns: minute * MINUTE_NS, ..(*one).clone() })
            };
            store.persist(&(0..1000).map(one).collect::<Vec<_>>()).expect("a disk");
        }
    };
    (0..minutes).for_each(minute);
    let retention = Retention { age_ns: Some(minutes * MINUTE_NS), bytes: None };
    let (mut wrote, mut dropped, mut idle) = (0.0, 0.0, 0.0);
    let gb = std::fs::metadata(&file).map_or(0.0, |about| about.len() as f64 * 1e-9);
    let start = Meter::start();
    for now in minutes..minutes + 10 {
        minute(now);
        let now_ns = (now + 1) * MINUTE_NS;
        let before = written();
        dropped += store.retain(retention, now_ns).expect("a disk").bytes as f64;
        wrote += written() - before;
        let before = written();
        store.retain(retention, now_ns).expect("a disk");
        idle += written() - before;
    }
    say(
        &format!("ten minutes' snapshots become too old, in a file of {gb:.1} GB"),
        start.elapsed().as_secs_f64(),
        "s",
        "",
    );
    at_most("  bytes written, times those forgotten", wrote / dropped, "", 3.0);
    at_most("  bytes written when nothing is too old", idle, "bytes", 0.0);
}

/// 10 000 names a minute come and go for a day, through working memory.
pub(super) fn names() {
    let (megabytes, each, minutes) = (100, 10_000, 24 * 60);
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("names.redb");
    let store = Arc::new(LongTermMemory::open(&file).expect("a file"));
    let now_ns = Arc::new(AtomicU64::new(0));
    let clock = Arc::clone(&now_ns);
    let kept =
        Consolidator::new(Arc::clone(&store), Policies::all(Policy::Everything)).expect("it can be read");
    let memory = WorkingMemory::new(Arc::new(move || clock.load(Ordering::Relaxed)))
        .with_limits(MemoryLimits::default())
        .with_backing(Arc::new(kept));
    let retention = Retention { age_ns: None, bytes: Some(megabytes * 1_000_000) };
    let before = resident_mb();
    let (mut largest_mb, mut resident, mut over) = (0.0_f64, 0.0_f64, 0);
    let start = Meter::start();
    for minute in 0..minutes {
        now_ns.store(minute * MINUTE_NS, Ordering::Relaxed);
        for part in 0..each / 1000 {
            let names = (0..1000).map(|n| id(minute * each + part * 1000 + n));
            let born = |id| Commit::new(id, minute, [("value", Value::Int(1))]);
            memory.commit_now(names.clone().map(born).collect()).expect("it fits");
            memory.commit_now(names.map(|id| Commit::removal(id, minute)).collect()).expect("it fits");
        }
        over += store.keep_within(retention, minute * MINUTE_NS).expect("a disk").over;
        largest_mb = largest_mb.max(store.stats().expect("it can be read").file_bytes as f64 * 1e-6);
        resident = resident.max(resident_mb() - before);
    }
    start.say(&format!("names that come and go, {each} a minute for {minutes} minutes"), each * minutes);
    at_most("  largest file after a minute", largest_mb, "MB", megabytes as f64);
    at_most("  bytes over the limit", over as f64, "bytes", 0.0);
    at_most("  memory of the process for it", resident, "MB", megabytes as f64);
    say("  entities in working memory at the end", memory.len() as f64, "", "");
}
