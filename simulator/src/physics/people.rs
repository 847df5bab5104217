//! People in the physics: their parts go where they want, their hands are held there by springs and give way.

use armarium_robot::Geometry;
use nalgebra::{Isometry3, Point3, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, RigidBodyHandle};

use super::build::add_person_part;
use super::convert;
use crate::person::{Posture, parts, poses};
use crate::world::PersonSpec;

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
        Self { spec: spec.clone(), moved: bodies, hands, colliders, wants, speeds: [Vector3::zeros(); 2] }
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
        let PersonSpec { stiffness, damping, .. } = self.spec;
        for (side, hand) in self.hands.iter().enumerate() {
            let body = &mut bodies[*hand];
            let at = convert::to_vector(body.translation());
            let pull = (self.wants.hands[side].coords - at) * stiffness
                + (self.speeds[side] - convert::to_vector(body.linvel())) * damping;
            body.reset_forces(false);
            body.add_force(convert::vector(&pull), true);
        }
        let poses = self.poses(bodies);
        for (body, pose) in self.moved.iter().zip(&poses) {
            bodies[*body].set_next_kinematic_position(convert::pose(pose));
        }
    }

    /// The poses of all parts with the hands where they are.
    pub(super) fn poses(&self, bodies: &rapier::RigidBodySet) -> Vec<Isometry3<f64>> {
        let hands = self.hands.map(|hand| Point3::from(convert::to_vector(bodies[hand].translation())));
        poses(&self.spec, &self.wants.room_from_feet, &hands)
    }
}
