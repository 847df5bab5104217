//! A robot in memory: links, joints, limbs, hands, sensors, postures. Immutable after reading; no state, no
//! algorithms. It is read from a robot file and a URDF (see `description`) and knows no robot by name.
//!
//! Links are in an order in which parents come before children. Joints are the independent ones, in the order of the
//! description's depth-first walk, and so is every joint array of this room; a mimic joint is no joint of its own, it
//! moves its link with its leader's position ([`JointMotion`]). Start at [`Model`].

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Point3, Unit, Vector3};

use crate::Mesh;
use crate::error::RobotError;

/// Standard gravity in the root frame (z up), m/s².
pub const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// Identifies a link of a [`Model`]: an index into [`Model::links`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(pub(crate) usize);

impl LinkId {
    /// The index into [`Model::links`] and into the poses of [`Kinematics`](crate::Kinematics).
    #[must_use]
    pub fn index(self) -> usize {
        self.0
    }
}

/// The form of a part, centred on its own frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// A box.
    Box {
        /// Edge lengths along x, y, z, m.
        size: Vector3<f64>,
    },
    /// A cylinder about z.
    Cylinder {
        /// Radius, m.
        radius: f64,
        /// Length along z, m.
        length: f64,
    },
    /// A sphere.
    Sphere {
        /// Radius, m.
        radius: f64,
    },
    /// A cylinder about z with a half ball at each end.
    Capsule {
        /// Radius, m.
        radius: f64,
        /// Length of the cylinder, between the middles of the balls, m.
        length: f64,
    },
    /// A surface of triangles. Bodies touch it as its convex hull.
    Mesh(Arc<Mesh>),
}

impl Geometry {
    /// The box around it: its middle, and half its extents along x, y and z, m.
    pub fn surrounding_box(&self) -> (Point3<f64>, Vector3<f64>) {
        let half = match self {
            Self::Box { size } => size / 2.0,
            Self::Cylinder { radius, length } => Vector3::new(*radius, *radius, length / 2.0),
            Self::Sphere { radius } => Vector3::repeat(*radius),
            Self::Capsule { radius, length } => Vector3::new(*radius, *radius, length / 2.0 + radius),
            Self::Mesh(mesh) => return mesh.surrounding_box(),
        };
        (Point3::origin(), half)
    }
}

/// A visible part of a link.
#[derive(Clone, Debug, PartialEq)]
pub struct Visual {
    /// Its form.
    pub shape: Geometry,
    /// The shape's pose in the link's frame.
    pub link_from_shape: Isometry3<f64>,
    /// Colour: red, green, blue.
    pub color: [u8; 3],
}

/// A collision part of a link.
#[derive(Clone, Debug, PartialEq)]
pub struct Collision {
    /// Its form.
    pub shape: Geometry,
    /// The shape's pose in the link's frame.
    pub link_from_shape: Isometry3<f64>,
}

/// Mass and its distribution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the link's frame, m.
    pub center: Point3<f64>,
    /// Inertia about the centre of mass along the link's axes, kg m².
    pub inertia: Matrix3<f64>,
}

/// One rigid body or frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Its name.
    pub name: String,
    /// Its parent link; `None` for the root.
    pub parent: Option<LinkId>,
    /// How a joint moves it against its parent; `None` for the root and for fixed links.
    pub motion: Option<JointMotion>,
    /// Its pose in the parent's frame without that motion.
    pub parent_from_link: Isometry3<f64>,
    /// Its mass; `None` for pure frames.
    pub inertial: Option<Inertial>,
    /// Its visible parts.
    pub visuals: Vec<Visual>,
    /// Its collision parts.
    pub collisions: Vec<Collision>,
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Rotates about its axis; positions in rad.
    Revolute,
    /// Slides along its axis; positions in m.
    Prismatic,
}

/// How a joint moves a link against its parent: with the position `multiplier * q + offset`, where `q` is the
/// joint's. For the link of a joint itself these are 1 and 0; for a mimic joint they are its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMotion {
    /// The joint, as an index into [`Model::joints`]; for a mimic joint, its leader.
    pub joint: usize,
    /// Rotation or translation.
    pub kind: JointKind,
    /// The axis in the link's frame.
    pub axis: Unit<Vector3<f64>>,
    /// Motion of the link over that of the joint.
    pub multiplier: f64,
    /// Position of the link's own motion with the joint at 0, rad (m).
    pub offset: f64,
}

