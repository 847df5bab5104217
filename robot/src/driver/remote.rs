//! A driver in another process. It is claimed when it is connected to, and released when this is dropped.
//!
//! Of the samples that have come the newest is taken: a guard that is late goes on with what is. A driver in lockstep sends a
//! sample again when it hears nothing; then the same targets are sent again. What comes on its key and is no sample of it is passed
//! over; if nothing else comes, it is the reason why the driver is lost.

use std::fmt;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use armarium_bus::control::{ControlReader, ControlSender};
use armarium_bus::{CodecError, Message, Payload, Session, SessionError};
use parking_lot::{Condvar, Mutex};
use tokio::time::Instant;

use super::wire::{Claim, Description, Keys, Release, WireSample, WireTargets, described};
use super::{Driver, DriverClock, DriverError, Mismatch, TimedSample};
use crate::message::{pose, read, written};
use crate::throttled::Throttled;
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
    refusals: Throttled,
}

/// The newest sample that nobody has fetched.
#[derive(Default)]
struct Inbox {
    come: Mutex<Come>,
    arrived: Condvar,
    /// Called at each sample, if somebody asked for it.
    call: OnceLock<Box<dyn Fn() + Send + Sync>>,
    strangers: Throttled,
}

#[derive(Debug, Default)]
struct Come {
    /// Of the driver's start; nothing counts before it is known.
    epoch: Option<u64>,
    newest: Option<WireSample>,
    /// When the last one came.
    last: Option<Instant>,
    /// What else has come since the last sample.
    stranger: Option<Stranger>,
}

