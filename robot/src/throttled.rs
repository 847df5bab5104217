//! Warnings about what comes from outside, perhaps a thousand times a second: each kind is said once a second at most, with how
//! often it was since.

use std::fmt;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;

/// The least time from one warning to the next.
const APART: Duration = Duration::from_secs(1);

/// One kind of warning.
#[derive(Debug, Default)]
pub struct Throttled(Mutex<Said>);

#[derive(Debug, Default)]
struct Said {
    last: Option<Instant>,
    unsaid: u64,
}

impl Throttled {
    /// Says it, or counts it.
    pub fn warn(&self, what: impl fmt::Display) {
        match self.due(Instant::now()) {
            None => {}
            Some(0) => tracing::warn!("{what}"),
            Some(more) => tracing::warn!("{what} (and {more} times before, since it was said last)"),
        }
    }

    /// How often it was not said, if it is to be said now.
    fn due(&self, now: Instant) -> Option<u64> {
        let mut said = self.0.lock();
        if said.last.is_some_and(|last| now.saturating_duration_since(last) < APART) {
            said.unsaid += 1;
            return None;
        }
        said.last = Some(now);
        Some(std::mem::take(&mut said.unsaid))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thousand_warnings_in_a_second_are_one() {
        let (throttled, began) = (Throttled::default(), Instant::now());
        let at = |ms| throttled.due(began + Duration::from_millis(ms));
        assert_eq!(at(0), Some(0));
        assert!((1..1000).all(|ms| at(ms).is_none()));
        assert_eq!((at(1000), at(1001), at(2500)), (Some(999), None, Some(1)));
    }
}
