//! Of which clock a time is: a simulated run's, or the time of day. Its value says so.

use std::fmt;

/// Of which clock a time is that data describe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeOf {
    /// A simulated run's: it counts from the run's start.
    Run,
    /// The time of day, since 1970.
    Day,
}

/// A time below is a run's, ns: no run lasts a year, and no clock says that it is 1970.
const DAY_FROM_NS: u64 = 365 * 86_400 * 1_000_000_000;

impl TimeOf {
    /// Of which clock a time is, ns.
    pub fn of(time_ns: u64) -> Self {
        if time_ns < DAY_FROM_NS { Self::Run } else { Self::Day }
    }
}

impl fmt::Display for TimeOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Run => "a run's time",
            Self::Day => "the time of day",
        })
    }
}
