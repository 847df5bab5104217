//! The messages between a robot's guard and skills in other processes; `docs/wire-robot.md` describes them.

use std::collections::BTreeMap;

use armarium_bus::{Key, KeyError, keys};
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::message::{WirePose, pose, wire_pose};
use crate::planning::KnownBox;
use crate::{Fault, ForceTorque, LeaseError, LeaseLimits, Load, LoadShape, Model, Sensed, SensedWrench};

/// What a robot is, for the check that both sides mean the same.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct RobotDescription {
    /// The robot file's name.
    pub(super) robot: String,
    /// In the order of states.
    pub(super) joints: Vec<String>,
    /// In the order of states.
    #[serde(default)]
    pub(super) wrenches: Vec<String>,
    /// The limbs with their joints, in the order of commands.
    pub(super) limbs: BTreeMap<String, Vec<String>>,
    /// Distinguishes the starts of the guard.
    pub(super) epoch: u64,
    /// Why it is out of reach, if it is.
    #[serde(default)]
    pub(super) lost: Option<String>,
}

impl RobotDescription {
    pub(super) fn of(model: &Model, epoch: u64) -> Self {
        let joint = |&joint: &usize| model.joints()[joint].name.clone();
        let limbs = model.limbs().values();
        Self {
            robot: model.name().into(),
            joints: (0..model.joints().len()).map(|i| joint(&i)).collect(),
            wrenches: model.wrenches().iter().map(|sensor| sensor.name.clone()).collect(),
            limbs: limbs.map(|limb| (limb.name.clone(), limb.joints.iter().map(joint).collect())).collect(),
            epoch,
            lost: None,
        }
    }

    /// How it differs from another one, if it does.
    pub(super) fn differs(&self, other: &Self) -> Option<&'static str> {
        let Self { robot, joints, wrenches, limbs, epoch: _, lost: _ } = self;
        let differences = [
            (*robot != other.robot, "it has another name"),
            (*joints != other.joints, "it has other joints, or in another order"),
            (*wrenches != other.wrenches, "it has other wrench sensors, or in another order"),
            (*limbs != other.limbs, "it has other groups or hands"),
        ];
        differences.into_iter().find_map(|(differs, what)| differs.then_some(what))
    }
}

/// What a robot senses, and the faults of its leases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RobotState {
    pub(super) epoch: u64,
    pub(super) number: u64,
    pub(super) stamp_ns: u64,
    pub(super) position: Vec<f64>,
    pub(super) velocity: Vec<f64>,
    /// For each sensor what it gives, and what the environment exerts on the hand: force and torque each.
    #[serde(default)]
    pub(super) wrenches: Vec<[[f64; 6]; 2]>,
    /// The leases that were taken from their commanders, by their numbers, with the reason.
    #[serde(default)]
    pub(super) faults: BTreeMap<u64, Fault>,
    /// Why this is the last state, if it is.
    #[serde(default)]
    pub(super) lost: Option<String>,
}

fn six(wrench: &ForceTorque) -> [f64; 6] {
    let (force, torque) = (wrench.force, wrench.torque);
    [force.x, force.y, force.z, torque.x, torque.y, torque.z]
}

fn wrench([fx, fy, fz, tx, ty, tz]: [f64; 6]) -> ForceTorque {
    ForceTorque { force: [fx, fy, fz].into(), torque: [tx, ty, tz].into() }
}

impl RobotState {
    pub(super) fn of(
        sensed: &Sensed,
        (epoch, number): (u64, u64),
        faults: BTreeMap<u64, Fault>,
        lost: Option<String>,
    ) -> Self {
        let Sensed { stamp_ns, position, velocity, wrenches } = sensed;
        let wrenches = wrenches.iter().map(|felt| [six(&felt.raw), six(&felt.external)]).collect();
        let (position, velocity) = (position.clone(), velocity.clone());
        Self { epoch, number, stamp_ns: *stamp_ns, position, velocity, wrenches, faults, lost }
    }

    /// What is sensed, if it is of a robot with so many joints and sensors, and all finite.
    pub(super) fn sensed(self, model: &Model) -> Option<Sensed> {
        let Self { stamp_ns, position, velocity, wrenches, .. } = self;
        let (joints, sensors) = (model.joints().len(), model.wrenches().len());
        let fits = position.len() == joints && velocity.len() == joints && wrenches.len() == sensors;
        let finite = position.iter().chain(&velocity).chain(wrenches.iter().flatten().flatten());
        let fits = fits && finite.copied().all(f64::is_finite);
        let felt =
            |[raw, external]: [[f64; 6]; 2]| SensedWrench { raw: wrench(raw), external: wrench(external) };
        let wrenches = wrenches.into_iter().map(felt).collect();
        fits.then_some(Sensed { stamp_ns, position, velocity, wrenches })
    }
}

