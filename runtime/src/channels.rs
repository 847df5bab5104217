//! Named channels: each holds the newest value that an observer has published, with its time, and counts its
//! readers.
//!
//! Observers publish; watches and skills read. A channel keeps only the newest sample: a slow reader misses samples
//! and never delays the publisher. Observers with costly computations check [`Channels::wanted`] first.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;
use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::time::Instant;

/// One published value and when it was published, in the executor's (virtual) time.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelSample {
    /// The value; usually a map of named fields.
    pub value: Value,
    /// When it was published.
    pub at: Instant,
}

#[derive(Debug)]
struct Channel {
    newest: watch::Sender<Option<ChannelSample>>,
    wanted: watch::Sender<usize>,
}

/// The set of channels; clones share the same channels.
#[derive(Clone, Debug, Default)]
pub struct Channels {
    by_name: Arc<Mutex<BTreeMap<String, Arc<Channel>>>>,
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

    fn channel(&self, name: &str) -> Arc<Channel> {
        let mut by_name = self.by_name.lock();
        Arc::clone(by_name.entry(name.to_owned()).or_insert_with(|| {
            Arc::new(Channel { newest: watch::channel(None).0, wanted: watch::channel(0).0 })
        }))
    }

    /// Publishes a value now; it replaces the previous one.
    pub fn publish(&self, name: &str, value: Value) {
        let sample = ChannelSample { value, at: Instant::now() };
        self.channel(name).newest.send_replace(Some(sample));
    }

    /// The newest sample, if any.
    pub fn newest(&self, name: &str) -> Option<ChannelSample> {
        self.channel(name).newest.borrow().clone()
    }

    /// The newest value, or the field of it at `path`. Only the returned part is copied.
    pub fn field(&self, name: &str, path: &[String]) -> Option<Value> {
        let channel = self.channel(name);
        let newest = channel.newest.borrow();
        let mut value = &newest.as_ref()?.value;
        for part in path {
            value = value.get(part)?;
        }
        Some(value.clone())
    }

    /// Time since the last publication; `None` if nothing was published yet.
    pub fn age(&self, name: &str) -> Option<Duration> {
        self.channel(name).newest.borrow().as_ref().map(|sample| sample.at.elapsed())
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
