//! The stereo pairs of robots and other agents: draw both images of a scene, add noise, and publish the frames.
//!
//! A frame is drawn only when it is due and a reader waits for it. The robot computes its cameras' pose from its
//! joint angles; the true pose differs by the world's mounting error.

mod agents;
mod distant;
mod drawing;
#[cfg(test)]
mod gestures;
#[cfg(test)]
mod people_tests;

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use armarium_robot::{Kinematics, LinkId, newest};
use armarium_values::random::StandardNormal;
use armarium_visionx::{
    DepthImage, ImageError, ImageSource, PinholeCamera, RgbImage, SharedImage, StereoCalibration, StereoFrame,
};
use async_trait::async_trait;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::coach::HandShown;
use crate::render::hand::{HandPose, SLEEVE, hand_shapes, landmarks};
use crate::render::{
    DepthSensor, ExposureMotion, Rendering, SensorNoise, ShadowedScene, Shape, Viewpoint, VisibleScene,
    depth_of_shapes,
};
use crate::start::RobotStart;
use crate::truth::FrameTruth;
use crate::world::{CameraSpec, Faults, ImageFault, World};

pub(crate) use agents::AgentEyes;
pub use drawing::Moment;
pub(crate) use drawing::{Drawing, RobotJoints, SceneState};

pub use distant::{DistantCameras, Scenery, SceneryError, ScenerySink};

pub use drawing::{SceneShapes, TOOL_HALF};
/// Where the coach takes the eyes of a robot without cameras to be, root frame, m.
const NO_CAMERA: Point3<f64> = Point3::new(0.0, 0.0, 1.6);
/// Most frames that are on their way at the same time; at 120 Hz, a second has as many.
const MAX_ON_THEIR_WAY: usize = 150;
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

/// A stereo pair: when its next frame is due, its sensors' errors, and what is on its way.
struct StereoRig {
    source: Arc<SimulatedCameras>,
    period_s: f64,
    /// Number of frames that were due.
    next_frame: u64,
    noise: SensorNoise,
    depth: Option<DepthSensor>,
    /// The camera's clock less the robot's, and the standard deviation of its stamps, s.
    stamps_s: [f64; 2],
    /// Mean and standard deviation of the time until a frame arrives, s.
    latency_s: [f64; 2],
    /// The share of frames that never arrive.
    dropped: f64,
    rng: ChaCha8Rng,
    /// The frames that were taken and have not arrived yet, with the time at which they do, ns, in the order of that.
    on_their_way: VecDeque<(u64, StereoFrame)>,
}

impl StereoRig {
    fn new(
        name: &str,
        calibration: StereoCalibration,
        spec: &CameraSpec,
        (rate, noise): (f64, SensorNoise),
        mut rng: ChaCha8Rng,
    ) -> Self {
        // Without an offset nothing is drawn, so that other errors are the same.
        let offset = match spec.stamp_offset {
            0.0 => 0.0,
            most => most * (2.0 * rng.random::<f64>() - 1.0),
        };
        Self {
            stamps_s: [offset, spec.stamp_jitter],
            source: Arc::new(SimulatedCameras::new(name, calibration)),
            period_s: 1.0 / rate,
            next_frame: 0,
            depth: spec.depth.as_ref().map(|depth| DepthSensor::new(depth, noise.seed())),
            noise,
            latency_s: [spec.latency, spec.jitter],
            dropped: spec.dropped,
            rng,
            on_their_way: VecDeque::new(),
        }
    }

    /// By how much the stamp of the present frame is wrong, s: the same for everybody who draws it.
    fn stamp_error(&self) -> f64 {
        let [offset, deviation] = self.stamps_s;
        let mut rng =
            ChaCha8Rng::seed_from_u64(self.noise.seed() ^ 0x57a3_b000 ^ self.next_frame.rotate_left(32));
        // No stamp comes before that of the frame before.
        let most = 0.4 * self.period_s;
        offset + (deviation * rng.sample::<f64, _>(StandardNormal)).clamp(-most, most)
    }

    /// The stamp of the present frame, which is exposed at `exposed_ns`.
    fn stamp(&self, exposed_ns: u64) -> u64 {
        exposed_ns.saturating_add_signed((self.stamp_error() * 1e9) as i64)
    }

    /// Sends a frame that was exposed at `exposed_ns` on its way, unless it is lost. No frame overtakes another.
    fn send(&mut self, exposed_ns: u64, frame: StereoFrame) {
        let [mean, deviation] = self.latency_s;
        let late = (mean + deviation * self.rng.sample::<f64, _>(StandardNormal)).max(0.0);
        if self.rng.random::<f64>() < self.dropped {
            return;
        }
        let last = self.on_their_way.back().map_or(0, |(at, _)| *at);
        let arrives = (exposed_ns + (late * 1e9) as u64).max(last);
        if self.on_their_way.len() < MAX_ON_THEIR_WAY {
            self.on_their_way.push_back((arrives, frame));
        }
    }

