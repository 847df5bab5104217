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
    pub(super) kind: JointKind,
    /// Position of the joint at which its coordinate in the multibody is 0.
    pub(super) start: f64,
    pub(super) servo: Servo,
}

/// Sets the spring of every servo such that, with its damper, it pulls to the set point and feeds the velocity
/// forward. `now` and `targets` are positions and velocities of all the model's joints.
pub(super) fn set_targets(
    physics: &mut rapier::PhysicsWorld,
    bodies: &[Body],
    now: (&[f64], &[f64]),
    targets: (&[f64], &[f64]),
) {
    for body in bodies {
        let Servo { stiffness, damping, effort } = body.servo;
        let (q, v) = (now.0[body.index], now.1[body.index]);
        let wanted = stiffness * (targets.0[body.index] - q) + damping * (targets.1[body.index] - v);
        let rest = q + (wanted.clamp(-effort, effort) + damping * v) / stiffness;
        if let Some((multibody, link)) = physics.multibody_joints.get_mut(body.joint)
            && let Some(link) = multibody.link_mut(link)
        {
            link.joint.set_spring(axis_of(body.kind), stiffness, rest - body.start);
        }
    }
}

/// Reads positions and velocities of the joints that have bodies.
pub(super) fn read(
    physics: &rapier::PhysicsWorld,
    bodies: &[Body],
    position: &mut [f64],
    velocity: &mut [f64],
) {
    for body in bodies {
        let Some((multibody, id)) = physics.multibody_joints.get(body.joint) else { continue };
        let Some(link) = multibody.link(id) else { continue };
        position[body.index] = body.start + link.joint.coords()[axis_of(body.kind)];
        velocity[body.index] = multibody.joint_velocity(link)[0];
    }
}

/// Index of a joint's coordinate among the six of a multibody joint: in both frames x is the joint's axis.
fn axis_of(kind: JointKind) -> usize {
    match kind {
        JointKind::Revolute => 3,
        JointKind::Prismatic => 0,
    }
}
