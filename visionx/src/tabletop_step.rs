//! The table with what is on it, and the floor, as processing steps: what one picture shows by itself.

use armarium_values::Observation;

use crate::annotate;
use crate::camera::PinholeCamera;
use crate::frame::{RgbImage, StereoFrame};
use crate::providers::RawFrame;
use crate::steps::{OBJECTS, StereoStep, level_seen, posed};
use crate::tabletop::{TableObject, Tabletop, TabletopSegmentation};

/// Confidence of an object on a table after one observation.
const THING: f64 = 0.8;
/// Class of the objects on a table of which nothing else is known.
const THING_CLASS: &str = "thing";

/// A table as `EnvironmentModels/.../table`, and what is on it as `ObjectInstances` of class `thing`.
pub struct TabletopStep {
    segmentation: TabletopSegmentation,
    last: Option<Tabletop>,
}

impl TabletopStep {
    /// The step around a segmentation.
    pub fn new(segmentation: TabletopSegmentation) -> Self {
        Self { segmentation, last: None }
    }
}

impl StereoStep for TabletopStep {
    fn name(&self) -> &str {
        "tabletop"
    }

    fn missing_input(&self, frame: &RawFrame) -> Option<String> {
        self.segmentation.missing_input(frame)
    }

    fn looks_for(&self) -> Vec<(String, String)> {
        vec![(OBJECTS.into(), THING_CLASS.into())]
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        self.last = self.segmentation.segment(frame);
        let Some(Tabletop { table, objects }) = &self.last else { return Vec::new() };
        let things = objects.iter().map(|object| thing(object, frame.stamp_ns));
        [level_seen("table", table, frame.stamp_ns)].into_iter().chain(things).collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        let objects = self.last.iter().flat_map(|seen| &seen.objects);
        objects.for_each(|object| annotate::region(image, &object.bounding_box, [255, 0, 255]));
    }
}

/// The floor as each picture shows it by itself, as `EnvironmentModels/.../floor`.
pub struct FloorStep {
    segmentation: TabletopSegmentation,
}

impl FloorStep {
    /// The step for depth images of this camera.
    pub fn new(camera: PinholeCamera) -> Self {
        Self { segmentation: TabletopSegmentation::new(camera) }
    }
}

impl StereoStep for FloorStep {
    fn name(&self) -> &str {
        "floor"
    }

    fn missing_input(&self, frame: &RawFrame) -> Option<String> {
        self.segmentation.missing_input(frame)
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        let floor = self.segmentation.floor(frame);
        floor.map(|floor| level_seen("floor", &floor, frame.stamp_ns)).into_iter().collect()
    }

    fn draw(&self, _image: &mut RgbImage) {}
}

fn thing(object: &TableObject, stamp_ns: u64) -> Observation {
    let color: Vec<f64> = object.color.iter().map(|c| f64::from(*c)).collect();
    posed((OBJECTS, THING_CLASS), stamp_ns, &object.root_from_object, &object.covariance)
        .with_confidence(THING)
        .with("size", object.size.as_slice().to_vec())
        .with("color", color)
}
