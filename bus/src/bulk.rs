//! Large payloads, such as pixels: written once into shared memory, where readers on the same machine see them
//! without another copy. Other readers get the same message over the network; Zenoh selects the way for each peer.
//!
//! Every queue here keeps the newest messages: when it is full, the oldest is dropped and counted. Payloads are not
//! interpreted. A message goes through shared memory if both sides' sessions have it enabled
//! ([`SessionConfig::shared_memory`](crate::SessionConfig)).

use std::collections::VecDeque;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;
use tokio::sync::{Notify, watch};
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::sample::{Sample, SampleKind};
use zenoh::shm::{
    GarbageCollect, PosixShmProviderBackend, ShmBuf, ShmProvider, ShmProviderBuilder, ZShmMut,
    cleanup_orphaned_shm_segments,
};

use crate::attached;
use crate::error::SessionError;
use crate::keys::{Key, KeyPattern};
use crate::session::Session;

/// A new pool has room for so many payloads of the present size.
const ROOM: usize = 8;
/// Smallest pool, bytes.
const LEAST_POOL: usize = 4 << 20;
/// Largest pool, bytes; payloads that do not fit into it go over the network.
const MOST_POOL: usize = 1 << 30;

type Pool = ShmProvider<PosixShmProviderBackend>;

/// Sends large payloads on one key.
#[derive(Debug)]
pub struct BulkSender {
    /// Dropped before the publisher on which it listens (order of fields).
    _listener: zenoh::matching::MatchingListener<()>,
    publisher: Publisher<'static>,
    /// The pool, and the smaller one before it, which readers may still use.
    pools: Mutex<VecDeque<(usize, Pool)>>,
    unshared: AtomicU64,
    wanted: watch::Receiver<bool>,
    session: Session,
}

/// The buffer of one payload: in shared memory, or on the heap when the pool has no room.
pub struct Slot {
    memory: Memory,
    length: usize,
}

enum Memory {
    Shared(ZShmMut),
    Own(Vec<u8>),
}

/// A received payload with its attachment.
#[derive(Clone, Debug)]
pub struct Bulk {
    /// The key it was put on, as Zenoh writes it.
    pub key: String,
    /// The payload's encoding.
    pub encoding: String,
    /// The attachment.
    pub attachment: Vec<u8>,
    /// The payload.
    pub payload: BulkBytes,
}

/// A payload's bytes in one piece; clones share the bytes.
#[derive(Clone)]
pub struct BulkBytes(ZBytes);

/// Receives large payloads; its queue keeps the newest.
#[derive(Debug)]
pub struct BulkReader {
    queue: Arc<Queue>,
    _declared: Subscriber<()>,
}

#[derive(Debug)]
struct Queue {
    waiting: Mutex<VecDeque<Bulk>>,
    capacity: usize,
    arrived: Notify,
    dropped: AtomicU64,
}

fn failed(error: impl fmt::Display) -> SessionError {
    SessionError::Zenoh { what: error.to_string() }
}

/// Removes the shared memory of killed processes, and unmaps what this process still maps of it. It scans all
/// segments of the machine: call it rarely.
pub fn remove_orphans() {
    attached::let_go();
    cleanup_orphaned_shm_segments();
}

impl Session {
    /// Declares a publisher of large payloads on a key. Under congestion payloads are dropped.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn bulk_sender(&self, key: &Key, encoding: &str) -> Result<BulkSender, SessionError> {
        let publisher = self.zenoh().declare_publisher(key.as_str().to_owned());
        let publisher = publisher.encoding(Encoding::from(encoding)).express(true);
        let publisher = publisher.congestion_control(CongestionControl::Drop).await.map_err(failed)?;
        let (tell, wanted) = watch::channel(false);
        let told = tell.clone();
        let listener = publisher.matching_listener();
        let listener = listener.callback(move |status| {
            told.send_replace(status.matching());
        });
        let listener = listener.await.map_err(failed)?;
        tell.send_replace(publisher.matching_status().await.map_err(failed)?.matching());
        let (pools, unshared) = (Mutex::new(VecDeque::new()), AtomicU64::new(0));
        Ok(BulkSender { publisher, pools, unshared, wanted, session: self.clone(), _listener: listener })
    }

    /// Subscribes to large payloads. At most `capacity` wait in the queue; when it is full, the oldest is dropped.
    ///
    /// With `detached`, payloads are copied out of shared memory as they arrive: many may then wait without holding
    /// the sender's pool. Otherwise they stay in shared memory, and may become invalid there: see
    /// [`BulkBytes::is_intact`].
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn bulk_reader(
        &self,
        keys: impl Into<KeyPattern>,
        capacity: usize,
        detached: bool,
    ) -> Result<BulkReader, SessionError> {
        let queue = Arc::new(Queue {
            waiting: Mutex::new(VecDeque::new()),
            capacity: capacity.max(1),
            arrived: Notify::new(),
            dropped: AtomicU64::new(0),
        });
        let offered = Arc::clone(&queue);
        let declared = self.zenoh().declare_subscriber(keys.into().as_str().to_owned());
        let declared = declared.callback(move |sample| {
            if sample.kind() == SampleKind::Put {
                offered.offer(Bulk::of(&sample, detached));
            }
        });
        Ok(BulkReader { queue, _declared: declared.await.map_err(failed)? })
    }
}

