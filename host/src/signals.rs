//! What asks a program to end.

use tokio::signal::unix::{SignalKind, signal};

/// Waits for Ctrl-C, or for the system's request to end. Says which.
pub(crate) async fn signalled() -> &'static str {
    let Ok(mut terminated) = signal(SignalKind::terminate()) else { return std::future::pending().await };
    tokio::select! {
        biased;
        _ = tokio::signal::ctrl_c() => "Ctrl-C",
        _ = terminated.recv() => "the system (SIGTERM)",
    }
}
