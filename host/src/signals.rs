//! What asks a program to end.

use tokio::signal::unix::{SignalKind, signal};

/// Waits for Ctrl-C, or for the system's request to end. Says which. It hears from the call on, not only when it is first waited for; to
/// be called in a tokio runtime.
pub(crate) fn signalled() -> impl Future<Output = &'static str> {
    let signals = (signal(SignalKind::interrupt()), signal(SignalKind::terminate()));
    async move {
        let (Ok(mut interrupted), Ok(mut terminated)) = signals else { return std::future::pending().await };
        tokio::select! {
            biased;
            _ = interrupted.recv() => "Ctrl-C",
            _ = terminated.recv() => "the system (SIGTERM)",
        }
    }
}
