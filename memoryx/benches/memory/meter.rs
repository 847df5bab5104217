//! Prints figures of the wall clock and of the processors, and counts those that miss what is asked.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

static MISSED: AtomicU32 = AtomicU32::new(0);

/// How many figures have missed what is asked.
pub(crate) fn missed() -> u32 {
    MISSED.load(Ordering::Relaxed)
}

fn judged(asked: &str, holds: bool) -> String {
    MISSED.fetch_add(u32::from(!holds), Ordering::Relaxed);
    format!("asked: {asked}{}", if holds { "" } else { ", MISSED" })
}

pub(crate) fn say(what: &str, figure: f64, unit: &str, note: &str) {
    println!("{what:<62} {figure:>12.2} {unit:<10} {note}");
}

/// A figure that is at most so large.
pub(crate) fn at_most(what: &str, figure: f64, unit: &str, most: f64) {
    say(what, figure, unit, &judged(&format!("at most {most}"), figure <= most));
}

/// A field in kB of this process's status, in MB.
pub(crate) fn resident_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap_or("0");
    line.trim().trim_end_matches(" kB").trim().parse::<f64>().unwrap_or(0.0) / 1024.0
}

/// Processor time of all threads of this process, s.
fn processor_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = stat.rsplit(')').next().unwrap_or_default();
    let ticks = after.split_whitespace().skip(11).take(2).filter_map(|n| n.parse::<f64>().ok());
    ticks.sum::<f64>() / 100.0
}

/// Wall-clock and processor time since construction.
pub(crate) struct Meter {
    start: Instant,
    processor_s: f64,
}

impl Meter {
    #[allow(clippy::disallowed_methods, reason = "figures are of the wall clock")]
    pub(crate) fn start() -> Self {
        // The clock is read last: reading the processor time takes longer than some measurements.
        Self { processor_s: processor_s(), start: Instant::now() }
    }

    pub(crate) fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    pub(crate) fn processor_us(&self) -> f64 {
        (processor_s() - self.processor_s) * 1e6
    }

    /// Prints the rate and the processor time of each item. Returns the rate, 1/s.
    pub(crate) fn say(&self, what: &str, count: u64) -> f64 {
        self.rate(what, count, None)
    }

    /// A rate that is at least so large, 1/s.
    pub(crate) fn at_least(&self, what: &str, count: u64, least: f64) -> f64 {
        self.rate(what, count, Some(least))
    }

    fn rate(&self, what: &str, count: u64, least: Option<f64>) -> f64 {
        let rate = count as f64 / self.elapsed().as_secs_f64();
        let each_us = self.processor_us() / count as f64;
        let asked = least.map(|least| judged(&format!("at least {least}"), rate >= least));
        let asked = asked.map_or_else(String::new, |asked| format!("; {asked}"));
        println!("{what:<62} {rate:>12.0} {:<10} {each_us:>7.2} us of processors each{asked}", "/s");
        rate
    }
}