impl BulkSender {
    /// Whether anyone subscribes.
    #[must_use]
    pub fn is_wanted(&self) -> bool {
        *self.wanted.borrow()
    }

    /// Waits until someone subscribes.
    pub async fn wanted(&self) {
        let mut wanted = self.wanted.clone();
        // The sender of this channel lives as long as the listener.
        let _ = wanted.wait_for(|wanted| *wanted).await.is_ok();
    }

    /// How many payloads did not fit into shared memory, because readers held it, and were sent as copies.
    #[must_use]
    pub fn unshared(&self) -> u64 {
        self.unshared.load(Ordering::Relaxed)
    }

    /// A buffer of `length` bytes, in shared memory if possible. Its initial content is arbitrary.
    #[must_use]
    pub fn slot(&self, length: usize) -> Slot {
        let shared = self.shared(length.max(1));
        if shared.is_none() {
            self.unshared.fetch_add(1, Ordering::Relaxed);
        }
        let memory = shared.map_or_else(|| Memory::Own(vec![0; length]), Memory::Shared);
        Slot { memory, length }
    }

    fn shared(&self, length: usize) -> Option<ZShmMut> {
        let wanted = length.saturating_mul(ROOM).clamp(LEAST_POOL, MOST_POOL);
        let mut pools = self.pools.lock();
        if pools.back().is_none_or(|(size, _)| *size < wanted) {
            let made = ShmProviderBuilder::default_backend(wanted).wait();
            pools.push_back((wanted, made.ok()?));
            if pools.len() > 2 {
                pools.pop_front();
            }
        }
        let (_, pool) = pools.back()?;
        pool.alloc(length).with_policy::<GarbageCollect>().wait().ok()
    }

    /// Sends a payload with an attachment.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub async fn send(&self, slot: Slot, attachment: Vec<u8>) -> Result<(), SessionError> {
        let payload = match slot.memory {
            Memory::Shared(buffer) => ZBytes::from(buffer),
            Memory::Own(bytes) => ZBytes::from(bytes),
        };
        let put = self.publisher.put(payload).attachment(attachment);
        put.timestamp(self.session.zenoh().new_timestamp()).await.map_err(failed)
    }
}

impl Deref for Slot {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.memory {
            Memory::Shared(buffer) => &buffer[..self.length],
            Memory::Own(bytes) => bytes,
        }
    }
}

impl DerefMut for Slot {
    fn deref_mut(&mut self) -> &mut [u8] {
        match &mut self.memory {
            Memory::Shared(buffer) => &mut buffer[..self.length],
            Memory::Own(bytes) => bytes,
        }
    }
}

impl fmt::Debug for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shared = matches!(self.memory, Memory::Shared(_));
        f.debug_struct("Slot").field("length", &self.length).field("shared", &shared).finish()
    }
}

impl Bulk {
    fn of(sample: &Sample, detached: bool) -> Self {
        let attachment = sample.attachment().map(|a| a.to_bytes().into_owned()).unwrap_or_default();
        let (key, encoding) = (sample.key_expr().to_string(), sample.encoding().to_string());
        Self { key, encoding, attachment, payload: BulkBytes::of(sample.payload(), detached) }
    }
}

impl BulkBytes {
    /// Joins a payload that arrived in several pieces.
    fn of(payload: &ZBytes, detached: bool) -> Self {
        let in_one_piece = payload.slices().nth(1).is_none();
        let shared = payload.as_shm().is_some();
        if in_one_piece && !(shared && detached) {
            return Self(payload.clone());
        }
        Self(ZBytes::from(payload.to_bytes().into_owned()))
    }

    /// Whether the bytes are in the sender's shared memory.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        self.0.as_shm().is_some()
    }

    /// Whether all bytes read so far are those that were sent; to be called after reading. A reader that the system
    /// suspends for a tenth of a second loses its hold on shared memory, and the sender writes the next payload
    /// there. The same happens when the sender has exited.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        self.0.as_shm().is_none_or(|buffer| buffer.is_valid())
    }
}

impl AsRef<[u8]> for BulkBytes {
    fn as_ref(&self) -> &[u8] {
        self.0.slices().next().unwrap_or_default()
    }
}

impl fmt::Debug for BulkBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let length = self.as_ref().len();
        f.debug_struct("BulkBytes").field("length", &length).field("shared", &self.is_shared()).finish()
    }
}

impl Queue {
    /// Never blocks: this runs on Zenoh's link threads.
    fn offer(&self, bulk: Bulk) {
        let mut waiting = self.waiting.lock();
        if waiting.len() >= self.capacity {
            waiting.pop_front();
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        waiting.push_back(bulk);
        drop(waiting);
        self.arrived.notify_one();
    }
}

impl BulkReader {
    /// Waits for the next payload, without a timeout, because a sender may come back.
    pub async fn next(&self) -> Bulk {
        loop {
            if let Some(bulk) = self.try_next() {
                return bulk;
            }
            self.queue.arrived.notified().await;
        }
    }

    /// The next payload, if one is in the queue.
    #[must_use]
    pub fn try_next(&self) -> Option<Bulk> {
        self.queue.waiting.lock().pop_front()
    }

    /// How many payloads were dropped from the queue so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.queue.dropped.load(Ordering::Relaxed)
    }
}
