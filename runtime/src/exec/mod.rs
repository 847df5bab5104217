//! Runs a chart on tokio: skills as tasks, one bounded queue, tokio's clock. The engine decides, the agenda says
//! what is due, and this module carries it out. Items due at an instant come before messages that arrive at it, so
//! that a flood of events delays no timer.
//!
//! On a current-thread runtime with a paused clock, a run is repeatable bit for bit: it uses ordered maps, biased
//! selection, and only tokio's clock.

mod chart_skill;
mod following;
mod remote_events;
mod sink;
mod skills;
mod watchdog;

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;
use futures::future::BoxFuture;
use parking_lot::Mutex;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

use crate::activation::{Activation, Report, SkillStart};
use crate::agenda::Agenda;
use crate::channels::Channels;
use crate::chart::Registry;
use crate::engine::{Effect, Engine, Input, InputRecord, RecordingSensors, Sensors};
use crate::program::Program;
use crate::skill::{Failure, InputError, Limits, Skill, SkillContext, SkillManifest, SkillResult};
use crate::trace::{TraceEvent, TraceItem};
use following::Following;
use remote_events::Outbox;
use skills::{ActiveSkill, ExecutorMessage};
use watchdog::Watchdog;

pub use crate::engine::RunResult;
pub use chart_skill::{ChartSkill, SinkOfRun, Stop};
pub use remote_events::{DeliveryError, Peers, Raised, RemoteEvent, Subscribers, Transport};
pub use sink::TraceSink;

/// Largest number of messages in the engine's queue; senders wait when it is full.
const QUEUE: usize = 256;

/// A closed run fails after this time without a skill, a timer or an event, while only watches are armed.
const MAX_QUIET: Duration = Duration::from_secs(3600);

/// Called with the path of a state whose skill is stuck.
pub type OnStuck = Box<dyn FnMut(&str) + Send>;

/// How a chart is run.
#[derive(Default)]
pub struct ExecOptions {
    /// Inputs of the chart that override profile and defaults.
    pub inputs: BTreeMap<String, Value>,
    /// The profile whose defaults are used.
    pub profile: Option<String>,
    /// Bounds on every skill, in addition to the chart's own.
    pub limits: Limits,
    /// Receives the trace.
    pub sink: Option<Box<dyn TraceSink>>,
    /// Called at once with a state's path when its skill does not return within its grace, or has not yielded for a
    /// long time by the wall clock; it must stop the robot. In the second case it is called from another thread.
    pub on_stuck: Option<OnStuck>,
    /// The charts of other agents, and how events are exchanged with them.
    pub peers: Peers,
    /// Whether nobody can raise events from outside. A run in which nothing can happen any more then fails.
    pub closed: bool,
}

impl fmt::Debug for ExecOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ExecOptions")
            .field("inputs", &self.inputs)
            .field("profile", &self.profile)
            .finish_non_exhaustive()
    }
}

/// Controls a run from outside.
#[derive(Clone, Debug)]
pub struct Controller {
    queue: mpsc::Sender<ExecutorMessage>,
    stop: CancellationToken,
    reason: Arc<Mutex<Option<String>>>,
}

impl Controller {
    /// Ends the run: all skills are cancelled and waited for; the outcome is `stopped`.
    pub fn stop(&self, reason: impl Into<String>) {
        let mut slot = self.reason.lock();
        slot.get_or_insert(reason.into());
        drop(slot);
        self.stop.cancel();
    }

    /// Raises an event that all active states see. Returns false if the queue is full or the run has ended.
    #[must_use = "an event that the queue had no room for was not raised"]
    pub fn raise(&self, name: impl Into<String>, data: Value) -> bool {
        self.queue.try_send(ExecutorMessage::Event { name: name.into(), data, answer: None }).is_ok()
    }

    /// Ends the skill of a state with an outcome of one's choice: the skill is cancelled, and what it gives then is ignored but for its
    /// outputs. Where that cannot be, the trace says so. Returns false if the queue is full or the run has ended.
    #[must_use = "a choice that the queue had no room for was not made"]
    pub fn choose(&self, state: impl Into<String>, outcome: impl Into<String>) -> bool {
        self.queue.try_send(ExecutorMessage::Chosen { state: state.into(), outcome: outcome.into() }).is_ok()
    }

    /// Says in the trace what somebody did to the run from outside. Returns false if the queue is full or the run has ended.
    #[must_use = "what the queue had no room for is not in the trace"]
    pub fn acted(&self, what: impl Into<String>) -> bool {
        self.queue.try_send(ExecutorMessage::Acted { what: what.into() }).is_ok()
    }

