//! Yesterday's programs: what an earlier client sends, byte by byte, is understood, and it understands the answers; what an earlier
//! memory answers and publishes, byte by byte, is understood by a client of today. Tomorrow's: fields that are not known yet
//! are ignored.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::collections::BTreeMap;
use std::sync::Arc;

use armarium_bus::session::Reply;
use armarium_bus::{Key, Session, SessionConfig, decode, encode, keys};
use armarium_memoryx::wire::Maintain;
use armarium_memoryx::{
    Change, Commit, Follower, LongTermMemory, Memory, MemoryError, MemoryServer, Pattern, RemoteMemory,
    ServerOptions, WorkingMemory,
};
use serde::{Deserialize, Serialize};
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

/// The list of all of `Things`; the numbers and the names of a file; an update of `Things/p/fork` with `value: 9`.
const LIST: &str = "\
    a2677061747465726ea3677365676d656e74665468696e67736870726f7669646572f666656e74697479f6656166\
    746572f6";
const STATS: &str = "657374617473";
const NAMES: &str = "656e616d6573";
const UPDATE: &str = "\
    a46269646d5468696e67732f702f666f726b6d7265666572656e6365645f6e730369696e7374616e63657381a26a\
    61747472696275746573a16576616c7565a163696e74096a636f6e666964656e6365fb3ff0000000000000706578\
    7065637465645f76657273696f6ef6";

/// What an earlier memory answers: of `Things/p/cup` with `value: 7`, version 1; and publishes: `value: 8`, version 2.
const ANSWERS: [(&str, &str, &str); 4] = [
    ("commit", "versions;v1", "8104"),
    (
        "query",
        "snapshots;v2",
        "a269736e617073686f747381a66269646c5468696e67732f702f6375706776657273696f6e016d7265666572656e\
         6365645f6e73036773656e745f6e73056a617272697665645f6e730769696e7374616e63657381a26a6174747269\
         6275746573a16576616c7565a163696e74076a636f6e666964656e6365fb3ff0000000000000646d6f7265f4",
    ),
    ("list", "heads;v1", "a268656e74697469657381846c5468696e67732f702f6375700107f4646e657874f6"),
    ("maintain", "report;v1", "a266636f756e7473a168656e7469746965730165776f72647380"),
];
const CHANGES: &str = "\
    a36565706f6368096566697273740069736e617073686f747381a66269646c5468696e67732f702f637570677665\
    7273696f6e026d7265666572656e6365645f6e73036773656e745f6e73056a617272697665645f6e730769696e73\
    74616e63657381a26a61747472696275746573a16576616c7565a163696e74086a636f6e666964656e6365fb3ff0\
    000000000000";
