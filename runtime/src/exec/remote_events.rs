//! Events between the charts of agents: a run's events are sent in order, and events from others are raised in the
//! charts that run here. A [`Transport`] carries the events; this module does not know the network.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use armarium_values::Value;
use futures::future::{BoxFuture, join_all};
use parking_lot::Mutex;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::timeout;

use super::Controller;
use super::skills::ExecutorMessage;
use crate::program::{EventRefused, Program};

/// Largest number of agents that one run sends to.
const MAX_AGENTS: usize = 64;
/// Largest number of events that wait for one agent.
const MAX_WAITING: usize = 64;
/// How long a sender waits for whether a chart takes its event: less than the lease after which nobody answers.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(200);
/// How long the end of a run waits for the delivery of its events.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// An event on its way to another agent.
#[derive(Clone, Debug, PartialEq)]
pub struct RemoteEvent {
    /// The agent, or `agent/Chart`.
    pub to: String,
    /// The event's name.
    pub event: String,
    /// Its data.
    pub data: Value,
}

/// Why an event does not reach the charts that it is for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum DeliveryError {
    /// No agent of that name answers in time.
    #[error("no agent `{agent}` answers")]
    NoAgent { agent: String },
    /// The agent runs no chart that it could be for; `None` is any chart.
    #[error("`{agent}` runs no chart {}now", chart.as_ref().map_or(String::new(), |c| format!("`{c}` ")))]
    NoChart { agent: String, chart: Option<String> },
    /// Two processes of that name have received it.
    #[error("two agents are called `{agent}`, the processes {} and {}, and both have heard it", .instances[0], .instances[1])]
    TwoAgents { agent: String, instances: [String; 2] },
    /// The queue of a chart is full.
    #[error("the chart `{chart}` has no room for `{event}`: too many events wait")]
    QueueFull { chart: String, event: String },
    /// The chart does not take it.
    #[error(transparent)]
    Refused(#[from] EventRefused),
    /// It has arrived, and changed nothing: no chart takes it as it is now.
    #[error("`{agent}` has it, but {reason}")]
    Dropped { agent: String, reason: String },
    /// The task that delivers it has ended.
    #[error("it was lost: {0}")]
    Lost(tokio::task::JoinError),
    /// The transport failed.
    #[error(transparent)]
    Transport(Box<dyn std::error::Error + Send + Sync>),
}

impl DeliveryError {
    /// A failure of the transport.
    pub fn transport(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Transport(Box::new(error))
    }
}

/// Delivers events to other agents.
pub trait Transport: Send + Sync {
    /// Delivers one event. Events for one agent are passed one after the other.
    fn deliver(&self, sent: RemoteEvent) -> BoxFuture<'static, Result<(), DeliveryError>>;
}

/// The connection of a run to those of other agents.
#[derive(Clone, Default)]
pub struct Peers {
    /// Delivers events to them; without it, sending is an error.
    pub transport: Option<Arc<dyn Transport>>,
    /// Receives their events.
    pub subscribers: Subscribers,
}

impl fmt::Debug for Peers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Peers").field("subscribers", &self.subscribers).finish_non_exhaustive()
    }
}

/// The running charts that receive events from other agents; clones share the same charts.
#[derive(Clone, Debug, Default)]
pub struct Subscribers(Arc<Mutex<Runs>>);

#[derive(Debug, Default)]
struct Runs {
    next: u64,
    /// The charts and the controllers of their runs.
    by_number: BTreeMap<u64, (Arc<Program>, Controller)>,
}

/// What became of an event that was raised in running charts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Raised {
    /// How many charts received it.
    pub charts: u32,
    /// Why it changed nothing, where that is known of all of them.
    pub dropped: Option<String>,
}

/// The entry of a run among the subscribers, until it is dropped.
#[derive(Debug)]
pub(super) struct Subscription {
    subscribers: Subscribers,
    number: u64,
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.subscribers.runs(|runs| runs.by_number.remove(&self.number));
    }
}

impl Subscribers {
    fn runs<T>(&self, with: impl FnOnce(&mut Runs) -> T) -> T {
        with(&mut self.0.lock())
    }

    pub(super) fn join(&self, chart: Arc<Program>, controller: Controller) -> Subscription {
        let number = self.runs(|runs| {
            runs.next += 1;
            runs.by_number.insert(runs.next, (chart, controller));
            runs.next
        });
        Subscription { subscribers: self.clone(), number }
    }

