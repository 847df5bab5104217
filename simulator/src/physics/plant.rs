//! Robot, table and objects as Rapier bodies, stepped at 1 kHz.
//!
//! - The arms, what helps them and their hands are one multibody in reduced coordinates. Every joint has a servo: a stiff
//!   spring and damper about the set point, with feed-forward of the set velocity. It is integrated implicitly, and
//!   its force is limited by the joint's effort. The servo compensates the robot's own weight by its nominal model.
//!   As that model is exact, the two cancel and gravity is left out for these bodies (loads and contacts act in
//!   full).
//! - An arm that stands, with no new set point and touched by nothing, sleeps with what it holds: its joints are stiff until
//!   it is commanded or touched, and cost nothing (see [`Rest`]).
//! - Joints of other limbs, such as the head's, have servos of their own that move the inertia beyond them; their motion
//!   does not shake the rest.
//! - Objects are free boxes on an [`ElasticFoundation`] of springs. Rapier handles their contacts with the fingers,
//!   and a thin core keeps them from falling through the table when they lie on their side.
//! - An object is held by a fixed joint that exists only while both finger pads press on it (see [`grip`](super::grip)).
//! - The wrist sensors are exact here (see [`wrench`](super::wrench)); noise is added in the sensing.

use std::sync::Arc;

use armarium_robot::{Limb, Model, Wrench};
use nalgebra::{Isometry3, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, MultibodyJointHandle, RigidBodyHandle};

use super::assembly::Assembly;
use super::build::{RobotBodies, add_object, add_robot, add_room, empty_room};
use super::convert;
use super::drives::Joints;
use super::hand::{Hand, Outside};
use super::wrench::Momentum;
use crate::error::PlantError;
use crate::foundation::{ElasticFoundation, FoundationReaction, Motion};
use crate::table::TableTop;
use crate::world::World;

/// One step, s.
pub const DT: f64 = 1e-3;
/// Friction of finger pads on objects.
pub const PAD_FRICTION: f64 = 0.9;
/// An arm sleeps after this many steps of rest.
const SLEEPS_AFTER: u32 = 300;
/// How far the first set points may be from where the joints are, rad (m): some deviations of the joint sensors.
const FIRST_TARGET: f64 = 2e-3;
/// A joint that is slower than this rests, rad/s (m/s).
const RESTING: f64 = 1e-3;

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

/// An arm with its hand.
struct Arm {
    /// Its joints and those of its hand.
    joints: Vec<usize>,
    /// Its wrench sensor.
    sensor: Option<usize>,
    colliders: Vec<ColliderHandle>,
    /// Whether something touched it in the last step.
    touched: bool,
    hand: Hand,
    rest: Rest,
}

/// Whether an arm sleeps.
///
/// It falls asleep when for [`SLEEPS_AFTER`] steps its set points have not changed, its joints have stood, and nothing has
/// touched or pushed it or what it holds. It wakes in the step in which one of these ends. Asleep, its joints are stiff where
/// they are, and it keeps its grip.
#[derive(Debug)]
struct Rest {
    asleep: bool,
    /// Number of steps for which it has rested.
    steps: u32,
    /// The set points of the last step; at first, where the joints are.
    targets: Vec<f64>,
    /// How far a set point may be from the one before without asking for motion, rad (m).
    tolerance: f64,
}

impl Rest {
    /// Takes a step's set points over; returns whether they ask for motion.
    fn asks_for_motion(&mut self, joints: &[usize], (position, velocity): (&[f64], &[f64])) -> bool {
        let mut moving = false;
        for (&joint, target) in joints.iter().zip(&mut self.targets) {
            moving |= velocity[joint] != 0.0 || (*target - position[joint]).abs() > self.tolerance;
            *target = position[joint];
        }
        self.tolerance = 0.0;
        moving
    }
}

/// The physics of a world.
pub struct Plant {
    model: Arc<Model>,
    physics: rapier::PhysicsWorld,
    table: TableTop,
    joints: Joints,
    /// The joints of the arms, of what helps them, and of their hands.
    heavy: Vec<usize>,
    robot: RobotBodies,
    objects: Vec<Object>,
    arms: Vec<Arm>,
    /// The arm that works, as an index into `arms`.
    working: usize,
}

