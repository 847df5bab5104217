//! What a session receives: messages, queries and answers, and services that start and stop. Payloads are not
//! interpreted.

use zenoh::bytes::Encoding;
use zenoh::sample::{SampleKind, SourceInfo};

use crate::error::{SessionError, failed};
use crate::keys::Key;
use crate::queue::{Queue, Weigh};

/// A payload with its metadata.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The key, as Zenoh writes it.
    pub key: String,
    /// Whether this is a deletion; the payload is empty then.
    pub deleted: bool,
    /// The encoding, `application/cbor;NAME;vN`.
    pub encoding: String,
    /// The payload.
    pub payload: Vec<u8>,
    /// When it was sent, ns since 1970 by the sender's clock; `None` when the sender did not say.
    pub sent_ns: Option<u64>,
    /// The session that sent it, where known.
    pub sender: Option<String>,
}

/// An answer to a query.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The result.
    Message(Message),
    /// The other side refuses; the payload gives the reason.
    Refusal {
        /// The payload's encoding.
        encoding: String,
        /// The reason.
        payload: Vec<u8>,
    },
}

/// A subscription and its queue. When the queue is full, new messages are dropped.
#[derive(Debug)]
pub struct Subscription {
    pub(crate) queue: Queue<Message>,
    pub(crate) _declared: zenoh::pubsub::Subscriber<()>,
}

/// The queries that arrive at a queryable.
#[derive(Debug)]
pub struct Questions {
    pub(crate) queue: Queue<Question>,
    pub(crate) _declared: zenoh::query::Queryable<()>,
}

/// A query from another session. Dropping it ends it for the caller too.
#[derive(Debug)]
pub struct Question {
    /// The queried key or key expression.
    pub key: String,
    /// The part after the `?`.
    pub parameters: String,
    /// The payload's encoding; empty without one.
    pub encoding: String,
    /// The query's payload; empty without one.
    pub payload: Vec<u8>,
    /// The session that sent it, if it says so.
    pub sender: Option<String>,
    query: zenoh::query::Query,
}

/// A service has started or stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Liveliness {
    /// Its key.
    pub key: String,
    /// Whether it runs.
    pub alive: bool,
}

/// The starts and stops of services.
#[derive(Debug)]
pub struct Roll {
    pub(crate) queue: Queue<Liveliness>,
    pub(crate) _declared: zenoh::pubsub::Subscriber<()>,
}

impl Subscription {
    /// The next message; `None` when the session has closed.
    pub async fn next(&mut self) -> Option<Message> {
        self.queue.next().await
    }

    /// The next message, if one is in the queue.
    pub fn try_next(&mut self) -> Option<Message> {
        self.queue.try_next()
    }

    /// How many messages were dropped so far, because of their number or their bytes.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }
}

impl Roll {
    /// The next service that has started or stopped; `None` when the session has closed.
    pub async fn next(&mut self) -> Option<Liveliness> {
        self.queue.next().await
    }
}

impl Questions {
    /// The next query; `None` when the session has closed.
    pub async fn next(&mut self) -> Option<Question> {
        self.queue.next().await
    }

    /// The next query, if one is in the queue.
    pub fn try_next(&mut self) -> Option<Question> {
        self.queue.try_next()
    }

    /// How many queries were dropped so far; they got no answer.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }
}

impl Question {
    /// Sends an answer, of possibly several, on a key that matches the query.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn reply(&self, key: &Key, encoding: &str, payload: Vec<u8>) -> Result<(), SessionError> {
        let reply = self.query.reply(key.as_str(), payload).encoding(Encoding::from(encoding));
        reply.await.map_err(failed)
    }

    /// Refuses the query; the payload gives the reason.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn refuse(&self, encoding: &str, payload: Vec<u8>) -> Result<(), SessionError> {
        self.query.reply_err(payload).encoding(Encoding::from(encoding)).await.map_err(failed)
    }
}

impl Weigh for Message {
    fn bytes(&self) -> usize {
        self.key.len() + self.payload.len()
    }
}

impl Weigh for Question {
    fn bytes(&self) -> usize {
        self.parameters.len() + self.payload.len()
    }
}

impl Weigh for Answer {
    fn bytes(&self) -> usize {
        match self {
            Self::Message(message) => message.bytes(),
            Self::Refusal { payload, .. } => payload.len(),
        }
    }
}

impl Weigh for Liveliness {
    fn bytes(&self) -> usize {
        self.key.len()
    }
}

/// The session that sent something, if it says so.
fn source(info: Option<&SourceInfo>) -> Option<String> {
    info.map(|info| info.source_id().zid().to_string())
}

pub(crate) fn of_sample(sample: &zenoh::sample::Sample) -> Message {
    Message {
        key: sample.key_expr().to_string(),
        deleted: sample.kind() == SampleKind::Delete,
        encoding: sample.encoding().to_string(),
        payload: sample.payload().to_bytes().into_owned(),
        sent_ns: sample.timestamp().map(nanoseconds),
        sender: source(sample.source_info())
            .or_else(|| sample.timestamp().map(|stamp| stamp.get_id().to_string())),
    }
}

pub(crate) fn of_reply(reply: &zenoh::query::Reply) -> Answer {
    match reply.result() {
        Ok(sample) => Answer::Message(of_sample(sample)),
        Err(error) => Answer::Refusal {
            encoding: error.encoding().to_string(),
            payload: error.payload().to_bytes().into_owned(),
        },
    }
}

pub(crate) fn of_query(query: zenoh::query::Query) -> Question {
    Question {
        key: query.key_expr().to_string(),
        parameters: query.parameters().to_string(),
        sender: source(query.source_info()),
        encoding: query.encoding().map(ToString::to_string).unwrap_or_default(),
        payload: query.payload().map(|p| p.to_bytes().into_owned()).unwrap_or_default(),
        query,
    }
}

pub(crate) fn nanoseconds(stamp: &zenoh::time::Timestamp) -> u64 {
    stamp.get_time().as_nanos()
}
