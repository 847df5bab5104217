//! A robot whose guard is in another process.
//!
//! Questions hold up the thread that asks, as calls of a robot in this process do, for a fraction of a millisecond. Commands are
//! sent at once. Faults come with the states.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use armarium_bus::control::{ControlReader, ControlSender};
use armarium_bus::{AliveToken, Key, Message, Payload, Reply, Session, keys};
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
use crate::{Fault, LeaseError, LeaseLimits, Load, Model, RobotError, Sensed, SensedWrench, newest};

/// A robot without a state for so long is lost.
const LOST_AFTER: Duration = Duration::from_millis(500);
/// How long a robot is looked for.
const FOUND_WITHIN: Duration = Duration::from_secs(3);
/// How long an answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// A robot whose guard is in another process.
#[derive(Debug)]
pub struct RemoteRobot {
    shared: Arc<Shared>,
    /// The lease's end where this process ends.
    _token: AliveToken,
    _states: ControlReader,
    watching: JoinHandle<()>,
}

struct Shared {
    name: String,
    model: Arc<Model>,
    session: Session,
    keys: Keys,
    token: String,
    epoch: u64,
    sensed: newest::Sender<Arc<Sensed>>,
    commands: ControlSender,
    /// The number of the newest state.
    number: AtomicU64,
    /// What the newest state says of leases.
    faults: Mutex<BTreeMap<String, Fault>>,
    /// Why no more states come.
    lost: Mutex<Option<String>>,
    arrived: AtomicBool,
}

impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared").field("name", &self.name).finish_non_exhaustive()
    }
}

impl RemoteRobot {
    /// Connects to the robot `name` of `agent`, which has to be one of this `model`, as the agent `caller`. Needs a
    /// multi-threaded tokio runtime.
    ///
    /// # Errors
    /// [`RobotError::Remote`] when it is not there, or another robot.
    pub async fn connect(
        session: &Session,
        (agent, name): (&str, &str),
        model: &Arc<Model>,
        caller: &str,
    ) -> Result<Self, RobotError> {
        let named = format!("{agent}/{name}");
        let remote = |why: String| RobotError::Remote { robot: named.clone(), why };
        let keys = Keys::of(agent, name).map_err(|error| remote(error.to_string()))?;
        let asked = session.query_until(&keys.description, FOUND_WITHIN).await;
        let described: RobotDescription =
            answer(asked.map_err(|error| error.to_string())).map_err(|error| remote(error.to_string()))?;
        if let Some(what) = RobotDescription::of(model, 0).differs(&described) {
            let robot = model.name();
            return Err(remote(format!("it is not the robot `{robot}` as this process knows it: {what}")));
        }
        let failed = |error: armarium_bus::SessionError| remote(error.to_string());
        let token = keys::alive(caller, &format!("robot {}", session.id()))
            .map_err(|error| remote(error.to_string()))?;
        let alive = session.alive(&token).await.map_err(failed)?;
        let commands = session.control_sender(&keys.command, &RobotCommand::SCHEMA.encoding()).await;
        let commands = commands.map_err(failed)?;
        let first = Sensed {
            stamp_ns: 0,
            position: model.zero(),
            velocity: vec![0.0; model.joints().len()],
            wrenches: vec![SensedWrench::default(); model.wrenches().len()],
        };
        let shared = Arc::new(Shared {
            name: named.clone(),
            model: Arc::clone(model),
            session: session.clone(),
            token: token.as_str().into(),
            epoch: described.epoch,
            sensed: newest::Sender::new(Arc::new(first)),
            commands,
            number: AtomicU64::new(0),
            faults: Mutex::default(),
            lost: Mutex::default(),
            arrived: AtomicBool::new(false),
            keys,
        });
        let taking = Arc::clone(&shared);
        let states =
            session.control_reader(shared.keys.state.clone(), move |message| taking.take(&message)).await;
        let states = states.map_err(failed)?;
        let watching = tokio::spawn(Arc::clone(&shared).watch());
        Ok(Self { shared, _token: alive, _states: states, watching })
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
fn answer<T: Payload>(asked: Result<Reply, String>) -> Result<T, String> {
    match asked? {
        Reply::Message(message) => {
            read(&message.encoding, &message.payload).map_err(|error| error.to_string())
        }
        Reply::Refusal { encoding, payload } => {
            let refused: Result<RobotRefusal, _> = read(&encoding, &payload);
            Err(refused.map_or_else(|error| error.to_string(), |refused| refused.reason))
        }
    }
}

impl Shared {
    /// A state, on a thread of the link.
    fn take(&self, message: &Message) {
        if self.lost.lock().is_some() {
            return;
        }
        let state: RobotState = match read(&message.encoding, &message.payload) {
            Ok(state) => state,
            Err(error) => return self.lose(&error.to_string()),
        };
        if state.epoch != self.epoch {
            return self.lose("its guard was started again");
        }
        let before = self.number.fetch_max(state.number, Ordering::AcqRel);
        if self.arrived.swap(true, Ordering::AcqRel) && state.number <= before {
            return;
        }
        self.faults.lock().clone_from(&state.faults);
        match state.sensed(&self.model) {
            Some(sensed) => self.sensed.send(Arc::new(sensed)),
            None => self.lose("a state is not of its joints and sensors"),
        }
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
                    return self.lose(&format!("it has sent no state for {} ms", LOST_AFTER.as_millis()));
                }
            }
        }
    }

    fn act(&self, wanted: Do) -> Result<Done, RobotError> {
        let remote = |why| RobotError::Remote { robot: self.name.clone(), why };
        answer(self.asked(&self.keys.to_do, written(&wanted))).map_err(remote)
    }

    fn asked(&self, key: &Key, message: (String, Vec<u8>)) -> Result<Reply, String> {
        if let Some(lost) = self.lost.lock().clone() {
            return Err(lost);
        }
        let (encoding, payload) = message;
        self.session.ask(key, (&encoding, payload), ANSWER_WITHIN).map_err(|error| error.to_string())
    }
}

impl Robot for RemoteRobot {
    fn model(&self) -> &Arc<Model> {
        &self.shared.model
    }

    fn sensed(&self) -> newest::NewestReceiver<Arc<Sensed>> {
        self.shared.sensed.subscribe()
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
        let unreachable = |why| LeaseError::Unreachable { why };
        let reply = self.shared.asked(&self.shared.keys.lease, written(&question)).map_err(unreachable)?;
        if let Reply::Refusal { encoding, payload } = &reply
            && let Ok(LeaseRefused { why }) = read(encoding, payload)
        {
            return Err(why);
        }
        let Leased { lease } = answer(Ok(reply)).map_err(unreachable)?;
        let limbs = limbs.iter().filter_map(|limb| self.shared.model.find_limb(limb).cloned()).collect();
        let (shared, number, fault) = (Arc::clone(&self.shared), AtomicU64::new(0), Mutex::default());
        Ok(Lease::new(RemoteCommander { shared, limbs, lease, number, fault }))
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
    shared: Arc<Shared>,
    limbs: Vec<Limb>,
    lease: String,
    /// The number of the next command.
    number: AtomicU64,
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
        let number = self.number.fetch_add(1, Ordering::Relaxed);
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
            *fault = self.shared.faults.lock().get(&self.lease).cloned().or(lost);
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
