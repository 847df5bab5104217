//! Two arms and a box: both arms of the robot in physics, with a soft pad on the inner side of each hand, and a box
//! that stands on a table until the arms lift it between their hands.
//!
//! The robot's first two arms, right and left, and what helps them are one multibody with the servos of the [`Plant`](super::Plant); the box is free. Only the
//! pads' pressure and friction connect it to the hands (see [`pad`](super::pad)), so it can slip and fall. There is
//! no clock, noise or guard here; [`carrying`](crate::carrying) adds sensors and the referee.

use std::sync::Arc;

use armarium_robot::{Limb, Model};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::RigidBodyHandle;

use super::assembly::Assembly;
use super::build::{add_box, add_robot, empty_room};
use super::convert;
use super::drives::Joints;
use super::pad::{Moving, Pad, PadReaction, PadSpec};
use super::plant::DT;
use crate::error::PlantError;
use crate::start::Errors;

/// Middle of the palm, TCP frame, along the fingers, m.
const PALM_MIDDLE: f64 = -0.03;
/// From the TCP to the inner side of the hand, m.
pub const HAND_HALF: f64 = 0.05;

/// The box and what it stands on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarriedBox {
    /// Mass, kg.
    pub mass: f64,
    /// Width (x, between the hands), depth (y) and height (z), m.
    pub size: [f64; 3],
    /// Where its middle is at the start, root frame, m. The table ends under it.
    pub at: [f64; 3],
    /// The hands' pads.
    pub pad: PadSpec,
}

impl Default for CarriedBox {
    fn default() -> Self {
        Self { mass: 1.5, size: [0.44, 0.30, 0.24], at: [0.0, 0.45, 1.02], pad: PadSpec::default() }
    }
}

impl CarriedBox {
    /// The middle of a pad's outer face (side 0 right, 1 left) in the frame of its TCP, m. In both hands, y points
    /// to the robot's left: to the inner side of the right hand, and to the outer side of the left hand.
    pub fn pad_middle(&self, side: usize) -> Point3<f64> {
        let inner = if side == 0 { 1.0 } else { -1.0 };
        Point3::new(0.0, inner * (HAND_HALF + self.pad.thickness), PALM_MIDDLE)
    }
}

/// A pair of values, right and left.
pub type Sides<T> = [T; 2];

struct PaddedHand {
    palm: RigidBodyHandle,
    palm_from_tcp: Isometry3<f64>,
    pad: Pad,
    outward: Vector3<f64>,
    reaction: PadReaction,
}

/// The physics of robot, box and table.
pub struct CarryingPlant {
    physics: rapier::PhysicsWorld,
    joints: Joints,
    hands: Sides<PaddedHand>,
    carried: RigidBodyHandle,
    half: Vector3<f64>,
}

impl CarryingPlant {
    /// Builds the robot in the posture `start` (positions of all the model's joints, rad or m) and the box on its
    /// table.
    ///
    /// # Errors
    /// [`PlantError`] when the robot lacks an arm or a TCP.
    pub fn new(model: &Arc<Model>, carried: &CarriedBox, start: &[f64]) -> Result<Self, PlantError> {
        let missing = |what: &str| PlantError::Missing { what: what.to_owned() };
        let arms: Vec<&Limb> = model.arms().take(2).collect();
        let [right, left] = arms[..] else { return Err(missing("second arm")) };
        let mut dynamic = model.reaching_joints(&right.name);
        dynamic.extend(&left.joints);
        let assembly = Assembly::new(model, start, &dynamic, &[]);
        let mut physics = empty_room();
        let still = vec![0.0; start.len()];
        let bodies = add_robot(
            &mut physics,
            model,
            &assembly,
            (&Isometry3::identity(), &Errors::none(start.len())),
            (start, &still),
        )?
        .bodies;
        let half = Vector3::from(carried.size) / 2.0;
        let handle = add_table_and_box(&mut physics, carried, &half);
        let hand = |side: usize| {
            let tcp = [right, left][side].tcp.ok_or_else(|| missing("TCP"))?;
            let (lump, palm_from_tcp) =
                assembly.carrier(tcp).ok_or_else(|| missing("joint that moves the TCP"))?;
            let inner = if side == 0 { 1.0 } else { -1.0 };
            let middle = carried.pad_middle(side);
            let edges = (Vector3::z() * carried.pad.half[0], Vector3::x() * carried.pad.half[1]);
            Ok::<_, PlantError>(PaddedHand {
                palm: bodies[lump].handle,
                palm_from_tcp,
                pad: Pad::new(carried.pad, carried.mass, middle, edges.0, edges.1),
                outward: Vector3::x() * inner,
                reaction: PadReaction::default(),
            })
        };
        let hands = [hand(0)?, hand(1)?];
        let joints = Joints::new(model, bodies, &dynamic, start);
        Ok(Self { physics, joints, hands, carried: handle, half })
    }

