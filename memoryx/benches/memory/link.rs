//! Bytes on an agent's link to the router, and bytes of a snapshot in long-term memory. Neither depends on the
//! machine.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::{Consolidator, LongTermMemory, MemoryLimits, Policies, Policy, WorkingMemory};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;

use super::scale::{Agent, agent, client, following, router, told};
use super::{commit, say};

/// Until messages in flight have arrived, and idle memories have published their number of changes.
const SETTLED: Duration = Duration::from_millis(400);
/// How long idle agents are measured.
const IDLE: Duration = Duration::from_secs(10);

/// A TCP proxy to a router that counts its bytes.
struct CountingProxy {
    endpoint: String,
    up: Arc<AtomicU64>,
    down: Arc<AtomicU64>,
    _tasks: JoinSet<()>,
}

impl CountingProxy {
    async fn to(router: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let endpoint = format!("tcp/{}", listener.local_addr().expect("an address"));
        let (up, down) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let (counts_up, counts_down) = (Arc::clone(&up), Arc::clone(&down));
        let mut tasks = JoinSet::new();
        tasks.spawn(async move {
            let (near, _) = listener.accept().await.expect("a connection");
            let far = TcpStream::connect(router).await.expect("a router");
            let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
            tokio::join!(pass(from_near, to_far, &counts_up), pass(from_far, to_near, &counts_down));
        });
        Self { endpoint, up, down, _tasks: tasks }
    }

    /// Bytes to the router and from it since the last call.
    fn bytes(&self) -> (f64, f64) {
        let taken = |count: &AtomicU64| count.swap(0, Ordering::Relaxed) as f64;
        (taken(&self.up), taken(&self.down))
    }

    fn say(&self, what: &str, count: u64) {
        let (up, down) = self.bytes();
        say(&format!("{what}: to the router"), up / count as f64, "bytes", "");
        say(&format!("{what}: from it"), down / count as f64, "bytes", "");
    }
}

async fn pass(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, count: &AtomicU64) {
    let mut buffer = vec![0; 1 << 16];
    while let Ok(read @ 1..) = from.read(&mut buffer).await {
        count.fetch_add(read as u64, Ordering::Relaxed);
        if to.write_all(&buffer[..read]).await.is_err() {
            return;
        }
    }
}

async fn on_a_line(router: SocketAddr, name: &str) -> (Agent, CountingProxy) {
    let line = CountingProxy::to(router).await;
    let session = Session::open(&client(std::slice::from_ref(&line.endpoint))).await.expect("a session");
    let agent = agent(session, name.into()).await;
    tokio::time::sleep(SETTLED).await;
    (agent, line)
}

pub(super) async fn link() {
    kept();
    let router = router().await;
    let endpoints = router.endpoints().await;
    let address = endpoints[0].strip_prefix("tcp/").and_then(|a| a.parse().ok()).expect("an address");
    let (teller, tells) = on_a_line(address, "teller").await;
    tells.say("link: an agent starts, alone", 1);
    let (_bystander, stands_by) = on_a_line(address, "bystander").await;
    stands_by.say("link: an agent starts, beside 1", 1);
    let mut others = Vec::new();
    for n in 0..50 {
        let session = Session::open(&client(&endpoints)).await.expect("a session");
        others.push(agent(session, format!("agent{n}")).await);
    }
    tokio::time::sleep(SETTLED).await;
    stands_by.say("link: a bystander, while 50 agents start", 50);
    let (follower, follows) = on_a_line(address, "follower").await;
    follows.say("link: an agent starts, beside 52", 1);
    for followers in 0..=2 {
        let remotes = following([&follower, &others[0]].into_iter().take(followers), "teller").await;
        tokio::time::sleep(SETTLED).await;
        if followers == 1 {
            follows.say("link: following 1000 entities begins", 1);
        }
        for (together, updates) in [(1, 1000), (100, 20_000)] {
            let _ = [&tells, &follows, &stands_by].map(CountingProxy::bytes);
            told(&teller, &remotes, together, updates).await;
            tokio::time::sleep(SETTLED).await;
            let what = format!("link: an update of 100 B, {together} at once, {followers} followers");
            tells.say(&format!("{what}, the teller"), updates);
            follows.say(&format!("{what}, a follower"), updates);
            stands_by.say(&format!("{what}, a bystander"), updates);
        }
    }
    stands_by.bytes();
    tokio::time::sleep(IDLE).await;
    stands_by.say("link: a second of nothing", IDLE.as_secs());
}

/// Measures what a snapshot of 100 B takes in long-term memory.
fn kept() {
    let folder = tempfile::tempdir().expect("a folder");
    for together in [1, 100] {
        let store = LongTermMemory::open(&folder.path().join(format!("{together}.redb"))).expect("a file");
        let store = Arc::new(store);
        let kept =
            Consolidator::new(Arc::clone(&store), Policies::all(Policy::Everything)).expect("it can be read");
        let memory = WorkingMemory::new(Arc::new(|| 0))
            .with_limits(MemoryLimits { history: 2, ..MemoryLimits::default() });
        let memory = memory.with_backing(Arc::new(kept));
        for g in 0..1000 {
            let updates = (0..together).map(|i| commit((g * together + i) % 1000, 100));
            memory.commit_now(updates.collect()).expect("it fits");
        }
        drop(memory);
        let what = format!("kept: a snapshot of 100 B, {together} at once");
        let stats = store.stats().expect("it can be read");
        say(&what, stats.bytes as f64 / stats.snapshots as f64, "bytes", "records");
        store.compact().expect("it can be made smaller");
        let stats = store.stats().expect("it can be read");
        say(&what, stats.file_bytes as f64 / stats.snapshots as f64, "bytes", "of the compacted file");
    }
}
