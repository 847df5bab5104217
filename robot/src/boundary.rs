//! The data between skills and a robot: samples of the sensors, limits of a lease, and why a command is refused.
//! The trait is [`Robot`](crate::Robot).

use nalgebra::Vector3;

/// A sample of all the robot's sensors. Joint arrays are in the order of the model's joints.
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
    /// The wrist's force and torque, compensated.
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

/// Limits that a lease requests; the robot's own limits apply as well.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeaseLimits {
    /// Largest compensated wrist force, N. Above it, the arm yields and the lease gets a fault.
    pub force_n: Option<f64>,
    /// Largest speed, m/s, of every TCP that the limb moves, whichever joints move it. Faster commands are scaled
    /// down together, which keeps their direction.
    pub speed_m_s: Option<f64>,
}

/// Why the guard took the limb from its commander.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// The wrist force exceeded the limit; the arm yielded along the force.
    #[error("the wrist force reached {force_n:.0} N, over its limit of {limit_n:.0} N; the arm gave way")]
    Force {
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
    /// The wrist sensor repeats the same sample: the sensor or its connection is broken.
    #[error("the wrist sensor has not changed for {frozen_ms} ms; check the sensor and its cable")]
    FrozenWrench {
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
    /// The robot was stopped permanently.
    #[error("the robot is stopped: {reason}")]
    Stopped {
        /// Why.
        reason: String,
    },
}

/// Why a lease was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
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
    /// The robot has been stopped permanently (emergency stop).
    #[error("the robot is stopped: {reason}")]
    Stopped {
        /// Why.
        reason: String,
    },
}
