//! Shares a robot with skills in other processes.
//!
//! Leases that others hold are kept here. One ends when it is released, or when the liveliness token of its holder's process is
//! gone; before that, the guard's watchdog brakes what nobody commands. A second after its fault a lease frees its limbs: its
//! holder may be one that has stopped, or is out of reach.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use armarium_bus::control::{ControlReader, ControlSender};
use armarium_bus::{
    IncomingQuery, Key, KeyPattern, Message, Payload, Queryable, Session, SessionError, keys,
};
use parking_lot::Mutex;
use tokio::task::JoinSet;

use super::lease::Lease;
use super::robot::Robot;
use super::wire::{
    Do, Done, Keys, LeaseQuestion, LeaseRefused, Leased, RobotCommand, RobotDescription, RobotRefusal,
    RobotState,
};
use crate::boundary::MAX_NAME;
use crate::message::{read, written};
use crate::throttled::Throttled;
use crate::{Fault, LeaseError, RobotError};

/// Questions that wait.
const QUEUE: usize = 256;
/// Most leases that others hold.
const MAX_LEASES: usize = 64;
/// After so long a holder's token has to be known.
const TOKEN_WITHIN: Duration = Duration::from_secs(1);
/// How long after its fault a lease keeps its limbs, ns of the robot's time.
const FREED_AFTER_NS: u64 = 1_000_000_000;
/// Longest text that is said, letters.
const MAX_SAID: usize = 1000;

/// A robot that is shared until this is dropped.
#[derive(Debug)]
pub struct RobotServer {
    _commands: ControlReader,
    _tasks: JoinSet<()>,
    publishing: JoinSet<()>,
}

/// A lease that somebody in another process holds.
struct Held {
    /// Until its limbs are freed.
    lease: Option<Lease>,
    /// Why they were taken from him, and at which of the robot's times, ns.
    fault: Option<(Fault, u64)>,
    /// Names it in states.
    number: u64,
    token: String,
    /// The number of its last command.
    last: Option<u64>,
}

struct ServedRobot {
    robot: Arc<dyn Robot>,
    session: Session,
    described: RobotDescription,
    leases: Mutex<Leases>,
    ignored: Throttled,
}

#[derive(Default)]
struct Leases {
    /// By their secrets.
    held: BTreeMap<String, Held>,
    /// The number of the last one.
    last: u64,
}

impl RobotServer {
    /// Shares a robot as `agent/name`. Needs a multi-threaded tokio runtime.
    ///
    /// # Errors
    /// [`SessionError`] when a name cannot be part of a key, or the session has closed.
    pub async fn start(
        session: &Session,
        (agent, name): (&str, &str),
        robot: Arc<dyn Robot>,
    ) -> Result<Self, SessionError> {
        let keys = Keys::of(agent, name)?;
        let described = RobotDescription::of(robot.model(), session.now_ns());
        let states = session.control_sender(&keys.state, &RobotState::SCHEMA.encoding()).await?;
        let shared = Arc::new(ServedRobot {
            robot,
            session: session.clone(),
            described,
            leases: Mutex::default(),
            ignored: Throttled::default(),
        });
        let commanded = Arc::clone(&shared);
        let commands =
            session.control_reader(keys.command, move |message| commanded.command(&message)).await?;
        let mut tasks = JoinSet::new();
        let holders = session.watch_alive(&keys::alive_pattern(None, None)?, QUEUE).await?;
        tasks.spawn(Arc::clone(&shared).outlive(holders));
        // The description last: who knows it can ask for the rest.
        for key in [keys.lease, keys.to_do, keys.description] {
            let questions = session.declare_queryable(key.clone(), QUEUE).await?;
            tasks.spawn(Arc::clone(&shared).answer(questions, key));
        }
        let mut publishing = JoinSet::new();
        publishing.spawn(shared.publish(states));
        Ok(Self { _commands: commands, _tasks: tasks, publishing })
    }

    /// Waits until the robot has ended, and its last state with the reason was sent. Questions are still answered: leases are
    /// refused with the reason.
    pub async fn last_state_sent(&mut self) {
        self.publishing.join_next().await;
    }
}

impl ServedRobot {
    /// Sends each state until the robot ends, and that last one.
    async fn publish(self: Arc<Self>, states: ControlSender) {
        let mut sensed = self.robot.sensed();
        let mut number = 0;
        while sensed.changed().await.is_ok() {
            let now = sensed.borrow_and_update();
            let (faults, lost) = (self.leases.lock().faults(now.stamp_ns), self.robot.lost());
            let state = RobotState::of(&now, (self.described.epoch, number), faults, lost);
            if states.send(written(&state).1).is_err() {
                return;
            }
            number += 1;
        }
    }

    /// On a thread of the link. What cannot be read, or is of no lease, moves nothing.
    fn command(&self, message: &Message) {
        let command: RobotCommand = match read(&message.encoding, &message.payload) {
            Ok(command) => command,
            Err(error) => return self.ignored.warn(format_args!("a command is not understood: {error}")),
        };
        let mut leases = self.leases.lock();
        let Some(held) = leases.held.get_mut(&command.lease) else {
            return self.ignored.warn("a command for a lease that nobody holds is ignored");
        };
        if held.last.is_some_and(|last| command.number <= last) {
            let number = command.number;
            return self
                .ignored
                .warn(format_args!("the command {number} came again, or too late, and is ignored"));
        }
        held.last = Some(command.number);
        if let Some(lease) = &held.lease {
            // Its fault is told with the next state.
            let _ = lease.command(&command.velocity);
        }
    }

