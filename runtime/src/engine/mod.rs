//! The interpreter: a function from (state, input) to (state, effects). It knows no clock, no randomness, no task.
//!
//! The algorithm is SCXML's (appendix D) with one difference: leaving is orderly. A transition first cancels the
//! skills of all states that are left and waits until they have returned; only then exit actions, transition
//! actions and entries run. Start reading at [`Engine::handle`], then `select`, `step`, `act`.

mod act;
mod end;
mod enter;
mod event;
mod hold;
mod inputs;
mod interface;
mod record;
mod select;
mod step;

pub(crate) mod program;
pub(crate) mod tables;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use armarium_values::Value;
use armarium_values::expr::World;

pub use interface::{Effect, Input, InputError, NoSensors, Observation, RunResult, Sensors};
pub use program::{EventId, Program, StateId};
pub use record::{Recording, Replaying, Seen};

use crate::skill::SkillResult;
use crate::trace::TraceItem;
use event::{Event, Origin};
use inputs::inputs;
use tables::{AFTER, FAILURE, RETRY, Symbol};

/// Microsteps without rest after which a run fails.
pub const MAX_MICROSTEPS: u32 = 1000;
/// Events that may wait while states are left; more are dropped, and seen in the trace.
pub const MAX_QUEUE: usize = 1024;
/// Events that unbreakable states may hold back.
pub const MAX_HELD: usize = 64;

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
    /// Counts entries of all states: tells one stay in a state from another.
    entry: u64,
    /// What few states need.
    extra: Option<Box<Extra>>,
    /// The newest selection that has looked at it.
    seen: u32,
    /// The newest entry that has planned a state inside it.
    filled: u32,
    active: bool,
}

/// What a state with a skill, timers, tries or an outcome is doing.
#[derive(Clone, Debug, Default)]
struct Extra {
    skill: SkillRun,
    /// Its outcome, once nobody handled it.
    done: Option<Symbol>,
    /// Whether it has reported its outcome, for unbreakable states.
    ended: bool,
    retries: u32,
    /// Waits before it is tried again; nothing inside it is active.
    waiting: bool,
    timers: Vec<u64>,
    /// What the transition that entered it gave, for further tries.
    given: BTreeMap<String, Value>,
    /// For a parallel state: the first outcome of a region that is not success.
    first_other: Option<(Symbol, Value)>,
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
    /// The outermost chart has come to its end, with this outcome.
    ending: Option<(Symbol, Value)>,
    shown: Vec<StateId>,
    /// The innermost states that were active when the run came to its end.
    ended_in: Vec<StateId>,
    /// Whether states were entered or left since the configuration was shown.
    moved: bool,
    tracing: bool,
    finished: bool,
    /// How many active states have eventless transitions.
    eager: u32,
    /// How many active states are unbreakable.
    unbreakable: u32,
    /// Counts selections.
    selection: u32,
    /// Kept for their memory.
    enabled: Vec<u32>,
    exits: Vec<StateId>,
    entries: Vec<StateId>,
}

/// The engine's variables, states and sensors together, as expressions see them.
struct View<'v> {
    program: &'v Program,
    store: &'v Store,
    runs: &'v [Run],
    sensors: &'v dyn Sensors,
}

impl World for View<'_> {
    #[inline]
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
        self.store.event.as_ref().map(|e| e.name(self.program))
    }
    fn event_data(&self) -> Option<&Value> {
        self.store.event.as_ref().map(|e| e.data())
    }
    fn active(&self, state: u32) -> bool {
        self.runs.get(state as usize).is_some_and(|r| r.active)
    }
}

/// What one call works with.
struct Turn<'t> {
    program: &'t Program,
    sensors: &'t dyn Sensors,
    out: &'t mut Vec<Effect>,
    tracing: bool,
}

