//! What control needs of a session: small messages that go out at once from any thread, those that are taken where they
//! arrive, and questions that hold up the thread that asks. Payloads are not interpreted.
//!
//! Everything else waits in queues and asynchronously: see [`session`](crate::session).

use std::fmt;
use std::sync::mpsc;
use std::time::Duration;

use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{SampleKind, SourceInfo};

use crate::error::{SessionError, failed};
use crate::keys::{Key, KeyPattern};
use crate::message::{Boxed, Message, Reply, of_reply, of_sample};
use crate::session::Session;

/// Answers that wait for one question; more are dropped.
const MAX_ANSWERS: usize = 16;

/// Sends small messages on one key, before all others of the session, each at once and none together. Under congestion
/// they are dropped.
pub struct ControlSender(Publisher<'static>);

/// Takes the messages of some keys until it is dropped.
pub struct ControlReader(
    #[expect(dead_code, reason = "it is kept for what it does when it is dropped")] Subscriber<()>,
);

impl fmt::Debug for ControlSender {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ControlSender").field(&self.0.key_expr().as_str()).finish()
    }
}

impl fmt::Debug for ControlReader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ControlReader")
    }
}

impl ControlSender {
    /// Sends a payload. Does not wait for anybody.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`] when the session has closed.
    pub fn send(&self, payload: Vec<u8>) -> Result<(), SessionError> {
        self.0.put(payload).wait().map_err(failed)
    }
}

impl Session {
    /// Declares a sender of small messages.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn control_sender<'a>(&'a self, key: &'a Key, encoding: &'a str) -> Boxed<'a, ControlSender> {
        let publisher = self.zenoh().declare_publisher(key.as_str().to_owned());
        let publisher =
            publisher.encoding(Encoding::from(encoding)).express(true).priority(Priority::RealTime);
        let publisher = publisher.congestion_control(CongestionControl::Drop);
        Box::pin(async move { Ok(ControlSender(publisher.await.map_err(failed)?)) })
    }

    /// Hands each message to `take`, on a thread of the link, which `take` must not hold up. The session's own messages are
    /// handed over, too, on the thread that sends them.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn control_reader(
        &self,
        keys: impl Into<KeyPattern>,
        take: impl Fn(Message) + Send + Sync + 'static,
    ) -> Boxed<'_, ControlReader> {
        let declared = self.zenoh().declare_subscriber(keys.into().as_str().to_owned());
        let declared = declared.callback(move |sample| {
            if sample.kind() == SampleKind::Put {
                take(of_sample(&sample));
            }
        });
        Box::pin(async move { Ok(ControlReader(declared.await.map_err(failed)?)) })
    }

    /// Asks, and holds up this thread until there is an answer, all have been asked, or the time is over. An answer counts more
    /// than a refusal.
    ///
    /// # Errors
    /// [`SessionError::NoReply`]; [`SessionError::Zenoh`].
    pub fn ask(&self, key: &Key, payload: (&str, Vec<u8>), timeout: Duration) -> Result<Reply, SessionError> {
        let (sender, replies) = mpsc::sync_channel(MAX_ANSWERS);
        let (encoding, payload) = payload;
        self.zenoh()
            .get(key.as_str())
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .source_info(SourceInfo::new(self.zenoh().id(), 0))
            .priority(Priority::RealTime)
            .timeout(timeout)
            .payload(payload)
            .encoding(Encoding::from(encoding))
            // One answer too many is not needed: the receiver takes the first.
            .callback(move |reply| drop(sender.try_send(of_reply(&reply))))
            .wait()
            .map_err(failed)?;
        let mut refusal = None;
        for reply in replies {
            match reply {
                Reply::Message(_) => return Ok(reply),
                Reply::Refusal { .. } => refusal = refusal.or(Some(reply)),
            }
        }
        let seconds = timeout.as_secs();
        refusal.ok_or_else(|| SessionError::NoReply { key: key.to_string(), seconds })
    }
}
