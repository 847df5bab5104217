//! Counters of a running processor.

use std::sync::OnceLock;

use tokio::time::Instant;

use crate::counter::{Counter, Latency};
use crate::frame::ImageError;

/// Counters of a processor's loop. All may be read at any time.
#[derive(Debug, Default)]
pub struct ProcessorStatistics {
    /// Frames processed.
    pub frames: Counter,
    /// Frames of the first provider that were never processed: by the gaps in their numbers, because the
    /// processor or the transport was too slow; and those before every other provider had sent a frame.
    pub skipped: Counter,
    /// Frames that were damaged or that do not suit the processor.
    pub unusable: Counter,
    /// Results discarded because the frame's memory was overwritten meanwhile.
    pub torn: Counter,
    /// Time from receiving a frame to handing over its result, by tokio's clock (zero in virtual time).
    pub latency: Latency,
    why_unusable: OnceLock<String>,
    span_ns: Counter,
}

impl ProcessorStatistics {
    /// The error of the first unusable frame, for people.
    pub fn why_unusable(&self) -> Option<&str> {
        self.why_unusable.get().map(String::as_str)
    }

    /// Frames processed per second of tokio's clock, from the first to the last; 0 before the second.
    pub fn rate_hz(&self) -> f64 {
        let span_s = self.span_ns.get() as f64 * 1e-9;
        if span_s > 0.0 { self.frames.get().saturating_sub(1) as f64 / span_s } else { 0.0 }
    }

    /// Counts an unusable frame; logs the error of the first one.
    pub(super) fn count_unusable(&self, processor: &str, error: &ImageError) {
        self.unusable.add(1);
        if self.why_unusable.set(error.to_string()).is_ok() {
            tracing::warn!("`{processor}` cannot use a frame: {error}");
        }
    }

    pub(super) fn count(&self, began: Instant, received: Instant) {
        self.frames.add(1);
        self.latency.add(received.elapsed());
        self.span_ns.set(u64::try_from(received.duration_since(began).as_nanos()).unwrap_or(u64::MAX));
    }
}
