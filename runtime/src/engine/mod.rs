//! The interpreter: a function from (state, input) to (state, effects). It knows no clock, no randomness, no task.
//!
//! The algorithm is SCXML's (appendix D) with one difference: leaving is orderly. A transition first cancels the
//! skills of all states that are left and waits until they have returned; only then exit actions, transition
//! actions and entries run. Start reading at [`Engine::handle`], then `select`, `step`, `act`.

mod act;
mod end;
mod enter;
mod interface;
mod select;
mod step;

pub(crate) mod program;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use armarium_values::Value;
use armarium_values::expr::World;

pub use interface::{Effect, Input, InputError, NoSensors, Observation, RunResult, Sensors};
pub use program::{Program, StateId};

use crate::skill::SkillResult;
use crate::trace::TraceItem;

/// Microsteps without rest after which a run fails.
pub const MAX_MICROSTEPS: u32 = 1000;
/// Events that may wait while states are left; more are dropped, and seen in the trace.
pub const MAX_QUEUE: usize = 1024;
/// Events that unbreakable states may hold back.
pub const MAX_HELD: usize = 64;

/// What an event is, beyond its name.
#[derive(Clone, Debug, PartialEq)]
enum Origin {
    /// All active states see it.
    Broadcast,
    /// An expression failed in this state.
    Error(StateId),
    /// The state reported its outcome; `region_end` when it is a region that came to a final state of its own.
    Outcome { state: StateId, entry: u64, region_end: bool },
    /// A watch of the state fired.
    Watch { state: StateId, entry: u64 },
    /// A timer of the state ran out; it takes this transition only.
    After { state: StateId, entry: u64, transition: u32 },
    /// The state's wait before its next try is over.
    Retry { state: StateId, entry: u64 },
}

#[derive(Clone, Debug)]
struct Event {
    name: Arc<str>,
    data: Value,
    origin: Origin,
}

impl Event {
    fn scope(&self) -> Option<(StateId, u64)> {
        match self.origin {
            Origin::Broadcast | Origin::Error(_) => None,
            Origin::Outcome { state, entry, .. }
            | Origin::Watch { state, entry }
            | Origin::Retry { state, entry }
            | Origin::After { state, entry, .. } => Some((state, entry)),
        }
    }

    fn is_failure(&self) -> bool {
        matches!(self.origin, Origin::Outcome { .. }) && &*self.name == "failure"
    }

    fn is_error(&self) -> bool {
        self.name.starts_with("error.")
    }
}

/// What a state's skill is doing.
#[derive(Clone, Debug, Default, PartialEq)]
enum SkillRun {
    #[default]
    None,
    /// Entered; starts when the macrostep is over.
    Ready(BTreeMap<String, Value>),
    Running(u64),
    Cancelling(u64),
}

/// What a state is doing; reset when it is entered.
#[derive(Clone, Debug, Default)]
struct Run {
    active: bool,
    /// Counts entries of all states: tells one stay in a state from another.
    entry: u64,
    skill: SkillRun,
    /// Its outcome, once nobody handled it.
    done: Option<Arc<str>>,
    /// Whether it has reported its outcome, for unbreakable states.
    ended: bool,
    retries: u32,
    /// Waits before it is tried again; nothing inside it is active.
    waiting: bool,
    timers: Vec<u64>,
    /// What the transition that entered it gave, for further tries.
    given: BTreeMap<String, Value>,
    /// For a parallel state: the first outcome of a region that is not success.
    first_other: Option<(Arc<str>, Value)>,
}

#[derive(Clone, Debug)]
enum TimerUse {
    After { state: StateId, entry: u64, transition: u32 },
    Retry { state: StateId, entry: u64 },
    Send { id: Option<String>, event: Event },
}

/// What a microstep does once all skills that it leaves have returned.
#[derive(Clone, Debug)]
enum Step {
    Take(Vec<u32>),
    /// Try the inside of a state again.
    Restart(StateId),
    Finish {
        outcome: String,
        reason: Option<String>,
        chain: Vec<String>,
    },
}

#[derive(Clone, Debug)]
struct Pending {
    step: Step,
    event: Option<Event>,
    /// States to leave, in the file's order.
    exits: Vec<StateId>,
    /// Skills that have not returned yet.
    waiting: BTreeSet<u64>,
}

