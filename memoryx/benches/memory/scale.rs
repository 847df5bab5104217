//! Many agents through one router: what an update costs by how many follow it, and by how many others are there.

use std::sync::Arc;

use armarium_bus::{Mode, Session, SessionConfig};
use armarium_memoryx::{Limits, Memory, MemoryServer, RemoteMemory, WorkingMemory};

use super::shared::hear;
use super::{Meter, commit, resident_mb, say};

/// Entities of each agent.
const ENTITIES: u64 = 1000;
/// Updates of one agent that are measured.
const UPDATES: u64 = 20_000;
/// How many follow.
const FOLLOWERS: [usize; 4] = [0, 1, 4, 9];

struct Agent {
    session: Session,
    memory: Arc<WorkingMemory>,
    _server: MemoryServer,
}

pub(super) async fn scale() {
    for count in [10, 100] {
        through_one_router(count).await;
    }
}

async fn through_one_router(count: usize) {
    let router = SessionConfig { mode: Mode::Router, ..SessionConfig::default() };
    let router = Session::open(&router).await.expect("a router");
    let config =
        SessionConfig { mode: Mode::Client, ..SessionConfig::connected_to(&router.endpoints().await) };
    let (before, start) = (resident_mb(), Meter::start());
    let mut agents = Vec::new();
    for n in 0..count {
        agents.push(agent(&config, n).await);
    }
    let each = (resident_mb() - before) / count as f64;
    say(&format!("an agent with {ENTITIES} entities, of {count}"), each, "MB", "");
    start.say(&format!("agents started, of {count}"), count as u64, "");
    let mut costs = Vec::new();
    for followers in FOLLOWERS {
        let others = agents.iter().skip(1).take(followers);
        let mut remotes = Vec::new();
        for other in others {
            remotes.push(RemoteMemory::connect(&other.session, "agent0").await.expect("it answers"));
        }
        let what = format!("updates of 100 B, {followers} followers, of {count} agents");
        costs.push((followers as f64, told(&agents[0], &remotes, &what).await));
    }
    say(&format!("each follower adds, of {count} agents"), slope(&costs), "us", "");
    for agent in agents {
        agent.session.close().await.expect("it closes");
    }
    router.close().await.expect("it closes");
}

async fn agent(config: &SessionConfig, n: usize) -> Agent {
    let session = Session::open(config).await.expect("a session");
    let clock = session.clone();
    let memory = WorkingMemory::new(Arc::new(move || clock.now_ns()));
    let memory = Arc::new(memory.with_limits(Limits { history: 2, ..Limits::default() }));
    memory.commit_now((0..ENTITIES).map(|n| commit(n, 100)).collect()).expect("it fits");
    let shared = Arc::clone(&memory);
    let server = MemoryServer::start(&session, &format!("agent{n}"), shared).await.expect("it is shared");
    Agent { session, memory, _server: server }
}

/// Processor time of an update until all have heard it, us.
async fn told(agent: &Agent, remotes: &[RemoteMemory], what: &str) -> f64 {
    let mut changes: Vec<_> = remotes.iter().map(Memory::subscribe).collect();
    let start = Meter::start();
    for g in 0..UPDATES / 100 {
        let updates = (0..100).map(|i| commit((g * 100 + i) % ENTITIES, 100));
        agent.memory.commit_now(updates.collect()).expect("it fits");
        tokio::task::yield_now().await;
    }
    for changes in &mut changes {
        hear(changes, UPDATES).await;
    }
    let each_us = start.processor_us() / UPDATES as f64;
    start.say(what, UPDATES, "");
    each_us
}

/// The slope of the line through the points whose squared errors are least.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let above: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    above / points.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>()
}
