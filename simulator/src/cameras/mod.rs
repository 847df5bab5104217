//! The stereo pair on the robot's head: builds the scene, draws both images, adds noise, and publishes the frames.
//!
//! A frame is drawn only when it is due and a reader waits for it. The robot computes its cameras' pose from its
//! joint angles; the true pose differs by the world's mounting error.

mod agents;
mod distant;
#[cfg(test)]
mod gestures;

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use armarium_robot::{Kinematics, LinkId, Model, newest};
use armarium_visionx::{
    DepthImage, ImageError, ImageSource, PinholeCamera, RgbImage, StereoCalibration, StereoFrame,
};
use async_trait::async_trait;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::coach::{CoachState, HandShown};
use crate::render::hand::{HandPose, SLEEVE, hand_shapes, landmarks};
use crate::render::{
    DirtTexture, Geometry, Rendering, Scene, SensorNoise, Shape, Viewpoint, depth_of_shapes, render_pair,
    robot,
};
use crate::table::{DirtGrid, THICKNESS, TableTop};
use crate::truth::FrameTruth;
use crate::world::{CoverSpec, ImageFault, World};

pub(crate) use agents::AgentEyes;

pub use distant::{DistantCameras, Scenery, SceneryError, ScenerySink};

/// Half the edges of the coach's tool, m.
pub const TOOL_HALF: Vector3<f64> = Vector3::new(0.045, 0.03, 0.02);
/// Colour of dirt.
const DIRT: [u8; 3] = [104, 92, 84];
/// Radius around the middle of the workspace in which the table is visibly dirty, m.
const DIRTY_RADIUS: f64 = 0.22;
/// Where the coach takes the eyes of a robot without cameras to be, root frame, m.
const NO_CAMERA: Point3<f64> = Point3::new(0.0, 0.0, 1.6);
/// Something is in front of the hand if it is nearer to the camera by more than this, m.
const HIDES: f32 = 0.002;

/// The provider of the simulated frames.
#[derive(Debug)]
pub struct SimulatedCameras {
    name: String,
    calibration: StereoCalibration,
    newest: newest::Sender<Feed>,
    waiting: AtomicUsize,
}

#[derive(Clone, Debug, Default)]
struct Feed {
    frame: Option<Arc<StereoFrame>>,
    gone: bool,
}

/// Counts one waiting reader until it is dropped.
struct Waiting<'a>(&'a AtomicUsize);

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl SimulatedCameras {
    const NAME: &'static str = "head_stereo";

    fn new(name: &str, calibration: StereoCalibration) -> Self {
        let newest = newest::Sender::new(Feed::default());
        Self { name: name.into(), calibration, newest, waiting: AtomicUsize::new(0) }
    }

    fn wanted(&self) -> bool {
        self.waiting.load(Ordering::Relaxed) > 0
    }

    fn publish(&self, frame: StereoFrame) {
        self.newest.send(Feed { frame: Some(Arc::new(frame)), ..self.newest.borrow() });
    }

    /// Wakes all waiting readers: no further frame will come.
    pub(crate) fn close(&self) {
        self.newest.send(Feed { gone: true, ..self.newest.borrow() });
    }

    fn gone(&self) -> ImageError {
        ImageError::Gone { provider: self.name.clone() }
    }
}

#[async_trait]
impl ImageSource for SimulatedCameras {
    fn name(&self) -> &str {
        &self.name
    }

    fn calibration(&self) -> StereoCalibration {
        self.calibration
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let mut newest = self.newest.subscribe();
        if newest.borrow_and_update().gone {
            return Err(self.gone());
        }
        self.waiting.fetch_add(1, Ordering::Relaxed);
        let _waiting = Waiting(&self.waiting);
        newest.changed().await.map_err(|_| self.gone())?;
        let feed = newest.borrow();
        match &feed.frame {
            Some(frame) if !feed.gone => Ok(Arc::clone(frame)),
            _ => Err(self.gone()),
        }
    }
}

/// A stereo pair: when its next frame is due, and its sensors' noise.
struct StereoRig {
    source: Arc<SimulatedCameras>,
    period_s: f64,
    /// Number of frames that were due.
    next_frame: u64,
    noise: SensorNoise,
    latency_ns: u64,
    /// The frames that were taken and have not arrived yet: at most one each millisecond of the latency.
    on_their_way: VecDeque<StereoFrame>,
}