    /// Ends the leases of processes that are gone.
    async fn outlive(self: Arc<Self>, mut holders: armarium_bus::LivelinessSubscription) {
        while let Some(seen) = holders.next().await {
            if !seen.alive {
                self.leases.lock().held.retain(|_, held| held.token != seen.key);
            }
        }
    }

    async fn answer(self: Arc<Self>, mut questions: Queryable, key: Key) {
        while let Some(query) = questions.next().await {
            let answered = match self.answered(&query) {
                Ok((encoding, payload)) => query.reply(&key, &encoding, payload).await,
                Err((encoding, payload)) => query.refuse(&encoding, payload).await,
            };
            if let Err(error) = answered {
                tracing::debug!("nobody waits for an answer on {key}: {error}");
            }
        }
    }

    fn answered(self: &Arc<Self>, query: &IncomingQuery) -> Result<(String, Vec<u8>), (String, Vec<u8>)> {
        let IncomingQuery { encoding, payload, .. } = query;
        if payload.is_empty() {
            return Ok(written(&RobotDescription { lost: self.robot.lost(), ..self.described.clone() }));
        }
        let refused = |reason: String| written(&RobotRefusal { reason });
        if LeaseQuestion::SCHEMA.check(encoding).is_ok() {
            let question = read(encoding, payload).map_err(|error| refused(error.to_string()))?;
            let leased = self.lease(question).map_err(|why| written(&LeaseRefused { why }))?;
            return Ok(written(&leased));
        }
        let wanted: Do = read(encoding, payload).map_err(|error| refused(error.to_string()))?;
        self.act(wanted).map(|done| written(&done)).map_err(|error| refused(error.to_string()))
    }

    fn lease(self: &Arc<Self>, question: LeaseQuestion) -> Result<Leased, LeaseError> {
        let unreachable = |why: String| LeaseError::Unreachable { why };
        let token = Key::parse(&question.token).map_err(|error| unreachable(error.to_string()))?;
        if !self.leases.lock().has_room() {
            return Err(unreachable(format!("it has given {MAX_LEASES} leases")));
        }
        let secret = secret().map_err(|error| unreachable(error.to_string()))?;
        let limbs: Vec<&str> = question.limbs.iter().map(String::as_str).collect();
        let lease =
            self.robot.lease_together(&limbs, &question.holder, question.limits(), &question.touches)?;
        let number = self.leases.lock().add(secret.clone(), lease, question.token);
        tokio::spawn(Arc::clone(self).check(token, secret.clone()));
        Ok(Leased { lease: secret, number })
    }

    /// Ends a lease whose token is not there.
    async fn check(self: Arc<Self>, token: Key, lease: String) {
        let there = self.session.is_alive(&KeyPattern::from(token), TOKEN_WITHIN).await;
        if !there.unwrap_or(false) {
            self.leases.lock().held.remove(&lease);
        }
    }

    fn act(&self, wanted: Do) -> Result<Done, RobotError> {
        let robot = &self.robot;
        match wanted {
            Do::Release { lease } => drop(self.leases.lock().held.remove(&lease)),
            Do::Stop { reason } => robot.stop(&beginning(&reason, MAX_NAME)),
            Do::Reset => robot.reset(),
            Do::Tare { wrench } => robot.tare(&wrench)?,
            Do::SetLoad { hand, load } => robot.set_load(&hand, load.map(Into::into))?,
            Do::SetSurroundings { boxes } => {
                robot.set_surroundings(boxes.into_iter().map(Into::into).collect())?;
            }
            Do::SetSpeedScale { scale } => robot.set_speed_scale(scale)?,
            Do::Say { utterance } => robot.say(&beginning(&utterance, MAX_SAID)),
            Do::Loads => {}
        }
        Ok(Done { loads: robot.loads().iter().map(|(hand, load)| (hand.clone(), load.into())).collect() })
    }
}

impl Leases {
    /// Whether there may be one more; one whose limbs were freed long ago makes room.
    fn has_room(&mut self) -> bool {
        if self.held.len() >= MAX_LEASES {
            let freed = self.held.iter().filter(|(_, held)| held.lease.is_none());
            let oldest = freed.min_by_key(|(_, held)| held.number).map(|(secret, _)| secret.clone());
            return oldest.and_then(|oldest| self.held.remove(&oldest)).is_some();
        }
        true
    }

    fn add(&mut self, secret: String, lease: Lease, token: String) -> u64 {
        self.last += 1;
        let number = self.last;
        self.held.insert(secret, Held { lease: Some(lease), fault: None, number, token, last: None });
        number
    }

    /// The faults of all leases by their numbers. Frees the limbs of those that have had one for long.
    fn faults(&mut self, now_ns: u64) -> BTreeMap<u64, Fault> {
        let mut faults = BTreeMap::new();
        for held in self.held.values_mut() {
            let found = held.lease.as_ref().and_then(Lease::fault);
            if let (Some(fault), None) = (found, &held.fault) {
                held.fault = Some((fault, now_ns));
            }
            let Some((fault, since_ns)) = &held.fault else { continue };
            held.lease.take_if(|_| now_ns.saturating_sub(*since_ns) > FREED_AFTER_NS);
            faults.insert(held.number, fault.clone());
        }
        faults
    }
}

/// A text that nobody can guess.
pub(super) fn secret() -> Result<String, getrandom::Error> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// At most so many letters of a text.
fn beginning(text: &str, most: usize) -> String {
    text.chars().take(most).collect()
}
