//! The skills of one run: each is a task whose reports go into the run's queue.

use armarium_values::Value;
use tokio::sync::{mpsc, oneshot};
use tokio::task::AbortHandle;
use tokio_util::sync::CancellationToken;

use super::watchdog::Polls;
use crate::activation::{Activation, Report};
use crate::program::StateId;

/// A message in the executor's queue.
#[derive(Debug)]
pub(super) enum ExecutorMessage {
    /// An event from outside. Who waits for it is told why it changed nothing, if it did not.
    Event { name: String, data: Value, answer: Option<oneshot::Sender<Option<String>>> },
    /// An event that could not be delivered to another agent: the data of its `error.communication`; or that came from outside and
    /// was refused to its sender.
    Dropped { name: String, reason: String, error: Option<Value> },
    /// Somebody chooses how the skill of a state ends.
    Chosen { state: String, outcome: String },
    /// Somebody acted on the run.
    Acted { what: String },
    /// A report of a skill.
    Skill { activation: u64, report: Report },
    /// A skill has not yielded for too long.
    Hangs { reason: String },
    /// A request to end the run.
    Stopped { reason: String },
}

/// A running skill. Dropping it cancels the skill and aborts its task.
#[derive(Debug)]
pub(super) struct ActiveSkill {
    state: StateId,
    cancel: CancellationToken,
    task: AbortHandle,
}

impl Drop for ActiveSkill {
    fn drop(&mut self) {
        self.cancel.cancel();
        self.task.abort();
    }
}

impl ActiveSkill {
    /// Starts a skill in a task of its own. `cancel` is the token in its context.
    pub(super) fn start(
        (number, state): (u64, StateId),
        activation: Activation,
        cancel: CancellationToken,
        queue: mpsc::Sender<ExecutorMessage>,
        polls: Polls,
    ) -> Self {
        let task = tokio::spawn(polls.of(Box::pin(drive(activation, number, queue))));
        Self { state, cancel, task: task.abort_handle() }
    }

    pub(super) fn cancel(&self) {
        self.cancel.cancel();
    }

    pub(super) fn state(&self) -> StateId {
        self.state
    }
}

async fn drive(mut activation: Activation, number: u64, queue: mpsc::Sender<ExecutorMessage>) {
    loop {
        let report = activation.next().await;
        let ended = matches!(report, Report::Ended(_));
        if queue.send(ExecutorMessage::Skill { activation: number, report }).await.is_err() {
            tracing::debug!("a skill told something after its run");
        }
        if ended {
            return;
        }
    }
}
