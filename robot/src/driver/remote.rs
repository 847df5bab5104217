//! A driver in another process. It is claimed when it is connected to, and released when this is dropped.
//!
//! Of the samples that have come the newest is taken: a guard that is late goes on with what is. A driver in lockstep sends a
//! sample again when it hears nothing; then the same targets are sent again.

use std::sync::Arc;
use std::time::Duration;

use armarium_bus::control::{ControlReader, ControlSender};
use armarium_bus::{Message, Payload, Session, SessionError};
use parking_lot::{Condvar, Mutex};

use super::wire::{Claim, Description, Keys, Release, WireSample, WireTargets, described};
use super::{Driver, DriverClock, DriverError, TimedSample};
use crate::message::{read, written};
use crate::{ForceTorque, JointTargets, Model, Sample};

/// A driver in real time without a sample for so long is lost.
const LOST_AFTER: Duration = Duration::from_millis(500);
/// A driver in lockstep without a sample for so long is asked whether it is there still: it may compute for long.
const ASKED_AFTER: Duration = Duration::from_secs(1);
/// How long a driver is looked for.
const FOUND_WITHIN: Duration = Duration::from_secs(3);
/// How long the release of a driver may take.
const RELEASE_WITHIN: Duration = Duration::from_millis(200);

/// A driver in another process.
#[derive(Debug)]
pub struct RemoteDriver {
    name: String,
    session: Session,
    keys: Keys,
    commander: String,
    described: Description,
    /// For each joint and sensor of the model, its place in the messages.
    order: Order,
    inbox: Arc<Inbox>,
    _reader: ControlReader,
    targets: ControlSender,
    /// Number and stamp of the last sample.
    last: Option<(u64, u64)>,
    /// The last targets as they were sent.
    sent: Vec<u8>,
    claimed: bool,
}

/// The newest message that nobody has fetched.
#[derive(Debug, Default)]
struct Inbox {
    newest: Mutex<Option<Message>>,
    arrived: Condvar,
}

#[derive(Debug)]
struct Order {
    joints: Vec<usize>,
    wrenches: Vec<usize>,
}

impl RemoteDriver {
    /// Connects to the driver `name` of `agent` and claims it for `caller`. It has to have the joints and wrench sensors of
    /// `model`, in any order.
    ///
    /// # Errors
    /// [`DriverError`] when it is not there, is of another robot, or is commanded by somebody else.
    pub async fn connect(
        session: &Session,
        (agent, name): (&str, &str),
        model: &Model,
        caller: &str,
    ) -> Result<Self, DriverError> {
        let keys = Keys::of(agent, name)?;
        let name = format!("{agent}/{name}");
        let unreachable = |source| DriverError::Session { driver: name.clone(), source };
        let inbox = Arc::new(Inbox::default());
        let offered = Arc::clone(&inbox);
        let reader = session.control_reader(keys.sample.clone(), move |message| offered.offer(message));
        let reader = reader.await.map_err(unreachable)?;
        let encoding = WireTargets::SCHEMA.encoding();
        let targets = session.control_sender(&keys.targets, &encoding).await.map_err(unreachable)?;
        // What it is comes before the claim: a driver of another robot is left alone.
        let asked = session.query_until(&keys.description, FOUND_WITHIN).await.map_err(unreachable)?;
        let before = described(&name, &asked)?;
        let order = Order::of(&before, model, &name)?;
        let commander = format!("{} {}", session.id(), session.now_ns());
        let claim = Claim { commander: commander.clone(), caller: caller.into() };
        let (encoding, payload) = written(&claim);
        let answer =
            session.query_one(&keys.claim, "", Some((&encoding, payload))).await.map_err(unreachable)?;
        let described = described(&name, &answer)?;
        let session = session.clone();
        let driver = Self {
            name,
            session,
            keys,
            commander,
            described,
            order,
            inbox,
            _reader: reader,
            targets,
            last: None,
            sent: Vec::new(),
            claimed: true,
        };
        // One that was started anew in between may have another order.
        if driver.described.epoch != before.epoch {
            return Err(DriverError::Restarted { driver: driver.name.clone() });
        }
        Ok(driver)
    }

    /// Its name, `AGENT/DRIVER`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The next message that is a new sample.
    fn newer(&mut self) -> Result<WireSample, DriverError> {
        let within = match self.described.clock {
            DriverClock::Lockstep => ASKED_AFTER,
            DriverClock::Realtime => LOST_AFTER,
        };
        loop {
            let Some(message) = self.inbox.wait(within) else {
                if self.described.clock == DriverClock::Lockstep && self.is_there() {
                    continue;
                }
                let silent_ms = within.as_millis() as u64;
                return Err(DriverError::Silent { driver: self.name.clone(), silent_ms });
            };
            let unreadable = |source| DriverError::Message { driver: self.name.clone(), source };
            let sample: WireSample = read(&message.encoding, &message.payload).map_err(unreadable)?;
            if sample.epoch != self.described.epoch {
                return Err(DriverError::Restarted { driver: self.name.clone() });
            }
            if let Some(reason) = &sample.refused {
                tracing::warn!("the driver `{}` refused {reason}", self.name);
            }
            match self.last {
                Some((number, _)) if sample.number == number && !self.sent.is_empty() => {
                    self.targets.send(self.sent.clone()).map_err(|source| self.unreachable(source))?;
                }
                Some((number, _)) if sample.number <= number => {}
                _ => return Ok(sample),
            }
        }
    }

