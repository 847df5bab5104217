//! The true state at an instant, and its receivers: the recorder, the referee and a digest. Skills never see it.

use std::sync::Arc;

use armarium_robot::LinkId;
use nalgebra::{Isometry3, Point3, Vector3};
use parking_lot::Mutex;
use serde::Serialize;

use crate::coach::{ActionEvent, CoachState};
use crate::person::Reach;
pub use crate::physics::Contact;
use crate::physics::{LedHand, PressedLoad, Touched};
use crate::world::{Gesture, WorldEvent};

/// The true state at one control step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TruthSample {
    /// Time since the robot's start, ns; the same as that of the sensed sample and of frames.
    pub stamp_ns: u64,
    /// Joint positions in the model's order, rad (m).
    pub position: Vec<f64>,
    /// Joint velocities, rad/s (m/s).
    pub velocity: Vec<f64>,
    /// Commanded joint positions, rad (m).
    pub command_position: Vec<f64>,
    /// Commanded joint velocities, rad/s (m/s).
    pub command_velocity: Vec<f64>,
    /// Pose of the TCP of the arm that works, in the root frame.
    pub tcp: Isometry3<f64>,
    /// Velocity of that TCP, root frame, m/s.
    pub tcp_velocity: Vector3<f64>,
    /// The table's force on the judged object.
    pub contact: Contact,
    /// The object in question, by its index among the world's bodies: the one that the hand of the arm that works holds, or
    /// held last; before the
    /// first grasp, the one named `sponge`, else the first. `None` in a world without objects.
    pub object: Option<usize>,
    /// Poses of the middles of all objects in the root frame, in the world's order.
    pub objects: Vec<Isometry3<f64>>,
    /// What is between the first robot's hands, where these have pads.
    pub pressed: Option<PressedLoad>,
    /// The poses of the TCPs of the first robot's arms, in a world with handles.
    pub tcps: Vec<Isometry3<f64>>,
    /// The first robot's hands that a person leads.
    pub led: Vec<LedHand>,
    /// The forces between the first robot and other things, N.
    pub collisions: Vec<(Touched, f64)>,
    /// Which links of the first robot touch which bodies, by their index.
    pub links_touching: Vec<(LinkId, usize)>,
    /// The distance between the first robot's arms and each person when it was last looked at, m.
    pub people: Vec<f64>,
    /// The poses of the parts of each person at that time, root frame.
    pub people_parts: Vec<Vec<Isometry3<f64>>>,
    /// The arms of people that reach for places at that time.
    pub reaches: Vec<TrueReach>,
    /// Whether that hand holds the judged object.
    pub held: bool,
    /// The coach's state.
    pub coach: CoachState,
    /// Force of that hand on its wrench sensor, sensor's frame, without noise and bias, N.
    pub wrist_force: Vector3<f64>,
    /// Torque of that hand on its wrench sensor, sensor's frame, without noise and bias, N m.
    pub wrist_torque: Vector3<f64>,
}

/// An arm of a person that reaches for a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueReach {
    /// The person, by their index.
    pub person: usize,
    /// What the arm does.
    pub reach: Reach,
    /// Its elbow and its wrist, root frame, m.
    pub forearm: [Point3<f64>; 2],
}

impl TruthSample {
    /// The object in question and the pose of its middle.
    pub fn object_pose(&self) -> Option<(usize, Isometry3<f64>)> {
        let object = self.object?;
        Some((object, *self.objects.get(object)?))
    }
}

/// The truth about a rendered pair of images. In the recording: `/truth/hand`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameTruth {
    /// Stamp of the frame, ns, by which what is seen in it is compared; it errs.
    pub stamp_ns: u64,
    /// The gesture of the coach's hand, if the hand is there.
    pub gesture: Option<Gesture>,
    /// How long the gesture has been shown, s; without a hand, how long there has been none.
    pub since_s: f64,
    /// Whether the whole hand is in both images and nothing hides it.
    pub visible: bool,
    /// Where the left camera truly was, root frame. In the recording it follows from the joints.
    #[serde(skip)]
    pub root_from_left: Isometry3<f64>,
}

/// An event. In the recording: `/truth/events`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "what", content = "detail", rename_all = "snake_case")]
pub enum TruthEvent {
    /// The robot said something.
    Said {
        /// The utterance.
        utterance: String,
    },
    /// An event of the coach.
    Coach(ActionEvent),
    /// A milestone was reached for the first time.
    Reached(WorldEvent),
    /// The hand took an object, by its name. From now on it is the object that is judged.
    Grasped(String),
    /// The hand took or lost an object.
    Held(bool),
}

/// Receives the truth, in the simulator's own thread; it must return at once.
pub trait TruthSink: Send {
    /// Called at every control step.
    fn sample(&mut self, sample: &TruthSample);
    /// Called for every rendered frame.
    fn frame(&mut self, frame: &FrameTruth) {
        let _ = frame;
    }
    /// Called for every event, with its time, ns.
    fn event(&mut self, stamp_ns: u64, event: &TruthEvent) {
        let _ = (stamp_ns, event);
    }
}

/// A digest of all samples: equal runs have equal digests, and different runs almost surely have different ones.
///
/// FNV-1a over the bits of every number; not cryptographic.
#[derive(Clone, Debug)]
pub struct TruthDigest {
    state: Arc<Mutex<u64>>,
}

impl Default for TruthDigest {
    fn default() -> Self {
        Self { state: Arc::new(Mutex::new(0xcbf2_9ce4_8422_2325)) }
    }
}

impl TruthDigest {
    /// The digest so far.
    pub fn value(&self) -> u64 {
        *self.state.lock()
    }
}

impl TruthSink for TruthDigest {
    fn sample(&mut self, s: &TruthSample) {
        let mut state = self.state.lock();
        let mut eat = |v: f64| {
            for byte in v.to_bits().to_le_bytes() {
                *state = (*state ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        };
        eat(s.stamp_ns as f64);
        for list in [&s.position, &s.velocity, &s.command_position, &s.command_velocity] {
            list.iter().copied().for_each(&mut eat);
        }
        eat(s.contact.normal);
        for v in [s.contact.tangential, s.wrist_force, s.wrist_torque, s.coach.push] {
            v.iter().copied().for_each(&mut eat);
        }
        let object = s.object_pose().map(|(_, pose)| pose);
        for pose in [object, s.coach.tool, s.coach.hand.map(|h| h.root_from_hand)].into_iter().flatten() {
            pose.translation.vector.iter().copied().for_each(&mut eat);
        }
    }
}
