//! What passes between skills and a robot: what is sensed, bounds of a lease, and why a command is refused. Plain data; the
//! trait is [`Robot`](crate::Robot).

use nalgebra::Vector3;

/// Everything that the robot sensed at one instant. Joint arrays are in the order of the model's joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensed {
    /// Time of the sample since the robot's start, ns.
    pub stamp_ns: u64,
    /// Joint positions, rad (m for prismatic joints).
    pub position: Vec<f64>,
    /// Joint velocities, rad/s (m/s for prismatic joints).
    pub velocity: Vec<f64>,
    /// Force that the hand exerts on the wrist sensor, raw, in the sensor's frame, N.
    pub force_raw: Vector3<f64>,
    /// Torque about the sensor's origin, raw, in the sensor's frame, N m.
    pub torque_raw: Vector3<f64>,
    /// The same, compensated.
    pub wrist: Wrist,
}

/// The wrist's force and torque, compensated for bias, weight and inertia of hand and load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrist {
    /// Force of the environment on the hand, in the root frame, N.
    pub force: Vector3<f64>,
    /// Torque of the environment on the hand about the TCP, in the root frame, N m.
    pub torque: Vector3<f64>,
}

/// Bounds that a lease asks for; the robot's own limits bound them in turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeaseLimits {
    /// Largest compensated wrist force, N. Over it, the arm gives way and the lease is faulted.
    pub force_n: Option<f64>,
    /// Largest speed, m/s, of every TCP that the limb moves, whichever joints move it: faster commands are scaled down
    /// together, direction kept.
    pub speed_m_s: Option<f64>,
}

/// Why the guard took the limb from its commander.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// The wrist force exceeded the limit; the arm gave way along the force.
    #[error("the wrist force reached {force_n:.0} N, over its limit of {limit_n:.0} N; the arm gave way")]
    Force {
        /// Largest force seen, N.
        force_n: f64,
        /// The limit in force, N.
        limit_n: f64,
    },
    /// No fresh command within the watchdog's time.
    #[error("no command for {silent_ms} ms; the arm was braked")]
    Watchdog {
        /// How long nothing came, ms.
        silent_ms: u64,
    },
    /// The wrist sensor repeats the same sample: it is broken or its connection is.
    #[error("the wrist sensor has not changed for {frozen_ms} ms; check the sensor and its cable")]
    FrozenWrench {
        /// How long it has been the same, ms.
        frozen_ms: u64,
    },
    /// A command was NaN or infinite.
    #[error("a command for joint `{joint}` was not a finite number")]
    NotFinite {
        /// The first such joint.
        joint: String,
    },
    /// A command held another number of velocities than the limb has joints.
    #[error("a command for the limb `{limb}` held {got} velocities, it has {expected} joints")]
    WrongLength {
        /// The limb commanded.
        limb: String,
        /// How many joints it has.
        expected: usize,
        /// How many velocities came.
        got: usize,
    },
    /// The robot was stopped for good.
    #[error("the robot is stopped: {reason}")]
    Stopped {
        /// Why.
        reason: String,
    },
}

/// Why a lease was not given.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LeaseError {
    /// Somebody else commands the limb.
    #[error("the limb `{limb}` is commanded by `{holder}`")]
    Taken {
        /// The limb asked for.
        limb: String,
        /// Who holds it.
        holder: String,
    },
    /// The robot has no such limb.
    #[error("the robot has no limb `{limb}`; it has {known}")]
    Unknown {
        /// The limb asked for.
        limb: String,
        /// Comma-separated names.
        known: String,
    },
    /// The robot has been stopped for good (emergency stop).
    #[error("the robot is stopped: {reason}")]
    Stopped {
        /// Why.
        reason: String,
    },
}
