//! Commits beside queries: a million entities, and clients that loop over filters that fit nothing.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::{Key, Payload, Reply, Session, SessionConfig, decode, encode, keys};
use armarium_memoryx::wire::{QueryRequest, Snapshots};
use armarium_memoryx::{Commit, MemoryServer, Pattern, Query, ServerOptions, WorkingMemory};
use armarium_values::Value;
use tokio::task::JoinSet;

use super::{Meter, at_most, id, median, say};

const ENTITIES: u64 = 1_000_000;
const CLIENTS: usize = 8;
const COMMITS: u64 = 10_000;
/// Between two commits, so that most of the time belongs to the clients.
const PAUSE: Duration = Duration::from_millis(1);

pub(super) async fn beside() {
    let memory = Arc::new(WorkingMemory::new(Arc::new(|| 0)));
    for group in 0..ENTITIES / 1000 {
        let update = |n| Commit::new(id(n), n, [("value", Value::Int(0))]);
        memory.commit_now((group * 1000..(group + 1) * 1000).map(update).collect()).expect("it fits");
    }
    let far = Session::open(&SessionConfig::default()).await.expect("a session");
    let _server = MemoryServer::start(&far, "alice", Arc::clone(&memory), ServerOptions::default())
        .await
        .expect("it is shared");

    let idle = commits(&memory).await;
    let mut clients = JoinSet::new();
    for _ in 0..CLIENTS {
        let near = SessionConfig::connected_to(&far.endpoints().await);
        clients.spawn(ask_for_ever(Session::open(&near).await.expect("a session")));
    }
    let start = Meter::start();
    let beside = commits(&memory).await;
    let processors = start.processor_us() * 1e-6 / start.elapsed().as_secs_f64();
    clients.shutdown().await;

    let of = |times: &[Duration], share: f64| {
        times[((times.len() - 1) as f64 * share) as usize].as_secs_f64() * 1e3
    };
    let (idle_us, beside_us) = (median(idle), median(beside.clone()));
    let mut sorted = beside;
    sorted.sort_unstable();
    say(&format!("commit in a memory of {ENTITIES}, median"), idle_us, "us", "");
    say(&format!("  the same beside {CLIENTS} clients whose filters fit nothing"), beside_us, "us", "");
    at_most("  times the idle one", beside_us / idle_us, "", 2.0);
    at_most("  99.9 % of them within", of(&sorted, 0.999), "ms", 5.0);
    at_most("  the worst", of(&sorted, 1.0), "ms", 25.0);
    at_most("  processors used by commits, queries and clients together", processors, "", 1.2);
}

/// How long each of many commits takes.
async fn commits(memory: &Arc<WorkingMemory>) -> Vec<Duration> {
    let memory = Arc::clone(memory);
    let timed = move || {
        let one = |n: u64| {
            #[allow(clippy::disallowed_methods, reason = "figures are of the wall clock")]
            std::thread::sleep(PAUSE);
            let update = Commit::new(id(n * 7919 % ENTITIES), n, [("value", Value::Int(1))]);
            let start = Meter::start();
            memory.commit_now(vec![update]).expect("it fits");
            start.elapsed()
        };
        (0..COMMITS).map(one).collect()
    };
    tokio::task::spawn_blocking(timed).await.expect("it ends")
}

/// Asks for what there is not, part after part, again and again.
async fn ask_for_ever(session: Session) {
    let key: Key = keys::memory_commit("alice").expect("a name");
    let query = Query::latest(Pattern::any()).filter("value > 7 && value < 9");
    let mut request = QueryRequest { query, parts: true };
    loop {
        let payload = encode(&request).expect("it fits");
        let answer = session.query_one(&key, "", Some((&QueryRequest::SCHEMA.encoding(), payload))).await;
        request.query.after = match answer {
            Ok(Reply::Message(message)) => {
                let found: Snapshots = decode(&message.payload).expect("an answer");
                found.next
            }
            // Too many questions wait: begin again.
            _ => None,
        };
    }
}
