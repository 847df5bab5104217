//! Memory over Zenoh, beside the bare session: both ends in this process, over TCP on loopback.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use armarium_bus::{Key, Payload, Session, SessionConfig, Subscription, decode, encode, keys};
use armarium_memoryx::wire::{ChangesMessage, CommitRequest};
use armarium_memoryx::{
    Change, EntityId, Follower, Memory, MemoryLimits, MemoryServer, Pattern, RemoteMemory, ServerOptions,
    WorkingMemory,
};
use tokio::task::JoinSet;

use super::proxy::counting_proxy;
use super::{Meter, at_most, commit, id, median, say};

/// Queries and messages whose latency is measured.
const TIMES: u64 = 2000;
/// Updates that are sent as fast as possible.
const UPDATES: u64 = 400_000;

pub(super) async fn shared() {
    codec();
    let far = Session::open(&SessionConfig::default()).await.expect("a session");
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.expect("a session");
    let clock = far.clone();
    let memory = WorkingMemory::new(Arc::new(move || clock.now_ns()));
    let memory = Arc::new(memory.with_limits(MemoryLimits { history: 64, ..MemoryLimits::default() }));
    let _server = MemoryServer::start(&far, "alice", Arc::clone(&memory), ServerOptions::default())
        .await
        .expect("it is shared");
    let remote = RemoteMemory::connect(&near, "alice").await.expect("it answers");
    let mut bare = Bare::start(&near, &far).await;
    latencies(&memory, &remote, &mut bare).await;
    bare.rate().await;
    rates(&memory, &remote).await;
    connecting(&far, &memory).await;
}

/// Measures a program that opens its session, connects, reads one small entity beside 2 000 large ones, and ends.
async fn connecting(far: &Session, memory: &WorkingMemory) {
    memory
        .commit_now((0..2000).map(|n| commit(n, 20_000)).chain([commit(2000, 100)]).collect())
        .expect("it fits");
    let (endpoint, bytes) = counting_proxy(&far.endpoints().await[0]).await;
    let (mut times, mut most) = (Vec::new(), 0);
    for _ in 0..50 {
        let before = bytes[1].load(Ordering::Relaxed);
        let start = Meter::start();
        let near = Session::open(&SessionConfig::connected_to(std::slice::from_ref(&endpoint))).await;
        let near = near.expect("a session");
        let remote = RemoteMemory::connect(&near, "alice").await.expect("it answers");
        remote.latest(&id(2000)).await.expect("it is there");
        times.push(start.elapsed());
        most = most.max(bytes[1].load(Ordering::Relaxed) - before);
    }
    let worst_ms = times.iter().max().map_or(0.0, |worst| worst.as_secs_f64() * 1e3);
    say("session, connection and one entity beside 2000 of 20 kB, median", median(times) * 1e-3, "ms", "");
    at_most("  the slowest of 50", worst_ms, "ms", 30.0);
    at_most("  the most that was received", most as f64, "bytes", 10_000.0);
}

/// Measures updates per second, in each direction.
async fn rates(memory: &Arc<WorkingMemory>, remote: &RemoteMemory) {
    let mut changes = follow(remote).await;
    let start = Meter::start();
    let writing = Arc::clone(memory);
    let writer = tokio::spawn(async move {
        for n in 0..UPDATES / 100 {
            let updates = (0..100).map(|i| commit((n * 100 + i) % 20_000, 100));
            writing.commit_now(updates.collect()).expect("it fits");
            tokio::task::yield_now().await;
        }
    });
    hear(&mut changes, UPDATES).await;
    writer.await.expect("it ends");
    start.at_least("updates of 100 B heard by a remote observer", UPDATES, 200_000.0);
    let start = Meter::start();
    for g in 0..200_u64 {
        let group = (0..1000).map(|i| commit((g * 1000 + i) % 20_000, 100)).collect();
        remote.commit(group).await.expect("it fits");
    }
    start.at_least("updates of 100 B committed from afar, 1000 at once", 200_000, 200_000.0);
    hear(&mut changes, 200_000).await;
    start.say("  and heard back", 200_000);
}

/// Follows a memory from now on.
pub(super) async fn follow(remote: &RemoteMemory) -> Follower {
    let remote = Arc::new(remote.clone());
    Follower::from_now(remote, Pattern::segment("Things")).await.expect("it answers").0
}

pub(super) async fn hear(changes: &mut Follower, count: u64) {
    let mut heard = 0;
    while heard < count {
        match changes.next().await.expect("it answers") {
            Some(Change::New(_)) => heard += 1,
            Some(Change::Missed { from, to, .. }) => heard += to - from + 1,
            None => return,
        }
    }
}

/// Waits for exactly this version, whatever comes before it.
async fn hear_version(changes: &mut Follower, of: &EntityId, version: u64) {
    while let Ok(Some(change)) = changes.next().await {
        if matches!(&change, Change::New(snapshot) if snapshot.version == version && snapshot.id == *of) {
            return;
        }
    }
}

