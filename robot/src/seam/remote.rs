//! A robot whose guard is in another process.
//!
//! Questions hold up the thread that asks, as calls of a robot in this process do, for a fraction of a millisecond. Commands are
//! sent at once. Faults come with the states. A state that is none of the robot is passed over; if no other comes, it is the
//! reason why the robot is lost.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::control::{ControlReader, ControlSender};
use armarium_bus::{
    AliveToken, CodecError, Key, KeyError, Message, Payload, Reply, Session, SessionError, keys,
};
use parking_lot::Mutex;
use tokio::task::JoinHandle;

use super::lease::{Commander, Lease, bad_command};
use super::robot::Robot;
use super::wire::{
    Do, Done, Keys, LeaseQuestion, LeaseRefused, Leased, RobotCommand, RobotDescription, RobotRefusal,
    RobotState, WireLoad,
};
use crate::message::{read, written};
use crate::model::Limb;
use crate::planning::KnownBox;
use crate::throttled::Throttled;
use crate::{Fault, LeaseError, LeaseLimits, Load, Model, RobotError, Sensed, SensedWrench, newest};

/// A robot without a state for so long is lost. Its guard gives up a driver before, and tells the reason.
const LOST_AFTER: Duration = Duration::from_millis(700);
/// How long a robot is looked for.
const FOUND_WITHIN: Duration = Duration::from_secs(3);
/// How long an answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// A robot whose guard is in another process.
#[derive(Debug)]
pub struct RemoteRobot {
    shared: Arc<RobotConnection>,
    /// The lease's end where this process ends.
    _token: AliveToken,
    _states: ControlReader,
    watching: JoinHandle<()>,
}

struct RobotConnection {
    name: String,
    model: Arc<Model>,
    session: Session,
    keys: Keys,
    token: String,
    epoch: u64,
    sensed: newest::Sender<Arc<Sensed>>,
    commands: ControlSender,
    /// Number and stamp of the newest state.
    newest: Mutex<Option<(u64, u64)>>,
    /// Why states were passed over since then.
    passed_over: Mutex<Option<PassedOver>>,
    warned: Throttled,
    /// What the newest state says of leases.
    faults: Mutex<BTreeMap<u64, Fault>>,
    /// Why no more states come.
    lost: Mutex<Option<String>>,
}