/// The variables of a run, which expressions read.
#[derive(Debug, Default)]
struct Store {
    data: Vec<Option<Value>>,
    event: Option<Event>,
}

/// One run of a chart.
#[derive(Debug)]
pub struct Engine {
    program: Arc<Program>,
    store: Store,
    runs: Vec<Run>,
    /// Active states, in the file's order.
    configuration: Vec<StateId>,
    /// What histories remember.
    remembered: BTreeMap<StateId, Vec<StateId>>,
    internal: VecDeque<Event>,
    external: VecDeque<Event>,
    held: VecDeque<Event>,
    timers: BTreeMap<u64, TimerUse>,
    /// The states of skills that run.
    skills: BTreeMap<u64, StateId>,
    pending: Option<Pending>,
    ready: BTreeSet<StateId>,
    next: u64,
    microsteps: u32,
    /// The newest failure, for finals that do not say why.
    last_failure: Option<(Value, StateId)>,
    shown: Vec<StateId>,
    finished: bool,
}

/// The engine's variables, states and sensors together, as expressions see them.
struct View<'v> {
    store: &'v Store,
    runs: &'v [Run],
    sensors: &'v dyn Sensors,
}

impl World for View<'_> {
    fn data(&self, slot: u32) -> Option<&Value> {
        self.store.data.get(slot as usize)?.as_ref()
    }
    fn channel(&self, channel: u32, path: &[String]) -> Option<Value> {
        self.sensors.channel(channel, path)
    }
    fn age(&self, channel: u32) -> Option<f64> {
        self.sensors.age(channel)
    }
    fn event_name(&self) -> Option<&str> {
        self.store.event.as_ref().map(|e| &*e.name)
    }
    fn event_data(&self) -> Option<&Value> {
        self.store.event.as_ref().map(|e| &e.data)
    }
    fn active(&self, state: u32) -> bool {
        self.runs.get(state as usize).is_some_and(|r| r.active)
    }
}

/// What one call works with.
struct Turn<'t> {
    sensors: &'t dyn Sensors,
    out: &'t mut Vec<Effect>,
}

impl Turn<'_> {
    fn trace(&mut self, item: TraceItem) {
        self.out.push(Effect::Trace(item));
    }
}

impl Engine {
    /// A run that has not begun. `given` overrides the profile's inputs, which override the defaults.
    ///
    /// # Errors
    /// [`InputError`] for an input or profile that does not exist, is missing or does not fit.
    pub fn new(
        program: Arc<Program>,
        given: &BTreeMap<String, Value>,
        profile: Option<&str>,
    ) -> Result<Self, InputError> {
        let inputs = inputs(&program, given, profile)?;
        let mut data = vec![None; program.slots as usize];
        for (variable, value) in program.instances[0].inputs.iter().zip(inputs) {
            data[variable.slot as usize] = Some(value);
        }
        let runs = vec![Run::default(); program.states.len()];
        Ok(Self {
            program,
            store: Store { data, event: None },
            runs,
            configuration: Vec::new(),
            remembered: BTreeMap::new(),
            internal: VecDeque::new(),
            external: VecDeque::new(),
            held: VecDeque::new(),
            timers: BTreeMap::new(),
            skills: BTreeMap::new(),
            pending: None,
            ready: BTreeSet::new(),
            next: 1,
            microsteps: 0,
            last_failure: None,
            shown: Vec::new(),
            finished: false,
        })
    }

    /// Enters the chart's initial states.
    pub fn start(&mut self, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        let mut turn = Turn { sensors, out };
        let chart = self.program.name.clone();
        turn.trace(TraceItem::Started { chart, inputs: self.variables_of(0, |i| &i.inputs) });
        self.enter_run(&mut turn);
        self.run(&mut turn);
    }

    /// Takes one input, runs to completion, and appends what is to be done to `out`.
    pub fn handle(&mut self, input: Input, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        if self.finished {
            return;
        }
        let mut turn = Turn { sensors, out };
        match input {
            Input::SkillEnded { activation, result } => self.skill_ended(activation, result, &mut turn),
            Input::SkillStuck { activation } => self.skill_stuck(activation, &mut turn),
            Input::Event { name, data } => {
                self.queue(Event { name: name.into(), data, origin: Origin::Broadcast }, &mut turn);
            }
            Input::Timer { timer } => self.timer(timer, &mut turn),
            Input::Watch { watch, entry } => {
                let watch = &self.program.watches[watch as usize];
                let origin = Origin::Watch { state: watch.state, entry };
                let event = Event { name: Arc::clone(&watch.name), data: Value::Null, origin };
                self.queue(event, &mut turn);
            }
            Input::WatchFailed { watch, entry, message, place } => {
                let state = self.program.watches[watch as usize].state;
                if self.runs[state as usize].entry == entry {
                    self.error_at(state, &message, place, &mut turn);
                }
            }
            Input::Stop { reason } => self.stop("stopped", reason, &mut turn),
            Input::Abort { reason } => self.stop("failure", reason, &mut turn),
        }
        self.run(&mut turn);
    }