impl StereoRig {
    fn new(name: &str, calibration: StereoCalibration, rate: f64, noise: SensorNoise) -> Self {
        let source = Arc::new(SimulatedCameras::new(name, calibration));
        let on_their_way = VecDeque::new();
        Self { source, period_s: 1.0 / rate, next_frame: 0, noise, latency_ns: 0, on_their_way }
    }

    /// Publishes the frames that have arrived by `now_ns`.
    fn deliver(&mut self, now_ns: u64) {
        while self.on_their_way.front().is_some_and(|frame| frame.stamp_ns + self.latency_ns <= now_ns)
            && let Some(frame) = self.on_their_way.pop_front()
        {
            self.source.publish(frame);
        }
    }

    /// Whether a frame is due at `t` s; it is so once.
    fn is_due(&mut self, t: f64) -> bool {
        let due = t + 1e-9 >= self.next_frame as f64 * self.period_s;
        if due {
            self.next_frame = ((t + 1e-9) / self.period_s).floor() as u64 + 1;
        }
        due
    }

    fn left_and_right(&self, scene_from_left: Isometry3<f64>) -> [Viewpoint; 2] {
        let StereoCalibration { camera, baseline } = self.source.calibration;
        let left = Viewpoint { scene_from_camera: scene_from_left, camera };
        [left, left.shifted_right(baseline)]
    }

    /// Left image, right image and left depth, with the sensors' noise.
    fn sensed(&self, drawn: [Rendering; 2]) -> (RgbImage, RgbImage, DepthImage) {
        let [Rendering { image: mut left, depth }, Rendering { image: mut right, .. }] = drawn;
        self.noise.apply(&mut left, self.next_frame, 0);
        self.noise.apply(&mut right, self.next_frame, 1);
        (left, right, depth)
    }
}

/// The state of the scene at one frame.
pub(crate) struct SceneState<'a> {
    pub(crate) stamp_ns: u64,
    pub(crate) true_position: &'a [f64],
    pub(crate) sensed_position: &'a [f64],
    pub(crate) objects: &'a [Isometry3<f64>],
    pub(crate) coach: &'a CoachState,
    /// Time since the last hand was visible, s.
    pub(crate) without_hand_s: f64,
    pub(crate) wiped: &'a DirtGrid,
}

/// The simulator's side of the cameras.
pub(crate) struct Eyes {
    rig: StereoRig,
    truth: Kinematics,
    belief: Kinematics,
    /// The link of the left camera, if the robot has cameras.
    left: Option<LinkId>,
    believed_from_true: Isometry3<f64>,
    fault: (ImageFault, f64),
    last: Option<(RgbImage, RgbImage, DepthImage)>,
    fixed: Vec<Shape>,
    table_half: Vector3<f64>,
    table_pose: Isometry3<f64>,
    table_color: [u8; 3],
    bumps: Arc<[crate::render::Bump]>,
    dirt: Arc<DirtTexture>,
    objects: Vec<(Vector3<f64>, [u8; 3])>,
    tool_color: [u8; 3],
}

impl Eyes {
    /// Builds the cameras of a world. A robot without cameras gives no frames.
    pub(crate) fn new(model: &Arc<Model>, world: &World, table: &TableTop, seed: u64) -> Self {
        let left = model.camera().map(|camera| camera.left);
        let spec = &world.camera;
        let camera = PinholeCamera {
            width: spec.width,
            height: spec.height,
            focal: spec.focal,
            center: [f64::from(spec.width) / 2.0, f64::from(spec.height) / 2.0],
        };
        let calibration = StereoCalibration { camera, baseline: spec.baseline };
        let noise = SensorNoise::new(spec.noise, seed);
        let error = &spec.mounting_error;
        let believed_from_true = Isometry3::from_parts(
            Translation3::from(Vector3::from(error.position)),
            UnitQuaternion::from_scaled_axis(Vector3::from(error.rotation_deg.map(f64::to_radians))),
        );
        let [hx, hy] = table.half();
        let table_half = Vector3::new(hx, hy, THICKNESS / 2.0);
        let rig = StereoRig::new(SimulatedCameras::NAME, calibration, spec.rate, noise);
        Self {
            rig: StereoRig { latency_ns: (spec.latency * 1e9) as u64, ..rig },
            truth: Kinematics::new(model),
            belief: Kinematics::new(model),
            left,
            believed_from_true,
            fault: (world.faults.images, world.faults.from),
            last: None,
            fixed: legs(table).into_iter().chain(world.covers.iter().map(board)).collect(),
            table_half,
            table_pose: table.root_from_top() * Translation3::new(0.0, 0.0, -THICKNESS / 2.0),
            table_color: world.table.color,
            bumps: table.bumps().to_vec().into(),
            dirt: Arc::new(blotches(world, table, seed)),
            objects: world.objects.iter().map(|o| (Vector3::from(o.size) / 2.0, o.color)).collect(),
            tool_color: world.coach.tool.color,
        }
    }

