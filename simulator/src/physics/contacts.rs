//! The contacts that Rapier solved in the last step, as forces at points.

use nalgebra::Vector3;
use rapier3d_f64::geometry::NEW_CONTACT_BIT;
use rapier3d_f64::prelude::{ColliderHandle, PhysicsWorld, RigidBodyHandle};

use super::convert;
use super::plant::DT;

/// A force between two bodies at a point.
pub(super) struct Touch {
    pub(super) colliders: [ColliderHandle; 2],
    pub(super) bodies: [Option<RigidBodyHandle>; 2],
    /// Where, room's frame, m.
    pub(super) point: Vector3<f64>,
    /// On the second body; the first has the opposite, N.
    pub(super) force: Vector3<f64>,
}

/// All of them.
pub(super) fn touches(physics: &PhysicsWorld) -> Vec<Touch> {
    let mut all = Vec::new();
    for pair in physics.narrow_phase.contact_pairs() {
        for manifold in pair.solver_manifolds() {
            let data = &manifold.data;
            for contact in &data.solver_contacts {
                let point = (contact.contact_id[0] & !NEW_CONTACT_BIT) as usize;
                let Some(solved) = manifold.points.get(point) else { continue };
                let (a, b) = data.solver_contact_world_points(contact, &physics.bodies);
                let impulse = data.normal * solved.data.impulse + solved.data.warmstart_tangent_world;
                all.push(Touch {
                    colliders: [pair.collider1, pair.collider2],
                    bodies: [data.rigid_body1, data.rigid_body2],
                    point: convert::to_vector((a + b) * 0.5),
                    force: convert::to_vector(impulse) / DT,
                });
            }
        }
    }
    all
}

/// A force and its torque about the room's origin, N and N m.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ExternalWrench {
    pub(super) force: Vector3<f64>,
    pub(super) torque: Vector3<f64>,
}

impl ExternalWrench {
    /// Adds a force at a point.
    pub(super) fn add(&mut self, force: &Vector3<f64>, at: &Vector3<f64>) {
        self.force += force;
        self.torque += at.cross(force);
    }
}
