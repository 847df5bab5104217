//! The interpreter: a function from (state, input) to (state, effects). It has no clock, no random source and no
//! tasks.
//!
//! The algorithm is SCXML's (appendix D) with one difference: states are left in an orderly way. A transition first
//! cancels the skills of all states that it leaves, and waits until they have returned. Only then do exit actions,
//! transition actions and entries run. Start reading at [`Engine::handle`], then `select`, `step`, `act`.

mod act;
mod circle;
mod end;
mod enter;
mod event;
mod hear;
mod hold;
mod inputs;
mod interface;
mod record;
mod select;
mod state;
mod step;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use armarium_values::Value;

pub(crate) use circle::{Circle, RECORDED_BEFORE_BOUND};
pub use interface::{Effect, Input, NoSensors, RunResult, Sensors, WatchSample};
pub use record::{InputRecord, RecordingSensors, Replaying, SensorReading};

use crate::program::{
    ChartVariable, Code, ERROR_CHANNEL, EventId, EventNumber, FAILURE, Instance, Program, StateId,
};
use crate::skill::InputError;
use crate::trace::TraceItem;
use event::{Event, Origin};
use inputs::inputs;
use state::{Pending, RunContext, StateRun, Timer, Turn, Variables};

/// A run fails after this many microsteps without rest.
pub const MAX_MICROSTEPS: u32 = 1000;
/// Largest number of events that wait while states are being left. Further events are dropped; the trace shows it.
pub const MAX_QUEUE: usize = 1024;
/// A run fails after this many microsteps in answer to one input. Events that the chart sends to itself count as
/// well.
pub const MAX_ANSWER: u32 = 20_000;
/// Largest number of events that unbreakable states may hold back.
pub const MAX_HELD: usize = 64;

