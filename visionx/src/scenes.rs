//! Images for this room's tests: balls, boxes and hands made of balls over a table, ray cast for both cameras.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use armarium_values::random::StandardNormal;
use async_trait::async_trait;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::camera::{PinholeCamera, StereoCalibration};
use crate::frame::{DepthImage, ImageError, RgbImage, SharedImage, StereoFrame};
use crate::image_source::ImageSource;
use crate::tracking::hand::Gesture;

pub(crate) const CALIBRATION: StereoCalibration = StereoCalibration {
    camera: PinholeCamera { width: 640, height: 480, focal: 515.0, center: [320.0, 240.0] },
    baseline: 0.093,
};
pub(crate) const SKIN: [u8; 3] = [224, 172, 138];
pub(crate) const TABLE: [u8; 3] = [150, 115, 80];

/// Sends a frame `frames` times, one every 66 ms, stamped 0, 1, 2 ...; the one with the number `spoilt` cannot be read.
pub(crate) struct TestCamera {
    frame: StereoFrame,
    frames: u64,
    spoilt: Option<u64>,
    given: AtomicU64,
}

impl TestCamera {
    /// With black images.
    pub(crate) fn new(frames: u64, spoilt: Option<u64>) -> Arc<Self> {
        Self::of(empty_frames().swap_remove(0), frames, spoilt)
    }

    pub(crate) fn of(frame: StereoFrame, frames: u64, spoilt: Option<u64>) -> Arc<Self> {
        Arc::new(Self { frame, frames, spoilt, given: AtomicU64::new(0) })
    }
}

#[async_trait]
impl ImageSource for TestCamera {
    fn name(&self) -> &str {
        "camera"
    }

    fn calibration(&self) -> StereoCalibration {
        CALIBRATION
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        tokio::time::sleep(Duration::from_millis(66)).await;
        let stamp_ns = self.given.fetch_add(1, Ordering::Relaxed);
        let provider = "camera".to_owned();
        match stamp_ns {
            at if at >= self.frames => Err(ImageError::Gone { provider }),
            at if Some(at) == self.spoilt => Err(ImageError::Spoilt { provider, what: "nothing".into() }),
            _ => Ok(Arc::new(StereoFrame { stamp_ns, ..self.frame.clone() })),
        }
    }
}

/// An object in the root frame.
#[derive(Clone)]
pub(crate) enum Thing {
    Ball { center: Point3<f64>, radius: f64, color: [u8; 3] },
    Block { root_from_block: Isometry3<f64>, size: Vector3<f64>, color: [u8; 3] },
}

/// The left camera's pose in a robot's head that looks down at a table.
pub(crate) fn root_from_left() -> Isometry3<f64> {
    let eye = Vector3::new(-0.0465, 0.245, 1.65);
    let z = (Vector3::new(0.25, 0.55, 0.95) - eye).normalize();
    let x = z.cross(&Vector3::z()).normalize();
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    Isometry3::from_parts(eye.into(), UnitQuaternion::from_rotation_matrix(&axes))
}

pub(crate) fn table(color: [u8; 3]) -> Thing {
    let root_from_block = Isometry3::translation(0.25, 0.6, 0.88);
    Thing::Block { root_from_block, size: Vector3::new(1.0, 0.7, 0.04), color }
}

/// A frame with sensor noise of two grey levels, without depth.
pub(crate) fn frame(things: &[Thing], stamp_ns: u64, seed: u64) -> StereoFrame {
    StereoFrame { depth: None, ..frame_with_depth(things, stamp_ns, seed) }
}

/// A frame with sensor noise of two grey levels and exact depth.
pub(crate) fn frame_with_depth(things: &[Thing], stamp_ns: u64, seed: u64) -> StereoFrame {
    let root_from_left = root_from_left();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let [(left, depth), (right, _)] =
        [0.0, CALIBRATION.baseline].map(|shift| cast(things, &root_from_left, shift, &mut rng));
    let (left, right, depth) = (left.into(), right.into(), Some(Arc::new(depth)));
    StereoFrame { stamp_ns, left, right, depth, root_from_left }
}

/// Frames with nothing to detect: black, white, noise, and images of the wrong size.
pub(crate) fn empty_frames() -> Vec<StereoFrame> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let flat = |level| RgbImage::painted(640, 480, |_, _| [level; 3]);
    let noise = RgbImage::painted(640, 480, |_, _| rng.random());
    let small = [1, 0].map(|side| RgbImage::painted(side, side, |_, _| [200, 150, 120]));
    let eyes = [flat(0), flat(255), noise].into_iter().chain(small);
    let root_from_left = root_from_left();
    let frame = |(eye, i): (RgbImage, u64)| {
        let (left, right) = (SharedImage::from(eye.clone()), eye.into());
        StereoFrame { stamp_ns: i * 66_000_000, left, right, depth: None, root_from_left }
    };
    eyes.zip(0..).map(frame).collect()
}

fn cast(
    things: &[Thing],
    root_from_left: &Isometry3<f64>,
    shift: f64,
    rng: &mut ChaCha8Rng,
) -> (RgbImage, DepthImage) {
    let camera = CALIBRATION.camera;
    let root_from_camera = root_from_left * Isometry3::translation(shift, 0.0, 0.0);
    let (w, h) = (camera.width as usize, camera.height as usize);
    let mut depths = vec![f64::MAX; w * h];
    let mut colors = vec![[105.0, 108.0, 104.0]; w * h];
    for thing in things {
        let camera_from_root = root_from_camera.inverse();
        for y in 0..h {
            for x in columns(thing, &camera_from_root, y as f64) {
                let ray = camera.ray(&nalgebra::Point2::new(x as f64, y as f64));
                let Some((z, brightness, color)) = thing.hit(&camera_from_root, &ray) else { continue };
                if z < depths[y * w + x] {
                    depths[y * w + x] = z;
                    colors[y * w + x] = color.map(|c| f64::from(c) * brightness);
                }
            }
        }
    }
    let mut noisy = |c: f64| (c + 2.0 * rng.sample::<f64, _>(StandardNormal)).round().clamp(0.0, 255.0) as u8;
    let data = colors.into_iter().flatten().map(&mut noisy).collect();
    let measured = |z: f64| if z < f64::MAX { z as f32 } else { 0.0 };
    let depth = DepthImage {
        width: camera.width,
        height: camera.height,
        data: depths.into_iter().map(measured).collect(),
    };
    (RgbImage::from_rgb(camera.width, camera.height, data).unwrap(), depth)
}

