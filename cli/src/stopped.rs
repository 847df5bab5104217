//! When a serving program ends: at Ctrl-C, at the system's request, or at the end of the standard input.

use std::io;

/// Waits for Ctrl-C, or for the system's request to end.
pub(crate) async fn stopped() {
    let interrupted = tokio::signal::ctrl_c();
    let Ok(mut terminated) = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) else {
        let _ = interrupted.await.is_ok();
        return;
    };
    tokio::select! {
        biased;
        _ = interrupted => {}
        _ = terminated.recv() => {}
    }
}

/// As [`stopped`], or at the end of the standard input.
pub(crate) async fn stopped_or_input_ended() {
    tokio::select! {
        biased;
        () = stopped() => {}
        () = input_ended() => {}
    }
}

/// Waits until all writers of the standard input have closed it.
#[expect(
    clippy::disallowed_methods,
    reason = "agents live in real time, and nothing can wait for this thread"
)]
async fn input_ended() {
    // A plain thread, because a blocking task of the runtime would delay the end of the program.
    let (ended, waiting) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // The content is ignored; a read error counts as the end.
        let _ = io::copy(&mut io::stdin().lock(), &mut io::sink()).is_ok();
        let _ = ended.send(()).is_ok();
    });
    // The sender is only dropped after it has sent.
    let _ = waiting.await.is_ok();
}
