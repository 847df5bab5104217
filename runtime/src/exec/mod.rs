//! Runs a chart on tokio: skills as tasks, timers, watches, one bounded queue. The engine decides, this does.
//!
//! On a current-thread runtime with a paused clock a run is repeatable bit for bit: ordered maps, biased
//! selection, and nothing but tokio's clock.

mod chart_skill;
mod letters;
mod skills;
mod watchdog;
mod watching;

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use armarium_values::Value;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

use crate::channels::Channels;
use crate::chart::Registry;
use crate::engine::{Effect, Engine, Input, InputError, InputRecord, Program, Recording, Sensors};
use crate::skill::Limits;
use crate::trace::{TraceEvent, TraceItem, TraceSink};
use letters::Outbox;
use skills::{Message, Running};
use watchdog::Watchdog;
use watching::Watching;

pub use crate::engine::RunResult;
pub use chart_skill::{ChartSkill, Stop};
pub use letters::{Hearers, Letter, Others, Post};

/// Messages that may wait for the engine; skills that send more wait.
const QUEUE: usize = 256;

/// Called with the path of a state whose skill is stuck.
pub type OnStuck = Box<dyn FnMut(&str) + Send>;

/// How a chart is run.
#[derive(Default)]
pub struct ExecOptions {
    /// Inputs of the chart that override profile and defaults.
    pub inputs: BTreeMap<String, Value>,
    /// The profile whose defaults are used.
    pub profile: Option<String>,
    /// Bounds on every skill, beside the chart's own.
    pub limits: Limits,
    /// Takes what happens.
    pub sink: Option<Box<dyn TraceSink>>,
    /// Called at once with a state's path when its skill does not return within its grace, or has not yielded for a
    /// long time by the wall clock: stop the robot. In the second case it is called from another thread.
    pub on_stuck: Option<OnStuck>,
    /// The charts of other agents, and how events go to and fro.
    pub others: Others,
}

impl fmt::Debug for ExecOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ExecOptions")
            .field("inputs", &self.inputs)
            .field("profile", &self.profile)
            .finish_non_exhaustive()
    }
}

/// Reaches into a run from outside.
#[derive(Clone, Debug)]
pub struct Controller {
    queue: mpsc::Sender<Message>,
    stop: CancellationToken,
    reason: Arc<Mutex<Option<String>>>,
}

impl Controller {
    /// Ends the run: all skills are cancelled and waited for; the outcome is `stopped`.
    pub fn stop(&self, reason: impl Into<String>) {
        let mut slot = self.reason.lock().unwrap_or_else(PoisonError::into_inner);
        slot.get_or_insert(reason.into());
        drop(slot);
        self.stop.cancel();
    }

    /// Raises an event that all active states see. Gives false when the queue is full or the run has ended.
    #[must_use = "an event that the queue had no room for was not raised"]
    pub fn raise(&self, name: impl Into<String>, data: Value) -> bool {
        self.queue.try_send(Message::Event { name: name.into(), data }).is_ok()
    }
}

