//! Until when a program that serves others goes on: Ctrl-C, the system's request to end, the end of the standard input.

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

/// As [`stopped`], or for the end of the standard input.
pub(crate) async fn stopped_or_input_ended() {
    tokio::select! {
        biased;
        () = stopped() => {}
        () = input_ended() => {}
    }
}

/// Waits until nobody can write to the standard input any more.
#[expect(
    clippy::disallowed_methods,
    reason = "agents live in real time, and nothing can wait for this thread"
)]
async fn input_ended() {
    // A thread of its own, which does not hold up the end of the program as one of the runtime's would.
    let (ended, waiting) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        // What is said there is not for this program; an input that cannot be read has ended too.
        let _ = io::copy(&mut io::stdin().lock(), &mut io::sink()).is_ok();
        let _ = ended.send(()).is_ok();
    });
    // The sender is only dropped after it has sent.
    let _ = waiting.await.is_ok();
}
