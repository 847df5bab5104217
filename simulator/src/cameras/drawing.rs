//! Everything that a camera could see, as shapes for the renderer: the room, the table with its dirt, bodies, robots, and the
//! coach with tool and hand. It knows no camera.

use std::sync::Arc;

use armarium_robot::{Kinematics, LinkId, Visual};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::NO_CAMERA;
use crate::coach::CoachState;
use crate::figure;
use crate::render::hand::{HandPose, hand_shapes};
use crate::render::robot::{link_shapes, robot_shapes};
use crate::render::{Bump, DirtTexture, ExposureMotion, Shape, VisibleForm, VisibleScene};
use crate::start::{self, RobotStart};
use crate::table::{DirtGrid, LEG_RADIUS, THICKNESS, TableTop};
use crate::world::{CoverSpec, World};

/// Half the edges of the coach's tool, m.
pub const TOOL_HALF: Vector3<f64> = Vector3::new(0.045, 0.03, 0.02);
/// Colour of dirt.
const DIRT: [u8; 3] = [104, 92, 84];
/// Radius around the middle of the workspace in which the table is visibly dirty, m.
const DIRTY_RADIUS: f64 = 0.22;

/// The joints of a robot at one frame, rad (m), in its model's order.
#[derive(Clone, Copy)]
pub(crate) struct RobotJoints<'a> {
    /// As they are.
    pub(crate) truth: &'a [f64],
    /// As the robot senses them.
    pub(crate) sensed: &'a [f64],
}

/// Where everything was that moves, `SINCE_MOMENT` before a frame: how it moves follows from that.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// True joint positions of the robots, rad (m), in the world's order.
    pub robots: Vec<Vec<f64>>,
    /// Poses of the bodies.
    pub objects: Vec<Isometry3<f64>>,
    /// Poses of the parts of all people.
    pub people: Vec<Vec<Isometry3<f64>>>,
    /// Pose of the coach's tool while it was shown.
    pub tool: Option<Isometry3<f64>>,
    /// Pose of the coach's hand while it was shown.
    pub hand: Option<Isometry3<f64>>,
}

/// Time between a [`Moment`] and its frame, s.
pub(crate) const SINCE_MOMENT: f64 = 1e-3;

/// The state of the scene at one frame.
pub(crate) struct SceneState<'a> {
    pub(crate) exposed_ns: u64,
    /// Where everything was shortly before; `None` where that is not known, and nothing is blurred.
    pub(crate) before: Option<&'a Moment>,
    /// The robots, in the world's order.
    pub(crate) robots: &'a [RobotJoints<'a>],
    /// Poses of all bodies.
    pub(crate) objects: &'a [Isometry3<f64>],
    /// Poses of the parts of all people.
    pub(crate) people: &'a [Vec<Isometry3<f64>>],
    pub(crate) coach: &'a CoachState,
    /// Time since the last hand was visible, s.
    pub(crate) without_hand_s: f64,
    pub(crate) wiped: &'a DirtGrid,
}

/// Where what moves is, but for the robots.
struct Places<'a> {
    objects: &'a [Isometry3<f64>],
    people: &'a [Vec<Isometry3<f64>>],
    tool: Option<Isometry3<f64>>,
    hand: Option<(HandPose, Isometry3<f64>)>,
}

/// The shapes of what is not a robot, for viewers.
#[derive(Clone, Debug)]
pub struct SceneShapes {
    /// What stands still, each shape at its place in the root frame.
    pub fixed: Vec<Shape>,
    /// The parts of each body of [`TruthSample::objects`](crate::TruthSample::objects), in the body's frame.
    pub bodies: Vec<Vec<Shape>>,
    /// The parts of each person, each in the frame of [`TruthSample::people_parts`](crate::TruthSample::people_parts).
    pub people: Vec<Vec<Shape>>,
}

/// What there is to draw.
pub(crate) struct Drawing {
    /// The robots, and where their roots are in the scene.
    robots: Vec<(Kinematics, Isometry3<f64>)>,
    /// The robots as they were shortly before.
    before: Vec<Kinematics>,
    /// How long the shutter is open, over [`SINCE_MOMENT`].
    exposure: f64,
    fixed: Vec<Shape>,
    table_half: Vector3<f64>,
    table_pose: Isometry3<f64>,
    table_color: [u8; 3],
    bumps: Arc<[Bump]>,
    dirt: Arc<DirtTexture>,
    objects: Vec<Vec<Visual>>,
    /// The solids of each person's parts, each in its own frame, and how they look.
    people: Vec<Vec<Visual>>,
    looks: Vec<Vec<Vec<Visual>>>,
    tool_color: [u8; 3],
}

