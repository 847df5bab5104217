//! What a session receives: messages, queries and answers, and services that start and stop. Payloads are not
//! interpreted.

use std::pin::Pin;

use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::sample::{SampleKind, SourceInfo};

use crate::error::{SessionError, failed};
use crate::keys::Key;
use crate::queue::Receiver;
use crate::turns::{AskerTurn, Turns};

/// A future of the session. Its type is hidden, so that those who wait for it are not compiled with Zenoh inside.
pub type Boxed<'a, T> = Pin<Box<dyn Future<Output = Result<T, SessionError>> + Send + 'a>>;

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
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Reply {
    /// The result.
    Message(Message),
    /// The other side refuses; the payload gives the reason.
    Refusal { encoding: String, payload: Vec<u8> },
}

/// A subscription and its queue. When the queue is full, new messages are dropped.
pub type Subscription = Receiver<Message>;

/// The queries that arrive at a queryable.
pub type Queryable = Receiver<IncomingQuery>;

/// The starts and stops of services.
pub type LivelinessSubscription = Receiver<Liveliness>;

/// A query from another session. Dropping it ends it for the caller too.
#[derive(Debug)]
pub struct IncomingQuery {
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
    turn: AskerTurn,
    query: Option<zenoh::query::Query>,
}

/// A service has started or stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Liveliness {
    /// Its key.
    pub key: String,
    /// Whether it runs.
    pub alive: bool,
}

impl IncomingQuery {
    /// Sends an answer, of possibly several, on a key that matches the query.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn reply<'a>(&'a self, key: &'a Key, encoding: &str, payload: Vec<u8>) -> Boxed<'a, ()> {
        let encoding = Encoding::from(encoding);
        self.send(move |query| query.reply(key.as_str(), payload).encoding(encoding).wait())
    }

    /// Refuses the query; the payload gives the reason.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn refuse(&self, encoding: &str, payload: Vec<u8>) -> Boxed<'_, ()> {
        let encoding = Encoding::from(encoding);
        self.send(move |query| query.reply_err(payload).encoding(encoding).wait())
    }

    fn send<'a>(
        &'a self,
        send: impl FnOnce(&zenoh::query::Query) -> zenoh::Result<()> + Send + 'a,
    ) -> Boxed<'a, ()> {
        Box::pin(async move {
            let Some(query) = &self.query else { return Ok(()) };
            self.turn.take(|| send(query)).await.map_err(failed)
        })
    }
}

impl Drop for IncomingQuery {
    /// Zenoh tells the asker that no more answers come.
    fn drop(&mut self) {
        let query = self.query.take();
        self.turn.take_later(|| drop(query));
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

pub(crate) fn of_reply(reply: &zenoh::query::Reply) -> Reply {
    match reply.result() {
        Ok(sample) => Reply::Message(of_sample(sample)),
        Err(error) => Reply::Refusal {
            encoding: error.encoding().to_string(),
            payload: error.payload().to_bytes().into_owned(),
        },
    }
}

pub(crate) fn of_query(query: zenoh::query::Query, turns: &Turns) -> IncomingQuery {
    let sender = source(query.source_info());
    IncomingQuery {
        key: query.key_expr().to_string(),
        parameters: query.parameters().to_string(),
        turn: turns.of(sender.as_deref()),
        sender,
        encoding: query.encoding().map(ToString::to_string).unwrap_or_default(),
        payload: query.payload().map(|p| p.to_bytes().into_owned()).unwrap_or_default(),
        query: Some(query),
    }
}

pub(crate) fn nanoseconds(stamp: &zenoh::time::Timestamp) -> u64 {
    stamp.get_time().as_nanos()
}
