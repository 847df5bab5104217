//! Simulated hands that move before a stereo camera, with the true positions of their fingertips.
//!
//! A hand is 0.3 to 1.0 m away, moves with at most 0.5 m/s, rotates, and changes its gesture every second. The camera
//! is the robot's: 640 x 480, with noise and a depth image. The truth is used for measuring only.

use std::f64::consts::TAU;
use std::sync::Arc;

use armarium_simulator::render::hand::{HandPose, fingertips, hand_shapes, tip_radius};
use armarium_simulator::render::{SensorNoise, Shape, Viewpoint, VisibleForm, VisibleScene, render};
use armarium_visionx::{Gesture, PinholeCamera, RgbImage, SharedImage, StereoCalibration, StereoFrame};
use nalgebra::{Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The stereo camera.
pub(super) const CALIBRATION: StereoCalibration = StereoCalibration {
    camera: PinholeCamera { width: 640, height: 480, focal: 515.0, center: [319.5, 239.5] },
    baseline: 0.093,
};
/// Frames per second.
pub const RATE_HZ: f64 = 30.0;
/// Frames per gesture, and among them those in which the hand changes to it.
pub(super) const STAYS: u64 = 30;
pub(super) const CHANGES: u64 = 6;
/// How many backgrounds there are.
pub(super) const BACKGROUNDS: u64 = 3;
/// Standard deviation of the camera's noise, grey levels.
const NOISE: f64 = 2.5;
/// Fastest motion of the hand, m/s.
const FASTEST: f64 = 0.5;
/// Nearest and farthest distance, m.
const DISTANCES: (f64, f64) = (0.3, 1.0);

/// A visible fingertip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrueTip {
    /// Finger: 0 is the thumb, 4 the little finger.
    pub(super) finger: usize,
    /// The centre of its round end in the left image, px.
    pub(super) px: Point2<f64>,
    /// The radius of its round end, px.
    pub(super) radius: f64,
}

/// The truth of one frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct HandTruth {
    pub(super) gesture: Gesture,
    /// Frames since the gesture began.
    pub(super) since: u64,
    pub(super) tips: Vec<TrueTip>,
    /// Whether the whole hand is in both images.
    pub(super) whole: bool,
}

/// A hand's motion before a background.
pub(super) struct Stage {
    viewpoints: [Viewpoint; 2],
    background: Vec<Shape>,
    noise: SensorNoise,
    gestures: Vec<Gesture>,
    /// Amplitudes, m and rad, and angular frequencies, rad/s, and phases: across, along, in depth, roll, tilt.
    waves: [[f64; 3]; 5],
    back: bool,
}

