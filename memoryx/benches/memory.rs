//! How fast memory is, with a bare redb file and the bare session in the same run for scale:
//! `cargo bench -p armarium-memoryx`. A word picks those whose names hold it.

#![allow(clippy::print_stdout, clippy::disallowed_methods)] // It prints figures of the wall clock.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use armarium_bus::{Session, SessionConfig, keys};
use armarium_memoryx::{
    Commit, Consolidator, EntityId, Instance, Limits, LongTermMemory, Memory, MemoryServer, Pattern,
    Policies, Policy, Query, RemoteMemory, Snapshot, WorkingMemory,
};
use armarium_values::Value;
use redb::{Database, TableDefinition};

const BARE: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("bare");

fn id(n: u64) -> EntityId {
    EntityId::new("Things", "bench", &format!("e{n}")).expect("a name")
}

fn commit(n: u64, bytes: usize) -> Commit {
    Commit::new(id(n), n, [("data", Value::Bytes(vec![n as u8; bytes]))])
}

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

fn memory(limits: Limits) -> WorkingMemory {
    WorkingMemory::new(Arc::new(|| 0)).with_limits(limits)
}

fn median(mut times: Vec<Duration>) -> f64 {
    times.sort_unstable();
    times[times.len() / 2].as_secs_f64() * 1e6
}

fn say(what: &str, figure: f64, unit: &str, asked: &str) {
    println!("{what:<58} {figure:>12.2} {unit:<12} {asked}");
}

fn per_second(count: u64, start: Instant) -> f64 {
    count as f64 / start.elapsed().as_secs_f64()
}

fn resident_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap_or("0");
    line.trim().trim_end_matches(" kB").trim().parse::<f64>().unwrap_or(0.0) / 1024.0
}

fn in_process() {
    let memory = memory(Limits::default());
    let mut times = Vec::new();
    for i in 0..20_000 {
        let update = vec![commit(i % 100, 1000)];
        let start = Instant::now();
        memory.commit_now(update).expect("it fits");
        times.push(start.elapsed());
    }
    say("commit in process, 1 kB, median", median(times), "us", "asked: 2");
}

fn a_million() {
    let before = resident_mb();
    let memory = memory(Limits { entities: 1_000_000, ..Limits::default() });
    let look = |memory: &WorkingMemory, count: u64| {
        let ids: Vec<EntityId> = (0..10_000).map(|i| id(i * 7919 % count)).collect();
        let start = Instant::now();
        for id in &ids {
            std::hint::black_box(memory.latest_now(id).expect("it is there"));
        }
        start.elapsed().as_secs_f64() * 1e6 / 10_000.0
    };
    for n in 0..1000 {
        memory.commit_now(vec![commit(n, 200)]).expect("it fits");
    }
    say("latest by id among 1 000", look(&memory, 1000), "us", "");
    for n in 1000..1_000_000 {
        memory.commit_now(vec![commit(n, 200)]).expect("it fits");
    }
    say("latest by id among 1 000 000", look(&memory, 1_000_000), "us", "asked: independent");
    say("1 000 000 entities of 200 B", resident_mb() - before, "MB", "asked: 1000");
}

