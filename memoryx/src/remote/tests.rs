//! The memory of another agent over real sessions on this machine.

use std::collections::BTreeMap;

use std::sync::atomic::Ordering;

use armarium_bus::{Reply, SessionConfig};
use armarium_values::Value;

use super::*;
use crate::conformance_tests;
use crate::entity::EntityId;
use crate::follow::{Change, Follower};
use crate::proxy::{ProxyState, counting_proxy, proxy};
use crate::server::{MemoryServer, ServerOptions};
use crate::store::LongTermMemory;
use crate::wire::ChangesMessage;
use crate::working::{Clock, MemoryLimits, WorkingMemory};

/// A memory that is shared as Alice's, and as another session sees it.
pub(crate) struct Pair {
    pub(crate) memory: Arc<WorkingMemory>,
    pub(crate) remote: RemoteMemory,
    pub(crate) near: Session,
    far: Session,
    _server: MemoryServer,
}

async fn serve(far: &Session, memory: &Arc<WorkingMemory>) -> MemoryServer {
    MemoryServer::start(far, "alice", Arc::clone(memory), ServerOptions::default()).await.unwrap()
}

/// A pair whose memory has the clock of its session, or another one.
pub(crate) async fn pair_with(limits: MemoryLimits, clock: Option<Clock>) -> Pair {
    let far = Session::open(&SessionConfig::default()).await.unwrap();
    let own = far.clone();
    let clock = clock.unwrap_or_else(|| Arc::new(move || own.now_ns()));
    let memory = Arc::new(conformance_tests::typed(WorkingMemory::new(clock).with_limits(limits)));
    let server = serve(&far, &memory).await;
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.unwrap();
    let remote = RemoteMemory::connect(&near, "alice").await.unwrap();
    Pair { memory, remote, near, far, _server: server }
}

async fn pair() -> Pair {
    pair_with(MemoryLimits { history: 64, ..MemoryLimits::default() }, Some(Arc::new(|| 0))).await
}

/// The next change, of which none is missing.
async fn new(follower: &mut Follower) -> Arc<Snapshot> {
    let Some(Change::New(snapshot)) = follower.next().await.unwrap() else { panic!("one is missing") };
    snapshot
}

