//! The edge detector of one watch: since when its condition holds, and whether it has fired and waits for its
//! `until`.

use std::time::Duration;

/// See the module. All times are since the run's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Edge {
    since: Option<Duration>,
    fired: bool,
}

impl Edge {
    /// Takes one sample at `now` and returns whether the watch fires. It fires when the condition has held for
    /// `hold`, and was false (or `until` was true) since the last firing. A condition that is true at the first
    /// sample counts as a rise.
    pub(super) fn sample(&mut self, now: Duration, holds: bool, until: bool, hold: Duration) -> bool {
        if self.fired && until {
            (self.fired, self.since) = (false, None);
        }
        if !holds {
            self.since = None;
            return false;
        }
        let since = *self.since.get_or_insert(now);
        if self.fired || now.saturating_sub(since) < hold {
            return false;
        }
        self.fired = true;
        true
    }

    /// When the hold time ends, if it is running.
    pub(super) fn deadline(&self, hold: Duration) -> Option<Duration> {
        self.since.filter(|_| !self.fired).map(|since| since.saturating_add(hold))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_rise_once_hold_and_wait_for_until() {
        let at = Duration::from_millis;
        let hold = Duration::from_millis(100);
        let mut edge = Edge::default();
        assert!(!edge.sample(at(0), true, false, hold));
        assert_eq!(edge.deadline(hold), Some(at(100)));
        assert!(!edge.sample(at(50), false, false, hold), "a false sample resets the hold");
        assert!(!edge.sample(at(60), true, false, hold));
        assert!(!edge.sample(at(150), true, false, hold));
        assert!(edge.sample(at(160), true, false, hold));
        assert!(!edge.sample(at(300), true, false, hold), "it fires on the rise only");
        assert!(!edge.sample(at(310), false, false, hold));
        assert!(!edge.sample(at(500), true, false, hold), "it has not been below `until`");
        assert!(!edge.sample(at(700), true, false, hold));
        assert!(!edge.sample(at(710), false, true, hold));
        assert!(!edge.sample(at(720), true, false, hold));
        assert!(edge.sample(at(820), true, false, hold));
    }

    #[test]
    fn true_at_the_first_sample_is_a_rise() {
        assert!(Edge::default().sample(Duration::ZERO, true, false, Duration::ZERO));
    }
}
