//! Two real sessions on loopback, on free ports.

use std::time::Duration;

use crate::bulk::{Bulk, BulkReader, BulkSender};
use crate::error::SessionError;
use crate::keys::{self, KeyPattern};
use crate::session::{REPLY_TIMEOUT, Reply, Session, SessionConfig};

async fn pair() -> (Session, Session) {
    let one = Session::open(&SessionConfig::default()).await.unwrap();
    let two = Session::open(&SessionConfig::connected_to(&one.endpoints().await)).await.unwrap();
    (one, two)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_is_there_is_known_at_once() {
    let (far, near) = pair().await;
    let service = keys::alive("alice", "agent").unwrap();
    let those = KeyPattern::from(service.clone());
    let most = Duration::from_secs(60);
    assert_eq!(far.is_alive(&those, most).await, Ok(false));
    let token = far.alive(&service).await.unwrap();
    while near.is_alive(&those, most).await != Ok(true) {}
    let other = KeyPattern::from(keys::alive("bob", "agent").unwrap());
    assert_eq!(near.is_alive(&other, most).await, Ok(false));
    drop(token);
}

/// Whoever opens a session can put and ask at once, however much others offer.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_put_and_asked_as_soon_as_a_session_is_open_is_heard() {
    let far = Session::open(&SessionConfig::default()).await.unwrap();
    let mut heard = Vec::new();
    for channel in 0..500 {
        let key = keys::live("alice", &format!("c{channel}")).unwrap();
        heard.push((key.clone(), far.subscribe(key, 64).await.unwrap()));
    }
    let other = Session::open(&SessionConfig::default()).await.unwrap();
    let asked = keys::chart("bob", "bench").unwrap();
    let mut questions = other.declare_queryable(asked.clone(), 64).await.unwrap();
    let reply = asked.clone();
    tokio::spawn(async move {
        while let Some(question) = questions.next().await {
            question.reply(&reply, "e", vec![7]).await.unwrap();
        }
    });
    let endpoints = [far.endpoints().await, other.endpoints().await].concat();
    let config = SessionConfig::connected_to(&endpoints);
    for round in 0..20_u8 {
        let near = Session::open(&config).await.unwrap();
        assert!(matches!(near.query_one(&asked, "", None).await, Ok(Reply::Message(_))));
        for (key, heard) in heard.iter_mut().rev().step_by(50) {
            near.put_waiting(key, "e", vec![round]).await.unwrap();
            let message = tokio::time::timeout(REPLY_TIMEOUT, heard.next()).await;
            assert_eq!(message.unwrap().unwrap().payload, [round], "{key}");
        }
    }
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_unix_socket_is_for_its_user_only() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("socket");
    let endpoint = format!("unixsock-stream/{}", socket.display());
    let config = SessionConfig { listen: vec![endpoint.clone()], ..SessionConfig::default() };
    let far = Session::open(&config).await.unwrap();
    let rights = std::os::unix::fs::PermissionsExt::mode(&std::fs::metadata(&socket).unwrap().permissions());
    assert_eq!(rights & 0o777, 0o600);
    let config =
        SessionConfig { mode: crate::session::Mode::Client, ..SessionConfig::connected_to(&[endpoint]) };
    let near = Session::open(&config).await.unwrap();
    let service = keys::alive("alice", "agent").unwrap();
    let _token = far.alive(&service).await.unwrap();
    while near.is_alive(&KeyPattern::from(service.clone()), Duration::from_secs(60)).await != Ok(true) {}
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_put_arrives_with_what_names_it() {
    let (one, two) = pair().await;
    let key = keys::event("alice").unwrap();
    let mut heard = two.subscribe(key.clone(), 16).await.unwrap();
    // The other side learns of a subscription with a delay: ask until it knows.
    let message = loop {
        one.put(&key, "application/cbor;test;v1", vec![1, 2, 3]).await.unwrap();
        let wait = tokio::time::timeout(std::time::Duration::from_millis(20), heard.next());
        if let Ok(message) = wait.await {
            break message.unwrap();
        }
    };
    assert_eq!(message.key, "alice/event");
    assert_eq!(message.encoding, "application/cbor;test;v1");
    assert_eq!(message.payload, [1, 2, 3]);
    assert!(message.sent_ns.unwrap() <= one.now_ns());
    assert!(message.sender.is_some());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn questions_are_answered_refused_or_unanswered() {
    let (one, two) = pair().await;
    let key = keys::memory_commit("alice").unwrap();
    let mut questions = one.declare_queryable(key.clone(), 16).await.unwrap();
    tokio::spawn(async move {
        while let Some(question) = questions.next().await {
            let reply_key = keys::memory_commit("alice").unwrap();
            match question.parameters.as_str() {
                "twice" => {
                    question.reply(&reply_key, "e", question.payload.clone()).await.unwrap();
                    question.reply(&reply_key, "e", vec![]).await.unwrap();
                }
                "no" => question.refuse("why", vec![9]).await.unwrap(),
                _ => {}
            }
        }
    });
    let answers = loop {
        let asked = two.query(key.clone(), "twice", Some(("e", vec![7])), 8, REPLY_TIMEOUT).await.unwrap();
        if !asked.is_empty() {
            break asked;
        }
    };
    let payloads: Vec<Vec<u8>> = answers
        .into_iter()
        .map(|answer| match answer {
            Reply::Message(message) => message.payload,
            Reply::Refusal { .. } => vec![255],
        })
        .collect();
    assert_eq!(payloads, [vec![7], vec![]], "both answers on one key arrive");
    let refusal = two.query_one(&key, "no", None).await.unwrap();
    assert_eq!(refusal, Reply::Refusal { encoding: "why".into(), payload: vec![9] });
    assert!(matches!(two.query_one(&key, "silence", None).await, Err(SessionError::NoReply { .. })));
    let too_many = two.query(key.clone(), "twice", None, 1, REPLY_TIMEOUT).await;
    assert!(matches!(too_many, Err(SessionError::TooManyReplies { most: 1, .. })));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_queue_counts_what_it_drops() {
    let one = Session::open(&SessionConfig::default()).await.unwrap();
    let key = keys::live("alice", "run").unwrap();
    let mut heard = one.subscribe(key.clone(), 2).await.unwrap();
    for i in 0..5 {
        one.put(&key, "e", vec![i]).await.unwrap();
    }
    assert_eq!(heard.dropped(), 3);
    assert_eq!([heard.next().await.unwrap().payload, heard.next().await.unwrap().payload], [[0], [1]]);
    assert_eq!(heard.try_next(), None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn services_are_seen_to_come_and_go() {
    let (one, two) = pair().await;
    let mut roll = two.watch_alive(&keys::alive_pattern(None, None).unwrap(), 16).await.unwrap();
    let token = one.alive(&keys::alive("alice", "memory").unwrap()).await.unwrap();
    let come = roll.next().await.unwrap();
    assert_eq!((come.key.as_str(), come.alive), ("alice/alive/memory", true));
    drop(token);
    let gone = roll.next().await.unwrap();
    assert_eq!((gone.key.as_str(), gone.alive), ("alice/alive/memory", false));
}

#[tokio::test]
async fn a_single_threaded_runtime_is_refused() {
    assert_eq!(Session::open(&SessionConfig::default()).await.unwrap_err(), SessionError::Runtime);
}

/// Sends a payload as a camera does, again and again until one has arrived whole. A stalled machine may lose single
/// payloads; one that arrives must be as it was sent.
async fn deliver(sender: &BulkSender, reader: &BulkReader, length: usize) -> Bulk {
    let attachment = [7, length as u8];
    for _ in 0..20 {
        let mut slot = sender.slot(length);
        assert_eq!(slot.len(), length);
        slot.fill(length as u8);
        sender.send(slot, attachment.to_vec()).await.unwrap();
        while let Ok(bulk) = tokio::time::timeout(Duration::from_secs(2), reader.next()).await {
            // An empty payload is sent as one byte: shared memory has no empty buffers.
            let bytes = bulk.payload.as_ref();
            let whole = bytes.iter().all(|b| *b == length as u8) && bytes.len() == length.max(1);
            if bulk.attachment == attachment && bulk.payload.is_intact() {
                assert!(whole || length == 0 && bytes.len() <= 1, "{} of {length}", bytes.len());
                return bulk;
            }
        }
    }
    panic!("none of 20 payloads of {length} bytes arrived");
}

async fn bulk_between(shared: [bool; 2], detached: bool) -> Vec<Bulk> {
    let config = |shared_memory| SessionConfig { shared_memory, ..SessionConfig::default() };
    let one = Session::open(&config(shared[0])).await.unwrap();
    let connected = SessionConfig { connect: one.endpoints().await, ..config(shared[1]) };
    let two = Session::open(&connected).await.unwrap();
    let key = keys::image("alice", "eyes").unwrap();
    let sender = one.bulk_sender(&key, "pixels").await.unwrap();
    assert!(!sender.is_wanted());
    let reader = two.bulk_reader(key, 2, detached).await.unwrap();
    sender.wanted().await;
    let mut heard = Vec::new();
    for length in LENGTHS {
        heard.push(deliver(&sender, &reader, length).await);
    }
    if detached {
        // Detached payloads stay valid, whatever the sender does.
        drop(sender);
        assert!(heard.iter().all(|bulk| bulk.payload.is_intact()));
    }
    heard
}

/// Varying sizes, among them one larger than any packet.
const LENGTHS: [usize; 6] = [0, 1, 70_000, 3_000_000, 5, 9_000_000];

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_payloads_arrive_whole_by_shared_memory_where_both_can() {
    for (shared, detached) in [([true, true], false), ([true, true], true), ([true, false], false)] {
        let heard = bulk_between(shared, detached).await;
        for bulk in heard {
            assert_eq!((bulk.key.as_str(), bulk.encoding.as_str()), ("alice/image/eyes", "pixels"));
            let by_shared_memory = shared == [true, true] && !detached;
            assert_eq!(bulk.payload.is_shared(), by_shared_memory, "{shared:?} {detached}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bulk_queue_keeps_the_newest_and_counts_the_others() {
    let one = Session::open(&SessionConfig::default()).await.unwrap();
    let key = keys::image_coded("alice", "eyes", "png").unwrap();
    let sender = one.bulk_sender(&key, "pixels").await.unwrap();
    let reader = one.bulk_reader(key, 2, false).await.unwrap();
    for i in 0..5u8 {
        let mut slot = sender.slot(1);
        slot[0] = i;
        sender.send(slot, Vec::new()).await.unwrap();
    }
    assert_eq!(reader.dropped(), 3);
    let kept = [reader.next().await, reader.next().await].map(|b| b.payload.as_ref()[0]);
    assert_eq!(kept, [3, 4]);
    assert!(reader.try_next().is_none());
}