impl<'t> Turn<'t> {
    /// Tells what happens; nothing is put together when nobody listens.
    #[inline]
    fn trace(&mut self, item: impl FnOnce(&'t Program) -> TraceItem) {
        if self.tracing {
            self.out.push(Effect::Trace(item(self.program)));
        }
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
            ending: None,
            shown: Vec::new(),
            ended_in: Vec::new(),
            moved: false,
            tracing: true,
            finished: false,
            eager: 0,
            unbreakable: 0,
            selection: 0,
            enabled: Vec::new(),
            exits: Vec::new(),
            entries: Vec::new(),
        })
    }

    /// Whether what happens is told as [`Effect::Trace`]. It is unless this says otherwise; an engine that nobody
    /// listens to is several times faster.
    pub fn set_tracing(&mut self, on: bool) {
        self.tracing = on;
    }

    /// Enters the chart's initial states.
    pub fn start(&mut self, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        let program = Arc::clone(&self.program);
        let mut turn = Turn { program: &program, sensors, out, tracing: self.tracing };
        let inputs = self.variables_of(0, |i| &i.inputs);
        turn.trace(|p| TraceItem::Started { chart: p.name.clone(), inputs });
        self.enter_run(&mut turn);
        self.run(&mut turn);
    }

    /// Takes one input, runs to completion, and appends what is to be done to `out`.
    pub fn handle(&mut self, input: Input, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        if self.finished {
            return;
        }
        let program = Arc::clone(&self.program);
        let mut turn = Turn { program: &program, sensors, out, tracing: self.tracing };
        match input {
            Input::SkillEnded { activation, result } => self.skill_ended(activation, result, &mut turn),
            Input::SkillStuck { activation } => self.skill_stuck(activation, &mut turn),
            Input::Event { name, data } => {
                let event = Event::named(&program, &name, data);
                self.queue(event, &mut turn);
            }
            Input::Timer { timer } => self.timer(timer, &mut turn),
            Input::Watch { watch, entry } => {
                if let Some(watch) = program.watches.get(watch as usize) {
                    let origin = Origin::Watch { state: watch.state, entry };
                    self.queue(Event::new(watch.name, Value::Null, origin), &mut turn);
                }
            }
            Input::WatchFailed { watch, entry, message, place } => {
                let state = program.watches.get(watch as usize).map(|w| w.state);
                if let Some(state) = state.filter(|s| self.runs[*s as usize].entry == entry) {
                    self.error_at(state, &message, place, &mut turn);
                }
            }
            Input::Stop { reason } => self.stop("stopped", reason, &mut turn),
            Input::Abort { reason } => self.stop("failure", reason, &mut turn),
        }
        self.run(&mut turn);
    }

    /// As [`Input::Event`], for an event whose number is known: nothing is looked up or allocated.
    pub fn raise(&mut self, event: EventId, data: Value, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        if self.finished {
            return;
        }
        let program = Arc::clone(&self.program);
        let mut turn = Turn { program: &program, sensors, out, tracing: self.tracing };
        let event = Event::new(event.0, data, Origin::Broadcast);
        if self.pending.is_none() && self.external.is_empty() {
            self.microsteps = 1;
            self.dispatch(event, &mut turn);
        } else {
            self.queue(event, &mut turn);
        }
        self.run(&mut turn);
    }

    /// Whether the condition of a watch holds now, and whether its `until` (or the condition's end) does.
    pub fn observe(&self, watch: u32, sensors: &dyn Sensors) -> Observation {
        let watch = &self.program.watches[watch as usize];
        let view = View { program: &self.program, store: &self.store, runs: &self.runs, sensors };
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
        let last = |i: usize| self.program.tables.last(self.configuration[i]);
        let inner = |i: usize| self.configuration.get(i + 1).is_none_or(|next| *next > last(i));
        (0..self.configuration.len()).filter(|i| inner(*i)).map(|i| self.configuration[i]).collect()
    }

    /// All active states, in the file's order; the first stands for the run.
    #[must_use]
    pub fn configuration(&self) -> &[StateId] {
        &self.configuration
    }

    /// The innermost states that were active when the run came to its end, before they were left; empty until then.
    #[must_use]
    pub fn ended_in(&self) -> &[StateId] {
        &self.ended_in
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

    /// What only few states need, made where it is not there yet.
    fn extra(&mut self, state: StateId) -> &mut Extra {
        self.runs[state as usize].extra.get_or_insert_default()
    }

    fn extra_of(&self, state: StateId) -> Option<&Extra> {
        self.runs[state as usize].extra.as_deref()
    }

    /// Queues an event from outside.
    fn queue(&mut self, event: Event, turn: &mut Turn<'_>) {
        if self.external.len() >= MAX_QUEUE {
            let reason = "too many events are waiting".into();
            turn.trace(|p| TraceItem::Dropped { name: event.name(p).to_owned(), reason });
        } else {
            self.external.push_back(event);
        }
    }

    fn timer(&mut self, timer: u64, turn: &mut Turn<'_>) {
        match self.timers.remove(&timer) {
            None => {}
            Some(TimerUse::Send { event, .. }) => self.queue(event, turn),
            Some(TimerUse::After { state, entry, transition }) => {
                let path = turn.program.path(state);
                let reason = format!("`{path}` had not ended when its time was up");
                let data = Value::record([("reason", reason.into())]);
                self.queue(Event::new(AFTER, data, Origin::After { state, entry, transition }), turn);
            }
            Some(TimerUse::Retry { state, entry }) => {
                self.queue(Event::new(RETRY, Value::Null, Origin::Retry { state, entry }), turn);
            }
        }
    }

    fn skill_ended(&mut self, activation: u64, result: SkillResult, turn: &mut Turn<'_>) {
        let Some(state) = self.skills.remove(&activation) else { return };
        let cancelled = self.extra(state).skill == SkillRun::Cancelling(activation);
        turn.trace(|p| {
            let (outcome, reason, outputs) = match &result {
                _ if cancelled => ("cancelled", None, BTreeMap::new()),
                Ok(outcome) => (outcome.name.as_str(), None, outcome.outputs.clone()),
                Err(failure) => ("failure", Some(failure.reason.clone()), BTreeMap::new()),
            };
            let (state, outcome) = (p.path(state).to_owned(), outcome.to_owned());
            TraceItem::SkillEnded { activation, state, outcome, reason, outputs }
        });
        self.extra(state).skill = SkillRun::None;
        if cancelled {
            self.returned(activation, turn);
        } else {
            let event = self.outcome_of_skill(state, result, turn);
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
        let path = turn.program.path(state).to_owned();
        self.extra(state).skill = SkillRun::None;
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
            if let Some((outcome, data)) = self.ending.take() {
                let (reason, mut chain) = end::reason_and_chain(&data);
                if outcome == FAILURE {
                    chain.push(turn.program.name.clone());
                }
                let outcome = turn.program.tables.symbols.name(outcome).to_owned();
                self.finish_with(outcome, reason, chain, turn);
                continue;
            }
            if self.eager > 0 && self.take_always(turn) {
                continue;
            }
            if let Some(event) = self.internal.pop_front() {
                self.dispatch(event, turn);
            } else if self.ready.is_empty() {
                self.microsteps = 0;
                self.store.event = None;
                self.show_configuration(turn);
                let Some(event) = self.external.pop_front() else { return };
                self.dispatch(event, turn);
            } else {
                self.start_ready(turn);
            }
        }
        self.show_configuration(turn);
    }

    fn show_configuration(&mut self, turn: &mut Turn<'_>) {
        if !turn.tracing || !std::mem::take(&mut self.moved) {
            return;
        }
        let leaves = self.leaves();
        if leaves != self.shown {
            let paths = leaves.iter().map(|s| turn.program.path(*s).to_owned()).collect();
            turn.trace(|_| TraceItem::Configuration { leaves: paths });
            self.shown = leaves;
        }
    }
}

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