/// What is no sample of the driver.
#[derive(Clone, Debug, thiserror::Error)]
enum Stranger {
    #[error("it is of another start of the driver, or of another one of the name")]
    Epoch,
    #[error(transparent)]
    Message(#[from] CodecError),
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
        let reader = session.control_reader(keys.sample.clone(), move |message| offered.offer(&message));
        let reader = reader.await.map_err(unreachable)?;
        let encoding = WireTargets::SCHEMA.encoding();
        let targets = session.control_sender(&keys.targets, &encoding).await.map_err(unreachable)?;
        // What it is comes before the claim: a driver of another robot is left alone.
        let asked = session.query_until(&keys.description, FOUND_WITHIN).await.map_err(unreachable)?;
        let before = described(&name, &asked)?;
        let order = Order::of(&before, model, &name)?;
        inbox.come.lock().epoch = Some(before.epoch);
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
            refusals: Throttled::default(),
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

    /// The next sample that is new.
    fn newer(&mut self) -> Result<WireSample, DriverError> {
        let within = match self.described.clock {
            DriverClock::Lockstep => ASKED_AFTER,
            DriverClock::Realtime => LOST_AFTER,
        };
        let last = self.inbox.come.lock().last;
        let until = last.unwrap_or_else(Instant::now) + within;
        loop {
            let left = match self.described.clock {
                DriverClock::Lockstep => within,
                // Samples that are not new do not count.
                DriverClock::Realtime => until.saturating_duration_since(Instant::now()),
            };
            let Some(sample) = self.inbox.wait(left) else {
                self.is_there(within)?;
                continue;
            };
            if self.is_new(&sample)? {
                return Ok(sample);
            }
        }
    }

    /// Whether a sample is a later one than the last. The targets for one that came again are sent again.
    fn is_new(&mut self, sample: &WireSample) -> Result<bool, DriverError> {
        if sample.claims > self.described.claims {
            let reason = "somebody else has claimed it since, as it had heard no targets for too long".into();
            return Err(DriverError::Refused { driver: self.name.clone(), reason });
        }
        if let Some(reason) = &sample.refused {
            self.refusals.warn(format_args!("the driver `{}` refused {reason}", self.name));
        }
        let Some((last, _)) = self.last else { return Ok(true) };
        if sample.number == last && !self.sent.is_empty() {
            self.targets.send(self.sent.clone()).map_err(|source| self.unreachable(source))?;
        }
        Ok(sample.number > last)
    }

    /// Whether a driver that has been silent may be waited for: one in lockstep may compute for long.
    fn is_there(&self, silent: Duration) -> Result<(), DriverError> {
        let driver = || self.name.clone();
        match self.inbox.come.lock().stranger.take() {
            Some(Stranger::Epoch) => return Err(DriverError::Restarted { driver: driver() }),
            Some(Stranger::Message(source)) => return Err(DriverError::Message { driver: driver(), source }),
            None => {}
        }
        let lost = DriverError::Silent { driver: driver(), silent_ms: silent.as_millis() as u64 };
        if self.described.clock == DriverClock::Realtime {
            return Err(lost);
        }
        let asked = self.session.ask(&self.keys.description, ("", Vec::new()), ASKED_AFTER);
        let now = described(&self.name, &asked.map_err(|_| lost)?)?;
        if now.epoch == self.described.epoch {
            Ok(())
        } else {
            Err(DriverError::Restarted { driver: driver() })
        }
    }

    /// A new sample in the order of the model.
    fn taken(&mut self, sample: WireSample) -> Result<TimedSample, DriverError> {
        if let Some((_, before_ns)) = self.last
            && sample.stamp_ns <= before_ns
        {
            let (driver, after_ns) = (self.name.clone(), sample.stamp_ns);
            return Err(DriverError::Clock { driver, before_ns, after_ns });
        }
        self.last = Some((sample.number, sample.stamp_ns));
        let WireSample { stamp_ns, braked, position, velocity, wrenches, bodies, .. } = sample;
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
        let bodies = bodies.into_iter().map(|(name, at)| (name, pose(at)));
        // What is no pose is no body, either.
        let bodies = bodies.filter(|(_, at)| at.to_homogeneous().iter().all(|c| c.is_finite()));
        Ok(TimedSample { stamp_ns, sample, braked, bodies: bodies.collect() })
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

    fn bodies(&self) -> Vec<String> {
        self.described.bodies.clone()
    }

    fn sample(&mut self) -> Result<TimedSample, DriverError> {
        let sample = self.newer()?;
        self.taken(sample)
    }

    fn call_on_arrival(&mut self, call: Box<dyn Fn() + Send + Sync>) -> bool {
        self.described.clock == DriverClock::Realtime && self.inbox.call.set(call).is_ok()
    }

    fn arrived(&mut self) -> Result<Option<TimedSample>, DriverError> {
        let Some(sample) = self.inbox.come.lock().newest.take() else { return Ok(None) };
        if self.is_new(&sample)? { self.taken(sample).map(Some) } else { Ok(None) }
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

impl fmt::Debug for Inbox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Inbox").field("come", &self.come).finish_non_exhaustive()
    }
}

impl Inbox {
    /// A message, on a thread of the link: a sample of the driver replaces what has not been fetched.
    fn offer(&self, message: &Message) {
        let sample = read::<WireSample>(&message.encoding, &message.payload);
        let mut come = self.come.lock();
        let Some(epoch) = come.epoch else { return };
        let stranger = match sample {
            Ok(sample) if sample.epoch == epoch => {
                *come = Come {
                    epoch: Some(epoch),
                    newest: Some(sample),
                    last: Some(Instant::now()),
                    stranger: None,
                };
                self.arrived.notify_one();
                drop(come);
                return self.call.get().into_iter().for_each(|call| call());
            }
            Ok(_) => Stranger::Epoch,
            Err(error) => error.into(),
        };
        self.strangers.warn(format_args!("a message on `{}` is ignored: {stranger}", message.key));
        come.stranger = Some(stranger);
    }

    fn wait(&self, within: Duration) -> Option<WireSample> {
        let mut come = self.come.lock();
        let _ = self.arrived.wait_while_for(&mut come, |come| come.newest.is_none(), within);
        come.newest.take()
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
            return Err(other(Mismatch::Rate { hz: *rate_hz }));
        }
        let joints = places("joint", &own, joints).map_err(other)?;
        Ok(Self { joints, wrenches: places("wrench sensor", &sensors, wrenches).map_err(other)? })
    }
}

/// Where each of the robot's own names is among those of the driver.
fn places(kind: &'static str, own: &[&str], driven: &[String]) -> Result<Vec<usize>, Mismatch> {
    if let Some(strange) = driven.iter().find(|name| !own.contains(&name.as_str())) {
        return Err(Mismatch::Unknown { kind, name: strange.clone(), known: own.join(", ") });
    }
    if driven.len() > own.len() {
        return Err(Mismatch::Twice { kind });
    }
    let place = |name: &&str| driven.iter().position(|other| other == name);
    let missing = |name: &&str| Mismatch::Missing { kind, name: (*name).to_owned() };
    own.iter().map(|name| place(name).ok_or_else(|| missing(name))).collect()
}
