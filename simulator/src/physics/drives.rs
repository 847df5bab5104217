//! The joints' servos: set points in, positions and velocities out.
//!
//! Every joint is a stiff spring and damper about its set point, with feed-forward of the set velocity. The solver
//! integrates it implicitly; its force is limited by the joint's effort.

use std::sync::Arc;

use armarium_robot::{JointKind, Kinematics, LinkId, Model};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{MultibodyJointHandle, RigidBodyHandle};

use super::plant::DT;

/// A servo's gains, and what its drive lacks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Servo {
    pub(super) stiffness: f64,
    pub(super) damping: f64,
    pub(super) effort: f64,
    /// Coulomb friction, N m (N).
    pub(super) friction: f64,
    /// Half the play between motor and link, rad (m).
    pub(super) play: f64,
}

/// Speed above which Coulomb friction acts in full, rad/s (m/s).
const SLIDING: f64 = 0.02;

/// A lump's body.
#[derive(Clone, Debug)]
pub(super) struct LumpBody {
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
    /// Position of its motor, where the angle is measured, rad (m): it lags behind the link by up to half the play.
    pub(super) motor: f64,
    pub(super) kind: JointKind,
    /// Position of the joint at which its coordinate in the multibody is 0.
    pub(super) start: f64,
    pub(super) servo: Servo,
}

/// A joint that carries no arm, such as one of the head: its servo moves the inertia of what is beyond it, and its motion
/// does not shake what carries it.
#[derive(Clone, Debug)]
struct LightJoint {
    /// Index in the model.
    index: usize,
    /// Largest acceleration that its effort gives, rad/s^2 (m/s^2).
    strongest: f64,
}

/// Time in which the servo of a light joint settles, s; it is critically damped.
const LIGHT_SERVO_S: f64 = 0.01;
/// Reflected inertia of the motors of light joints, kg m^2 (kg).
const LIGHT_ROTOR: f64 = 0.01;

impl LightJoint {
    fn new(model: &Model, kinematics: &Kinematics, index: usize) -> Self {
        let joint = &model.joints()[index];
        let (origin, axis) = (kinematics.origin(index), kinematics.axis(index));
        let inertia = |link: LinkId| {
            let Some(inertial) = &model.links()[link.index()].inertial else { return 0.0 };
            let pose = kinematics.pose(link);
            let arm = axis.cross(&(pose * inertial.center - origin));
            let local = pose.rotation.inverse() * axis;
            match joint.kind {
                JointKind::Revolute => {
                    inertial.mass * arm.norm_squared() + local.dot(&(inertial.inertia * local))
                }
                JointKind::Prismatic => inertial.mass,
            }
        };
        let moved: f64 = LIGHT_ROTOR + model.subtree(joint.link).map(inertia).sum::<f64>();
        let effort = if joint.effort > 0.0 { joint.effort } else { f64::INFINITY };
        Self { index, strongest: effort / moved }
    }

    fn step(&self, position: &mut f64, velocity: &mut f64, target: (f64, f64)) {
        let rate = 1.0 / LIGHT_SERVO_S;
        let wanted = rate * rate * (target.0 - *position) + 2.0 * rate * (target.1 - *velocity);
        *velocity += wanted.clamp(-self.strongest, self.strongest) * DT;
        *position += *velocity * DT;
    }
}

/// All joints of the model: those with bodies, the light ones, and those that stand still.
pub(super) struct Joints {
    pub(super) bodies: Vec<LumpBody>,
    light: Vec<LightJoint>,
    /// True positions, rad or m, in the model's order.
    pub(super) position: Vec<f64>,
    /// True velocities, rad/s or m/s.
    pub(super) velocity: Vec<f64>,
    /// Positions of the motors, where angles are measured, rad or m.
    pub(super) motors: Vec<f64>,
}

impl Joints {
    /// The joints at rest in the posture `start`. What belongs to none of the `heavy` joints is light.
    pub(super) fn new(model: &Arc<Model>, bodies: Vec<LumpBody>, heavy: &[usize], start: &[f64]) -> Self {
        let mut kinematics = Kinematics::new(model);
        kinematics.update(start);
        let light = (0..model.joints().len()).filter(|joint| !heavy.contains(joint));
        let light = light.map(|joint| LightJoint::new(model, &kinematics, joint)).collect();
        let (position, motors) = (start.to_vec(), start.to_vec());
        Self { bodies, light, position, velocity: vec![0.0; start.len()], motors }
    }

    /// Goes on with other bodies; joints that have none any more stand still.
    pub(super) fn replace(&mut self, mut bodies: Vec<LumpBody>) {
        for body in &self.bodies {
            self.velocity[body.index] = 0.0;
        }
        for body in &mut bodies {
            body.motor += body.multiplier * (self.motors[body.index] - self.position[body.index]);
            if body.leads {
                (self.position[body.index], self.velocity[body.index]) = body.state;
            }
        }
        self.bodies = bodies;
    }

    /// Sets the spring of every servo such that, with its damper, it pulls to the set point and feeds the velocity
    /// forward. `targets` are positions and velocities of all the model's joints.
    pub(super) fn set_targets(&self, physics: &mut rapier::PhysicsWorld, targets: (&[f64], &[f64])) {
        for body in &self.bodies {
            let Servo { stiffness, damping, effort, friction, .. } = body.servo;
            let (q, v) = body.state;
            let target = body.multiplier * targets.0[body.index] + body.offset;
            let speed = body.multiplier * targets.1[body.index];
            let wanted = stiffness * (target - q) + damping * (speed - v);
            let force = wanted.clamp(-effort, effort) - friction * (v / SLIDING).clamp(-1.0, 1.0);
            let rest = q + (force + damping * v) / stiffness;
            if let Some((multibody, link)) = physics.multibody_joints.get_mut(body.joint)
                && let Some(link) = multibody.link_mut(link)
            {
                link.joint.set_spring(axis_of(body.kind), stiffness, rest - body.start);
            }
        }
    }

    /// Moves the light joints, and reads positions and velocities of the others, after a step towards `targets`.
    pub(super) fn read(&mut self, physics: &rapier::PhysicsWorld, targets: (&[f64], &[f64])) {
        for body in &mut self.bodies {
            let Some((multibody, id)) = physics.multibody_joints.get(body.joint) else { continue };
            let Some(link) = multibody.link(id) else { continue };
            let position = body.start + link.joint.coords()[axis_of(body.kind)];
            body.state = (position, multibody.joint_velocity(link)[0]);
            let play = body.servo.play;
            body.motor = body.motor.clamp(position - play, position + play);
            if body.leads {
                (self.position[body.index], self.velocity[body.index]) = body.state;
                self.motors[body.index] = body.motor;
            }
        }
        for joint in &self.light {
            let j = joint.index;
            joint.step(&mut self.position[j], &mut self.velocity[j], (targets.0[j], targets.1[j]));
            self.motors[j] = self.position[j];
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
