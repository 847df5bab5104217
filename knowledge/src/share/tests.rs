//! Following over real sessions: frames, a disconnection, reported gaps, and what is said of it.

use std::sync::atomic::{AtomicU64, Ordering};

use armarium_bus::{Access, Session, SessionConfig};
use armarium_memoryx::{
    Consolidator, LongTermMemory, MemoryLimits, MemoryServer, Policies, Policy, RemoteMemory, ServerOptions,
};
use armarium_values::{Frame, Pose, Value, Vector};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use super::*;
use crate::agent::{AgentMemory, MemoryConfig};
use crate::proxy::{ProxyState, proxy};

fn cup(time: u64, x: f64) -> Commit {
    let id = EntityId::new(OBJECT_INSTANCES, "vision", "cup").unwrap();
    let position = Vector { frame: Frame::root(), components: [x, 0.0, 1.0] };
    let velocity = Vector { frame: Frame::root(), components: [1.0, 0.0, 0.0] };
    let instance = Instance::new([
        ("class", Value::from("cup")),
        ("position", position.into()),
        ("velocity", velocity.into()),
    ]);
    let covariance = vec![4e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4];
    Commit::of(id, time, vec![instance.with_covariance("position", covariance)])
}

fn stands(agent: &str, x: f64, turned: f64) -> Commit {
    let at = Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * turned);
    let id = EntityId::new("AgentInstances", "map", agent).unwrap();
    Commit::new(id, 0, [("pose", Value::Pose(Pose::new(WORLD.into(), &at)))])
}

fn settings(fuse_into: Option<&str>) -> FollowSettings {
    FollowSettings {
        own: "bob".into(),
        agent: "alice".into(),
        pattern: Pattern::segment(OBJECT_INSTANCES),
        fuse_into: fuse_into.map(Into::into),
        record: None,
    }
}

/// Waits until the data here describe a certain time.
async fn arrived(memory: &WorkingMemory, id: &EntityId, time: u64) {
    let mut changes = memory.changes(&Pattern::any());
    while memory.latest_now(id).map_or(true, |s| s.referenced_ns < time) {
        // A lagging receiver checks again as well.
        let _ = changes.recv().await;
    }
}

fn close(a: [f64; 3], b: [f64; 3]) -> bool {
    armarium_memoryx::distance(&a, &b) < 1e-12
}

#[tokio::test(start_paused = true)]
async fn what_is_followed_is_in_ones_own_frame_with_its_origin() {
    let alice = Arc::new(crate::working_memory(Arc::new(|| 7)));
    let bob = Arc::new(crate::working_memory(Arc::new(|| 8)));
    let quarter = std::f64::consts::FRAC_PI_2;
    bob.commit_now(vec![stands("alice", 2.0, quarter), stands("bob", 1.0, 0.0)]).unwrap();
    alice.commit_now(vec![cup(5, 0.3)]).unwrap();
    let other = Arc::<WorkingMemory>::clone(&alice);
    let following = Copying::start(other, Arc::clone(&bob), settings(Some("scene"))).await.unwrap();
    arrived(&bob, &"ObjectInstances/scene/cup".parse().unwrap(), 5).await;
    let found = bob.latest_now(&"ObjectInstances/alice.vision/cup".parse().unwrap()).unwrap();
    // Alice stands one metre along Bob's x axis, and her x axis is parallel to his y axis.
    let Some(Value::Vector(position)) = found.attribute("position") else { panic!("no position") };
    assert!(close(position.components, [1.0, 0.3, 1.0]), "{position:?}");
    assert_eq!(position.frame, Frame::root());
    let Some(Value::Vector(velocity)) = found.attribute("velocity") else { panic!("no velocity") };
    assert!(close(velocity.components, [0.0, 1.0, 0.0]), "{velocity:?}");
    let covariance = &found.instance().unwrap().covariance["position"];
    assert!((covariance[0] - 1e-4).abs() < 1e-15 && (covariance[4] - 4e-4).abs() < 1e-15, "{covariance:?}");
    let origin = found.attribute("origin").unwrap();
    assert_eq!(origin.get("agent"), Some(&Value::from("alice")));
    assert_eq!((origin.get("version"), found.referenced_ns), (Some(&Value::Int(1)), 5));
    let fused = bob.latest_now(&"ObjectInstances/scene/cup".parse().unwrap()).unwrap();
    assert!(fused.attribute("position") == Some(&Value::Vector(position.clone())));

    // Bob receives nothing twice, even after a restart. What he has of an agent `alice.b` is not Alice's.
    drop(following);
    let id = EntityId::new(OBJECT_INSTANCES, "b.eye", "cup").unwrap();
    let of_other =
        Origin { agent: "alice.b".into(), id: id.clone(), version: 3, arrived_ns: 7, missed: 0 }.attribute();
    let copied = followed_id("alice", &id).unwrap();
    bob.commit_now(vec![Commit::new(copied, 5, [("class", "cup".into()), ("origin", of_other)])]).unwrap();
    let had = last_taken(&bob, &settings(None)).await.unwrap();
    assert_eq!(had.into_keys().collect::<Vec<_>>(), [cup(5, 0.3).id]);
    alice.commit_now(vec![cup(6, 0.4)]).unwrap();
    let other = Arc::<WorkingMemory>::clone(&alice);
    let _following = Copying::start(other, Arc::clone(&bob), settings(None)).await.unwrap();
    arrived(&bob, &found.id, 6).await;
    let newest = bob.latest_now(&found.id).unwrap();
    assert_eq!((newest.version, newest.attribute("origin").unwrap().get("missed")), (2, None));
}

