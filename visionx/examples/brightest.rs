//! A processor of one's own: the brightest spot that both eyes see, as an entity `Lights/.../lamp` with its place.
//!
//! `cargo run -p armarium-visionx --example brightest -- FOLDER` processes the pairs of a folder: `NAME_left.png`, `NAME_right.png`, and
//! `calibration.yaml` beside them.

#![allow(clippy::print_stdout, reason = "it shows what it observes")]

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;

use armarium_values::{Frame, Observation, ObservedPlace};
use armarium_visionx::providers::{FileProvider, ImageProvider, Pace, StereoPair};
use armarium_visionx::{
    OfStereo, ProcessorLoop, ProcessorStatistics, ResultSink, RgbImage, Seen, SeenBy, StereoCalibration,
    StereoFrame, StereoStep, Trigger, Workers, annotate, run_processor,
};
use async_trait::async_trait;
use nalgebra::Point2;

/// How well the spot is known in each eye, px.
const HALF_A_PIXEL: f64 = 0.5;

/// The processor.
struct Brightest {
    calibration: StereoCalibration,
    last: Option<Point2<f64>>,
}

/// Where an image is brightest, px.
fn brightest(image: &RgbImage) -> Option<Point2<f64>> {
    let bright = |pixel: &[u8]| pixel.iter().map(|part| u32::from(*part)).sum::<u32>();
    let pixels = image.data().chunks_exact(3).enumerate();
    let (at, _) = pixels.max_by_key(|(_, pixel)| bright(pixel))?;
    let width = image.width() as usize;
    Some(Point2::new((at % width) as f64, (at / width) as f64))
}

impl StereoStep for Brightest {
    fn name(&self) -> &str {
        "brightest"
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        let (left, right) = (brightest(&frame.left), brightest(&frame.right));
        self.last = left;
        let point = left.zip(right).and_then(|(left, right)| self.calibration.triangulate(&left, &right));
        let Some(point) = point else { return Vec::new() };
        let covariance = self.calibration.covariance(&point, [HALF_A_PIXEL; 2]);
        let place = ObservedPlace::new(&Frame::from("camera"), &point.coords, &covariance);
        vec![Observation::new("Lights", "lamp", frame.stamp_ns).at(place)]
    }

    fn draw(&self, image: &mut RgbImage) {
        self.last.iter().for_each(|at| annotate::cross(image, at, 6.0, [255, 0, 255]));
    }
}

/// Prints what is observed.
struct Print;

#[async_trait]
impl ResultSink for Print {
    async fn take(&self, by: &SeenBy, seen: Seen) -> bool {
        for observation in seen.observations {
            println!("{} {}", by.stamp_ns, observation.to_json());
        }
        true
    }
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn Error>> {
    let folders: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let pace = Pace { speed: None, repeat: false };
    let provider = FileProvider::open("files", &folders, 15.0, pace).await;
    let provider = provider.map_err(|(path, error)| format!("{}: {error}", path.display()))?;
    let pair = StereoPair::of(&provider.description())?;
    let step = Brightest { calibration: pair.calibration(), last: None };
    let statistics = ProcessorStatistics::default();
    let with = ProcessorLoop {
        inputs: vec![Arc::new(provider)],
        trigger: Trigger::Next,
        workers: Workers::Threads,
        sink: &Print,
        annotated: None,
        statistics: &statistics,
    };
    // It ends with the last file.
    let _ = run_processor(Box::new(OfStereo::new(step, pair)), &with).await;
    println!("{} frames", statistics.frames.get());
    Ok(())
}