    /// Whether the condition of a watch holds now, and whether its `until` (or the condition's end) does.
    pub fn observe(&self, watch: u32, sensors: &dyn Sensors) -> Observation {
        let watch = &self.program.watches[watch as usize];
        let view = View { store: &self.store, runs: &self.runs, sensors };
        let place = |code: &program::Code, message: String| (message, self.program.place(code.place));
        let mut error = None;
        let mut look = |code: &program::Code| {
            code.expr.observe(&view).unwrap_or_else(|e| {
                error = Some(place(code, e.message));
                false
            })
        };
        let holds = look(&watch.condition);
        let until = watch.until.as_ref().map_or(!holds, &mut look);
        Observation { holds, until, error }
    }

    /// The program that runs.
    #[must_use]
    pub fn program(&self) -> &Arc<Program> {
        &self.program
    }

    /// The innermost active states, in the file's order.
    #[must_use]
    pub fn leaves(&self) -> Vec<StateId> {
        let last = |i: usize| self.program.state(self.configuration[i]).last;
        let inner = |i: usize| self.configuration.get(i + 1).is_none_or(|next| *next > last(i));
        (0..self.configuration.len()).filter(|i| inner(*i)).map(|i| self.configuration[i]).collect()
    }

    /// All active states, in the file's order; the first stands for the run.
    #[must_use]
    pub fn configuration(&self) -> &[StateId] {
        &self.configuration
    }

    /// The locals of the outermost chart that have a value.
    #[must_use]
    pub fn locals(&self) -> BTreeMap<String, Value> {
        self.variables_of(0, |i| &i.locals)
    }

    /// The outputs of the outermost chart that have a value.
    #[must_use]
    pub fn outputs(&self) -> BTreeMap<String, Value> {
        self.variables_of(0, |i| &i.outputs)
    }

    /// Whether the run has ended.
    #[must_use]
    pub fn finished(&self) -> bool {
        self.finished
    }

    fn variables_of(
        &self,
        instance: usize,
        which: fn(&program::Instance) -> &Vec<program::Variable>,
    ) -> BTreeMap<String, Value> {
        let variables = which(&self.program.instances[instance]).iter();
        variables
            .filter_map(|v| Some((v.declaration.name.clone(), self.store.data[v.slot as usize].clone()?)))
            .collect()
    }

    fn number(&mut self) -> u64 {
        self.next += 1;
        self.next - 1
    }

    /// Queues an event from outside.
    fn queue(&mut self, event: Event, turn: &mut Turn<'_>) {
        if self.external.len() >= MAX_QUEUE {
            let reason = "too many events are waiting".into();
            turn.trace(TraceItem::Dropped { name: event.name.to_string(), reason });
        } else {
            self.external.push_back(event);
        }
    }

    fn timer(&mut self, timer: u64, turn: &mut Turn<'_>) {
        match self.timers.remove(&timer) {
            None => {}
            Some(TimerUse::Send { event, .. }) => self.queue(event, turn),
            Some(TimerUse::After { state, entry, transition }) => {
                let path = &self.program.state(state).path;
                let data = Value::record([(
                    "reason",
                    format!("`{path}` had not ended when its time was up").into(),
                )]);
                let origin = Origin::After { state, entry, transition };
                self.queue(Event { name: "after".into(), data, origin }, turn);
            }
            Some(TimerUse::Retry { state, entry }) => {
                let origin = Origin::Retry { state, entry };
                self.queue(Event { name: "retry".into(), data: Value::Null, origin }, turn);
            }
        }
    }