#[tokio::test(start_paused = true)]
async fn who_follows_everything_takes_poses_of_agents_once() {
    let (alice, bob) =
        (crate::working_memory(Arc::new(|| 7)), Arc::new(crate::working_memory(Arc::new(|| 8))));
    alice.commit_now(vec![stands("alice", 2.0, 0.0), cup(5, 0.3)]).unwrap();
    let everything = FollowSettings { pattern: Pattern::segment("*"), ..settings(None) };
    let _following = Copying::start(Arc::new(alice), Arc::clone(&bob), everything).await.unwrap();
    arrived(&bob, &"ObjectInstances/alice.vision/cup".parse().unwrap(), 5).await;
    assert_eq!(bob.len(), 1, "poses come by a following of their own");
}

#[test]
fn whom_to_follow_is_named_with_segments() {
    for (text, segment) in [("alice", None), ("alice:Motions", Some("Motions")), ("alice:*", Some("*"))] {
        assert_eq!(text.parse(), Ok(Followee { agent: "alice".into(), segment: segment.map(Into::into) }));
    }
    for bad in ["", "alice:", ":Motions", "*", "alice:a/b"] {
        assert!(matches!(bad.parse::<Followee>(), Err(MemoryError::Name { .. })), "{bad}");
    }
}

#[test]
fn a_place_that_is_not_known_is_nobody_elses() {
    let instance = cup(1, 0.3).instances.remove(0);
    let moved = transformed(&instance, "alice", None);
    let Some(Value::Vector(position)) = moved.attributes.get("position") else { panic!("no position") };
    assert_eq!((position.frame.0.as_str(), position.components), ("alice/root", [0.3, 0.0, 1.0]));
}