fn long_term() {
    let folder = tempfile::tempdir().expect("a folder");
    let bare = Database::create(folder.path().join("bare.redb")).expect("a file");
    let mut times = Vec::new();
    for n in 0..300 {
        let start = Instant::now();
        let write = bare.begin_write().expect("a transaction");
        write.open_table(BARE).expect("a table").insert(n, [7; 1000].as_slice()).expect("room");
        write.commit().expect("a disk");
        times.push(start.elapsed());
    }
    let raw = median(times);
    let store = LongTermMemory::open(&folder.path().join("ours.redb")).expect("a file");
    let mut times = Vec::new();
    for version in 1..=300 {
        let one = [snapshot(0, version, 1000)];
        let start = Instant::now();
        store.persist(&one).expect("a disk");
        times.push(start.elapsed());
    }
    let ours = median(times);
    say("bare redb commit, 1 kB, durable, median", raw, "us", "");
    say("durable commit of one snapshot, 1 kB, median", ours, "us", "");
    say("  times the bare one", ours / raw, "", "asked: at most 2");
    for (what, entities) in [("of 10 entities", 10), ("of 1000 entities", 1000)] {
        let store = LongTermMemory::open(&folder.path().join(format!("{entities}.redb"))).expect("a file");
        let groups: Vec<Vec<_>> = (0..100_u64)
            .map(|g| {
                let each = 1000 / entities;
                (0..1000).map(|i| snapshot(i % entities, g * each + i / entities + 1, 1000)).collect()
            })
            .collect();
        let start = Instant::now();
        for group in &groups {
            store.persist(group).expect("a disk");
        }
        say(
            &format!("1 kB snapshots in groups of 1000, {what}"),
            per_second(100_000, start),
            "/s",
            "asked: 100 000",
        );
        let start = Instant::now();
        let mut count = 0;
        store
            .scan(|_| {
                count += 1;
                true
            })
            .expect("it can be read");
        say(
            &format!("scan of {count} snapshots of 1 kB, {what}"),
            per_second(count, start),
            "/s",
            "asked: 1 000 000",
        );
        let start = Instant::now();
        let found = store.query(&Query::history(Pattern::entity(&id(1)))).expect("it can be read");
        say(&format!("history of one entity, {what}"), per_second(found.len() as u64, start), "/s", "");
    }
    let store = LongTermMemory::open(&folder.path().join("small.redb")).expect("a file");
    for g in 0..50 {
        let group: Vec<_> = (0..10_000).map(|i| snapshot(i % 100, g * 100 + i / 100 + 1, 100)).collect();
        store.persist(&group).expect("a disk");
    }
    let start = Instant::now();
    let mut count = 0;
    store
        .scan(|_| {
            count += 1;
            true
        })
        .expect("it can be read");
    say(&format!("scan of {count} snapshots of 100 B"), per_second(count, start), "/s", "asked: 1 000 000");
    let mut noise = 1_u64;
    let frames: Vec<_> = (1..=90_u64)
        .map(|version| {
            let pixels = (0..640 * 480 * 3).map(|_| {
                noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (noise >> 56) as u8
            });
            let attributes = [("pixels", Value::Bytes(pixels.collect()))];
            Arc::new(Snapshot {
                instances: vec![Instance::new(attributes)],
                ..(*snapshot(0, version, 0)).clone()
            })
        })
        .collect();
    let start = Instant::now();
    for frame in frames {
        store.persist(&[Arc::new(Snapshot { id: id(1_000_000), ..(*frame).clone() })]).expect("a disk");
    }
    say("noisy 640x480 RGB frames, durable, one by one", per_second(90, start), "frames/s", "asked: 30");
}