    /// As [`Controller::raise`]; gives who will say why the event changed nothing, if it did not.
    fn offer(&self, name: &str, data: Value) -> Option<oneshot::Receiver<Option<String>>> {
        let (answer, answered) = oneshot::channel();
        let message = ExecutorMessage::Event { name: name.to_owned(), data, answer: Some(answer) };
        self.queue.try_send(message).is_ok().then_some(answered)
    }

    /// Says in the trace that an event was refused to its sender. Where too much waits already, it is not said.
    fn refused(&self, name: &str, reason: String) {
        let refused = ExecutorMessage::Dropped { name: name.to_owned(), reason, error: None };
        let _ = self.queue.try_send(refused).is_ok();
    }
}

/// A chart that is ready to run.
pub struct Executor {
    engine: Engine,
    registry: Registry,
    channels: Channels,
    limits: Limits,
    sink: Option<Box<dyn TraceSink>>,
    watchdog: Watchdog,
    outbox: Outbox,
    subscribers: Subscribers,
    sender: mpsc::Sender<ExecutorMessage>,
    queue: mpsc::Receiver<ExecutorMessage>,
    stop: CancellationToken,
    reason: Arc<Mutex<Option<String>>>,
    running: BTreeMap<u64, ActiveSkill>,
    agenda: Agenda,
    following: Following,
    began: Instant,
    /// Time since the run began, at the current turn.
    now: Duration,
    /// See [`ExecOptions::closed`].
    closed: bool,
    /// Time of the engine's last turn.
    last_turn: Duration,
    result: Option<RunResult>,
}

impl fmt::Debug for Executor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Executor").field("program", self.engine.program()).finish_non_exhaustive()
    }
}

/// The channels as expressions read them.
struct Hub<'h> {
    channels: &'h Channels,
    names: &'h [String],
}

impl Sensors for Hub<'_> {
    fn channel(&self, channel: u32, path: &[String]) -> Option<Value> {
        self.channels.field(self.names.get(channel as usize)?, path)
    }
    fn age(&self, channel: u32) -> Option<f64> {
        Some(self.channels.age(self.names.get(channel as usize)?)?.as_secs_f64())
    }
}

impl Executor {
    /// Prepares a run; nothing is started yet.
    ///
    /// # Errors
    /// [`InputError`] for an input or profile that does not exist, is missing or does not fit.
    pub fn new(
        program: Arc<Program>,
        registry: Registry,
        channels: Channels,
        options: ExecOptions,
    ) -> Result<Self, InputError> {
        let mut engine = Engine::new(program, &options.inputs, options.profile.as_deref())?;
        engine.set_tracing(options.sink.is_some());
        let (sender, queue) = mpsc::channel(QUEUE);
        Ok(Self {
            engine,
            registry,
            channels,
            limits: options.limits,
            sink: options.sink,
            watchdog: Watchdog::new(options.on_stuck, sender.clone()),
            outbox: Outbox::new(options.peers.transport, sender.clone()),
            subscribers: options.peers.subscribers,
            sender,
            queue,
            stop: CancellationToken::new(),
            reason: Arc::new(Mutex::new(None)),
            running: BTreeMap::new(),
            agenda: Agenda::default(),
            following: Following::default(),
            began: Instant::now(),
            now: Duration::ZERO,
            closed: options.closed,
            last_turn: Duration::ZERO,
            result: None,
        })
    }

    /// Sets how long, by the wall clock, a skill may run without yielding before it counts as hanging; the default
    /// is 10 s. `on_hang` is then called with its state's path, from a separate thread, after
    /// [`ExecOptions::on_stuck`]. If the skill blocks the thread that everything runs on, nothing else can
    /// continue, and the process should end.
    #[must_use]
    pub fn hang_after(mut self, limit: Duration, on_hang: Option<OnStuck>) -> Self {
        self.watchdog.set(limit, on_hang);
        self
    }

    /// A handle that controls the run.
    pub fn controller(&self) -> Controller {
        Controller { queue: self.sender.clone(), stop: self.stop.clone(), reason: Arc::clone(&self.reason) }
    }