impl JointMotion {
    /// The position of the link's own motion, rad (m), with all joints at `q`; a missing value is read as 0.
    pub fn position(&self, q: &[f64]) -> f64 {
        self.multiplier * q.get(self.joint).copied().unwrap_or(0.0) + self.offset
    }
}

/// One degree of freedom.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// The link that it moves.
    pub link: LinkId,
    /// Its axis in the frame of the link that it moves. At position 0 this is also the joint's frame.
    pub axis: Unit<Vector3<f64>>,
    /// Lower limit, rad (m); `-inf` for a joint without limits.
    pub lower: f64,
    /// Upper limit, rad (m); `inf` for a joint without limits.
    pub upper: f64,
    /// Largest speed, rad/s (m/s).
    pub velocity: f64,
    /// Largest acceleration, rad/s² (m/s²).
    pub acceleration: f64,
    /// Largest torque, N m (force, N).
    pub effort: f64,
}

/// Joints that are commanded together: a group of the robot file, or a hand.
#[derive(Clone, Debug, PartialEq)]
pub struct Limb {
    /// Its name.
    pub name: String,
    /// Its joints as indices into [`Model::joints`], in the order of its commands.
    pub joints: Vec<usize>,
    /// Its tool centre point: the link at its end whose speed is limited. A limb with one is an arm.
    pub tcp: Option<LinkId>,
    /// The hand at its end.
    pub hand: Option<String>,
    /// Its wrench sensor, as an index into [`Model::wrenches`].
    pub wrench: Option<usize>,
    /// The limbs that move with it so that it reaches further.
    pub helped_by: Vec<String>,
    /// The posture in which it is ready to work, by its name.
    pub ready: Option<String>,
    /// The postures that it takes in place of others, by the names of these.
    pub postures: BTreeMap<String, String>,
}

/// A gripper: joints that open and close together.
#[derive(Clone, Debug, PartialEq)]
pub struct Hand {
    /// Its name, which is also that of its limb.
    pub name: String,
    /// Positions of its joints when it is open, rad (m).
    pub open: Vec<f64>,
    /// Positions of its joints when it is closed, rad (m).
    pub closed: Vec<f64>,
    /// The shapes that it takes, by their names: positions of its joints, rad (m). `open` and `closed` are two of them.
    pub shapes: BTreeMap<String, Vec<f64>>,
    /// The links with which it touches what it holds.
    pub pads: Vec<LinkId>,
    /// Where it grasps, in the frame of its arm's TCP: the middle of what it holds, x along the approach, y along the
    /// closing direction.
    pub grasp_in_tcp: Isometry3<f64>,
    /// The face with which it presses on what it carries together with another hand, in the frame of its arm's TCP: its middle,
    /// x out of it, y along it.
    pub press_in_tcp: Option<Isometry3<f64>>,
    /// Width of a finger pad across approach and closing direction, m.
    pub pad_width: f64,
    /// The mark by which cameras track it.
    pub marker: Option<Marker>,
}

/// A coloured ball on a hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Marker {
    /// The link in whose origin it is.
    pub link: LinkId,
    /// Colour: red, green, blue.
    pub color: [u8; 3],
    /// Diameter, m.
    pub diameter: f64,
}

/// A force/torque sensor. What is attached beyond its frame is what it feels.
#[derive(Clone, Debug, PartialEq)]
pub struct WrenchSensor {
    /// Its name.
    pub name: String,
    /// The link in whose frame it measures.
    pub frame: LinkId,
}

/// A pair of parallel cameras; optical axis z, image's right x.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoCamera {
    /// Its name.
    pub name: String,
    /// The link of the left camera.
    pub left: LinkId,
    /// The link of the right camera.
    pub right: LinkId,
    /// The limb that turns them.
    pub on: Option<String>,
}

/// How a platform moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlatformKind {
    /// To all sides, and it turns.
    #[default]
    Holonomic,
    /// Forward and backward, along its y, and it turns.
    Differential,
    /// It stands still.
    None,
}

/// What a robot drives on: three joints between the root frame, which stays where the robot's odometry began, and what was the
/// root of its description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Platform {
    /// How it moves.
    pub kind: PlatformKind,
    /// Its joints: x and y in the root frame, m, and its turn about z, rad.
    pub joints: [usize; 3],
    /// The link that it carries all others with.
    pub link: LinkId,
}

impl Platform {
    /// The limb of its joints.
    pub const LIMB: &str = "platform";
}

/// The robot's own limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotLimits {
    /// Largest force at a wrench sensor, N, for leases that say no limit of their own.
    pub force_n: f64,
    /// The largest limit that a lease may say, N.
    pub most_force_n: f64,
    /// Largest speed of any TCP, m/s.
    pub speed_m_s: f64,
}