async fn shared() {
    let far = Session::open(&SessionConfig::default()).await.expect("a session");
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.expect("a session");
    bare_session(&near, &far).await;
    let memory = Arc::new(memory(Limits { history: 64, ..Limits::default() }));
    let _server = MemoryServer::start(&far, "alice", Arc::clone(&memory)).await.expect("it is shared");
    let remote = RemoteMemory::connect(&near, "alice").await.expect("it answers");
    let mut changes = remote.subscribe();
    let mut times = Vec::new();
    for n in 0..2000 {
        let update = vec![commit(n % 10, 100)];
        let start = Instant::now();
        memory.commit_now(update).expect("it fits");
        changes.recv().await.expect("it is told");
        times.push(start.elapsed());
    }
    say("commit to a remote observer, median", median(times), "us", "asked: 2.5 x raw put");
    let mut times = Vec::new();
    for _ in 0..2000 {
        let start = Instant::now();
        remote.latest(&id(1)).await.expect("it is there");
        times.push(start.elapsed());
    }
    say("remote query of one entity, median", median(times), "us", "asked: 2 x raw get");
    let count = 400_000;
    let start = Instant::now();
    let writing = Arc::clone(&memory);
    let writer = tokio::spawn(async move {
        for n in 0..count / 100 {
            writing
                .commit_now((0..100).map(|i| commit((n * 100 + i) % 20_000, 100)).collect())
                .expect("it fits");
            tokio::task::yield_now().await;
        }
    });
    let mut heard = 0;
    while heard < count {
        match changes.recv().await {
            Ok(_) => heard += 1,
            Err(tokio::sync::broadcast::error::RecvError::Lagged(missed)) => heard += missed,
            Err(_) => break,
        }
    }
    writer.await.expect("it ends");
    say("updates of 100 B heard by a remote observer", per_second(count, start), "/s", "asked: 200 000");
    let groups: Vec<Vec<_>> =
        (0..200_u64).map(|g| (0..1000).map(|i| commit(g * 50 + i % 20_000, 100)).collect()).collect();
    let start = Instant::now();
    for group in groups {
        remote.commit(group).await.expect("it fits");
    }
    say(
        "updates of 100 B committed from afar, 1000 at once",
        per_second(200_000, start),
        "/s",
        "asked: 200 000",
    );
    let mut times = Vec::new();
    for n in 0..2000 {
        let update = vec![commit(n % 10, 100)];
        let start = Instant::now();
        remote.commit(update).await.expect("it fits");
        times.push(start.elapsed());
    }
    say("remote commit with its answer, median", median(times), "us", "");
}

async fn bare_session(near: &Session, far: &Session) {
    let key = keys::trace("alice", "bench").expect("a key");
    let mut heard = near.subscribe(key.clone(), 1 << 16).await.expect("a subscription");
    while heard.try_next().is_none() {
        far.put(&key, "x", vec![0; 100]).await.expect("a session");
        tokio::task::yield_now().await;
    }
    while heard.try_next().is_some() {}
    let mut times = Vec::new();
    for _ in 0..2000 {
        let start = Instant::now();
        far.put(&key, "x", vec![0; 100]).await.expect("a session");
        heard.next().await.expect("it arrives");
        times.push(start.elapsed());
    }
    say("bare put to subscriber, 100 B, median", median(times), "us", "");
    let key = keys::chart("alice", "bench").expect("a key");
    let mut questions = far.answer(key.clone(), 64).await.expect("a queryable");
    let reply = key.clone();
    tokio::spawn(async move {
        while let Some(question) = questions.next().await {
            question.reply(&reply, "x", vec![0; 100]).await.expect("an answer");
        }
    });
    while near.ask_one(&key, "", None).await.is_err() {}
    let mut times = Vec::new();
    for _ in 0..2000 {
        let start = Instant::now();
        near.ask_one(&key, "", None).await.expect("an answer");
        times.push(start.elapsed());
    }
    say("bare get, 100 B, median", median(times), "us", "");
}

async fn durable_agent() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = Arc::new(LongTermMemory::open(&folder.path().join("agent.redb")).expect("a file"));
    let kept = Consolidator::new(store, Policies::all(Policy::Everything));
    let memory = Arc::new(memory(Limits::default()).with_backing(Arc::new(kept)));
    let start = Instant::now();
    for g in 0..100 {
        memory.commit_now((0..1000).map(|i| commit(g * 10 + i % 1000, 1000)).collect()).expect("it fits");
    }
    say(
        "durable commits of 1000 x 1 kB through working memory",
        per_second(100_000, start),
        "/s",
        "asked: 100 000",
    );
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let is_wanted = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w.as_str()));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.expect("threads");
    let parts: BTreeMap<&str, fn()> =
        [("1 in process", in_process as fn()), ("2 million", a_million), ("3 store", long_term)].into();
    for (name, part) in parts {
        if is_wanted(name) {
            part();
        }
    }
    if is_wanted("durable agent") {
        runtime.block_on(durable_agent());
    }
    if is_wanted("shared") {
        runtime.block_on(shared());
    }
}
