//! What is due, and when: timers, armed watches, and the deadlines of cancelled skills.
//!
//! The agenda is pure: it has no clock, no task and no channel. All times are passed in and count from the run's
//! start. The driver of an engine passes each effect to [`Agenda::take`], calls [`Agenda::turned`] after each turn,
//! and reports new channel values with [`Agenda::published`]. It then passes the inputs from [`Agenda::due`] to the
//! engine until there are no more, and waits until [`Agenda::next`]. The executor and the stepper both work this
//! way, so that a chart behaves the same in both.
//!
//! Order at one instant: first stuck skills, then timers in their order, then watches in the file's order, and last
//! what arrives from outside at that instant.

mod edge;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use armarium_values::expr::Reads;

use crate::engine::{Circle, Effect, Engine, Input, RECORDED_BEFORE_BOUND, Sensors};
use crate::program::{Program, StateId};
use edge::Edge;

/// Sampling period of a condition that reads the age of a channel, while nothing is published.
const AGE_TICK: Duration = Duration::from_millis(20);
/// A run fails after this many firings and failures of watches without rest.
pub const MAX_FIRINGS: u32 = 1000;
/// A run fails after this many ends of skills at one instant.
pub const MAX_ENDS: u32 = 10_000;

/// See the module.
#[derive(Debug, Default)]
pub struct Agenda {
    /// Sorted by time, then by the engine's order, then by number.
    timers: BTreeSet<(Duration, u64, u64)>,
    timer_keys: BTreeMap<u64, (Duration, u64)>,
    /// Deadline by activation, after which a cancelled skill counts as stuck.
    graces: BTreeMap<u64, Duration>,
    armed: BTreeMap<u32, Armed>,
    /// How many armed watches read a channel.
    readers: BTreeMap<u32, usize>,
    /// Inputs from watches that the engine has not received yet.
    seen: VecDeque<Input>,
    firings: Repeats,
    /// Whether the watches never came to rest. The run then ends, and watches are not sampled any more.
    restless: bool,
    ends: Repeats,
    /// The instant that `ends` counts for.
    ends_at: Duration,
}

/// A watch that is being sampled.
#[derive(Debug)]
struct Armed {
    entry: u64,
    edge: Edge,
    hold: Duration,
    reads: Reads,
    /// Whether a value that it reads may have changed since the last sample.
    dirty: bool,
    failed: bool,
    blind: bool,
    next_tick: Option<Duration>,
}

/// Counts repeated occurrences without rest, with the states that they occur in.
#[derive(Debug, Default)]
struct Repeats {
    count: u32,
    circle: Circle,
}

impl Repeats {
    fn clear(&mut self) {
        self.count = 0;
        self.circle.clear();
    }

    /// Counts one occurrence in `state`. Returns the states' names once the count exceeds `most`.
    fn add(&mut self, state: StateId, most: u32, program: &Program) -> Option<String> {
        self.count += 1;
        if self.count + RECORDED_BEFORE_BOUND > most {
            self.circle.note(state);
        }
        (self.count > most).then(|| self.circle.names(program))
    }
}

impl Agenda {
    /// Whether a timer or the deadline of a cancelled skill is pending.
    pub fn has_timers(&self) -> bool {
        !(self.timers.is_empty() && self.graces.is_empty() && self.seen.is_empty())
    }

    /// Whether a watch is armed.
    pub fn has_watches(&self) -> bool {
        !self.armed.is_empty()
    }

    /// Registers an effect at `now`. Returns the effects that the driver has to carry out itself.
    #[must_use]
    pub fn take(&mut self, effect: Effect, program: &Program, now: Duration) -> Option<Effect> {
        match effect {
            Effect::StartTimer { timer, after, order } => {
                let at = now.saturating_add(after);
                self.timers.insert((at, order, timer));
                self.timer_keys.insert(timer, (at, order));
            }
            Effect::CancelTimer { timer } => {
                if let Some((at, order)) = self.timer_keys.remove(&timer) {
                    self.timers.remove(&(at, order, timer));
                }
            }
            Effect::ArmWatch { watch, entry } => self.arm(watch, entry, program),
            Effect::DisarmWatch { watch } => self.disarm(watch),
            Effect::Cancel { activation, grace } => {
                self.graces.entry(activation).or_insert(now.saturating_add(grace));
                return Some(effect);
            }
            other => return Some(other),
        }
        None
    }

    /// To be called after each turn of the engine: the chart's data and states may have changed.
    pub fn turned(&mut self) {
        self.armed.values_mut().filter(|a| a.reads.data).for_each(|a| a.dirty = true);
    }

    /// To be called when a channel has a new value.
    pub fn published(&mut self, channel: u32) {
        let readers = self.armed.values_mut().filter(|a| a.reads.channels.contains(&channel));
        readers.for_each(|a| a.dirty = true);
    }