impl RobotLimits {
    /// The force limit of a lease that says this one, N.
    pub fn force_of(&self, said: Option<f64>) -> f64 {
        said.map_or(self.force_n, |said| said.min(self.most_force_n))
    }
}

/// A robot's description.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    pub(crate) name: String,
    pub(crate) links: Vec<Link>,
    pub(crate) joints: Vec<Joint>,
    pub(crate) link_ids: BTreeMap<String, LinkId>,
    pub(crate) joint_ids: BTreeMap<String, usize>,
    /// For each link, those that a joint moves, from the root to it.
    pub(crate) movers: Vec<Vec<LinkId>>,
    pub(crate) limbs: BTreeMap<String, Limb>,
    /// The names of the arms, in the order of the robot file.
    pub(crate) arms: Vec<String>,
    pub(crate) hands: BTreeMap<String, Hand>,
    pub(crate) wrenches: Vec<WrenchSensor>,
    pub(crate) camera: Option<StereoCamera>,
    pub(crate) postures: BTreeMap<String, Vec<f64>>,
    pub(crate) start_posture: Option<String>,
    pub(crate) start: Vec<f64>,
    pub(crate) limits: RobotLimits,
    pub(crate) platform: Option<Platform>,
    /// Pairs of links that need not keep their distance, each in the order of the links.
    pub(crate) may_touch: BTreeSet<[LinkId; 2]>,
}

impl Model {
    /// The robot's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// All links, parents before children.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// The identities of all links, in the order of [`links`](Self::links).
    pub fn link_ids(&self) -> impl Iterator<Item = LinkId> + use<> {
        (0..self.links.len()).map(LinkId)
    }

    /// All joints that move; every joint array is in this order.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// All limbs by name.
    pub fn limbs(&self) -> &BTreeMap<String, Limb> {
        &self.limbs
    }

    /// The joints of a limb in the order of its commands; empty if there is no such limb (use
    /// [`find_limb`](Self::find_limb) to distinguish).
    pub fn limb(&self, name: &str) -> &[usize] {
        self.limbs.get(name).map_or(&[], |limb| &limb.joints)
    }

    /// A limb by its name.
    pub fn find_limb(&self, name: &str) -> Option<&Limb> {
        self.limbs.get(name)
    }

    /// A link by its name.
    pub fn link(&self, name: &str) -> Option<LinkId> {
        self.link_ids.get(name).copied()
    }

    /// A link by its name, or an error that lists all links.
    ///
    /// # Errors
    /// [`RobotError::Unknown`] when there is no such link.
    pub fn require_link(&self, name: &str) -> Result<LinkId, RobotError> {
        self.link(name).ok_or_else(|| unknown("link", name, self.link_ids.keys()))
    }

    /// A joint's index by its name.
    pub fn joint(&self, name: &str) -> Option<usize> {
        self.joint_ids.get(name).copied()
    }

    /// A joint's index by its name, or an error that lists all joints.
    ///
    /// # Errors
    /// [`RobotError::Unknown`] when there is no such joint.
    pub fn require_joint(&self, name: &str) -> Result<usize, RobotError> {
        self.joint(name).ok_or_else(|| unknown("joint", name, self.joint_ids.keys()))
    }

    /// All joints at 0, or at the limit nearest to it.
    pub fn zero(&self) -> Vec<f64> {
        self.joints.iter().map(|j| 0.0_f64.max(j.lower).min(j.upper)).collect()
    }

    /// Whether moving `joint` moves `link`.
    pub fn moves(&self, joint: usize, link: LinkId) -> bool {
        self.motions(link).any(|(_, motion)| motion.joint == joint)
    }

    /// The motions between the root and `link`, each with the link that it moves.
    pub(crate) fn motions(&self, link: LinkId) -> impl Iterator<Item = (LinkId, &JointMotion)> {
        self.movers[link.0].iter().filter_map(|&mover| Some((mover, self.links[mover.0].motion.as_ref()?)))
    }

