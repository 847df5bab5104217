//! Builds a world's room, objects and robot in Rapier, once, at the start. It does not step them.

use armarium_robot::{Geometry, JointKind, LinkId, Mesh, Model};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, RigidBodyHandle};

use super::assembly::{Assembly, Lump, joint_motion};
use super::convert;
use super::drives::{Body, Servo};
use super::plant::{DT, Object, PAD_FRICTION};
use crate::error::PlantError;
use crate::foundation::{ElasticFoundation, FoundationReaction};
use crate::table::{THICKNESS, TableTop};
use crate::world::{GRAVITY, ObjectSpec};

const ROBOT: rapier::Group = rapier::Group::GROUP_1;
const OBJECT: rapier::Group = rapier::Group::GROUP_2;
const CORE: rapier::Group = rapier::Group::GROUP_3;
const ROOM: rapier::Group = rapier::Group::GROUP_4;

fn groups(of: rapier::Group, with: rapier::Group) -> rapier::InteractionGroups {
    rapier::InteractionGroups::new(of, with, rapier::InteractionTestMode::And)
}

/// An empty room: gravity and the parameters of integration.
pub(super) fn empty_room() -> rapier::PhysicsWorld {
    let mut physics = rapier::PhysicsWorld::new();
    physics.gravity = rapier::Vector::new(0.0, 0.0, -GRAVITY);
    let parameters = &mut physics.integration_parameters;
    parameters.dt = DT;
    parameters.num_solver_iterations = 1;
    parameters.friction_model = rapier::FrictionModel::Coulomb;
    parameters.length_unit = 0.1;
    physics
}

pub(super) fn add_room(physics: &mut rapier::PhysicsWorld, table: &TableTop) {
    let [hx, hy] = table.half();
    let below = Isometry3::translation(0.0, 0.0, -THICKNESS / 2.0);
    let top = rapier::ColliderBuilder::cuboid(hx, hy, THICKNESS / 2.0)
        .position(convert::pose(&(table.root_from_top() * below)))
        .friction(table.friction())
        .collision_groups(groups(ROOM, ROBOT | CORE));
    let floor = rapier::ColliderBuilder::cuboid(10.0, 10.0, 0.5)
        .translation(rapier::Vector::new(0.0, 0.0, -0.5))
        .collision_groups(groups(ROOM, ROBOT | CORE | OBJECT));
    physics.insert_collider(top, None);
    physics.insert_collider(floor, None);
}

pub(super) fn add_object(physics: &mut rapier::PhysicsWorld, table: &TableTop, spec: &ObjectSpec) -> Object {
    let foundation = ElasticFoundation::new(spec);
    let half = *foundation.half();
    let [x, y] = spec.at;
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), spec.yaw_deg.to_radians());
    // The object starts as deep as its weight presses it in.
    let sink = spec.mass * GRAVITY / spec.stiffness;
    let surface = Point3::new(x, y, table.plane_height(x, y));
    let middle = surface + table.plane_normal().into_inner() * (half.z - sink);
    let pose = Isometry3::from_parts(middle.coords.into(), table.root_from_top().rotation * yaw);
    let handle = add_box(physics, &pose, spec.size, spec.mass);
    let full = rapier::ColliderBuilder::cuboid(half.x, half.y, half.z)
        .density(0.0)
        .friction(PAD_FRICTION)
        .collision_groups(groups(OBJECT, ROBOT | OBJECT | ROOM));
    let core = rapier::ColliderBuilder::cuboid(half.x * 0.8, half.y * 0.8, half.z * 0.15)
        .density(0.0)
        .friction(table.friction())
        .collision_groups(groups(CORE, ROOM));
    let collider = physics.insert_collider(full, Some(handle));
    physics.insert_collider(core, Some(handle));
    Object { handle, collider, foundation, reaction: FoundationReaction::default() }
}

/// The robot's bodies in Rapier.
pub(super) struct RobotBodies {
    /// What is fixed to the room.
    pub(super) base: RigidBodyHandle,
    /// A body for each lump.
    pub(super) bodies: Vec<Body>,
    /// The collision shapes of the links that touch.
    pub(super) colliders: Vec<(LinkId, ColliderHandle)>,
}

