//! Where processors work: beside everything else, or in the step of whoever waits for them.

use std::panic::resume_unwind;

/// Where processors work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Workers {
    /// In virtual time: time stands still while a processor works, and they work one after the other, so that a run is
    /// repeatable.
    Joined,
    /// In real time: on a thread each, so that a slow processor holds up nothing.
    Threads,
}

impl Workers {
    /// Does some work on a state; gives both back.
    pub(crate) async fn work<S, T>(
        self,
        mut state: S,
        work: impl FnOnce(&mut S) -> T + Send + 'static,
    ) -> (S, T)
    where
        S: Send + 'static,
        T: Send + 'static,
    {
        if self == Self::Joined {
            let done = work(&mut state);
            return (state, done);
        }
        let on_a_thread = tokio::task::spawn_blocking(move || {
            let done = work(&mut state);
            (state, done)
        });
        match on_a_thread.await {
            Ok(both) => both,
            Err(error) => match error.try_into_panic() {
                Ok(panic) => resume_unwind(panic),
                // The program ends, and with it the task that waits here.
                Err(_) => std::future::pending().await,
            },
        }
    }
}
