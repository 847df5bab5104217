//! The data between skills and a robot: samples of the sensors, limits of a lease, and why a command is refused.
//! The trait is [`Robot`](crate::Robot).

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};

/// Longest name of a holder, a load, a known box, or of what a lease may touch, bytes.
pub(crate) const MAX_NAME: usize = 100;
/// Longest edge or distance of a load or of a known box, m.
pub(crate) const MAX_M: f64 = 1000.0;
/// Greatest mass of a load, kg.
pub(crate) const MAX_KG: f64 = 1000.0;

/// A sample of all the robot's sensors. Joint arrays are in the order of the model's joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensed {
    /// Time of the sample since the robot's start, ns.
    pub stamp_ns: u64,
    /// Joint positions, rad (m for prismatic joints).
    pub position: Vec<f64>,
    /// Joint velocities, rad/s (m/s for prismatic joints).
    pub velocity: Vec<f64>,
    /// What the wrench sensors feel, in the order of the model's.
    pub wrenches: Vec<SensedWrench>,
}

/// A force and a torque.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ForceTorque {
    /// Force, N.
    pub force: Vector3<f64>,
    /// Torque, N m.
    pub torque: Vector3<f64>,
}

impl ForceTorque {
    pub(crate) fn map(self, mut f: impl FnMut(Vector3<f64>) -> Vector3<f64>) -> Self {
        Self { force: f(self.force), torque: f(self.torque) }
    }

    pub(crate) fn minus(self, other: Self) -> Self {
        Self { force: self.force - other.force, torque: self.torque - other.torque }
    }

    pub(crate) fn toward(&mut self, goal: Self, share: f64) {
        self.force += share * (goal.force - self.force);
        self.torque += share * (goal.torque - self.torque);
    }

    pub(crate) fn is_finite(&self) -> bool {
        self.force.iter().chain(&self.torque).all(|v| v.is_finite())
    }
}

/// A sample of one wrench sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensedWrench {
    /// What the hand exerts on the sensor, as the sensor gives it: sensor's frame, about the sensor's origin.
    pub raw: ForceTorque,
    /// What the environment exerts on the hand: compensated for bias, weight and inertia of hand and load; root
    /// frame, about the TCP.
    pub external: ForceTorque,
}

/// What a hand holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Load {
    /// What it is. Hands whose loads have the same name hold one thing together: where one arm stops or gives way to
    /// a force, the other does, too.
    pub name: String,
    /// The mass that the hand bears, kg.
    pub mass_kg: f64,
    /// Its centre, in the frame of the hand's TCP, m.
    pub center_in_tcp: Point3<f64>,
    /// The box that it fills, if that is known: bodies keep their distance from it.
    pub shape: Option<LoadShape>,
}

/// The box that a load fills.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadShape {
    /// The pose of its middle in the frame of the hand's TCP.
    pub tcp_from_box: Isometry3<f64>,
    /// Edge lengths along its x, y, z, m.
    pub size: Vector3<f64>,
}

impl Load {
    /// Whether its mass is one, its lengths are some that can be held, and its name is no longer than others.
    pub(crate) fn is_physical(&self) -> bool {
        let is_held = |shape: &LoadShape| is_box(&shape.tcp_from_box, &shape.size);
        (0.0..=MAX_KG).contains(&self.mass_kg)
            && self.center_in_tcp.iter().all(|c| c.abs() <= MAX_M)
            && self.shape.as_ref().is_none_or(is_held)
            && self.name.len() <= MAX_NAME
    }
}

/// Whether a pose and edges are of a box somewhere near the robot.
pub(crate) fn is_box(pose: &Isometry3<f64>, size: &Vector3<f64>) -> bool {
    let turned = pose.rotation.coords.iter().all(|c| c.is_finite());
    let near = pose.translation.vector.iter().all(|c| c.abs() <= MAX_M);
    turned && near && size.iter().all(|edge| *edge > 0.0 && *edge <= MAX_M)
}

