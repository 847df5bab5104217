//! A chart driven by hand under virtual time: no skill runs, no robot moves, nothing waits.
//!
//! A [`Stepper`] is told events, outcomes of skills, firings of watches, values of channels, and how much time goes by;
//! between them it shows what is active. Skills that are cancelled return at once. It is for looking at what a chart
//! means, for conformance tests and for measuring the engine; `exec` is what runs charts.

mod coverage;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;

use crate::engine::{Effect, Engine, EventId, Input, InputError, Program, RunResult, Sensors, StateId};
use crate::skill::{Failure, Outcome};
use crate::trace::TraceItem;

pub use coverage::{Coverage, Described};

/// How often a watch that reads the age of a channel is looked at while time goes by.
const AGE_TICK: Duration = Duration::from_millis(20);

/// Something that a stepper was told and cannot do; the chart has not moved.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum StepError {
    /// There is no such state.
    #[error("the chart has no state `{state}`{}", help.as_ref().map_or(String::new(), |h| format!("; {h}")))]
    State {
        /// The name or path.
        state: String,
        /// What might be meant.
        help: Option<String>,
    },
    /// The state is not active, or has neither a skill that runs nor such a watch.
    #[error("`{state}` has no skill that runs and no armed watch `{name}`: `{name}` is dropped")]
    NotExpected {
        /// The state.
        state: String,
        /// The outcome or watch.
        name: String,
    },
}

/// What is active, and what the chart knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The innermost active states, sorted: the bare name where it is unique in the chart, else the path. After the
    /// end of the run, those at its end.
    pub configuration: Vec<String>,
    /// All active states, likewise.
    pub states: Vec<String>,
    /// The locals of the outermost chart that have a value.
    pub locals: BTreeMap<String, Value>,
    /// Its outputs that have a value.
    pub outputs: BTreeMap<String, Value>,
}

/// A skill that runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunningSkill {
    /// Number of its start in the run.
    pub activation: u64,
    /// The state that runs it, as it is shown: its bare name where that is unique.
    pub state: String,
    /// The state's path.
    pub path: String,
    /// The skill's name.
    pub skill: String,
}

/// An event that went to another agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Sent {
    /// Its name.
    pub event: String,
    /// The agent, or `agent/Chart`.
    pub to: String,
    /// What came with it.
    pub data: Value,
}

/// An armed watch.
#[derive(Clone, Copy, Debug)]
struct Armed {
    entry: u64,
    since: Option<Duration>,
    fired: bool,
}

/// What channels hold: their values and when they were published.
#[derive(Debug, Default)]
struct Board {
    names: Vec<String>,
    values: BTreeMap<u32, (Value, Duration)>,
    now: Duration,
}

impl Sensors for Board {
    fn channel(&self, channel: u32, path: &[String]) -> Option<Value> {
        let (value, _) = self.values.get(&channel)?;
        path.iter().try_fold(value, |value, field| value.get(field)).cloned()
    }
    fn age(&self, channel: u32) -> Option<f64> {
        self.values.get(&channel).map(|(_, at)| self.now.saturating_sub(*at).as_secs_f64())
    }
}

/// A chart that is driven by hand.
#[derive(Debug)]
pub struct Stepper {
    engine: Engine,
    board: Board,
    /// By time, then the engine's order, then number.
    timers: BTreeSet<(Duration, u64, u64)>,
    timer_keys: BTreeMap<u64, (Duration, u64)>,
    skills: BTreeMap<StateId, u64>,
    watches: BTreeMap<u32, Armed>,
    /// How states are shown.
    labels: Vec<String>,
    /// States by their paths, and by how they are shown.
    by_path: BTreeMap<String, StateId>,
    logs: Vec<String>,
    sent: Vec<Sent>,
    coverage: Coverage,
    result: Option<RunResult>,
    effects: Vec<Effect>,
}

