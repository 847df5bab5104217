//! Builds a world's room, objects and robot in Rapier, once, at the start. It does not step them.

use armarium_robot::{Geometry, JointKind, LinkId, Mesh, Model, Visual};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rapier3d_f64::prelude as rapier;
use rapier3d_f64::prelude::{ColliderHandle, RigidBodyHandle};

use super::assembly::{Assembly, Lump, joint_motion};
use super::convert;
use super::drives::{LumpBody, Servo};
use super::mass::Mass;
use super::plant::{DT, Object, PAD_FRICTION};
use crate::error::PlantError;
use crate::foundation::{ElasticFoundation, FoundationReaction};
use crate::start::{BodyStart, RobotErrors};
use crate::table::{THICKNESS, TableTop};
use crate::world::{BodyMotion, BodyShape, BodySpec, GRAVITY, Softness};

const ROBOT: rapier::Group = rapier::Group::GROUP_1;
const OBJECT: rapier::Group = rapier::Group::GROUP_2;
const CORE: rapier::Group = rapier::Group::GROUP_3;
const ROOM: rapier::Group = rapier::Group::GROUP_4;
const RIGID: rapier::Group = rapier::Group::GROUP_5;
const PERSON: rapier::Group = rapier::Group::GROUP_6;

/// Friction of a person's skin and clothes.
const SKIN_FRICTION: f64 = 0.5;

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

/// Adds the table and the floor; returns the table.
pub(super) fn add_room(physics: &mut rapier::PhysicsWorld, table: &TableTop) -> ColliderHandle {
    let [hx, hy] = table.half();
    let below = Isometry3::translation(0.0, 0.0, -THICKNESS / 2.0);
    let top = rapier::ColliderBuilder::cuboid(hx, hy, THICKNESS / 2.0)
        .position(convert::pose(&(table.root_from_top() * below)))
        .friction(table.friction())
        .collision_groups(groups(ROOM, ROBOT | CORE | RIGID));
    let floor = rapier::ColliderBuilder::cuboid(10.0, 10.0, 0.5)
        .translation(rapier::Vector::new(0.0, 0.0, -0.5))
        .collision_groups(groups(ROOM, ROBOT | CORE | OBJECT | RIGID));
    let table = physics.insert_collider(top, None);
    physics.insert_collider(floor, None);
    table
}

/// Adds a body that is no part of a robot.
pub(super) fn add_body(physics: &mut rapier::PhysicsWorld, table: &TableTop, body: &BodyStart) -> Object {
    let BodyStart { spec, room_from_body } = body;
    match spec.softness() {
        Some(softness) => add_soft_box(physics, table, room_from_body, &softness),
        None => add_rigid(physics, room_from_body, spec),
    }
}

fn add_soft_box(
    physics: &mut rapier::PhysicsWorld,
    table: &TableTop,
    pose: &Isometry3<f64>,
    softness: &Softness,
) -> Object {
    let foundation = ElasticFoundation::new(softness);
    let half = *foundation.half();
    let handle = add_box(physics, pose, softness.size, softness.mass);
    let full = rapier::ColliderBuilder::cuboid(half.x, half.y, half.z)
        .density(0.0)
        .friction(PAD_FRICTION)
        .collision_groups(groups(OBJECT, ROBOT | OBJECT | ROOM | RIGID | PERSON));
    let core = rapier::ColliderBuilder::cuboid(half.x * 0.8, half.y * 0.8, half.z * 0.15)
        .density(0.0)
        .friction(table.friction())
        .collision_groups(groups(CORE, ROOM));
    let collider = physics.insert_collider(full, Some(handle));
    physics.insert_collider(core, Some(handle));
    let reaction = FoundationReaction::default();
    let (colliders, foundation) = (vec![collider], Some(foundation));
    Object {
        handle,
        colliders,
        foundation,
        reaction,
        loose: true,
        has_handles: false,
        slippery: None,
        cuboid: None,
    }
}