    /// Raises an event in the running charts, or only in those of one name, and waits for a short time until it is known whether
    /// they take it.
    ///
    /// # Errors
    /// [`DeliveryError::QueueFull`]; [`DeliveryError::Refused`] when charts run and none of them knows it.
    pub async fn raise(
        &self,
        chart: Option<&str>,
        event: &str,
        data: &Value,
    ) -> Result<Raised, DeliveryError> {
        let answers = self.raise_in_all(chart, event, data)?;
        let charts = u32::try_from(answers.len()).unwrap_or(u32::MAX);
        let answered = join_all(answers.into_iter().map(|answer| timeout(ANSWER_TIMEOUT, answer))).await;
        // One that does not answer yet may take it.
        let dropped = |answer: &Result<Result<Option<String>, _>, _>| match answer {
            Ok(Ok(dropped)) => dropped.clone(),
            _ => None,
        };
        let reasons: Option<Vec<String>> = answered.iter().map(dropped).collect();
        Ok(Raised { charts, dropped: reasons.and_then(|reasons| reasons.into_iter().next()) })
    }

    /// As [`Self::raise`]; gives what each chart that received it will answer.
    fn raise_in_all(
        &self,
        chart: Option<&str>,
        event: &str,
        data: &Value,
    ) -> Result<Vec<oneshot::Receiver<Option<String>>>, DeliveryError> {
        self.runs(|runs| {
            let (mut received, mut refused) = (Vec::new(), None);
            for (program, controller) in runs.by_number.values() {
                if chart.is_some_and(|chart| chart != program.name()) {
                    continue;
                }
                if let Err(error) = program.accepts(event, data) {
                    controller.refused(event, error.to_string());
                    refused = Some(error);
                    continue;
                }
                let Some(answer) = controller.offer(event, data.clone()) else {
                    let chart = program.name().to_owned();
                    return Err(DeliveryError::QueueFull { chart, event: event.into() });
                };
                received.push(answer);
            }
            match refused {
                Some(error) if received.is_empty() => Err(error.into()),
                _ => Ok(received),
            }
        })
    }
}

/// The events that a run sends.
pub(super) struct Outbox {
    transport: Option<Arc<dyn Transport>>,
    /// The run's own queue: an event that cannot be delivered comes back as `error.communication`.
    queue: mpsc::Sender<ExecutorMessage>,
    /// A queue and its task per agent, so that a slow agent does not delay the others.
    routes: BTreeMap<String, (mpsc::Sender<RemoteEvent>, JoinHandle<()>)>,
}

impl Outbox {
    pub(super) fn new(transport: Option<Arc<dyn Transport>>, queue: mpsc::Sender<ExecutorMessage>) -> Self {
        Self { transport, queue, routes: BTreeMap::new() }
    }

    pub(super) fn send(&mut self, sent: RemoteEvent) {
        let Some(transport) = &self.transport else {
            return self.return_undelivered(&sent, "this run has no connection to others");
        };
        let agent = sent.to.split('/').next().unwrap_or_default().to_owned();
        if !self.routes.contains_key(&agent) {
            if self.routes.len() >= MAX_AGENTS {
                return self.return_undelivered(&sent, "a run sends to no more than 64 agents");
            }
            let (sender, events) = mpsc::channel(MAX_WAITING);
            let task = tokio::spawn(deliver_all(Arc::clone(transport), events, self.queue.clone()));
            self.routes.insert(agent.clone(), (sender, task));
        }
        if let Some((route, _)) = self.routes.get(&agent)
            && let Err(full) = route.try_send(sent)
        {
            self.return_undelivered(&full.into_inner(), "too many events to it wait already");
        }
    }

    fn return_undelivered(&self, sent: &RemoteEvent, why: &str) {
        if self.queue.try_send(undelivered(sent, why)).is_err() {
            tracing::warn!("an event could not be sent, and the queue is full");
        }
    }

    /// Waits, for a limited time, until the sent events have been delivered.
    pub(super) async fn close(&mut self) {
        if self.routes.is_empty() {
            return;
        }
        let tasks = std::mem::take(&mut self.routes).into_values().map(|(_, task)| task);
        if timeout(CLOSE_TIMEOUT, join_all(tasks)).await.is_err() {
            tracing::warn!("the run has ended, and not all that it sent to other agents has been delivered");
        }
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.routes.values().for_each(|(_, task)| task.abort());
    }
}

async fn deliver_all(
    transport: Arc<dyn Transport>,
    mut events: mpsc::Receiver<RemoteEvent>,
    queue: mpsc::Sender<ExecutorMessage>,
) {
    while let Some(sent) = events.recv().await {
        // What arrives and is not taken is no failure of the sender: nobody waits for it there now.
        if let Err(why) = transport.deliver(sent.clone()).await
            && !matches!(why, DeliveryError::Dropped { .. })
        {
            // If the run has ended, there is no receiver for this message.
            let _ = queue.send(undelivered(&sent, &why.to_string())).await.is_ok();
        }
    }
}

fn undelivered(sent: &RemoteEvent, why: &str) -> ExecutorMessage {
    let RemoteEvent { to, event, .. } = sent;
    let reason = format!("`{event}` cannot be sent to `{to}`: {why}");
    tracing::warn!("{reason}");
    let data =
        [("reason", reason.as_str().into()), ("event", event.as_str().into()), ("to", to.as_str().into())];
    ExecutorMessage::Dropped { name: event.clone(), error: Some(Value::record(data)), reason }
}