impl Stepper {
    /// A chart before its start. `given` overrides the profile's inputs, which override the defaults.
    ///
    /// # Errors
    /// [`InputError`] for an input or profile that does not exist, is missing or does not fit.
    pub fn new(
        program: Arc<Program>,
        given: &BTreeMap<String, Value>,
        profile: Option<&str>,
    ) -> Result<Self, InputError> {
        let board = Board { names: program.channels().to_vec(), ..Board::default() };
        let (labels, by_path) = labels(&program);
        Ok(Self {
            engine: Engine::new(program, given, profile)?,
            board,
            timers: BTreeSet::new(),
            timer_keys: BTreeMap::new(),
            skills: BTreeMap::new(),
            watches: BTreeMap::new(),
            labels,
            by_path,
            logs: Vec::new(),
            sent: Vec::new(),
            coverage: Coverage::default(),
            result: None,
            effects: Vec::new(),
        })
    }

    /// Nothing is told of what happens but what is active: for measuring.
    pub fn keep_quiet(&mut self) {
        self.engine.set_tracing(false);
    }

    /// Enters the chart's initial states.
    pub fn start(&mut self) {
        self.engine.start(&self.board, &mut self.effects);
        self.settle();
    }

    /// An event that all active states see.
    pub fn event(&mut self, name: &str, data: Value) {
        self.tell(Input::Event { name: name.to_owned(), data });
    }

    /// As [`Stepper::event`], for an event whose number is known (see [`Program::event`]).
    pub fn raise(&mut self, event: EventId, data: Value) {
        self.engine.raise(event, data, &self.board, &mut self.effects);
        self.settle();
    }

    /// A skill's outcome, or the firing of a watch, of a state that is given by its path or unique name. Data are the
    /// outputs, or `reason` with a failure.
    ///
    /// # Errors
    /// [`StepError`] when there is no such state, or nothing in it that could report this.
    pub fn report(&mut self, state: &str, name: &str, data: Value) -> Result<(), StepError> {
        let id = self.find(state)?;
        let input = if let Some(watch) = self.armed_watch(id, name) {
            let entry = self.watches[&watch].entry;
            Input::Watch { watch, entry }
        } else if let Some(activation) = self.skills.remove(&id) {
            Input::SkillEnded { activation, result: result(name, data) }
        } else {
            return Err(StepError::NotExpected { state: state.to_owned(), name: name.to_owned() });
        };
        self.tell(input);
        Ok(())
    }

    /// A value is published on a channel. Channels that no expression reads are ignored.
    pub fn publish(&mut self, channel: &str, value: Value) {
        if let Some(at) = self.board.names.iter().position(|n| n == channel) {
            let at = u32::try_from(at).unwrap_or(u32::MAX);
            self.board.values.insert(at, (value, self.board.now));
            self.look();
        }
    }

    /// Lets time go by: timers run out and watches hold.
    pub fn advance(&mut self, by: Duration) {
        let end = self.board.now.saturating_add(by);
        while let Some(at) = self.next_instant().filter(|at| *at <= end) {
            self.board.now = at.max(self.board.now);
            match self.timers.first().copied() {
                Some(key) if key.0 <= self.board.now => {
                    self.timers.remove(&key);
                    self.timer_keys.remove(&key.2);
                    self.tell(Input::Timer { timer: key.2 });
                }
                _ => self.look(),
            }
        }
        self.board.now = end;
        self.look();
    }