/// A body whose parts are all of one density.
fn add_rigid(physics: &mut rapier::PhysicsWorld, pose: &Isometry3<f64>, spec: &BodySpec) -> Object {
    let fixed = spec.motion == BodyMotion::Static;
    let body = if fixed { rapier::RigidBodyBuilder::fixed() } else { rapier::RigidBodyBuilder::dynamic() };
    let (all, handles) = (spec.parts(), spec.handle_parts().len());
    let plain = all.len() - handles;
    let form = |(i, part): (usize, &Visual)| {
        let form = shape(&part.shape, &part.link_from_shape)
            .collision_groups(groups(RIGID, ROBOT | OBJECT | ROOM | RIGID | PERSON));
        // What sticks to a handle is the soft grip of a hand. Contacts with hooks, though there is none, are found anew in each step:
        // otherwise Rapier keeps their normals in the room until what touches has turned by 11 degrees, and pads that turn with a
        // handle push it aside with a fifth of their force, until they let go of a sudden.
        if i < plain {
            form.friction(spec.friction)
        } else {
            form.friction(0.0)
                .friction_combine_rule(rapier::CoefficientCombineRule::Multiply)
                .active_hooks(rapier::ActiveHooks::MODIFY_SOLVER_CONTACTS)
        }
    };
    let parts: Vec<_> = all.iter().enumerate().map(form).collect();
    let volume: f64 = parts.iter().map(|part| part.shape.mass_properties(1.0).mass()).sum();
    let density = if volume > 0.0 { spec.mass / volume } else { 0.0 };
    let mut mass = Mass::default();
    parts.iter().for_each(|part| mass.add_shape(part, density));
    let body = body.additional_mass_properties(mass.properties(0.0));
    let handle = physics.insert_body(body.pose(convert::pose(pose)).can_sleep(false));
    let colliders: Vec<ColliderHandle> =
        parts.into_iter().map(|part| physics.insert_collider(part.density(0.0), Some(handle))).collect();
    // Else its mass is 0 until the first step, and pads that press on it have no damping.
    physics.bodies[handle].recompute_mass_properties_from_colliders(&physics.colliders);
    let guided = attach(physics, handle, pose, spec);
    let reaction = FoundationReaction::default();
    let cuboid = (spec.shape == BodyShape::Box).then(|| spec.half());
    let (loose, has_handles) = (!fixed && !guided, handles > 0);
    Object { handle, colliders, foundation: None, reaction, loose, has_handles, slippery: None, cuboid }
}

/// Adds a part of a person: one with a mass moves by forces, without gravity; the others are moved.
pub(super) fn add_person_part(
    physics: &mut rapier::PhysicsWorld,
    form: &Geometry,
    pose: &Isometry3<f64>,
    mass: Option<f64>,
) -> (RigidBodyHandle, ColliderHandle) {
    let body = match mass {
        Some(mass) => {
            rapier::RigidBodyBuilder::dynamic().additional_mass(mass).lock_rotations().gravity_scale(0.0)
        }
        None => rapier::RigidBodyBuilder::kinematic_position_based(),
    };
    let body = physics.insert_body(body.pose(convert::pose(pose)).can_sleep(false));
    let part = shape(form, &Isometry3::identity())
        .density(0.0)
        .friction(SKIN_FRICTION)
        .collision_groups(person_groups(true));
    (body, physics.insert_collider(part, Some(body)))
}

/// What a part of a person touches; nothing while it `touches` nothing.
pub(super) fn person_groups(touches: bool) -> rapier::InteractionGroups {
    groups(PERSON, if touches { ROBOT | RIGID | OBJECT } else { rapier::Group::NONE })
}

/// Attaches a body to the room by its hinge or its slide; returns whether it has one.
fn attach(
    physics: &mut rapier::PhysicsWorld,
    handle: RigidBodyHandle,
    pose: &Isometry3<f64>,
    spec: &BodySpec,
) -> bool {
    let axis = |axis: [f64; 3]| nalgebra::Unit::new_normalize(Vector3::from(axis));
    let (joint, moves, limits, damping, axis, through) = match (&spec.hinge, &spec.slide) {
        (Some(hinge), _) => (
            rapier::JointAxesMask::LOCKED_REVOLUTE_AXES,
            rapier::JointAxis::AngX,
            hinge.limits_deg.map(f64::to_radians),
            hinge.damping,
            axis(hinge.axis),
            Vector3::from(hinge.through),
        ),
        (None, Some(slide)) => (
            rapier::JointAxesMask::LOCKED_PRISMATIC_AXES,
            rapier::JointAxis::LinX,
            slide.limits,
            slide.damping,
            axis(slide.axis),
            Vector3::zeros(),
        ),
        (None, None) => return false,
    };
    let room = physics.insert_body(rapier::RigidBodyBuilder::fixed());
    let frame = Isometry3::from_parts(through.into(), along_x(&axis));
    let joint = rapier::GenericJointBuilder::new(joint)
        .local_frame1(convert::pose(&(pose * frame)))
        .local_frame2(convert::pose(&frame))
        .limits(moves, limits)
        .motor_velocity(moves, 0.0, damping)
        .motor_model(moves, rapier::MotorModel::ForceBased)
        .build();
    physics.impulse_joints.insert(room, handle, joint, true);
    true
}

/// The rotation that turns x into an axis.
fn along_x(axis: &nalgebra::Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::x(), axis)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI))
}

