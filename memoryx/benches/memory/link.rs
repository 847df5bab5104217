//! Bytes on an agent's link to the router, and bytes of a snapshot in long-term memory. Neither depends on the
//! machine.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::Session;
use armarium_memoryx::{MemoryLimits, Policies, Policy};

use super::proxy::counting_proxy;
use super::scale::{Agent, agent, client, following, router, told};
use super::{commit, on_file, say};

/// Until messages in flight have arrived, and idle memories have published their number of changes.
const SETTLED: Duration = Duration::from_millis(400);
/// How long idle agents are measured.
const IDLE: Duration = Duration::from_secs(10);

/// Counts the bytes of a link to a router.
struct Link(Arc<[AtomicU64; 2]>);

impl Link {
    /// Bytes to the router and from it since the last call.
    fn bytes(&self) -> (f64, f64) {
        let taken = |at: usize| self.0[at].swap(0, Ordering::Relaxed) as f64;
        (taken(0), taken(1))
    }

    fn say(&self, what: &str, count: u64) {
        let (up, down) = self.bytes();
        say(&format!("{what}: to the router"), up / count as f64, "bytes", "");
        say(&format!("{what}: from it"), down / count as f64, "bytes", "");
    }
}

async fn on_a_line(router: &str, name: &str) -> (Agent, Link) {
    let (endpoint, bytes) = counting_proxy(router).await;
    let session = Session::open(&client(&[endpoint])).await.expect("a session");
    let agent = agent(session, name.into()).await;
    tokio::time::sleep(SETTLED).await;
    (agent, Link(bytes))
}

pub(super) async fn link() {
    kept();
    let router = router().await;
    let endpoints = router.endpoints().await;
    let address = &endpoints[0];
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
            let _ = [&tells, &follows, &stands_by].map(Link::bytes);
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
        let file = folder.path().join(format!("{together}.redb"));
        let limits = MemoryLimits { history: 2, ..MemoryLimits::default() };
        let (store, memory) = on_file(&file, Policies::all(Policy::Everything), limits);
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
