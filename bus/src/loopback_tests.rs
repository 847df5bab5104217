//! Two real sessions on loopback, on ports that were free.

use crate::keys;
use crate::session::{ANSWER_TIMEOUT, Answer, Session, SessionConfig, SessionError};

async fn pair() -> (Session, Session) {
    let one = Session::open(&SessionConfig::default()).await.unwrap();
    let two = Session::open(&SessionConfig::connected_to(&one.endpoints().await)).await.unwrap();
    (one, two)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_put_arrives_with_what_names_it() {
    let (one, two) = pair().await;
    let key = keys::robot_state("alice").unwrap();
    let mut heard = two.subscribe(key.clone(), 16).await.unwrap();
    // A subscription is known to the other side some time after it was declared: ask until it is.
    let message = loop {
        one.put(&key, "application/cbor;test;v1", vec![1, 2, 3]).await.unwrap();
        let wait = tokio::time::timeout(std::time::Duration::from_millis(20), heard.next());
        if let Ok(message) = wait.await {
            break message.unwrap();
        }
    };
    assert_eq!(message.key, "alice/robot/state");
    assert_eq!(message.encoding, "application/cbor;test;v1");
    assert_eq!(message.payload, [1, 2, 3]);
    assert!(message.sent_ns.unwrap() <= one.now_ns());
    assert!(message.sender.is_some());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn questions_are_answered_refused_or_unanswered() {
    let (one, two) = pair().await;
    let key = keys::memory_commit("alice").unwrap();
    let mut questions = one.answer(key.clone(), 16).await.unwrap();
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
        let asked = two.ask(key.clone(), "twice", Some(("e", vec![7])), 8, ANSWER_TIMEOUT).await.unwrap();
        if !asked.is_empty() {
            break asked;
        }
    };
    let payloads: Vec<Vec<u8>> = answers
        .into_iter()
        .map(|answer| match answer {
            Answer::Message(message) => message.payload,
            Answer::Refusal { .. } => vec![255],
        })
        .collect();
    assert_eq!(payloads, [vec![7], vec![]], "both answers on one key arrive");
    let refusal = two.ask_one(&key, "no", None).await.unwrap();
    assert_eq!(refusal, Answer::Refusal { encoding: "why".into(), payload: vec![9] });
    assert!(matches!(two.ask_one(&key, "silence", None).await, Err(SessionError::NoAnswer { .. })));
    let too_many = two.ask(key.clone(), "twice", None, 1, ANSWER_TIMEOUT).await;
    assert!(matches!(too_many, Err(SessionError::TooManyAnswers { most: 1, .. })));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_queue_counts_what_it_drops() {
    let one = Session::open(&SessionConfig::default()).await.unwrap();
    let key = keys::trace("alice", "run").unwrap();
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
