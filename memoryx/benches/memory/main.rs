//! How fast memory is: `cargo bench -p armarium-memoryx`. A bare map, a bare redb file and the bare session run
//! beside it for comparison. Arguments select the parts whose names contain one of them: `working`, `finding`, `beside`,
//! `store`, `durable`, `starts`, `shared`, `scale`, `link`; and those that only run when they are named, `minutes` (ten minutes of images in
//! real time, 17 GB of disk), `ages` and `names` (forgetting, minutes). The status is 1 when a figure misses what is asked.
//!
//! Rates depend on the other load of the machine; so the processor time of each item is printed too.

#![allow(clippy::print_stdout, reason = "it prints figures")]

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use armarium_memoryx::{
    Commit, Consolidator, EntityId, LongTermMemory, MemoryLimits, Policies, WorkingMemory,
};
use armarium_values::Value;

mod beside;
mod durable;
mod finding;
mod forgets;
mod frames;
mod link;
mod meter;
#[path = "../../tests/proxy.rs"]
mod proxy;
mod scale;
mod shared;
mod starts;
mod store;
mod working;

use meter::{Meter, at_most, resident_mb, say};

fn id(n: u64) -> EntityId {
    EntityId::new("Things", "bench", &format!("e{n}")).expect("a name")
}

fn commit(n: u64, bytes: usize) -> Commit {
    Commit::new(id(n), n, [("data", Value::Bytes(vec![n as u8; bytes]))])
}

/// A memory on a file, which has what the policies select.
fn on_file(file: &Path, policies: Policies, limits: MemoryLimits) -> (Arc<LongTermMemory>, WorkingMemory) {
    let store = Arc::new(LongTermMemory::open(file).expect("a file"));
    let kept = Consolidator::new(Arc::clone(&store), policies).expect("it can be read");
    let memory = WorkingMemory::new(Arc::new(|| 0)).with_limits(limits).with_backing(Arc::new(kept));
    (store, memory)
}

fn median(mut times: Vec<Duration>) -> f64 {
    times.sort_unstable();
    times[times.len() / 2].as_secs_f64() * 1e6
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let is_wanted = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w.as_str()));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.expect("threads");
    if is_wanted("working") {
        working::in_process();
        working::a_million();
        working::together();
    }
    if is_wanted("finding") {
        finding::finding();
    }
    if is_wanted("beside") {
        runtime.block_on(beside::beside());
    }
    if is_wanted("store") {
        store::long_term();
    }
    if is_wanted("durable") {
        durable::durable();
    }
    if is_wanted("starts") {
        runtime.block_on(starts::starts());
    }
    if wanted.iter().any(|word| word == "minutes") {
        frames::ten_minutes(&wanted);
    }
    if wanted.iter().any(|word| word == "ages") {
        forgets::by_age();
    }
    if wanted.iter().any(|word| word == "names") {
        forgets::names();
    }
    if is_wanted("shared") {
        runtime.block_on(shared::shared());
    }
    if is_wanted("scale") {
        runtime.block_on(scale::scale());
    }
    if is_wanted("link") {
        runtime.block_on(link::link());
    }
    let missed = meter::missed();
    if missed > 0 {
        println!("{missed} figures miss what is asked");
        std::process::exit(1);
    }
}
