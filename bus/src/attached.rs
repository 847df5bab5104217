//! The shared memory of other processes that this one looks into, and lets go of.
//!
//! Zenoh keeps every segment mapped that it ever read from, for as long as the session lives; the memory of a sender that
//! was killed would stay with its reader. Here a segment is let go when nobody holds a payload in it, and mapped again
//! should another one come. Zenoh's own bookkeeping of payloads (1.3 MB a sender) is not reached from here.

use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use zenoh::shm::{
    ChunkID, PosixShmClient, ProtocolID, SegmentID, ShmClient, ShmClientStorage, ShmSegment, WithProtocolID,
};

/// What sessions of this process are attached to.
static ATTACHED: Mutex<Vec<Weak<Attached>>> = Mutex::new(Vec::new());

/// A sender's segment.
#[derive(Debug)]
struct Attached {
    id: SegmentID,
    /// The segment, while it is mapped. Pointers into it are given out under the lock, to whoever holds the `Arc` around
    /// this: without such a holder there are none.
    mapped: Mutex<Option<Arc<dyn ShmSegment>>>,
}

/// Attaches to segments so that they can be let go.
#[derive(Debug)]
struct Client;

/// What a session reads shared memory with.
pub(crate) fn clients() -> Arc<ShmClientStorage> {
    Arc::new(ShmClientStorage::builder().with_client(Arc::new(Client)).build())
}

/// Lets go of all segments in which nobody holds a payload. The last process to do so removes a segment whose sender
/// has gone.
pub(crate) fn let_go() {
    let mut attached = ATTACHED.lock();
    attached.retain(|segment| {
        let Some(segment) = segment.upgrade() else { return false };
        segment.let_go();
        true
    });
}

impl Attached {
    /// Drops the mapping when the session's table is the only other holder. Whoever takes the segment from the table
    /// meanwhile waits at the lock, and maps it again.
    fn let_go(self: &Arc<Self>) {
        let mut mapped = self.mapped.lock();
        if Arc::strong_count(self) == 2 {
            *mapped = None;
        }
    }
}

impl ShmSegment for Attached {
    fn map(&self, chunk: ChunkID) -> zenoh::Result<*mut u8> {
        let mut mapped = self.mapped.lock();
        let segment = match mapped.take() {
            Some(segment) => segment,
            None => PosixShmClient.attach(self.id)?,
        };
        mapped.insert(segment).map(chunk)
    }
}

impl WithProtocolID for Client {
    fn id(&self) -> ProtocolID {
        PosixShmClient.id()
    }
}

impl ShmClient for Client {
    fn attach(&self, id: SegmentID) -> zenoh::Result<Arc<dyn ShmSegment>> {
        let mapped = Mutex::new(Some(PosixShmClient.attach(id)?));
        let segment = Arc::new(Attached { id, mapped });
        ATTACHED.lock().push(Arc::downgrade(&segment));
        Ok(segment)
    }
}
