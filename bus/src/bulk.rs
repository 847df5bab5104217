//! Large payloads, such as pixels: written once into shared memory, where readers on the same machine see them without
//! another copy. A reader elsewhere gets the same message over the network: Zenoh knows which of the two a peer can do.
//!
//! Every queue here keeps the newest: what does not fit pushes out the oldest, and is counted. Nothing here interprets
//! payloads. A session does shared memory when [`SessionConfig::shared_memory`](crate::SessionConfig) says so, and a
//! message passes through it when both sides' sessions do.

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

/// Payloads of the last size that a pool has room for.
const ROOM: usize = 8;
/// Smallest pool, bytes.
const LEAST_POOL: usize = 4 << 20;
/// Largest pool, bytes; payloads that do not fit in go over the network.
const MOST_POOL: usize = 1 << 30;

type Pool = ShmProvider<PosixShmProviderBackend>;

/// Sends large payloads on one key.
#[derive(Debug)]
pub struct BulkSender {
    /// Goes before the publisher that it listens to.
    _listener: zenoh::matching::MatchingListener<()>,
    publisher: Publisher<'static>,
    /// The pool, and the smaller one before it, in which readers may still look.
    pools: Mutex<VecDeque<(usize, Pool)>>,
    unshared: AtomicU64,
    wanted: watch::Receiver<bool>,
    session: Session,
}

/// Where one payload is written: in shared memory, or in the process's own when there is no room.
pub struct Slot {
    memory: Memory,
    length: usize,
}

enum Memory {
    Shared(ZShmMut),
    Own(Vec<u8>),
}

/// A payload that has come, with what was attached to it.
#[derive(Clone, Debug)]
pub struct Bulk {
    /// The key it was put on, as Zenoh writes it.
    pub key: String,
    /// What the payload is.
    pub encoding: String,
    /// What was attached to it.
    pub attachment: Vec<u8>,
    /// The payload.
    pub payload: BulkBytes,
}

/// A payload's bytes in one piece; clones are the same bytes.
#[derive(Clone)]
pub struct BulkBytes(ZBytes);

/// The payloads that come on some keys, newest first to stay.
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

/// Removes the shared memory that processes left behind which were killed, and lets go of what this one still maps of
/// it. It looks through all segments of the machine: for now and then.
pub fn remove_orphans() {
    attached::let_go();
    cleanup_orphaned_shm_segments();
}

impl Session {
    /// Declares that large payloads will be sent on a key. What the network cannot take now is dropped.
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

    /// Subscribes to large payloads. At most `capacity` wait to be read; further ones push out the oldest.
    ///
    /// With `detached`, payloads are copied out of shared memory as they come: many may then wait without holding the
    /// sender's pool. Without it they are only looked at where they are, and may have to be given up: see
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
    /// Whether anybody listens.
    #[must_use]
    pub fn is_wanted(&self) -> bool {
        *self.wanted.borrow()
    }

    /// Waits until somebody listens.
    pub async fn wanted(&self) {
        let mut wanted = self.wanted.clone();
        // The other end lives as long as the listener.
        let _ = wanted.wait_for(|wanted| *wanted).await.is_ok();
    }

    /// How many payloads did not fit into shared memory, because readers held it, and were sent as copies.
    #[must_use]
    pub fn unshared(&self) -> u64 {
        self.unshared.load(Ordering::Relaxed)
    }

    /// Room for a payload of `length` bytes, in shared memory where there is any. Its content is arbitrary.
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

    /// Sends a payload with something attached to it.
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
    /// In one piece: a message that came in several is put together.
    fn of(payload: &ZBytes, detached: bool) -> Self {
        let in_one_piece = payload.slices().nth(1).is_none();
        let shared = payload.as_shm().is_some();
        if in_one_piece && !(shared && detached) {
            return Self(payload.clone());
        }
        Self(ZBytes::from(payload.to_bytes().into_owned()))
    }

    /// Whether the bytes lie in memory that the sender shares.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        self.0.as_shm().is_some()
    }

    /// Whether what was read so far is what was sent. A reader that the system does not let run for a tenth of a second
    /// loses its hold on shared memory, and the sender writes the next payload there; so it does when the sender has
    /// gone. Whoever has looked at the bytes asks afterwards.
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
    /// Never waits: this runs on the threads of Zenoh's links.
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
    /// The next payload. It waits until there is one, however long that takes: a sender may come back.
    pub async fn next(&self) -> Bulk {
        loop {
            if let Some(bulk) = self.try_next() {
                return bulk;
            }
            self.queue.arrived.notified().await;
        }
    }

    /// The next payload if there is one already.
    #[must_use]
    pub fn try_next(&self) -> Option<Bulk> {
        self.queue.waiting.lock().pop_front()
    }

    /// How many payloads were pushed out of the queue so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.queue.dropped.load(Ordering::Relaxed)
    }
}
