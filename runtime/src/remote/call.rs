//! One call that another agent has started here: the skill as it runs, what is to be told of it, and its lease.

use std::collections::{BTreeMap, VecDeque};
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use armarium_values::Value;
use futures::FutureExt as _;
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

use super::LEASE;
use super::wire::{Ended, Manifest, RaisedEvent, Status};
use crate::channels::Channels;
use crate::exec::Stop;
use crate::skill::{Failure, Limits, Parameter, Skill, SkillContext, SkillManifest, SkillResult};

/// Events that wait for the caller; older ones are dropped.
const EVENTS: usize = 256;

/// What is to run.
pub(super) struct Task {
    pub(super) name: String,
    pub(super) skill: Arc<dyn Skill>,
    pub(super) manifest: SkillManifest,
    pub(super) inputs: BTreeMap<String, Value>,
    pub(super) limits: Limits,
    pub(super) channels: Channels,
    pub(super) stop: Stop,
}

#[derive(Debug, Default)]
struct State {
    revision: u64,
    leaves: Vec<String>,
    events: VecDeque<RaisedEvent>,
    ended: Option<Ended>,
}

/// A call that runs or has ended.
#[derive(Debug)]
pub(super) struct Call {
    state: watch::Sender<State>,
    heard: Mutex<Instant>,
    cancel: CancellationToken,
    reason: Mutex<Option<String>>,
}

impl Call {
    /// Starts a task; gives the future that runs it to its end.
    pub(super) fn start(task: Task) -> (Arc<Self>, impl Future<Output = ()> + Send) {
        let call = Arc::new(Self {
            state: watch::channel(State::default()).0,
            heard: Mutex::new(Instant::now()),
            cancel: CancellationToken::new(),
            reason: Mutex::default(),
        });
        let running = Arc::clone(&call);
        (call, async move { running.run(task).await })
    }

    pub(super) fn cancel(&self, reason: &str) {
        let mut slot = self.reason.lock().unwrap_or_else(PoisonError::into_inner);
        slot.get_or_insert_with(|| reason.chars().take(200).collect());
        drop(slot);
        self.cancel.cancel();
    }

    pub(super) fn has_ended(&self) -> bool {
        self.state.borrow().ended.is_some()
    }

    /// The caller is there; what is new to it, perhaps after a while.
    pub(super) async fn poll(&self, seen: u64, wait: Duration) -> Status {
        *self.heard.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
        let mut changes = self.state.subscribe();
        let news = changes.wait_for(|state| state.revision > seen || state.ended.is_some());
        // Nothing new within the time is an answer too.
        let _ = timeout(wait, news).await.is_ok();
        self.status(seen)
    }

    pub(super) fn status(&self, seen: u64) -> Status {
        let state = self.state.borrow();
        Status {
            revision: state.revision,
            leaves: state.leaves.clone(),
            events: state.events.iter().filter(|e| e.revision > seen).cloned().collect(),
            ended: state.ended.clone(),
        }
    }

    fn lease(&self) -> Instant {
        *self.heard.lock().unwrap_or_else(PoisonError::into_inner) + LEASE
    }

    async fn run(&self, task: Task) {
        let (events, mut incoming) = mpsc::channel(64);
        let (inside, mut within) = watch::channel(Vec::new());
        let context = SkillContext {
            state: task.name.clone(),
            inputs: task.inputs,
            limits: task.limits,
            cancel: self.cancel.clone(),
            channels: task.channels,
            events,
            inside,
        };
        let skill = task.skill;
        let acting = AssertUnwindSafe(async move { skill.run(context).await }).catch_unwind();
        tokio::pin!(acting);
        let mut deadline = None;
        let result = loop {
            let (lease, until) = (self.lease(), deadline.unwrap_or_else(Instant::now));
            tokio::select! {
                biased;
                Some((name, data)) = incoming.recv() => self.raised(&task.manifest, name, data),
                Ok(()) = within.changed() => self.tell(|state| state.leaves.clone_from(&within.borrow_and_update())),
                result = &mut acting => break result,
                () = self.cancel.cancelled(), if deadline.is_none() => {
                    deadline = Some(Instant::now() + task.manifest.grace);
                }
                () = sleep_until(lease), if deadline.is_none() => {
                    // A poll may have come while this waited.
                    if self.lease() <= Instant::now() {
                        tracing::warn!(call = %task.name, "its caller is gone: it is cancelled");
                        self.cancel("its caller is gone");
                    }
                }
                () = sleep_until(until), if deadline.is_some() => {
                    tracing::error!(call = %task.name, "it did not return after it was cancelled");
                    (task.stop)(&task.name);
                    break Ok(Err(Failure::new("it is stuck: it did not return after it was cancelled")));
                }
            }
        };
        while let Ok((name, data)) = incoming.try_recv() {
            self.raised(&task.manifest, name, data);
        }
        let result: SkillResult =
            result.unwrap_or_else(|_| Err(Failure::new("the skill panicked at the other agent")));
        self.tell(|state| state.ended = Some(result.into()));
    }

    fn tell(&self, change: impl FnOnce(&mut State)) {
        self.state.send_modify(|state| {
            state.revision += 1;
            change(state);
        });
    }

    fn raised(&self, manifest: &SkillManifest, name: String, data: Value) {
        if !manifest.events.contains(&name) {
            tracing::warn!(event = name, "a skill raised an event that it does not declare");
            return;
        }
        self.tell(|state| {
            if state.events.len() >= EVENTS {
                state.events.pop_front();
                tracing::warn!("events wait for a caller that does not fetch them: the oldest is dropped");
            }
            let revision = state.revision;
            state.events.push_back(RaisedEvent { revision, name, data });
        });
    }
}

impl Manifest {
    /// The inputs as declared: converted, with defaults.
    ///
    /// # Errors
    /// One sentence for people: an input that is unknown, missing, or of another type.
    pub(super) fn checked(
        &self,
        mut given: BTreeMap<String, Value>,
    ) -> Result<BTreeMap<String, Value>, String> {
        let mut inputs = BTreeMap::new();
        for parameter in &self.inputs {
            let name = &parameter.name;
            let value = match given.remove(name) {
                Some(value) => Parameter::from(parameter)
                    .accept(value)
                    .map_err(|e| format!("the input `{name}`: {e}"))?,
                None => {
                    parameter.default.clone().ok_or_else(|| format!("the input `{name}` is not given"))?
                }
            };
            inputs.insert(name.clone(), value);
        }
        match given.keys().next() {
            Some(unknown) => Err(format!("there is no input `{unknown}`")),
            None => Ok(inputs),
        }
    }
}