/// Why a state is none of this robot.
#[derive(Clone, Debug, thiserror::Error)]
enum PassedOver {
    #[error(transparent)]
    Message(#[from] CodecError),
    #[error("its guard was started again, or there are two of the name")]
    Epoch,
    #[error("its clock went from {before_ns} to {after_ns} ns")]
    Clock { before_ns: u64, after_ns: u64 },
    #[error("a state is not of its joints and sensors, or not all of its numbers are finite")]
    Shape,
}

/// Why a question has no answer that can be used.
#[derive(Debug, thiserror::Error)]
enum AskError {
    #[error(transparent)]
    Session(#[from] SessionError),
    #[error(transparent)]
    Message(#[from] CodecError),
    #[error(transparent)]
    Key(#[from] KeyError),
    /// It says why it refuses, or it is known why it cannot be asked.
    #[error("{reason}")]
    Refused { reason: String },
    #[error("it is not the robot `{robot}` as this process knows it: {what}")]
    Other { robot: String, what: &'static str },
}

impl fmt::Debug for RobotConnection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RobotConnection").field("name", &self.name).finish_non_exhaustive()
    }
}

impl RemoteRobot {
    /// Connects to the robot `name` of `agent`, which has to be one of this `model`, as the agent `caller`. Needs a
    /// multi-threaded tokio runtime.
    ///
    /// # Errors
    /// [`RobotError::Remote`] when it is not there, has no driver, or is another robot.
    pub async fn connect(
        session: &Session,
        (agent, name): (&str, &str),
        model: &Arc<Model>,
        caller: &str,
    ) -> Result<Self, RobotError> {
        let named = format!("{agent}/{name}");
        let connected = Self::connected(session, (agent, name), model, caller).await;
        connected.map_err(|error| RobotError::Remote { robot: named, why: error.to_string() })
    }

    async fn connected(
        session: &Session,
        (agent, name): (&str, &str),
        model: &Arc<Model>,
        caller: &str,
    ) -> Result<Self, AskError> {
        let keys = Keys::of(agent, name)?;
        let described: RobotDescription =
            answer(session.query_until(&keys.description, FOUND_WITHIN).await?)?;
        if let Some(what) = RobotDescription::of(model, 0).differs(&described) {
            return Err(AskError::Other { robot: model.name().into(), what });
        }
        if let Some(reason) = described.lost {
            return Err(AskError::Refused { reason });
        }
        let token = keys::alive(caller, &format!("robot {}", session.id()))?;
        let alive = session.alive(&token).await?;
        let commands = session.control_sender(&keys.command, &RobotCommand::SCHEMA.encoding()).await?;
        let first = Sensed {
            stamp_ns: 0,
            position: model.zero(),
            velocity: vec![0.0; model.joints().len()],
            wrenches: vec![SensedWrench::default(); model.wrenches().len()],
        };
        let shared = Arc::new(RobotConnection {
            name: format!("{agent}/{name}"),
            model: Arc::clone(model),
            session: session.clone(),
            token: token.as_str().into(),
            epoch: described.epoch,
            sensed: newest::Sender::new(Arc::new(first)),
            commands,
            newest: Mutex::default(),
            passed_over: Mutex::default(),
            warned: Throttled::default(),
            faults: Mutex::default(),
            lost: Mutex::default(),
            keys,
        });
        let taking = Arc::clone(&shared);
        let states =
            session.control_reader(shared.keys.state.clone(), move |message| taking.take(&message)).await?;
        let watching = tokio::spawn(Arc::clone(&shared).watch());
        Ok(Self { shared, _token: alive, _states: states, watching })
    }

    /// The key of this process's liveliness token.
    #[cfg(test)]
    pub(super) fn token(&self) -> &str {
        &self.shared.token
    }

    /// What the newest state says of leases.
    #[cfg(test)]
    pub(super) fn faults(&self) -> BTreeMap<u64, Fault> {
        self.shared.faults.lock().clone()
    }

    /// Which start of its guard it is.
    #[cfg(test)]
    pub(super) fn epoch(&self) -> u64 {
        self.shared.epoch
    }

    /// Does something, for its effect alone.
    fn tell(&self, wanted: Do) {
        if let Err(error) = self.shared.act(wanted) {
            tracing::warn!("{error}");
        }
    }
}

impl Drop for RemoteRobot {
    fn drop(&mut self) {
        self.watching.abort();
    }
}

/// The content of an answer, or the reason of a refusal.
fn answer<T: Payload>(asked: Reply) -> Result<T, AskError> {
    match asked {
        Reply::Message(message) => Ok(read(&message.encoding, &message.payload)?),
        Reply::Refusal { encoding, payload } => {
            let RobotRefusal { reason } = read(&encoding, &payload)?;
            Err(AskError::Refused { reason })
        }
    }
}

impl RobotConnection {
    /// A message on the key of states, on a thread of the link.
    fn take(&self, message: &Message) {
        if self.lost.lock().is_some() {
            return;
        }
        if let Err(why) = self.take_state(message) {
            self.warned.warn(format_args!("a state of the robot `{}` is passed over: {why}", self.name));
            *self.passed_over.lock() = Some(why);
        }
    }

    fn take_state(&self, message: &Message) -> Result<(), PassedOver> {
        let mut state: RobotState = read(&message.encoding, &message.payload)?;
        if state.epoch != self.epoch {
            return Err(PassedOver::Epoch);
        }
        let (number, stamp_ns, lost) = (state.number, state.stamp_ns, state.lost.take());
        let faults = std::mem::take(&mut state.faults);
        let mut newest = self.newest.lock();
        match *newest {
            // It came again, or too late.
            Some((before, _)) if number <= before => return Ok(()),
            Some((_, before_ns)) if stamp_ns <= before_ns && lost.is_none() => {
                return Err(PassedOver::Clock { before_ns, after_ns: stamp_ns });
            }
            _ => {}
        }
        let sensed = state.sensed(&self.model).ok_or(PassedOver::Shape)?;
        *newest = Some((number, stamp_ns));
        *self.passed_over.lock() = None;
        *self.faults.lock() = faults;
        match lost {
            Some(why) => self.lose(&why),
            None => self.sensed.send(Arc::new(sensed)),
        }
        Ok(())
    }

    /// Tells all who wait why nothing comes any more.
    fn lose(&self, why: &str) {
        self.lost.lock().get_or_insert_with(|| format!("the robot `{}` is lost: {why}", self.name));
        self.sensed.send(self.sensed.borrow());
        self.sensed.close();
    }

    /// Waits until no state has come for too long.
    async fn watch(self: Arc<Self>) {
        let mut sensed = self.sensed.subscribe();
        loop {
            match tokio::time::timeout(LOST_AFTER, sensed.changed()).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return,
                Err(_) => {
                    let passed_over = self.passed_over.lock().take().map(|why| why.to_string());
                    let silent = || format!("it has sent no state for {} ms", LOST_AFTER.as_millis());
                    return self.lose(&passed_over.unwrap_or_else(silent));
                }
            }
        }
    }

    fn act(&self, wanted: Do) -> Result<Done, RobotError> {
        let done = self.asked(&self.keys.to_do, written(&wanted)).and_then(answer);
        done.map_err(|error| RobotError::Remote { robot: self.name.clone(), why: error.to_string() })
    }

    fn asked(&self, key: &Key, message: (String, Vec<u8>)) -> Result<Reply, AskError> {
        if let Some(reason) = self.lost.lock().clone() {
            return Err(AskError::Refused { reason });
        }
        let (encoding, payload) = message;
        Ok(self.session.ask(key, (&encoding, payload), ANSWER_WITHIN)?)
    }
}

impl Robot for RemoteRobot {
    fn model(&self) -> &Arc<Model> {
        &self.shared.model
    }