impl RobotBodies {
    /// The body that carries a lump's links; the base for none.
    pub(super) fn carrier(&self, lump: Option<usize>) -> RigidBodyHandle {
        lump.map_or(self.base, |lump| self.bodies[lump].handle)
    }

    /// Removes all of them.
    pub(super) fn remove(&self, physics: &mut rapier::PhysicsWorld) {
        for body in self.bodies.iter().rev() {
            physics.remove_body(body.handle);
        }
        physics.remove_body(self.base);
    }
}

/// Adds the robot with its joints at `position` and `velocity`: of all the model's joints, rad (m) and rad/s (m/s).
pub(super) fn add_robot(
    physics: &mut rapier::PhysicsWorld,
    model: &Model,
    assembly: &Assembly,
    (position, velocity): (&[f64], &[f64]),
) -> Result<RobotBodies, PlantError> {
    let base = physics.insert_body(rapier::RigidBodyBuilder::fixed());
    let mut bodies: Vec<Body> = Vec::new();
    let mut poses: Vec<Isometry3<f64>> = Vec::new();
    for lump in &assembly.lumps {
        let q = lump.multiplier * position[lump.joint] + lump.offset;
        let parent_pose = lump.parent.map_or_else(Isometry3::identity, |p| poses[p]);
        let at_start = lump.parent_from_body * joint_motion(lump.kind, &lump.axis, q);
        let pose = parent_pose * at_start;
        let handle = physics.insert_body(lump_body(lump, &pose));
        let parent = lump.parent.map_or(base, |p| bodies[p].handle);
        let joint = physics
            .multibody_joints
            .insert(parent, handle, joint_of(lump, &at_start), true)
            .ok_or_else(|| PlantError::Joint { joint: model.joints()[lump.joint].name.clone() })?;
        bodies.push(Body {
            handle,
            joint,
            index: lump.joint,
            leads: model.joints()[lump.joint].link == lump.link,
            multiplier: lump.multiplier,
            offset: lump.offset,
            kind: lump.kind,
            start: q,
            state: (q, lump.multiplier * velocity[lump.joint]),
            servo: servo(lump, model.joints()[lump.joint].effort),
        });
        poses.push(pose);
    }
    set_rotors(physics, &bodies);
    let mut robot = RobotBodies { base, bodies, colliders: Vec::new() };
    for part in &assembly.touching {
        let shape = collider(&part.shape, &part.body_from_shape);
        let handle = physics.insert_collider(shape, Some(robot.carrier(part.lump)));
        robot.colliders.push((part.link, handle));
    }
    Ok(robot)
}

fn lump_body(lump: &Lump, pose: &Isometry3<f64>) -> rapier::RigidBodyBuilder {
    let mass = rapier::MassProperties::with_inertia_matrix(
        convert::vector(&lump.mass.center().coords),
        lump.mass.mass.max(0.01),
        convert::matrix(&lump.mass.inertia()),
    );
    rapier::RigidBodyBuilder::dynamic()
        .pose(convert::pose(pose))
        .additional_mass_properties(mass)
        .gravity_scale(0.0)
        .can_sleep(false)
}

/// In both frames x is the joint's axis. The coordinate is 0 in the start posture.
fn joint_of(lump: &Lump, parent_from_start: &Isometry3<f64>) -> rapier::GenericJoint {
    let to_axis = UnitQuaternion::rotation_between(&Vector3::x(), &lump.axis)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
    let frame = Isometry3::from_parts(Vector3::zeros().into(), to_axis);
    let locked = match lump.kind {
        JointKind::Revolute => rapier::JointAxesMask::LOCKED_REVOLUTE_AXES,
        JointKind::Prismatic => rapier::JointAxesMask::LOCKED_PRISMATIC_AXES,
    };
    rapier::GenericJointBuilder::new(locked)
        .local_frame1(convert::pose(&(parent_from_start * frame)))
        .local_frame2(convert::pose(&frame))
        .build()
}

