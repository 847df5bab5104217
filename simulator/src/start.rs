//! How a world begins: where its robots and bodies are at the start.
//!
//! It only reads the world and computes poses; the physics builds what it says.

use std::sync::Arc;

use armarium_robot::{Joint, JointKind, Model};
use armarium_values::random::StandardNormal;
use nalgebra::{Isometry3, Point3, Rotation2, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::error::SimulationError;
use crate::table::TableTop;
use crate::world::{BodyShape, BodySpec, GRAVITY, Imperfections, PadSpec, Place, RobotSpec, World};

/// A robot, where it stands, and how.
#[derive(Clone, Debug)]
pub struct RobotStart {
    /// Its name in the world.
    pub name: String,
    /// The robot.
    pub model: Arc<Model>,
    /// The name of the arm that works.
    pub arm: String,
    /// Where its root is in the room; its z points up.
    pub room_from_root: Isometry3<f64>,
    /// Positions of all its joints as the robot senses them without noise, rad (m).
    pub position: Vec<f64>,
    /// What it truly is, against its model.
    pub errors: RobotErrors,
    /// Soft pads on the hands of its arms, in the model's order. A robot that has any touches with them alone.
    pub pads: Vec<MountedPad>,
}

/// A pad on a hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountedPad {
    /// How it feels.
    pub spec: PadSpec,
    /// The middle of its outer face, TCP frame, m.
    pub middle: Point3<f64>,
    /// The directions of its edges, along the fingers and across them, TCP frame; unit vectors.
    pub edges: [Vector3<f64>; 2],
    /// The direction in which it presses, TCP frame; a unit vector.
    pub normal: Vector3<f64>,
}

/// The errors of one robot's body.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotErrors {
    /// Of each joint, its sensed position less the true one, rad (m).
    pub zeros: Vec<f64>,
    /// The share of its own weight that is not compensated.
    pub gravity: f64,
    /// Play of each turning joint, rad.
    pub backlash: f64,
    /// Coulomb friction of a joint over its effort.
    pub friction: f64,
    /// Time in which a drive settles to 2 %, s.
    pub drive_time: f64,
    /// True mass beyond a wrench sensor over that of the model.
    pub hand_mass_scale: f64,
}

impl RobotStart {
    /// Where its joints truly are, rad (m).
    pub fn true_position(&self) -> Vec<f64> {
        self.position.iter().zip(&self.errors.zeros).map(|(sensed, zero)| sensed - zero).collect()
    }
}

impl RobotErrors {
    /// A robot that is what its model says.
    pub fn none(joints: usize) -> Self {
        Self {
            zeros: vec![0.0; joints],
            gravity: 0.0,
            backlash: 0.0,
            friction: 0.0,
            drive_time: 0.04,
            hand_mass_scale: 1.0,
        }
    }

    fn draw(physics: &Imperfections, model: &Model, rng: &mut ChaCha8Rng) -> Self {
        let sigma = physics.joint_zero_deg.to_radians();
        let mut zero = |joint: &Joint| match joint.kind {
            JointKind::Revolute => sigma * rng.sample::<f64, _>(StandardNormal),
            JointKind::Prismatic => 0.0,
        };
        let zeros = model.joints().iter().map(&mut zero).collect();
        let mut either = || if rng.random::<bool>() { 1.0 } else { -1.0 };
        Self {
            zeros,
            gravity: either() * physics.gravity_error,
            backlash: physics.backlash_deg.to_radians(),
            friction: physics.joint_friction,
            drive_time: physics.drive_time,
            hand_mass_scale: 1.0 + either() * physics.hand_mass_error,
        }
    }
}

/// A body and its pose.
#[derive(Clone, Debug)]
pub struct BodyStart {
    /// The body.
    pub spec: BodySpec,
    /// Its middle.
    pub room_from_body: Isometry3<f64>,
}

