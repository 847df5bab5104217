//! A thin layer over the Zenoh session: put, get and subscribe with bounded queues, queryables, liveliness.
//!
//! Zenoh's callbacks run on its link threads, so they only put items into a queue, without blocking: what does not
//! fit is dropped and counted, and the reader can read the count. Payloads are not interpreted.
//!
//! A session needs a multi-threaded tokio runtime, and waits in real time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::runtime::{Handle, RuntimeFlavor};
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Locality, SampleKind, SourceInfo};

use crate::attached;
pub use crate::config::{Mode, SessionConfig, Tls};
use crate::error::{SessionError, failed};
use crate::keys::{Key, KeyPattern};
pub use crate::message::{Answer, Liveliness, Message, Question, Questions, Roll, Subscription};
use crate::message::{nanoseconds, of_query, of_reply, of_sample};
use crate::queue::queue;

/// Default timeout of a query.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// A session; clones are the same session. It closes when the last clone and everything declared on it is dropped.
#[derive(Clone, Debug)]
pub struct Session {
    zenoh: zenoh::Session,
}

/// Announces a service until it is dropped.
#[derive(Debug)]
#[must_use = "the service is gone when the token is dropped"]
pub struct AliveToken {
    _declared: zenoh::liveliness::LivelinessToken,
}

/// Whether other sessions subscribe to certain keys.
#[derive(Debug)]
pub struct Interest {
    there: Arc<AtomicBool>,
    _listener: zenoh::matching::MatchingListener<()>,
    _publisher: zenoh::pubsub::Publisher<'static>,
}

impl Session {
    /// Opens a session.
    ///
    /// # Errors
    /// [`SessionError::Runtime`] outside a multi-threaded tokio runtime; [`SessionError::OffLoopback`] and
    /// [`SessionError::Config`] for an invalid configuration; [`SessionError::Zenoh`] when Zenoh cannot listen or
    /// connect.
    pub async fn open(config: &SessionConfig) -> Result<Self, SessionError> {
        let flavor = Handle::try_current().map(|h| h.runtime_flavor());
        if !matches!(flavor, Ok(RuntimeFlavor::MultiThread)) {
            return Err(SessionError::Runtime);
        }
        let mut opening = zenoh::open(config.to_zenoh()?);
        if config.shared_memory {
            opening = opening.with_shm_clients(attached::clients());
        }
        let zenoh = opening.await.map_err(failed)?;
        Ok(Self { zenoh })
    }

    /// The endpoints on which it listens, with their actual ports.
    pub async fn endpoints(&self) -> Vec<String> {
        self.zenoh.info().locators().await.iter().map(ToString::to_string).collect()
    }

    /// Zenoh's own session, for payloads that stay in its buffers.
    #[must_use]
    pub fn zenoh(&self) -> &zenoh::Session {
        &self.zenoh
    }

    /// The session's unique id.
    #[must_use]
    pub fn id(&self) -> String {
        self.zenoh.zid().to_string()
    }

    /// The sender of a message, for people. If the message does not name it, the sessions that this one is linked to:
    /// the message came through one of them.
    pub async fn sender(&self, said: Option<&str>) -> String {
        if let Some(said) = said {
            return said.into();
        }
        let linked = self.zenoh.info().transports().await;
        let linked: Vec<_> = linked.map(|transport| transport.zid().to_string()).collect();
        format!("one of those linked here: {}", linked.join(", "))
    }

