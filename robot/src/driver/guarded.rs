//! A guard that is stepped with a driver's samples.
//!
//! A driver in lockstep is asked on tokio's clock, one period after the other: under a paused clock all tasks have done what they
//! do at one time before the next sample is waited for, so that a run is the same however long the driver takes. A driver in real
//! time has a thread of its own, which nothing else holds up; where samples come from another process, the guard is stepped by the
//! thread that brings them, because to wake up another one takes as long as a message does, and its own waits for their end.

use std::sync::{Arc, Weak};
use std::time::Duration;

use parking_lot::{Condvar, Mutex};
use tokio::time::Instant;

use super::{Driver, DriverClock, DriverError, TimedSample};
use crate::{Guard, JointTargets, Sample};

/// A delay that is caught up.
const MAX_DELAY: Duration = Duration::from_millis(10);
/// A driver in real time is braked until its first targets have come. Skills begin when it is not, or after so long, ns.
const BEGINS_WITHIN_NS: u64 = 100_000_000;
/// After so long without a sample the thread of a driver looks for the reason.
const QUIET: Duration = Duration::from_millis(100);

/// A guard and the driver below it.
pub struct GuardedDriver {
    guard: Guard,
    driver: Box<dyn Driver>,
    /// The stamp of the first sample, until skills begin, ns.
    waiting_since_ns: Option<u64>,
    begun: bool,
}

impl GuardedDriver {
    /// Puts a guard above a driver.
    pub fn new(guard: Guard, driver: impl Driver + 'static) -> Self {
        Self { guard, driver: Box::new(driver), waiting_since_ns: None, begun: false }
    }

    /// Steps the guard until the driver is lost, or `after` says so, which is called with the stamp of each sample, ns, and what
    /// the robot said. Then the joints brake, and skills are told why.
    ///
    /// # Errors
    /// [`DriverError`] with which the driver was lost.
    pub async fn run(
        self,
        after: impl FnMut(u64, Vec<String>) -> bool + Send + 'static,
    ) -> Result<(), DriverError> {
        match self.driver.clock() {
            DriverClock::Lockstep => self.run_in_lockstep(after).await,
            DriverClock::Realtime => {
                let ended = tokio::task::spawn_blocking(move || self.run_in_real_time(after)).await;
                ended.unwrap_or_else(|panicked| std::panic::resume_unwind(panicked.into_panic()))
            }
        }
    }

    async fn run_in_lockstep(
        mut self,
        mut after: impl FnMut(u64, Vec<String>) -> bool,
    ) -> Result<(), DriverError> {
        let (mut due, period) = (Instant::now(), self.driver.period());
        loop {
            match self.step() {
                Ok(stamp_ns) if after(stamp_ns, self.guard.take_utterances()) => {}
                ended => return self.end(ended),
            }
            // After a long delay in real time the robot's time stays behind: otherwise the guard would take the silence of the
            // commanders for their end.
            due = (due + period).max(Instant::now().checked_sub(MAX_DELAY).unwrap_or(due));
            if due > Instant::now() {
                tokio::time::sleep_until(due).await;
            } else {
                // A time that is over is not waited for: this thread's other tasks, who have been sent the sample, would not come to run.
                tokio::task::yield_now().await;
            }
        }
    }

    fn run_in_real_time(
        mut self,
        mut after: impl FnMut(u64, Vec<String>) -> bool + Send + 'static,
    ) -> Result<(), DriverError> {
        let on_arrival = Arc::new(OnArrival::default());
        let arrived = Arc::downgrade(&on_arrival);
        if self.driver.call_on_arrival(Box::new(move || OnArrival::step(&arrived))) {
            return on_arrival.run(Stepped { guarded: self, after: Box::new(after), steps: 0, ended: None });
        }
        loop {
            match self.step() {
                Ok(stamp_ns) if after(stamp_ns, self.guard.take_utterances()) => {}
                ended => return self.end(ended),
            }
        }
    }

