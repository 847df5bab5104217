//! A thin layer over the Zenoh session: put, get and subscribe with bounded queues, queryables, liveliness.
//!
//! Zenoh's callbacks run on its link threads, so they only put items into a queue, without blocking: what does not
//! fit is dropped and counted, and the reader can read the count. Payloads are not interpreted.
//!
//! A session needs a multi-threaded tokio runtime, and waits in real time.

use std::collections::BTreeSet;
use std::fmt;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::runtime::{Handle, RuntimeFlavor};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Locality, SampleKind, SourceInfo};

pub use crate::config::{Mode, SessionConfig, Tls};
use crate::error::{SessionError, failed};
use crate::keys::{Key, KeyPattern};
pub use crate::message::{
    Boxed, IncomingQuery, Liveliness, LivelinessSubscription, Message, Queryable, Reply, Subscription,
};
use crate::message::{nanoseconds, of_query, of_reply, of_sample};
use crate::queue::queue;
use crate::segments;
use crate::turns::{Turns, aside};

/// The priority of queries and answers. Zenoh has a queue for each: what is published, which is dropped rather than
/// waited for, never waits behind an answer that a link does not take.
const ANSWERS: Priority = Priority::DataHigh;

/// Pause between two questions of one that is repeated.
const ASKED_AGAIN: Duration = Duration::from_millis(20);

/// Default timeout of a query.
pub const REPLY_TIMEOUT: Duration = Duration::from_secs(5);

/// A session; clones are the same session. It closes when the last clone and everything declared on it is dropped.
#[derive(Clone)]
pub struct Session {
    // Behind a trait, as the futures below are: otherwise each function that holds a session while it waits makes the compiler
    // prove anew that all of Zenoh is `Send`, which took a third of the memory room's build.
    zenoh: Arc<dyn AsRef<zenoh::Session> + Send + Sync>,
    turns: Turns,
}

/// Zenoh's session as [`Session`] holds it.
struct Opened(zenoh::Session);

impl AsRef<zenoh::Session> for Opened {
    fn as_ref(&self) -> &zenoh::Session {
        &self.0
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Session").field("id", &self.id()).finish()
    }
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

/// Zenoh makes sockets with the rights that any new file has.
#[cfg(unix)]
fn only_for_this_user(socket: &str) -> std::io::Result<()> {
    std::fs::set_permissions(socket, std::os::unix::fs::PermissionsExt::from_mode(0o600))
}

#[cfg(not(unix))]
fn only_for_this_user(_: &str) -> std::io::Result<()> {
    Ok(())
}

impl Session {
    /// Opens a session.
    ///
    /// # Errors
    /// [`SessionError::Runtime`] outside a multi-threaded tokio runtime; [`SessionError::OffLoopback`] and
    /// [`SessionError::Config`] for an invalid configuration; [`SessionError::Zenoh`] when Zenoh cannot listen or
    /// connect.
    pub fn open(config: &SessionConfig) -> Boxed<'_, Self> {
        Box::pin(Self::opened(config))
    }

    async fn opened(config: &SessionConfig) -> Result<Self, SessionError> {
        let flavor = Handle::try_current().map(|h| h.runtime_flavor());
        if !matches!(flavor, Ok(RuntimeFlavor::MultiThread)) {
            return Err(SessionError::Runtime);
        }
        let mut opening = zenoh::open(config.to_zenoh()?);
        if config.shared_memory {
            opening = opening.with_shm_clients(segments::clients());
        }
        let zenoh = opening.await.map_err(failed)?;
        for socket in config.sockets() {
            only_for_this_user(socket)
                .map_err(|error| failed(format!("the rights of `{socket}`: {error}")))?;
        }
        Ok(Self { zenoh: Arc::new(Opened(zenoh)), turns: Turns::default() })
    }