    /// True joint positions, rad or m, in the model's order.
    pub fn position(&self) -> &[f64] {
        &self.joints.position
    }

    /// True joint velocities, rad/s or m/s.
    pub fn velocity(&self) -> &[f64] {
        &self.joints.velocity
    }

    /// Pose of the box's middle.
    pub fn carried(&self) -> Isometry3<f64> {
        convert::to_pose(self.physics.bodies[self.carried].position())
    }

    /// Poses of the TCPs, right and left.
    pub fn tcps(&self) -> Sides<Isometry3<f64>> {
        self.hands
            .each_ref()
            .map(|h| convert::to_pose(self.physics.bodies[h.palm].position()) * h.palm_from_tcp)
    }

    /// The forces of the box on the hands in the last step, right and left; torques about the TCPs.
    pub fn reactions(&self) -> Sides<PadReaction> {
        self.hands.each_ref().map(|h| h.reaction)
    }

    /// Advances by [`DT`]. The servo targets are positions and velocities of all joints.
    pub fn step(&mut self, position: &[f64], velocity: &[f64]) {
        self.joints.set_targets(&mut self.physics, (position, velocity));
        self.press();
        self.physics.step();
        self.joints.read(&self.physics, (position, velocity));
    }

    /// Applies the pads' forces to hands and box.
    fn press(&mut self) {
        let carried = moving(&self.physics.bodies[self.carried], &Isometry3::identity());
        let bodies = &mut self.physics.bodies;
        bodies[self.carried].reset_forces(false);
        bodies[self.carried].reset_torques(false);
        let middle = carried.pose.translation.vector;
        for hand in &mut self.hands {
            let tcp = moving(&bodies[hand.palm], &hand.palm_from_tcp);
            hand.reaction = hand.pad.step(&tcp, &carried, &self.half, &hand.outward, DT);
            let PadReaction { force, torque, .. } = hand.reaction;
            let at = tcp.pose.translation.vector;
            let palm = &mut bodies[hand.palm];
            palm.reset_forces(false);
            palm.reset_torques(false);
            palm.add_force_at_point(convert::vector(&force), convert::vector(&at), true);
            palm.add_torque(convert::vector(&torque), true);
            let on_box = -(torque + (at - middle).cross(&force));
            bodies[self.carried].add_force(convert::vector(&-force), true);
            bodies[self.carried].add_torque(convert::vector(&on_box), true);
        }
    }
}

fn add_table_and_box(
    physics: &mut rapier::PhysicsWorld,
    spec: &CarriedBox,
    half: &Vector3<f64>,
) -> RigidBodyHandle {
    let [x, y, z] = spec.at;
    let top = z - half.z;
    let table = rapier::ColliderBuilder::cuboid(1.0, 1.0, 0.02)
        .translation(rapier::Vector::new(x, y + 0.8, top - 0.02))
        .friction(0.4);
    physics.insert_collider(table, None);
    let pose = Isometry3::from_parts(Vector3::new(x, y, z).into(), UnitQuaternion::identity());
    let handle = add_box(physics, &pose, spec.size, spec.mass);
    let shape = rapier::ColliderBuilder::cuboid(half.x, half.y, half.z).density(0.0).friction(0.4);
    physics.insert_collider(shape, Some(handle));
    handle
}

/// The motion of a body, or of a frame fixed in it.
fn moving(body: &rapier::RigidBody, body_from_frame: &Isometry3<f64>) -> Moving {
    let pose = convert::to_pose(body.position()) * body_from_frame;
    let angular = convert::to_vector(body.angvel());
    let arm = pose.translation.vector - convert::to_vector(body.center_of_mass());
    Moving { pose, linear: convert::to_vector(body.linvel()) + angular.cross(&arm), angular }
}