    /// To be called when a skill has returned. Returns the input that fails the run when more than [`MAX_ENDS`]
    /// skills ended at this instant.
    pub fn ended(
        &mut self,
        activation: u64,
        state: StateId,
        program: &Program,
        now: Duration,
    ) -> Option<Input> {
        self.graces.remove(&activation);
        if now != self.ends_at {
            self.ends.clear();
            self.ends_at = now;
        }
        let states = self.ends.add(state, MAX_ENDS, program)?;
        Some(Input::Abort {
            reason: format!("{MAX_ENDS} skills ended without any time between them: {states}"),
        })
    }

    /// The state entry that a watch was armed in, if it is armed.
    pub fn armed(&self, watch: u32) -> Option<u64> {
        self.armed.get(&watch).map(|armed| armed.entry)
    }

    /// The channels that armed watches read, in order.
    pub fn channels(&self) -> impl Iterator<Item = u32> + Clone {
        self.readers.keys().copied()
    }

    /// When the next item may be due, if only time passes.
    pub fn next(&self) -> Option<Duration> {
        let timer = self.timers.first().map(|(at, ..)| *at);
        let grace = self.graces.values().min().copied();
        let watch = self.armed.values().filter_map(Armed::next).min();
        [timer, grace, watch].into_iter().flatten().min()
    }

    /// The next input for the engine at `now`. The driver calls this until it returns `None`.
    pub fn due(&mut self, engine: &Engine, sensors: &dyn Sensors, now: Duration) -> Option<Input> {
        if let Some(input) = self.seen.pop_front() {
            return Some(input);
        }
        if let Some(activation) = self.graces.iter().find(|(_, at)| **at <= now).map(|(a, _)| *a) {
            self.graces.remove(&activation);
            return Some(Input::SkillStuck { activation });
        }
        if let Some((.., timer)) = self.timers.first().copied().filter(|(at, ..)| *at <= now) {
            if let Some((at, order)) = self.timer_keys.remove(&timer) {
                self.timers.remove(&(at, order, timer));
            }
            return Some(Input::Timer { timer });
        }
        if !self.restless
            && let Some(states) = self.look(engine, sensors, now)
        {
            self.restless = true;
            let reason = format!("{MAX_FIRINGS} firings of watches without rest: {states}");
            return Some(Input::Abort { reason });
        }
        let input = self.seen.pop_front();
        if input.is_none() {
            self.firings.clear();
        }
        input
    }

    /// Samples all watches that may have changed. Returns the names of their states if they never come to rest.
    fn look(&mut self, engine: &Engine, sensors: &dyn Sensors, now: Duration) -> Option<String> {
        for (number, armed) in &mut self.armed {
            if !armed.dirty && armed.next().is_none_or(|at| at > now) {
                continue;
            }
            let before = self.seen.len();
            armed.look(*number, engine, sensors, now, &mut self.seen);
            let program = engine.program();
            for _ in before..self.seen.len() {
                let state = program.watches[*number as usize].state;
                if let Some(states) = self.firings.add(state, MAX_FIRINGS, program) {
                    self.seen.clear();
                    return Some(states);
                }
            }
        }
        None
    }

    fn arm(&mut self, number: u32, entry: u64, program: &Program) {
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
        reads.channels.iter().for_each(|channel| *self.readers.entry(*channel).or_default() += 1);
        let hold = Duration::try_from_secs_f64(watch.hold_s).unwrap_or(Duration::ZERO);
        let (edge, next_tick) = (Edge::default(), None);
        let armed = Armed { entry, edge, hold, reads, dirty: true, failed: false, blind: false, next_tick };
        self.armed.insert(number, armed);
    }

    fn disarm(&mut self, number: u32) {
        let Some(armed) = self.armed.remove(&number) else { return };
        for channel in &armed.reads.channels {
            if let Some(readers) = self.readers.get_mut(channel) {
                *readers -= 1;
            }
        }
        self.readers.retain(|_, readers| *readers > 0);
    }
}

impl Armed {
    /// When the next sample is due, even if nothing that the watch reads has changed.
    fn next(&self) -> Option<Duration> {
        [self.edge.deadline(self.hold), self.next_tick].into_iter().flatten().min()
    }

    /// Takes one sample and appends the resulting inputs for the engine.
    fn look(
        &mut self,
        watch: u32,
        engine: &Engine,
        sensors: &dyn Sensors,
        now: Duration,
        out: &mut VecDeque<Input>,
    ) {
        self.dirty = false;
        self.next_tick = self.reads.age.then(|| now.saturating_add(AGE_TICK));
        let entry = self.entry;
        let seen = engine.observe(watch, sensors);
        if let Some((message, place)) = seen.error
            && !std::mem::replace(&mut self.failed, true)
        {
            out.push_back(Input::WatchFailed { watch, entry, message, place });
        }
        if let Some((message, place)) = seen.blind
            && !std::mem::replace(&mut self.blind, true)
        {
            out.push_back(Input::WatchBlind { watch, message, place });
        }
        if self.edge.sample(now, seen.holds, seen.until, self.hold) {
            out.push_back(Input::Watch { watch, entry });
        }
    }
}

#[cfg(test)]
mod tests;
