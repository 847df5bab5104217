//! Watches: conditions over channels that become events. Only what is armed is looked at, and only the channels
//! that armed watches read are asked for.

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_values::expr::Reads;
use futures::future::select_all;
use tokio::sync::watch::Receiver;
use tokio::time::Instant;

use crate::channels::{Channels, Demand, Sample};
use crate::engine::{Engine, Input, Program, Sensors};

/// How often a condition that reads the age of a channel is looked at while nothing is published.
const AGE_TICK: Duration = Duration::from_millis(20);

/// One watch's memory: the hold, and whether it has fired and waits for its `until`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Edge {
    since: Option<Instant>,
    fired: bool,
}

impl Edge {
    /// One sample at `now`. Gives whether the watch fires: the condition has held for `hold`, it was false (or
    /// `until` was true) since it fired last; true at the first sample counts as a rise.
    pub(super) fn sample(&mut self, now: Instant, holds: bool, until: bool, hold: Duration) -> bool {
        if self.fired && until {
            (self.fired, self.since) = (false, None);
        }
        if !holds {
            self.since = None;
            return false;
        }
        let since = *self.since.get_or_insert(now);
        if self.fired || now.duration_since(since) < hold {
            return false;
        }
        self.fired = true;
        true
    }

    /// When the hold is over, if it runs.
    pub(super) fn deadline(&self, hold: Duration) -> Option<Instant> {
        self.since.filter(|_| !self.fired).map(|since| since + hold)
    }
}

#[derive(Debug)]
struct Armed {
    entry: u64,
    edge: Edge,
    hold: Duration,
    reads: Reads,
    dirty: bool,
    failed: bool,
    blind: bool,
    next_tick: Option<Instant>,
}

#[derive(Debug)]
struct Observed {
    readers: usize,
    receiver: Receiver<Option<Sample>>,
    _demand: Demand,
}

/// All watches that are armed now.
#[derive(Debug, Default)]
pub(super) struct Watching {
    armed: BTreeMap<u32, Armed>,
    observed: BTreeMap<u32, Observed>,
}

impl Watching {
    pub(super) fn arm(&mut self, number: u32, entry: u64, program: &Program, channels: &Channels) {
        self.disarm(number);
        let watch = &program.watches[number as usize];
        let mut reads = watch.condition.expr.reads().clone();
        if let Some(until) = &watch.until {
            let other = until.expr.reads();
            reads.channels.extend(&other.channels);
            reads.age |= other.age;
            reads.data |= other.data;
        }
        reads.channels.sort_unstable();
        reads.channels.dedup();
        for channel in &reads.channels {
            let name = &program.channels()[*channel as usize];
            let observed = self.observed.entry(*channel).or_insert_with(|| Observed {
                readers: 0,
                receiver: channels.subscribe(name),
                _demand: channels.demand(name),
            });
            observed.readers += 1;
        }
        let hold = Duration::try_from_secs_f64(watch.hold_s).unwrap_or(Duration::ZERO);
        let (edge, next_tick) = (Edge::default(), None);
        let armed = Armed { entry, edge, hold, reads, dirty: true, failed: false, blind: false, next_tick };
        self.armed.insert(number, armed);
    }

    pub(super) fn disarm(&mut self, number: u32) {
        let Some(armed) = self.armed.remove(&number) else { return };
        for channel in &armed.reads.channels {
            if let Some(observed) = self.observed.get_mut(channel) {
                observed.readers -= 1;
                if observed.readers == 0 {
                    self.observed.remove(channel);
                }
            }
        }
    }

    /// Whether a channel is read.
    pub(super) fn observes(&self) -> bool {
        !self.observed.is_empty()
    }

    /// Waits until a channel that is read has a new sample.
    pub(super) async fn changed(&mut self) {
        let waits = self.observed.values_mut().map(|observed| {
            Box::pin(async {
                if observed.receiver.changed().await.is_err() {
                    // The hub is kept alive by the demand; were it gone, nothing would be published any more.
                    std::future::pending::<()>().await;
                }
                observed.receiver.mark_changed();
            })
        });
        select_all(waits).await;
        let Self { armed, observed } = self;
        for (channel, observed) in observed {
            if observed.receiver.has_changed().unwrap_or(false) {
                observed.receiver.mark_unchanged();
                let readers = armed.values_mut().filter(|a| a.reads.channels.contains(channel));
                readers.for_each(|a| a.dirty = true);
            }
        }
    }

    /// The chart's data or states may have changed.
    pub(super) fn data_changed(&mut self) {
        self.armed.values_mut().filter(|a| a.reads.data).for_each(|a| a.dirty = true);
    }

    /// When a watch has to be looked at although nothing was published.
    pub(super) fn deadline(&self) -> Option<Instant> {
        let of =
            |armed: &Armed| [armed.edge.deadline(armed.hold), armed.next_tick].into_iter().flatten().min();
        self.armed.values().filter_map(of).min()
    }

    /// Time has passed.
    pub(super) fn time(&mut self, now: Instant) {
        for armed in self.armed.values_mut() {
            let due = |at: Option<Instant>| at.is_some_and(|at| at <= now);
            armed.dirty |= due(armed.edge.deadline(armed.hold)) || due(armed.next_tick);
        }
    }

    /// Looks at all watches that may have changed; gives what the engine is to be told, in the file's order.
    pub(super) fn sample(&mut self, engine: &Engine, sensors: &dyn Sensors, now: Instant) -> Vec<Input> {
        let mut inputs = Vec::new();
        for (number, armed) in self.armed.iter_mut().filter(|(_, a)| a.dirty) {
            armed.dirty = false;
            armed.next_tick = armed.reads.age.then(|| now + AGE_TICK);
            let (watch, entry) = (*number, armed.entry);
            let seen = engine.observe(watch, sensors);
            if let Some((message, place)) = seen.error
                && !std::mem::replace(&mut armed.failed, true)
            {
                inputs.push(Input::WatchFailed { watch, entry, message, place });
            }
            if let Some((message, place)) = seen.blind
                && !std::mem::replace(&mut armed.blind, true)
            {
                inputs.push(Input::WatchBlind { watch, message, place });
            }
            if armed.edge.sample(now, seen.holds, seen.until, armed.hold) {
                inputs.push(Input::Watch { watch, entry });
            }
        }
        inputs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn edges_rise_once_hold_and_wait_for_until() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
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

    #[tokio::test(start_paused = true)]
    async fn true_at_the_first_sample_is_a_rise() {
        let mut edge = Edge::default();
        assert!(edge.sample(Instant::now(), true, false, Duration::ZERO));
    }
}