/// A chart that is about to run.
pub struct Executor {
    engine: Engine,
    registry: Registry,
    channels: Channels,
    limits: Limits,
    sink: Option<Box<dyn TraceSink>>,
    watchdog: Watchdog,
    outbox: Outbox,
    hearers: Hearers,
    sender: mpsc::Sender<Message>,
    queue: mpsc::Receiver<Message>,
    stop: CancellationToken,
    reason: Arc<Mutex<Option<String>>>,
    running: BTreeMap<u64, Running>,
    timers: BTreeMap<(Instant, u64, u64), ()>,
    timer_keys: BTreeMap<u64, (Instant, u64, u64)>,
    watching: Watching,
    began: Instant,
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
            outbox: Outbox::new(options.others.post, sender.clone()),
            hearers: options.others.hearers,
            sender,
            queue,
            stop: CancellationToken::new(),
            reason: Arc::new(Mutex::new(None)),
            running: BTreeMap::new(),
            timers: BTreeMap::new(),
            timer_keys: BTreeMap::new(),
            watching: Watching::default(),
            began: Instant::now(),
            result: None,
        })
    }

    /// Sets after how long by the wall clock a skill that does not yield is taken to hang; without this, 10 s. Then
    /// `on_hang` is called with its state's path, from a thread of its own, after [`ExecOptions::on_stuck`]: where the
    /// skill blocks the thread that everything runs on, nothing else can go on, and the process should end.
    #[must_use]
    pub fn hang_after(mut self, limit: std::time::Duration, on_hang: Option<OnStuck>) -> Self {
        self.watchdog.set(limit, on_hang);
        self
    }

    /// A handle that reaches into the run.
    #[must_use]
    pub fn controller(&self) -> Controller {
        Controller { queue: self.sender.clone(), stop: self.stop.clone(), reason: Arc::clone(&self.reason) }
    }

    /// Runs the chart to its end. Dropping the future cancels and aborts all skills.
    pub async fn run(mut self) -> RunResult {
        self.began = Instant::now();
        self.watchdog.start();
        let seat = self.hearers.join(self.engine.program().name(), self.controller());
        self.turn(None);
        let mut stopping = false;
        loop {
            if let Some(result) = self.result.take() {
                drop(seat);
                self.outbox.close().await;
                return result;
            }
            if self.sample_watches() {
                continue;
            }
            let deadline = self.deadline();
            let stop = self.stop.clone();
            let turn = tokio::select! {
                biased;
                () = stop.cancelled(), if !stopping => Turn::Stop,
                Some(message) = self.queue.recv() => Turn::Message(message),
                () = until(deadline), if deadline.is_some() => Turn::Time,
                () = self.watching.changed(), if self.watching.observes() => Turn::Channels,
            };
            match turn {
                Turn::Stop => {
                    stopping = true;
                    let reason = self.reason.lock().unwrap_or_else(PoisonError::into_inner).clone();
                    self.handle(Input::Stop { reason: reason.unwrap_or_default() });
                }
                Turn::Message(message) => self.message(message),
                Turn::Time => self.time(),
                Turn::Channels => {}
            }
        }
    }

    fn message(&mut self, message: Message) {
        match message {
            Message::Event { name, data } => self.handle(Input::Event { name, data }),
            Message::Inside { state, leaves } => self.trace(TraceItem::Inside { state, leaves }),
            Message::Hangs { reason } => self.handle(Input::Abort { reason }),
            Message::Ended { activation, result } => {
                self.running.remove(&activation);
                self.handle(Input::SkillEnded { activation, result });
            }
        }
    }

    fn handle(&mut self, input: Input) {
        self.turn(Some(input));
    }

    /// One turn of the engine, its start where there is no input; for a sink, with what it was told and read.
    fn turn(&mut self, input: Option<Input>) {
        let mut effects = Vec::new();
        let program = Arc::clone(self.engine.program());
        let hub = Hub { channels: &self.channels, names: program.channels() };
        let Some(sink) = &mut self.sink else {
            match input {
                None => self.engine.start(&hub, &mut effects),
                Some(input) => self.engine.handle(input, &hub, &mut effects),
            }
            return self.apply(effects);
        };
        let sensors = Recording::new(&hub);
        match input.clone() {
            None => self.engine.start(&sensors, &mut effects),
            Some(input) => self.engine.handle(input, &sensors, &mut effects),
        }
        sink.input(&InputRecord { at_ns: nanoseconds(self.began), input, seen: sensors.seen() });
        self.apply(effects);
    }

    fn deadline(&self) -> Option<Instant> {
        let timer = self.timers.keys().next().map(|(at, ..)| *at);
        let grace = self.running.values().filter_map(Running::deadline).min();
        [timer, grace, self.watching.deadline()].into_iter().flatten().min()
    }

    /// Everything that is due now: stuck skills, then timers in their order. Watches are sampled anyway.
    fn time(&mut self) {
        let now = Instant::now();
        let stuck = |running: &Running| running.deadline().is_some_and(|at| at <= now);
        let stuck: Vec<u64> = self.running.iter().filter(|(_, r)| stuck(r)).map(|(a, _)| *a).collect();
        for activation in stuck {
            let Some(running) = self.running.remove(&activation) else { continue };
            tracing::error!(state = running.state(), "a skill did not return after it was cancelled");
            self.watchdog.stuck(running.state());
            self.handle(Input::SkillStuck { activation });
        }
        while let Some((key, ())) = self.timers.first_key_value().filter(|((at, ..), ())| *at <= now) {
            let key = *key;
            self.timers.remove(&key);
            self.timer_keys.remove(&key.2);
            self.handle(Input::Timer { timer: key.2 });
        }
        self.watching.time(now);
    }

    /// Looks at the watches that may have changed. Gives whether one fired.
    fn sample_watches(&mut self) -> bool {
        let program = Arc::clone(self.engine.program());
        let hub = Hub { channels: &self.channels, names: program.channels() };
        let inputs = self.watching.sample(&self.engine, &hub, Instant::now());
        let any = !inputs.is_empty();
        inputs.into_iter().for_each(|input| self.handle(input));
        any
    }

    fn apply(&mut self, effects: Vec<Effect>) {
        self.watching.data_changed();
        for effect in effects {
            match effect {
                Effect::StartSkill { activation, state, skill, inputs, limits } => {
                    let path = self.engine.program().path(state).to_owned();
                    let limits = self.limits.tightened(limits);
                    let Some(implementation) = self.registry.get(&skill).cloned() else {
                        let reason = format!("there is no skill `{skill}` in this program");
                        let result = Err(crate::skill::Failure::new(reason));
                        self.running
                            .insert(activation, Running::failed(path, activation, result, &self.sender));
                        continue;
                    };
                    let start = skills::Start { activation, state: path, inputs, limits };
                    let polls = self.watchdog.watch(activation, &start.state);
                    let declared = self.registry.manifest(&skill).map_or_else(Vec::new, |m| m.events.clone());
                    let channels = self.channels.clone();
                    let running =
                        Running::start(implementation, start, channels, &self.sender, declared, polls);
                    self.running.insert(activation, running);
                }
                Effect::Cancel { activation, grace } => {
                    if let Some(running) = self.running.get_mut(&activation) {
                        running.cancel(Instant::now() + grace);
                    }
                }
                Effect::StartTimer { timer, after, order } => {
                    let key = (Instant::now() + after, order, timer);
                    self.timers.insert(key, ());
                    self.timer_keys.insert(timer, key);
                }
                Effect::CancelTimer { timer } => {
                    if let Some(key) = self.timer_keys.remove(&timer) {
                        self.timers.remove(&key);
                    }
                }
                Effect::ArmWatch { watch, entry } => {
                    self.watching.arm(watch, entry, self.engine.program(), &self.channels);
                }
                Effect::DisarmWatch { watch } => self.watching.disarm(watch),
                Effect::Send { event, to, data } => self.outbox.send(Letter { to, event, data }),
                Effect::Trace(item) => self.trace(item),
                Effect::Finished(result) => self.result = Some(result),
            }
        }
    }

    fn trace(&mut self, item: TraceItem) {
        if let Some(sink) = &mut self.sink {
            sink.record(&TraceEvent { at_ns: nanoseconds(self.began), item });
        }
    }
}

fn nanoseconds(since: Instant) -> u64 {
    u64::try_from(Instant::now().duration_since(since).as_nanos()).unwrap_or(u64::MAX)
}

/// What woke the executor.
enum Turn {
    Stop,
    Message(Message),
    Time,
    Channels,
}

async fn until(deadline: Option<Instant>) {
    match deadline {
        Some(at) => sleep_until(at).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests;