    /// Runs the chart to its end. Dropping the future cancels and aborts all skills.
    pub async fn run(mut self) -> RunResult {
        // What memory holds is there when the chart starts, and is kept up to date until the run ends.
        let observing = self.channels.observe(self.engine.program().observed()).await;
        self.began = Instant::now();
        self.watchdog.start();
        let subscription = self.subscribers.join(Arc::clone(self.engine.program()), self.controller());
        self.turn(None);
        let _observing = match observing {
            Ok(tasks) => tasks,
            Err(error) => {
                self.turn(Some(Input::Abort { reason: error.to_string() }));
                JoinSet::new()
            }
        };
        let mut stopping = false;
        let stop = self.stop.clone();
        loop {
            self.catch_up();
            if let Some(result) = self.result.take() {
                drop(subscription);
                self.outbox.close().await;
                return result;
            }
            let quiet_until = self.quiet_until().filter(|_| !stopping);
            if quiet_until.is_some_and(|at| at <= self.now) {
                let reason = self.stuck();
                self.turn(Some(Input::Abort { reason }));
                continue;
            }
            let deadline = self.agenda.next().into_iter().chain(quiet_until).min();
            let deadline = deadline.and_then(|at| self.began.checked_add(at));
            let message = tokio::select! {
                biased;
                () = stop.cancelled(), if !stopping => {
                    stopping = true;
                    let reason = self.reason.lock().clone();
                    ExecutorMessage::Stopped { reason: reason.unwrap_or_default() }
                }
                Some(message) = self.queue.recv() => message,
                () = until(deadline), if deadline.is_some() => continue,
                () = self.following.changed(), if !self.following.is_empty() => continue,
            };
            self.catch_up();
            if self.result.is_none() {
                self.message(message);
            }
        }
    }

    /// Passes everything that is due by now to the engine.
    fn catch_up(&mut self) {
        self.now = self.began.elapsed();
        while self.result.is_none() {
            for channel in self.following.take_changed() {
                self.agenda.published(channel);
            }
            let program = Arc::clone(self.engine.program());
            let hub = Hub { channels: &self.channels, names: program.channels() };
            let Some(input) = self.agenda.due(&self.engine, &hub, self.now) else { return };
            if let Input::SkillStuck { activation } = &input
                && let Some(running) = self.running.remove(activation)
            {
                let state = program.path(running.state());
                tracing::error!(state, "a skill did not return after it was cancelled");
                self.watchdog.stuck(state);
            }
            self.turn(Some(input));
        }
    }

    /// When the run fails because nothing can happen any more: at once if nothing is armed, later if only watches are;
    /// `None` while a skill runs, a timer is armed, or somebody may raise an event.
    fn quiet_until(&self) -> Option<Duration> {
        let waits = !self.running.is_empty() || self.agenda.has_timers() || !self.queue.is_empty();
        if !self.closed || waits || self.result.is_some() {
            return None;
        }
        let patience = if self.agenda.has_watches() { MAX_QUIET } else { Duration::ZERO };
        Some(self.last_turn.saturating_add(patience))
    }

    /// Why nothing can happen any more: what each innermost state waits for.
    fn stuck(&self) -> String {
        let program = self.engine.program();
        let waits = self.engine.leaves().into_iter().map(|leaf| program.waits_for(leaf));
        let waits = waits.collect::<Vec<_>>().join("; ");
        if self.agenda.has_watches() {
            let hours = MAX_QUIET.as_secs() / 3600;
            return format!(
                "stuck: for {hours} h no skill ran, no timer was armed and no watch fired; {waits}"
            );
        }
        format!("stuck: no skill runs, no timer or watch is armed, and nobody can send events; {waits}")
    }

    fn message(&mut self, message: ExecutorMessage) {
        match message {
            ExecutorMessage::Event { name, data, answer } => {
                let dropped = self.turn(Some(Input::Event { name, data }));
                // Nobody may wait any more.
                let _ = answer.is_none_or(|answer| answer.send(dropped).is_ok());
            }
            ExecutorMessage::Dropped { name, reason, error } => {
                self.trace(TraceItem::Dropped { name, reason });
                let name = "error.communication".to_owned();
                if let Some(data) = error {
                    self.turn(Some(Input::Event { name, data }));
                }
            }
            ExecutorMessage::Chosen { state, outcome } => {
                drop(self.turn(Some(Input::Choose { state, outcome })))
            }
            ExecutorMessage::Acted { what } => self.trace(TraceItem::Acted { action: what }),
            ExecutorMessage::Skill { activation, report } => self.report(activation, report),
            ExecutorMessage::Hangs { reason } => drop(self.turn(Some(Input::Abort { reason }))),
            ExecutorMessage::Stopped { reason } => drop(self.turn(Some(Input::Stop { reason }))),
        }
    }