impl Drawing {
    /// The things of a world; `seed` determines where the table is dirty.
    pub(crate) fn new(world: &World, robots: &[RobotStart], table: &TableTop, seed: u64) -> Self {
        let [hx, hy] = table.half();
        let kinematics = |robot: &RobotStart| Kinematics::new(&robot.model);
        Self {
            robots: robots.iter().map(|robot| (kinematics(robot), robot.room_from_root)).collect(),
            before: robots.iter().map(kinematics).collect(),
            exposure: world.camera.exposure / SINCE_MOMENT,
            fixed: legs(table).into_iter().chain(world.covers.iter().map(board)).collect(),
            table_half: Vector3::new(hx, hy, THICKNESS / 2.0),
            table_pose: table.root_from_top() * Translation3::new(0.0, 0.0, -THICKNESS / 2.0),
            table_color: world.table.color,
            bumps: table.bumps().to_vec().into(),
            dirt: Arc::new(blotches(world, table, seed)),
            objects: start::bodies(world, table).iter().map(|body| body.spec.parts()).collect(),
            people: world.people().map(figure::parts).collect(),
            looks: world.people().map(figure::looks).collect(),
            tool_color: world.coach.tool.color,
        }
    }

    pub(crate) fn shapes(&self) -> SceneShapes {
        let table = VisibleForm::Box { half: self.table_half };
        let table = Shape::new(table, self.table_pose, self.table_color);
        let own = |parts: &Vec<Visual>| link_shapes(parts, &Isometry3::identity());
        SceneShapes {
            fixed: self.fixed.iter().cloned().chain([table]).collect(),
            bodies: self.objects.iter().map(own).collect(),
            people: self.people.iter().map(own).collect(),
        }
    }

    /// Number of its bodies.
    pub(super) fn bodies(&self) -> usize {
        self.objects.len()
    }

    /// Number of parts of each person.
    pub(super) fn people(&self) -> impl Iterator<Item = usize> + '_ {
        self.people.iter().map(Vec::len)
    }

    /// Number of joints of each robot.
    pub(super) fn joints(&self) -> impl Iterator<Item = usize> + '_ {
        self.robots.iter().map(|(kinematics, _)| kinematics.model().joints().len())
    }

    /// How long the shutter is open, over [`SINCE_MOMENT`].
    pub(crate) fn exposure(&self) -> f64 {
        self.exposure
    }

    /// Pose of a robot's link shortly before the scene that was built last, and in it; for none, a place where a head might be.
    pub(crate) fn links(&self, robot: usize, link: Option<LinkId>) -> [Isometry3<f64>; 2] {
        let (kinematics, scene_from_root) = &self.robots[robot];
        [&self.before[robot], kinematics].map(|kinematics| {
            let nowhere = || Translation3::from(NO_CAMERA).into();
            scene_from_root * link.map_or_else(nowhere, |link| *kinematics.pose(link))
        })
    }

    /// Moves the robots to where they are.
    pub(crate) fn update(&mut self, robots: &[RobotJoints<'_>]) {
        for ((kinematics, _), state) in self.robots.iter_mut().zip(robots) {
            kinematics.update(state.truth);
        }
    }

    /// All shapes at one instant, and how they move.
    pub(crate) fn scene(&mut self, view: &SceneState<'_>) -> VisibleScene {
        self.update(view.robots);
        self.clean(view.wiped);
        for (n, (kinematics, state)) in self.before.iter_mut().zip(view.robots).enumerate() {
            kinematics.update(view.before.map_or(state.truth, |before| &before.robots[n]));
        }
        let hand = view.coach.hand.map(|hand| (HandPose::of(hand.gesture), hand.root_from_hand));
        let now = Places { objects: view.objects, people: view.people, tool: view.coach.tool, hand };
        let robots = self.robots.iter().map(|(kinematics, _)| kinematics);
        let mut scene = VisibleScene::new(self.shapes_at(robots, &now));
        if let Some(before) = view.before.filter(|_| self.exposure > 0.0) {
            // What has just come does not move.
            let then = Places {
                objects: &before.objects,
                people: &before.people,
                tool: now.tool.map(|now| before.tool.unwrap_or(now)),
                hand: now.hand.map(|(posture, now)| (posture, before.hand.unwrap_or(now))),
            };
            let shapes = self.shapes_at(self.before.iter(), &then);
            let poses = shapes.iter().zip(&scene.shapes);
            let motion = |(then, now): (&Shape, &Shape)| {
                ExposureMotion::between(&then.scene_from_shape, &now.scene_from_shape, self.exposure)
            };
            scene.motions = poses.map(motion).collect();
        }
        scene
    }

    /// All shapes, with robots and what else moves at these places.
    fn shapes_at<'a>(&self, robots: impl Iterator<Item = &'a Kinematics>, places: &Places<'_>) -> Vec<Shape> {
        let mut shapes: Vec<Shape> = Vec::new();
        for (kinematics, (_, scene_from_root)) in robots.zip(&self.robots) {
            shapes.extend(robot_shapes(kinematics, scene_from_root));
        }
        shapes.extend(self.fixed.iter().cloned());
        let (bumps, dirt) = (Arc::clone(&self.bumps), Some(Arc::clone(&self.dirt)));
        let table = VisibleForm::Tabletop { half: self.table_half, bumps, dirt };
        shapes.push(Shape::new(table, self.table_pose, self.table_color));
        for (parts, pose) in self.objects.iter().zip(places.objects) {
            shapes.extend(link_shapes(parts, pose));
        }
        for (parts, poses) in self.looks.iter().zip(places.people) {
            shapes.extend(parts.iter().zip(poses).flat_map(|(part, pose)| link_shapes(part, pose)));
        }
        if let Some(pose) = &places.tool {
            shapes.extend(tool(pose, self.tool_color));
        }
        if let Some((posture, root_from_hand)) = &places.hand {
            shapes.extend(hand_shapes(posture, root_from_hand));
        }
        shapes
    }

    /// Removes the dirt where the table has been wiped.
    fn clean(&mut self, wiped: &DirtGrid) {
        let stale = wiped.cells().iter().zip(&self.dirt.cells).any(|(w, d)| *w && *d > 0);
        if stale {
            let dirt = Arc::make_mut(&mut self.dirt);
            for (cell, wiped) in dirt.cells.iter_mut().zip(wiped.cells()) {
                if *wiped {
                    *cell = 0;
                }
            }
        }
    }
}

