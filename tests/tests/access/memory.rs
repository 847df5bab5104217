//! Who reads and writes an agent's memory, and which errors the others get.

use std::sync::Arc;

use armarium_bus::{Access, Session, SessionConfig, Tls};
use armarium_memoryx::wire::Maintain;
use armarium_memoryx::{
    Commit, EntityId, Memory, MemoryError, MemoryServer, Pattern, Query, RemoteMemory, ServerOptions,
};
use armarium_values::Value;

use super::Authority;

fn commit(provider: &str, entity: &str) -> Vec<Commit> {
    let id = EntityId::new("Things", provider, entity).unwrap();
    vec![Commit::new(id, 1, [("value", Value::Int(7))])]
}

async fn everything(memory: &RemoteMemory) -> usize {
    memory.query(&Query::latest(Pattern::any())).await.unwrap().len()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_agent_writes_only_its_own_segments_and_a_stranger_reads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::new(folder.path());
    let access = Access {
        own: "alice".into(),
        readers: vec!["carol".into()],
        writers: vec!["bob".into()],
        callers: Vec::new(),
        ..Access::default()
    };
    let far = SessionConfig {
        listen: vec!["tls/127.0.0.1:0".into()],
        tls: Some(authority.tls("alice")),
        access_control: Some(access.rules().unwrap()),
        ..SessionConfig::default()
    };
    let far = Session::open(&far).await.unwrap();
    let memory = Arc::new(armarium_knowledge::working_memory(Arc::new(|| 1)));
    memory.commit_now(commit("alice", "cup")).unwrap();
    let shared = Arc::clone(&memory);
    let options = ServerOptions { guarded: true, store: None };
    let _server = MemoryServer::start(&far, "alice", shared, options).await.unwrap();
    let endpoints = far.endpoints().await;
    let open = async |tls: Tls| {
        let config = SessionConfig { tls: Some(tls), ..SessionConfig::connected_to(&endpoints) };
        Session::open(&config).await
    };

    // A writer writes segments of his own name, sees his changes, and is refused for other segments.
    let session = open(authority.tls("bob")).await.unwrap();
    let bob = RemoteMemory::connect_as(&session, "alice", "bob").await.unwrap();
    let mut changes = bob.subscribe(&Pattern::any()).await.unwrap();
    assert_eq!(bob.commit(commit("bob", "sponge")).await, Ok(vec![1]));
    assert_eq!(changes.recv().await.unwrap().id.as_str(), "Things/bob/sponge");
    assert_eq!(bob.commit(commit("bob.vision", "plate")).await, Ok(vec![1]));
    for provider in ["alice", "bobby", "carol"] {
        let id = format!("Things/{provider}/cup");
        let refused = bob.commit(commit(provider, "cup")).await;
        assert_eq!(refused, Err(MemoryError::Forbidden { id, writer: "bob".into() }));
    }
    let both = [commit("bob", "fork"), commit("alice", "fork")].concat();
    assert!(matches!(bob.commit(both).await, Err(MemoryError::Forbidden { .. })));
    assert_eq!(everything(&bob).await, 3, "all of a commit or nothing");
    let kept = bob.maintain(&Maintain::Compact).await;
    assert!(matches!(kept, Err(MemoryError::Forbidden { .. })), "{kept:?}");

    // A client cannot use another's name: there is no answer, which is an error.
    let as_alice = RemoteMemory::connect_as(&session, "alice", "alice").await;
    assert!(matches!(as_alice, Err(MemoryError::Remote { .. })), "{as_alice:?}");

    // A reader reads, and his write is refused.
    let session = open(authority.tls("carol")).await.unwrap();
    let carol = RemoteMemory::connect(&session, "alice").await.unwrap();
    assert_eq!(everything(&carol).await, 3);
    let refused = carol.commit(commit("carol", "cup")).await;
    assert!(matches!(refused, Err(MemoryError::Forbidden { .. })), "{refused:?}");
    // A name of his own does not make him a writer.
    let as_writer = RemoteMemory::connect_as(&session, "alice", "carol").await;
    assert!(matches!(as_writer, Err(MemoryError::Remote { .. })), "{as_writer:?}");

    // A stranger with a valid certificate reads nothing; one of another authority cannot even connect.
    let session = open(authority.tls("mallory")).await.unwrap();
    let stranger = RemoteMemory::connect(&session, "alice").await;
    assert!(matches!(stranger, Err(MemoryError::Remote { .. })), "{stranger:?}");
    let other = tempfile::tempdir().unwrap();
    let forged = Tls {
        root_ca: folder.path().join("ca.pem").display().to_string(),
        ..Authority::new(other.path()).tls("bob")
    };
    if let Ok(session) = open(forged).await {
        let forged = RemoteMemory::connect_as(&session, "alice", "bob").await;
        assert!(matches!(forged, Err(MemoryError::Remote { .. })), "{forged:?}");
    }
    assert_eq!(memory.len(), 3);
}