/// Measures one of each kind in turn, again and again, so that all see the same load of the machine.
async fn latencies(memory: &WorkingMemory, remote: &RemoteMemory, bare: &mut Bare) {
    let mut changes = follow(remote).await;
    let mut times: [Vec<Duration>; 5] = std::array::from_fn(|_| Vec::new());
    let one = id(1);
    for _ in 0..TIMES {
        times[0].push(bare.put().await);
        let update = vec![commit(1, 100)];
        let start = Meter::start();
        let version = memory.commit_now(update).expect("it fits")[0];
        hear_version(&mut changes, &one, version).await;
        times[1].push(start.elapsed());
        times[2].push(bare.get().await);
        let start = Meter::start();
        remote.latest(&one).await.expect("it is there");
        times[3].push(start.elapsed());
        let update = vec![commit(1, 100)];
        let start = Meter::start();
        let version = remote.commit(update).await.expect("it fits")[0];
        times[4].push(start.elapsed());
        hear_version(&mut changes, &one, version).await;
    }
    let [put, told, get, asked, taken] = times.map(median);
    say("bare put to subscriber, 100 B, median", put, "us", "");
    say("commit to a remote observer, median", told, "us", "");
    at_most("  times the bare put", told / put, "", 2.5);
    say("bare get, 100 B, median", get, "us", "");
    say("remote query of one entity, median", asked, "us", "");
    at_most("  times the bare get", asked / get, "", 2.0);
    say("remote commit with its answer, median", taken, "us", "");
    say("  times the bare get", taken / get, "", "");
}

/// Measures encoding and decoding of an update, without a network.
fn codec() {
    let memory = WorkingMemory::new(Arc::new(|| 0));
    let updates: Vec<_> = (0..1000).map(|n| commit(n, 100)).collect();
    memory.commit_now(updates.clone()).expect("it fits");
    let snapshots = (0..1000).map(|n| memory.latest_now(&id(n)).expect("it is there")).collect();
    round_trip("changes", &ChangesMessage { epoch: 0, first: 0, until_ns: 0, snapshots });
    round_trip("a commit", &CommitRequest { updates, sent_ns: 0 });
}

fn round_trip<T: Payload>(what: &str, thousand: &T) {
    let start = Meter::start();
    let mut bytes = Vec::new();
    for _ in 0..50 {
        bytes = encode(thousand).expect("it can be written");
    }
    start.say(&format!("{what} of 100 B each: written"), 50_000);
    let start = Meter::start();
    for _ in 0..50 {
        std::hint::black_box(decode::<T>(&bytes).expect("it can be read"));
    }
    start.say(&format!("{what} of 100 B each: read"), 50_000);
}

/// The bare session: the cost of a Zenoh put and get without memory.
struct Bare {
    near: Session,
    far: Session,
    put_on: Key,
    ask_on: Key,
    heard: Subscription,
    /// Number of puts so far; the newest message holds it.
    puts: u64,
    _answering: JoinSet<()>,
}

impl Bare {
    async fn start(near: &Session, far: &Session) -> Self {
        let put_on = keys::live("alice", "bench").expect("a key");
        let ask_on = keys::chart("alice", "bench").expect("a key");
        let heard = near.subscribe(put_on.clone(), 1 << 16).await.expect("a subscription");
        let mut questions = far.declare_queryable(ask_on.clone(), 64).await.expect("a queryable");
        let reply = ask_on.clone();
        let mut answering = JoinSet::new();
        answering.spawn(async move {
            while let Some(question) = questions.next().await {
                question.reply(&reply, "x", vec![0; 100]).await.expect("an answer");
            }
        });
        let (near, far) = (near.clone(), far.clone());
        let mut bare = Self { near, far, put_on, ask_on, heard, puts: 0, _answering: answering };
        // Wait until the other side knows the declarations.
        while bare.heard.try_next().is_none() {
            bare.send().await;
            tokio::task::yield_now().await;
        }
        while bare.near.query_one(&bare.ask_on, "", None).await.is_err() {}
        bare
    }

    /// Puts 100 B that begin with the next number.
    async fn send(&mut self) {
        self.puts += 1;
        let mut payload = vec![0; 100];
        payload[..8].copy_from_slice(&self.puts.to_le_bytes());
        self.far.put(&self.put_on, "x", payload).await.expect("a session");
    }

    /// Measures the time from a put until that message has arrived.
    async fn put(&mut self) -> Duration {
        let start = Meter::start();
        self.send().await;
        let number = self.puts.to_le_bytes();
        while self.heard.next().await.is_some_and(|message| !message.payload.starts_with(&number)) {}
        start.elapsed()
    }

    async fn get(&self) -> Duration {
        let start = Meter::start();
        self.near.query_one(&self.ask_on, "", None).await.expect("an answer");
        start.elapsed()
    }

    async fn rate(&mut self) {
        let start = Meter::start();
        let (sender, put_on) = (self.far.clone(), self.put_on.clone());
        let writer = tokio::spawn(async move {
            for _ in 0..200_000 {
                sender.put_waiting(&put_on, "x", vec![0; 100]).await.expect("a session");
            }
        });
        let mut count = 0;
        while count + self.heard.dropped() < 200_000 && self.heard.next().await.is_some() {
            count += 1;
        }
        writer.await.expect("it ends");
        start.say("bare puts of 100 B heard, one message each", 200_000);
    }
}