    pub(crate) fn source(&self) -> &Arc<SimulatedCameras> {
        &self.rig.source
    }

    /// Position of the robot's cameras in a posture, m, root frame; where it has none, a place where a head might be.
    pub(crate) fn viewpoint(&mut self, position: &[f64]) -> Point3<f64> {
        self.truth.update(position);
        self.left.map_or(NO_CAMERA, |left| self.truth.pose(left).translation.vector.into())
    }

    /// Whether a frame is due at `t` s and a reader waits for it, here or in another process.
    pub(crate) fn due(&mut self, t: f64, elsewhere: bool) -> bool {
        self.rig.is_due(t) && self.left.is_some() && (elsewhere || self.rig.source.wanted())
    }

    /// Draws a frame and publishes it. Returns the truth about it.
    pub(crate) fn draw(&mut self, view: &SceneState<'_>) -> FrameTruth {
        let (drawn, truth) = self.paint(view);
        let frame = self.sensed(view.stamp_ns, drawn);
        self.rig.on_their_way.push_back(frame);
        self.rig.deliver(view.stamp_ns);
        truth
    }

    /// Publishes the frames that have arrived by `now_ns`.
    pub(crate) fn deliver(&mut self, now_ns: u64) {
        self.rig.deliver(now_ns);
    }

    /// Number of frames that were due.
    pub(crate) fn frame(&self) -> u64 {
        self.rig.next_frame
    }

    /// Renders both images, without noise. Also returns the truth about them.
    pub(crate) fn paint(&mut self, view: &SceneState<'_>) -> ([Rendering; 2], FrameTruth) {
        self.truth.update(view.true_position);
        self.belief.update(view.sensed_position);
        let scene = self.scene(view);
        let [left, right] = self.rig.left_and_right(self.left_pose(&self.truth) * self.believed_from_true);
        let drawn = render_pair(&scene, &[left, right]);
        let visible = view.coach.hand.is_some_and(|hand| {
            let alone = Scene::new(skin(&hand));
            [left, right]
                .iter()
                .zip(&drawn)
                .all(|(eye, drawn)| whole(&hand, eye, &drawn.depth, &depth_of_shapes(&alone, eye)))
        });
        let truth = FrameTruth {
            stamp_ns: view.stamp_ns,
            gesture: view.coach.hand.map(|h| h.gesture),
            since_s: view.coach.hand.map_or(view.without_hand_s, |h| h.shown_s),
            visible,
        };
        (drawn, truth)
    }

    /// Adds the sensors' noise and faults.
    fn sensed(&mut self, stamp_ns: u64, drawn: [Rendering; 2]) -> StereoFrame {
        let mut pictures = self.rig.sensed(drawn);
        let (fault, from) = self.fault;
        if stamp_ns as f64 * 1e-9 >= from {
            match fault {
                ImageFault::None => {}
                ImageFault::Black => {
                    pictures.0.data_mut().fill(0);
                    pictures.1.data_mut().fill(0);
                    pictures.2.data.fill(0.0);
                }
                ImageFault::Swapped => std::mem::swap(&mut pictures.0, &mut pictures.1),
                ImageFault::Frozen => pictures = self.last.get_or_insert(pictures).clone(),
            }
        }
        let root_from_left = self.left_pose(&self.belief);
        let (left, right, depth) = pictures;
        StereoFrame { stamp_ns, left, right, depth: Some(depth), root_from_left }
    }

    fn left_pose(&self, kinematics: &Kinematics) -> Isometry3<f64> {
        self.left.map_or_else(|| Translation3::from(NO_CAMERA).into(), |left| *kinematics.pose(left))
    }

