//! What is due, and when: timers, armed watches, and the graces of cancelled skills.
//!
//! It is pure: it knows no clock, no task and no channel, only times since the run's start that are handed in. Whoever
//! drives an engine hands over each effect ([`Agenda::take`]) and each turn's end ([`Agenda::turned`]), says which
//! channels have new values ([`Agenda::published`]), tells the engine what is due until nothing is ([`Agenda::due`]), and
//! looks again at [`Agenda::next`]. The executor and the stepper are such drivers; so a chart means the same in both.
//!
//! Of what is due at one instant, stuck skills come first, then timers in their order, then watches in the file's.
//! All of it comes before what arrives at that instant from outside.

mod edge;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use armarium_values::expr::Reads;

use crate::engine::{Circle, Effect, Engine, Input, NEAR, Sensors};
use crate::program::{Program, StateId};
use edge::Edge;

/// How often a condition that reads the age of a channel is looked at while nothing is published.
const AGE_TICK: Duration = Duration::from_millis(20);
/// Firings and failures of watches without rest, after which a run fails.
pub const MAX_FIRINGS: u32 = 1000;
/// Ends of skills at one instant, after which a run fails.
pub const MAX_ENDS: u32 = 10_000;

/// See the module.
#[derive(Debug, Default)]
pub struct Agenda {
    /// By time, then the engine's order, then number.
    timers: BTreeSet<(Duration, u64, u64)>,
    timer_keys: BTreeMap<u64, (Duration, u64)>,
    /// When cancelled skills count as stuck, by activation.
    graces: BTreeMap<u64, Duration>,
    armed: BTreeMap<u32, Armed>,
    /// How many armed watches read a channel.
    readers: BTreeMap<u32, usize>,
    /// What watches have seen, still to be told.
    seen: VecDeque<Input>,
    firings: Repeats,
    /// Whether watches never came to rest: the run ends, and they are not looked at any more.
    restless: bool,
    ends: Repeats,
    /// When `ends` were counted.
    ends_at: Duration,
}

/// A watch that is observed.
#[derive(Debug)]
struct Armed {
    entry: u64,
    edge: Edge,
    hold: Duration,
    reads: Reads,
    /// Something that it reads may have changed.
    dirty: bool,
    failed: bool,
    blind: bool,
    next_tick: Option<Duration>,
}

/// Things that happen again and again without rest.
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

    /// Counts one more, in `state`. Gives the states' names once there are more than `most`.
    fn add(&mut self, state: StateId, most: u32, program: &Program) -> Option<String> {
        self.count += 1;
        if self.count + NEAR > most {
            self.circle.note(state);
        }
        (self.count > most).then(|| self.circle.names(program))
    }
}

impl Agenda {
    /// Whether nothing is waited for.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.timers.is_empty() && self.armed.is_empty() && self.seen.is_empty() && self.graces.is_empty()
    }

    /// Takes note of an effect at `now`. Gives back what the driver has to do itself.
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

    /// The engine has had a turn: the chart's data and states may have changed.
    pub fn turned(&mut self) {
        self.armed.values_mut().filter(|a| a.reads.data).for_each(|a| a.dirty = true);
    }

    /// A channel has a new value.
    pub fn published(&mut self, channel: u32) {
        let readers = self.armed.values_mut().filter(|a| a.reads.channels.contains(&channel));
        readers.for_each(|a| a.dirty = true);
    }

    /// A skill has returned. Gives what the engine is to be told instead where skills end again and again without any
    /// time going by.
    #[must_use]
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

    /// The entry that a watch is armed with.
    #[must_use]
    pub fn armed(&self, watch: u32) -> Option<u64> {
        self.armed.get(&watch).map(|armed| armed.entry)
    }

    /// The channels that armed watches read, in order.
    pub fn channels(&self) -> impl Iterator<Item = u32> + Clone {
        self.readers.keys().copied()
    }

    /// When something may be due next, if time alone passes.
    #[must_use]
    pub fn next(&self) -> Option<Duration> {
        let timer = self.timers.first().map(|(at, ..)| *at);
        let grace = self.graces.values().min().copied();
        let watch = self.armed.values().filter_map(Armed::next).min();
        [timer, grace, watch].into_iter().flatten().min()
    }

    /// What the engine is to be told next at `now`; the driver tells it, and asks again until there is nothing.
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

    /// Looks at all watches that may have changed. Gives the names of their states where they never rest.
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
    /// When it has to be looked at although nothing that it reads has changed.
    fn next(&self) -> Option<Duration> {
        [self.edge.deadline(self.hold), self.next_tick].into_iter().flatten().min()
    }

    /// One sample; adds what the engine is to be told.
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