    /// Publishes the frames that have arrived by `now_ns`.
    fn deliver(&mut self, now_ns: u64) {
        while self.on_their_way.front().is_some_and(|(arrives, _)| *arrives <= now_ns)
            && let Some((_, frame)) = self.on_their_way.pop_front()
        {
            self.source.publish(frame);
        }
    }

    /// Whether a frame will be due at `t` s.
    fn will_be_due(&self, t: f64) -> bool {
        t + 1e-9 >= self.next_frame as f64 * self.period_s
    }

    /// Whether a frame is due at `t` s; it is so once.
    fn is_due(&mut self, t: f64) -> bool {
        let due = self.will_be_due(t);
        if due {
            self.next_frame = ((t + 1e-9) / self.period_s).floor() as u64 + 1;
        }
        due
    }

    fn left_and_right(&self, (scene_from_left, motion): (Isometry3<f64>, ExposureMotion)) -> [Viewpoint; 2] {
        let StereoCalibration { camera, baseline } = self.source.calibration;
        let left = Viewpoint { scene_from_camera: scene_from_left, motion, camera };
        [left, left.shifted_right(baseline)]
    }

    /// The frame of what was drawn, with the sensors' errors.
    fn sensed(&self, drawn: StereoRendering, exposed_ns: u64, root_from_left: Isometry3<f64>) -> StereoFrame {
        let StereoRendering { left: Rendering { image: mut left, depth }, scene, right } = drawn;
        self.noise.apply(&mut left, self.next_frame, 0);
        let (noise, number) = (self.noise.clone(), self.next_frame);
        let PinholeCamera { width, height, focal, .. } = self.source.calibration.camera;
        let right = SharedImage::later(width, height, move || {
            let mut image = scene.render(&right).image;
            noise.apply(&mut image, number, 1);
            image
        });
        let depth = self.depth.as_ref().map(|sensor| Arc::new(sensor.sense(depth, focal, number)));
        StereoFrame { stamp_ns: self.stamp(exposed_ns), left: left.into(), right, depth, root_from_left }
    }
}

/// What the left eye sees, without noise, and what the right one will see when somebody looks at it.
pub(crate) struct StereoRendering {
    left: Rendering,
    scene: Arc<ShadowedScene>,
    right: Viewpoint,
}

impl StereoRendering {
    fn of(scene: &Arc<ShadowedScene>, [left, right]: [Viewpoint; 2]) -> Self {
        Self { left: scene.render(&left), scene: Arc::clone(scene), right }
    }
}

/// A unit vector of any direction.
fn direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let any = Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
    any.try_normalize(1e-9).unwrap_or_else(Vector3::x)
}

/// The eyes of a robot: its stereo pair, where it truly is, and where the robot believes it to be.
pub(crate) struct Eyes {
    rig: StereoRig,
    /// Which of the scene's robots they are of.
    robot: usize,
    belief: Kinematics,
    /// The link of the left camera, if the robot has cameras.
    left: Option<LinkId>,
    believed_from_true: Isometry3<f64>,
    faults: Faults,
    last: Option<StereoFrame>,
}

