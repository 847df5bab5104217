//! What is refused is logged with who sent it, and a flood of it does not become a flood of log lines: a few of
//! each sender are written in a second, and the others counted.

use std::collections::BTreeMap;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;

use crate::error::MemoryError;

/// Refusals of one sender that are logged one by one in a second.
const LOGGED: u32 = 3;
/// Senders whose refusals are logged in a second.
const SENDERS: usize = 16;
/// How long they are counted together.
const WINDOW: Duration = Duration::from_secs(1);

/// What was refused lately.
#[derive(Debug, Default)]
pub(super) struct Refusals(Mutex<Lately>);

#[derive(Debug, Default)]
struct Lately {
    since: Option<Instant>,
    logged: BTreeMap<String, u32>,
    left_out: u64,
}

impl Refusals {
    /// Logs that something of `sender` on `key` was refused, unless that has been logged often enough.
    pub(super) fn note(&self, sender: &str, key: &str, error: &MemoryError) {
        let mut lately = self.0.lock();
        let now = Instant::now();
        if lately.since.is_none_or(|since| now - since >= WINDOW) {
            let left_out = lately.left_out;
            if left_out > 0 {
                tracing::warn!(left_out, "more was refused than is logged one by one");
            }
            *lately = Lately { since: Some(now), ..Lately::default() };
        }
        let logged = lately.logged.get(sender).copied().unwrap_or(0);
        if logged < LOGGED && (logged > 0 || lately.logged.len() < SENDERS) {
            lately.logged.insert(sender.into(), logged + 1);
            tracing::warn!(%error, key, sender, "refused");
        } else {
            lately.left_out += 1;
        }
    }
}

/// Whether whoever is told this error has done something wrong, or at least more than the memory takes; what happens
/// among those who work together is not worth a line.
pub(super) fn is_senders_fault(error: &MemoryError) -> bool {
    !matches!(
        error,
        MemoryError::NotFound { .. }
            | MemoryError::Conflict { .. }
            | MemoryError::Query { .. }
            | MemoryError::Store { .. }
    )
}