fn legs(table: &TableTop) -> Vec<Shape> {
    let leg = |(pose, half_length)| {
        Shape::new(VisibleForm::Cylinder { radius: LEG_RADIUS, half_length }, pose, [90, 90, 94])
    };
    table.legs().map(leg).into()
}

fn board(cover: &CoverSpec) -> Shape {
    let half = Vector3::from(cover.size) / 2.0;
    Shape::new(VisibleForm::Box { half }, cover.root_from_cover(), cover.color)
}

/// The coach's block on a grey stick.
fn tool(pose: &Isometry3<f64>, color: [u8; 3]) -> [Shape; 2] {
    let along = Vector3::new(0.0, 0.6, 0.8);
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &along).unwrap_or_default();
    let stick = Isometry3::from_parts((along * 0.13).into(), turn);
    let rod = VisibleForm::Cylinder { radius: 0.008, half_length: 0.12 };
    let block = Shape::new(VisibleForm::Box { half: TOOL_HALF }, *pose, color);
    [block, Shape::new(rod, pose * stick, [72, 72, 78])]
}

/// Dirt around the workspace: spots of random strength, determined by the seed.
fn blotches(world: &World, table: &TableTop, seed: u64) -> DirtTexture {
    use rand::{RngExt, SeedableRng};
    let grid = DirtGrid::new(table);
    let mut texture = DirtTexture::clean(grid.columns(), grid.rows(), DIRT);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed ^ 0x5eed_d127);
    let path = crate::coach::CoachPath::new(&world.coach.demonstration.clone().unwrap_or_default());
    let [cx, cy] = path.center();
    let middle = table.root_from_top().inverse() * Point3::new(cx, cy, world.table.height);
    let [hx, hy] = table.half();
    for _ in 0..90 {
        let (angle, distance) = (rng.random::<f64>() * std::f64::consts::TAU, rng.random::<f64>().sqrt());
        let x = middle.x + DIRTY_RADIUS * distance * libm::cos(angle);
        let y = middle.y + DIRTY_RADIUS * distance * libm::sin(angle);
        let radius = 0.012 + 0.03 * rng.random::<f64>();
        let strength = 60.0 + 120.0 * rng.random::<f64>();
        for row in 0..texture.rows {
            let dy = (row as f64 + 0.5) * crate::table::DIRT_CELL - hy - y;
            if dy.abs() > radius {
                continue;
            }
            for column in 0..texture.columns {
                let dx = (column as f64 + 0.5) * crate::table::DIRT_CELL - hx - x;
                let falloff = 1.0 - (dx * dx + dy * dy) / (radius * radius);
                if falloff > 0.0 {
                    let cell = &mut texture.cells[row * texture.columns + column];
                    *cell = (*cell).max((strength * falloff.sqrt()) as u8);
                }
            }
        }
    }
    texture
}
