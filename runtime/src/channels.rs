//! Named channels: each holds the newest value that an observer has published, with its time, and counts its
//! readers.
//!
//! Observers publish; watches and skills read. A channel keeps only the newest sample: a slow reader misses samples
//! and never delays the publisher. Observers with costly computations check [`Channels::wanted`] first.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;
use futures::future::BoxFuture;
use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::attention::Attention;
use crate::observed::ObservedPattern;

/// One published value and when it was published, in the executor's (virtual) time.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelSample {
    /// The value; usually a map of named fields.
    pub value: Value,
    /// When it was published.
    pub at: Instant,
    /// How old it was then.
    pub before: Duration,
}

impl ChannelSample {
    /// How old the value is now: the time since it was published, and how old it was then.
    pub fn age(&self) -> Duration {
        self.at.elapsed().saturating_add(self.before)
    }
}

#[derive(Debug)]
struct Channel {
    newest: watch::Sender<Option<ChannelSample>>,
    wanted: watch::Sender<usize>,
}

/// Publishes what a memory holds of patterns. This room does not know memory; who does implements it.
pub trait ObserveMemory: Send + Sync {
    /// Publishes the matches of these patterns with [`Channels::publish_matches`], now and at each change until the tasks are
    /// dropped. When it returns, what memory holds at present has been published.
    ///
    /// # Errors
    /// [`ObserveError`] when memory cannot be read.
    fn observe(
        &self,
        patterns: Vec<ObservedPattern>,
        channels: Channels,
    ) -> BoxFuture<'static, Result<JoinSet<()>, ObserveError>>;
}

/// Memory cannot be observed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("memory cannot be observed: {reason}")]
pub struct ObserveError {
    /// Why.
    pub reason: String,
}

/// The set of channels; clones share the same channels.
#[derive(Clone, Default)]
pub struct Channels {
    by_name: Arc<Mutex<BTreeMap<String, Arc<Channel>>>>,
    memory: Option<Arc<dyn ObserveMemory>>,
    attention: Attention,
}

impl fmt::Debug for Channels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.by_name.lock().keys()).finish()
    }
}

/// Marks a channel as read until it is dropped.
#[derive(Debug)]
pub struct Demand {
    channel: Arc<Channel>,
}

impl Drop for Demand {
    fn drop(&mut self) {
        self.channel.wanted.send_modify(|n| *n -= 1);
    }
}

impl Channels {
    /// An empty set of channels.
    pub fn new() -> Self {
        Self::default()
    }

    /// What the skills that run need to know the place of.
    pub fn attention(&self) -> &Attention {
        &self.attention
    }

    /// The same channels, on which this memory publishes what charts observe of it.
    #[must_use]
    pub fn with_memory(mut self, memory: Arc<dyn ObserveMemory>) -> Self {
        self.memory = Some(memory);
        self
    }

    /// Publishes what memory holds of these patterns, now and at each change until the tasks are dropped. Without a memory
    /// nothing matches.
    ///
    /// # Errors
    /// [`ObserveError`] when memory cannot be read.
    pub async fn observe(&self, patterns: &[ObservedPattern]) -> Result<JoinSet<()>, ObserveError> {
        for observed in patterns {
            // Nothing that an earlier run has observed.
            self.channel(&observed.pattern.channel(false)).newest.send_replace(None);
            self.publish_matches(observed, None, Vec::new);
        }
        match &self.memory {
            Some(memory) if !patterns.is_empty() => memory.observe(patterns.to_vec(), self.clone()).await,
            _ => Ok(JoinSet::new()),
        }
    }

    /// Publishes the matches of a pattern on those of its channels that are read: the best with its age, and all, the highest
    /// confidence first. Where the last match is gone, the channel of the best holds `Null`, and its age goes on.
    pub fn publish_matches(
        &self,
        observed: &ObservedPattern,
        best: Option<(Value, Duration)>,
        all: impl FnOnce() -> Vec<Value>,
    ) {
        if observed.all {
            self.replace(&observed.pattern.channel(true), Value::List(all()), Duration::ZERO);
        }
        if observed.best {
            let name = observed.pattern.channel(false);
            match best {
                Some((value, age)) => self.replace(&name, value, age),
                None => self.channel(&name).newest.send_modify(|newest| {
                    newest.iter_mut().for_each(|sample| sample.value = Value::Null);
                }),
            }
        }
    }

    fn replace(&self, name: &str, value: Value, before: Duration) {
        let sample = ChannelSample { value, at: Instant::now(), before };
        self.channel(name).newest.send_replace(Some(sample));
    }

    fn channel(&self, name: &str) -> Arc<Channel> {
        let mut by_name = self.by_name.lock();
        Arc::clone(by_name.entry(name.to_owned()).or_insert_with(|| {
            Arc::new(Channel { newest: watch::channel(None).0, wanted: watch::channel(0).0 })
        }))
    }

    /// Publishes a value now; it replaces the previous one.
    pub fn publish(&self, name: &str, value: Value) {
        self.replace(name, value, Duration::ZERO);
    }

    /// The newest sample, if any.
    pub fn newest(&self, name: &str) -> Option<ChannelSample> {
        self.channel(name).newest.borrow().clone()
    }

    /// The newest value, or the field of it at `path`. Only the returned part is copied.
    pub fn field(&self, name: &str, path: &[String]) -> Option<Value> {
        self.channel(name).newest.borrow().as_ref()?.value.at(path)
    }

    /// How old the newest value is; `None` if nothing was published yet.
    pub fn age(&self, name: &str) -> Option<Duration> {
        self.channel(name).newest.borrow().as_ref().map(ChannelSample::age)
    }

    /// A receiver that wakes at each new sample.
    pub fn subscribe(&self, name: &str) -> watch::Receiver<Option<ChannelSample>> {
        self.channel(name).newest.subscribe()
    }

    /// Registers the caller as a reader for as long as it keeps the returned token.
    #[must_use = "the demand ends when the token is dropped"]
    pub fn demand(&self, name: &str) -> Demand {
        let channel = self.channel(name);
        channel.wanted.send_modify(|n| *n += 1);
        Demand { channel }
    }

    /// The number of readers of a channel. An observer sleeps on it while there are none.
    pub fn wanted(&self, name: &str) -> watch::Receiver<usize> {
        self.channel(name).wanted.subscribe()
    }
}