/// The columns of a row in which an object can be visible.
fn columns(thing: &Thing, camera_from_root: &Isometry3<f64>, y: f64) -> std::ops::Range<usize> {
    let camera = CALIBRATION.camera;
    let Thing::Ball { center, radius, .. } = thing else { return 0..camera.width as usize };
    let c = camera_from_root * center;
    let Some(px) = camera.project(&c) else { return 0..0 };
    let reach = 1.3 * radius * camera.focal / c.z + 2.0;
    if (px.y - y).abs() > reach {
        return 0..0;
    }
    (px.x - reach).max(0.0) as usize..((px.x + reach).max(0.0) as usize).min(camera.width as usize)
}

impl Thing {
    /// Depth, brightness and colour where a ray (camera frame, z = 1) hits the object.
    fn hit(&self, camera_from_root: &Isometry3<f64>, ray: &Vector3<f64>) -> Option<(f64, f64, [u8; 3])> {
        let light = camera_from_root * Vector3::new(-0.35, -0.3, 0.9).normalize();
        let shade = |normal: Vector3<f64>| 0.55 + 0.45 * normal.dot(&light).max(0.0);
        match self {
            Self::Ball { center, radius, color } => {
                let c = (camera_from_root * center).coords;
                let (a, b) = (ray.norm_squared(), ray.dot(&c));
                let root = b * b - a * (c.norm_squared() - radius * radius);
                let t = (b - (root >= 0.0).then(|| root.sqrt())?) / a;
                Some((t, shade((ray * t - c) / *radius), *color))
            }
            Self::Block { root_from_block, size, color } => {
                let block_from_camera = (camera_from_root * root_from_block).inverse();
                let (o, d) = (block_from_camera.translation.vector, block_from_camera * ray);
                let (mut near, mut far, mut axis) = (0.0, f64::MAX, 0);
                for i in 0..3 {
                    let [a, b] = [-0.5, 0.5].map(|s| (s * size[i] - o[i]) / d[i]);
                    if a.min(b) > near {
                        (near, axis) = (a.min(b), i);
                    }
                    far = f64::min(far, a.max(b));
                }
                let normal = Vector3::ith(axis, -d[axis].signum());
                (near < far && near > 0.0)
                    .then(|| (near, shade(block_from_camera.inverse() * normal), *color))
            }
        }
    }
}

/// A hand over the table that shows its palm or its back to the left camera. `roll`: direction of the fingers in the
/// image, rad from the image's x. Fingers are rows of balls. Also returns the direction of the index finger in the
/// left camera's frame.
pub(crate) fn hand(
    gesture: Gesture,
    center: Point3<f64>,
    roll: f64,
    back: bool,
    tilt: f64,
) -> (Vec<Thing>, Vector3<f64>) {
    let x = Vector3::new(0.0, 0.0, if back { 1.0 } else { -1.0 });
    let z = Vector3::new(libm::cos(roll), libm::sin(roll), 0.0);
    let facing = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    let rotation = Rotation3::from_axis_angle(&Vector3::y_axis(), tilt) * facing;
    let left_from_hand = Isometry3::from_parts(center.coords.into(), rotation.into());
    let root_from_hand = root_from_left() * left_from_hand;
    let mut things = Vec::new();
    let mut rod = |from: Vector3<f64>, to: Vector3<f64>, radius: f64| {
        let n = ((to - from).norm() / 0.003).ceil() as usize + 1;
        for i in 0..=n {
            let center = root_from_hand * Point3::from(from + (to - from) * (i as f64 / n as f64));
            things.push(Thing::Ball { center, radius, color: SKIN });
        }
    };
    let stretched = match gesture {
        Gesture::Fist => [false; 5],
        Gesture::OpenHand => [true; 5],
        Gesture::PointOne => [false, true, false, false, false],
        Gesture::PointTwo => [false, true, true, false, false],
    };
    for (i, y) in [0.03, 0.01, -0.01, -0.03].into_iter().enumerate() {
        let knuckle = Vector3::new(0.0, y, 0.04);
        rod(Vector3::new(0.0, 0.7 * y, -0.07), knuckle, 0.0135);
        let spread = if gesture == Gesture::PointOne { 0.0 } else { 7.0 * y };
        let along = Vector3::new(0.0, libm::sin(spread), libm::cos(spread));
        if stretched[i + 1] {
            rod(knuckle, knuckle + along * 0.085, 0.009);
        } else {
            rod(knuckle, knuckle + Vector3::new(0.03, 0.0, 0.005), 0.0095);
            rod(knuckle + Vector3::new(0.03, 0.0, 0.005), knuckle + Vector3::new(0.03, 0.0, -0.02), 0.009);
        }
    }
    let root = Vector3::new(0.005, 0.025, -0.03);
    let end = if stretched[0] { Vector3::new(0.01, 0.095, 0.04) } else { Vector3::new(0.035, 0.0, 0.03) };
    rod(root, end, 0.011);
    (things, rotation * Vector3::z())
}