    fn sensed(&self) -> newest::NewestReceiver<Arc<Sensed>> {
        self.shared.sensed.subscribe()
    }

    fn lost(&self) -> Option<String> {
        self.shared.lost.lock().clone()
    }

    fn lease_together(
        &self,
        limbs: &[&str],
        holder: &str,
        limits: LeaseLimits,
        touches: &[String],
    ) -> Result<Lease, LeaseError> {
        let question = LeaseQuestion {
            limbs: limbs.iter().map(|&limb| limb.to_owned()).collect(),
            holder: holder.to_owned(),
            force_n: limits.force_n,
            speed_m_s: limits.speed_m_s,
            touches: touches.to_vec(),
            token: self.shared.token.clone(),
        };
        let unreachable = |error: AskError| LeaseError::Unreachable { why: error.to_string() };
        let reply = self.shared.asked(&self.shared.keys.lease, written(&question)).map_err(unreachable)?;
        if let Reply::Refusal { encoding, payload } = &reply
            && let Ok(LeaseRefused { why }) = read(encoding, payload)
        {
            return Err(why);
        }
        let Leased { lease, number } = answer(reply).map_err(unreachable)?;
        let limbs = limbs.iter().filter_map(|limb| self.shared.model.find_limb(limb).cloned()).collect();
        let (shared, next, fault) = (Arc::clone(&self.shared), AtomicU64::new(0), Mutex::default());
        Ok(Lease::new(RemoteCommander { shared, limbs, lease, number, next, fault }))
    }

    fn tare(&self, wrench: &str) -> Result<(), RobotError> {
        self.shared.act(Do::Tare { wrench: wrench.to_owned() }).map(drop)
    }

    fn set_load(&self, hand: &str, load: Option<Load>) -> Result<(), RobotError> {
        let load = load.as_ref().map(WireLoad::from);
        self.shared.act(Do::SetLoad { hand: hand.to_owned(), load }).map(drop)
    }

    fn loads(&self) -> BTreeMap<String, Load> {
        let loads = self.shared.act(Do::Loads).map(|done| done.loads);
        loads.unwrap_or_default().into_iter().map(|(hand, load)| (hand, load.into())).collect()
    }

    fn set_surroundings(&self, boxes: Vec<KnownBox>) -> Result<(), RobotError> {
        self.shared.act(Do::SetSurroundings { boxes: boxes.iter().map(Into::into).collect() }).map(drop)
    }

    fn stop(&self, reason: &str) {
        self.tell(Do::Stop { reason: reason.to_owned() });
    }

    fn reset(&self) {
        self.tell(Do::Reset);
    }

    fn set_speed_scale(&self, scale: f64) -> Result<(), RobotError> {
        self.shared.act(Do::SetSpeedScale { scale }).map(drop)
    }

    fn say(&self, utterance: &str) {
        self.tell(Do::Say { utterance: utterance.to_owned() });
    }
}

/// The commander of a lease of a robot in another process.
#[derive(Debug)]
struct RemoteCommander {
    shared: Arc<RobotConnection>,
    limbs: Vec<Limb>,
    /// Its secret.
    lease: String,
    /// Its name in states.
    number: u64,
    /// The number of the next command.
    next: AtomicU64,
    /// The first fault that was seen here.
    fault: Mutex<Option<Fault>>,
}

impl Commander for RemoteCommander {
    fn command(&self, velocities: &[f64]) -> Result<(), Fault> {
        if let Some(fault) = self.fault() {
            return Err(fault);
        }
        let limbs: Vec<&Limb> = self.limbs.iter().collect();
        let bad = bad_command(velocities, &limbs, &self.shared.model);
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let command = RobotCommand { lease: self.lease.clone(), number, velocity: velocities.to_vec() };
        // What is bad is sent, too: the guard brakes.
        let sent = self.shared.commands.send(written(&command).1);
        let gone = sent.err().map(|error| Fault::Stopped { reason: error.to_string() });
        match bad.or(gone) {
            None => Ok(()),
            Some(fault) => Err(self.fault.lock().get_or_insert(fault).clone()),
        }
    }

    fn fault(&self) -> Option<Fault> {
        let mut fault = self.fault.lock();
        if fault.is_none() {
            let lost = self.shared.lost.lock().clone().map(|reason| Fault::Stopped { reason });
            *fault = self.shared.faults.lock().get(&self.number).cloned().or(lost);
        }
        fault.clone()
    }
}

impl Drop for RemoteCommander {
    fn drop(&mut self) {
        if let Err(error) = self.shared.act(Do::Release { lease: self.lease.clone() }) {
            tracing::warn!("a lease cannot be given back; it ends with this process: {error}");
        }
    }
}
