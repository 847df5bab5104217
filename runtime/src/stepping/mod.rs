//! A chart driven by hand under virtual time: no skill runs, no robot moves, nothing waits.
//!
//! A [`Stepper`] is told events, outcomes of skills, firings of watches, values of channels, and how much time goes by;
//! between them it shows what is active. Skills that are cancelled return at once. It is for looking at what a chart
//! means, for conformance tests and for measuring the engine; `exec` is what runs charts. Both are driven by one `agenda`, so that
//! a chart does here what it does there.

mod coverage;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use armarium_source::suggest;
use armarium_values::Value;

use crate::agenda::Agenda;
use crate::engine::{Effect, Engine, Input, RunResult, Sensors};
use crate::program::{EventId, Kind, Program, StateId};
use crate::skill::{Failure, InputError, Outcome};
use crate::trace::TraceItem;

pub use coverage::{Coverage, Described};

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
    agenda: Agenda,
    skills: BTreeMap<StateId, u64>,
    /// Skills that were cancelled and are about to return.
    returning: VecDeque<(StateId, u64)>,
    /// How states are shown.
    labels: Vec<String>,
    /// States by their paths, and by how they are shown.
    by_path: BTreeMap<String, StateId>,
    logs: Vec<String>,
    sent: Vec<Sent>,
    coverage: Coverage,
    result: Option<RunResult>,
    effects: Vec<Effect>,
    /// Everything that was traced, with its time.
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
        let board = Board { names: program.channels().to_vec(), ..Board::default() };
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

    /// Nothing is told of what happens but what is active: for measuring.
    pub fn keep_quiet(&mut self) {
        self.engine.set_tracing(false);
    }

    /// Enters the chart's initial states.
    pub fn start(&mut self) {
        self.engine.start(&self.board, &mut self.effects);
        self.turned();
        self.settle();
    }

    /// An event that all active states see.
    pub fn event(&mut self, name: &str, data: Value) {
        self.tell(Input::Event { name: name.to_owned(), data });
    }

    /// As [`Stepper::event`], for an event whose number is known (see [`Program::event`]).
    pub fn raise(&mut self, event: EventId, data: Value) {
        self.engine.raise(event, data, &self.board, &mut self.effects);
        self.turned();
        self.settle();
    }

    /// A skill's outcome, or the firing of a watch, of a state that is given by its path or unique name. Data are the
    /// outputs, or `reason` with a failure.
    ///
    /// # Errors
    /// [`StepError`] when there is no such state, or nothing in it that could report this.
    pub fn report(&mut self, state: &str, name: &str, data: Value) -> Result<(), StepError> {
        let id = self.find(state)?;
        let input = if let Some((watch, entry)) = self.armed_watch(id, name) {
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
            self.agenda.published(at);
            self.settle();
        }
    }

    /// Lets time go by: timers run out and watches hold.
    pub fn advance(&mut self, by: Duration) {
        let end = self.board.now.saturating_add(by);
        while let Some(at) = self.next_instant().filter(|at| *at <= end) {
            self.board.now = at.max(self.board.now);
            self.settle();
        }
        self.board.now = end;
        self.settle();
    }

    /// When something happens next by itself: a timer runs out, or a watch may have held long enough. Time since the
    /// start.
    #[must_use]
    pub fn next_instant(&self) -> Option<Duration> {
        self.agenda.next()
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
            help: suggest(state, self.labels.iter().map(String::as_str)),
        })
    }

    /// The armed watch of that name, and the entry that it is armed with.
    fn armed_watch(&self, state: StateId, name: &str) -> Option<(u32, u64)> {
        let program = self.engine.program();
        let mut watches = program.state(state).watches.iter().copied();
        let named = |watch: &u32| program.symbols.name(program.watches[*watch as usize].name) == name;
        let watch = watches.find(named)?;
        Some((watch, self.agenda.armed(watch)?))
    }

    fn tell(&mut self, input: Input) {
        self.turn(input);
        self.settle();
    }

    fn turn(&mut self, input: Input) {
        self.engine.handle(input, &self.board, &mut self.effects);
        self.turned();
    }

    /// Does what the engine wants done after a turn.
    fn turned(&mut self) {
        if !self.effects.is_empty() {
            for effect in std::mem::take(&mut self.effects) {
                self.act(effect);
            }
        }
        self.agenda.turned();
    }

    /// Tells the engine what is due, until there is nothing; then cancelled skills return, one after the other.
    fn settle(&mut self) {
        while !self.agenda.is_empty() || !self.returning.is_empty() {
            if let Some(input) = self.agenda.due(&self.engine, &self.board, self.board.now) {
                self.turn(input);
                continue;
            }
            let Some((state, activation)) = self.returning.pop_front() else { return };
            let restless = self.agenda.ended(activation, state, self.engine.program(), self.board.now);
            self.turn(Input::SkillEnded { activation, result: Ok(Outcome::success()) });
            if let Some(restless) = restless {
                self.turn(restless);
            }
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
