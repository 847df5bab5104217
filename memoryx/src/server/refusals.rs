//! Logs refusals with their sender. A flood of refusals does not become a flood of log lines: a few per sender and
//! second are written, the others are counted.

use std::collections::BTreeMap;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;

use crate::error::MemoryError;

/// Refusals per sender and second that are logged individually.
const MAX_LOGGED: u32 = 3;
/// Senders per second whose refusals are logged.
const MAX_SENDERS: usize = 16;
/// The period over which refusals are counted.
const WINDOW_LENGTH: Duration = Duration::from_secs(1);

/// The refusals of the present period.
#[derive(Debug, Default)]
pub(super) struct Refusals(Mutex<LogWindow>);

#[derive(Debug, Default)]
struct LogWindow {
    since: Option<Instant>,
    logged: BTreeMap<String, u32>,
    left_out: u64,
}

impl Refusals {
    /// Logs that something of `sender` on `key` was refused, unless the limit is reached.
    pub(super) fn note(&self, sender: &str, key: &str, error: &MemoryError) {
        let mut lately = self.0.lock();
        let now = Instant::now();
        if lately.since.is_none_or(|since| now - since >= WINDOW_LENGTH) {
            let left_out = lately.left_out;
            if left_out > 0 {
                tracing::warn!(left_out, "more was refused than is logged one by one");
            }
            *lately = LogWindow { since: Some(now), ..LogWindow::default() };
        }
        let logged = lately.logged.get(sender).copied().unwrap_or(0);
        if logged < MAX_LOGGED && (logged > 0 || lately.logged.len() < MAX_SENDERS) {
            lately.logged.insert(sender.into(), logged + 1);
            tracing::warn!(%error, key, sender, "refused");
        } else {
            lately.left_out += 1;
        }
    }
}

/// Whether an error is the sender's fault, or at least exceeds what the memory accepts. Conflicts among cooperating
/// writers are not logged.
pub(super) fn is_senders_fault(error: &MemoryError) -> bool {
    !matches!(
        error,
        MemoryError::NotFound { .. }
            | MemoryError::Conflict { .. }
            | MemoryError::Query { .. }
            | MemoryError::Store { .. }
    )
}