    /// The wall clock of message timestamps, ns since 1970; no value repeats.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        nanoseconds(&self.zenoh.new_timestamp())
    }

    /// Publishes a payload on a key, with a timestamp. There is no acknowledgement, and under congestion it is
    /// dropped.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn put(&self, key: &Key, encoding: &str, payload: Vec<u8>) -> Result<(), SessionError> {
        self.put_with(key, encoding, payload, CongestionControl::Drop).await
    }

    /// [`Self::put`] that blocks under congestion; not for control loops.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn put_waiting(&self, key: &Key, encoding: &str, payload: Vec<u8>) -> Result<(), SessionError> {
        self.put_with(key, encoding, payload, CongestionControl::Block).await
    }

    async fn put_with(
        &self,
        key: &Key,
        encoding: &str,
        payload: Vec<u8>,
        congestion: CongestionControl,
    ) -> Result<(), SessionError> {
        let put = self.zenoh.put(key.as_str(), payload).encoding(Encoding::from(encoding));
        put.timestamp(self.zenoh.new_timestamp()).congestion_control(congestion).await.map_err(failed)
    }

    /// Subscribes to keys with a queue for `capacity` messages. The session also receives its own puts.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn subscribe(
        &self,
        keys: impl Into<KeyPattern>,
        capacity: usize,
    ) -> Result<Subscription, SessionError> {
        self.subscribe_from(keys.into(), capacity, Locality::Any).await
    }

    /// As [`Self::subscribe`], without the session's own puts.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn subscribe_others(
        &self,
        keys: impl Into<KeyPattern>,
        capacity: usize,
    ) -> Result<Subscription, SessionError> {
        self.subscribe_from(keys.into(), capacity, Locality::Remote).await
    }

    async fn subscribe_from(
        &self,
        keys: KeyPattern,
        capacity: usize,
        origin: Locality,
    ) -> Result<Subscription, SessionError> {
        let (offer, queue) = queue(capacity);
        let declared = self.zenoh.declare_subscriber(keys.as_str().to_owned()).allowed_origin(origin);
        let declared = declared.callback(move |sample| offer.offer(of_sample(&sample)));
        Ok(Subscription { queue, _declared: declared.await.map_err(failed)? })
    }

    /// Observes whether other sessions subscribe to any of these keys, from now on.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn interest(&self, keys: &KeyPattern) -> Result<Interest, SessionError> {
        let publisher = self.zenoh.declare_publisher(keys.as_str().to_owned());
        let publisher =
            publisher.allowed_destination(zenoh::sample::Locality::Remote).await.map_err(failed)?;
        let there = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&there);
        let listener = publisher.matching_listener();
        let listener = listener.callback(move |status| told.store(status.matching(), Ordering::Relaxed));
        let listener = listener.await.map_err(failed)?;
        let status = publisher.matching_status().await.map_err(failed)?;
        there.store(status.matching(), Ordering::Relaxed);
        Ok(Interest { there, _listener: listener, _publisher: publisher })
    }

    /// Queries all queryables on a key or pattern, with `parameters` after the `?`, for at most `most` answers within
    /// `timeout`. Without an answer the list is empty.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`]; [`SessionError::TooManyAnswers`].
    pub async fn ask(
        &self,
        keys: impl Into<KeyPattern>,
        parameters: &str,
        payload: Option<(&str, Vec<u8>)>,
        most: usize,
        timeout: Duration,
    ) -> Result<Vec<Answer>, SessionError> {
        let keys = keys.into();
        let selector = if parameters.is_empty() { keys.to_string() } else { format!("{keys}?{parameters}") };
        let (offer, mut queue) = queue(most);
        let mut get = self
            .zenoh
            .get(selector)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .source_info(SourceInfo::new(self.zenoh.id(), 0))
            .timeout(timeout);
        if let Some((encoding, payload)) = payload {
            get = get.payload(payload).encoding(Encoding::from(encoding));
        }
        get.callback(move |reply| offer.offer(of_reply(&reply))).await.map_err(failed)?;
        let mut answers = Vec::new();
        while let Some(answer) = queue.next().await {
            answers.push(answer);
            if answers.len() > most {
                break;
            }
        }
        if queue.dropped() > 0 || answers.len() > most {
            return Err(SessionError::TooManyAnswers { key: keys.to_string(), most });
        }
        Ok(answers)
    }

    /// Queries for one answer within [`ANSWER_TIMEOUT`].
    ///
    /// # Errors
    /// [`SessionError::NoAnswer`] when none came; otherwise as [`Self::ask`].
    pub async fn ask_one(
        &self,
        key: &Key,
        parameters: &str,
        payload: Option<(&str, Vec<u8>)>,
    ) -> Result<Answer, SessionError> {
        let answers = self.ask(key.clone(), parameters, payload, 64, ANSWER_TIMEOUT).await?;
        // An answer counts more than a refusal by another queryable; a timeout is a refusal as well.
        let is_message = |a: &&Answer| matches!(a, Answer::Message(_));
        let best = answers.iter().find(is_message).or(answers.first()).cloned();
        best.ok_or_else(|| SessionError::NoAnswer { key: key.to_string(), seconds: ANSWER_TIMEOUT.as_secs() })
    }

    /// Declares a queryable with a queue for `capacity` queries; further ones end at once without an answer.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn answer(
        &self,
        keys: impl Into<KeyPattern>,
        capacity: usize,
    ) -> Result<Questions, SessionError> {
        let (offer, queue) = queue(capacity);
        let declared = self.zenoh.declare_queryable(keys.into().as_str().to_owned());
        let declared = declared.callback(move |query| offer.offer(of_query(query)));
        Ok(Questions { queue, _declared: declared.await.map_err(failed)? })
    }

    /// Announces a service under its key.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn alive(&self, key: &Key) -> Result<AliveToken, SessionError> {
        let declared = self.zenoh.liveliness().declare_token(key.as_str().to_owned());
        Ok(AliveToken { _declared: declared.await.map_err(failed)? })
    }

    /// The services that run now, and those that start or stop later.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn watch_alive(&self, keys: &KeyPattern, capacity: usize) -> Result<Roll, SessionError> {
        let (offer, queue) = queue(capacity);
        let seen = move |sample: zenoh::sample::Sample| {
            let alive = sample.kind() == SampleKind::Put;
            offer.offer(Liveliness { key: sample.key_expr().to_string(), alive });
        };
        let liveliness = self.zenoh.liveliness();
        let declared = liveliness.declare_subscriber(keys.as_str().to_owned()).history(true).callback(seen);
        Ok(Roll { queue, _declared: declared.await.map_err(failed)? })
    }

    /// Whether a service runs now, as far as the linked sessions answer within `timeout`.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn is_alive(&self, keys: &KeyPattern, timeout: Duration) -> Result<bool, SessionError> {
        let (offer, mut queue) = queue(16);
        let get = self.zenoh.liveliness().get(keys.as_str().to_owned()).timeout(timeout);
        get.callback(move |reply| offer.offer(of_reply(&reply))).await.map_err(failed)?;
        while let Some(answer) = queue.next().await {
            if matches!(answer, Answer::Message(_)) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Closes the session for all clones.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn close(&self) -> Result<(), SessionError> {
        let closed = self.zenoh.close().await.map_err(failed);
        attached::let_go();
        closed
    }
}

impl Interest {
    /// Whether there is such a subscriber now.
    #[must_use]
    pub fn is_there(&self) -> bool {
        self.there.load(Ordering::Relaxed)
    }
}
