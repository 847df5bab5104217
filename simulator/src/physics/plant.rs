//! Robots, table and bodies in Rapier, stepped at 1 kHz.
//!
//! - The arms of a robot, what helps them and their hands are one multibody in reduced coordinates. Every joint has a servo: a
//!   stiff spring and damper about the set point, with feed-forward of the set velocity. It is integrated implicitly, and
//!   its force is limited by the joint's effort. The servo compensates the robot's own weight by its nominal model.
//!   As that model is exact, the two cancel and gravity is left out for these bodies (loads and contacts act in
//!   full).
//! - An arm that stands, with no new set point and touched by nothing, sleeps with what it holds: its joints are stiff until
//!   it is commanded or touched, and cost nothing (see [`PlantRobot`]).
//! - Joints of other limbs, such as the head's, have servos of their own that move the inertia beyond them; their motion
//!   does not shake the rest.
//! - Soft objects are free boxes on an [`ElasticFoundation`] of springs. Rapier handles their contacts with the fingers,
//!   and a thin core keeps them from falling through the table when they lie on their side. Rapier handles rigid bodies
//!   alone; for them the table is flat.
//! - An object is held by a fixed joint that exists only while both finger pads press on it (see [`grip`](super::grip)); one with
//!   handles by springs instead (see [`soft_grip`](super::soft_grip)), by several hands at once.
//! - The wrist sensors are exact here (see [`wrench`](super::wrench)); noise is added in the sensing.

use armarium_robot::{ForceTorque, LinkId};
use nalgebra::{Isometry3, Vector3};
use rapier3d_f64::parry::query;
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, MultibodyJointHandle, RigidBodyHandle};

use super::build::{add_body, add_room, empty_room};
use super::contacts::{ExternalWrench, Touch, touches};
use super::convert;
use super::pad::{Moving, PadReaction};
use super::people::{LedHand, PersonBodies};
use super::robot::{ArmWithHand, PaddedHand, PlantRobot};
use super::slippery::Slippery;
use super::soft_grip::SoftGrip;
use super::wrench::Momentum;
use crate::error::PlantError;
use crate::foundation::{ElasticFoundation, FoundationReaction, RigidMotion};
use crate::person::Posture;
use crate::start::{self, RobotStart};
use crate::table::TableTop;
use crate::world::{PersonSpec, World};

/// One step, s.
pub const DT: f64 = 1e-3;
/// Friction of finger pads on objects.
pub const PAD_FRICTION: f64 = 0.9;

/// Positions and velocities of all joints of a robot, rad (m) and rad/s (m/s).
pub type Targets<'a> = (&'a [f64], &'a [f64]);

/// Forces from outside in one step, root frame, N.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct External {
    /// On the hand of the first robot's arm that works, at the TCP.
    pub hand: Vector3<f64>,
    /// On its forearm, at its middle: its wrench sensor does not feel that.
    pub arm: Vector3<f64>,
    /// On each body's middle.
    pub objects: Vec<Vector3<f64>>,
    /// The friction of bodies, by their index, that are slippery in this step.
    pub slippery: Vec<(usize, f64)>,
}

/// A body that is no part of a robot.
#[derive(Clone, Debug)]
pub(super) struct Object {
    pub(super) handle: RigidBodyHandle,
    pub(super) colliders: Vec<ColliderHandle>,
    /// The springs under a soft one.
    pub(super) foundation: Option<ElasticFoundation>,
    /// The force of those springs in the last step.
    pub(super) reaction: FoundationReaction,
    /// Whether a hand can take it.
    pub(super) loose: bool,
    /// Whether it has handles, so that hands grip it softly.
    pub(super) has_handles: bool,
    /// While it is slippery.
    pub(super) slippery: Option<Slippery>,
    /// Half the edges of a rigid box, m.
    pub(super) cuboid: Option<Vector3<f64>>,
}

/// The physics of a world.
pub struct Plant {
    pub(super) physics: rapier::PhysicsWorld,
    table: TableTop,
    table_collider: ColliderHandle,
    pub(super) objects: Vec<Object>,
    pub(super) robots: Vec<PlantRobot>,
    people: Vec<PersonBodies>,
    /// The contacts of the last step.
    pub(super) touches: Vec<Touch>,
    /// Whether a joint holds what a hand grips, besides the contacts.
    pub(super) joins: bool,
}