    /// The endpoints on which it listens, with their actual ports.
    pub fn endpoints(&self) -> Pin<Box<dyn Future<Output = Vec<String>> + Send + '_>> {
        Box::pin(async { self.zenoh().info().locators().await.iter().map(ToString::to_string).collect() })
    }

    /// Zenoh's own session, for payloads that stay in its buffers.
    pub fn zenoh(&self) -> &zenoh::Session {
        (*self.zenoh).as_ref()
    }

    /// The session's unique id.
    pub fn id(&self) -> String {
        self.zenoh().zid().to_string()
    }

    /// The sender of a message, for people. If the message does not name it, the sessions that this one is linked to:
    /// the message came through one of them.
    pub fn sender(&self, said: Option<&str>) -> String {
        match said {
            Some(said) => said.into(),
            None => format!("one of those linked here: {}", self.linked().join(", ")),
        }
    }

    /// The ids of the sessions that this one is linked to.
    fn linked(&self) -> Vec<String> {
        self.zenoh().info().transports().wait().map(|transport| transport.zid().to_string()).collect()
    }

    /// Whether this session is linked to another one, by its id. Those that are reached through others are not.
    pub fn is_linked(&self, id: &str) -> bool {
        self.linked().iter().any(|linked| linked == id)
    }

    /// The wall clock of message timestamps, ns since 1970; no value repeats.
    pub fn now_ns(&self) -> u64 {
        nanoseconds(&self.zenoh().new_timestamp())
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

    fn put_with<'a>(
        &'a self,
        key: &'a Key,
        encoding: &'a str,
        payload: Vec<u8>,
        congestion: CongestionControl,
    ) -> Boxed<'a, ()> {
        let put = self.zenoh().put(key.as_str(), payload).encoding(Encoding::from(encoding));
        let put = put.timestamp(self.zenoh().new_timestamp()).congestion_control(congestion);
        // A link that takes nothing may hold this up, too.
        Box::pin(async move { aside(|| put.wait()).map_err(failed) })
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

    fn subscribe_from(&self, keys: KeyPattern, capacity: usize, origin: Locality) -> Boxed<'_, Subscription> {
        let (sender, messages) = queue(capacity);
        let declared = self.zenoh().declare_subscriber(keys.as_str().to_owned()).allowed_origin(origin);
        let declared = declared.callback(move |sample| {
            let message = of_sample(&sample);
            sender.send(message.key.len() + message.payload.len(), message);
        });
        Box::pin(async move { Ok(messages.declared(declared.await.map_err(failed)?)) })
    }

    /// Observes whether other sessions subscribe to any of these keys, from now on.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn interest<'a>(&'a self, keys: &'a KeyPattern) -> Boxed<'a, Interest> {
        Box::pin(self.interest_in(keys))
    }

    async fn interest_in(&self, keys: &KeyPattern) -> Result<Interest, SessionError> {
        let publisher = self.zenoh().declare_publisher(keys.as_str().to_owned());
        let publisher = publisher.allowed_destination(Locality::Remote).await.map_err(failed)?;
        let there = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&there);
        let listener = publisher.matching_listener();
        // It is called at once if somebody does already, and then at each change.
        let listener = listener.callback(move |status| told.store(status.matching(), Ordering::Relaxed));
        let listener = listener.await.map_err(failed)?;
        Ok(Interest { there, _listener: listener, _publisher: publisher })
    }

    /// Queries all queryables on a key or pattern, with `parameters` after the `?`, for at most `most` answers within
    /// `timeout`. Without an answer the list is empty.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`]; [`SessionError::TooManyReplies`].
    pub fn query(
        &self,
        keys: impl Into<KeyPattern>,
        parameters: &str,
        payload: Option<(&str, Vec<u8>)>,
        most: usize,
        timeout: Duration,
    ) -> Boxed<'_, Vec<Reply>> {
        self.query_keys(keys.into(), parameters, payload, most, timeout)
    }

    fn query_keys(
        &self,
        keys: KeyPattern,
        parameters: &str,
        payload: Option<(&str, Vec<u8>)>,
        most: usize,
        timeout: Duration,
    ) -> Boxed<'_, Vec<Reply>> {
        let selector = if parameters.is_empty() { keys.to_string() } else { format!("{keys}?{parameters}") };
        let (sender, mut replies) = queue(most);
        let mut get = self
            .zenoh()
            .get(selector)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .source_info(SourceInfo::new(self.zenoh().id(), 0))
            .priority(ANSWERS)
            .timeout(timeout);
        if let Some((encoding, payload)) = payload {
            get = get.payload(payload).encoding(Encoding::from(encoding));
        }
        let callback = move |reply| {
            let reply = of_reply(&reply);
            let (Reply::Message(Message { payload, .. }) | Reply::Refusal { payload, .. }) = &reply;
            sender.send(payload.len(), reply);
        };
        let get = get.callback(callback);
        Box::pin(async move {
            get.await.map_err(failed)?;
            let mut answers = Vec::new();
            while let Some(answer) = replies.next().await {
                answers.push(answer);
                if answers.len() > most {
                    break;
                }
            }
            if replies.dropped() > 0 || answers.len() > most {
                return Err(SessionError::TooManyReplies { key: keys.to_string(), most });
            }
            Ok(answers)
        })
    }

    /// Queries for one answer within [`REPLY_TIMEOUT`].
    ///
    /// # Errors
    /// [`SessionError::NoReply`] when none came; otherwise as [`Self::query`].
    pub async fn query_one(
        &self,
        key: &Key,
        parameters: &str,
        payload: Option<(&str, Vec<u8>)>,
    ) -> Result<Reply, SessionError> {
        let answers = self.query(key.clone(), parameters, payload, 64, REPLY_TIMEOUT).await?;
        // An answer counts more than a refusal by another queryable; a timeout is a refusal as well.
        let is_message = |a: &&Reply| matches!(a, Reply::Message(_));
        let best = answers.iter().find(is_message).or(answers.first()).cloned();
        best.ok_or_else(|| SessionError::NoReply { key: key.to_string(), seconds: REPLY_TIMEOUT.as_secs() })
    }

    /// Queries without a payload for one answer, again and again for `wait`: a session that has just been linked may not know
    /// yet who answers.
    ///
    /// # Errors
    /// As [`Self::query_one`].
    pub async fn query_until(&self, key: &Key, wait: Duration) -> Result<Reply, SessionError> {
        let asking = async {
            loop {
                match self.query_one(key, "", None).await {
                    Err(SessionError::NoReply { .. }) => tokio::time::sleep(ASKED_AGAIN).await,
                    answered => return answered,
                }
            }
        };
        let none = SessionError::NoReply { key: key.to_string(), seconds: wait.as_secs() };
        tokio::time::timeout(wait, asking).await.unwrap_or(Err(none))
    }

    /// Declares a queryable with a queue for `capacity` queries; further ones end at once without an answer.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn declare_queryable(&self, keys: impl Into<KeyPattern>, capacity: usize) -> Boxed<'_, Queryable> {
        self.declare_queryable_on(&keys.into(), capacity)
    }

    fn declare_queryable_on(&self, keys: &KeyPattern, capacity: usize) -> Boxed<'_, Queryable> {
        let (sender, queries) = queue(capacity);
        let declared = self.zenoh().declare_queryable(keys.as_str().to_owned());
        let turns = self.turns.clone();
        let declared = declared.callback(move |query| {
            let query = of_query(query, &turns);
            sender.send(query.parameters.len() + query.payload.len(), query);
        });
        Box::pin(async move { Ok(queries.declared(declared.await.map_err(failed)?)) })
    }

    /// Announces a service under its key.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn alive(&self, key: &Key) -> Boxed<'_, AliveToken> {
        let declared = self.zenoh().liveliness().declare_token(key.as_str().to_owned());
        Box::pin(async move { Ok(AliveToken { _declared: declared.await.map_err(failed)? }) })
    }

    /// The services that run now, and those that start or stop later.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn watch_alive(&self, keys: &KeyPattern, capacity: usize) -> Boxed<'_, LivelinessSubscription> {
        let (sender, services) = queue(capacity);
        let seen = move |sample: zenoh::sample::Sample| {
            let (key, alive) = (sample.key_expr().to_string(), sample.kind() == SampleKind::Put);
            sender.send(key.len(), Liveliness { key, alive });
        };
        let liveliness = self.zenoh().liveliness();
        let declared = liveliness.declare_subscriber(keys.as_str().to_owned()).history(true).callback(seen);
        Box::pin(async move { Ok(services.declared(declared.await.map_err(failed)?)) })
    }

    /// Whether a service runs now, as far as the linked sessions answer within `timeout`.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn is_alive(&self, keys: &KeyPattern, timeout: Duration) -> Boxed<'_, bool> {
        let (sender, mut alive) = queue(16);
        let get = self.zenoh().liveliness().get(keys.as_str().to_owned()).timeout(timeout);
        let callback = move |reply: zenoh::query::Reply| {
            if reply.result().is_ok() {
                sender.send(0, ());
            }
        };
        let get = get.callback(callback);
        Box::pin(async move {
            get.await.map_err(failed)?;
            Ok(alive.next().await.is_some())
        })
    }

    /// The keys of the services that run now, as far as the linked sessions answer within `timeout`.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn all_alive(&self, keys: &KeyPattern, timeout: Duration) -> Boxed<'_, BTreeSet<String>> {
        let (sender, mut alive) = queue(1024);
        let get = self.zenoh().liveliness().get(keys.as_str().to_owned()).timeout(timeout);
        let get = get.callback(move |reply: zenoh::query::Reply| {
            if let Ok(sample) = reply.result() {
                let key = sample.key_expr().to_string();
                sender.send(key.len(), key);
            }
        });
        Box::pin(async move {
            get.await.map_err(failed)?;
            let mut keys = BTreeSet::new();
            while let Some(key) = alive.next().await {
                keys.insert(key);
            }
            Ok(keys)
        })
    }

    /// Closes the session for all clones.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn close(&self) -> Boxed<'_, ()> {
        Box::pin(async {
            let closed = self.zenoh().close().await.map_err(failed);
            segments::unmap_unused();
            closed
        })
    }
}

impl Interest {
    /// Whether there is such a subscriber now.
    pub fn has_subscribers(&self) -> bool {
        self.there.load(Ordering::Relaxed)
    }
}