    /// `link` and all links attached to it, parents before children.
    pub fn subtree(&self, link: LinkId) -> impl Iterator<Item = LinkId> + '_ {
        let mut inside = vec![false; self.links.len()];
        (link.0..self.links.len()).filter_map(move |i| {
            inside[i] = i == link.0 || self.links[i].parent.is_some_and(|p| inside[p.0]);
            inside[i].then_some(LinkId(i))
        })
    }

    /// The limbs with a TCP, in the order of the robot file.
    pub fn arms(&self) -> impl Iterator<Item = &Limb> {
        self.arms.iter().filter_map(|name| self.limbs.get(name))
    }

    /// The arm of that name.
    pub fn arm(&self, name: &str) -> Option<&Limb> {
        self.arms().find(|arm| arm.name == name)
    }

    /// On which side of the robot an arm begins: 1 where the root frame's x points, -1 on the other side; 1 for an arm in
    /// the middle.
    pub fn side_of(&self, arm: &Limb) -> f64 {
        let first = arm.joints.first().map(|&joint| self.joints[joint].link);
        let x = first.map_or(0.0, |link| self.link_pose(&self.zero(), link).translation.x);
        if x < -1e-6 { -1.0 } else { 1.0 }
    }

    /// The joints with which an arm reaches: those of the limbs that help it, then its own; empty if there is no such
    /// arm.
    pub fn reaching_joints(&self, arm: &str) -> Vec<usize> {
        let Some(limb) = self.limbs.get(arm) else { return Vec::new() };
        let helpers = limb.helped_by.iter().flat_map(|helper| self.limb(helper));
        helpers.chain(&limb.joints).copied().collect()
    }

    /// All hands by name.
    pub fn hands(&self) -> &BTreeMap<String, Hand> {
        &self.hands
    }

    /// The hand of an arm.
    pub fn hand_of(&self, arm: &Limb) -> Option<&Hand> {
        self.hands.get(arm.hand.as_deref()?)
    }

    /// The wrench sensors, in the order of the robot file.
    pub fn wrenches(&self) -> &[WrenchSensor] {
        &self.wrenches
    }

    /// The frame of a limb's wrench sensor.
    pub fn sensor_of(&self, limb: &Limb) -> Option<LinkId> {
        Some(self.wrenches.get(limb.wrench?)?.frame)
    }

    /// The stereo cameras with which it sees.
    pub fn camera(&self) -> Option<&StereoCamera> {
        self.camera.as_ref()
    }

    /// The name of the frame in which its pictures are: the left camera's link.
    pub fn camera_frame(&self) -> &str {
        self.camera.as_ref().map_or("camera", |camera| &self.links[camera.left.0].name)
    }

    /// The named postures: positions of all joints, rad (m).
    pub fn postures(&self) -> &BTreeMap<String, Vec<f64>> {
        &self.postures
    }

    /// A named posture, as an arm takes it: positions of all joints, rad (m).
    pub fn posture(&self, name: &str, arm: &str) -> Option<&[f64]> {
        let own = self.limbs.get(arm).and_then(|arm| arm.postures.get(name));
        self.postures.get(own.map_or(name, String::as_str)).map(Vec::as_slice)
    }

    /// The posture in which it begins: positions of all joints, rad (m).
    pub fn start(&self) -> &[f64] {
        &self.start
    }

    /// The posture in which it begins when this arm is to work: positions of all joints, rad (m).
    pub fn start_of(&self, arm: &str) -> &[f64] {
        self.start_posture.as_deref().and_then(|name| self.posture(name, arm)).unwrap_or(&self.start)
    }

    /// The posture in which a limb is ready to work: positions of all joints, rad (m). It is also the posture towards
    /// which the joints that the work leaves free are pulled. Where the robot file names none, the start.
    pub fn ready(&self, limb: &str) -> &[f64] {
        let ready = self.limbs.get(limb).and_then(|limb| self.postures.get(limb.ready.as_deref()?));
        ready.map_or(&self.start, Vec::as_slice)
    }

    /// What it drives on.
    pub fn platform(&self) -> Option<&Platform> {
        self.platform.as_ref()
    }

    /// A posture (all joints, rad or m) taken where the platform is in `now`.
    pub fn taken_at(&self, posture: &[f64], now: &[f64]) -> Vec<f64> {
        let mut q = posture.to_vec();
        for joint in self.platform.iter().flat_map(|platform| platform.joints) {
            q[joint] = now[joint];
        }
        q
    }

    /// Its own limits.
    pub fn limits(&self) -> RobotLimits {
        self.limits
    }

    /// Whether two links need not keep their distance: the SRDF disables their collisions.
    pub fn may_touch(&self, a: LinkId, b: LinkId) -> bool {
        self.may_touch.contains(&[a.min(b), a.max(b)])
    }
}

pub(crate) fn unknown<'a>(
    kind: &'static str,
    name: &str,
    known: impl Iterator<Item = &'a String>,
) -> RobotError {
    let known = known.map(String::as_str).collect::<Vec<_>>().join(", ");
    RobotError::Unknown { kind, name: name.to_owned(), known }
}
