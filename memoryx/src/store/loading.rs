//! Reading long-term memory into working memory.

use std::sync::Arc;

use tokio::runtime::{Handle, RuntimeFlavor};

use super::LongTermMemory;
use crate::awaited_thread::AwaitedThread;
use crate::error::MemoryError;
use crate::query::{Cursor, Pattern, Query};
use crate::working::WorkingMemory;

/// Snapshots that are loaded together, and about how many bytes of them.
const PAGE_SIZE: usize = 1024;
const MAX_PAGE_BYTES: u64 = 16 << 20;

/// The reading of long-term memory beside all others. Dropping this ends it.
pub struct Loading {
    /// While this is there, the thread reads on. Dropped first (the order of the fields).
    _goes_on: Arc<()>,
    _thread: Option<AwaitedThread>,
}

impl LongTermMemory {
    /// Loads the newest snapshots of matching entities into working memory, with their versions. Returns how many of
    /// them that memory did not have. Snapshots that it refuses, because they are invalid or it is full, stay in the
    /// file only, with a log line.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when they cannot be read.
    pub fn load_into(&self, memory: &WorkingMemory, pattern: Pattern) -> Result<usize, MemoryError> {
        self.load_while(memory, pattern, &|| true)
    }

    /// Loads everything: beside all others where the runtime has several threads, and at once where it has one, because
    /// virtual time does not wait for another thread. What was not read yet is looked up in the file, if this is the
    /// memory's backing.
    ///
    /// # Errors
    /// [`MemoryError::Store`] when the file cannot be read, or there is no thread.
    pub fn load_beside(self: &Arc<Self>, memory: &Arc<WorkingMemory>) -> Result<Loading, MemoryError> {
        let goes_on = Arc::new(());
        if !Handle::try_current().is_ok_and(|h| h.runtime_flavor() == RuntimeFlavor::MultiThread) {
            self.load_into(memory, Pattern::any())?;
            return Ok(Loading { _goes_on: goes_on, _thread: None });
        }
        memory.set_partial(true);
        let (store, memory, wanted) = (Arc::clone(self), Arc::clone(memory), Arc::downgrade(&goes_on));
        let thread = AwaitedThread::start("memory-reading", "no thread to read it", move || {
            let goes_on = || wanted.strong_count() > 0;
            match store.load_while(&memory, Pattern::any(), &goes_on) {
                Ok(_) if goes_on() => memory.set_partial(false),
                Ok(_) => {}
                Err(error) => {
                    tracing::error!(%error, "long-term memory could not be read into working memory")
                }
            }
        });
        Ok(Loading { _goes_on: goes_on, _thread: Some(thread?) })
    }

    /// As [`Self::load_into`], as long as `goes_on` is true.
    fn load_while(
        &self,
        memory: &WorkingMemory,
        pattern: Pattern,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<usize, MemoryError> {
        let (mut restored, mut refused) = (0, None);
        let mut query =
            Query { most: Some(PAGE_SIZE), most_bytes: Some(MAX_PAGE_BYTES), ..Query::latest(pattern) };
        while goes_on() {
            let found = self.query(&query)?;
            let is_cut = query.is_filled_by(&found);
            query.after = found.last().map(|s| Cursor::after(s));
            let (count, error) = memory.restore(found);
            restored += count;
            refused = refused.or(error);
            if !is_cut {
                break;
            }
        }
        memory.count_from(self.given_ahead()?);
        if let Some(error) = refused {
            tracing::warn!(%error, store = self.name, "some of what was kept is not in working memory");
        }
        Ok(restored)
    }
}
