//! Events between the charts of agents: what a run sends leaves in its order, and what others send is raised in the
//! charts that run here. How events travel is a [`Post`]; this knows no network.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use armarium_values::Value;
use futures::future::{BoxFuture, join_all};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::timeout;

use super::Controller;
use super::skills::Message;

/// Agents that one run sends to.
const MOST_AGENTS: usize = 64;
/// Events to one agent that may wait.
const MOST_LETTERS: usize = 64;
/// How long the end of a run waits for what it has sent.
const LAST: Duration = Duration::from_secs(1);

/// An event on its way to another agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Letter {
    /// The agent, or `agent/Chart`.
    pub to: String,
    /// The event's name.
    pub event: String,
    /// What comes with it.
    pub data: Value,
}

/// Takes events to other agents.
pub trait Post: Send + Sync {
    /// Delivers one event; those to one agent are given one after the other. An error is one sentence for people.
    fn deliver(&self, letter: Letter) -> BoxFuture<'static, Result<(), String>>;
}

/// How a run and those of other agents tell each other events.
#[derive(Clone, Default)]
pub struct Others {
    /// Takes events to them; without it, sending is an error.
    pub post: Option<Arc<dyn Post>>,
    /// Where what they send is heard.
    pub hearers: Hearers,
}

impl fmt::Debug for Others {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Others").field("hearers", &self.hearers).finish_non_exhaustive()
    }
}

/// The charts that run now and hear what other agents send; clones share the same charts.
#[derive(Clone, Debug, Default)]
pub struct Hearers(Arc<Mutex<Hall>>);

#[derive(Debug, Default)]
struct Hall {
    next: u64,
    /// A chart's name and the way into its run.
    seats: BTreeMap<u64, (String, Controller)>,
}

/// A run's place among the hearers, until it is dropped.
#[derive(Debug)]
pub(super) struct Seat {
    hearers: Hearers,
    number: u64,
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.hearers.hall(|hall| hall.seats.remove(&self.number));
    }
}

impl Hearers {
    fn hall<T>(&self, with: impl FnOnce(&mut Hall) -> T) -> T {
        with(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(super) fn join(&self, chart: &str, controller: Controller) -> Seat {
        let number = self.hall(|hall| {
            hall.next += 1;
            hall.seats.insert(hall.next, (chart.to_owned(), controller));
            hall.next
        });
        Seat { hearers: self.clone(), number }
    }

    /// Raises an event in the charts that run, or in those of one name. Gives how many have heard it.
    ///
    /// # Errors
    /// One sentence for people, when a chart has no room for it.
    pub fn raise(&self, chart: Option<&str>, event: &str, data: &Value) -> Result<u32, String> {
        self.hall(|hall| {
            let mut heard = 0;
            for (name, controller) in hall.seats.values() {
                if chart.is_some_and(|chart| chart != name) {
                    continue;
                }
                if !controller.raise(event, data.clone()) {
                    return Err(format!(
                        "the chart `{name}` has no room for `{event}`: too many events wait"
                    ));
                }
                heard += 1;
            }
            Ok(heard)
        })
    }
}

/// What a run sends.
pub(super) struct Outbox {
    post: Option<Arc<dyn Post>>,
    /// The run's own queue: what cannot be delivered comes back as `error.communication`.
    queue: mpsc::Sender<Message>,
    /// A queue and its task by agent, so that a slow one holds up no other.
    routes: BTreeMap<String, (mpsc::Sender<Letter>, JoinHandle<()>)>,
}

impl Outbox {
    pub(super) fn new(post: Option<Arc<dyn Post>>, queue: mpsc::Sender<Message>) -> Self {
        Self { post, queue, routes: BTreeMap::new() }
    }

    pub(super) fn send(&mut self, letter: Letter) {
        let Some(post) = &self.post else {
            return self.back(&letter, "this run has no connection to others");
        };
        let agent = letter.to.split('/').next().unwrap_or_default().to_owned();
        if !self.routes.contains_key(&agent) {
            if self.routes.len() >= MOST_AGENTS {
                return self.back(&letter, "a run sends to no more than 64 agents");
            }
            let (sender, letters) = mpsc::channel(MOST_LETTERS);
            let task = tokio::spawn(carry(Arc::clone(post), letters, self.queue.clone()));
            self.routes.insert(agent.clone(), (sender, task));
        }
        if let Some((route, _)) = self.routes.get(&agent)
            && let Err(full) = route.try_send(letter)
        {
            self.back(&full.into_inner(), "too many events to it wait already");
        }
    }

    fn back(&self, letter: &Letter, why: &str) {
        if self.queue.try_send(undelivered(letter, why)).is_err() {
            tracing::warn!("an event could not be sent, and the queue is full");
        }
    }

    /// Waits until what was sent has been delivered, for a while.
    pub(super) async fn close(&mut self) {
        if self.routes.is_empty() {
            return;
        }
        let tasks = std::mem::take(&mut self.routes).into_values().map(|(_, task)| task);
        if timeout(LAST, join_all(tasks)).await.is_err() {
            tracing::warn!("the run has ended, and not all that it sent to other agents has been delivered");
        }
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.routes.values().for_each(|(_, task)| task.abort());
    }
}

async fn carry(post: Arc<dyn Post>, mut letters: mpsc::Receiver<Letter>, queue: mpsc::Sender<Message>) {
    while let Some(letter) = letters.recv().await {
        if let Err(why) = post.deliver(letter.clone()).await {
            // The run may have ended; then nobody is left to be told.
            let _ = queue.send(undelivered(&letter, &why)).await.is_ok();
        }
    }
}

fn undelivered(letter: &Letter, why: &str) -> Message {
    let Letter { to, event, .. } = letter;
    let reason = format!("`{event}` cannot be sent to `{to}`: {why}");
    tracing::warn!("{reason}");
    let data = [("reason", reason.into()), ("event", event.as_str().into()), ("to", to.as_str().into())];
    Message::Event { name: "error.communication".into(), data: Value::record(data) }
}