impl Plant {
    /// Builds the world with its robots; [`start::robots`] gives them. The first robot's root is the room's origin.
    ///
    /// # Errors
    /// [`PlantError`] when a robot lacks a limb or link that the simulator needs.
    pub fn new(world: &World, robots: Vec<RobotStart>) -> Result<Self, PlantError> {
        let mut physics = empty_room();
        let table = TableTop::new(&world.table);
        let table_collider = add_room(&mut physics, &table);
        let bodies = start::bodies(world, &table);
        let mut robots = robots.into_iter();
        let first = robots.next().ok_or_else(|| PlantError::Missing { what: "robot".into() })?;
        let mut all = vec![PlantRobot::new(&mut physics, first, bodies.len())?];
        let objects: Vec<_> = bodies.iter().map(|body| add_body(&mut physics, &table, body)).collect();
        for robot in robots {
            all.push(PlantRobot::new(&mut physics, robot, bodies.len())?);
        }
        let stand = |spec: &PersonSpec| PersonBodies::new(&mut physics, spec, Posture::standing(spec));
        let people = world.people().map(stand).collect();
        let mut plant = Self {
            physics,
            table,
            table_collider,
            objects,
            robots: all,
            people,
            touches: Vec::new(),
            joins: true,
        };
        plant.weigh();
        let momenta = plant.momenta();
        plant.feel(&External::default(), &momenta);
        Ok(plant)
    }

    /// True joint positions of a robot, rad or m, in its model's order.
    pub fn position(&self, robot: usize) -> &[f64] {
        &self.robots[robot].joints.position
    }

    /// The positions of a robot's motors, where its angles are measured, rad or m.
    pub fn motors(&self, robot: usize) -> &[f64] {
        &self.robots[robot].joints.motors
    }

    /// True joint velocities of a robot, rad/s or m/s.
    pub fn velocity(&self, robot: usize) -> &[f64] {
        &self.robots[robot].joints.velocity
    }

    /// The table.
    pub fn table(&self) -> &TableTop {
        &self.table
    }

    /// Pose of the TCP of a robot's arm that works, in the room.
    pub fn tcp(&self, robot: usize) -> Isometry3<f64> {
        self.robots[robot].hand().tcp(&self.physics.bodies)
    }

    /// Velocity of that TCP, m/s, in the room.
    pub fn tcp_velocity(&self, robot: usize) -> Vector3<f64> {
        self.robots[robot].hand().tcp_velocity(&self.physics.bodies)
    }

    /// Pose of an object's middle.
    pub fn object(&self, index: usize) -> Option<Isometry3<f64>> {
        self.objects.get(index).map(|o| convert::to_pose(self.physics.bodies[o.handle].position()))
    }

    /// The mass of a body, kg.
    pub fn mass(&self, index: usize) -> Option<f64> {
        self.objects.get(index).map(|o| self.physics.bodies[o.handle].mass())
    }

    /// Whether something has handles.
    pub fn has_handles(&self) -> bool {
        self.objects.iter().any(|object| object.has_handles)
    }

    /// The springs under an object, if it is soft.
    pub fn foundation(&self, index: usize) -> Option<&ElasticFoundation> {
        self.objects.get(index).and_then(|o| o.foundation.as_ref())
    }

    /// The force of the table on an object in the last step.
    pub fn contact(&self, index: usize) -> Contact {
        let Some(object) = self.objects.get(index) else { return Contact::default() };
        let mut contact = Contact { normal: object.reaction.normal, tangential: object.reaction.friction };
        if object.foundation.is_some() {
            return contact;
        }
        for touch in &self.touches {
            let [first, second] = touch.colliders;
            let sign = if first == self.table_collider && object.colliders.contains(&second) {
                1.0
            } else if second == self.table_collider && object.colliders.contains(&first) {
                -1.0
            } else {
                continue;
            };
            let up = self.table.plane_normal();
            let force = touch.force * sign;
            let normal = force.dot(&up);
            contact.normal += normal;
            contact.tangential += force - up.into_inner() * normal;
        }
        contact
    }

