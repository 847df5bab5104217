//! People in the physics: their parts go where they want, their hands are held there by springs and give way.
//!
//! A hand that leads one of the robot's is joined to it by a spring, which is a grip that gives a little. As long as it leads, or
//! reaches for the robot's hand or draws back, it and its forearm touch nothing else.

use armarium_robot::Geometry;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, RigidBodyHandle};

use super::build::{add_person_part, person_groups};
use super::convert;
use super::robot::ArmWithHand;
use crate::figure::{parts, poses};
use crate::person::Posture;
use crate::world::PersonSpec;

/// Stiffness of a person's grip, N/m: of the skin of a palm that holds something.
const GRIP: f64 = 3000.0;
/// Damping of a grip and of a wrist, over the critical one.
const DAMPED: f64 = 0.7;
/// Inertia that a wrist is damped for, kg m².
const TURNED: f64 = 0.05;

/// A person.
pub(super) struct PersonBodies {
    spec: PersonSpec,
    /// All parts but the hands; they go where the hands are.
    moved: Vec<RigidBodyHandle>,
    hands: [RigidBodyHandle; 2],
    pub(super) colliders: Vec<ColliderHandle>,
    wants: Posture,
    /// How fast the hands want to move, m/s.
    speeds: [Vector3<f64>; 2],
    /// What the hands hold of the robot.
    grips: [Option<PersonGrip>; 2],
}

/// A hand of the robot in that of a person.
#[derive(Clone, Copy, Debug)]
struct PersonGrip {
    /// Where the person's hand took it, TCP frame.
    tcp_from_hand: Point3<f64>,
    /// How it was turned then.
    room_from_tcp: UnitQuaternion<f64>,
}

/// What a person does to a hand of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LedHand {
    /// The robot's arm, by its index among its arms.
    pub arm: usize,
    /// Where its TCP is, root frame.
    pub tcp: Isometry3<f64>,
    /// Force of the person on it, root frame, N.
    pub force: Vector3<f64>,
    /// Torque of the person on it about its TCP, root frame, N m.
    pub torque: Vector3<f64>,
    /// From where the person's hand is to where the person wants it, root frame, m.
    pub behind: Vector3<f64>,
}

impl PersonBodies {
    /// Adds a person who stands in a posture.
    pub(super) fn new(physics: &mut rapier::PhysicsWorld, spec: &PersonSpec, wants: Posture) -> Self {
        let poses = poses(spec, &wants.room_from_feet, &wants.hands);
        let forms: Vec<Geometry> = parts(spec).into_iter().map(|part| part.shape).collect();
        let first_hand = forms.len() - 2;
        let mut bodies = Vec::new();
        let mut colliders = Vec::new();
        for (i, (form, pose)) in forms.iter().zip(&poses).enumerate() {
            let mass = (i >= first_hand).then_some(spec.hand_mass);
            let (body, collider) = add_person_part(physics, form, pose, mass);
            bodies.push(body);
            colliders.push(collider);
        }
        let hands = [bodies[first_hand], bodies[first_hand + 1]];
        bodies.truncate(first_hand);
        let (speeds, grips) = ([Vector3::zeros(); 2], [None; 2]);
        Self { spec: spec.clone(), moved: bodies, hands, colliders, wants, speeds, grips }
    }

    /// Takes over what the person wants, `dt` s after the last time.
    pub(super) fn want(&mut self, posture: &Posture, dt: f64) {
        for (side, speed) in self.speeds.iter_mut().enumerate() {
            *speed = (posture.hands[side] - self.wants.hands[side]) / dt;
        }
        self.wants = *posture;
    }

    /// Pulls the hands to where they are wanted and moves the other parts to the hands.
    pub(super) fn apply(&self, bodies: &mut rapier::RigidBodySet) {
        let PersonSpec { stiffness, damping, strength, .. } = self.spec;
        for (side, hand) in self.hands.iter().enumerate() {
            let body = &mut bodies[*hand];
            let at = convert::to_vector(body.translation());
            let pull = (self.wants.hands[side].coords - at) * stiffness
                + (self.speeds[side] - convert::to_vector(body.linvel())) * damping;
            body.reset_forces(false);
            body.add_force(convert::vector(&pull.cap_magnitude(strength)), true);
        }
        let poses = self.poses(bodies);
        for (body, pose) in self.moved.iter().zip(&poses) {
            bodies[*body].set_next_kinematic_position(convert::pose(pose));
        }
    }

    /// Joins the hands that lead to those of the robot, whose arms these are; after the hands were pulled.
    pub(super) fn lead(&mut self, physics: &mut rapier::PhysicsWorld, arms: &mut [ArmWithHand]) {
        for side in 0..2 {
            let lead = self.wants.leads[side];
            let first = self.colliders.len() - 4;
            // Forearms come before hands.
            for part in [self.colliders[first + side], self.colliders[first + 2 + side]] {
                if let Some(collider) = physics.colliders.get_mut(part) {
                    let wanted = person_groups(lead.is_none());
                    if collider.collision_groups() != wanted {
                        collider.set_collision_groups(wanted);
                    }
                }
            }
            let held = lead.filter(|lead| lead.holds && lead.arm < arms.len());
            let Some(lead) = held else {
                self.grips[side] = None;
                continue;
            };
            let arm = &mut arms[lead.arm];
            let tcp = arm.hand.moving(&physics.bodies);
            let own = &physics.bodies[self.hands[side]];
            let (at, speed) =
                (Point3::from(convert::to_vector(own.translation())), convert::to_vector(own.linvel()));
            let grip = *self.grips[side].get_or_insert_with(|| PersonGrip {
                tcp_from_hand: tcp.pose.inverse() * at,
                room_from_tcp: tcp.pose.rotation,
            });
            let place = tcp.pose * grip.tcp_from_hand;
            let critical = |stiffness: f64, mass: f64| 2.0 * DAMPED * (stiffness * mass).sqrt();
            let force =
                (at - place) * GRIP + (speed - tcp.velocity_at(&place)) * critical(GRIP, self.spec.hand_mass);
            let missing = (lead.turn * grip.room_from_tcp * tcp.pose.rotation.inverse()).scaled_axis();
            let turning = missing * self.spec.wrist - tcp.angular * critical(self.spec.wrist, TURNED);
            let palm = &mut physics.bodies[arm.hand.palm];
            palm.add_force_at_point(convert::vector(&force), convert::vector(&place.coords), true);
            palm.add_torque(convert::vector(&turning), true);
            physics.bodies[self.hands[side]].add_force(convert::vector(&-force), true);
            let lever = place.coords - tcp.pose.translation.vector;
            let (torque, behind) = (turning + lever.cross(&force), self.wants.hands[side] - at);
            arm.led = Some(LedHand { arm: lead.arm, tcp: tcp.pose, force, torque, behind });
        }
    }

    /// The poses of all parts with the hands where they are.
    pub(super) fn poses(&self, bodies: &rapier::RigidBodySet) -> Vec<Isometry3<f64>> {
        let hands = self.hands.map(|hand| Point3::from(convert::to_vector(bodies[hand].translation())));
        poses(&self.spec, &self.wants.room_from_feet, &hands)
    }
}
