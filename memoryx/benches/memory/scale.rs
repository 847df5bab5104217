//! Many agents on one router: the cost of an update by the number of followers, and by the number of other agents.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Mode, Session, SessionConfig};
use armarium_memoryx::{MemoryLimits, MemoryServer, RemoteMemory, ServerOptions, WorkingMemory};

use super::shared::{follow, hear};
use super::{Meter, commit, resident_mb, say};

/// Entities of each agent.
const ENTITIES: u64 = 1000;
/// How many updates are committed together, and how many are measured in all.
const UPDATES: [(u64, u64); 2] = [(1, 2000), (100, 50_000)];
/// Numbers of followers.
const FOLLOWERS: [usize; 4] = [0, 1, 4, 9];
/// How long idle agents are measured.
const IDLE: Duration = Duration::from_secs(5);

/// An agent with its memory on a session of its own.
pub(super) struct Agent {
    pub(super) name: String,
    pub(super) session: Session,
    pub(super) memory: Arc<WorkingMemory>,
    _server: MemoryServer,
}

pub(super) async fn scale() {
    for count in [10, 30, 100] {
        through_one_router(count).await;
    }
}

async fn through_one_router(count: usize) {
    let router = router().await;
    let agents = started(&router, count).await;
    idle(count).await;
    for (together, updates) in UPDATES {
        let mut costs = Vec::new();
        for followers in FOLLOWERS {
            let remotes = following(&agents[1..=followers], "agent0").await;
            let what =
                format!("{together} updates of 100 B at once, {followers} followers, of {count} agents");
            let start = Meter::start();
            told(&agents[0], &remotes, together, updates).await;
            let each_us = start.processor_us() / updates as f64;
            start.say(&what, updates);
            costs.push((followers as f64, each_us));
        }
        say(&format!("  each follower adds, {together} at once, of {count} agents"), slope(&costs), "us", "");
    }
    ring(&agents).await;
    for agent in agents {
        agent.session.close().await.expect("it closes");
    }
    router.close().await.expect("it closes");
}

pub(super) async fn router() -> Session {
    let config = SessionConfig { mode: Mode::Router, ..SessionConfig::default() };
    Session::open(&config).await.expect("a router")
}

pub(super) fn client(endpoints: &[String]) -> SessionConfig {
    SessionConfig { mode: Mode::Client, ..SessionConfig::connected_to(endpoints) }
}

/// Starts agents on a router, and prints what a session and a memory take.
async fn started(router: &Session, count: usize) -> Vec<Agent> {
    let config = client(&router.endpoints().await);
    let (before, start) = (resident_mb(), Meter::start());
    let mut sessions = Vec::new();
    for _ in 0..count {
        sessions.push(Session::open(&config).await.expect("a session"));
    }
    let opened = resident_mb();
    start.say(&format!("sessions opened, of {count}"), count as u64);
    say(&format!("  a session, of {count}"), (opened - before) * 1024.0 / count as f64, "kB", "");
    let start = Meter::start();
    let mut agents = Vec::new();
    for (n, session) in sessions.into_iter().enumerate() {
        agents.push(agent(session, format!("agent{n}")).await);
    }
    start.say(&format!("memories of {ENTITIES} entities shared, of {count}"), count as u64);
    say(&format!("  a memory, of {count}"), (resident_mb() - opened) * 1024.0 / count as f64, "kB", "");
    agents
}

pub(super) async fn agent(session: Session, name: String) -> Agent {
    let clock = session.clone();
    let memory = WorkingMemory::new(Arc::new(move || clock.now_ns()));
    let memory = Arc::new(memory.with_limits(MemoryLimits { history: 2, ..MemoryLimits::default() }));
    memory.commit_now((0..ENTITIES).map(|n| commit(n, 100)).collect()).expect("it fits");
    let server = MemoryServer::start(&session, &name, Arc::clone(&memory), ServerOptions::default())
        .await
        .expect("it is shared");
    Agent { name, session, memory, _server: server }
}

/// One agent's memory as some other agents see it.
pub(super) async fn following(by: impl IntoIterator<Item = &Agent>, agent: &str) -> Vec<RemoteMemory> {
    let mut remotes = Vec::new();
    for follower in by {
        remotes.push(RemoteMemory::connect(&follower.session, agent).await.expect("it answers"));
    }
    remotes
}

/// Commits updates of an agent; the next ones follow when all followers have received the last ones.
pub(super) async fn told(agent: &Agent, remotes: &[RemoteMemory], together: u64, updates: u64) {
    let mut listening = Vec::new();
    for remote in remotes {
        listening.push(follow(remote).await);
    }
    for g in 0..updates / together {
        tell(agent, g * together, together);
        for changes in &mut listening {
            hear(changes, together).await;
        }
        if remotes.is_empty() && (g * together).is_multiple_of(500) {
            // Without followers: slow enough that each update is published before the next.
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
}

/// One commit of an agent, after the first `told` updates.
fn tell(agent: &Agent, told: u64, together: u64) {
    let updates = (0..together).map(|i| commit((told + i) % ENTITIES, 100));
    agent.memory.commit_now(updates.collect()).expect("it fits");
}

/// Measures the cost of idle agents.
async fn idle(count: usize) {
    let start = Meter::start();
    tokio::time::sleep(IDLE).await;
    let each = start.processor_us() / IDLE.as_secs_f64() / count as f64;
    say(&format!("an agent that does nothing, of {count}"), each, "us/s", "of processors");
}

/// Each agent follows the next one, and all commit at once.
async fn ring(agents: &[Agent]) {
    let count = agents.len();
    let start = Meter::start();
    let mut remotes = Vec::new();
    for (n, agent) in agents.iter().enumerate() {
        let next = &agents[(n + 1) % count].name;
        remotes.push(RemoteMemory::connect(&agent.session, next).await.expect("it answers"));
    }
    start.say(&format!("followers connected, of {count}"), count as u64);
    let mut listening = Vec::new();
    for remote in &remotes {
        listening.push(follow(remote).await);
    }
    let (together, updates) = UPDATES[1];
    let rounds = updates / together / count as u64;
    let start = Meter::start();
    for g in 0..rounds {
        for agent in agents {
            tell(agent, g * together, together);
        }
        for changes in &mut listening {
            hear(changes, together).await;
        }
    }
    let what = format!("{together} at once by each of {count} agents, 1 follower each");
    start.say(&what, rounds * together * count as u64);
}

/// The slope of the least-squares line through the points.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let above: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    above / points.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>()
}