    /// Index of the object that the hand of a robot's arm that works holds.
    pub fn held(&self, robot: usize) -> Option<usize> {
        self.robots[robot].hand().grip.held()
    }

    /// What a robot's hands exert on its wrench sensors in the last step, without noise, in the order of the model's: sensor's
    /// frame, about its origin. A sensor of no arm feels nothing.
    pub fn wrenches(&self, robot: usize) -> impl Iterator<Item = ForceTorque> + '_ {
        self.robots[robot].wrenches()
    }

    /// What the hand of a robot's arm that works exerts on its wrench sensor.
    pub fn wrench(&self, robot: usize) -> ForceTorque {
        self.robots[robot].hand().wrench()
    }

    /// The number of arms that are awake.
    pub fn awake(&self) -> usize {
        self.arms().filter(|arm| !arm.rest.asleep).count()
    }

    fn arms(&self) -> impl Iterator<Item = &ArmWithHand> {
        self.robots.iter().flat_map(|robot| &robot.arms)
    }

    /// Takes over what the people want from now on, in the world's order; each was asked in each step.
    pub fn people_want(&mut self, postures: &[Posture]) {
        for (person, posture) in self.people.iter_mut().zip(postures) {
            person.want(posture, DT);
        }
    }

    /// The poses of the parts of a person, in the order of [`parts`](crate::figure::parts).
    pub fn person(&self, person: usize) -> Vec<Isometry3<f64>> {
        self.people.get(person).map_or_else(Vec::new, |person| person.poses(&self.physics.bodies))
    }

    /// Advances by [`DT`]. The servo targets are those of each robot.
    pub fn step(&mut self, targets: &[Targets<'_>], external: &External) {
        self.wake_and_rest(targets, external);
        for (robot, targets) in self.robots.iter().zip(targets) {
            robot.joints.set_targets(&mut self.physics, *targets);
        }
        self.apply(external);
        self.make_slippery(external);
        self.press_pads();
        self.pull_grips();
        self.lead();
        self.physics.step();
        self.touches = touches(&self.physics);
        for (robot, targets) in self.robots.iter_mut().zip(targets) {
            robot.joints.read(&self.physics, *targets);
        }
        let momenta = self.momenta();
        self.update_grips(external, &momenta);
        self.feel(external, &momenta);
    }

    /// Wakes arms that are commanded or touched, and lets those sleep that have rested for long enough.
    fn wake_and_rest(&mut self, targets: &[Targets<'_>], external: &External) {
        for (i, targets) in targets.iter().enumerate().take(self.robots.len()) {
            let push = if i == 0 { external.hand + external.arm } else { Vector3::zeros() };
            if !self.robots[i].wake_and_rest(*targets, &push, external) {
                continue;
            }
            let held: Vec<Option<usize>> = self.robots[i].arms.iter().map(|arm| arm.hand.joined()).collect();
            held.iter().flatten().for_each(|object| self.part(*object));
            if let Err(error) = self.robots[i].rebuild(&mut self.physics) {
                tracing::error!("the robot's bodies cannot be built again: {error}");
                continue;
            }
            for (arm, held) in held.iter().enumerate() {
                held.iter().for_each(|object| self.join((i, arm), *object));
            }
        }
    }

    fn apply(&mut self, external: &External) {
        for arm in self.robots.iter().flat_map(|robot| &robot.arms) {
            let palm = &mut self.physics.bodies[arm.hand.palm];
            palm.reset_forces(false);
            palm.reset_torques(false);
        }
        let hand = self.robots[0].hand();
        let (tcp, palm) = (hand.tcp(&self.physics.bodies).translation.vector, hand.palm);
        let palm = &mut self.physics.bodies[palm];
        if external.hand != Vector3::zeros() {
            palm.add_force_at_point(convert::vector(&external.hand), convert::vector(&tcp), true);
        }
        if let Some(forearm) = self.robots[0].forearm() {
            let forearm = &mut self.physics.bodies[forearm];
            forearm.reset_forces(false);
            if external.arm != Vector3::zeros() {
                forearm.add_force(convert::vector(&external.arm), true);
            }
        }
        for (i, object) in self.objects.iter_mut().enumerate() {
            let body = &mut self.physics.bodies[object.handle];
            let knock = external.objects.get(i).copied().unwrap_or_default();
            body.reset_forces(false);
            body.reset_torques(false);
            if let Some(foundation) = &mut object.foundation {
                let motion = RigidMotion {
                    root_from_object: convert::to_pose(body.position()),
                    linear: convert::to_vector(body.linvel()),
                    angular: convert::to_vector(body.angvel()),
                };
                object.reaction = foundation.step(&self.table, &motion, DT);
                body.add_force(convert::vector(&(object.reaction.force + knock)), true);
                body.add_torque(convert::vector(&object.reaction.torque), true);
            } else if knock != Vector3::zeros() {
                body.add_force(convert::vector(&knock), true);
            }
        }
    }

    /// Moves the people, and what they do to the hands of the first robot that they lead.
    fn lead(&mut self) {
        let Self { physics, people, robots, .. } = self;
        let arms = &mut robots[0].arms;
        arms.iter_mut().for_each(|arm| arm.led = None);
        for person in people {
            person.apply(&mut physics.bodies);
            person.lead(physics, arms);
        }
    }

    /// The hands of the first robot that are led, in the order of its arms.
    pub fn led(&self) -> impl Iterator<Item = LedHand> + '_ {
        self.robots[0].arms.iter().filter_map(|arm| arm.led)
    }

    /// The forces of what the soft pads of a robot press on its hands, in the order of its arms; torques about the TCPs.
    pub fn pads(&self, robot: usize) -> impl Iterator<Item = PadReaction> + '_ {
        let arms = self.robots[robot].arms.iter();
        arms.map(|arm| arm.pad.as_ref().map_or_else(PadReaction::default, |pad| pad.reaction))
    }

    /// Poses of the TCPs of a robot's arms, in the room.
    pub fn tcps(&self, robot: usize) -> impl Iterator<Item = Isometry3<f64>> + '_ {
        self.robots[robot].arms.iter().map(|arm| arm.hand.tcp(&self.physics.bodies))
    }

    /// Makes or breaks the joints between palms and objects.
    fn update_grips(&mut self, external: &External, momenta: &[Momentum]) {
        let touched = self.touched();
        let held: Vec<(usize, usize, Option<usize>)> = (0..self.robots.len())
            .flat_map(|robot| {
                let arms = self.robots[robot].arms.iter().enumerate();
                arms.map(move |(i, arm)| (robot, i, arm.hand.grip.held()))
            })
            .collect();
        for (n, (&(robot, i, before), touched)) in held.iter().zip(touched).enumerate() {
            let outside = before.map(|held| self.outside(held, (robot, i), external));
            let ArmWithHand { hand, rest, touched: was, .. } = &mut self.robots[robot].arms[i];
            *was = touched;
            if rest.asleep || (!touched && before.is_none()) {
                hand.rest_grip();
                continue;
            }
            let others = held.iter().enumerate().filter(|(k, _)| *k != n).filter_map(|(_, (.., held))| *held);
            let others: Vec<usize> = others.filter(|held| !self.objects[*held].has_handles).collect();
            hand.step_grip(&self.physics, &self.objects, momenta, outside, &others);
            let after = hand.grip.held();
            if before == after {
                continue;
            }
            if hand.soft.take().is_none() {
                before.into_iter().for_each(|lost| self.part(lost));
            }
            after.into_iter().for_each(|taken| self.join((robot, i), taken));
        }
    }

    /// The sum of the forces on an object besides its weight and the hand that holds it, with their torque about its middle.
    fn outside(&self, object: usize, (robot, arm): (usize, usize), external: &External) -> ExternalWrench {
        let knock = external.objects.get(object).copied().unwrap_or_default();
        let Object { reaction, handle, foundation, .. } = &self.objects[object];
        let mut sum = ExternalWrench { force: reaction.force + knock, torque: reaction.torque };
        if foundation.is_none() {
            let middle = convert::to_vector(self.physics.bodies[*handle].center_of_mass());
            let own = &self.robots[robot].arms[arm].colliders;
            for touch in self.touches.iter().filter(|touch| !touch.colliders.iter().any(|c| own.contains(c)))
            {
                let sign = match touch.bodies {
                    [_, Some(second)] if second == *handle => 1.0,
                    [Some(first), _] if first == *handle => -1.0,
                    _ => continue,
                };
                sum.add(&(touch.force * sign), &(touch.point - middle));
            }
        }
        sum
    }

    fn join(&mut self, (robot, arm): (usize, usize), object: usize) {
        if !self.joins {
            return;
        }
        if self.objects[object].has_handles {
            let hand = &mut self.robots[robot].arms[arm].hand;
            return hand.grip_softly(&self.physics.bodies, (object, &self.objects[object]));
        }
        let (palm, handle) = (self.robots[robot].arms[arm].hand.palm, self.objects[object].handle);
        let bodies = &self.physics.bodies;
        let palm_from_object = bodies[palm].position().inverse() * *bodies[handle].position();
        let joint = rapier::FixedJointBuilder::new().local_frame1(palm_from_object).build();
        self.physics.multibody_joints.insert(palm, handle, joint, true);
    }

    fn part(&mut self, object: usize) {
        let joint = MultibodyJointHandle(self.objects[object].handle.0);
        self.physics.multibody_joints.remove(joint, true);
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
        let momenta = self.momenta();
        for arm in self.robots.iter_mut().flat_map(|robot| &mut robot.arms) {
            arm.hand.remember(&self.physics.bodies, &momenta);
        }
    }

    /// Of the objects.
    fn momenta(&self) -> Vec<Momentum> {
        let of = |object: &Object| Momentum::of_body(&self.physics.bodies[object.handle]);
        self.objects.iter().map(of).collect()
    }

    /// Updates what the wrench sensors feel.
    fn feel(&mut self, external: &External, momenta: &[Momentum]) {
        let mut outside = self.contacts_from_outside();
        for (i, (arm, outside)) in self.arms().zip(&mut outside).enumerate() {
            // The first robot's arms come first.
            if i == self.robots[0].working {
                outside.add(&external.hand, &arm.hand.tcp(&self.physics.bodies).translation.vector);
            }
            if let Some(PaddedHand { reaction, .. }) = &arm.pad {
                outside.add(&reaction.force, &arm.hand.tcp(&self.physics.bodies).translation.vector);
                outside.torque += reaction.torque;
            }
            if let Some(LedHand { tcp, force, torque, .. }) = &arm.led {
                outside.add(force, &tcp.translation.vector);
                outside.torque += torque;
            }
            if let Some(SoftGrip { reaction, .. }) = &arm.hand.soft {
                outside.add(&reaction.force, &arm.hand.tcp(&self.physics.bodies).translation.vector);
                outside.torque += reaction.torque;
            }
            if let Some(held) = arm.hand.joined() {
                let middle =
                    convert::to_vector(self.physics.bodies[self.objects[held].handle].center_of_mass());
                let reaction = &self.objects[held].reaction;
                let on_object = reaction.force + external.objects.get(held).copied().unwrap_or_default();
                outside.add(&on_object, &middle);
                outside.torque += reaction.torque;
            }
        }
        let arms = self.robots.iter_mut().flat_map(|robot| &mut robot.arms);
        for (arm, outside) in arms.zip(&outside) {
            arm.hand.feel(&self.physics.bodies, momenta, outside);
        }
    }

    /// For each arm, whether something touches it or what it holds.
    fn touched(&self) -> Vec<bool> {
        let held = |arm: &ArmWithHand| arm.hand.joined().map(|held| &self.objects[held]);
        let presses = |arm: &ArmWithHand| arm.pad.as_ref().is_some_and(|pad| pad.reaction.normal > 0.0);
        let rubs = |arm: &ArmWithHand| {
            arm.led.is_some() || presses(arm) || held(arm).is_some_and(|object| object.reaction.normal > 0.0)
        };
        let mut touched: Vec<bool> = self.arms().map(rubs).collect();
        for pair in self.physics.narrow_phase.contact_pairs().filter(|pair| pair.has_any_active_contact()) {
            for (arm, touched) in self.arms().zip(&mut touched) {
                let holds = held(arm).map_or(&[][..], |object| &object.colliders);
                let own = |it: ColliderHandle| arm.colliders.contains(&it) || holds.contains(&it);
                *touched |= own(pair.collider1) != own(pair.collider2);
            }
        }
        touched
    }

    /// For each hand, the force and torque of Rapier's contacts between what is beyond its wrench sensor and everything
    /// else.
    fn contacts_from_outside(&self) -> Vec<ExternalWrench> {
        let mut outside = vec![ExternalWrench::default(); self.arms().count()];
        for Touch { colliders, bodies, point, force, .. } in &self.touches {
            for (arm, sum) in self.arms().zip(&mut outside) {
                let inside = |i: usize| arm.hand.has(colliders[i], bodies[i], &self.objects);
                match (inside(0), inside(1)) {
                    (true, false) => sum.add(&-force, point),
                    (false, true) => sum.add(force, point),
                    _ => {}
                }
            }
        }
        outside
    }

    /// The forces between a robot and other things in the last step, N.
    pub fn collisions(&self, robot: usize) -> impl Iterator<Item = (Touched, f64)> + '_ {
        self.touches.iter().filter_map(move |touch| {
            let own = touch.colliders.map(|collider| self.robots[robot].has(collider));
            let other = match own {
                [true, false] => touch.colliders[1],
                [false, true] => touch.colliders[0],
                _ => return None,
            };
            let object = self.objects.iter().position(|object| object.colliders.contains(&other));
            let person = || self.people.iter().position(|person| person.colliders.contains(&other));
            let what = match (object, person()) {
                (Some(object), _) => Touched::Body(object),
                (None, Some(person)) => Touched::Person(person),
                (None, None) => Touched::Room,
            };
            Some((what, touch.force.norm()))
        })
    }

    /// Which links of a robot touch which bodies.
    pub fn contacts_of_links(&self, robot: usize) -> impl Iterator<Item = (LinkId, usize)> + '_ {
        self.touches.iter().filter_map(move |touch| {
            let [a, b] = touch.colliders;
            let parts = [(a, b), (b, a)].into_iter();
            parts.filter_map(|(own, other)| Some((self.robots[robot].link_of(own)?, other))).find_map(
                |(link, other)| Some((link, self.objects.iter().position(|o| o.colliders.contains(&other))?)),
            )
        })
    }

    /// The distance between the parts of a robot that touch and a person, m; 0 where they touch.
    pub fn distance(&self, robot: usize, person: usize) -> Option<f64> {
        let shape = |collider: ColliderHandle| self.physics.colliders.get(collider);
        let own = self.robots[robot].colliders().filter_map(shape);
        let theirs = &self.people.get(person)?.colliders;
        own.flat_map(|own| theirs.iter().filter_map(move |their| Some((own, shape(*their)?))))
            .filter_map(|(a, b)| {
                let nearest = query::distance(a.position(), a.shape(), b.position(), b.shape());
                nearest.ok().map(|nearest| nearest.distance)
            })
            .min_by(f64::total_cmp)
    }
}

/// The motion of a body, or of a frame fixed in it.
pub(super) fn moving(body: &rapier::RigidBody, body_from_frame: &Isometry3<f64>) -> Moving {
    let pose = convert::to_pose(body.position()) * body_from_frame;
    let angular = convert::to_vector(body.angvel());
    let arm = pose.translation.vector - convert::to_vector(body.center_of_mass());
    Moving { pose, linear: convert::to_vector(body.linvel()) + angular.cross(&arm), angular }
}

/// The table's force on an object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contact {
    /// Normal force, N.
    pub normal: f64,
    /// Friction, root frame, N.
    pub tangential: Vector3<f64>,
}

/// What a robot touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Touched {
    /// The table or the floor, or another robot.
    Room,
    /// A body, by its index.
    Body(usize),
    /// A person, by their index.
    Person(usize),
}
