//! Shared memory segments of other processes: attaches to them, and detaches when they are unused.
//!
//! Zenoh keeps every segment mapped that it ever read from, until the session ends; the memory of a killed sender
//! would stay mapped at its reader. Here a segment is unmapped when no payload in it is in use, and mapped again when
//! another arrives. Zenoh's own bookkeeping of payloads (1.3 MB per sender) cannot be freed from here.

use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use zenoh::shm::{
    ChunkID, PosixShmClient, ProtocolID, SegmentID, ShmClient, ShmClientStorage, ShmSegment, WithProtocolID,
};

/// The segments that this process is attached to.
static SEGMENTS: Mutex<Vec<Weak<ForeignSegment>>> = Mutex::new(Vec::new());

/// A sender's segment.
#[derive(Debug)]
struct ForeignSegment {
    id: SegmentID,
    /// The segment, while it is mapped. Pointers into it are handed out under the lock, and only to holders of the
    /// `Arc` around this. Without such a holder no pointer exists.
    mapped: Mutex<Option<Arc<dyn ShmSegment>>>,
}

/// Attaches to segments in a way that allows unmapping.
#[derive(Debug)]
struct UnmappingClient;

/// The storage with which a session reads shared memory.
pub(crate) fn clients() -> Arc<ShmClientStorage> {
    Arc::new(ShmClientStorage::builder().with_client(Arc::new(UnmappingClient)).build())
}

/// Unmaps all segments without a payload in use. The last process to do so removes a segment whose sender has exited.
pub(crate) fn unmap_unused() {
    let mut segments = SEGMENTS.lock();
    segments.retain(|segment| {
        let Some(segment) = segment.upgrade() else { return false };
        segment.unmap_unused();
        true
    });
}

impl ForeignSegment {
    /// Drops the mapping if only the session's table holds this as well. A thread that takes the segment from the
    /// table meanwhile waits at the lock, and maps it again.
    fn unmap_unused(self: &Arc<Self>) {
        let mut mapped = self.mapped.lock();
        if Arc::strong_count(self) == 2 {
            *mapped = None;
        }
    }
}

impl ShmSegment for ForeignSegment {
    fn map(&self, chunk: ChunkID) -> zenoh::Result<*mut u8> {
        let mut mapped = self.mapped.lock();
        let segment = match mapped.take() {
            Some(segment) => segment,
            None => PosixShmClient.attach(self.id)?,
        };
        mapped.insert(segment).map(chunk)
    }
}

impl WithProtocolID for UnmappingClient {
    fn id(&self) -> ProtocolID {
        PosixShmClient.id()
    }
}

impl ShmClient for UnmappingClient {
    fn attach(&self, id: SegmentID) -> zenoh::Result<Arc<dyn ShmSegment>> {
        let mapped = Mutex::new(Some(PosixShmClient.attach(id)?));
        let segment = Arc::new(ForeignSegment { id, mapped });
        SEGMENTS.lock().push(Arc::downgrade(&segment));
        Ok(segment)
    }
}
