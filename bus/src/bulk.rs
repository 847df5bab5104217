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
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Sample, SampleKind};
use zenoh::shm::{
    GarbageCollect, PosixShmProviderBackend, ShmBuf, ShmProvider, ShmProviderBuilder, ZShmMut,
    cleanup_orphaned_shm_segments,
};

use crate::error::{SessionError, failed};
use crate::keys::{Key, KeyPattern};
use crate::segments;
use crate::session::{Boxed, Session};
use crate::turns::aside;

/// A new pool has room for so many payloads of the present size.
const PAYLOADS_PER_POOL: usize = 8;
/// Smallest pool, bytes.
const MIN_POOL_BYTES: usize = 4 << 20;
/// Largest pool, bytes; payloads that do not fit into it go over the network.
const MAX_POOL_BYTES: usize = 1 << 30;

/// Zenoh has a queue for each priority: nothing else waits behind large payloads. It holds 16 packets of 64 KiB, and
/// a payload that does not fit may take 500 ms to leave ([`SessionConfig`](crate::SessionConfig) sets both), so that
/// a busy machine or a slow network loses no single image. With Zenoh's own 2 packets and 50 ms that happened.
const PRIORITY: Priority = Priority::DataLow;

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
pub struct BulkBuffer {
    memory: BufferMemory,
    length: usize,
}

enum BufferMemory {
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
    queue: Arc<NewestQueue>,
    _declared: Subscriber<()>,
}

#[derive(Debug)]
struct NewestQueue {
    waiting: Mutex<VecDeque<Bulk>>,
    capacity: usize,
    arrived: Notify,
    dropped: AtomicU64,
}

/// Removes the shared memory of killed processes, and unmaps what this process still maps of it. It scans all
/// segments of the machine: call it rarely.
pub fn remove_orphans() {
    segments::unmap_unused();
    cleanup_orphaned_shm_segments();
}

impl Session {
    /// Declares a publisher of large payloads on a key. Under congestion payloads are dropped.
    ///
    /// # Errors
    /// [`SessionError::Zenoh`].
    pub fn bulk_sender<'a>(&'a self, key: &'a Key, encoding: &'a str) -> Boxed<'a, BulkSender> {
        Box::pin(self.bulk_sender_on(key, encoding))
    }

    async fn bulk_sender_on(&self, key: &Key, encoding: &str) -> Result<BulkSender, SessionError> {
        let publisher = self.zenoh().declare_publisher(key.as_str().to_owned());
        let publisher = publisher.encoding(Encoding::from(encoding)).express(true).priority(PRIORITY);
        let publisher = publisher.congestion_control(CongestionControl::Drop).await.map_err(failed)?;
        let (tell, wanted) = watch::channel(false);
        let listener = publisher.matching_listener();
        // It is called at once if somebody subscribes already, and then at each change.
        let listener = listener.callback(move |status| {
            tell.send_replace(status.matching());
        });
        let listener = listener.await.map_err(failed)?;
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
    pub fn bulk_reader(
        &self,
        keys: impl Into<KeyPattern>,
        capacity: usize,
        detached: bool,
    ) -> Boxed<'_, BulkReader> {
        self.bulk_reader_of(&keys.into(), capacity, detached)
    }

    fn bulk_reader_of(&self, keys: &KeyPattern, capacity: usize, detached: bool) -> Boxed<'_, BulkReader> {
        let queue = Arc::new(NewestQueue {
            waiting: Mutex::new(VecDeque::new()),
            capacity: capacity.max(1),
            arrived: Notify::new(),
            dropped: AtomicU64::new(0),
        });
        let offered = Arc::clone(&queue);
        let declared = self.zenoh().declare_subscriber(keys.as_str().to_owned());
        let declared = declared.callback(move |sample| {
            if sample.kind() == SampleKind::Put {
                offered.offer(Bulk::of(&sample, detached));
            }
        });
        Box::pin(async move { Ok(BulkReader { queue, _declared: declared.await.map_err(failed)? }) })
    }
}

impl BulkSender {
    /// Whether anyone subscribes.
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
    pub fn unshared(&self) -> u64 {
        self.unshared.load(Ordering::Relaxed)
    }

    /// A buffer of `length` bytes, in shared memory if possible. Its initial content is arbitrary.
    pub fn slot(&self, length: usize) -> BulkBuffer {
        let shared = self.shared(length.max(1));
        if shared.is_none() {
            self.unshared.fetch_add(1, Ordering::Relaxed);
        }
        let memory = shared.map_or_else(|| BufferMemory::Own(vec![0; length]), BufferMemory::Shared);
        BulkBuffer { memory, length }
    }

    fn shared(&self, length: usize) -> Option<ZShmMut> {
        let wanted = length.saturating_mul(PAYLOADS_PER_POOL).clamp(MIN_POOL_BYTES, MAX_POOL_BYTES);
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
    pub fn send(&self, slot: BulkBuffer, attachment: Vec<u8>) -> Boxed<'_, ()> {
        let payload = match slot.memory {
            BufferMemory::Shared(buffer) => ZBytes::from(buffer),
            BufferMemory::Own(bytes) => ZBytes::from(bytes),
        };
        let put = self.publisher.put(payload).attachment(attachment);
        let put = put.timestamp(self.session.zenoh().new_timestamp());
        Box::pin(async move { aside(|| put.wait()).map_err(failed) })
    }
}

impl Deref for BulkBuffer {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.memory {
            BufferMemory::Shared(buffer) => &buffer[..self.length],
            BufferMemory::Own(bytes) => bytes,
        }
    }
}

impl DerefMut for BulkBuffer {
    fn deref_mut(&mut self) -> &mut [u8] {
        match &mut self.memory {
            BufferMemory::Shared(buffer) => &mut buffer[..self.length],
            BufferMemory::Own(bytes) => bytes,
        }
    }
}

impl fmt::Debug for BulkBuffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shared = matches!(self.memory, BufferMemory::Shared(_));
        f.debug_struct("BulkBuffer").field("length", &self.length).field("shared", &shared).finish()
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
    pub fn is_shared(&self) -> bool {
        self.0.as_shm().is_some()
    }

    /// Whether all bytes read so far are those that were sent; to be called after reading. A reader that the system
    /// suspends for a tenth of a second loses its hold on shared memory, and the sender writes the next payload
    /// there. The same happens when the sender has exited.
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

impl NewestQueue {
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
    pub fn try_next(&self) -> Option<Bulk> {
        self.queue.waiting.lock().pop_front()
    }

    /// How many payloads were dropped from the queue so far.
    pub fn dropped(&self) -> u64 {
        self.queue.dropped.load(Ordering::Relaxed)
    }
}