    /// One sample, and its targets.
    pub(super) fn step(&mut self) -> Result<u64, DriverError> {
        let timed = self.driver.sample()?;
        self.step_with(timed)
    }

    fn step_with(&mut self, timed: TimedSample) -> Result<u64, DriverError> {
        let since_ns = *self.waiting_since_ns.get_or_insert(timed.stamp_ns);
        self.begun |= !timed.braked || timed.stamp_ns - since_ns >= BEGINS_WITHIN_NS;
        if !self.begun {
            let Sample { position, .. } = timed.sample;
            let velocity = vec![0.0; position.len()];
            self.driver.apply(&JointTargets { position, velocity })?;
            return Ok(timed.stamp_ns);
        }
        if timed.braked {
            self.guard.drives_have_braked();
        }
        let targets = self.guard.step(timed.stamp_ns, &timed.sample);
        self.driver.apply(targets)?;
        Ok(timed.stamp_ns)
    }

    fn end(mut self, ended: Result<u64, DriverError>) -> Result<(), DriverError> {
        let reason =
            ended.as_ref().err().map_or_else(|| "its driver was left".to_owned(), ToString::to_string);
        // Skills are told first: a driver that is out of reach is waited for when it is to brake.
        self.guard.end(&reason);
        self.driver.brake();
        ended.map(drop)
    }
}

/// A guard that is stepped where samples arrive, from when on its thread has put it here until it takes it out: a driver never ends on
/// a thread of its link.
#[derive(Default)]
struct OnArrival {
    stepped: Mutex<Option<Stepped>>,
    ended: Condvar,
}

struct Stepped {
    guarded: GuardedDriver,
    after: Box<dyn FnMut(u64, Vec<String>) -> bool + Send>,
    steps: u64,
    ended: Option<Result<u64, DriverError>>,
}

impl OnArrival {
    /// On the thread that brings a sample. While the guard's own thread looks after it, that one takes the sample.
    fn step(arrived: &Weak<Self>) {
        let Some(on_arrival) = arrived.upgrade() else { return };
        let Some(mut stepped) = on_arrival.stepped.try_lock() else { return };
        let Some(stepped) = stepped.as_mut() else { return };
        stepped.take_arrived();
        if stepped.ended.is_some() {
            on_arrival.ended.notify_one();
        }
    }

    /// On the guard's own thread, until the end.
    fn run(&self, stepped: Stepped) -> Result<(), DriverError> {
        let mut here = self.stepped.lock();
        let mut stepped = here.insert(stepped);
        // What came before the guard was here.
        stepped.take_arrived();
        while stepped.ended.is_none() {
            let steps = stepped.steps;
            self.ended.wait_for(&mut here, QUIET);
            let Some(still) = here.as_mut() else { return Ok(()) };
            stepped = still;
            if stepped.steps == steps {
                stepped.wait_for_sample();
            }
        }
        let ended = here.take();
        drop(here);
        ended.map_or(Ok(()), |Stepped { guarded, ended, .. }| guarded.end(ended.unwrap_or(Ok(0))))
    }
}

impl Stepped {
    fn take_arrived(&mut self) {
        if self.ended.is_none() {
            let arrived = self.guarded.driver.arrived();
            let stamp_ns =
                arrived.and_then(|timed| timed.map(|timed| self.guarded.step_with(timed)).transpose());
            self.count(stamp_ns.transpose());
        }
    }

    fn wait_for_sample(&mut self) {
        if self.ended.is_none() {
            let stamp_ns = self.guarded.step();
            self.count(Some(stamp_ns));
        }
    }

    fn count(&mut self, stepped: Option<Result<u64, DriverError>>) {
        match stepped {
            None => {}
            Some(Ok(stamp_ns)) if (self.after)(stamp_ns, self.guarded.guard.take_utterances()) => {
                self.steps += 1
            }
            ended => self.ended = ended,
        }
    }
}