    /// Time since the start.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.board.now
    }

    /// How the run ended, once it has.
    #[must_use]
    pub fn result(&self) -> Option<&RunResult> {
        self.result.as_ref()
    }

    /// What the action `log` has said since this was asked last.
    pub fn take_logs(&mut self) -> Vec<String> {
        std::mem::take(&mut self.logs)
    }

    /// What was sent to other agents since this was asked last. They are not here, and are taken to have heard it.
    pub fn take_sent(&mut self) -> Vec<Sent> {
        std::mem::take(&mut self.sent)
    }

    /// The engine that is driven.
    #[must_use]
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// The innermost active states; after the end of the run, those at its end.
    #[must_use]
    pub fn leaves(&self) -> Vec<StateId> {
        if self.result.is_some() { self.engine.ended_in().to_vec() } else { self.engine.leaves() }
    }

    /// What is active, and what the chart knows.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let leaves = self.leaves();
        let program = self.engine.program();
        let shown = |state: &StateId| !program.is_root(*state);
        let all: BTreeSet<StateId> = leaves.iter().flat_map(|leaf| program.outward(*leaf)).collect();
        let label = |state: StateId| self.labels[state as usize].clone();
        let mut configuration: Vec<String> = leaves.into_iter().filter(shown).map(label).collect();
        let mut states: Vec<String> = all.into_iter().filter(shown).map(label).collect();
        configuration.sort();
        states.sort();
        Snapshot { configuration, states, locals: self.engine.locals(), outputs: self.engine.outputs() }
    }

    /// The transitions that were taken so far.
    #[must_use]
    pub fn coverage(&self) -> &Coverage {
        &self.coverage
    }

    /// The skills that run, in the chart's order.
    #[must_use]
    pub fn running(&self) -> Vec<RunningSkill> {
        let program = self.engine.program();
        let name = |state: StateId| match &program.state(state).kind {
            crate::engine::program::Kind::Skill { manifest } => manifest.name.clone(),
            _ => String::new(),
        };
        let one = |(state, activation): (&StateId, &u64)| RunningSkill {
            activation: *activation,
            state: self.labels[*state as usize].clone(),
            path: program.path(*state).to_owned(),
            skill: name(*state),
        };
        self.skills.iter().map(one).collect()
    }

    fn find(&self, state: &str) -> Result<StateId, StepError> {
        let by_label =
            || self.labels.iter().position(|l| l == state).and_then(|at| StateId::try_from(at).ok());
        self.by_path.get(state).copied().or_else(by_label).ok_or_else(|| StepError::State {
            state: state.to_owned(),
            help: crate::chart::suggest(state, self.labels.iter().map(String::as_str)),
        })
    }

    fn armed_watch(&self, state: StateId, name: &str) -> Option<u32> {
        let program = self.engine.program();
        let is = |watch: &&u32| {
            let watch = &program.watches[**watch as usize];
            watch.state == state && program.tables.symbols.name(watch.name) == name
        };
        self.watches.keys().find(is).copied()
    }

    fn tell(&mut self, input: Input) {
        self.engine.handle(input, &self.board, &mut self.effects);
        self.settle();
    }

    /// Does what the engine wants done, until nothing is left and no watch fires.
    fn settle(&mut self) {
        if !self.effects.is_empty() {
            self.apply();
        }
        if !self.watches.is_empty() {
            self.look();
        }
    }

    fn apply(&mut self) {
        while !self.effects.is_empty() {
            let mut inputs = Vec::new();
            for effect in std::mem::take(&mut self.effects) {
                inputs.extend(self.effect(effect));
            }
            for input in inputs {
                self.engine.handle(input, &self.board, &mut self.effects);
            }
        }
    }

    /// Does one thing. Gives what the engine is to be told at once.
    fn effect(&mut self, effect: Effect) -> Option<Input> {
        match effect {
            Effect::StartSkill { activation, state, .. } => {
                self.skills.insert(state, activation);
            }
            Effect::Cancel { activation, .. } => {
                self.skills.retain(|_, a| *a != activation);
                return Some(Input::SkillEnded { activation, result: Ok(Outcome::success()) });
            }
            Effect::StartTimer { timer, after, order } => {
                let at = self.board.now.saturating_add(after);
                self.timers.insert((at, order, timer));
                self.timer_keys.insert(timer, (at, order));
            }
            Effect::CancelTimer { timer } => {
                if let Some((at, order)) = self.timer_keys.remove(&timer) {
                    self.timers.remove(&(at, order, timer));
                }
            }
            Effect::ArmWatch { watch, entry } => {
                self.watches.insert(watch, Armed { entry, since: None, fired: false });
            }
            Effect::DisarmWatch { watch } => {
                self.watches.remove(&watch);
            }
            Effect::Send { event, to, data } => self.sent.push(Sent { event, to, data }),
            Effect::Trace(TraceItem::Log { text, .. }) => self.logs.push(text),
            Effect::Trace(item) => self.coverage.note(&item),
            Effect::Finished(result) => self.result = Some(result),
        }
        None
    }

    // Watches.

    /// When something happens next by itself: a timer runs out, or a watch may have held long enough. Time since the
    /// start.
    #[must_use]
    pub fn next_instant(&self) -> Option<Duration> {
        let timer = self.timers.first().map(|(at, ..)| *at);
        let program = self.engine.program();
        let watch = |(number, armed): (&u32, &Armed)| {
            let watch = &program.watches[*number as usize];
            let hold = Duration::try_from_secs_f64(watch.hold_s).unwrap_or(Duration::ZERO);
            let over = armed.since.filter(|_| !armed.fired).map(|since| since.saturating_add(hold));
            let ages = watch.condition.expr.reads().age;
            let ages = ages || watch.until.as_ref().is_some_and(|u| u.expr.reads().age);
            let tick = ages.then(|| self.board.now.saturating_add(AGE_TICK));
            over.filter(|at| *at > self.board.now).into_iter().chain(tick).min()
        };
        timer.into_iter().chain(self.watches.iter().filter_map(watch).min()).min()
    }

    /// Looks at all armed watches, until none fires.
    fn look(&mut self) {
        // Each watch fires at most once for one state of the channels: `until` has to come between.
        for _ in 0..=self.watches.len() {
            let fired =
                self.watches.keys().copied().collect::<Vec<_>>().into_iter().find_map(|w| self.sample(w));
            let Some(input) = fired else { return };
            self.engine.handle(input, &self.board, &mut self.effects);
            self.apply();
        }
    }

    fn sample(&mut self, watch: u32) -> Option<Input> {
        let seen = self.engine.observe(watch, &self.board);
        let hold_s = self.engine.program().watches[watch as usize].hold_s;
        let hold = Duration::try_from_secs_f64(hold_s).unwrap_or(Duration::ZERO);
        let (now, armed) = (self.board.now, self.watches.get_mut(&watch)?);
        if armed.fired && seen.until {
            (armed.fired, armed.since) = (false, None);
        }
        if !seen.holds {
            armed.since = None;
            return None;
        }
        let since = *armed.since.get_or_insert(now);
        if armed.fired || now.saturating_sub(since) < hold {
            return None;
        }
        armed.fired = true;
        Some(Input::Watch { watch, entry: armed.entry })
    }
}

