//! A thread that ends before whoever started it goes on: its handle waits for it when it is dropped. What ends it is told by other means.

use std::thread::JoinHandle;

use crate::error::MemoryError;

/// A thread for whose end whoever drops this waits.
pub(crate) struct AwaitedThread(Option<JoinHandle<()>>);

impl AwaitedThread {
    /// Starts a thread. `missing`: what is said where there is none.
    pub(crate) fn start(
        name: &str,
        missing: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<Self, MemoryError> {
        let thread = std::thread::Builder::new().name(name.into()).spawn(work);
        let thread = thread.map_err(|e| MemoryError::Store { what: format!("{missing}: {e}") })?;
        Ok(Self(Some(thread)))
    }
}

impl Drop for AwaitedThread {
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            let _ = thread.join();
        }
    }
}