impl Stage {
    /// A stage of `seed`, with one of the three backgrounds: a brown wall, a skin-coloured one, a pale one with
    /// objects before it.
    pub(super) fn new(seed: u64, background: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed * BACKGROUNDS + background);
        let camera = CALIBRATION.camera;
        let left = Viewpoint::look_at(camera, Vector3::new(0.0, -0.6, 1.3), Vector3::new(0.0, 0.4, 1.1));
        let mut draw = |low: f64, high: f64| rng.random_range(low..high);
        let phase = |draw: &mut dyn FnMut(f64, f64) -> f64| draw(0.0, TAU);
        let waves = [
            [0.10, draw(0.8, 2.2), phase(&mut draw)],
            [0.06, draw(0.8, 2.2), phase(&mut draw)],
            [(DISTANCES.1 - DISTANCES.0) / 2.0, draw(0.4, 0.8), phase(&mut draw)],
            [0.6, draw(0.5, 1.5), phase(&mut draw)],
            [0.35, draw(0.5, 1.5), phase(&mut draw)],
        ];
        let back = draw(0.0, 1.0) < 0.5;
        let all = [Gesture::OpenHand, Gesture::PointOne, Gesture::PointTwo, Gesture::Fist];
        let start = draw(0.0, 4.0) as usize;
        let gestures = (0..64).map(|i| all[(start + i * if back { 1 } else { 3 }) % 4]).collect();
        Self {
            viewpoints: [left, left.shifted_right(CALIBRATION.baseline)],
            background: scenery(background, &left),
            noise: SensorNoise::new(NOISE, seed),
            gestures,
            waves,
            back,
        }
    }

    /// The hand's pose in the left camera's frame at a time.
    fn hand(&self, t: f64) -> Isometry3<f64> {
        let wave = |i: usize| self.waves[i][0] * libm::sin(self.waves[i][1] * t + self.waves[i][2]);
        let z = (DISTANCES.0 + DISTANCES.1) / 2.0 + wave(2);
        // The closer the hand, the narrower the field of view.
        let room = ((z - 0.25) / 0.4).clamp(0.1, 1.0);
        // Fingers point up in the image, the back or the palm to the camera.
        let base = axes(self.back);
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), wave(3));
        let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), wave(4));
        let place = Translation3::new(wave(0) * room, wave(1) * room + 0.02, z);
        Isometry3::from_parts(place, roll * tilt * base)
    }

    /// The time of a frame: the motion is slowed where it would be too fast.
    fn time(&self, frame: u64) -> f64 {
        let mut fastest: f64 = 0.0;
        for k in 0..400 {
            let at = |t: f64| self.hand(t).translation.vector;
            let t = f64::from(k) * 0.05;
            fastest = fastest.max((at(t + 0.01) - at(t)).norm() / 0.01);
        }
        frame as f64 / RATE_HZ * (FASTEST / fastest).min(1.0)
    }

    fn pose(&self, frame: u64) -> (HandPose, Gesture) {
        let (n, since) = ((frame / STAYS) as usize, frame % STAYS);
        let now = self.gestures[n % self.gestures.len()];
        let before = if n == 0 { now } else { self.gestures[(n - 1) % self.gestures.len()] };
        let share = (since + 1) as f64 / CHANGES as f64;
        (HandPose::blend(&HandPose::of(before), &HandPose::of(now), share), now)
    }

    /// A frame with its truth.
    pub(super) fn frame(&self, number: u64) -> (StereoFrame, HandTruth) {
        let left_from_hand = self.hand(self.time(number));
        let (pose, gesture) = self.pose(number);
        let scene_from_hand = self.viewpoints[0].scene_from_camera * left_from_hand;
        let mut shapes = self.background.clone();
        shapes.extend(hand_shapes(&pose, &scene_from_hand));
        let scene = VisibleScene::new(shapes);
        let [mut left, mut right] = self.viewpoints.map(|eye| render(&scene, &eye));
        self.noise.apply(&mut left.image, number, 0);
        self.noise.apply(&mut right.image, number, 1);
        let seen = |p: &Point3<f64>, shift: f64, border: f64| {
            let px = CALIBRATION.camera.project_shifted(p, shift);
            px.filter(|px| px.x > border && px.y > border && px.x < 639.0 - border && px.y < 479.0 - border)
        };
        let tips = (0..5).filter(|&i| straight(gesture, i)).filter_map(|i| {
            let tip = left_from_hand * fingertips(&pose)[i];
            let radius = CALIBRATION.camera.focal * tip_radius(i) / tip.z;
            let px = seen(&tip, 0.0, radius + 2.0)?;
            let depth = left.depth.data[px.y.round() as usize * 640 + px.x.round() as usize];
            let visible = (f64::from(depth) - (tip.z - tip_radius(i))).abs() < 0.006;
            visible.then_some(TrueTip { finger: i, px, radius })
        });
        let tips: Vec<TrueTip> = tips.collect();
        let marks = armarium_simulator::render::hand::landmarks(&pose);
        let whole = marks.iter().all(|(p, _)| {
            let p = left_from_hand * p;
            seen(&p, 0.0, 4.0).is_some() && seen(&p, CALIBRATION.baseline, 4.0).is_some()
        });
        let frame = StereoFrame {
            stamp_ns: (number as f64 / RATE_HZ * 1e9) as u64,
            left: left.image.into(),
            right: right.image.into(),
            depth: Some(Arc::new(left.depth)),
            root_from_left: Isometry3::identity(),
        };
        (frame, HandTruth { gesture, since: number % STAYS, tips, whole })
    }
}

/// A frame without visible content.
pub(super) fn blackout(frame: &StereoFrame) -> StereoFrame {
    let black = SharedImage::from(RgbImage::painted(frame.left.width(), frame.left.height(), |_, _| [0; 3]));
    StereoFrame { left: black.clone(), right: black, depth: None, ..frame.clone() }
}

/// The hand's axes in the camera frame: its z points up in the image, its x (out of the palm) to the camera or away
/// from it.
fn axes(back: bool) -> UnitQuaternion<f64> {
    let z = -Vector3::y();
    let x = if back { Vector3::z() } else { -Vector3::z() };
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]))
}

fn straight(gesture: Gesture, finger: usize) -> bool {
    match gesture {
        Gesture::Fist => false,
        Gesture::OpenHand => true,
        Gesture::PointOne => finger == 1,
        Gesture::PointTwo => finger == 1 || finger == 2,
    }
}

/// The background objects.
fn scenery(background: u64, camera: &Viewpoint) -> Vec<Shape> {
    let at = |x: f64, y: f64, z: f64| camera.scene_from_camera * Isometry3::translation(x, y, z);
    let wall = |color| Shape {
        geometry: VisibleForm::Box { half: Vector3::new(3.0, 2.5, 0.02) },
        scene_from_shape: at(0.0, 0.0, 1.45),
        color,
    };
    match background {
        0 => vec![wall([150, 115, 80])],
        1 => vec![wall([224, 172, 138])],
        _ => {
            let thing = |x, y, color| Shape {
                geometry: VisibleForm::Box { half: Vector3::new(0.09, 0.12, 0.05) },
                scene_from_shape: at(x, y, 1.35),
                color,
            };
            let ball = Shape {
                geometry: VisibleForm::Sphere { radius: 0.08 },
                scene_from_shape: at(0.1, -0.3, 1.32),
                color: [230, 120, 20],
            };
            vec![
                wall([205, 190, 165]),
                thing(-0.45, 0.2, [200, 40, 40]),
                thing(0.5, 0.1, [180, 140, 100]),
                thing(-0.25, -0.35, [30, 60, 200]),
                ball,
            ]
        }
    }
}
