//! What one asker may take of a shared memory's time and room, so that some is left for the others.

use std::sync::Arc;

use armarium_bus::PerAsker;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, SemaphorePermit};

use super::BUDGET_KB;

/// Queries that are answered in parallel, and of these, those of one asker.
const MAX_PARALLEL: usize = 8;
const MAX_PARALLEL_OF_ONE: usize = 4;
/// The part of the budget that one asker gets.
const SHARES: u32 = 4;

/// All askers. Those who do not say who they are count as one.
#[derive(Debug)]
pub(super) struct Askers {
    shares: PerAsker<Share>,
    all: Share,
}

/// What may be taken at the same time.
#[derive(Debug)]
struct Share {
    parallel: Semaphore,
    /// Budget for queries that wait or are being answered, kB.
    room: Arc<Semaphore>,
}

/// A query's part of the budget, until it is dropped.
#[derive(Debug)]
pub(super) struct Waiting {
    own: Arc<Share>,
    _room: [OwnedSemaphorePermit; 2],
}

impl Share {
    fn new(parallel: usize, room_kb: u32) -> Self {
        Self { parallel: Semaphore::new(parallel), room: Arc::new(Semaphore::new(room_kb as usize)) }
    }
}

impl Askers {
    pub(super) fn new() -> Self {
        Self { shares: PerAsker::default(), all: Share::new(MAX_PARALLEL, BUDGET_KB) }
    }

    /// Takes budget for a query to wait beside the others, so that commits never wait for queries. `None` when the
    /// asker, or all together, have none left.
    pub(super) fn admit(&self, asker: Option<&str>, kb: u32) -> Option<Waiting> {
        let own = self.shares.of(asker, || Share::new(MAX_PARALLEL_OF_ONE, BUDGET_KB / SHARES));
        let room =
            |share: &Share, most: u32| Arc::clone(&share.room).try_acquire_many_owned(kb.min(most)).ok();
        let taken = [room(&own, BUDGET_KB / SHARES)?, room(&self.all, BUDGET_KB)?];
        Some(Waiting { own, _room: taken })
    }

    /// Waits until the query may compute, and lets it do so while the result is held.
    pub(super) async fn turn<'w>(&'w self, waiting: &'w Waiting) -> [Option<SemaphorePermit<'w>>; 2] {
        // First its own, so that one asker's queries wait for each other and not in front of the others.
        let own = waiting.own.parallel.acquire().await.ok();
        [own, self.all.parallel.acquire().await.ok()]
    }
}
