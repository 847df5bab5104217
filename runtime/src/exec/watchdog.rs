//! Checks by the wall clock that each skill yields. The executor's time may be virtual, and it stands still while a
//! skill blocks its thread. Therefore the check runs on its own thread.
//!
//! It does not affect a run in which every skill yields.

use std::collections::BTreeMap;
use std::fmt;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};
use tokio::sync::mpsc;

use super::OnStuck;
use super::skills::ExecutorMessage;

/// How long a skill may run without yielding before it counts as hanging, by default.
const HANG_TIMEOUT: Duration = Duration::from_secs(10);

/// When a skill's poll began, ns since the watchdog was made; 0 between polls.
type Since = Arc<AtomicU64>;

struct WatchdogState {
    began: Instant,
    skills: Mutex<BTreeMap<u64, (String, Since)>>,
    on_stuck: Mutex<Option<OnStuck>>,
    over: Mutex<bool>,
    wake: Condvar,
}

pub(super) struct Watchdog {
    shared: Arc<WatchdogState>,
    queue: mpsc::Sender<ExecutorMessage>,
    limit: Duration,
    on_hang: Option<OnStuck>,
}

/// Monitors the polls of one skill; removed when dropped.
pub(super) struct Polls {
    activation: u64,
    since: Since,
    shared: Arc<WatchdogState>,
}

impl fmt::Debug for Polls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Polls").field("activation", &self.activation).finish_non_exhaustive()
    }
}

impl WatchdogState {
    fn now(&self) -> u64 {
        u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX).max(1)
    }

    /// The state of a skill that has been in one poll for longer than `limit`.
    fn hanging(&self, limit: Duration) -> Option<String> {
        let now = self.now();
        let limit = u64::try_from(limit.as_nanos()).unwrap_or(u64::MAX);
        let skills = self.skills.lock();
        let hangs = |since: &Since| match since.load(Ordering::Relaxed) {
            0 => false,
            since => now.saturating_sub(since) > limit,
        };
        skills.values().find(|(_, since)| hangs(since)).map(|(state, _)| state.clone())
    }
}

impl Watchdog {
    #[expect(
        clippy::disallowed_methods,
        reason = "it watches skills by the wall's clock, which goes on when a skill blocks the thread"
    )]
    pub(super) fn new(on_stuck: Option<OnStuck>, queue: mpsc::Sender<ExecutorMessage>) -> Self {
        let shared = WatchdogState {
            began: Instant::now(),
            skills: Mutex::default(),
            on_stuck: Mutex::new(on_stuck),
            over: Mutex::new(false),
            wake: Condvar::new(),
        };
        Self { shared: Arc::new(shared), queue, limit: HANG_TIMEOUT, on_hang: None }
    }

    pub(super) fn set(&mut self, limit: Duration, on_hang: Option<OnStuck>) {
        (self.limit, self.on_hang) = (limit.max(Duration::from_millis(1)), on_hang);
    }

    /// Starts the thread, which ends with the watchdog.
    pub(super) fn start(&mut self) {
        let shared = Arc::clone(&self.shared);
        let (queue, limit, on_hang) = (self.queue.clone(), self.limit, self.on_hang.take());
        let thread = std::thread::Builder::new().name("watchdog".into());
        if let Err(error) = thread.spawn(move || watch(&shared, &queue, limit, on_hang)) {
            tracing::error!(%error, "skills are not watched: there is no thread for it");
        }
    }

    /// Reports the skill of a state as stuck, to the callback that stops the robot.
    pub(super) fn stuck(&self, state: &str) {
        if let Some(on_stuck) = self.shared.on_stuck.lock().as_mut() {
            on_stuck(state);
        }
    }

    pub(super) fn watch(&self, activation: u64, state: &str) -> Polls {
        let since = Since::default();
        self.shared.skills.lock().insert(activation, (state.to_owned(), Arc::clone(&since)));
        Polls { activation, since, shared: Arc::clone(&self.shared) }
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        *self.shared.over.lock() = true;
        self.shared.wake.notify_all();
    }
}

fn watch(
    shared: &WatchdogState,
    queue: &mpsc::Sender<ExecutorMessage>,
    limit: Duration,
    on_hang: Option<OnStuck>,
) {
    let mut over = shared.over.lock();
    while !*over {
        shared.wake.wait_for(&mut over, limit / 4);
        if *over {
            return;
        }
        let Some(state) = shared.hanging(limit) else { continue };
        drop(over);
        let reason = format!("the skill of `{state}` has not yielded for {} s", limit.as_secs_f64());
        tracing::error!(state, "a skill does not yield");
        if let Some(on_stuck) = shared.on_stuck.lock().as_mut() {
            on_stuck(&state);
        }
        // If the executor runs on another thread than the skill, it can still end the run in order.
        if queue.try_send(ExecutorMessage::Hangs { reason }).is_err() {
            tracing::error!(state, "the run could not be told");
        }
        if let Some(mut on_hang) = on_hang {
            on_hang(&state);
        }
        return;
    }
}

impl Polls {
    /// Wraps a future so that each of its polls is monitored.
    pub(super) fn of<F: Future + Unpin>(self, future: F) -> Watched<F> {
        Watched { future, polls: self }
    }
}

impl Drop for Polls {
    fn drop(&mut self) {
        self.shared.skills.lock().remove(&self.activation);
    }
}

pub(super) struct Watched<F> {
    future: F,
    polls: Polls,
}

impl<F: Future + Unpin> Future for Watched<F> {
    type Output = F::Output;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<F::Output> {
        self.polls.since.store(self.polls.shared.now(), Ordering::Relaxed);
        let result = Pin::new(&mut self.future).poll(context);
        self.polls.since.store(0, Ordering::Relaxed);
        result
    }
}
