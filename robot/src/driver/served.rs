//! Offers a driver of this process to guards in others.
//!
//! A thread takes the driver's samples and sends them; targets are judged where they arrive ([`Gate`]) and applied by the thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use armarium_bus::control::{ControlReader, ControlSender};
use armarium_bus::{IncomingQuery, Payload, Queryable, Session};
use parking_lot::{Condvar, Mutex};
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::gate::{Gate, GateRefusal, WATCHDOG_NS};
use super::wire::{Claim, Description, DriverRefusal, Keys, Release, WireSample, WireTargets};
use super::{Driver, DriverClock, DriverError, TimedSample};
use crate::message::{read, wire_pose, written};
use crate::{JointTargets, Model};

/// Claims and questions that wait.
const QUEUE: usize = 64;
/// A driver in lockstep that hears nothing sends its sample again so often.
const AGAIN: Duration = Duration::from_millis(100);

/// A driver that is offered until this is dropped.
#[derive(Debug)]
pub struct DriverServer {
    ends: Arc<AtomicBool>,
    _reader: ControlReader,
    _tasks: JoinSet<()>,
}

/// What the thread, the link's threads and those who claim share.
#[derive(Debug)]
struct ServedDriver {
    gate: Mutex<Gate>,
    arrived: Condvar,
    began: Instant,
    described: Description,
}

impl DriverServer {
    /// Offers a driver of the robot `model` as `agent/name`. Needs a multi-threaded tokio runtime, and real time.
    ///
    /// # Errors
    /// [`DriverError::Session`] when a name cannot be part of a key, or the session has closed.
    pub async fn start(
        session: &Session,
        (agent, name): (&str, &str),
        model: &Model,
        driver: impl Driver + 'static,
    ) -> Result<Self, DriverError> {
        let keys = Keys::of(agent, name)?;
        let unreachable = |source| DriverError::Session { driver: format!("{agent}/{name}"), source };
        let (clock, period) = (driver.clock(), driver.period());
        let described = Description {
            joints: model.joints().iter().map(|joint| joint.name.clone()).collect(),
            wrenches: model.wrenches().iter().map(|sensor| sensor.name.clone()).collect(),
            rate_hz: 1.0 / period.as_secs_f64(),
            clock,
            epoch: session.now_ns(),
            watchdog_s: WATCHDOG_NS as f64 * 1e-9,
            bodies: driver.bodies(),
            claims: 0,
        };
        let gate = Gate::new(described.joints.len(), clock, period.as_nanos() as u64, described.epoch);
        let (gate, arrived, began) = (Mutex::new(gate), Condvar::new(), Instant::now());
        let shared = Arc::new(ServedDriver { gate, arrived, began, described });
        let sender = session.control_sender(&keys.sample, &WireSample::SCHEMA.encoding()).await;
        let sender = sender.map_err(unreachable)?;
        let taking = Arc::clone(&shared);
        let reader = session.control_reader(keys.targets, move |message| {
            let now_ns = taking.now_ns();
            let mut gate = taking.gate.lock();
            match read::<WireTargets>(&message.encoding, &message.payload) {
                Ok(targets) => gate.offer(targets, now_ns),
                Err(error) => gate.refuse(error.into()),
            }
            taking.arrived.notify_one();
        });
        let reader = reader.await.map_err(unreachable)?;
        let mut tasks = JoinSet::new();
        // The description last: who knows it can claim the driver.
        for key in [keys.claim, keys.description] {
            let questions = session.declare_queryable(key.clone(), QUEUE).await.map_err(unreachable)?;
            tasks.spawn(Arc::clone(&shared).answer(questions, key));
        }
        let ends = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&ends);
        tasks.spawn_blocking(move || shared.drive(driver, &sender, &ended));
        Ok(Self { ends, _reader: reader, _tasks: tasks })
    }
}

impl Drop for DriverServer {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

impl ServedDriver {
    fn now_ns(&self) -> u64 {
        self.began.elapsed().as_nanos() as u64
    }

    async fn answer(self: Arc<Self>, mut questions: Queryable, key: armarium_bus::Key) {
        while let Some(query) = questions.next().await {
            let answered = match self.claimed(&query) {
                Ok(()) => {
                    let claims = self.gate.lock().claims();
                    let (encoding, payload) = written(&Description { claims, ..self.described.clone() });
                    query.reply(&key, &encoding, payload).await
                }
                Err(refused) => {
                    let (encoding, payload) = written(&DriverRefusal { reason: refused.to_string() });
                    query.refuse(&encoding, payload).await
                }
            };
            if let Err(error) = answered {
                tracing::debug!("nobody waits for an answer on {key}: {error}");
            }
        }
    }

    /// A question without a payload changes nothing.
    fn claimed(&self, query: &IncomingQuery) -> Result<(), GateRefusal> {
        let IncomingQuery { encoding, payload, .. } = query;
        if payload.is_empty() {
            return Ok(());
        }
        if Release::SCHEMA.check(encoding).is_ok() {
            let Release { commander } = read(encoding, payload)?;
            self.gate.lock().release(&commander);
            return Ok(());
        }
        self.gate.lock().claim(read::<Claim>(encoding, payload)?, self.now_ns())
    }

    /// Samples, sends, and applies what comes, until the driver is lost or this ends.
    fn drive(&self, mut driver: impl Driver, sender: &ControlSender, ends: &AtomicBool) {
        let mut number = 0;
        while !ends.load(Ordering::Relaxed) {
            let Ok(timed) = driver.sample() else { return };
            let (braked, refused) = self.gate.lock().begin_sample(number, self.now_ns());
            let refused = refused.map(|refused| refused.to_string());
            let payload = written(&self.sample(number, timed, braked, refused)).1;
            let sent = sender.send(payload.clone());
            let targets = match driver.clock() {
                DriverClock::Lockstep => self.wait(|| drop(sender.send(payload.clone())), ends),
                DriverClock::Realtime => self.gate.lock().take(),
            };
            let applied = match targets {
                Some(targets) => driver.apply(&targets),
                None => {
                    if braked {
                        driver.brake();
                    }
                    Ok(())
                }
            };
            if sent.is_err() || applied.is_err() {
                break;
            }
            number += 1;
        }
        driver.brake();
    }

    /// Waits for targets, and does something again and again meanwhile.
    fn wait(&self, again: impl Fn(), ends: &AtomicBool) -> Option<JointTargets> {
        let mut gate = self.gate.lock();
        loop {
            let targets = gate.take();
            if targets.is_some() || ends.load(Ordering::Relaxed) {
                return targets;
            }
            if self.arrived.wait_for(&mut gate, AGAIN).timed_out() {
                again();
            }
        }
    }

    fn sample(&self, number: u64, timed: TimedSample, braked: bool, refused: Option<String>) -> WireSample {
        let TimedSample { stamp_ns, sample, bodies, .. } = timed;
        let wrench = |wrench: &crate::ForceTorque| {
            let (force, torque) = (wrench.force, wrench.torque);
            [force.x, force.y, force.z, torque.x, torque.y, torque.z]
        };
        WireSample {
            epoch: self.described.epoch,
            number,
            stamp_ns,
            wrenches: sample.wrenches.iter().map(wrench).collect(),
            position: sample.position,
            velocity: sample.velocity,
            braked,
            refused,
            claims: self.gate.lock().claims(),
            bodies: bodies.iter().map(|(name, pose)| (name.clone(), wire_pose(pose))).collect(),
        }
    }
}
