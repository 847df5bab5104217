//! The robot's description in memory: links, joints, limbs. Immutable after reading; no state, no algorithms.
//!
//! Links are in an order in which parents come before children. Joints (only those that move) are in the order of
//! the description's depth-first walk, and so is every joint array of this room. Start at [`Model::armar3`].

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point3, Unit, Vector3};

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

/// A primitive, centred on its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Primitive {
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
}

/// A visible part of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Visual {
    /// The primitive.
    pub shape: Primitive,
    /// The shape's pose in the link's frame.
    pub link_from_shape: Isometry3<f64>,
    /// Colour: red, green, blue.
    pub color: [u8; 3],
}

/// A collision part of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Collision {
    /// The primitive.
    pub shape: Primitive,
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
    /// The joint between it and its parent; `None` for the root and for fixed links.
    pub joint: Option<usize>,
    /// Its pose in the parent's frame with the joint at 0.
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

/// A group of joints that is commanded together.
#[derive(Clone, Debug, PartialEq)]
pub struct Limb {
    /// Its name.
    pub name: String,
    /// Its joints as indices into [`Model::joints`], in the order of its commands.
    pub joints: Vec<usize>,
    /// The link at its end whose speed is limited.
    pub tcp: Option<LinkId>,
    /// The link of its force/torque sensor.
    pub sensor: Option<LinkId>,
}

/// A limb by names, as in a configuration file.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimbSpec {
    /// Its name.
    pub name: String,
    /// Names of its joints, in the order of its commands.
    pub joints: Vec<String>,
    /// The link at its end.
    #[serde(default)]
    pub tcp: Option<String>,
    /// The link of its force/torque sensor.
    #[serde(default)]
    pub sensor: Option<String>,
}

/// A robot's description.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    pub(crate) name: String,
    pub(crate) links: Vec<Link>,
    pub(crate) joints: Vec<Joint>,
    pub(crate) limbs: BTreeMap<String, Limb>,
    pub(crate) link_ids: BTreeMap<String, LinkId>,
    pub(crate) joint_ids: BTreeMap<String, usize>,
    /// For each link, the joints between it and the root.
    pub(crate) supporting: Vec<Vec<usize>>,
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
        self.supporting[link.0].contains(&joint)
    }

    /// `link` and all links attached to it, parents before children.
    pub fn subtree(&self, link: LinkId) -> impl Iterator<Item = LinkId> + '_ {
        let mut inside = vec![false; self.links.len()];
        (link.0..self.links.len()).filter_map(move |i| {
            inside[i] = i == link.0 || self.links[i].parent.is_some_and(|p| inside[p.0]);
            inside[i].then_some(LinkId(i))
        })
    }

    /// Adds limbs (or replaces those of the same name).
    ///
    /// # Errors
    /// [`RobotError::Unknown`] when a joint or link is not in the description; [`RobotError::Description`] when a
    /// limb has no joints or has one twice.
    pub fn with_limbs(mut self, limbs: &[LimbSpec]) -> Result<Self, RobotError> {
        for spec in limbs {
            let joints = spec.joints.iter().map(|j| self.require_joint(j)).collect::<Result<Vec<_>, _>>()?;
            let twice = joints.iter().enumerate().any(|(i, j)| joints[..i].contains(j));
            if joints.is_empty() || twice {
                let what = format!("the limb `{}` must list each of its joints once", spec.name);
                return Err(RobotError::Description { what });
            }
            let tcp = spec.tcp.as_deref().map(|l| self.require_link(l)).transpose()?;
            let sensor = spec.sensor.as_deref().map(|l| self.require_link(l)).transpose()?;
            let limb = Limb { name: spec.name.clone(), joints, tcp, sensor };
            self.limbs.insert(spec.name.clone(), limb);
        }
        Ok(self)
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