impl Eyes {
    /// The cameras of a world's robot, by its number. A robot without cameras gives no frames.
    pub(crate) fn new(world: &World, robot: usize, start: &RobotStart, seed: u64) -> Self {
        let model = &start.model;
        let spec = &world.camera;
        let (width, height, focal) = (spec.width, spec.height, spec.focal);
        let center = [f64::from(width) / 2.0, f64::from(height) / 2.0];
        let camera = PinholeCamera { width, height, focal, center };
        let calibration = StereoCalibration { camera, baseline: spec.baseline };
        let noise = SensorNoise::new(spec.noise, seed ^ (robot as u64).rotate_left(48));
        let error = &spec.mounting_error;
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x00ca_3e7a ^ (robot as u64).rotate_left(40));
        let shift = Vector3::from(error.position) + direction(&mut rng) * error.distance;
        let turn = Vector3::from(error.rotation_deg) + direction(&mut rng) * error.angle_deg;
        let turn = UnitQuaternion::from_scaled_axis(turn.map(f64::to_radians));
        let believed_from_true = Isometry3::from_parts(shift.into(), turn);
        let name = if robot == 0 { SimulatedCameras::NAME } else { &start.name };
        Self {
            rig: StereoRig::new(name, calibration, spec, (spec.rate, noise), rng),
            robot,
            belief: Kinematics::new(model),
            left: model.camera().map(|camera| camera.left),
            believed_from_true,
            faults: world.faults.clone(),
            last: None,
        }
    }

    pub(crate) fn source(&self) -> &Arc<SimulatedCameras> {
        &self.rig.source
    }

    /// Whether a frame is due at `t` s and a reader waits for it, here or in another process.
    pub(crate) fn due(&mut self, t: f64, elsewhere: bool) -> bool {
        self.rig.is_due(t) && self.left.is_some() && (elsewhere || self.rig.source.wanted())
    }

    /// Whether a frame will be due at `t` s.
    pub(crate) fn will_be_due(&self, t: f64) -> bool {
        self.rig.will_be_due(t)
    }

    /// Draws a frame of a scene and publishes it. Returns the truth about it.
    pub(crate) fn draw(
        &mut self,
        drawing: &Drawing,
        scene: &Arc<ShadowedScene>,
        view: &SceneState<'_>,
    ) -> FrameTruth {
        let (drawn, truth) = self.paint(drawing, scene, view);
        let frame = self.sensed(view, drawn);
        self.rig.send(view.exposed_ns, frame);
        self.rig.deliver(view.exposed_ns);
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

    /// What both eyes see, without noise, and the truth about it.
    pub(crate) fn paint(
        &self,
        drawing: &Drawing,
        scene: &Arc<ShadowedScene>,
        view: &SceneState<'_>,
    ) -> (StereoRendering, FrameTruth) {
        let [before, true_left] =
            drawing.links(self.robot, self.left).map(|left| left * self.believed_from_true);
        let motion = ExposureMotion::between(&before, &true_left, drawing.exposure());
        let [left, right] = self.rig.left_and_right((true_left, motion));
        let drawn = StereoRendering::of(scene, [left, right]);
        let visible = view.coach.hand.is_some_and(|hand| {
            let alone = VisibleScene::new(skin(&hand));
            let in_one = |eye, depth| whole(&hand, eye, depth, &depth_of_shapes(&alone, eye));
            in_one(&left, &drawn.left.depth) && in_one(&right, &scene.depth_of_shapes(&right))
        });
        let truth = FrameTruth {
            stamp_ns: self.rig.stamp(view.exposed_ns),
            gesture: view.coach.hand.map(|h| h.gesture),
            since_s: view.coach.hand.map_or(view.without_hand_s, |h| h.shown_s),
            visible,
            root_from_left: left.scene_from_camera,
        };
        (drawn, truth)
    }

    /// Adds the sensors' noise and faults.
    fn sensed(&mut self, view: &SceneState<'_>, drawn: StereoRendering) -> StereoFrame {
        self.belief.update(view.robots[self.robot].sensed);
        let root_from_left =
            self.left.map_or_else(|| Translation3::from(NO_CAMERA).into(), |left| *self.belief.pose(left));
        let mut frame = self.rig.sensed(drawn, view.exposed_ns, root_from_left);
        if !self.faults.at(view.exposed_ns as f64 * 1e-9) {
            return frame;
        }
        match self.faults.images {
            ImageFault::None => frame,
            ImageFault::Black => {
                let (width, height) = (frame.left.width(), frame.left.height());
                let black = SharedImage::from(RgbImage::painted(width, height, |_, _| [0; 3]));
                let depth = frame.depth.map(|_| DepthImage {
                    width,
                    height,
                    data: vec![0.0; width as usize * height as usize],
                });
                StereoFrame { left: black.clone(), right: black, depth: depth.map(Arc::new), ..frame }
            }
            ImageFault::Swapped => {
                std::mem::swap(&mut frame.left, &mut frame.right);
                frame
            }
            ImageFault::Frozen => {
                let StereoFrame { stamp_ns, root_from_left, .. } = frame;
                StereoFrame { stamp_ns, root_from_left, ..self.last.get_or_insert(frame).clone() }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_err_by_an_offset_and_a_jitter_and_never_go_back() {
        let world = World::default();
        let start = &crate::start::robots(&world, 1, None).unwrap()[0];
        let mut offsets = Vec::new();
        for seed in 1..=40 {
            let mut eyes = Eyes::new(&world, 0, start, seed);
            let (mut errors, mut before) = (Vec::new(), 0);
            for frame in 1..=200 {
                let exposed_ns = frame * 66_000_000;
                eyes.rig.next_frame = frame;
                let stamp = eyes.rig.stamp(exposed_ns);
                assert!(stamp > before && stamp == eyes.rig.stamp(exposed_ns));
                before = stamp;
                errors.push((stamp as f64 - exposed_ns as f64) * 1e-9);
            }
            let count = errors.len() as f64;
            let mean = errors.iter().sum::<f64>() / count;
            let deviation = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count).sqrt();
            assert!((deviation - 0.002).abs() < 4e-4, "{deviation} s");
            offsets.push(mean);
        }
        assert!(offsets.iter().all(|offset| offset.abs() < 0.0035), "{offsets:?}");
        assert!(
            offsets.iter().any(|offset| *offset > 0.001) && offsets.iter().any(|offset| *offset < -0.001)
        );
        let mut hasty = World::default();
        (hasty.camera.stamp_jitter, hasty.camera.rate) = (0.1, 15.0);
        let mut eyes = Eyes::new(&hasty, 0, start, 1);
        let mut before = 0;
        for frame in 10..200 {
            eyes.rig.next_frame = frame;
            let stamp = eyes.rig.stamp(frame * 66_666_667);
            assert!(stamp > before, "{frame}");
            before = stamp;
        }
        let ideal = World::ideal();
        let eyes = Eyes::new(&ideal, 0, start, 1);
        assert_eq!(eyes.rig.stamp(1234), 1234);
    }
}
