//! Which links of the robot move together: reduces a model's tree to the bodies of the physics.
//!
//! Some joints have bodies. Links attached to those by fixed joints, and links of joints without bodies, are lumped into
//! the body that carries them, in the robot's present posture. This module only computes the bodies and does not step
//! them.

use armarium_robot::{Geometry, JointKind, LinkId, Model};
use nalgebra::{Isometry3, Unit, Vector3};

use super::mass::Mass;

/// One body of the physics with its joint. Its frame is that of the link that the joint moves.
#[derive(Clone, Debug)]
pub(super) struct Lump {
    /// The parent body; `None` if it is attached to the room.
    pub(super) parent: Option<usize>,
    /// Index of the joint in the model.
    pub(super) joint: usize,
    /// The link that it moves.
    pub(super) link: LinkId,
    pub(super) kind: JointKind,
    pub(super) axis: Unit<Vector3<f64>>,
    /// Its own position is `multiplier * q + offset`, where `q` is the joint's.
    pub(super) multiplier: f64,
    pub(super) offset: f64,
    /// Pose in the parent body's frame (the room's, for the first) with the joint at 0.
    pub(super) parent_from_body: Isometry3<f64>,
    pub(super) mass: Mass,
}

/// A collision shape of a link that touches.
#[derive(Clone, Debug)]
pub(super) struct Touching {
    /// The link.
    pub(super) link: LinkId,
    /// The lump that carries it; `None` for the room.
    pub(super) lump: Option<usize>,
    /// Its form.
    pub(super) shape: Geometry,
    /// Its pose in the lump's frame (the room's).
    pub(super) body_from_shape: Isometry3<f64>,
}

/// The part of the robot beyond a wrench sensor.
#[derive(Clone, Debug)]
pub(super) struct Wrist {
    /// The lump that carries sensor and palm; `None` if nothing moves them.
    pub(super) lump: Option<usize>,
    /// The sensor in that lump's frame.
    pub(super) body_from_sensor: Isometry3<f64>,
    /// The TCP in that lump's frame.
    pub(super) body_from_tcp: Isometry3<f64>,
    /// Mass beyond the sensor that moves with the lump, in the lump's frame.
    pub(super) palm: Mass,
    /// Lumps beyond the sensor: the fingers.
    pub(super) fingers: Vec<usize>,
}

/// The robot as bodies.
#[derive(Clone, Debug)]
pub(super) struct Assembly {
    pub(super) lumps: Vec<Lump>,
    /// The collision shapes of the links that touch.
    pub(super) touching: Vec<Touching>,
    /// For every link of the model: the lump that carries it, if any, and its pose in that lump.
    links: Vec<(Option<usize>, Isometry3<f64>)>,
    /// True mass beyond a wrench sensor over that of the model.
    hand_mass_scale: f64,
}

impl Assembly {
    /// Splits a model into the bodies of the `dynamic` joints; all others stand in `posture`. What the `touching` joints
    /// move has collision shapes. What is beyond a wrench sensor is `hand_mass_scale` times as heavy as the model says.
    pub(super) fn new(
        model: &Model,
        posture: &[f64],
        (dynamic, touching): (&[usize], &[usize]),
        hand_mass_scale: f64,
    ) -> Self {
        let mut lumps: Vec<Lump> = Vec::new();
        let mut links: Vec<(Option<usize>, Isometry3<f64>)> = Vec::new();
        let mut shapes = Vec::new();
        // For every link, whether the joint that moves it against what carries it touches.
        let mut touches: Vec<bool> = Vec::new();
        let hands: Vec<LinkId> =
            model.wrenches().iter().flat_map(|sensor| model.subtree(sensor.frame)).collect();
        for (link, id) in model.links().iter().zip(model.link_ids()) {
            let parent = link.parent.map(LinkId::index);
            let (inherited, parent_pose) = parent.map_or((None, Isometry3::identity()), |p| links[p]);
            let at_zero = parent_pose * link.parent_from_link;
            touches.push(match link.motion {
                Some(motion) => touching.contains(&motion.joint),
                None => parent.is_some_and(|p| touches[p]),
            });
            if let Some(motion) = link.motion.filter(|motion| dynamic.contains(&motion.joint)) {
                links.push((Some(lumps.len()), Isometry3::identity()));
                lumps.push(Lump {
                    parent: inherited,
                    joint: motion.joint,
                    link: id,
                    kind: motion.kind,
                    axis: motion.axis,
                    multiplier: motion.multiplier,
                    offset: motion.offset,
                    parent_from_body: at_zero,
                    mass: Mass::default(),
                });
            } else {
                let moved = link.motion.map_or_else(Isometry3::identity, |motion| {
                    joint_motion(motion.kind, &motion.axis, motion.position(posture))
                });
                links.push((inherited, at_zero * moved));
            }
            let (lump, body_from_link) = links[id.index()];
            if let (Some(lump), Some(inertial)) = (lump, &link.inertial) {
                let scale = if hands.contains(&id) { hand_mass_scale } else { 1.0 };
                lumps[lump].mass.add_link(inertial, &body_from_link, scale);
            }
            if touches[id.index()] {
                shapes.extend(link.collisions.iter().map(|collision| Touching {
                    link: id,
                    lump,
                    shape: collision.shape.clone(),
                    body_from_shape: body_from_link * collision.link_from_shape,
                }));
            }
        }
        Self { lumps, touching: shapes, links, hand_mass_scale }
    }

    /// What is beyond a wrench sensor whose hand's TCP is given.
    pub(super) fn wrist(&self, model: &Model, sensor: LinkId, tcp: LinkId) -> Wrist {
        let (lump, body_from_sensor) = self.links[sensor.index()];
        let mut palm = Mass::default();
        let mut fingers = Vec::new();
        for link in model.subtree(sensor) {
            let (carrier, body_from_link) = self.links[link.index()];
            if let Some(finger) = carrier.filter(|_| carrier != lump) {
                if !fingers.contains(&finger) {
                    fingers.push(finger);
                }
            } else if let Some(inertial) = &model.links()[link.index()].inertial {
                palm.add_link(inertial, &body_from_link, self.hand_mass_scale);
            }
        }
        Wrist { lump, body_from_sensor, body_from_tcp: self.links[tcp.index()].1, palm, fingers }
    }
}

/// The motion of a joint: a rotation about its axis or a translation along it.
pub(super) fn joint_motion(kind: JointKind, axis: &Unit<Vector3<f64>>, q: f64) -> Isometry3<f64> {
    match kind {
        JointKind::Revolute => Isometry3::rotation(axis.into_inner() * q),
        JointKind::Prismatic => {
            Isometry3::from_parts((axis.into_inner() * q).into(), nalgebra::UnitQuaternion::identity())
        }
    }
}