/// A skill's result from its name and data.
fn result(name: &str, data: Value) -> crate::skill::SkillResult {
    if name == "failure" {
        let reason = data.get("reason").and_then(Value::as_str).unwrap_or("no reason was given");
        return Err(Failure::new(reason));
    }
    let outputs = match data {
        Value::Map(fields) => fields,
        _ => BTreeMap::new(),
    };
    Ok(Outcome { name: name.to_owned(), outputs })
}

/// How states are shown, by number; and states by path and by how they are shown.
fn labels(program: &Program) -> (Vec<String>, BTreeMap<String, StateId>) {
    let count = StateId::try_from(program.len()).unwrap_or(StateId::MAX);
    let own = |id: &StateId| !program.is_root(*id);
    let mut uses: BTreeMap<&str, u32> = BTreeMap::new();
    let bare = |id: StateId| program.path(id).rsplit('.').next().unwrap_or("");
    (0..count).filter(own).for_each(|id| *uses.entry(bare(id)).or_default() += 1);
    let label = |id: StateId| match uses.get(bare(id)) {
        Some(1) if own(&id) => bare(id).to_owned(),
        _ => program.path(id).to_owned(),
    };
    let mut by_path: BTreeMap<String, StateId> =
        (0..count).filter(own).map(|id| (program.path(id).to_owned(), id)).collect();
    for id in (0..count).filter(own) {
        by_path.entry(label(id)).or_insert(id);
    }
    ((0..count).map(label).collect(), by_path)
}