    fn scene(&mut self, view: &SceneState<'_>) -> Scene {
        let mut shapes = robot::robot_shapes(&self.truth, &Isometry3::identity());
        shapes.extend(self.fixed.iter().cloned());
        self.clean(view.wiped);
        shapes.push(Shape {
            geometry: Geometry::Tabletop {
                half: self.table_half,
                bumps: Arc::clone(&self.bumps),
                dirt: Some(Arc::clone(&self.dirt)),
            },
            scene_from_shape: self.table_pose,
            color: self.table_color,
        });
        for ((half, color), pose) in self.objects.iter().zip(view.objects) {
            let geometry = Geometry::Box { half: *half };
            shapes.push(Shape { geometry, scene_from_shape: *pose, color: *color });
        }
        if let Some(pose) = &view.coach.tool {
            shapes.extend(tool(pose, self.tool_color));
        }
        if let Some(hand) = &view.coach.hand {
            shapes.extend(hand_shapes(&HandPose::of(hand.gesture), &hand.root_from_hand));
        }
        Scene::new(shapes)
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

/// The hand without its sleeve.
fn skin(hand: &HandShown) -> Vec<Shape> {
    let mut shapes = hand_shapes(&HandPose::of(hand.gesture), &hand.root_from_hand);
    shapes.retain(|s| s.color != SLEEVE);
    shapes
}

/// Whether the whole hand, from its wrist to its fingertips, is in the picture and at most a hundredth of it is
/// hidden. `alone` is the depth of the hand and its wrist only. What the sleeve covers does not count as the hand.
fn whole(hand: &HandShown, viewpoint: &Viewpoint, picture: &DepthImage, alone: &DepthImage) -> bool {
    let camera_from_hand = viewpoint.scene_from_camera.inverse() * hand.root_from_hand;
    let camera = &viewpoint.camera;
    let (mut farthest, mut wrist) = (0.0f32, f64::MAX);
    let inside = landmarks(&HandPose::of(hand.gesture)).iter().all(|(point, radius)| {
        let p = camera_from_hand * point;
        // Behind the hand there is the floor; beyond the wrist towards the arm, the forearm.
        farthest = farthest.max((p.z + radius) as f32);
        wrist = wrist.min(point.z - radius);
        camera.project(&p).is_some_and(|pixel| {
            let margin = camera.focal * radius / p.z;
            let within = |v: f64, size: u32| v >= margin && v <= f64::from(size) - 1.0 - margin;
            within(pixel.x, camera.width) && within(pixel.y, camera.height)
        })
    });
    // Coordinate of a seen point along the hand: the third row of the hand's pose in the camera, for the ray at
    // depth 1.
    let hand_from_camera = camera_from_hand.inverse();
    let along = hand_from_camera.rotation.to_rotation_matrix().matrix().row(2).transpose();
    let ray = |i: usize| {
        let (x, y) = ((i % camera.width as usize) as f64, (i / camera.width as usize) as f64);
        Vector3::new((x - camera.center[0]) / camera.focal, (y - camera.center[1]) / camera.focal, 1.0)
    };
    let (mut seen, mut hidden) = (0usize, 0usize);
    for (i, (a, b)) in alone.data.iter().zip(&picture.data).enumerate() {
        let near_enough = *a > 0.0 && *a <= farthest;
        if near_enough && along.dot(&ray(i)) * f64::from(*a) + hand_from_camera.translation.z >= wrist {
            seen += 1;
            hidden += usize::from(*b < *a - HIDES);
        }
    }
    inside && seen > 0 && hidden * 100 <= seen
}

fn legs(table: &TableTop) -> Vec<Shape> {
    let [hx, hy] = table.half();
    let mut legs = Vec::new();
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let corner = Point3::new(sx * (hx - 0.05), sy * (hy - 0.05), -THICKNESS);
        let top = table.root_from_top() * corner;
        let half_length = (top.z / 2.0).max(0.01);
        legs.push(Shape {
            geometry: Geometry::Cylinder { radius: 0.02, half_length },
            scene_from_shape: Isometry3::translation(top.x, top.y, half_length),
            color: [90, 90, 94],
        });
    }
    legs
}

fn board(cover: &CoverSpec) -> Shape {
    Shape {
        geometry: Geometry::Box { half: Vector3::from(cover.size) / 2.0 },
        scene_from_shape: cover.root_from_cover(),
        color: cover.color,
    }
}

/// The coach's block on a grey stick.
fn tool(pose: &Isometry3<f64>, color: [u8; 3]) -> [Shape; 2] {
    let along = Vector3::new(0.0, 0.6, 0.8);
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &along).unwrap_or_default();
    let stick = Isometry3::from_parts((along * 0.13).into(), turn);
    [
        Shape { geometry: Geometry::Box { half: TOOL_HALF }, scene_from_shape: *pose, color },
        Shape {
            geometry: Geometry::Cylinder { radius: 0.008, half_length: 0.12 },
            scene_from_shape: pose * stick,
            color: [72, 72, 78],
        },
    ]
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
        let x = middle.x + DIRTY_RADIUS * distance * angle.cos();
        let y = middle.y + DIRTY_RADIUS * distance * angle.sin();
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
