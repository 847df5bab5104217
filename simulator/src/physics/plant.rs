//! Robot, table and objects as Rapier bodies, stepped at 1 kHz.
//!
//! - The arm that works, what helps it and its hand are one multibody in reduced coordinates. Every joint has a servo: a stiff
//!   spring and damper about the set point, with feed-forward of the set velocity. It is integrated implicitly, and
//!   its force is limited by the joint's effort. The servo compensates the robot's own weight by its nominal model.
//!   As that model is exact, the two cancel and gravity is left out for these bodies (loads and contacts act in
//!   full).
//! - All other limbs follow their set points exactly.
//! - Objects are free boxes on an [`ElasticFoundation`] of springs. Rapier handles their contacts with the fingers,
//!   and a thin core keeps them from falling through the table when they lie on their side.
//! - An object is held by a fixed joint that exists only while both finger pads press on it (see [`grip`](super::grip)).
//! - The wrist sensor is exact here (see [`wrench`](super::wrench)); noise is added in the sensing.

use std::sync::Arc;

use armarium_robot::{Kinematics, Model};
use nalgebra::{Isometry3, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, MultibodyJointHandle, RigidBodyHandle};

use super::assembly::Assembly;
use super::build::{add_object, add_robot, add_room, empty_room};
use super::convert;
use super::drives::Joints;
use super::grip::{Grip, PadPress};
use super::wrench::{Momentum, WristWrench};
use crate::error::PlantError;
use crate::foundation::{ElasticFoundation, FoundationReaction, Motion};
use crate::table::TableTop;
use crate::world::World;

/// One step, s.
pub const DT: f64 = 1e-3;
/// Friction of finger pads on objects.
pub const PAD_FRICTION: f64 = 0.9;

/// Forces from outside in one step, root frame, N.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct External {
    /// On the hand of the arm that works, at the TCP.
    pub hand: Vector3<f64>,
    /// On each object's middle.
    pub objects: Vec<Vector3<f64>>,
}

/// An object's body.
#[derive(Clone, Debug)]
pub(super) struct Object {
    pub(super) handle: RigidBodyHandle,
    pub(super) collider: ColliderHandle,
    pub(super) foundation: ElasticFoundation,
    pub(super) reaction: FoundationReaction,
}

/// The physics of a world.
pub struct Plant {
    physics: rapier::PhysicsWorld,
    table: TableTop,
    joints: Joints,
    objects: Vec<Object>,
    pads: Vec<ColliderHandle>,
    grip: Grip,
    palm: RigidBodyHandle,
    fingers: Vec<RigidBodyHandle>,
    body_from_tcp: Isometry3<f64>,
    wrench: WristWrench,
}

impl Plant {
    /// Builds the world with the robot in the posture `start`: positions of all the model's joints, rad or m.
    ///
    /// # Errors
    /// [`PlantError`] when the robot lacks a limb or link that the simulator needs.
    pub fn new(model: &Arc<Model>, world: &World, start: &[f64]) -> Result<Self, PlantError> {
        let kinematics = Kinematics::new(model);
        let arm = world
            .robot
            .arm(model)
            .ok_or_else(|| PlantError::Missing { what: "arm that works".to_owned() })?;
        let assembly = Assembly::new(&kinematics, arm, start)?;
        let mut physics = empty_room();
        let table = TableTop::new(&world.table);
        add_room(&mut physics, &table);
        let (bodies, pads) = add_robot(&mut physics, model, &assembly, start)?;
        let objects: Vec<_> = world.objects.iter().map(|o| add_object(&mut physics, &table, o)).collect();
        let wrist = &assembly.wrist;
        let palm = bodies[wrist.lump].handle;
        let mut plant = Self {
            table,
            palm,
            fingers: wrist.fingers.iter().map(|f| bodies[*f].handle).collect(),
            body_from_tcp: wrist.body_from_tcp,
            wrench: WristWrench::new(wrist, world.objects.len()),
            grip: Grip::default(),
            joints: Joints::new(&physics, bodies, assembly.ideal.clone(), start),
            physics,
            objects,
            pads,
        };
        plant.weigh();
        plant.sense_wrist(&External::default());
        Ok(plant)
    }

    /// True joint positions, rad or m, in the model's order.
    pub fn position(&self) -> &[f64] {
        &self.joints.position
    }