/// Gains according to the load of the joint: highest for the torso, lowest for the wrist; all settle in about 10
/// ms.
fn servo(lump: &Lump, effort: f64) -> Servo {
    let stiffness = match lump.kind {
        JointKind::Prismatic => 8e3,
        JointKind::Revolute if effort >= 150.0 => 1e5,
        JointKind::Revolute if effort >= 50.0 => 3e4,
        JointKind::Revolute => 1e4,
    };
    let effort = if effort > 0.0 { effort } else { f64::MAX };
    Servo { stiffness, damping: 0.01 * stiffness, effort }
}

/// Sets the motors' reflected inertia, kg m^2 (kg), and the joints' velocities, and removes Rapier's own damping, as the
/// servo has its own.
fn set_rotors(physics: &mut rapier::PhysicsWorld, bodies: &[Body]) {
    for body in bodies {
        let Some((multibody, id)) = physics.multibody_joints.get_mut(body.joint) else { continue };
        let Some(dof) = multibody.links().take(id).map(|l| l.joint.ndofs()).reduce(|a, b| a + b) else {
            continue;
        };
        multibody.armature_mut()[dof] = if body.kind == JointKind::Revolute { 0.05 } else { 0.1 };
        multibody.damping_mut()[dof] = body.servo.damping;
        multibody.generalized_velocity_mut()[dof] = body.state.1;
    }
}

fn collider(shape: &Geometry, body_from_shape: &Isometry3<f64>) -> rapier::ColliderBuilder {
    let (builder, turn) = match shape {
        Geometry::Box { size } => (
            rapier::ColliderBuilder::cuboid(size.x / 2.0, size.y / 2.0, size.z / 2.0),
            UnitQuaternion::identity(),
        ),
        // Rapier's cylinders stand along y, the description's along z.
        Geometry::Cylinder { radius, length } => (
            rapier::ColliderBuilder::cylinder(length / 2.0, *radius),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2),
        ),
        Geometry::Sphere { radius } => (rapier::ColliderBuilder::ball(*radius), UnitQuaternion::identity()),
        Geometry::Capsule { radius, length } => {
            (rapier::ColliderBuilder::capsule_z(length / 2.0, *radius), UnitQuaternion::identity())
        }
        Geometry::Mesh(mesh) => (hull(mesh), UnitQuaternion::identity()),
    };
    builder
        .position(convert::pose(&(body_from_shape * turn)))
        .density(0.0)
        .friction(PAD_FRICTION)
        .collision_groups(groups(ROBOT, OBJECT | ROOM))
}

/// The convex hull of a mesh; the box around it where it is flat.
fn hull(mesh: &Mesh) -> rapier::ColliderBuilder {
    let points: Vec<_> = mesh.vertices().iter().map(|v| convert::vector(&v.coords)).collect();
    rapier::ColliderBuilder::convex_hull(&points).unwrap_or_else(|| {
        let (middle, half) = mesh.surrounding_box();
        let corners: [_; 8] = std::array::from_fn(|i| {
            let side = |axis: usize| if i >> axis & 1 == 0 { -1.0 } else { 1.0 };
            let thick = |axis: usize| side(axis) * half[axis].max(1e-3);
            convert::vector(&(middle.coords + Vector3::new(thick(0), thick(1), thick(2))))
        });
        rapier::ColliderBuilder::convex_hull(&corners)
            .unwrap_or_else(|| rapier::ColliderBuilder::ball(half.max().max(1e-3)))
    })
}

/// A free body with the mass and the inertia of a homogeneous box of this size (m), without a collision shape.
pub(super) fn add_box(
    physics: &mut rapier::PhysicsWorld,
    pose: &Isometry3<f64>,
    size: [f64; 3],
    mass: f64,
) -> rapier::RigidBodyHandle {
    let [sx, sy, sz] = size.map(|s| s * s);
    let inertia = Vector3::new(sy + sz, sx + sz, sx + sy) * (mass / 12.0);
    let mass = rapier::MassProperties::new(rapier::Vector::ZERO, mass, convert::vector(&inertia));
    let body = rapier::RigidBodyBuilder::dynamic()
        .pose(convert::pose(pose))
        .additional_mass_properties(mass)
        .can_sleep(false);
    physics.insert_body(body)
}
