//! Which links of the robot move together: reduces a model's tree to the bodies of the physics.
//!
//! One arm, what helps it and its hand have dynamics. Links attached to them by fixed joints, and those of all other
//! limbs (which follow their set points exactly), are lumped into the body that carries them, in the robot's start
//! posture. This module only computes the bodies and does not step them.

use crate::error::PlantError;
use armarium_robot::{Geometry, JointKind, Kinematics, Limb, LinkId, Model};
use nalgebra::{Isometry3, Matrix3, Point3, Unit, Vector3};

/// Mass, centre and inertia about the centre, in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Mass {
    pub(super) mass: f64,
    /// First moment: mass times centre, kg m.
    moment: Vector3<f64>,
    /// Inertia about the frame's origin, kg m^2.
    about_origin: Matrix3<f64>,
}

impl Mass {
    /// Adds a body whose inertia about its own centre is given along the frame's axes.
    fn add(&mut self, mass: f64, center: &Point3<f64>, inertia: &Matrix3<f64>) {
        self.mass += mass;
        self.moment += center.coords * mass;
        self.about_origin += inertia + steiner(mass, &center.coords);
    }

    pub(super) fn center(&self) -> Point3<f64> {
        if self.mass > 0.0 { Point3::from(self.moment / self.mass) } else { Point3::origin() }
    }

    /// Inertia about the centre, kg m^2.
    pub(super) fn inertia(&self) -> Matrix3<f64> {
        self.about_origin - steiner(self.mass, &self.center().coords)
    }
}

fn steiner(mass: f64, c: &Vector3<f64>) -> Matrix3<f64> {
    (Matrix3::identity() * c.norm_squared() - c * c.transpose()) * mass
}

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
    /// Collision shapes, with their poses in the body's frame.
    pub(super) collisions: Vec<(Geometry, Isometry3<f64>)>,
}

/// The part of the robot beyond the wrist sensor that does not have a lump of its own.
#[derive(Clone, Debug)]
pub(super) struct Wrist {
    /// The lump that carries sensor and palm.
    pub(super) lump: usize,
    /// The sensor in that lump's frame.
    pub(super) body_from_sensor: Isometry3<f64>,
    /// The TCP in that lump's frame.
    pub(super) body_from_tcp: Isometry3<f64>,
    /// Mass beyond the sensor that moves with the lump, in the lump's frame.
    pub(super) palm: Mass,
    /// Lumps attached to the palm: the fingers.
    pub(super) fingers: Vec<usize>,
}

/// The robot as bodies.
#[derive(Clone, Debug)]
pub(super) struct Assembly {
    pub(super) lumps: Vec<Lump>,
    /// Joints without dynamics, as indices into the model's.
    pub(super) ideal: Vec<usize>,
    pub(super) wrist: Wrist,
    /// For every link of the model: the lump that carries it, if any, and its pose in that lump.
    links: Vec<(Option<usize>, Isometry3<f64>)>,
}

impl Assembly {
    /// Splits a model into bodies of which `arm` works. `start` is the posture in which the masses of ideal limbs are added.
    ///
    /// # Errors
    /// [`PlantError::Missing`] when the model lacks a link or limb that the simulator needs.
    pub(super) fn new(kinematics: &Kinematics, arm: &Limb, start: &[f64]) -> Result<Self, PlantError> {
        let model = kinematics.model();
        let hand = arm.hand.as_deref().map_or(&[][..], |hand| model.limb(hand));
        let touching: Vec<usize> = arm.joints.iter().chain(hand).copied().collect();
        let mut dynamic = model.reaching_joints(&arm.name);
        dynamic.extend(hand);
        Self::moving(kinematics, arm, start, &dynamic, &touching)
    }

