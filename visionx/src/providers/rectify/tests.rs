//! A wall painted with noise, imaged by distorted and rotated cameras, ray by ray.

use nalgebra::{Isometry3, Point3, Translation3};

use super::*;
use crate::epipolar::EpipolarCheck;
use crate::mask::Region;
use crate::providers::Distortion;

const SIZE: (u32, u32) = (320, 240);
/// The wall's distance from the provider's frame, m.
const WALL: f64 = 1.5;

fn eye(shift: Vector3<f64>, turn: Vector3<f64>, k1: f64, focal: [f64; 2]) -> CameraModel {
    CameraModel {
        focal,
        center: [163.0, 117.0],
        distortion: Distortion { k1, k2: 0.08, p1: 8e-4, p2: -6e-4, k3: 0.0 },
        reference_from_camera: Isometry3::from_parts(
            Translation3::from(shift),
            UnitQuaternion::from_scaled_axis(turn),
        ),
    }
}

/// Two cameras that converge, one rolled and lower than the other, with different focal lengths.
fn eyes() -> [CameraModel; 2] {
    let left = eye(Vector3::zeros(), Vector3::new(0.01, 0.03, -0.02), -0.24, [260.0, 262.0]);
    let right =
        eye(Vector3::new(0.12, 0.008, -0.004), Vector3::new(-0.02, -0.04, 0.025), -0.21, [256.0, 257.0]);
    [left, right]
}

/// The wall's brightness, smooth between the points of a grid of 40 mm.
fn paint(x: f64, y: f64) -> f64 {
    let grid = |i: f64, j: f64| {
        let mut hash =
            (i as i64).wrapping_mul(0x9E37_79B9).wrapping_add((j as i64).wrapping_mul(0x85EB_CA6B));
        hash = (hash ^ (hash >> 15)).wrapping_mul(0x2C1B_3C6D);
        ((hash ^ (hash >> 12)) & 0xff) as f64
    };
    let (u, v) = (x / 0.04, y / 0.04);
    let (i, j) = (u.floor(), v.floor());
    let (a, b) = (u - i, v - j);
    let upper = grid(i, j) * (1.0 - a) + grid(i + 1.0, j) * a;
    let lower = grid(i, j + 1.0) * (1.0 - a) + grid(i + 1.0, j + 1.0) * a;
    upper * (1.0 - b) + lower * b
}

/// The brightness that a ray of the provider's frame hits, and the distance to the wall along it.
fn wall(from: &Point3<f64>, ray: &Vector3<f64>) -> (u8, f64) {
    let t = (WALL - from.z) / ray.z;
    let at = from + ray * t;
    (paint(at.x, at.y).round() as u8, t)
}

fn see(eye: &CameraModel) -> (RgbImage, DepthImage) {
    let mut data = Vec::new();
    let image = RgbImage::painted(SIZE.0, SIZE.1, |x, y| {
        let ray = ray_of(eye, &Point2::new(f64::from(x), f64::from(y))).unwrap();
        let from = Point3::from(eye.reference_from_camera.translation.vector);
        // The ray's z in the camera is 1, so that the length along it is the depth.
        let (value, depth) = wall(&from, &(eye.reference_from_camera.rotation * ray));
        data.push(depth as f32);
        [value; 3]
    });
    (image, DepthImage { width: SIZE.0, height: SIZE.1, data })
}

fn seen() -> StereoFrame {
    let [left, right] = eyes();
    let ((left, depth), (right, _)) = (see(&left), see(&right));
    StereoFrame {
        stamp_ns: 5,
        left: left.into(),
        right: right.into(),
        depth: Some(Arc::new(depth)),
        root_from_left: Isometry3::identity(),
    }
}