    /// True joint velocities, rad/s or m/s.
    pub fn velocity(&self) -> &[f64] {
        &self.joints.velocity
    }

    /// The table.
    pub fn table(&self) -> &TableTop {
        &self.table
    }

    /// Pose of the TCP of the arm that works.
    pub fn tcp(&self) -> Isometry3<f64> {
        convert::to_pose(self.physics.bodies[self.palm].position()) * self.body_from_tcp
    }

    /// Velocity of that TCP, m/s, root frame.
    pub fn tcp_velocity(&self) -> Vector3<f64> {
        let body = &self.physics.bodies[self.palm];
        let tcp = self.tcp().translation.vector;
        let arm = tcp - convert::to_vector(body.center_of_mass());
        convert::to_vector(body.linvel()) + convert::to_vector(body.angvel()).cross(&arm)
    }

    /// Pose of an object's middle.
    pub fn object(&self, index: usize) -> Option<Isometry3<f64>> {
        self.objects.get(index).map(|o| convert::to_pose(self.physics.bodies[o.handle].position()))
    }

    /// The springs under an object.
    pub fn foundation(&self, index: usize) -> Option<&ElasticFoundation> {
        self.objects.get(index).map(|o| &o.foundation)
    }

    /// The force of the table on an object in the last step.
    pub fn reaction(&self, index: usize) -> Option<&FoundationReaction> {
        self.objects.get(index).map(|o| &o.reaction)
    }

    /// Index of the object that the hand holds.
    pub fn held(&self) -> Option<usize> {
        self.grip.held()
    }

    /// Force and torque of the hand on the wrist sensor in the last step, in the sensor's frame, without noise, N
    /// and N m.
    pub fn wrist(&self) -> (Vector3<f64>, Vector3<f64>) {
        self.wrench.reading()
    }

    /// Advances by [`DT`]. The servo targets are positions and velocities of all joints.
    pub fn step(&mut self, position: &[f64], velocity: &[f64], external: &External) {
        self.joints.set_targets(&mut self.physics, (position, velocity));
        self.apply(external);
        self.physics.step();
        self.joints.read(&self.physics, (position, velocity));
        self.update_grip(external);
        self.sense_wrist(external);
    }

    fn apply(&mut self, external: &External) {
        let tcp = self.tcp().translation.vector;
        let palm = &mut self.physics.bodies[self.palm];
        palm.reset_forces(false);
        palm.reset_torques(false);
        if external.hand != Vector3::zeros() {
            palm.add_force_at_point(convert::vector(&external.hand), convert::vector(&tcp), true);
        }
        for (i, object) in self.objects.iter_mut().enumerate() {
            let body = &mut self.physics.bodies[object.handle];
            let motion = Motion {
                root_from_object: convert::to_pose(body.position()),
                linear: convert::to_vector(body.linvel()),
                angular: convert::to_vector(body.angvel()),
            };
            object.reaction = object.foundation.step(&self.table, &motion, DT);
            let force = object.reaction.force + external.objects.get(i).copied().unwrap_or_default();
            body.reset_forces(false);
            body.reset_torques(false);
            body.add_force(convert::vector(&force), true);
            body.add_torque(convert::vector(&object.reaction.torque), true);
        }
    }

    /// Makes or breaks the joint between palm and object.
    fn update_grip(&mut self, external: &External) {
        let presses: Vec<Vec<PadPress>> = (0..self.objects.len())
            .map(|o| self.pads.iter().map(|pad| self.press(*pad, self.objects[o].collider)).collect())
            .collect();
        let load = self.grip.held().map(|held| {
            let body = &self.physics.bodies[self.objects[held].handle];
            let reaction = &self.objects[held].reaction;
            let knock = external.objects.get(held).copied().unwrap_or_default();
            let momentum = Momentum::of_body(body);
            self.wrench.load(held, &momentum, &(reaction.force + knock), &reaction.torque)
        });
        let before = self.grip.held();
        self.grip.step(&presses, load, DT);
        let after = self.grip.held();
        if before == after {
            return;
        }
        if let Some(lost) = before {
            let joint = MultibodyJointHandle(self.objects[lost].handle.0);
            self.physics.multibody_joints.remove(joint, true);
        }
        if let Some(taken) = after {
            self.join(taken);
        }
    }

