//! Counters of a running processor.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::time::{Duration, Instant};

use crate::frame::ImageError;

/// Counters of a processor's loop. All may be read at any time.
#[derive(Debug, Default)]
pub struct ProcessorStatistics {
    frames: AtomicU64,
    pub(super) skipped: AtomicU64,
    unusable: AtomicU64,
    why_unusable: OnceLock<String>,
    pub(super) torn: AtomicU64,
    latency_ns: AtomicU64,
    worst_ns: AtomicU64,
    span_ns: AtomicU64,
}

impl ProcessorStatistics {
    /// Frames processed.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames.load(Ordering::Relaxed)
    }

    /// Frames of the first provider that were never processed: by the gaps in their numbers, because the
    /// processor or the transport was too slow; and those before every other provider had sent a frame.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }

    /// Frames that were damaged or that do not suit the processor.
    #[must_use]
    pub fn unusable(&self) -> u64 {
        self.unusable.load(Ordering::Relaxed)
    }

    /// The error of the first such frame, for people.
    #[must_use]
    pub fn why_unusable(&self) -> Option<&str> {
        self.why_unusable.get().map(String::as_str)
    }

    /// Results discarded because the frame's memory was overwritten meanwhile.
    #[must_use]
    pub fn torn(&self) -> u64 {
        self.torn.load(Ordering::Relaxed)
    }

    /// Mean time from receiving a frame to handing over its result, s of tokio's clock (zero in virtual time).
    #[must_use]
    pub fn mean_latency_s(&self) -> f64 {
        self.latency_ns.load(Ordering::Relaxed) as f64 * 1e-9 / self.frames().max(1) as f64
    }

    /// The longest such time, s.
    #[must_use]
    pub fn worst_latency_s(&self) -> f64 {
        self.worst_ns.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// Frames processed per second of tokio's clock, from the first to the last; 0 before the second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        let span_s = self.span_ns.load(Ordering::Relaxed) as f64 * 1e-9;
        if span_s > 0.0 { self.frames().saturating_sub(1) as f64 / span_s } else { 0.0 }
    }

    /// Counts an unusable frame; logs the error of the first one.
    pub(super) fn count_unusable(&self, processor: &str, error: &ImageError) {
        self.unusable.fetch_add(1, Ordering::Relaxed);
        if self.why_unusable.set(error.to_string()).is_ok() {
            tracing::warn!("`{processor}` cannot use a frame: {error}");
        }
    }

    pub(super) fn count(&self, began: Instant, received: Instant) {
        let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let latency = ns(received.elapsed());
        self.frames.fetch_add(1, Ordering::Relaxed);
        self.latency_ns.fetch_add(latency, Ordering::Relaxed);
        self.worst_ns.fetch_max(latency, Ordering::Relaxed);
        self.span_ns.store(ns(received.duration_since(began)), Ordering::Relaxed);
    }
}