    /// Handles a skill's report. Reports of a skill that counts as stuck are ignored.
    fn report(&mut self, activation: u64, report: Report) {
        let Some(state) = self.running.get(&activation).map(ActiveSkill::state) else { return };
        let path = || self.engine.program().path(state).to_owned();
        match report {
            Report::Event { name, data } => drop(self.turn(Some(Input::Event { name, data }))),
            Report::Dropped { name, count } => {
                let reason = format!("`{}` raised {count} more than may wait", path());
                self.trace(TraceItem::Dropped { name, reason });
            }
            Report::Inside(leaves) => {
                let state = path();
                self.trace(TraceItem::Inside { state, leaves });
            }
            Report::Ended(result) => {
                self.running.remove(&activation);
                let restless = self.agenda.ended(activation, state, self.engine.program(), self.now);
                self.turn(Some(Input::SkillEnded { activation, result }));
                if restless.is_some() && self.result.is_none() {
                    self.turn(restless);
                }
            }
        }
    }

    /// One turn of the engine; `None` is its start. A sink also receives the input and the sensor readings. Returns why an event
    /// that is the input changed nothing, if that is so and traced.
    fn turn(&mut self, input: Option<Input>) -> Option<String> {
        self.last_turn = self.now;
        let event = match &input {
            Some(Input::Event { name, .. }) => Some(name.clone()),
            _ => None,
        };
        let mut effects = Vec::new();
        let program = Arc::clone(self.engine.program());
        let hub = Hub { channels: &self.channels, names: program.channels() };
        if let Some(sink) = &mut self.sink {
            let sensors = RecordingSensors::new(&hub);
            match input.clone() {
                None => self.engine.start(&sensors, &mut effects),
                Some(input) => self.engine.handle(input, &sensors, &mut effects),
            }
            sink.input(&InputRecord { at_ns: nanoseconds(self.now), input, seen: sensors.seen() });
        } else {
            match input {
                None => self.engine.start(&hub, &mut effects),
                Some(input) => self.engine.handle(input, &hub, &mut effects),
            }
        }
        let dropped = effects.iter().find_map(|effect| match effect {
            Effect::Trace(TraceItem::Dropped { name, reason }) if Some(name) == event.as_ref() => {
                Some(reason.clone())
            }
            _ => None,
        });
        for effect in effects {
            if let Some(effect) = self.agenda.take(effect, &program, self.now) {
                self.act(effect);
            }
        }
        self.agenda.turned();
        self.following.follow(self.agenda.channels(), program.channels(), &self.channels);
        dropped
    }

    /// Carries out the effects that the agenda does not handle.
    fn act(&mut self, effect: Effect) {
        match effect {
            Effect::StartSkill { activation, state, skill, inputs, limits } => {
                let path = self.engine.program().path(state);
                let declared = self.registry.manifest(&skill).map_or_else(Vec::new, |m| m.events.clone());
                let implementation =
                    self.registry.get(&skill).cloned().unwrap_or_else(|| Arc::new(Missing(skill)));
                let cancel = CancellationToken::new();
                let start = SkillStart {
                    state: path.to_owned(),
                    inputs,
                    limits: self.limits.tightened(limits),
                    channels: self.channels.clone(),
                    cancel: cancel.clone(),
                };
                let running = ActiveSkill::start(
                    (activation, state),
                    Activation::new(implementation, declared, start),
                    cancel,
                    self.sender.clone(),
                    self.watchdog.watch(activation, path),
                );
                self.running.insert(activation, running);
            }
            Effect::Cancel { activation, .. } => {
                if let Some(running) = self.running.get(&activation) {
                    running.cancel();
                }
            }
            Effect::Send { event, to, data } => self.outbox.send(RemoteEvent { to, event, data }),
            Effect::Trace(item) => self.trace(item),
            Effect::Finished(result) => self.result = Some(result),
            Effect::StartTimer { .. }
            | Effect::CancelTimer { .. }
            | Effect::ArmWatch { .. }
            | Effect::DisarmWatch { .. } => {}
        }
    }

    fn trace(&mut self, item: TraceItem) {
        if let Some(sink) = &mut self.sink {
            sink.record(&TraceEvent { at_ns: nanoseconds(self.now), item });
        }
    }
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// A placeholder for a skill that this program does not have.
struct Missing(String);

impl Skill for Missing {
    fn manifest(&self) -> SkillManifest {
        SkillManifest::new(&self.0, "Is not part of this program.")
    }
    fn run(&self, _: SkillContext) -> BoxFuture<'static, SkillResult> {
        let failure = Failure::new(format!("there is no skill `{}` in this program", self.0));
        Box::pin(std::future::ready(Err(failure)))
    }
}

async fn until(deadline: Option<Instant>) {
    match deadline {
        Some(at) => sleep_until(at).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod agreement;
#[cfg(test)]
mod observed_tests;
#[cfg(test)]
mod tests;