    fn join(&mut self, index: usize) {
        let handle = self.objects[index].handle;
        let palm_from_object =
            self.physics.bodies[self.palm].position().inverse() * *self.physics.bodies[handle].position();
        let joint = rapier::FixedJointBuilder::new().local_frame1(palm_from_object).build();
        self.physics.multibody_joints.insert(self.palm, handle, joint, true);
    }

    /// The pressure of a pad on an object.
    fn press(&self, pad: ColliderHandle, object: ColliderHandle) -> PadPress {
        let Some(pair) = self.physics.narrow_phase.contact_pair(pad, object) else {
            return PadPress::default();
        };
        let impulse: f64 =
            pair.solver_manifolds().iter().flat_map(|m| &m.points).map(|p| p.data.impulse).sum();
        PadPress { touches: pair.has_any_active_contact(), force: impulse / DT }
    }

    /// Moves an object to another pose, at rest.
    pub fn place(&mut self, index: usize, root_from_object: &Isometry3<f64>) {
        if let Some(object) = self.objects.get(index) {
            let body = &mut self.physics.bodies[object.handle];
            body.set_position(convert::pose(root_from_object), true);
            body.set_linvel(rapier::Vector::ZERO, true);
            body.set_angvel(rapier::Vector::ZERO, true);
        }
        self.weigh();
    }

    fn weigh(&mut self) {
        let (fingers, objects) = self.momenta();
        self.wrench.remember(&self.physics.bodies[self.palm], &fingers, &objects);
    }

    /// Of the fingers, and of the objects.
    fn momenta(&self) -> (Vec<Momentum>, Vec<Momentum>) {
        let of = |handle: RigidBodyHandle| Momentum::of_body(&self.physics.bodies[handle]);
        let fingers = self.fingers.iter().map(|finger| of(*finger)).collect();
        (fingers, self.objects.iter().map(|object| of(object.handle)).collect())
    }

    fn sense_wrist(&mut self, external: &External) {
        let held = self.grip.held();
        let tcp = self.tcp().translation.vector;
        let mut force = external.hand;
        let mut torque = tcp.cross(&external.hand);
        if let Some(h) = held {
            let middle = convert::to_vector(self.physics.bodies[self.objects[h].handle].center_of_mass());
            let reaction = &self.objects[h].reaction;
            let on_object = reaction.force + external.objects.get(h).copied().unwrap_or_default();
            force += on_object;
            torque += middle.cross(&on_object) + reaction.torque;
        }
        let (contact_force, contact_torque) = self.contacts_from_outside(held);
        let (fingers, objects) = self.momenta();
        self.wrench.update(
            &self.physics.bodies[self.palm],
            &fingers,
            &objects,
            held,
            &(force + contact_force),
            &(torque + contact_torque),
        );
    }

    /// Force and torque, about the room's origin, of Rapier's contacts between the bodies beyond the wrist sensor
    /// and everything else.
    fn contacts_from_outside(&self, held: Option<usize>) -> (Vector3<f64>, Vector3<f64>) {
        let inside = |handle: Option<RigidBodyHandle>| {
            handle.is_some_and(|h| {
                h == self.palm
                    || self.fingers.contains(&h)
                    || held.is_some_and(|o| self.objects[o].handle == h)
            })
        };
        let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
        for pair in self.physics.narrow_phase.contact_pairs() {
            for manifold in pair.solver_manifolds() {
                let data = &manifold.data;
                let sign = match (inside(data.rigid_body1), inside(data.rigid_body2)) {
                    (true, false) => -1.0,
                    (false, true) => 1.0,
                    _ => continue,
                };
                for contact in &data.solver_contacts {
                    let (a, b) = data.solver_contact_world_points(contact, &self.physics.bodies);
                    let point = convert::to_vector((a + b) * 0.5);
                    let Some(solved) = manifold.points.get(contact.contact_id[0] as usize) else { continue };
                    let impulse = data.normal * solved.data.impulse + solved.data.warmstart_tangent_world;
                    let f = convert::to_vector(impulse) * (sign / DT);
                    force += f;
                    torque += point.cross(&f);
                }
            }
        }
        (force, torque)
    }
}
