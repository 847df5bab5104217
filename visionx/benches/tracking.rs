//! How long the image processors take for a stereo frame of 640 x 480, and for a photograph, on one thread:
//! `cargo bench -p armarium-visionx --bench tracking`.
//!
//! The stereo frame is flat: a brown table with a hand, a green ball and a yellow box painted at their disparities. The
//! photograph is one of those of the tests.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]
#![allow(clippy::print_stdout, reason = "a program for people")]

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use armarium_visionx::files::read_image;
use armarium_visionx::tracking::{
    FingerTipSettings, FingerTipTracking, HandDetector, LearnedHandDetector, SkinHandDetector,
};
use armarium_visionx::{
    BodyObserver, ColorMarkerObjectTracking, ColorModel, DepthImage, HandObserver, HandStep, MarkerStep,
    ObjectLocalizer, PinholeCamera, RgbImage, StereoCalibration, StereoFrame, StereoStep,
    TabletopSegmentation, TabletopStep,
};
use nalgebra::{Isometry3, Point2, Vector2, Vector3};

const CALIBRATION: StereoCalibration = StereoCalibration {
    camera: PinholeCamera { width: 640, height: 480, focal: 515.0, center: [320.0, 240.0] },
    baseline: 0.093,
};
/// Depth of all painted things, m.
const DEPTH: f64 = 0.7;
const FRAMES: u32 = 100;
const STEREO: &str = "a stereo frame";

/// The colour at a place of the painted plane, m from the left camera's axis.
fn paint(at: Vector2<f64>) -> [f64; 3] {
    let rod = |from: [f64; 2], to: [f64; 2], radius: f64| {
        let (a, b) = (Vector2::from(from), Vector2::from(to));
        let t = ((at - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
        (at - a - (b - a) * t).norm() < radius
    };
    let fingers = (0..5).map(|i| -0.5 + 0.35 * f64::from(i));
    let mut hand = fingers
        .map(|a: f64| rod([-0.1, 0.05], [-0.1 + 0.13 * libm::sin(a), 0.05 - 0.13 * libm::cos(a)], 0.009));
    if hand.any(|on| on) || rod([-0.1, 0.05], [-0.1, 0.06], 0.04) {
        [224.0, 172.0, 138.0]
    } else if (at - Vector2::new(0.1, -0.1)).norm() < 0.03 {
        [40.0, 170.0, 60.0]
    } else if (at.x - 0.1).abs() < 0.05 && (at.y - 0.08).abs() < 0.035 {
        [240.0, 210.0, 40.0]
    } else {
        [150.0, 115.0, 80.0]
    }
}

fn eye(shift: f64, seed: u64) -> RgbImage {
    let camera = CALIBRATION.camera;
    let mut state = seed;
    let mut noise = || {
        // Linear congruential noise is good enough here.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as f64 / f64::from(1u32 << 31) * 7.0 - 3.5
    };
    RgbImage::painted(camera.width, camera.height, |x, y| {
        let ray = camera.ray(&Point2::new(f64::from(x), f64::from(y)));
        let color = paint(ray.xy() * DEPTH + Vector2::new(shift, 0.0));
        color.map(|c| (c + noise()).round() as u8)
    })
}

fn measure(name: &str, of: &str, mut step: impl FnMut(u32) -> bool) {
    let mut seen = 0;
    let start = Instant::now();
    for i in 0..FRAMES {
        seen += u32::from(step(i));
    }
    let each = start.elapsed().as_secs_f64() * 1e3 / f64::from(FRAMES);
    println!("{name:<28} {each:6.2} ms {of}, seen in {seen} of {FRAMES}");
}

fn main() -> Result<(), Box<dyn Error>> {
    let root_from_left = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let mut frame = StereoFrame {
        stamp_ns: 0,
        left: eye(0.0, 1).into(),
        right: eye(CALIBRATION.baseline, 2).into(),
        depth: None,
        root_from_left,
    };
    let color = ColorModel::from_rgb([40, 170, 60]);
    measure("colour segmentation", STEREO, |_| {
        [&frame.left, &frame.right].iter().all(|eye| color.segment(eye).count() > 0)
    });
    let mut tracking = ColorMarkerObjectTracking::new(CALIBRATION, [40, 170, 60], None, 1);
    measure("marker tracking", STEREO, |i| {
        frame.stamp_ns = u64::from(i) * 66_000_000;
        tracking.update(&frame, None).is_some()
    });
    let mut observer = HandObserver::new(CALIBRATION);
    measure("hand, gesture, fingertips", STEREO, |i| {
        frame.stamp_ns = u64::from(i) * 66_000_000;
        observer.update(&frame).is_some()
    });
    let mut tips = FingerTipTracking::new(CALIBRATION, FingerTipSettings::default());
    measure("fingertip tracking", STEREO, |i| {
        frame.stamp_ns = u64::from(i) * 66_000_000;
        tips.update(&frame).len() == 5
    });
    let photograph =
        read_image(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/photographs/b03_open_hand.jpg")))?;
    let detectors: [(&str, Box<dyn HandDetector>); 3] = [
        ("hand by skin", Box::new(SkinHandDetector::default())),
        ("hand, learned", Box::new(LearnedHandDetector::of_images())),
        ("hand, learned, followed", Box::new(LearnedHandDetector::of_sequence())),
    ];
    for (name, mut detector) in detectors {
        measure(name, "a photograph of 480 x 640", |_| detector.find(&photograph).is_some());
    }
    let localizer = ObjectLocalizer::new(CALIBRATION, [0.10, 0.07, 0.04], [240, 210, 40]);
    measure("object localisation", STEREO, |_| localizer.localize(&frame).is_some());
    // The plane is a level table under cameras that look down on it.
    frame.root_from_left.translation.z = 1.0 + DEPTH;
    let (width, height) = (CALIBRATION.camera.width, CALIBRATION.camera.height);
    let data = vec![DEPTH as f32; width as usize * height as usize];
    frame.depth = Some(Arc::new(DepthImage { width, height, data }));
    let marker = ColorMarkerObjectTracking::new(CALIBRATION, [40, 170, 60], None, 1);
    let mut together: Vec<Box<dyn StereoStep>> = vec![
        Box::new(HandStep::new(HandObserver::new(CALIBRATION))),
        Box::new(MarkerStep::new(marker, "marker")),
        Box::new(TabletopStep::new(TabletopSegmentation::new(CALIBRATION.camera))),
    ];
    let mut people = BodyObserver::new(CALIBRATION);
    measure("people, where nobody is", STEREO, |_| people.update(&frame, &[]).is_none());
    measure("hand, marker, table together", STEREO, |i| {
        frame.stamp_ns = u64::from(i) * 66_000_000;
        together.step(&frame).len() >= 3
    });
    Ok(())
}
