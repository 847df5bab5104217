//! A chart driven by hand under virtual time: no skill runs, no robot moves, nothing waits.
//!
//! The caller of a [`Stepper`] gives it events, outcomes of skills, firings of watches, values of channels, and the
//! time that passes. In between, it shows what is active. Cancelled skills return at once. It serves to explore a
//! chart, for conformance tests and for measuring the engine; `exec` runs charts with real skills. Both use the
//! same `agenda`, so that a chart behaves the same.

mod coverage;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use armarium_source::suggest;
use armarium_values::Value;

use crate::agenda::Agenda;
use crate::engine::{Effect, Engine, Input, RunResult, Sensors};
use crate::observed::told;
use crate::program::{ChannelSource, EventId, Kind, Program, StateId};
use crate::skill::{Failure, InputError, Outcome, SkillManifest, SkillResult};
use crate::trace::TraceItem;

pub use coverage::{Coverage, Described};

/// A call that the stepper cannot carry out; the chart is unchanged.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum StepError {
    /// There is no state of this name or path; `help` is a similar name.
    #[error("the chart has no state `{state}`{}", help.as_ref().map_or(String::new(), |h| format!("; {h}")))]
    State { state: String, help: Option<String> },
    /// The state is not active, or has neither a running skill nor a watch of that name.
    #[error("`{state}` has no skill that runs and no armed watch `{name}`: `{name}` is dropped")]
    NotExpected { state: String, name: String },
}

/// The active states and the chart's data.
#[derive(Clone, Debug, PartialEq)]
pub struct StepperState {
    /// The innermost active states, sorted. Each is given by its bare name if that is unique in the chart, else by
    /// its path. After the end of the run: those at its end.
    pub configuration: Vec<String>,
    /// All active states, in the same form.
    pub states: Vec<String>,
    /// The locals of the outermost chart that have a value.
    pub locals: BTreeMap<String, Value>,
    /// Its outputs that have a value.
    pub outputs: BTreeMap<String, Value>,
}

/// A running skill.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunningSkill {
    /// Number of its start in the run.
    pub activation: u64,
    /// The state that runs it, as displayed: its bare name if that is unique.
    pub state: String,
    /// The state's path.
    pub path: String,
    /// The skill's name.
    pub skill: String,
}

/// An event that was sent to another agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Sent {
    /// Its name.
    pub event: String,
    /// The agent, or `agent/Chart`.
    pub to: String,
    /// Its data.
    pub data: Value,
}

/// The newest values of channels, when they were published, and how old they were then.
#[derive(Debug, Default)]
struct ChannelValues {
    names: Vec<String>,
    values: BTreeMap<u32, (Value, Duration, Duration)>,
    now: Duration,
}

impl ChannelValues {
    /// Replaces the value of a channel; without one, what it held is gone, and its age goes on. Returns the channel's number, if an
    /// expression reads it.
    fn replace(&mut self, name: &str, sample: Option<(Value, Duration)>) -> Option<u32> {
        let at = self.names.iter().position(|n| n == name).and_then(|at| u32::try_from(at).ok())?;
        match sample {
            Some((value, age)) => drop(self.values.insert(at, (value, self.now, age))),
            None => self.values.get_mut(&at).into_iter().for_each(|(value, ..)| *value = Value::Null),
        }
        Some(at)
    }
}

impl Sensors for ChannelValues {
    fn channel(&self, channel: u32, path: &[String]) -> Option<Value> {
        self.values.get(&channel)?.0.at(path)
    }
    fn age(&self, channel: u32) -> Option<f64> {
        let (_, at, age) = self.values.get(&channel)?;
        Some(self.now.saturating_sub(*at).saturating_add(*age).as_secs_f64())
    }
}