/// The refusal of a commit that expects version 1 of the cup, which has version 2.
const REFUSAL: &str = "\
    a168636f6e666c696374a36269646c5468696e67732f702f637570686578706563746564016661637475616c02";

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
struct Heads {
    entities: Vec<(String, u64, u64, bool)>,
    next: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Report {
    counts: BTreeMap<String, u64>,
    words: Vec<String>,
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

/// What tomorrow's program asks, with `null` for what it leaves out.
#[derive(Serialize)]
struct Asked {
    times: &'static str,
    sorted_by: &'static str,
    pattern: Option<u8>,
    removed: Option<u8>,
    parts: Option<u8>,
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
    let folder = tempfile::tempdir().unwrap();
    let store = Arc::new(LongTermMemory::open(&folder.path().join("alice.redb")).unwrap());
    let memory = WorkingMemory::new(Arc::new(|| 7)).with_backing(Arc::<LongTermMemory>::clone(&store));
    let options = ServerOptions { store: Some(store), guarded: false };
    let _server = MemoryServer::start(&far, "alice", Arc::new(memory), options).await.unwrap();
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

    let (encoding, payload) = ask(&near, "list;v1", bytes(LIST)).await;
    assert_eq!(encoding, "application/cbor;memoryx/heads;v1");
    let heads: Heads = decode(&payload).unwrap();
    assert!(
        heads.entities == [("Things/p/cup".to_owned(), 1, 7, false)] && heads.next.is_none(),
        "{heads:?}"
    );
    for (request, count) in [(STATS, Some(1)), (NAMES, None)] {
        let (encoding, payload) = ask(&near, "maintain;v1", bytes(request)).await;
        assert_eq!(encoding, "application/cbor;memoryx/report;v1");
        let report: Report = decode(&payload).unwrap();
        assert!(report.counts.get("entities").copied() == count && report.words.is_empty(), "{report:?}");
    }
    let fork = Key::parse("alice/memory/Things/p/fork").unwrap();
    near.put_waiting(&fork, "application/cbor;memoryx/update;v1", bytes(UPDATE)).await.unwrap();
    while told.next().await.unwrap().payload.len() < 100 {}
    let Reply::Message(got) = near.query_one(&fork, "history;limit=1", None).await.unwrap() else { panic!() };
    assert_eq!(
        (got.key.as_str(), got.encoding.as_str()),
        (fork.as_str(), "application/cbor;memoryx/entity;v1")
    );
    let fork: Snapshot = decode(&got.payload).unwrap();
    assert_eq!(fork.instances[0].attributes.get("value"), Some(&Value::Int(9)));

    // An update and a query with fields that this program does not know, and without those that may be left out.
    let instance = json!({"attributes": {"value": {"int": 8}}, "origin": ["door"]});
    let update = json!({
        "id": "Things/p/plate", "referenced_ns": 7, "referenced_clock": "run", "instances": [instance, {}],
    });
    let commit = json!({"updates": [update], "priority": 3});
    let (_, payload) = ask(&near, "commit;v1", encode(&commit).unwrap()).await;
    assert_eq!(decode::<Versions>(&payload).unwrap().0, [1]);
    let query = Asked { times: "latest", sorted_by: "size", pattern: None, removed: None, parts: None };
    let (_, payload) = ask(&near, "query;v1", encode(&query).unwrap()).await;
    let snapshots = decode::<Snapshots>(&payload).unwrap().snapshots;
    assert_eq!(snapshots.len(), 3);
    let plate = snapshots.iter().find(|one| one.id == "Things/p/plate").unwrap();
    assert_eq!((plate.sent_ns, plate.instances[0].confidence), (0, 1.0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn its_answers_are_understood() {
    let far = Session::open(&SessionConfig::default()).await.unwrap();
    let near = Session::open(&SessionConfig::connected_to(&far.endpoints().await)).await.unwrap();
    let key: Key = keys::memory_commit("alice").unwrap();
    let mut asked = far.declare_queryable(key.clone(), 16).await.unwrap();
    let mut is_refused = false;
    let _answering = tokio::spawn(async move {
        while let Some(question) = asked.next().await {
            let answer =
                ANSWERS.iter().find(|(what, ..)| question.encoding.contains(&format!("memoryx/{what};")));
            let (what, encoding, payload) = answer.unwrap();
            // The second commit is one that the memory refuses.
            if *what == "commit" && std::mem::replace(&mut is_refused, true) {
                question.refuse("application/cbor;memoryx/error;v1", bytes(REFUSAL)).await.unwrap();
                continue;
            }
            let encoding = format!("application/cbor;memoryx/{encoding}");
            question.reply(&key, &encoding, bytes(payload)).await.unwrap();
        }
    });
    let _alive = far.alive(&keys::alive("alice", "memory").unwrap()).await.unwrap();
    let remote = RemoteMemory::connect(&near, "alice").await.unwrap();
    let cup = "Things/p/cup".parse().unwrap();
    let seven = remote.latest(&cup).await.unwrap();
    assert_eq!((seven.version, seven.attribute("value")), (1, Some(&armarium_values::Value::Int(7))));
    let commit =
        || Commit { expected_version: Some(1), ..Commit::new("Things/p/cup".parse().unwrap(), 3, []) };
    assert_eq!(remote.commit(vec![commit()]).await, Ok(vec![4]));
    let refusal = MemoryError::Conflict { id: "Things/p/cup".into(), expected: 1, actual: 2 };
    assert_eq!(remote.commit(vec![commit()]).await, Err(refusal));
    assert_eq!(remote.maintain(&Maintain::Stats).await.unwrap().counts["entities"], 1);
    let (mut follower, heads) =
        Follower::from_now(Arc::new(remote), Pattern::segment("Things")).await.unwrap();
    assert_eq!((heads.len(), heads[0].version, heads[0].arrived_ns), (1, 1, 7));
    let told = keys::memory_changes_of("alice", "Things").unwrap();
    far.put_waiting(&told, "application/cbor;memoryx/changes;v1", bytes(CHANGES)).await.unwrap();
    let Some(Change::New(eight)) = follower.next().await.unwrap() else { panic!("one is missing") };
    assert_eq!((eight.version, eight.attribute("value")), (2, Some(&armarium_values::Value::Int(8))));
}