#[test]
fn the_ideal_pair_sees_what_its_own_rays_meet() {
    let [left, right] = eyes();
    let rectification = Rectification::new(&left, &right, SIZE).unwrap();
    let rectified = rectification.rectify(&seen()).unwrap();
    let StereoCalibration { camera, baseline } = rectification.calibration();
    let offset = right.reference_from_camera.translation.vector;
    assert!((baseline - offset.norm()).abs() < 1e-12);
    let reference_from_rectified = left.reference_from_camera.rotation * rectification.left_from_rectified;
    // The rectified right camera is at the real one's position.
    assert!((reference_from_rectified * Vector3::x() * baseline - offset).norm() < 1e-12);
    for (eye, image) in [(&left, &rectified.left), (&right, &rectified.right)] {
        let from = Point3::from(eye.reference_from_camera.translation.vector);
        let (mut looked, mut off, mut depth_off) = (0u32, 0.0, 0.0f64);
        for (x, y) in Region::whole(SIZE.0, SIZE.1).pixels() {
            let ray = reference_from_rectified * camera.ray(&Point2::new(f64::from(x), f64::from(y)));
            let (value, depth) = wall(&from, &ray);
            let pixel = image.pixel(x, y);
            if pixel == [0; 3] {
                continue;
            }
            looked += 1;
            off += f64::from(pixel[0].abs_diff(value));
            let given = rectified.depth.as_ref().unwrap().at(x, y);
            if eye == &left && given > 0.0 {
                depth_off = depth_off.max((f64::from(given) - depth).abs());
            }
        }
        assert!(looked > SIZE.0 * SIZE.1 * 8 / 10, "most of the picture is kept: {looked}");
        // Error of interpolating an image that was sampled once before.
        assert!(off / f64::from(looked) < 4.0, "{} grey levels", off / f64::from(looked));
        // The nearest pixel is half a pixel off, on a wall that is nearly upright.
        assert!(depth_off < 2e-3, "{depth_off} m");
    }
}

#[test]
fn rows_agree_afterwards_and_did_not_before() {
    let [left, right] = eyes();
    let rectification = Rectification::new(&left, &right, SIZE).unwrap();
    let calibration = rectification.calibration();
    let rows = |frame: &StereoFrame| {
        let check = EpipolarCheck::of(frame, &calibration);
        let away: Vec<f64> = check.rows_px.iter().map(|row| row.abs()).collect();
        (away.len(), EpipolarCheck::median(&away), EpipolarCheck::median(&check.depth_ratio))
    };
    let (corners, rows_px, depth) = rows(&rectification.rectify(&seen()).unwrap());
    assert!(corners > 40, "one in most cells of the picture: {corners}");
    assert!(rows_px.unwrap() < 0.3, "{rows_px:?}");
    assert!((depth.unwrap() - 1.0).abs() < 0.01, "{depth:?}");
    let (found, before, _) = rows(&seen());
    assert!(found < corners / 2 || before.unwrap() > 0.6, "{found} {before:?}");
}

#[test]
fn an_ideal_pair_stays_as_it_is() {
    let camera = PinholeCamera { width: SIZE.0, height: SIZE.1, focal: 300.0, center: [159.5, 119.5] };
    let (left, right) = (CameraModel::ideal(&camera, 0.0), CameraModel::ideal(&camera, 0.1));
    let rectification = Rectification::new(&left, &right, SIZE).unwrap();
    let calibration = rectification.calibration();
    assert!((calibration.camera.focal - 300.0).abs() < 1e-9 && (calibration.baseline - 0.1).abs() < 1e-12);
    assert!((calibration.camera.center[0] - 159.5).abs() < 1e-9);
    let frame = seen();
    let rectified = rectification.rectify(&frame).unwrap();
    let same = rectified.left.data().iter().zip(frame.left.data()).filter(|(a, b)| a.abs_diff(**b) <= 1);
    // Rounding may put a pixel at the border outside.
    assert!(same.count() > frame.left.data().len() * 98 / 100);
}

#[test]
fn what_is_no_pair_is_refused() {
    let [left, right] = eyes();
    let new =
        |left: &CameraModel, right: &CameraModel, size| Rectification::new(left, right, size).map(|_| ());
    assert!(new(&left, &left, SIZE).is_err(), "one place");
    assert!(new(&right, &left, SIZE).is_err(), "the wrong way round");
    assert!(new(&left, &right, (1, 240)).is_err());
    let mut turned = right;
    turned.reference_from_camera.rotation = UnitQuaternion::from_scaled_axis(Vector3::y() * 1.5);
    assert!(new(&left, &turned, SIZE).is_err(), "looks elsewhere");
    // r - 80 r^3 turns back at r = 1 / sqrt(240) = 0.0645.
    let mut folded = right;
    folded.distortion = Distortion { k1: -80.0, ..Distortion::default() };
    assert!((0.06..0.065).contains(&reach(&folded)));
    let frame = StereoFrame { left: RgbImage::painted(1, 1, |_, _| [0; 3]).into(), ..seen() };
    assert!(Rectification::new(&left, &right, SIZE).unwrap().rectify(&frame).is_none());
}
