//! Inverse dynamics by the recursive Newton-Euler algorithm, in the root frame. Allocates only in [`Dynamics::new`].
//!
//! Outward: angular velocity, angular acceleration and the acceleration of each link's origin. Inward: the force and
//! torque that each link needs, summed towards the root, of which a joint bears the part along its axis. Gravity is an
//! acceleration of the root upwards. No friction, no motor inertia.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::model::GRAVITY;
use crate::{JointKind, Kinematics, Model};

#[derive(Clone, Copy, Debug, Default)]
struct LinkState {
    omega: Vector3<f64>,
    alpha: Vector3<f64>,
    acceleration: Vector3<f64>,
    force: Vector3<f64>,
    torque: Vector3<f64>,
}

/// Joint torques for a motion; keeps its working memory.
#[derive(Clone, Debug)]
pub struct Dynamics {
    kinematics: Kinematics,
    links: Vec<LinkState>,
    torque: Vec<f64>,
    still: Vec<f64>,
}

impl Dynamics {
    /// For a robot whose root stands still.
    #[must_use]
    pub fn new(model: &Arc<Model>) -> Self {
        Self {
            kinematics: Kinematics::new(model),
            links: vec![LinkState::default(); model.links().len()],
            torque: vec![0.0; model.joints().len()],
            still: vec![0.0; model.joints().len()],
        }
    }

    /// The kinematics at the configuration of the last call.
    #[must_use]
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// Torques (N m; forces, N, of sliding joints) that accelerate the joints by `acceleration` at position `q` and
    /// `velocity`, against gravity. All in the order of the model's joints; missing values are read as 0.
    ///
    /// # Source
    /// Luh, Walker and Paul 1980; Featherstone 2008, chapter 5.
    pub fn inverse(&mut self, q: &[f64], velocity: &[f64], acceleration: &[f64]) -> &[f64] {
        self.kinematics.update(q);
        self.outward(velocity, acceleration);
        self.inward();
        &self.torque
    }

    /// Torques that hold the robot still at `q`, N m (N).
    pub fn gravity(&mut self, q: &[f64]) -> &[f64] {
        let still = std::mem::take(&mut self.still);
        self.inverse(q, &still, &still);
        self.still = still;
        &self.torque
    }

    fn outward(&mut self, velocity: &[f64], acceleration: &[f64]) {
        let model = Arc::clone(self.kinematics.model());
        for (i, link) in model.links().iter().enumerate() {
            let Some(parent) = link.parent else {
                self.links[i] = LinkState { acceleration: -GRAVITY, ..LinkState::default() };
                continue;
            };
            let up = self.links[parent.0];
            let here = self.kinematics.pose(crate::LinkId(i)).translation.vector;
            let arm = here - self.kinematics.pose(parent).translation.vector;
            let mut state = LinkState {
                omega: up.omega,
                alpha: up.alpha,
                acceleration: up.acceleration + up.alpha.cross(&arm) + up.omega.cross(&up.omega.cross(&arm)),
                ..LinkState::default()
            };
            if let Some(j) = link.joint {
                let axis = self.kinematics.axis(j);
                let speed = axis * velocity.get(j).copied().unwrap_or(0.0);
                let push = axis * acceleration.get(j).copied().unwrap_or(0.0);
                match model.joints()[j].kind {
                    JointKind::Revolute => {
                        state.omega += speed;
                        state.alpha += push + up.omega.cross(&speed);
                    }
                    JointKind::Prismatic => state.acceleration += push + 2.0 * up.omega.cross(&speed),
                }
            }
            self.links[i] = state;
        }
    }

    fn inward(&mut self) {
        let model = Arc::clone(self.kinematics.model());
        for (i, link) in model.links().iter().enumerate() {
            let Some(body) = link.inertial else { continue };
            let pose = self.kinematics.pose(crate::LinkId(i));
            let state = &mut self.links[i];
            let center = pose.rotation * body.center.coords;
            let (omega, alpha) = (state.omega, state.alpha);
            let at_center = state.acceleration + alpha.cross(&center) + omega.cross(&omega.cross(&center));
            let rotation = pose.rotation.to_rotation_matrix();
            let inertia = rotation.matrix() * body.inertia * rotation.matrix().transpose();
            let force = body.mass * at_center;
            state.force = force;
            state.torque = inertia * alpha + omega.cross(&(inertia * omega)) + center.cross(&force);
        }
        for (i, link) in model.links().iter().enumerate().rev() {
            let state = self.links[i];
            if let Some(j) = link.joint {
                let axis = self.kinematics.axis(j);
                self.torque[j] = match model.joints()[j].kind {
                    JointKind::Revolute => state.torque.dot(axis),
                    JointKind::Prismatic => state.force.dot(axis),
                };
            }
            if let Some(parent) = link.parent {
                let here = self.kinematics.pose(crate::LinkId(i)).translation.vector;
                let arm = here - self.kinematics.pose(parent).translation.vector;
                let up = &mut self.links[parent.0];
                up.force += state.force;
                up.torque += state.torque + arm.cross(&state.force);
            }
        }
    }
}
