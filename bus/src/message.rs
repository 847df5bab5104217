//! What comes over a session: messages, questions and answers, and who appears and goes. Nothing here interprets
//! payloads.

use zenoh::bytes::Encoding;
use zenoh::sample::{SampleKind, SourceInfo};

use crate::error::{SessionError, failed};
use crate::keys::Key;
use crate::queue::{Queue, Weigh};

/// A payload with what names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The key it was put on, as Zenoh writes it.
    pub key: String,
    /// Whether the key was deleted; the payload is empty then.
    pub deleted: bool,
    /// What the payload is, `application/cbor;NAME;vN`.
    pub encoding: String,
    /// The payload.
    pub payload: Vec<u8>,
    /// When it was sent, ns since 1970 by the sender's clock, where the sender said so.
    pub sent_ns: Option<u64>,
    /// The session that sent it, where known.
    pub sender: Option<String>,
}

/// An answer to a question.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// What was asked for.
    Message(Message),
    /// The other side refuses; its payload says why.
    Refusal {
        /// What the payload is.
        encoding: String,
        /// Why.
        payload: Vec<u8>,
    },
}

/// What a subscription's queue holds: all that came, unless it was full.
#[derive(Debug)]
pub struct Subscription {
    pub(crate) queue: Queue<Message>,
    pub(crate) _declared: zenoh::pubsub::Subscriber<()>,
}

/// The questions that others ask on a key.
#[derive(Debug)]
pub struct Questions {
    pub(crate) queue: Queue<Question>,
    pub(crate) _declared: zenoh::query::Queryable<()>,
}

/// A question of another session. It ends, for the asker too, when it is dropped.
#[derive(Debug)]
pub struct Question {
    /// The key or key expression that was asked for.
    pub key: String,
    /// What follows the `?`.
    pub parameters: String,
    /// The payload's encoding; empty without one.
    pub encoding: String,
    /// The payload that came with the question; empty without one.
    pub payload: Vec<u8>,
    /// The session that asks, where it says so.
    pub sender: Option<String>,
    query: zenoh::query::Query,
}

/// A service has appeared or gone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Liveliness {
    /// Its key.
    pub key: String,
    /// Whether it is there.
    pub alive: bool,
}

/// The services that appear and go.
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

    /// The next message if there is one already.
    pub fn try_next(&mut self) -> Option<Message> {
        self.queue.try_next()
    }

    /// How many messages have not fitted into the queue so far, by number or by bytes.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }
}

impl Roll {
    /// The next service that has appeared or gone; `None` when the session has closed.
    pub async fn next(&mut self) -> Option<Liveliness> {
        self.queue.next().await
    }
}

impl Questions {
    /// The next question; `None` when the session has closed.
    pub async fn next(&mut self) -> Option<Question> {
        self.queue.next().await
    }

    /// The next question if there is one already.
    pub fn try_next(&mut self) -> Option<Question> {
        self.queue.try_next()
    }

    /// How many questions have not fitted into the queue so far; they got no answer.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }
}

impl Question {
    /// One answer, of perhaps many, on a key that the question fits.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn reply(&self, key: &Key, encoding: &str, payload: Vec<u8>) -> Result<(), SessionError> {
        let reply = self.query.reply(key.as_str(), payload).encoding(Encoding::from(encoding));
        reply.await.map_err(failed)
    }

    /// Refuses, with a payload that says why.
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

/// The session that something comes from, if it says so.
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
