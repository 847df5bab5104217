//! Yesterday's client: what a program of the first release sends, byte by byte, is understood, and it understands the
//! answers. Tomorrow's: fields that are not known yet are ignored.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_bus::session::Reply;
use armarium_bus::{Key, Session, SessionConfig, decode, encode, keys};
use armarium_memoryx::{MemoryServer, ServerOptions, WorkingMemory};
use serde::Deserialize;
use serde_json::json;

/// A commit of `Things/p/cup` with `value: 7`, as it was recorded.
const COMMIT: &str = "\
    a2677570646174657381a46269646c5468696e67732f702f6375706d7265666572656e6365645f6e730369696e\
    7374616e63657381a26a61747472696275746573a16576616c7565a163696e74076a636f6e666964656e6365fb\
    3ff00000000000007065787065637465645f76657273696f6e006773656e745f6e7305";
/// A query of the history of `Things/*/cup`, with all fields that there were.
const QUERY: &str = "\
    ab677061747465726ea3677365676d656e74665468696e67736870726f7669646572f666656e74697479636375\
    706574696d657363616c6c6d617272697665645f73696e6365f66666696c746572f666726567696f6ef6656c69\
    6d6974f6656166746572f6646d6f7374f66a6d6f73745f6279746573f66772656d6f766564f4696c6f6e675f74\
    65726df4";

/// The answers as they were decoded.
#[derive(Debug, Deserialize)]
#[serde(transparent)]
struct Versions(Vec<u64>);

#[derive(Debug, Deserialize)]
struct Snapshots {
    snapshots: Vec<Snapshot>,
    more: bool,
}

#[derive(Debug, Deserialize)]
struct Changes {
    epoch: u64,
    first: u64,
    until_ns: u64,
    snapshots: Vec<Snapshot>,
}

/// A snapshot as that program knew it, and not as it is today.
#[derive(Debug, PartialEq, Deserialize)]
struct Snapshot {
    id: String,
    version: u64,
    referenced_ns: u64,
    sent_ns: u64,
    arrived_ns: u64,
    instances: Vec<Instance>,
}

#[derive(Debug, PartialEq, Deserialize)]
struct Instance {
    attributes: BTreeMap<String, Value>,
    confidence: f64,
}

#[derive(Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Value {
    Int(i64),
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits = hex.as_bytes().chunks(2).map(|two| std::str::from_utf8(two).unwrap());
    digits.map(|two| u8::from_str_radix(two, 16).unwrap()).collect()
}

async fn ask(session: &Session, schema: &str, content: Vec<u8>) -> (String, Vec<u8>) {
    let key: Key = keys::memory_commit("alice").unwrap();
    let encoding = format!("application/cbor;memoryx/{schema}");
    match session.query_one(&key, "", Some((&encoding, content))).await.unwrap() {
        Reply::Message(message) => (message.encoding, message.payload),
        Reply::Refusal { payload, .. } => panic!("{schema}: {}", String::from_utf8_lossy(&payload)),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_is_understood_and_understands() {
    let far = Session::open(&SessionConfig::default()).await.unwrap();
    let memory = Arc::new(WorkingMemory::new(Arc::new(|| 7)));
    let _server =
        MemoryServer::start(&far, "alice", Arc::clone(&memory), ServerOptions::default()).await.unwrap();
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.unwrap();
    let all = Key::parse("alice/memory/changes").unwrap();
    let mut told = near.subscribe(all, 64).await.unwrap();

    let (encoding, payload) = ask(&near, "commit;v1", bytes(COMMIT)).await;
    assert_eq!(encoding, "application/cbor;memoryx/versions;v1");
    assert_eq!(decode::<Versions>(&payload).unwrap().0, [1]);
    let (encoding, payload) = ask(&near, "query;v1", bytes(QUERY)).await;
    assert_eq!(encoding, "application/cbor;memoryx/snapshots;v2");
    let found: Snapshots = decode(&payload).unwrap();
    assert!(!found.more);
    let [cup] = &found.snapshots[..] else { panic!("{found:?}") };
    assert_eq!((cup.id.as_str(), cup.version, cup.referenced_ns, cup.sent_ns), ("Things/p/cup", 1, 3, 5));
    assert_eq!(cup.instances[0].attributes.get("value"), Some(&Value::Int(7)));

    // Its subscription may have come after the first change; then only the number says that there was one.
    let message = told.next().await.unwrap();
    assert_eq!(message.encoding, "application/cbor;memoryx/changes;v1");
    let changes: Changes = decode(&message.payload).unwrap();
    assert!(changes.epoch > 0 && changes.first + changes.snapshots.len() as u64 == 1, "{changes:?}");
    assert!(changes.until_ns == 7 && changes.snapshots.iter().all(|change| change == cup));

    // An update and a query with fields that this program does not know, and without those that may be left out.
    let instance = json!({"attributes": {"value": {"int": 8}}, "confidence": 1.0, "origin": ["door"]});
    let update = json!({
        "id": "Things/p/plate", "referenced_ns": 7, "referenced_clock": "run", "instances": [instance],
    });
    let commit = json!({"updates": [update], "sent_ns": 5, "priority": 3});
    let (_, payload) = ask(&near, "commit;v1", encode(&commit).unwrap()).await;
    assert_eq!(decode::<Versions>(&payload).unwrap().0, [1]);
    let query = json!({"times": "latest", "sorted_by": "size"});
    let (_, payload) = ask(&near, "query;v1", encode(&query).unwrap()).await;
    assert_eq!(decode::<Snapshots>(&payload).unwrap().snapshots.len(), 2);
}
