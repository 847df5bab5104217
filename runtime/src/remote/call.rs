//! One call that another agent has started here: its activation, its state for the caller, and its lease.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

use super::LEASE;
use super::wire::{Ended, RaisedEvent, Status};
use crate::activation::{Activation, Report};
use crate::exec::Stop;
use crate::skill::{Failure, MAX_EVENTS};

/// The state of the call that the caller polls.
#[derive(Debug, Default)]
struct CallState {
    revision: u64,
    leaves: Vec<String>,
    events: VecDeque<RaisedEvent>,
    /// Events that were dropped so far because the queue was full.
    dropped: u64,
    ended: Option<Ended>,
}

/// A call that runs or has ended.
#[derive(Debug)]
pub(super) struct Call {
    state: watch::Sender<CallState>,
    heard: Mutex<Instant>,
    cancel: CancellationToken,
}

impl Call {
    /// A new call; `cancel` is the token in its skill's context.
    pub(super) fn new(cancel: CancellationToken) -> Self {
        Self { state: watch::channel(CallState::default()).0, heard: Mutex::new(Instant::now()), cancel }
    }

    pub(super) fn cancel(&self) {
        self.cancel.cancel();
    }

    pub(super) fn has_ended(&self) -> bool {
        self.state.borrow().ended.is_some()
    }

    /// Renews the lease and returns what is new to the caller. Waits up to `wait` if nothing is.
    pub(super) async fn poll(&self, seen: u64, wait: Duration) -> Status {
        *self.heard.lock() = Instant::now();
        let mut changes = self.state.subscribe();
        let news = changes.wait_for(|state| state.revision > seen || state.ended.is_some());
        // After a timeout the status is returned unchanged.
        let _ = timeout(wait, news).await.is_ok();
        self.status(seen)
    }

    pub(super) fn status(&self, seen: u64) -> Status {
        let state = self.state.borrow();
        Status {
            revision: state.revision,
            leaves: state.leaves.clone(),
            events: state.events.iter().filter(|e| e.revision > seen).cloned().collect(),
            dropped: state.dropped,
            ended: state.ended.clone(),
        }
    }

    fn lease(&self) -> Instant {
        *self.heard.lock() + LEASE
    }

    /// Runs the skill to its end. Cancels it if the caller stops polling. If it then does not return within
    /// `grace`, it is stuck, and `stop` is called with its name.
    pub(super) async fn run(
        self: Arc<Self>,
        name: String,
        mut activation: Activation,
        grace: Duration,
        stop: Stop,
    ) {
        let mut deadline = None;
        let ended = loop {
            let (lease, until) = (self.lease(), deadline.unwrap_or_else(Instant::now));
            tokio::select! {
                biased;
                report = activation.next() => match report {
                    Report::Ended(result) => break result,
                    other => self.tell(other),
                },
                () = self.cancel.cancelled(), if deadline.is_none() => deadline = Some(Instant::now() + grace),
                () = sleep_until(lease), if deadline.is_none() => {
                    // A poll may have renewed the lease meanwhile.
                    if self.lease() <= Instant::now() {
                        tracing::warn!(call = %name, "its caller is gone: it is cancelled");
                        self.cancel();
                    }
                }
                () = sleep_until(until), if deadline.is_some() => {
                    tracing::error!(call = %name, "it did not return after it was cancelled");
                    stop(&name);
                    break Err(Failure::new("it is stuck: it did not return after it was cancelled"));
                }
            }
        };
        self.tell(Report::Ended(ended));
    }

    fn tell(&self, report: Report) {
        self.state.send_modify(|state| {
            state.revision += 1;
            match report {
                Report::Event { name, data } => {
                    if state.events.len() >= MAX_EVENTS {
                        state.events.pop_front();
                        state.dropped += 1;
                    }
                    state.events.push_back(RaisedEvent { revision: state.revision, name, data });
                }
                Report::Dropped { count, .. } => state.dropped += count,
                Report::Inside(leaves) => state.leaves = leaves,
                Report::Ended(result) => state.ended = Some(result.into()),
            }
        });
    }
}
