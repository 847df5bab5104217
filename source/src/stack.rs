//! A stack that is large enough for what is read and checked by recursion: nested YAML, and expressions, whose parser
//! is not ours. Their depth has a bound; what a level takes in a build without optimization is tens of kilobytes.

/// Bytes; only what is used of it is taken.
const STACK: usize = 64 << 20;

/// Does `work` on a large stack, and waits for it.
pub fn on_a_large_stack<T: Send>(work: impl Fn() -> T + Sync) -> T {
    let done = std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, &work).ok()?;
        Some(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    });
    // Where the system gives no thread, this one has to do.
    done.unwrap_or_else(work)
}
