//! How long a memory takes to start: on a file of many entities, and on a large one whose process was killed.

use std::sync::Arc;

use armarium_memoryx::{LongTermMemory, MemoryLimits, Policies, Policy};

use super::store::snapshot;
use super::{Meter, at_most, id, on_file, say};

const ENTITIES: u64 = 200_000;
/// Snapshots of 1 kB in the large file, in groups of a thousand.
const GROUPS: u64 = 2000;

pub(super) async fn starts() {
    let folder = tempfile::tempdir().expect("a folder");
    let many = folder.path().join("many.redb");
    let store = LongTermMemory::open(&many).expect("a file");
    for g in 0..ENTITIES / 1000 {
        let group: Vec<_> = (0..1000).map(|i| snapshot(g * 1000 + i, 1, 200)).collect();
        store.persist(&group).expect("a disk");
    }
    drop(store);
    start_on(&many, &format!("{ENTITIES} entities"), ENTITIES, 300.0).await;

    let large = folder.path().join("large.redb");
    let store = LongTermMemory::open(&large).expect("a file");
    for g in 0..GROUPS {
        let group: Vec<_> = (0..1000).map(|i| snapshot(i, g + 1, 1000)).collect();
        store.persist(&group).expect("a disk");
    }
    // A copy of an open file stands for the file of a killed process.
    let killed = folder.path().join("killed.redb");
    std::fs::copy(&large, &killed).expect("room");
    drop(store);
    let gb = std::fs::metadata(&killed).map_or(0.0, |about| about.len() as f64 * 1e-9);
    start_on(&killed, &format!("{gb:.1} GB whose process was killed"), 1000, 1000.0).await;
}

/// Starts until one entity is read, and until all are.
async fn start_on(file: &std::path::Path, what: &str, entities: u64, asked_ms: f64) {
    let start = Meter::start();
    let (store, memory) = on_file(file, Policies::all(Policy::Everything), MemoryLimits::of_agent());
    let memory = Arc::new(memory);
    let _loading = store.load_beside(&memory).expect("a thread");
    memory.latest_now(&id(entities - 1)).expect("it is there");
    let ms = start.elapsed().as_secs_f64() * 1e3;
    at_most(&format!("start on {what}, until one is read"), ms, "ms", asked_ms);
    while memory.len() < entities as usize {
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
    let ms = start.elapsed().as_secs_f64() * 1e3;
    say("  until all are in working memory", ms, "ms", "");
}