/// The robot's bodies in Rapier.
pub(super) struct RobotBodies {
    /// What is fixed to the room.
    pub(super) base: RigidBodyHandle,
    /// A body for each lump.
    pub(super) bodies: Vec<LumpBody>,
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
    (room_from_root, errors): (&Isometry3<f64>, &RobotErrors),
    (position, velocity): (&[f64], &[f64]),
) -> Result<RobotBodies, PlantError> {
    let base = physics.insert_body(rapier::RigidBodyBuilder::fixed().pose(convert::pose(room_from_root)));
    let mut bodies: Vec<LumpBody> = Vec::new();
    let mut poses: Vec<Isometry3<f64>> = Vec::new();
    for lump in &assembly.lumps {
        let q = lump.multiplier * position[lump.joint] + lump.offset;
        let parent_pose = lump.parent.map_or(*room_from_root, |p| poses[p]);
        let at_start = lump.parent_from_body * joint_motion(lump.kind, &lump.axis, q);
        let pose = parent_pose * at_start;
        let handle = physics.insert_body(lump_body(lump, &pose, errors));
        let parent = lump.parent.map_or(base, |p| bodies[p].handle);
        let joint = physics
            .multibody_joints
            .insert(parent, handle, joint_of(lump, &at_start), true)
            .ok_or_else(|| PlantError::Joint { joint: model.joints()[lump.joint].name.clone() })?;
        bodies.push(LumpBody {
            handle,
            joint,
            index: lump.joint,
            leads: model.joints()[lump.joint].link == lump.link,
            multiplier: lump.multiplier,
            offset: lump.offset,
            kind: lump.kind,
            start: q,
            state: (q, lump.multiplier * velocity[lump.joint]),
            motor: q,
            servo: servo(lump, model.joints()[lump.joint].effort, errors),
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

fn lump_body(lump: &Lump, pose: &Isometry3<f64>, errors: &RobotErrors) -> rapier::RigidBodyBuilder {
    rapier::RigidBodyBuilder::dynamic()
        .pose(convert::pose(pose))
        .additional_mass_properties(lump.mass.properties(0.01))
        .gravity_scale(errors.gravity)
        .can_sleep(false)
}

/// In both frames x is the joint's axis. The coordinate is 0 in the start posture.
fn joint_of(lump: &Lump, parent_from_start: &Isometry3<f64>) -> rapier::GenericJoint {
    let frame = Isometry3::from_parts(Vector3::zeros().into(), along_x(&lump.axis));
    let locked = match lump.kind {
        JointKind::Revolute => rapier::JointAxesMask::LOCKED_REVOLUTE_AXES,
        JointKind::Prismatic => rapier::JointAxesMask::LOCKED_PRISMATIC_AXES,
    };
    rapier::GenericJointBuilder::new(locked)
        .local_frame1(convert::pose(&(parent_from_start * frame)))
        .local_frame2(convert::pose(&frame))
        .build()
}

/// Gains according to the load of the joint: highest for a platform and the torso, lowest for the wrist; all settle in the drives'
/// time.
fn servo(lump: &Lump, effort: f64, errors: &RobotErrors) -> Servo {
    let damping = match lump.kind {
        JointKind::Prismatic if effort >= 1000.0 => 1e4,
        JointKind::Prismatic => 80.0,
        JointKind::Revolute if effort >= 150.0 => 1e3,
        JointKind::Revolute if effort >= 50.0 => 300.0,
        JointKind::Revolute => 100.0,
    };
    let limited = effort > 0.0;
    Servo {
        // Spring and damper settle as exp(-t stiffness / damping), to 2 % in four time constants.
        stiffness: 4.0 * damping / errors.drive_time,
        damping,
        effort: if limited { effort } else { f64::MAX },
        friction: if limited { errors.friction * effort } else { 0.0 },
        play: if lump.kind == JointKind::Revolute { errors.backlash / 2.0 } else { 0.0 },
    }
}

/// Sets the motors' reflected inertia, kg m^2 (kg), and the joints' velocities, and removes Rapier's own damping, as the
/// servo has its own.
fn set_rotors(physics: &mut rapier::PhysicsWorld, bodies: &[LumpBody]) {
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

fn collider(form: &Geometry, body_from_shape: &Isometry3<f64>) -> rapier::ColliderBuilder {
    shape(form, body_from_shape)
        .density(0.0)
        .friction(PAD_FRICTION)
        .collision_groups(groups(ROBOT, OBJECT | ROOM | RIGID | PERSON))
}

/// A form at its place in a body.
fn shape(form: &Geometry, body_from_shape: &Isometry3<f64>) -> rapier::ColliderBuilder {
    let (builder, turn) = match form {
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
    builder.position(convert::pose(&(body_from_shape * turn)))
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