    fn is_there(&self) -> bool {
        self.session.ask(&self.keys.description, ("", Vec::new()), ASKED_AFTER).is_ok()
    }

    fn unreachable(&self, source: SessionError) -> DriverError {
        DriverError::Session { driver: self.name.clone(), source }
    }
}

impl Driver for RemoteDriver {
    fn clock(&self) -> DriverClock {
        self.described.clock
    }

    fn period(&self) -> Duration {
        // The rate was checked when the driver was connected to.
        Duration::from_secs_f64(1.0 / self.described.rate_hz)
    }

    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        let sample = self.newer()?;
        if let Some((_, before_ns)) = self.last
            && sample.stamp_ns <= before_ns
        {
            return Err(DriverError::Clock {
                driver: self.name.clone(),
                before_ns,
                after_ns: sample.stamp_ns,
            });
        }
        self.last = Some((sample.number, sample.stamp_ns));
        let WireSample { stamp_ns, braked, position, velocity, wrenches, .. } = sample;
        let joint = |values: &[f64]| {
            self.order.joints.iter().map(|&i| values.get(i).copied().unwrap_or(f64::NAN)).collect()
        };
        let wrench = |&i: &usize| {
            let [fx, fy, fz, tx, ty, tz] = wrenches.get(i).copied().unwrap_or([f64::NAN; 6]);
            ForceTorque { force: [fx, fy, fz].into(), torque: [tx, ty, tz].into() }
        };
        // What is missing is no number, which the guard knows how to treat.
        let wrenches = self.order.wrenches.iter().map(wrench).collect();
        let sample = Sample { position: joint(&position), velocity: joint(&velocity), wrenches };
        Ok(TimedSample { stamp_ns, sample, braked })
    }

    fn apply(&mut self, targets: &JointTargets) -> Result<(), DriverError> {
        let Some((number, _)) = self.last else { return Ok(()) };
        let n = self.order.joints.len();
        let (mut position, mut velocity) = (vec![0.0; n], vec![0.0; n]);
        for (joint, &place) in self.order.joints.iter().enumerate() {
            (position[place], velocity[place]) = (targets.position[joint], targets.velocity[joint]);
        }
        let epoch = self.described.epoch;
        let targets = WireTargets { commander: self.commander.clone(), epoch, number, position, velocity };
        self.sent = written(&targets).1;
        self.targets.send(self.sent.clone()).map_err(|source| self.unreachable(source))
    }

    fn brake(&mut self) {
        if std::mem::take(&mut self.claimed) {
            let (encoding, payload) = written(&Release { commander: self.commander.clone() });
            // Without an answer it brakes by itself.
            let _ = self.session.ask(&self.keys.claim, (&encoding, payload), RELEASE_WITHIN);
        }
    }
}

impl Drop for RemoteDriver {
    fn drop(&mut self) {
        self.brake();
    }
}

impl Inbox {
    /// Replaces what has not been fetched.
    fn offer(&self, message: Message) {
        *self.newest.lock() = Some(message);
        self.arrived.notify_one();
    }

    fn wait(&self, within: Duration) -> Option<Message> {
        let mut newest = self.newest.lock();
        if newest.is_none() {
            let _ = self.arrived.wait_for(&mut newest, within);
        }
        newest.take()
    }
}

impl Order {
    fn of(described: &Description, model: &Model, driver: &str) -> Result<Self, DriverError> {
        let Description { joints, wrenches, rate_hz, .. } = described;
        let own: Vec<&str> = model.joints().iter().map(|joint| joint.name.as_str()).collect();
        let sensors: Vec<&str> = model.wrenches().iter().map(|sensor| sensor.name.as_str()).collect();
        let other =
            |what| DriverError::OtherRobot { driver: driver.into(), robot: model.name().into(), what };
        if !(1.0..=10_000.0).contains(rate_hz) {
            return Err(other(format!("it samples with {rate_hz} Hz; 1 to 10000 are possible")));
        }
        let joints = places("joint", &own, joints).map_err(other)?;
        Ok(Self { joints, wrenches: places("wrench sensor", &sensors, wrenches).map_err(other)? })
    }
}

/// Where each of the robot's own names is among those of the driver.
fn places(kind: &str, own: &[&str], driven: &[String]) -> Result<Vec<usize>, String> {
    if let Some(strange) = driven.iter().find(|name| !own.contains(&name.as_str())) {
        return Err(format!("the robot has no {kind} `{strange}`; it has {}", own.join(", ")));
    }
    if driven.len() > own.len() {
        return Err(format!("it names a {kind} twice"));
    }
    let place = |name: &&str| driven.iter().position(|other| other == name);
    own.iter()
        .map(|name| place(name).ok_or_else(|| format!("it does not have the {kind} `{name}`")))
        .collect()
}