fn commit(name: &str, value: i64) -> Commit {
    Commit::new(EntityId::new("Things", "p", name).unwrap(), 1, [("value", Value::Int(value))])
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_conforms() {
    let pair = pair().await;
    conformance_tests::check(&pair.remote).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn updates_that_are_put_and_gets_by_key_work_without_this_program() {
    let pair = pair().await;
    let mut changes = pair.remote.subscribe(&Pattern::any()).await.unwrap();
    let key = keys::memory("alice", "Things", "p", "a").unwrap();
    let (encoding, payload) = wire::seal(&commit("a", 7)).unwrap();
    let update = commit("a", 7);
    pair.near.put_waiting(&key, "application/cbor;memoryx/update;v9", payload.clone()).await.unwrap();
    pair.near.put_waiting(&key, &encoding, vec![0xff; 10]).await.unwrap();
    pair.near.put_waiting(&key, &encoding, payload).await.unwrap();
    let heard = changes.recv().await.unwrap();
    assert_eq!((heard.version, &heard.instances), (1, &update.instances), "the bad ones changed nothing");
    assert!(heard.sent_ns > 0);

    let every = wire::every_entity("alice").unwrap();
    let answers =
        pair.near.query(every, "history", None, 10, armarium_bus::session::REPLY_TIMEOUT).await.unwrap();
    let [Reply::Message(message)] = &answers[..] else { panic!("one answer, not {answers:?}") };
    assert_eq!(message.key, "alice/memory/Things/p/a");
    assert_eq!(wire::open::<Snapshot>(&message.encoding, &message.payload).unwrap(), *heard);
}

/// What others put on the memory's keys is no change of the memory, and makes nothing be missed or told twice.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn forged_changes_have_no_effect() {
    let pair = pair().await;
    let remote = Arc::new(pair.remote.clone());
    let (mut follower, _) = Follower::from_now(remote, Pattern::segment("Things")).await.unwrap();
    for i in 0..5 {
        pair.memory.commit_now(vec![commit("a", i)]).unwrap();
    }
    let known = pair.memory.latest_now(&commit("a", 0).id).unwrap();
    let forged = ChangesMessage { epoch: 7, first: 9, until_ns: u64::MAX, snapshots: vec![known] };
    let (encoding, payload) = wire::seal(&forged).unwrap();
    let key = keys::memory_changes_of("alice", "Things").unwrap();
    pair.far.put_waiting(&key, &encoding, payload).await.unwrap();
    pair.far.put_waiting(&key, &encoding, vec![0xff; 9]).await.unwrap();
    pair.memory.commit_now(vec![commit("end", 0)]).unwrap();
    let mut heard = Vec::new();
    while heard.last().is_none_or(|(name, _)| name != "end") {
        let snapshot = new(&mut follower).await;
        heard.push((snapshot.id.entity().to_owned(), snapshot.version));
    }
    let expected: Vec<_> = (1..=5).map(|v| ("a".to_owned(), v)).chain([("end".to_owned(), 1)]).collect();
    assert_eq!(heard, expected);
}

/// One entity of a large memory is read for the price of one; who follows a core segment gets nothing of another.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connecting_costs_what_is_asked_for() {
    let pair = pair().await;
    let large = |segment: &str, n: u64| {
        let id = EntityId::new(segment, "p", &format!("e{n}")).unwrap();
        Commit::new(id, n, [("data", Value::Bytes(vec![n as u8; 20_000]))])
    };
    pair.memory.commit_now((0..2000).map(|n| large("Things", n)).collect()).unwrap();
    pair.memory.commit_now(vec![commit("small", 1)]).unwrap();
    let (endpoint, bytes) = counting_proxy(&pair.far.endpoints().await[0]).await;
    let session = Session::open(&SessionConfig::connected_to(&[endpoint])).await.unwrap();
    let received = || bytes[1].load(Ordering::Relaxed);
    let remote = RemoteMemory::connect(&session, "alice").await.unwrap();
    remote.latest(&commit("small", 1).id).await.unwrap();
    let got = received();
    assert!(got < 10_000, "{got} bytes for one entity");

    let before = received();
    let (mut follower, _) = Follower::from_now(Arc::new(remote), Pattern::segment("Others")).await.unwrap();
    let id = EntityId::new("Others", "p", "e").unwrap();
    for n in 1..=10 {
        pair.memory.commit_now((0..50).map(|n| large("Things", n)).collect()).unwrap();
        pair.memory.commit_now(vec![Commit::new(id.clone(), n, [("value", Value::Int(1))])]).unwrap();
        let snapshot = new(&mut follower).await;
        assert_eq!(snapshot.version, n);
    }
    let got = received() - before;
    assert!(got < 50_000, "{got} bytes of a core segment with ten changes, beside 10 MB of another one");
}

/// A leader that begins anew, with its content on a file or without any, and whose clock is 3 s back by then, is followed on.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_whose_clock_goes_back_is_followed_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("alice.redb");
    for is_kept in [false, true] {
        is_followed_on(is_kept.then_some(&path)).await;
    }
}

async fn is_followed_on(file: Option<&std::path::PathBuf>) {
    let far = Session::open(&SessionConfig::default()).await.unwrap();
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.unwrap();
    let leader = |now_s: u64| {
        let memory = WorkingMemory::new(Arc::new(move || now_s * 1_000_000_000));
        let store = file.map(|file| Arc::new(LongTermMemory::open(file).unwrap()));
        let Some(store) = store else { return Arc::new(memory) };
        let memory = memory.with_backing(Arc::<LongTermMemory>::clone(&store));
        store.load_into(&memory, Pattern::any()).unwrap();
        Arc::new(memory)
    };
    let memory = leader(1005);
    let server = serve(&far, &memory).await;
    let remote = RemoteMemory::connect(&near, "alice").await.unwrap();
    memory.commit_now((0..3).map(|i| commit("a", i)).collect()).unwrap();
    let (mut follower, heads) =
        Follower::from_now(Arc::new(remote), Pattern::segment("Things")).await.unwrap();
    assert_eq!((heads.len(), heads[0].version), (1, 3));
    drop((server, memory));
    let anew = leader(1002);
    anew.commit_now(vec![commit("a", 7), commit("b", 8)]).unwrap();
    let _server = serve(&far, &anew).await;
    let version = if file.is_some() { 4 } else { 1 };
    let mut heard = BTreeMap::new();
    while heard.len() < 2 {
        let snapshot = new(&mut follower).await;
        let value = snapshot.attribute("value").cloned();
        heard.insert(snapshot.id.entity().to_owned(), (snapshot.version, value));
    }
    let expected =
        [("a", version, 7), ("b", 1, 8)].map(|(name, v, n)| (name.to_owned(), (v, Some(Value::Int(n)))));
    assert_eq!(heard, BTreeMap::from(expected));
    anew.commit_now(vec![commit("a", 9)]).unwrap();
    let snapshot = new(&mut follower).await;
    assert_eq!((snapshot.id.entity(), snapshot.version), ("a", version + 1));
}

