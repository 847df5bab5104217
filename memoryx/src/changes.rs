//! A subscription to a memory: every later change of the entities that match a pattern, those of each entity in order.
//! What was lost is noticed here, and read again by [`crate::Follower`].

use std::sync::{Arc, Weak};

use async_trait::async_trait;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};

use crate::entity::Snapshot;
use crate::query::Pattern;

/// A subscription to the changes of a memory.
pub struct Changes {
    pattern: Pattern,
    source: Box<dyn ChangeSource>,
}

/// Snapshots of so many bytes are not kept for those who have not taken them yet.
const LARGE_BYTES: u64 = 16 << 10;

/// A change as a memory tells it in its process. Until the slowest subscriber has taken it, a small snapshot is kept, and a large
/// one as long as the memory has it: so what waits is bounded in bytes.
#[derive(Clone, Debug)]
pub(crate) enum PublishedSnapshot {
    Small(Arc<Snapshot>),
    Large(Weak<Snapshot>),
}

impl PublishedSnapshot {
    pub(crate) fn of(snapshot: &Arc<Snapshot>) -> Self {
        if snapshot.bytes() < LARGE_BYTES {
            Self::Small(Arc::clone(snapshot))
        } else {
            Self::Large(Arc::downgrade(snapshot))
        }
    }

    /// The snapshot, unless the memory has forgotten it.
    fn take(self) -> Option<Arc<Snapshot>> {
        match self {
            Self::Small(snapshot) => Some(snapshot),
            Self::Large(snapshot) => snapshot.upgrade(),
        }
    }
}

/// Where changes come from.
#[async_trait]
pub(crate) trait ChangeSource: Send + Sync {
    /// The next change. Cancel-safe.
    async fn recv(&mut self) -> Result<Arc<Snapshot>, RecvError>;
    /// The next change, if one waits.
    fn try_recv(&mut self) -> Result<Arc<Snapshot>, TryRecvError>;
    /// Every change that arrived in the memory before this time was received, ns; 0 when unknown.
    fn until_ns(&self) -> u64;
    /// Whether the last loss was that of the memory itself, which has begun anew or was away.
    fn began_anew(&self) -> bool {
        false
    }
}

impl Changes {
    pub(crate) fn new(pattern: Pattern, source: impl ChangeSource + 'static) -> Self {
        Self { pattern, source: Box::new(source) }
    }

    /// The changes that this process's memory sends.
    pub(crate) fn here(pattern: Pattern, receiver: broadcast::Receiver<PublishedSnapshot>) -> Self {
        Self::new(pattern, Here { receiver, until_ns: 0 })
    }

    /// The next change. Cancel-safe.
    ///
    /// # Errors
    /// [`RecvError::Lagged`] when changes were lost, with their number as far as it is known: whoever needs them reads the
    /// memory again. [`RecvError::Closed`] when the memory is gone.
    pub async fn recv(&mut self) -> Result<Arc<Snapshot>, RecvError> {
        loop {
            let change = self.source.recv().await?;
            if self.pattern.matches(&change.id) {
                return Ok(change);
            }
        }
    }

    /// The next change, if one waits.
    ///
    /// # Errors
    /// As [`Self::recv`]; [`TryRecvError::Empty`] when none waits.
    pub fn try_recv(&mut self) -> Result<Arc<Snapshot>, TryRecvError> {
        loop {
            let change = self.source.try_recv()?;
            if self.pattern.matches(&change.id) {
                return Ok(change);
            }
        }
    }

    pub(crate) fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    pub(crate) fn until_ns(&self) -> u64 {
        self.source.until_ns()
    }

    pub(crate) fn began_anew(&self) -> bool {
        self.source.began_anew()
    }
}

/// The changes of a memory in this process, which come in the order of their arrival.
struct Here {
    receiver: broadcast::Receiver<PublishedSnapshot>,
    until_ns: u64,
}

#[async_trait]
impl ChangeSource for Here {
    async fn recv(&mut self) -> Result<Arc<Snapshot>, RecvError> {
        let change = self.receiver.recv().await?.take().ok_or(RecvError::Lagged(1))?;
        self.until_ns = change.arrived_ns;
        Ok(change)
    }

    fn try_recv(&mut self) -> Result<Arc<Snapshot>, TryRecvError> {
        let change = self.receiver.try_recv()?.take().ok_or(TryRecvError::Lagged(1))?;
        self.until_ns = change.arrived_ns;
        Ok(change)
    }

    fn until_ns(&self) -> u64 {
        self.until_ns
    }
}