/// A world's robots, whose errors the seed draws; the first in the posture `posture`, rad (m), by default in its own.
///
/// # Errors
/// [`SimulationError`] when one cannot be used.
pub fn robots(
    world: &World,
    seed: u64,
    posture: Option<Vec<f64>>,
) -> Result<Vec<RobotStart>, SimulationError> {
    let mut posture = posture;
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xe770_0255);
    let mut is_first = true;
    let begin = |spec: &RobotSpec| {
        let model = spec.model()?;
        let arm = spec.arm(&model).ok_or(SimulationError::Arm)?.name.clone();
        let mut position = posture.take().unwrap_or_else(|| model.start_of(&arm).to_vec());
        let joints = model.joints().len();
        if position.len() != joints || !position.iter().all(|q| q.is_finite()) {
            return Err(SimulationError::Start { expected: joints });
        }
        let errors = RobotErrors::draw(&world.physics.0, &model, &mut rng);
        let (name, mut room_from_root) = (spec.name.clone(), spec.world_from_root());
        if std::mem::take(&mut is_first) {
            // Its root is the room's origin; what stands elsewhere is its platform.
            for (joint, at) in model.platform().into_iter().flat_map(|platform| {
                platform.joints.into_iter().zip([spec.at[0], spec.at[1], spec.yaw_deg.to_radians()])
            }) {
                position[joint] += at;
            }
            room_from_root = Isometry3::identity();
        }
        let pads = spec.pads.map_or_else(Vec::new, |pad| mounted(pad, &model));
        Ok(RobotStart { name, model, arm, room_from_root, position, errors, pads })
    };
    [&world.robot].into_iter().chain(&world.robots).map(begin).collect()
}

/// Pads on the faces with which the hands of a robot press.
fn mounted(spec: PadSpec, model: &Model) -> Vec<MountedPad> {
    let faces = model.arms().filter_map(|arm| model.hand_of(arm)?.press_in_tcp);
    let pad = |face: Isometry3<f64>| MountedPad {
        spec,
        middle: face.translation.vector.into(),
        edges: [face.rotation * Vector3::y(), face.rotation * Vector3::z()],
        normal: face.rotation * Vector3::x(),
    };
    faces.map(pad).collect()
}

/// A world's bodies: those that the file names, in its order, then what lies in those.
pub fn bodies(world: &World, table: &TableTop) -> Vec<BodyStart> {
    let mut all: Vec<BodyStart> = Vec::new();
    for spec in world.named_bodies() {
        let named = |name: &Option<String>| {
            name.as_ref().and_then(|name| all.iter().find(|body| body.spec.name == *name))
        };
        let room_from_body = match (named(&spec.on), named(&spec.beside)) {
            (Some(under), _) => upon(&spec, under),
            (None, Some(other)) => beside(&spec, other),
            (None, None) => room_from_body(&spec, table),
        };
        all.push(BodyStart { room_from_body, spec });
    }
    let inside: Vec<BodyStart> = all.iter().flat_map(contents).collect();
    all.extend(inside);
    all
}

/// A body that stands on another one.
fn upon(spec: &BodySpec, under: &BodyStart) -> Isometry3<f64> {
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), spec.yaw_deg.to_radians());
    let [x, y] = spec.at.xy();
    let at = Vector3::new(x, y, under.spec.bears_at() + spec.half().z);
    under.room_from_body * Isometry3::from_parts(at.into(), yaw)
}

/// So far apart are bodies that touch, m, so that physics does not push them apart.
const TOUCHING: f64 = 1e-4;

/// A body that touches another one, and stands where that does.
fn beside(spec: &BodySpec, other: &BodyStart) -> Isometry3<f64> {
    let (turn, yaw) = (Rotation2::new(spec.yaw_deg.to_radians()), spec.yaw_deg.to_radians());
    let own: Vec<Vector2<f64>> = spec.outline().into_iter().map(|corner| turn * corner).collect();
    let direction = Vector2::from(spec.at.xy()).try_normalize(1e-9).unwrap_or_else(Vector2::x);
    let at = direction * (until_apart(&other.spec.outline(), &own, &direction) + TOUCHING);
    let up = spec.half().z - other.spec.half().z;
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    other.room_from_body * Isometry3::from_parts(at.push(up).into(), yaw)
}

/// How far a convex outline has to go in a direction until it is apart from another one; their corners go against the clock.
fn until_apart(still: &[Vector2<f64>], moved: &[Vector2<f64>], direction: &Vector2<f64>) -> f64 {
    let normals = |outline: &[Vector2<f64>], sign: f64| -> Vec<Vector2<f64>> {
        let edges = outline.iter().zip(outline.iter().cycle().skip(1)).map(|(a, b)| b - a);
        edges.map(|edge| Vector2::new(edge.y, -edge.x) * sign).collect()
    };
    let most = |outline: &[Vector2<f64>], n: &Vector2<f64>, sign: f64| {
        outline.iter().map(|corner| n.dot(corner) * sign).fold(f64::NEG_INFINITY, f64::max)
    };
    // They touch where the way leaves the sum of the one and the mirrored other; its sides have the normals of both.
    let all = normals(still, 1.0).into_iter().chain(normals(moved, -1.0));
    all.filter(|n| n.dot(direction) > 1e-12)
        .map(|n| (most(still, &n, 1.0) + most(moved, &n, -1.0)) / n.dot(direction))
        .fold(f64::INFINITY, f64::min)
}