/// Waits for this version of the only entity. Returns all versions received, in order.
async fn received_until(follower: &mut Follower, last: u64) -> Vec<u64> {
    let mut heard = Vec::new();
    while heard.last() != Some(&last) {
        heard.push(new(follower).await.version);
    }
    heard
}

/// After a pause of the connection, everything lost in it arrives soon, including the last changes, although no
/// further change follows them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_last_changes_are_not_missed() {
    let pair = pair().await;
    let (endpoint, state) = proxy(&pair.far.endpoints().await[0]).await;
    let slow = Session::open(&SessionConfig::connected_to(&[endpoint])).await.unwrap();
    let behind = Arc::new(RemoteMemory::connect(&slow, "alice").await.unwrap());
    let (mut behind, _) = Follower::from_now(behind, Pattern::segment("Things")).await.unwrap();
    let beside = Arc::new(pair.remote.clone());
    let (mut beside, _) = Follower::from_now(beside, Pattern::any()).await.unwrap();
    let probe = keys::live("alice", "probe").unwrap();
    let mut probed = slow.subscribe(probe.clone(), 1).await.unwrap();
    while probed.try_next().is_none() {
        pair.far.put(&probe, "x", Vec::new()).await.unwrap();
        tokio::task::yield_now().await;
    }
    state.send(ProxyState::Held).unwrap();
    // Several times the size of the buffers on the way.
    let (count, large) = (24, 1 << 20);
    for i in 1..=count {
        let id = commit("a", 0).id;
        let update = Commit::new(id, i, [("data", Value::Bytes(vec![7; large]))]);
        pair.memory.commit_now(vec![update]).unwrap();
    }
    assert_eq!(received_until(&mut beside, count).await, (1..=count).collect::<Vec<_>>());
    // Messages are sent one after the other: once this probe was dropped, the last change was too.
    pair.far.put(&probe, "x", Vec::new()).await.unwrap();
    state.send(ProxyState::Open).unwrap();
    assert_eq!(received_until(&mut behind, count).await, (1..=count).collect::<Vec<_>>());
}

/// Changes faster than anyone can follow: none is lost, and none is reported twice.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_flooded_arrives_whole() {
    let limits = MemoryLimits { history: 256, ..MemoryLimits::default() };
    let Pair { memory, remote, _server, .. } = pair_with(limits, None).await;
    let remote = Arc::new(remote);
    let mut follower = Follower::from_start(remote, Pattern::any()).await.unwrap();
    let (groups, entities) = (2000, 1000);
    let writer = tokio::spawn(async move {
        for group in 0..groups {
            let update = |i| commit(&format!("e{}", (group * 100 + i) % entities), group);
            memory.commit_now((0..100).map(update).collect()).unwrap();
            tokio::task::yield_now().await;
        }
    });
    let mut newest: BTreeMap<EntityId, u64> = BTreeMap::new();
    for _ in 0..groups * 100 {
        let snapshot = new(&mut follower).await;
        let before = newest.insert(snapshot.id.clone(), snapshot.version).unwrap_or(0);
        assert_eq!(snapshot.version, before + 1, "{}", snapshot.id);
    }
    writer.await.unwrap();
    assert!(
        newest.len() == entities as usize && newest.values().all(|v| *v == (groups * 100 / entities) as u64)
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_memory_that_is_not_there_is_an_error() {
    let session = Session::open(&SessionConfig::default()).await.unwrap();
    let error = RemoteMemory::connect(&session, "nobody").await.unwrap_err();
    assert!(matches!(error, MemoryError::Remote { .. }), "{error}");
    assert!(matches!(RemoteMemory::connect(&session, "no/body").await, Err(MemoryError::Name { .. })));
}