/// One run of a chart.
#[derive(Debug)]
pub struct Engine {
    program: Arc<Program>,
    store: Variables,
    runs: Vec<StateRun>,
    /// Active states, in the file's order.
    configuration: Vec<StateId>,
    /// The states that each history remembers.
    remembered: BTreeMap<StateId, Vec<StateId>>,
    internal: VecDeque<Event>,
    external: VecDeque<Event>,
    held: VecDeque<Event>,
    timers: BTreeMap<u64, Timer>,
    /// `Timer::chain` of the timer that is being handled.
    chain: u32,
    /// The state of each running skill, by activation.
    skills: BTreeMap<u64, StateId>,
    pending: Option<Pending>,
    ready: BTreeSet<StateId>,
    next: u64,
    microsteps: u32,
    /// Microsteps so far in answer to the current input.
    answer: u32,
    /// The states that the run cycles through when it is close to one of the bounds.
    circle: Circle,
    /// The newest failure, for final states that give no reason.
    last_failure: Option<(Value, StateId)>,
    /// The outcome of the outermost chart, once it has ended.
    ending: Option<(EventNumber, Value)>,
    shown: Vec<StateId>,
    /// The innermost states that were active when the run came to its end.
    ended_in: Vec<StateId>,
    /// Whether states were entered or left since the last `Configuration` trace item.
    moved: bool,
    tracing: bool,
    finished: bool,
    /// How many active states have eventless transitions.
    eager: u32,
    /// How many active states are unbreakable.
    unbreakable: u32,
    /// Number of the current selection.
    selection: u32,
    /// Buffers that are reused to avoid allocation.
    enabled: Vec<u32>,
    exits: Vec<StateId>,
    entries: Vec<StateId>,
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
        let mut inputs = inputs(&program, given, profile)?;
        let mut data = vec![None; program.slots as usize];
        for variable in &program.instances[0].inputs {
            data[variable.slot as usize] = inputs.remove(&variable.declaration.name);
        }
        let runs = vec![StateRun::default(); program.states.len()];
        Ok(Self {
            program,
            store: Variables { data, ..Variables::default() },
            runs,
            configuration: Vec::new(),
            remembered: BTreeMap::new(),
            internal: VecDeque::new(),
            external: VecDeque::new(),
            held: VecDeque::new(),
            timers: BTreeMap::new(),
            chain: 0,
            skills: BTreeMap::new(),
            pending: None,
            ready: BTreeSet::new(),
            next: 1,
            microsteps: 0,
            answer: 0,
            circle: Circle::default(),
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

    /// Whether the engine emits [`Effect::Trace`]; the default is true. Without tracing it is several times faster.
    pub fn set_tracing(&mut self, on: bool) {
        self.tracing = on;
    }

    /// Enters the chart's initial states.
    pub fn start(&mut self, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        let program = Arc::clone(&self.program);
        let mut turn = Turn { program: &program, sensors, out, tracing: self.tracing, actions: 0 };
        let inputs = self.variables_of(0, |i| &i.inputs);
        turn.trace(|p| TraceItem::Started { chart: p.name.clone(), inputs });
        self.enter_run(&mut turn);
        self.run(&mut turn);
    }

    /// Takes one input, runs to completion, and appends the effects to `out`.
    pub fn handle(&mut self, input: Input, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        if self.finished {
            return;
        }
        let program = Arc::clone(&self.program);
        let mut turn = Turn { program: &program, sensors, out, tracing: self.tracing, actions: 0 };
        self.chain = 0;
        if !matches!(input, Input::Timer { .. }) {
            self.circle.clear();
        }
        match input {
            Input::SkillEnded { activation, result } => self.skill_ended(activation, result, &mut turn),
            Input::SkillStuck { activation } => self.skill_stuck(activation, &mut turn),
            Input::Choose { state, outcome } => self.choose(&state, outcome, &mut turn),
            Input::Event { name, data } => self.event(&name, data, &mut turn),
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
            Input::WatchBlind { watch, message, place } => {
                let state = program.watches.get(watch as usize).map(|w| program.path(w.state));
                let data = [
                    ("reason", message.into()),
                    ("place", place.into()),
                    ("state", state.unwrap_or("").into()),
                ];
                self.queue(Event::new(ERROR_CHANNEL, Value::record(data), Origin::Broadcast), &mut turn);
            }
            Input::Stop { reason } => self.stop("stopped", reason, &mut turn),
            Input::Abort { reason } => self.stop("failure", reason, &mut turn),
        }
        self.run(&mut turn);
    }

    /// As [`Input::Event`], for an event whose number is known: no lookup and no allocation.
    pub fn raise(&mut self, event: EventId, data: Value, sensors: &dyn Sensors, out: &mut Vec<Effect>) {
        if self.finished {
            return;
        }
        let program = Arc::clone(&self.program);
        let mut turn = Turn { program: &program, sensors, out, tracing: self.tracing, actions: 0 };
        self.chain = 0;
        self.circle.clear();
        let event = Event::new(event.0, data, Origin::Broadcast);
        if self.pending.is_none() && self.external.is_empty() {
            self.microsteps = 1;
            self.dispatch(event, &mut turn);
        } else {
            self.queue(event, &mut turn);
        }
        self.run(&mut turn);
    }

    /// Samples a watch: whether its condition holds now, and whether it may fire again (`until`, or the condition's
    /// end).
    pub fn observe(&self, watch: u32, sensors: &dyn Sensors) -> WatchSample {
        let watch = &self.program.watches[watch as usize];
        let view = RunContext { program: &self.program, store: &self.store, runs: &self.runs, sensors };
        let (mut error, mut blind) = (None, None);
        let mut look = |code: &Code| {
            code.expr.look(&view).unwrap_or_else(|e| {
                if e.nan || !e.absent {
                    let to = if e.nan { &mut blind } else { &mut error };
                    *to = Some((e.message, self.program.place(code.place)));
                }
                false
            })
        };
        let holds = look(&watch.condition);
        let until = watch.until.as_ref().map_or(!holds, &mut look);
        WatchSample { holds, until, error, blind }
    }

    /// The program that this engine runs.
    pub fn program(&self) -> &Arc<Program> {
        &self.program
    }

    /// The innermost active states, in the file's order.
    pub fn leaves(&self) -> Vec<StateId> {
        let last = |i: usize| self.program.tables.last(self.configuration[i]);
        let inner = |i: usize| self.configuration.get(i + 1).is_none_or(|next| *next > last(i));
        (0..self.configuration.len()).filter(|i| inner(*i)).map(|i| self.configuration[i]).collect()
    }

    /// All active states, in the file's order; the first stands for the run.
    pub fn configuration(&self) -> &[StateId] {
        &self.configuration
    }

    /// The innermost states that were active when the run ended, before they were left; empty until then.
    pub fn ended_in(&self) -> &[StateId] {
        &self.ended_in
    }

    /// The locals of the outermost chart that have a value.
    pub fn locals(&self) -> BTreeMap<String, Value> {
        self.variables_of(0, |i| &i.locals)
    }

    /// The outputs of the outermost chart that have a value.
    pub fn outputs(&self) -> BTreeMap<String, Value> {
        self.variables_of(0, |i| &i.outputs)
    }

    /// Whether the run has ended.
    pub fn finished(&self) -> bool {
        self.finished
    }

    fn variables_of(
        &self,
        instance: usize,
        which: fn(&Instance) -> &Vec<ChartVariable>,
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

    /// The main loop of SCXML's appendix D: runs macrosteps until there is nothing left to do or a skill has to
    /// return.
    fn run(&mut self, turn: &mut Turn<'_>) {
        self.answer = 0;
        while !self.finished && self.pending.is_none() {
            if self.microsteps >= MAX_MICROSTEPS {
                return self.restless(&format!("{MAX_MICROSTEPS} microsteps without rest"), turn);
            }
            if self.answer >= MAX_ANSWER {
                let what = format!("{MAX_ANSWER} microsteps without rest, by events that it sends itself");
                return self.restless(&what, turn);
            }
            self.microsteps += 1;
            self.answer += 1;
            if let Some((outcome, data)) = self.ending.take() {
                let (reason, mut chain) = end::reason_and_chain(&data);
                if outcome == FAILURE {
                    chain.push(turn.program.name.clone());
                }
                let outcome = turn.program.event_names.name(outcome).to_owned();
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

    /// Fails a run that would never come to rest, and names the states that it cycles through.
    fn restless(&mut self, what: &str, turn: &mut Turn<'_>) {
        self.microsteps = 0;
        let reason = format!("{what}: {}", self.circle.names(turn.program));
        self.finish_with("failure".into(), Some(reason), Vec::new(), turn);
    }

    /// Whether the run is close to one of its bounds.
    fn near_a_bound(&self) -> bool {
        self.microsteps + RECORDED_BEFORE_BOUND > MAX_MICROSTEPS
            || self.answer + RECORDED_BEFORE_BOUND > MAX_ANSWER
            || self.chain + RECORDED_BEFORE_BOUND > MAX_MICROSTEPS
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
mod hostile;
#[cfg(test)]
mod nested;
#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
