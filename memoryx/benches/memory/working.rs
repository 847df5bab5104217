//! Working memory in this process.

use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{EntityId, MemoryLimits, WorkingMemory};
use indexmap::IndexMap;

use super::{Meter, at_most, commit, id, median, resident_mb, say};

/// How many entities are looked up in one go, and how often, in turn with the bare map.
const LOOKS: u64 = 10_000;
const ROUNDS: u64 = 21;

pub(super) fn in_process() {
    let memory = WorkingMemory::new(Arc::new(|| 0));
    let mut times = Vec::new();
    for i in 0..20_000 {
        let update = vec![commit(i % 100, 1000)];
        let start = Meter::start();
        memory.commit_now(update).expect("it fits");
        times.push(start.elapsed());
    }
    at_most("commit in process, 1 kB, median", median(times), "us", 2.0);
}

/// Many updates in each commit, among many entities whose histories are long.
pub(super) fn together() {
    let limits = MemoryLimits { history: 64, ..MemoryLimits::default() };
    let memory = WorkingMemory::new(Arc::new(|| 0)).with_limits(limits);
    let write = |updates: u64| {
        for n in 0..updates / 100 {
            let updates = (0..100).map(|i| commit((n * 100 + i) % 20_000, 100));
            memory.commit_now(updates.collect()).expect("it fits");
        }
    };
    // So that every history is full.
    write(20_000 * 64);
    let start = Meter::start();
    write(400_000);
    start.say("updates of 100 B in process, 100 at once among 20 000", 400_000);
}

fn looked_up<T>(ids: &[EntityId], mut look: impl FnMut(&EntityId) -> T) -> Duration {
    let start = Meter::start();
    for id in ids {
        std::hint::black_box(look(id));
    }
    start.elapsed() / LOOKS as u32
}

pub(super) fn a_million() {
    let before = resident_mb();
    let memory = WorkingMemory::new(Arc::new(|| 0))
        .with_limits(MemoryLimits { entities: 1_000_000, ..MemoryLimits::default() });
    let mut bare: IndexMap<String, Arc<u64>> = IndexMap::new();
    let mut held = 0;
    for count in [1000, 1_000_000] {
        for n in held..count {
            memory.commit_now(vec![commit(n, 200)]).expect("it fits");
        }
        if count == 1_000_000 {
            at_most("1 000 000 entities of 200 B", resident_mb() - before, "MB", 1000.0);
        }
        bare.extend((held..count).map(|n| (id(n).as_str().to_owned(), Arc::new(n))));
        held = count;
        let (mut ours, mut raw) = (Vec::new(), Vec::new());
        for round in 0..ROUNDS {
            let ids: Vec<_> = (0..LOOKS).map(|i| id((i + round * LOOKS) * 7919 % count)).collect();
            ours.push(looked_up(&ids, |id| memory.latest_now(id).expect("it is there")));
            raw.push(looked_up(&ids, |id| bare.get(id.as_str()).cloned()));
        }
        let (ours, bare) = (median(ours), median(raw));
        at_most(&format!("latest by id among {count}, median of {ROUNDS}"), ours, "us", 2.0);
        say(&format!("  a bare map's lookup among {count}"), bare, "us", "");
    }
}
