//! A skill as a task: started, cancelled, its panic caught, its end always reported once.

use std::any::Any;
use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use armarium_values::Value;
use futures::FutureExt;
use tokio::sync::{mpsc, watch};
use tokio::task::AbortHandle;
use tokio_util::sync::CancellationToken;

use super::watchdog::Polls;
use crate::channels::Channels;
use crate::program::StateId;
use crate::skill::{Failure, Limits, Skill, SkillContext, SkillResult};

/// Events of one skill that may wait.
const EVENTS: usize = 64;

/// What reaches the executor's queue.
#[derive(Debug)]
pub(super) enum Message {
    Ended {
        activation: u64,
        result: SkillResult,
    },
    Event {
        name: String,
        data: Value,
    },
    /// What is active inside a skill has changed.
    Inside {
        state: String,
        leaves: Vec<String>,
    },
    /// A skill has not yielded for too long.
    Hangs {
        reason: String,
    },
    /// Somebody ends the run.
    Stopped {
        reason: String,
    },
}

/// What a skill is started with.
#[derive(Debug)]
pub(super) struct Start {
    pub(super) activation: u64,
    pub(super) state: StateId,
    /// The state's path.
    pub(super) path: String,
    pub(super) inputs: BTreeMap<String, Value>,
    pub(super) limits: Limits,
}

/// A skill that has been started. Dropping it cancels and aborts the task, if that still runs.
#[derive(Debug)]
pub(super) struct Running {
    state: StateId,
    cancel: CancellationToken,
    task: AbortHandle,
}

impl Drop for Running {
    fn drop(&mut self) {
        self.cancel.cancel();
        self.task.abort();
    }
}

impl Running {
    pub(super) fn start(
        skill: Arc<dyn Skill>,
        start: Start,
        channels: Channels,
        queue: &mpsc::Sender<Message>,
        declared: Vec<String>,
        polls: Polls,
    ) -> Self {
        let cancel = CancellationToken::new();
        let (events, incoming) = mpsc::channel(EVENTS);
        let (inside, within) = watch::channel(Vec::new());
        let state = start.state;
        let context = SkillContext {
            state: start.path,
            inputs: start.inputs,
            limits: start.limits,
            cancel: cancel.clone(),
            channels,
            events,
            inside,
        };
        let told = Told { incoming, within, declared };
        let driving = Box::pin(drive(skill, context, told, start.activation, queue.clone()));
        let task = tokio::spawn(polls.of(driving));
        Self { state, cancel, task: task.abort_handle() }
    }

    /// A skill that could not even be started.
    pub(super) fn failed(
        state: StateId,
        activation: u64,
        result: SkillResult,
        queue: &mpsc::Sender<Message>,
    ) -> Self {
        let queue = queue.clone();
        let task = tokio::spawn(async move {
            report(&queue, Message::Ended { activation, result }).await;
        });
        Self { state, cancel: CancellationToken::new(), task: task.abort_handle() }
    }

    pub(super) fn cancel(&self) {
        self.cancel.cancel();
    }

    pub(super) fn state(&self) -> StateId {
        self.state
    }
}

async fn report(queue: &mpsc::Sender<Message>, message: Message) {
    if queue.send(message).await.is_err() {
        tracing::debug!("a skill ended after its run");
    }
}

/// What a skill tells while it runs.
struct Told {
    incoming: mpsc::Receiver<(String, Value)>,
    within: watch::Receiver<Vec<String>>,
    /// Events that it may raise.
    declared: Vec<String>,
}

async fn drive(
    skill: Arc<dyn Skill>,
    context: SkillContext,
    told: Told,
    activation: u64,
    queue: mpsc::Sender<Message>,
) {
    let Told { mut incoming, mut within, declared } = told;
    let state = context.state.clone();
    let pass = |(name, data): (String, Value)| {
        let known = declared.contains(&name);
        if !known {
            tracing::warn!(state, event = name, "a skill raised an event that it does not declare");
        }
        known.then_some(Message::Event { name, data })
    };
    let acting = AssertUnwindSafe(async { skill.run(context).await }).catch_unwind();
    tokio::pin!(acting);
    let result = loop {
        tokio::select! {
            biased;
            Some(event) = incoming.recv() => {
                if let Some(message) = pass(event) {
                    report(&queue, message).await;
                }
            }
            Ok(()) = within.changed() => {
                let leaves = within.borrow_and_update().clone();
                report(&queue, Message::Inside { state: state.clone(), leaves }).await;
            }
            result = &mut acting => break result,
        }
    };
    while let Ok(event) = incoming.try_recv() {
        if let Some(message) = pass(event) {
            report(&queue, message).await;
        }
    }
    let result = result.unwrap_or_else(|panic| Err(Failure::new(words(panic.as_ref()))));
    report(&queue, Message::Ended { activation, result }).await;
}

fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    format!("the skill panicked: {}", text.as_deref().unwrap_or("no message"))
}
