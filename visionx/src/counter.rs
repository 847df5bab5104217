//! Counters that some tasks add to while others read.

use std::sync::atomic::{AtomicU64, Ordering};

use tokio::time::Duration;

/// A count. It may be read at any time.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// The count so far.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    /// Adds to the count; returns the count before.
    pub(crate) fn add(&self, n: u64) -> u64 {
        self.0.fetch_add(n, Ordering::Relaxed)
    }

    pub(crate) fn set(&self, n: u64) {
        self.0.store(n, Ordering::Relaxed);
    }
}

/// Mean and maximum of latencies.
#[derive(Debug, Default)]
pub struct Latency {
    count: Counter,
    sum_ns: Counter,
    max_ns: AtomicU64,
}

impl Latency {
    /// The mean, s.
    pub fn mean_s(&self) -> f64 {
        self.sum_ns.get() as f64 * 1e-9 / self.count.get().max(1) as f64
    }

    /// The longest, s.
    pub fn worst_s(&self) -> f64 {
        self.max_ns.load(Ordering::Relaxed) as f64 * 1e-9
    }

    pub(crate) fn add(&self, latency: Duration) {
        let ns = u64::try_from(latency.as_nanos()).unwrap_or(u64::MAX);
        self.count.add(1);
        self.sum_ns.add(ns);
        self.max_ns.fetch_max(ns, Ordering::Relaxed);
    }
}