impl Plant {
    /// Builds the world with the robot in the posture `start`: positions of all the model's joints, rad or m.
    ///
    /// # Errors
    /// [`PlantError`] when the robot lacks a limb or link that the simulator needs.
    pub fn new(model: &Arc<Model>, world: &World, start: &[f64]) -> Result<Self, PlantError> {
        let missing = |what: &str| PlantError::Missing { what: what.to_owned() };
        let works = world.robot.arm(model).ok_or_else(|| missing("arm that works"))?;
        let limbs: Vec<&Limb> = model.arms().collect();
        let own = |arm: &Limb| -> Vec<usize> {
            let hand = arm.hand.as_deref().map_or(&[][..], |hand| model.limb(hand));
            arm.joints.iter().chain(hand).copied().collect()
        };
        let touching: Vec<usize> = limbs.iter().flat_map(|arm| own(arm)).collect();
        let mut heavy = touching.clone();
        for joint in limbs.iter().flat_map(|arm| model.reaching_joints(&arm.name)) {
            if !heavy.contains(&joint) {
                heavy.push(joint);
            }
        }
        let mut physics = empty_room();
        let table = TableTop::new(&world.table);
        add_room(&mut physics, &table);
        // All arms sleep at first.
        let carriers: Vec<usize> = heavy.iter().copied().filter(|joint| !touching.contains(joint)).collect();
        let assembly = Assembly::new(model, start, &carriers, &touching);
        let still = vec![0.0; start.len()];
        let robot = add_robot(&mut physics, model, &assembly, (start, &still))?;
        let objects: Vec<_> = world.objects.iter().map(|o| add_object(&mut physics, &table, o)).collect();
        let arm = |limb: &&Limb| {
            let hand = Hand::new(model, limb, (&assembly, &robot), objects.len())?;
            Some(Arm {
                joints: own(limb),
                sensor: limb.wrench,
                colliders: Vec::new(),
                touched: false,
                hand,
                // The first set points are where the joints are sensed to be.
                rest: Rest {
                    asleep: true,
                    steps: 0,
                    targets: own(limb).iter().map(|&joint| start[joint]).collect(),
                    tolerance: FIRST_TARGET,
                },
            })
        };
        let arms: Vec<Arm> = limbs.iter().filter_map(arm).collect();
        let working = limbs.iter().position(|arm| arm.name == works.name).unwrap_or(0);
        let bodies = robot.bodies.clone();
        let mut plant = Self {
            model: Arc::clone(model),
            table,
            joints: Joints::new(model, bodies, &heavy, start),
            physics,
            heavy,
            robot,
            objects,
            arms,
            working,
        };
        plant.find_colliders();
        plant.weigh();
        let momenta = plant.momenta();
        plant.feel(&External::default(), &momenta);
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

    fn hand(&self) -> &Hand {
        &self.arms[self.working].hand
    }

    /// Pose of the TCP of the arm that works.
    pub fn tcp(&self) -> Isometry3<f64> {
        self.hand().tcp(&self.physics.bodies)
    }

    /// Velocity of that TCP, m/s, root frame.
    pub fn tcp_velocity(&self) -> Vector3<f64> {
        self.hand().tcp_velocity(&self.physics.bodies)
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

    /// Index of the object that the hand of the arm that works holds.
    pub fn held(&self) -> Option<usize> {
        self.hand().grip.held()
    }

    /// What the hands exert on the wrench sensors in the last step, without noise, in the order of the model's: sensor's
    /// frame, about its origin. A sensor of no arm feels nothing.
    pub fn wrenches(&self) -> impl Iterator<Item = Wrench> + '_ {
        (0..self.model.wrenches().len()).map(|sensor| {
            let arm = self.arms.iter().find(|arm| arm.sensor == Some(sensor));
            arm.map_or_else(Wrench::default, |arm| arm.hand.wrench())
        })
    }

    /// What the hand of the arm that works exerts on its wrench sensor.
    pub fn wrench(&self) -> Wrench {
        self.hand().wrench()
    }

    /// The number of arms that are awake.
    pub fn awake(&self) -> usize {
        self.arms.iter().filter(|arm| !arm.rest.asleep).count()
    }

    /// Advances by [`DT`]. The servo targets are positions and velocities of all joints.
    pub fn step(&mut self, position: &[f64], velocity: &[f64], external: &External) {
        self.wake_and_rest((position, velocity), external);
        self.joints.set_targets(&mut self.physics, (position, velocity));
        self.apply(external);
        self.physics.step();
        self.joints.read(&self.physics, (position, velocity));
        let momenta = self.momenta();
        self.update_grips(external, &momenta);
        self.feel(external, &momenta);
    }

    /// Wakes arms that are commanded or touched, and lets those sleep that have rested for long enough.
    fn wake_and_rest(&mut self, targets: (&[f64], &[f64]), external: &External) {
        let mut changed = false;
        for (i, arm) in self.arms.iter_mut().enumerate() {
            let asked = arm.rest.asks_for_motion(&arm.joints, targets);
            let pushed = i == self.working && external.hand != Vector3::zeros();
            let moves = arm.joints.iter().any(|&joint| self.joints.velocity[joint].abs() > RESTING);
            let knocked = arm.hand.grip.held().and_then(|held| external.objects.get(held));
            let pushed = pushed || knocked.is_some_and(|knock| *knock != Vector3::zeros());
            let busy = asked || pushed || moves || arm.touched;
            arm.rest.steps = if busy { 0 } else { arm.rest.steps.saturating_add(1) };
            let asleep = if arm.rest.asleep { !busy } else { arm.rest.steps >= SLEEPS_AFTER };
            changed |= asleep != arm.rest.asleep;
            arm.rest.asleep = asleep;
        }
        if changed && let Err(error) = self.rebuild() {
            tracing::error!("the robot's bodies cannot be built again: {error}");
        }
    }

    /// Builds the robot's bodies again, for the arms that are awake now.
    fn rebuild(&mut self) -> Result<(), PlantError> {
        let asleep =
            |joint: &usize| self.arms.iter().any(|arm| arm.rest.asleep && arm.joints.contains(joint));
        let dynamic: Vec<usize> = self.heavy.iter().copied().filter(|joint| !asleep(joint)).collect();
        let touching: Vec<usize> = self.arms.iter().flat_map(|arm| arm.joints.iter().copied()).collect();
        let held: Vec<Option<usize>> = self.arms.iter().map(|arm| arm.hand.grip.held()).collect();
        held.iter().flatten().for_each(|object| self.part(*object));
        self.robot.remove(&mut self.physics);
        let Joints { position, velocity, .. } = &self.joints;
        let assembly = Assembly::new(&self.model, position, &dynamic, &touching);
        self.robot = add_robot(&mut self.physics, &self.model, &assembly, (position, velocity))?;
        self.joints.replace(self.robot.bodies.clone());
        for arm in &mut self.arms {
            arm.hand.renew(&self.model, &assembly, &self.robot);
        }
        self.find_colliders();
        for (arm, held) in held.iter().enumerate() {
            held.iter().for_each(|object| self.join(arm, *object));
        }
        Ok(())
    }

    fn find_colliders(&mut self) {
        let model = &self.model;
        for arm in &mut self.arms {
            let moved = |joint: &usize, link| model.moves(*joint, link);
            let colliders = self.robot.colliders.iter();
            let own = colliders.filter(|(link, _)| arm.joints.iter().any(|joint| moved(joint, *link)));
            arm.colliders = own.map(|(_, collider)| *collider).collect();
        }
    }

    fn apply(&mut self, external: &External) {
        let tcp = self.tcp().translation.vector;
        let palm = self.hand().palm;
        let palm = &mut self.physics.bodies[palm];
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

    /// Makes or breaks the joints between palms and objects.
    fn update_grips(&mut self, external: &External, momenta: &[Momentum]) {
        let touched = self.touched();
        let held: Vec<Option<usize>> = self.arms.iter().map(|arm| arm.hand.grip.held()).collect();
        for i in 0..self.arms.len() {
            self.arms[i].touched = touched[i];
            let Arm { hand, rest, .. } = &mut self.arms[i];
            let before = held[i];
            if rest.asleep || (!touched[i] && before.is_none()) {
                hand.rest_grip();
                continue;
            }
            let others: Vec<usize> =
                held.iter().enumerate().filter(|(k, _)| *k != i).filter_map(|(_, held)| *held).collect();
            let outside = before.map(|held| {
                let reaction = &self.objects[held].reaction;
                let knock = external.objects.get(held).copied().unwrap_or_default();
                Outside { force: reaction.force + knock, torque: reaction.torque }
            });
            hand.step_grip(&self.physics, &self.objects, momenta, outside, &others);
            let after = hand.grip.held();
            if before == after {
                continue;
            }
            before.into_iter().for_each(|lost| self.part(lost));
            after.into_iter().for_each(|taken| self.join(i, taken));
        }
    }

    fn join(&mut self, arm: usize, object: usize) {
        let (palm, handle) = (self.arms[arm].hand.palm, self.objects[object].handle);
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
        for arm in &mut self.arms {
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
        for (i, (arm, outside)) in self.arms.iter().zip(&mut outside).enumerate() {
            if i == self.working {
                outside.force += external.hand;
                outside.torque += arm.hand.tcp(&self.physics.bodies).translation.vector.cross(&external.hand);
            }
            if let Some(held) = arm.hand.grip.held() {
                let middle =
                    convert::to_vector(self.physics.bodies[self.objects[held].handle].center_of_mass());
                let reaction = &self.objects[held].reaction;
                let on_object = reaction.force + external.objects.get(held).copied().unwrap_or_default();
                outside.force += on_object;
                outside.torque += middle.cross(&on_object) + reaction.torque;
            }
        }
        for (arm, outside) in self.arms.iter_mut().zip(&outside) {
            arm.hand.feel(&self.physics.bodies, momenta, outside);
        }
    }

    /// For each arm, whether something touches it or what it holds.
    fn touched(&self) -> Vec<bool> {
        let held = |arm: &Arm| arm.hand.grip.held().map(|held| &self.objects[held]);
        let rubs = |arm: &Arm| held(arm).is_some_and(|object| object.reaction.normal > 0.0);
        let mut touched: Vec<bool> = self.arms.iter().map(rubs).collect();
        for pair in self.physics.narrow_phase.contact_pairs().filter(|pair| pair.has_any_active_contact()) {
            for (arm, touched) in self.arms.iter().zip(&mut touched) {
                let holds = held(arm).map(|object| object.collider);
                let own = |it: ColliderHandle| arm.colliders.contains(&it) || holds == Some(it);
                *touched |= own(pair.collider1) != own(pair.collider2);
            }
        }
        touched
    }

    /// For each hand, the force and torque of Rapier's contacts between what is beyond its wrench sensor and everything
    /// else.
    fn contacts_from_outside(&self) -> Vec<Outside> {
        let mut outside = vec![Outside::default(); self.arms.len()];
        for pair in self.physics.narrow_phase.contact_pairs() {
            for manifold in pair.solver_manifolds() {
                let data = &manifold.data;
                for (arm, sum) in self.arms.iter().zip(&mut outside) {
                    let inside = |collider, body| arm.hand.has(collider, body, &self.objects);
                    let sign = match (
                        inside(pair.collider1, data.rigid_body1),
                        inside(pair.collider2, data.rigid_body2),
                    ) {
                        (true, false) => -1.0,
                        (false, true) => 1.0,
                        _ => continue,
                    };
                    for contact in &data.solver_contacts {
                        let (a, b) = data.solver_contact_world_points(contact, &self.physics.bodies);
                        let point = convert::to_vector((a + b) * 0.5);
                        let Some(solved) = manifold.points.get(contact.contact_id[0] as usize) else {
                            continue;
                        };
                        let impulse = data.normal * solved.data.impulse + solved.data.warmstart_tangent_world;
                        let force = convert::to_vector(impulse) * (sign / DT);
                        sum.force += force;
                        sum.torque += point.cross(&force);
                    }
                }
            }
        }
        outside
    }
}