    /// The same with `dynamic` joints that the physics moves; the bodies of the `touching` ones have collision shapes.
    ///
    /// # Errors
    /// As [`Assembly::new`].
    pub(super) fn moving(
        kinematics: &Kinematics,
        arm: &Limb,
        start: &[f64],
        dynamic: &[usize],
        touching: &[usize],
    ) -> Result<Self, PlantError> {
        let model = kinematics.model();
        let missing = |what: &str| PlantError::Missing { what: what.to_owned() };
        let tcp = arm.tcp.ok_or_else(|| missing(&format!("TCP of `{}`", arm.name)))?;
        // Without a sensor nothing is felt, wherever it would be.
        let sensor = model.sensor_of(arm).unwrap_or(tcp);

        let mut lumps: Vec<Lump> = Vec::new();
        let mut carrier: Vec<Option<usize>> = Vec::new();
        let mut carrier_from_link: Vec<Isometry3<f64>> = Vec::new();
        let mut palm = Mass::default();
        let beyond = beyond_sensor(model, sensor);
        for (i, link) in model.links().iter().enumerate() {
            let parent = link.parent.map(LinkId::index);
            let at_zero =
                parent.map_or_else(Isometry3::identity, |p| carrier_from_link[p]) * link.parent_from_link;
            let inherited = parent.and_then(|p| carrier[p]);
            if let Some(motion) = link.motion.filter(|motion| dynamic.contains(&motion.joint)) {
                carrier.push(Some(lumps.len()));
                carrier_from_link.push(Isometry3::identity());
                lumps.push(Lump {
                    parent: inherited,
                    joint: motion.joint,
                    link: model.link(&link.name).ok_or_else(|| missing(&link.name))?,
                    kind: motion.kind,
                    axis: motion.axis,
                    multiplier: motion.multiplier,
                    offset: motion.offset,
                    parent_from_body: at_zero,
                    mass: Mass::default(),
                    collisions: Vec::new(),
                });
            } else {
                let moved = link.motion.map_or_else(Isometry3::identity, |motion| {
                    joint_motion(motion.kind, &motion.axis, motion.position(start))
                });
                carrier.push(inherited);
                carrier_from_link.push(at_zero * moved);
            }
            let Some(carried_by) = carrier[i] else { continue };
            let body_from_link = carrier_from_link[i];
            let lump = &mut lumps[carried_by];
            if let Some(inertial) = &link.inertial {
                let r = body_from_link.rotation.to_rotation_matrix();
                let inertia = r.matrix() * inertial.inertia * r.matrix().transpose();
                let center = body_from_link * inertial.center;
                lump.mass.add(inertial.mass, &center, &inertia);
                if beyond[i] && !link.motion.is_some_and(|motion| dynamic.contains(&motion.joint)) {
                    palm.add(inertial.mass, &center, &inertia);
                }
            }
            if touching.contains(&lump.joint) {
                let collisions =
                    link.collisions.iter().map(|c| (c.shape.clone(), body_from_link * c.link_from_shape));
                lump.collisions.extend(collisions);
            }
        }
        let lump = carrier[sensor.index()].ok_or_else(|| missing("joint that moves the wrench sensor"))?;
        let fingers = (0..lumps.len()).filter(|i| lumps[*i].parent == Some(lump)).collect();
        let wrist = Wrist {
            lump,
            body_from_sensor: carrier_from_link[sensor.index()],
            body_from_tcp: carrier_from_link[tcp.index()],
            palm,
            fingers,
        };
        let ideal = (0..model.joints().len()).filter(|j| !dynamic.contains(j)).collect();
        Ok(Self { lumps, ideal, wrist, links: carrier.into_iter().zip(carrier_from_link).collect() })
    }

    /// The lump that carries a link, and the link's pose in it; `None` for links that do not move.
    pub(super) fn carrier(&self, link: LinkId) -> Option<(usize, Isometry3<f64>)> {
        let (lump, pose) = self.links.get(link.index())?;
        Some(((*lump)?, *pose))
    }
}

/// For every link, whether it is attached beyond the sensor.
fn beyond_sensor(model: &Model, sensor: LinkId) -> Vec<bool> {
    let mut beyond = vec![false; model.links().len()];
    for link in model.subtree(sensor) {
        beyond[link.index()] = true;
    }
    beyond
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
