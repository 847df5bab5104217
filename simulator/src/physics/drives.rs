//! The joints' servos: set points in, positions and velocities out.
//!
//! Every joint is a stiff spring and damper about its set point, with feed-forward of the set velocity. The solver
//! integrates it implicitly; its force is limited by the joint's effort.

use armarium_robot::JointKind;
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{MultibodyJointHandle, RigidBodyHandle};

/// A servo's gains.
#[derive(Clone, Copy, Debug)]
pub(super) struct Servo {
    pub(super) stiffness: f64,
    pub(super) damping: f64,
    pub(super) effort: f64,
}

/// A lump's body.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub(super) handle: RigidBodyHandle,
    pub(super) joint: MultibodyJointHandle,
    /// Index of the joint in the model.
    pub(super) index: usize,
    /// Whether it is the joint's own body, and does not follow another.
    pub(super) leads: bool,
    /// Its own position is `multiplier * q + offset`, where `q` is the joint's.
    pub(super) multiplier: f64,
    pub(super) offset: f64,
    /// Its own position and velocity, rad (m) and rad/s (m/s).
    pub(super) state: (f64, f64),
    pub(super) kind: JointKind,
    /// Position of the joint at which its coordinate in the multibody is 0.
    pub(super) start: f64,
    pub(super) servo: Servo,
}

/// All joints of the model: those with bodies, and the ideal ones, which follow their set points exactly.
pub(super) struct Joints {
    pub(super) bodies: Vec<Body>,
    ideal: Vec<usize>,
    /// True positions, rad or m, in the model's order.
    pub(super) position: Vec<f64>,
    /// True velocities, rad/s or m/s.
    pub(super) velocity: Vec<f64>,
}

impl Joints {
    /// The joints at rest in the posture `start`.
    pub(super) fn new(
        physics: &rapier::PhysicsWorld,
        bodies: Vec<Body>,
        ideal: Vec<usize>,
        start: &[f64],
    ) -> Self {
        let velocity = vec![0.0; start.len()];
        let mut joints = Self { bodies, ideal, position: start.to_vec(), velocity };
        joints.read(physics, (start, &joints.velocity.clone()));
        joints
    }

    /// Sets the spring of every servo such that, with its damper, it pulls to the set point and feeds the velocity
    /// forward. `targets` are positions and velocities of all the model's joints.
    pub(super) fn set_targets(&self, physics: &mut rapier::PhysicsWorld, targets: (&[f64], &[f64])) {
        for body in &self.bodies {
            let Servo { stiffness, damping, effort } = body.servo;
            let (q, v) = body.state;
            let target = body.multiplier * targets.0[body.index] + body.offset;
            let speed = body.multiplier * targets.1[body.index];
            let wanted = stiffness * (target - q) + damping * (speed - v);
            let rest = q + (wanted.clamp(-effort, effort) + damping * v) / stiffness;
            if let Some((multibody, link)) = physics.multibody_joints.get_mut(body.joint)
                && let Some(link) = multibody.link_mut(link)
            {
                link.joint.set_spring(axis_of(body.kind), stiffness, rest - body.start);
            }
        }
    }

    /// Reads positions and velocities after a step towards `targets`.
    pub(super) fn read(&mut self, physics: &rapier::PhysicsWorld, targets: (&[f64], &[f64])) {
        for body in &mut self.bodies {
            let Some((multibody, id)) = physics.multibody_joints.get(body.joint) else { continue };
            let Some(link) = multibody.link(id) else { continue };
            let position = body.start + link.joint.coords()[axis_of(body.kind)];
            body.state = (position, multibody.joint_velocity(link)[0]);
            if body.leads {
                (self.position[body.index], self.velocity[body.index]) = body.state;
            }
        }
        for &j in &self.ideal {
            (self.position[j], self.velocity[j]) = (targets.0[j], targets.1[j]);
        }
    }
}

/// Index of a joint's coordinate among the six of a multibody joint: in both frames x is the joint's axis.
fn axis_of(kind: JointKind) -> usize {
    match kind {
        JointKind::Revolute => 3,
        JointKind::Prismatic => 0,
    }
}