/// A chart that is driven by hand.
#[derive(Debug)]
pub struct Stepper {
    engine: Engine,
    board: ChannelValues,
    agenda: Agenda,
    skills: BTreeMap<StateId, u64>,
    /// Skills that were cancelled and return next.
    returning: VecDeque<(StateId, u64)>,
    /// The displayed name of each state.
    labels: Vec<String>,
    /// States by path and by displayed name.
    by_path: BTreeMap<String, StateId>,
    logs: Vec<String>,
    sent: Vec<Sent>,
    coverage: Coverage,
    result: Option<RunResult>,
    effects: Vec<Effect>,
    /// The whole trace, with times.
    #[cfg(test)]
    pub(crate) trace: Vec<crate::trace::TraceEvent>,
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
        let mut board = ChannelValues { names: program.channels().to_vec(), ..ChannelValues::default() };
        // Memory knows nothing yet.
        for observed in program.observed() {
            let nothing = Value::List(Vec::new());
            board.replace(&observed.pattern.channel(true), Some((nothing, Duration::ZERO)));
        }
        let (labels, by_path) = labels(&program);
        Ok(Self {
            engine: Engine::new(program, given, profile)?,
            board,
            agenda: Agenda::default(),
            skills: BTreeMap::new(),
            returning: VecDeque::new(),
            labels,
            by_path,
            logs: Vec::new(),
            sent: Vec::new(),
            coverage: Coverage::default(),
            result: None,
            effects: Vec::new(),
            #[cfg(test)]
            trace: Vec::new(),
        })
    }

    /// Turns the trace off, for measuring. The active states can still be read.
    pub fn keep_quiet(&mut self) {
        self.engine.set_tracing(false);
    }

    /// Enters the chart's initial states.
    pub fn start(&mut self) {
        self.engine.start(&self.board, &mut self.effects);
        self.turned();
        self.settle();
    }

    /// Raises an event that all active states see.
    pub fn event(&mut self, name: &str, data: Value) {
        self.turn(Input::Event { name: name.to_owned(), data });
        self.settle();
    }

    /// As [`Stepper::event`], for an event whose number is known (see [`Program::event`]).
    pub fn raise(&mut self, event: EventId, data: Value) {
        self.engine.raise(event, data, &self.board, &mut self.effects);
        self.turned();
        self.settle();
    }

    /// Raises the events of a list again and again, for measuring.
    pub fn repeat(&mut self, events: &[(EventId, Value)], times: u64) {
        for _ in 0..times {
            for (event, data) in events {
                self.raise(*event, data.clone());
            }
        }
    }

    /// Reports a skill's outcome or the firing of a watch, for a state given by its path or unique name. `data` are
    /// the outputs, or a map with `reason` for a failure.
    ///
    /// # Errors
    /// [`StepError`] when there is no such state, or when it has no such skill or watch.
    pub fn report(&mut self, state: &str, name: &str, data: Value) -> Result<(), StepError> {
        let id = self.find(state)?;
        if let Some((watch, entry)) = self.armed_watch(id, name) {
            self.turn(Input::Watch { watch, entry });
        } else if let Some(activation) = self.skills.remove(&id) {
            self.ended(id, activation, result(name, data));
        } else {
            return Err(StepError::NotExpected { state: state.to_owned(), name: name.to_owned() });
        }
        self.settle();
        Ok(())
    }

    /// Publishes a value on a channel; what the chart observes of memory is given by the name that the chart uses, that of a chart
    /// inside it as `Chart.name`. The value is then `age` old. Channels that no expression reads are ignored.
    pub fn publish(&mut self, channel: &str, value: Value, age: Duration) {
        let program = Arc::clone(self.engine.program());
        let samples = match program.named_channels.get(channel).map(|named| &named.source) {
            Some(ChannelSource::Memory { pattern, all }) => {
                let (best, matches) = told(pattern, value, *all);
                vec![
                    (pattern.channel(false), best.map(|best| (best, age))),
                    (pattern.channel(true), Some((Value::List(matches), age))),
                ]
            }
            Some(ChannelSource::Published(name)) => vec![(name.clone(), Some((value, age)))],
            None => Vec::new(),
        };
        for (name, sample) in samples {
            if let Some(at) = self.board.replace(&name, sample) {
                self.agenda.published(at);
            }
        }
        self.settle();
    }

    /// Advances the time: timers expire and watches hold.
    pub fn advance(&mut self, by: Duration) {
        let end = self.board.now.saturating_add(by);
        while let Some(at) = self.next_instant().filter(|at| *at <= end) {
            self.board.now = at.max(self.board.now);
            self.settle();
        }
        self.board.now = end;
        self.settle();
    }

    /// When something happens next by itself, as time since the start: a timer expires, or a watch may have held
    /// long enough.
    pub fn next_instant(&self) -> Option<Duration> {
        self.agenda.next()
    }

    /// Time since the start.
    pub fn now(&self) -> Duration {
        self.board.now
    }

    /// How the run ended, once it has.
    pub fn result(&self) -> Option<&RunResult> {
        self.result.as_ref()
    }

    /// The output of the action `log` since the last call.
    pub fn take_logs(&mut self) -> Vec<String> {
        std::mem::take(&mut self.logs)
    }

    /// The events sent to other agents since the last call. The stepper has no other agents and treats all events
    /// as delivered.
    pub fn take_sent(&mut self) -> Vec<Sent> {
        std::mem::take(&mut self.sent)
    }

    /// What the running skill declares.
    pub(crate) fn manifest_of(&self, running: &RunningSkill) -> Option<&SkillManifest> {
        match &self.engine.program().state(*self.by_path.get(&running.path)?).kind {
            Kind::Skill { manifest } => Some(manifest),
            _ => None,
        }
    }

    /// The engine that is driven.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// The innermost active states; after the end of the run, those at its end.
    pub fn leaves(&self) -> Vec<StateId> {
        if self.result.is_some() { self.engine.ended_in().to_vec() } else { self.engine.leaves() }
    }

    /// The active states and the chart's data.
    pub fn snapshot(&self) -> StepperState {
        let leaves = self.leaves();
        let program = self.engine.program();
        let shown = |state: &StateId| !program.is_root(*state);
        let all: BTreeSet<StateId> = leaves.iter().flat_map(|leaf| program.outward(*leaf)).collect();
        let label = |state: StateId| self.labels[state as usize].clone();
        let mut configuration: Vec<String> = leaves.into_iter().filter(shown).map(label).collect();
        let mut states: Vec<String> = all.into_iter().filter(shown).map(label).collect();
        configuration.sort();
        states.sort();
        StepperState { configuration, states, locals: self.engine.locals(), outputs: self.engine.outputs() }
    }

    /// The transitions that were taken so far.
    pub fn coverage(&self) -> &Coverage {
        &self.coverage
    }

    /// The running skills, in the chart's order.
    pub fn running(&self) -> Vec<RunningSkill> {
        let program = self.engine.program();
        let name = |state: StateId| match &program.state(state).kind {
            Kind::Skill { manifest } => manifest.name.clone(),
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
            help: suggest(state, self.by_path.keys().map(String::as_str)),
        })
    }

    /// The armed watch of that name, and the state entry that it was armed in.
    fn armed_watch(&self, state: StateId, name: &str) -> Option<(u32, u64)> {
        let program = self.engine.program();
        let mut watches = program.state(state).watches.iter().copied();
        let named = |watch: &u32| program.event_names.name(program.watches[*watch as usize].name) == name;
        let watch = watches.find(named)?;
        Some((watch, self.agenda.armed(watch)?))
    }

    fn turn(&mut self, input: Input) {
        self.engine.handle(input, &self.board, &mut self.effects);
        self.turned();
    }

    /// Carries out the engine's effects after a turn.
    fn turned(&mut self) {
        if !self.effects.is_empty() {
            for effect in std::mem::take(&mut self.effects) {
                self.act(effect);
            }
        }
        self.agenda.turned();
    }

    /// Passes what is due to the engine until nothing is left. Then cancelled skills return, one after the other.
    fn settle(&mut self) {
        loop {
            if let Some(input) = self.agenda.due(&self.engine, &self.board, self.board.now) {
                self.turn(input);
                continue;
            }
            let Some((state, activation)) = self.returning.pop_front() else { return };
            self.ended(state, activation, Ok(Outcome::success()));
        }
    }

    /// A skill has returned.
    fn ended(&mut self, state: StateId, activation: u64, result: SkillResult) {
        let restless = self.agenda.ended(activation, state, self.engine.program(), self.board.now);
        self.turn(Input::SkillEnded { activation, result });
        if let Some(restless) = restless {
            self.turn(restless);
        }
    }

    fn act(&mut self, effect: Effect) {
        #[cfg(test)]
        if let Effect::Trace(item) = &effect {
            let at_ns = u64::try_from(self.board.now.as_nanos()).unwrap_or(u64::MAX);
            self.trace.push(crate::trace::TraceEvent { at_ns, item: item.clone() });
        }
        match self.agenda.take(effect, self.engine.program(), self.board.now) {
            Some(Effect::StartSkill { activation, state, .. }) => {
                self.skills.insert(state, activation);
            }
            Some(Effect::Cancel { activation, .. }) => {
                let state = self.skills.iter().find(|(_, a)| **a == activation).map(|(state, _)| *state);
                if let Some(state) = state {
                    self.skills.remove(&state);
                    self.returning.push_back((state, activation));
                }
            }
            Some(Effect::Send { event, to, data }) => self.sent.push(Sent { event, to, data }),
            Some(Effect::Trace(TraceItem::Log { text, .. })) => self.logs.push(text),
            Some(Effect::Trace(item)) => self.coverage.note(&item),
            Some(Effect::Finished(result)) => self.result = Some(result),
            Some(
                Effect::StartTimer { .. }
                | Effect::CancelTimer { .. }
                | Effect::ArmWatch { .. }
                | Effect::DisarmWatch { .. },
            )
            | None => {}
        }
    }
}

/// A skill's result from its name and data.
fn result(name: &str, data: Value) -> SkillResult {
    if name == "failure" {
        let reason = data.get("reason").and_then(Value::as_str).unwrap_or("it was reported as a failure");
        return Err(Failure::new(reason));
    }
    let outputs = match data {
        Value::Map(fields) => fields,
        _ => BTreeMap::new(),
    };
    Ok(Outcome { name: name.to_owned(), outputs })
}

/// The displayed name of each state, by number; and states by path and by displayed name.
pub(crate) fn labels(program: &Program) -> (Vec<String>, BTreeMap<String, StateId>) {
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