/// Limits that a lease requests; the robot's own limits apply as well.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeaseLimits {
    /// Largest compensated force at every wrench sensor that the limb moves, N. Above it, the sensor's arm yields and
    /// the lease gets a fault.
    pub force_n: Option<f64>,
    /// Largest speed, m/s, of every TCP that the limb moves, whichever joints move it. Faster commands are scaled
    /// down together, which keeps their direction.
    pub speed_m_s: Option<f64>,
}

impl LeaseLimits {
    /// Refuses a limit that is negative or no number.
    pub(crate) fn check(&self) -> Result<(), LeaseError> {
        let limits = [("force", self.force_n), ("speed", self.speed_m_s)];
        let wrong = limits
            .into_iter()
            .find_map(|(what, limit)| Some((what, limit.filter(|limit| limit.is_nan() || *limit < 0.0)?)));
        wrong.map_or(Ok(()), |(what, value)| Err(LeaseError::Limit { what: what.into(), value }))
    }
}

/// Why the guard took the limb from its commander.
#[derive(Clone, Debug, PartialEq, thiserror::Error, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Fault {
    /// The force at a wrench sensor exceeded the limit; its arm yielded along the force.
    #[error(
        "the force at `{sensor}` reached {force_n:.0} N, over its limit of {limit_n:.0} N; its arm gave way"
    )]
    Force {
        /// The wrench sensor. It may be that of another arm than the commanded one: a torso moves both.
        sensor: Arc<str>,
        /// Largest measured force, N.
        force_n: f64,
        /// The limit in force, N.
        limit_n: f64,
    },
    /// No fresh command within the watchdog's time.
    #[error("no command for {silent_ms} ms; the arm was braked")]
    Watchdog {
        /// Time without a command, ms.
        silent_ms: u64,
    },
    /// The drives braked by themselves, as no targets came to them in time.
    #[error("the drives got no targets in time and braked by themselves")]
    Braked,
    /// A wrench sensor repeats the same sample: the sensor or its connection is broken.
    #[error(
        "the wrench sensor `{sensor}` has not changed for {frozen_ms} ms; check the sensor and its cable"
    )]
    FrozenWrench {
        /// The wrench sensor.
        sensor: Arc<str>,
        /// How long it has not changed, ms.
        frozen_ms: u64,
    },
    /// A command was NaN or infinite.
    #[error("a command for joint `{joint}` was not a finite number")]
    NotFinite {
        /// The first such joint.
        joint: String,
    },
    /// A command has a different number of velocities than the limb has joints.
    #[error("a command for the limb `{limb}` held {got} velocities, it has {expected} joints")]
    WrongLength {
        /// The commanded limb.
        limb: String,
        /// Number of its joints.
        expected: usize,
        /// Number of velocities in the command.
        got: usize,
    },
    /// The robot was stopped.
    #[error("the robot is stopped: {reason}")]
    Stopped {
        /// Why.
        reason: String,
    },
}

/// Why a lease was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LeaseError {
    /// Another holder commands the limb.
    #[error("the limb `{limb}` is commanded by `{holder}`")]
    Taken {
        /// The requested limb.
        limb: String,
        /// The current holder.
        holder: String,
    },
    /// The robot has no such limb.
    #[error("the robot has no limb `{limb}`; it has {known}")]
    Unknown {
        /// The requested limb.
        limb: String,
        /// Comma-separated names.
        known: String,
    },
    /// The robot is in another process, and did not answer, or not as it should.
    #[error("the robot cannot be asked: {why}")]
    Unreachable {
        /// The reason.
        why: String,
    },
    /// No limb is named.
    #[error("a lease is of one limb at least")]
    Nothing,
    /// A name is too long, or there are too many.
    #[error(
        "a lease's holder and what it touches have names of at most {bytes} bytes, and it touches {touches} things at most"
    )]
    Names {
        /// Longest name, bytes.
        bytes: usize,
        /// Most things that it touches.
        touches: usize,
    },
    /// A limit of the lease is negative or no number.
    #[error("a lease's largest {what} cannot be {value}: it is a number from 0 on")]
    Limit {
        /// Of what.
        what: String,
        /// The limit.
        value: f64,
    },
    /// The robot has been stopped and not been reset since.
    #[error("the robot is stopped: {reason}")]
    Stopped {
        /// Why.
        reason: String,
    },
}