#[test]
fn transforms_compose_like_isometries() {
    let by = Isometry3::from_parts(
        Vector3::new(0.3, -0.2, 1.0).into(),
        UnitQuaternion::from_euler_angles(0.2, -0.7, 1.1),
    );
    let wrench =
        armarium_values::Wrench { frame: Frame::root(), force: [1.0, 2.0, 3.0], torque: [0.1, 0.2, 0.3] };
    let instance = Instance::new([
        ("wrench", Value::Wrench(wrench)),
        ("a", Value::List(vec![cup(0, 0.3).instances[0].attributes.get("position").unwrap().clone()])),
    ]);
    let there = transformed(&instance, "alice", Some(&by));
    let back = transformed(&there, "alice", Some(&by.inverse()));
    let numbers = |i: &Instance| match (i.attributes.get("wrench"), i.attributes.get("a")) {
        (Some(Value::Wrench(w)), Some(Value::List(items))) => match &items[0] {
            Value::Vector(v) => [w.force, w.torque, v.components],
            other => panic!("{other:?}"),
        },
        other => panic!("{other:?}"),
    };
    for (a, b) in numbers(&instance).into_iter().zip(numbers(&back)) {
        assert!(close(a, b), "{a:?} {b:?}");
    }
    let moved = by * Point3::new(0.3, 0.0, 1.0);
    assert!(close(numbers(&there)[2], moved.coords.into()));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn after_a_cut_both_sides_are_equal() {
    let folder = tempfile::tempdir().unwrap();
    let store = Arc::new(LongTermMemory::open(&folder.path().join("alice.redb")).unwrap());
    let kept = Consolidator::new(Arc::clone(&store), Policies::all(Policy::Everything)).unwrap();
    let session = Session::open(&SessionConfig::default()).await.unwrap();
    let clock = session.clone();
    let alice = crate::working_memory(Arc::new(move || clock.now_ns()));
    let alice = alice
        .with_limits(MemoryLimits { history: 4, ..MemoryLimits::default() })
        .with_backing(Arc::new(kept));
    let alice = Arc::new(alice);
    let options = ServerOptions { store: Some(store), guarded: false };
    let server = MemoryServer::start(&session, "alice", Arc::clone(&alice), options).await.unwrap();
    let (endpoint, state) = proxy(&session.endpoints().await[0]).await;

    let near = Session::open(&SessionConfig::connected_to(&[endpoint])).await.unwrap();
    let remote = Arc::new(RemoteMemory::connect(&near, "alice").await.unwrap());
    let bob = crate::working_memory(Arc::new(|| 0))
        .with_limits(MemoryLimits { history: 100_000, ..MemoryLimits::default() });
    let bob = Arc::new(bob);
    let shared = Arc::<RemoteMemory>::clone(&remote);
    let _following = Copying::start(shared, Arc::clone(&bob), settings(None)).await.unwrap();
    let commit = |from: u64, to: u64| {
        let times: Vec<u64> = (from..to).collect();
        for together in times.chunks(1000) {
            let updates = together.iter().map(|time| cup(*time, *time as f64 * 1e-3));
            alice.commit_now(updates.collect()).unwrap();
        }
    };
    let id: EntityId = "ObjectInstances/alice.vision/cup".parse().unwrap();
    commit(0, 50);
    arrived(&bob, &id, 49).await;
    state.send(ProxyState::Cut).unwrap();
    // 20 s at 1000 updates a second: far more than working memory keeps.
    commit(50, 20_000);
    state.send(ProxyState::Open).unwrap();
    arrived(&bob, &id, 19_999).await;
    commit(20_000, 20_020);
    arrived(&bob, &id, 20_019).await;
    let taken: Vec<u64> = bob
        .query_now(&Query::history(Pattern::entity(&id)))
        .unwrap()
        .iter()
        .map(|s| s.referenced_ns)
        .collect();
    assert_eq!(taken, (0..20_020).collect::<Vec<_>>(), "nothing is lost and nothing there twice");
    drop(server);
}

/// Whom an agent follows, and how that goes, is in its memory: also that the clock of the other one is another one after a restart.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn absence_and_clocks_are_told() {
    let far = Session::open(&SessionConfig::default()).await.unwrap();
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.unwrap();
    let clock = near.clone();
    let config = MemoryConfig { follow: vec![Followee::of("alice")], ..MemoryConfig::new("bob") };
    let bob = AgentMemory::open(config, Arc::new(move || clock.now_ns())).unwrap();
    let _shared = bob.share(&near).await.unwrap();
    let memory = bob.memory();
    told(memory, |told| {
        told.attribute("why").and_then(Value::as_str).is_some_and(|why| why.contains("alice"))
    })
    .await;

    let behind_ns = Arc::new(AtomicU64::new(0));
    let (clock, behind) = (far.clone(), Arc::clone(&behind_ns));
    let now_ns = move || clock.now_ns() - behind.load(Ordering::Relaxed);
    let alice = Arc::new(crate::working_memory(Arc::new(now_ns)));
    alice.commit_now(vec![stands("alice", 1.0, 0.0)]).unwrap();
    let serve = || MemoryServer::start(&far, "alice", Arc::clone(&alice), ServerOptions::default());
    let server = serve().await.unwrap();
    told(memory, |told| told.attribute("why").is_none() && ahead_s(told).is_some_and(|s| s.abs() < 1.0))
        .await;
    drop(server);
    behind_ns.store(3_000_000_000, Ordering::Relaxed);
    let _server = serve().await.unwrap();
    told(memory, |told| ahead_s(told).is_some_and(|s| (s + 3.0).abs() < 1.0)).await;
}

/// Waits until Bob's memory says this of Alice.
async fn told(memory: &WorkingMemory, is_wanted: impl Fn(&Snapshot) -> bool) {
    let id: EntityId = "Following/bob/alice".parse().unwrap();
    let mut changes = memory.changes(&Pattern::entity(&id));
    while !memory.latest_now(&id).is_ok_and(|told| is_wanted(&told)) {
        changes.recv().await.unwrap();
    }
}

fn ahead_s(told: &Snapshot) -> Option<f64> {
    match told.attribute("clock_ahead_s")? {
        Value::Float(ahead_s) => Some(*ahead_s),
        _ => None,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn whom_ones_own_rules_keep_out_cannot_be_followed() {
    let session = Session::open(&SessionConfig::default()).await.unwrap();
    let share = |readers: &[&str]| {
        let readers = readers.iter().map(|reader| (*reader).to_owned()).collect();
        let access = Some(Access { own: "bob".into(), readers, ..Access::default() });
        let config = MemoryConfig { follow: vec![Followee::of("alice")], access, ..MemoryConfig::new("bob") };
        let (bob, session) = (AgentMemory::open(config, Arc::new(|| 0)).unwrap(), session.clone());
        async move { bob.share(&session).await.map(drop) }
    };
    let refused = share(&["carol"]).await.unwrap_err().to_string();
    assert!(refused.contains("alice") && refused.contains("rules of `bob`"), "{refused}");
    assert_eq!(share(&["alice"]).await, Ok(()));
}