    fn skill_ended(&mut self, activation: u64, result: SkillResult, turn: &mut Turn<'_>) {
        let Some(state) = self.skills.remove(&activation) else { return };
        let cancelled = self.runs[state as usize].skill == SkillRun::Cancelling(activation);
        let (outcome, reason, outputs) = match &result {
            _ if cancelled => ("cancelled", None, BTreeMap::new()),
            Ok(outcome) => (outcome.name.as_str(), None, outcome.outputs.clone()),
            Err(failure) => ("failure", Some(failure.reason.clone()), BTreeMap::new()),
        };
        turn.trace(TraceItem::SkillEnded {
            activation,
            state: self.program.state(state).path.clone(),
            outcome: outcome.to_owned(),
            reason,
            outputs,
        });
        self.runs[state as usize].skill = SkillRun::None;
        if cancelled {
            self.returned(activation, turn);
        } else {
            let event = self.outcome_of_skill(state, result);
            self.external.push_back(event);
        }
    }

    /// A skill that was cancelled is gone.
    fn returned(&mut self, activation: u64, turn: &mut Turn<'_>) {
        if let Some(pending) = &mut self.pending {
            pending.waiting.remove(&activation);
            self.complete_if_returned(turn);
        }
    }

    fn skill_stuck(&mut self, activation: u64, turn: &mut Turn<'_>) {
        let Some(state) = self.skills.remove(&activation) else { return };
        let path = self.program.state(state).path.clone();
        self.runs[state as usize].skill = SkillRun::None;
        let reason = format!("the skill of `{path}` did not return after it was cancelled");
        self.finish_with("failure".into(), Some(reason), vec![path], turn);
        self.returned(activation, turn);
    }

    fn stop(&mut self, outcome: &str, reason: String, turn: &mut Turn<'_>) {
        let running = self.pending.as_ref().is_some_and(|p| matches!(p.step, Step::Finish { .. }));
        if !running {
            self.finish_with(outcome.to_owned(), Some(reason), Vec::new(), turn);
        }
    }

    /// The main loop of SCXML's appendix D: macrosteps until there is nothing to do or something to wait for.
    fn run(&mut self, turn: &mut Turn<'_>) {
        while !self.finished && self.pending.is_none() {
            if self.microsteps >= MAX_MICROSTEPS {
                let reason = format!("{MAX_MICROSTEPS} microsteps without rest");
                self.microsteps = 0;
                self.finish_with("failure".into(), Some(reason), Vec::new(), turn);
                return;
            }
            self.microsteps += 1;
            let always = self.select_always(turn);
            if !always.is_empty() {
                self.begin(Step::Take(always), None, turn);
            } else if let Some(event) = self.internal.pop_front() {
                self.dispatch(event, turn);
            } else if !self.start_ready(turn) {
                self.microsteps = 0;
                self.store.event = None;
                self.show_configuration(turn);
                let Some(event) = self.external.pop_front() else { return };
                self.dispatch(event, turn);
            }
        }
        self.show_configuration(turn);
    }

    fn show_configuration(&mut self, turn: &mut Turn<'_>) {
        let leaves = self.leaves();
        if leaves != self.shown {
            let paths = leaves.iter().map(|s| self.program.state(*s).path.clone()).collect();
            turn.trace(TraceItem::Configuration { leaves: paths });
            self.shown = leaves;
        }
    }
}

fn inputs(
    program: &Program,
    given: &BTreeMap<String, Value>,
    profile: Option<&str>,
) -> Result<Vec<Value>, InputError> {
    let variables = &program.instances[0].inputs;
    let nothing = BTreeMap::new();
    let profile = match profile {
        None => &nothing,
        Some(name) => program.profiles.get(name).ok_or_else(|| InputError::Profile {
            name: name.to_owned(),
            known: program.profiles.keys().cloned().collect::<Vec<_>>().join(", "),
        })?,
    };
    let names = || variables.iter().map(|v| v.declaration.name.as_str());
    if let Some(name) = given.keys().find(|name| !names().any(|known| known == *name)) {
        let help = crate::chart::suggest(name, names());
        return Err(InputError::Unknown { name: name.clone(), help });
    }
    let one = |variable: &program::Variable| {
        let name = &variable.declaration.name;
        let value = given.get(name).or_else(|| profile.get(name)).cloned();
        match value {
            None => variable.declaration.default.clone().ok_or(InputError::Missing { name: name.clone() }),
            Some(value) => variable
                .declaration
                .accept(value)
                .map_err(|message| InputError::Value { name: name.clone(), message }),
        }
    };
    variables.iter().map(one).collect()
}

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
