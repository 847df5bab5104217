//! Memory over Zenoh, beside the bare session: both ends in this process, over TCP on loopback.

use std::sync::Arc;

use armarium_bus::{Payload, Session, SessionConfig, decode, encode, keys};
use armarium_memoryx::wire::{Changes, CommitRequest};
use armarium_memoryx::{Limits, Memory, MemoryServer, RemoteMemory, Snapshot, WorkingMemory};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;

use super::{Meter, commit, id, median, say};

/// Questions and messages whose latency is measured.
const TIMES: u64 = 2000;
/// Updates that are sent as fast as they go.
const UPDATES: u64 = 400_000;

pub(super) async fn shared() {
    codec();
    let far = Session::open(&SessionConfig::default()).await.expect("a session");
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.expect("a session");
    let (raw_put, raw_get) = bare_session(&near, &far).await;
    let clock = far.clone();
    let memory = WorkingMemory::new(Arc::new(move || clock.now_ns()));
    let memory = Arc::new(memory.with_limits(Limits { history: 64, ..Limits::default() }));
    let _server = MemoryServer::start(&far, "alice", Arc::clone(&memory)).await.expect("it is shared");
    let remote = RemoteMemory::connect(&near, "alice").await.expect("it answers");
    latencies(&memory, &remote, raw_put, raw_get).await;
    let mut changes = remote.subscribe();
    let start = Meter::start();
    let writing = Arc::clone(&memory);
    let writer = tokio::spawn(async move {
        for n in 0..UPDATES / 100 {
            let updates = (0..100).map(|i| commit((n * 100 + i) % 20_000, 100));
            writing.commit_now(updates.collect()).expect("it fits");
            tokio::task::yield_now().await;
        }
    });
    hear(&mut changes, UPDATES).await;
    writer.await.expect("it ends");
    start.say("updates of 100 B heard by a remote observer", UPDATES, "asked: 200 000");
    let start = Meter::start();
    for g in 0..200_u64 {
        let group = (0..1000).map(|i| commit((g * 1000 + i) % 20_000, 100)).collect();
        remote.commit(group).await.expect("it fits");
    }
    start.say("updates of 100 B committed from afar, 1000 at once", 200_000, "asked: 200 000");
    hear(&mut changes, 200_000).await;
    start.say("  and heard back", 200_000, "");
}

pub(super) async fn hear(changes: &mut Receiver<Arc<Snapshot>>, count: u64) {
    let mut heard = 0;
    while heard < count {
        match changes.recv().await {
            Ok(_) => heard += 1,
            Err(RecvError::Lagged(missed)) => heard += missed,
            Err(RecvError::Closed) => return,
        }
    }
}

async fn latencies(memory: &WorkingMemory, remote: &RemoteMemory, raw_put: f64, raw_get: f64) {
    let mut changes = remote.subscribe();
    let (mut told, mut asked, mut taken) = (Vec::new(), Vec::new(), Vec::new());
    for n in 0..TIMES {
        let update = vec![commit(n % 10, 100)];
        let start = Meter::start();
        memory.commit_now(update).expect("it fits");
        changes.recv().await.expect("it is told");
        told.push(start.elapsed());
    }
    for _ in 0..TIMES {
        let start = Meter::start();
        remote.latest(&id(1)).await.expect("it is there");
        asked.push(start.elapsed());
    }
    for n in 0..TIMES {
        let update = vec![commit(n % 10, 100)];
        let start = Meter::start();
        remote.commit(update).await.expect("it fits");
        taken.push(start.elapsed());
    }
    for (what, time, raw, asked) in [
        ("commit to a remote observer, median", median(told), raw_put, "asked: 2.5"),
        ("remote query of one entity, median", median(asked), raw_get, "asked: 2"),
        ("remote commit with its answer, median", median(taken), raw_get, ""),
    ] {
        say(what, time, "us", "");
        say("  times the bare one", time / raw, "", asked);
    }
}

/// What an update costs to write and to read, without a network.
fn codec() {
    let memory = WorkingMemory::new(Arc::new(|| 0));
    let updates: Vec<_> = (0..1000).map(|n| commit(n, 100)).collect();
    memory.commit_now(updates.clone()).expect("it fits");
    let snapshots = (0..1000).map(|n| memory.latest_now(&id(n)).expect("it is there")).collect();
    round_trip("changes", &Changes { epoch: 0, first: 0, snapshots });
    round_trip("a commit", &CommitRequest { updates, sent_ns: 0 });
}

fn round_trip<T: Payload>(what: &str, thousand: &T) {
    let start = Meter::start();
    let mut bytes = Vec::new();
    for _ in 0..50 {
        bytes = encode(thousand).expect("it can be written");
    }
    start.say(&format!("{what} of 100 B each: written"), 50_000, "");
    let start = Meter::start();
    for _ in 0..50 {
        std::hint::black_box(decode::<T>(&bytes).expect("it can be read"));
    }
    start.say(&format!("{what} of 100 B each: read"), 50_000, "");
}

/// Median latency of a put and of a get, us.
async fn bare_session(near: &Session, far: &Session) -> (f64, f64) {
    let key = keys::trace("alice", "bench").expect("a key");
    let mut heard = near.subscribe(key.clone(), 1 << 16).await.expect("a subscription");
    while heard.try_next().is_none() {
        far.put(&key, "x", vec![0; 100]).await.expect("a session");
        tokio::task::yield_now().await;
    }
    while heard.try_next().is_some() {}
    let mut times = Vec::new();
    for _ in 0..TIMES {
        let start = Meter::start();
        far.put(&key, "x", vec![0; 100]).await.expect("a session");
        heard.next().await.expect("it arrives");
        times.push(start.elapsed());
    }
    let put = median(times);
    say("bare put to subscriber, 100 B, median", put, "us", "");
    let start = Meter::start();
    let (sender, putting) = (far.clone(), key.clone());
    let writer = tokio::spawn(async move {
        for _ in 0..200_000 {
            sender.put_waiting(&putting, "x", vec![0; 100]).await.expect("a session");
        }
    });
    let mut count = 0;
    while count + heard.dropped() < 200_000 && heard.next().await.is_some() {
        count += 1;
    }
    writer.await.expect("it ends");
    start.say("bare puts of 100 B heard, one message each", 200_000, "");
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
    for _ in 0..TIMES {
        let start = Meter::start();
        near.ask_one(&key, "", None).await.expect("an answer");
        times.push(start.elapsed());
    }
    let get = median(times);
    say("bare get, 100 B, median", get, "us", "");
    (put, get)
}
