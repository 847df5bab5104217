//! Shares a robot with skills in other processes.
//!
//! Leases that others hold are kept here. One ends when it is released, or when the liveliness token of its holder's process is
//! gone; before that, the guard's watchdog brakes what nobody commands.

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
use crate::message::{read, written};
use crate::{Fault, LeaseError};

/// Questions that wait.
const QUEUE: usize = 256;
/// Most leases that others hold.
const MAX_LEASES: usize = 64;
/// After so long a holder's token has to be known.
const TOKEN_WITHIN: Duration = Duration::from_secs(1);

/// A robot that is shared until this is dropped.
#[derive(Debug)]
pub struct RobotServer {
    _commands: ControlReader,
    _tasks: JoinSet<()>,
}

/// A lease that somebody in another process holds.
struct Held {
    lease: Lease,
    token: String,
    /// The number of its last command.
    last: Option<u64>,
}

struct Shared {
    robot: Arc<dyn Robot>,
    session: Session,
    described: RobotDescription,
    leases: Mutex<BTreeMap<String, Held>>,
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
        let shared =
            Arc::new(Shared { robot, session: session.clone(), described, leases: Mutex::default() });
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
        tasks.spawn(shared.publish(states));
        Ok(Self { _commands: commands, _tasks: tasks })
    }
}

impl Shared {
    /// Sends each state until the robot ends, and that last one.
    async fn publish(self: Arc<Self>, states: ControlSender) {
        let mut sensed = self.robot.sensed();
        let mut number = 0;
        while sensed.changed().await.is_ok() {
            let faults = self.faults();
            let state = RobotState::of(&sensed.borrow_and_update(), (self.described.epoch, number), faults);
            if states.send(written(&state).1).is_err() {
                return;
            }
            number += 1;
        }
    }

    fn faults(&self) -> BTreeMap<String, Fault> {
        let leases = self.leases.lock();
        leases.iter().filter_map(|(id, held)| Some((id.clone(), held.lease.fault()?))).collect()
    }

    /// On a thread of the link. What cannot be read, or is of no lease, moves nothing.
    fn command(&self, message: &Message) {
        let command: RobotCommand = match read(&message.encoding, &message.payload) {
            Ok(command) => command,
            Err(error) => return tracing::warn!("a command is not understood: {error}"),
        };
        let mut leases = self.leases.lock();
        let Some(held) = leases.get_mut(&command.lease) else {
            return tracing::warn!("a command for a lease that nobody holds is ignored");
        };
        if held.last.is_some_and(|last| command.number <= last) {
            return tracing::warn!("the command {} came again, or too late, and is ignored", command.number);
        }
        held.last = Some(command.number);
        // Its fault is told with the next state.
        let _ = held.lease.command(&command.velocity);
    }

    /// Ends the leases of processes that are gone.
    async fn outlive(self: Arc<Self>, mut holders: armarium_bus::LivelinessSubscription) {
        while let Some(seen) = holders.next().await {
            if !seen.alive {
                self.leases.lock().retain(|_, held| held.token != seen.key);
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
            return Ok(written(&self.described));
        }
        let refused = |reason: String| written(&RobotRefusal { reason });
        if LeaseQuestion::SCHEMA.check(encoding).is_ok() {
            let question = read(encoding, payload).map_err(|error| refused(error.to_string()))?;
            let lease = self.lease(question).map_err(|why| written(&LeaseRefused { why }))?;
            return Ok(written(&Leased { lease }));
        }
        let wanted: Do = read(encoding, payload).map_err(|error| refused(error.to_string()))?;
        self.act(wanted).map(|done| written(&done)).map_err(refused)
    }

    fn lease(self: &Arc<Self>, question: LeaseQuestion) -> Result<String, LeaseError> {
        let token = Key::parse(&question.token)
            .map_err(|error| LeaseError::Unreachable { why: error.to_string() })?;
        if self.leases.lock().len() >= MAX_LEASES {
            return Err(LeaseError::Unreachable { why: format!("it has given {MAX_LEASES} leases") });
        }
        let limbs: Vec<&str> = question.limbs.iter().map(String::as_str).collect();
        let lease =
            self.robot.lease_together(&limbs, &question.holder, question.limits(), &question.touches)?;
        let id = format!("{} {}", self.session.id(), self.session.now_ns());
        let held = Held { lease, token: question.token, last: None };
        self.leases.lock().insert(id.clone(), held);
        tokio::spawn(Arc::clone(self).check(token, id.clone()));
        Ok(id)
    }

    /// Ends a lease whose token is not there.
    async fn check(self: Arc<Self>, token: Key, lease: String) {
        let there = self.session.is_alive(&KeyPattern::from(token), TOKEN_WITHIN).await;
        if !there.unwrap_or(false) {
            self.leases.lock().remove(&lease);
        }
    }

    fn act(&self, wanted: Do) -> Result<Done, String> {
        let robot = &self.robot;
        let done = match wanted {
            Do::Release { lease } => {
                self.leases.lock().remove(&lease);
                Ok(())
            }
            Do::Stop { reason } => {
                robot.stop(&reason);
                Ok(())
            }
            Do::Reset => {
                robot.reset();
                Ok(())
            }
            Do::Tare { wrench } => robot.tare(&wrench),
            Do::SetLoad { hand, load } => robot.set_load(&hand, load.map(Into::into)),
            Do::SetSurroundings { boxes } => {
                robot.set_surroundings(boxes.into_iter().map(Into::into).collect())
            }
            Do::SetSpeedScale { scale } => robot.set_speed_scale(scale),
            Do::Say { utterance } => {
                robot.say(&utterance);
                Ok(())
            }
            Do::Loads => Ok(()),
        };
        done.map_err(|error| error.to_string())?;
        Ok(Done { loads: robot.loads().iter().map(|(hand, load)| (hand.clone(), load.into())).collect() })
    }
}