/// Asks for a lease; the answer is a [`Leased`] or a [`LeaseRefused`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct LeaseQuestion {
    pub(super) limbs: Vec<String>,
    /// For people; leases of one holder share their bounds.
    pub(super) holder: String,
    #[serde(default)]
    pub(super) force_n: Option<f64>,
    #[serde(default)]
    pub(super) speed_m_s: Option<f64>,
    #[serde(default)]
    pub(super) touches: Vec<String>,
    /// The liveliness token with which the lease ends.
    pub(super) token: String,
}

impl LeaseQuestion {
    pub(super) fn limits(&self) -> LeaseLimits {
        LeaseLimits { force_n: self.force_n, speed_m_s: self.speed_m_s }
    }
}

/// A lease was given.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Leased {
    /// Its secret: commands have it.
    pub(super) lease: String,
    /// Names it in states, which others see.
    pub(super) number: u64,
}

/// A lease was refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct LeaseRefused {
    pub(super) why: LeaseError,
}

/// The velocities of a lease's joints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct RobotCommand {
    pub(super) lease: String,
    /// Grows from command to command of a lease.
    pub(super) number: u64,
    /// rad/s (m/s).
    pub(super) velocity: Vec<f64>,
}

/// What else is asked of a robot; the answer is [`Done`] or a [`RobotRefusal`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Do {
    Release { lease: String },
    Stop { reason: String },
    Reset,
    Tare { wrench: String },
    SetLoad { hand: String, load: Option<WireLoad> },
    SetSurroundings { boxes: Vec<WireBox> },
    SetSpeedScale { scale: f64 },
    Say { utterance: String },
    Loads,
}

/// It was done.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Done {
    /// What the hands hold.
    #[serde(default)]
    pub(super) loads: BTreeMap<String, WireLoad>,
}

/// Why it was not done.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct RobotRefusal {
    pub(super) reason: String,
}

/// What a hand holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WireLoad {
    name: String,
    mass_kg: f64,
    center_in_tcp: [f64; 3],
    /// Pose of the middle in the TCP's frame, and edges.
    #[serde(default)]
    shape: Option<(WirePose, [f64; 3])>,
}

impl From<&Load> for WireLoad {
    fn from(load: &Load) -> Self {
        let shape = load.shape.as_ref().map(|shape| (wire_pose(&shape.tcp_from_box), shape.size.into()));
        let center_in_tcp = load.center_in_tcp.coords.into();
        Self { name: load.name.clone(), mass_kg: load.mass_kg, center_in_tcp, shape }
    }
}

impl From<WireLoad> for Load {
    fn from(load: WireLoad) -> Self {
        let shape =
            |(at, size): (WirePose, [f64; 3])| LoadShape { tcp_from_box: pose(at), size: size.into() };
        let center_in_tcp = Point3::from(load.center_in_tcp);
        Self { name: load.name, mass_kg: load.mass_kg, center_in_tcp, shape: load.shape.map(shape) }
    }
}

/// A thing around the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WireBox {
    name: String,
    /// In the root frame.
    at: WirePose,
    size: [f64; 3],
}

impl From<&KnownBox> for WireBox {
    fn from(known: &KnownBox) -> Self {
        Self { name: known.name.clone(), at: wire_pose(&known.root_from_box), size: known.size.into() }
    }
}

impl From<WireBox> for KnownBox {
    fn from(known: WireBox) -> Self {
        Self { name: known.name, root_from_box: pose(known.at), size: known.size.into() }
    }
}

armarium_bus::payloads! {
    RobotDescription: "robot/description", 1;
    RobotState: "robot/state", 1;
    LeaseQuestion: "robot/lease", 1;
    Leased: "robot/leased", 1;
    LeaseRefused: "robot/lease_refused", 1;
    RobotCommand: "robot/command", 1;
    Do: "robot/do", 1;
    Done: "robot/done", 1;
    RobotRefusal: "robot/refusal", 1;
}

/// The keys of a robot.
#[derive(Debug)]
pub(super) struct Keys {
    pub(super) description: Key,
    pub(super) state: Key,
    pub(super) lease: Key,
    pub(super) command: Key,
    pub(super) to_do: Key,
}

impl Keys {
    pub(super) fn of(agent: &str, robot: &str) -> Result<Self, KeyError> {
        let part = |part| keys::robot(agent, robot, part);
        let (description, state, lease) = (part("description")?, part("state")?, part("lease")?);
        Ok(Self { description, state, lease, command: part("command")?, to_do: part("do")? })
    }
}