/// A body that lies on the table stands as the table is tilted.
fn room_from_body(spec: &BodySpec, table: &TableTop) -> Isometry3<f64> {
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), spec.yaw_deg.to_radians());
    let [x, y] = match spec.at {
        Place::At(at) => return Isometry3::from_parts(Vector3::from(at).into(), yaw),
        Place::On(at) => at,
    };
    // A soft body starts as deep as its weight presses it in.
    let sink = spec.soft.map_or(0.0, |stiffness| spec.mass * GRAVITY / stiffness);
    let up = spec.half().z - sink;
    let surface = Point3::new(x, y, table.plane_height(x, y));
    let on_table = surface + table.plane_normal().into_inner() * up;
    if table.is_over(&on_table) {
        Isometry3::from_parts(on_table.coords.into(), table.root_from_top().rotation * yaw)
    } else {
        Isometry3::from_parts(Vector3::new(x, y, up).into(), yaw)
    }
}

/// The balls in a cup or a tray, layer by layer above its bottom.
fn contents(holder: &BodyStart) -> Vec<BodyStart> {
    let BodyStart { spec, room_from_body } = holder;
    let Some(contents) = &spec.contents else { return Vec::new() };
    let half = spec.half();
    let inside = half.xy().map(|side| (side - spec.wall - contents.diameter / 2.0).max(0.0));
    let pitch = contents.diameter * 1.05;
    let across = |side: f64| (side / pitch).floor() as i32;
    let within = |[x, y]: &[f64; 2]| match spec.shape {
        BodyShape::Cup => libm::hypot(*x, *y) <= inside.x,
        _ => x.abs() <= inside.x && y.abs() <= inside.y,
    };
    let columns = || -across(inside.x)..=across(inside.x);
    let layer: Vec<[f64; 2]> = (-across(inside.y)..=across(inside.y))
        .flat_map(|j| columns().map(move |i| [f64::from(i) * pitch, f64::from(j) * pitch]))
        .filter(within)
        .collect();
    let ball = |n: usize| {
        let [x, y] = layer[n % layer.len()];
        let height = spec.wall + contents.diameter * (0.5 + 1.02 * (n / layer.len()) as f64);
        let at = room_from_body * Point3::new(x, y, height - half.z);
        let spec = BodySpec {
            name: format!("{}_{}", spec.name, n + 1),
            shape: BodyShape::Sphere,
            diameter: contents.diameter,
            mass: contents.mass,
            friction: spec.friction,
            at: Place::At(at.into()),
            color: contents.color,
            ..BodySpec::default()
        };
        BodyStart {
            spec,
            room_from_body: Isometry3::from_parts(at.coords.into(), UnitQuaternion::identity()),
        }
    };
    (0..contents.balls as usize).map(ball).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Apart by the way that is said, and not by less; what is round is taken for 64 corners around it.
        #[test]
        fn bodies_beside_each_other_touch(
            (w, d, angle, yaw) in (0.03..0.2f64, 0.03..0.2f64, 0.0..std::f64::consts::TAU, 0.0..360.0f64), round in any::<bool>(),
        ) {
            let still = BodySpec { size: [0.08, 0.05, 0.06], ..BodySpec::default() };
            let shape = if round { BodyShape::Cylinder } else { BodyShape::Box };
            let moved = BodySpec { shape, size: [w, d, 0.1], diameter: w, ..BodySpec::default() };
            let direction = Rotation2::new(angle) * Vector2::x();
            let turn = Rotation2::new(f64::to_radians(yaw));
            let own: Vec<Vector2<f64>> = moved.outline().into_iter().map(|corner| turn * corner).collect();
            let way = until_apart(&still.outline(), &own, &direction);
            let half = Vector2::new(0.04, 0.025);
            // A circle by its distance from the box; another box by the projections on the axes of both.
            let overlap = |way: f64| {
                let middle: Vector2<f64> = direction * way;
                if round {
                    return (middle.abs() - half).sup(&Vector2::zeros()).norm() < w / 2.0;
                }
                let (own, axes) = (turn.matrix().abs() * Vector2::new(w, d) / 2.0, turn.inverse() * middle);
                let other = turn.inverse().matrix().abs() * half;
                (0..2).all(|i| middle[i].abs() < half[i] + own[i] && axes[i].abs() < Vector2::new(w, d)[i] / 2.0 + other[i])
            };
            prop_assert!(!overlap(way + 1e-6), "apart after {way}");
            prop_assert!(overlap(way - 0.0012), "touching before {way}");
        }
    }
}
