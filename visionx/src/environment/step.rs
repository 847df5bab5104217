//! The environment model as a processing step: what it has fused is observed after each picture.

use armarium_values::Observation;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::{BulkEstimate, EnvironmentModel, SurfaceEstimate};
use crate::annotate;
use crate::camera::PinholeCamera;
use crate::frame::{RgbImage, StereoFrame};
use crate::own_part::OwnPart;
use crate::providers::RawFrame;
use crate::steps::{ENVIRONMENT, StereoStep, TABLE, posed};
use crate::tabletop::TabletopSegmentation;

/// Tables, shelves, walls, the floor and bulks, fused over time, as `EnvironmentModels`. What is no longer there is told for some time
/// more, with the confidence 0.
pub struct EnvironmentStep {
    model: EnvironmentModel,
    camera: PinholeCamera,
    root_from_left: Isometry3<f64>,
    own: Box<dyn Fn(u64) -> Vec<OwnPart> + Send>,
    last: Vec<SurfaceEstimate>,
}

impl EnvironmentStep {
    /// The step around a model, for frames of this camera.
    pub fn new(model: EnvironmentModel, camera: PinholeCamera) -> Self {
        let own = Box::new(|_| Vec::new());
        Self { model, camera, root_from_left: Isometry3::identity(), own, last: Vec::new() }
    }

    /// The same for a robot that sees itself; `own` says where the parts of its body were at a time (ns).
    #[must_use]
    pub fn without(self, own: impl Fn(u64) -> Vec<OwnPart> + Send + 'static) -> Self {
        Self { own: Box::new(own), ..self }
    }
}

impl StereoStep for EnvironmentStep {
    fn name(&self) -> &str {
        "environment"
    }

    fn missing_input(&self, frame: &RawFrame) -> Option<String> {
        TabletopSegmentation::new(self.camera).missing_input(frame)
    }

    fn step(&mut self, frame: &StereoFrame) -> Vec<Observation> {
        self.root_from_left = frame.root_from_left;
        self.model.update(frame, &(self.own)(frame.stamp_ns));
        self.last = self.model.surfaces();
        let bulks = self.model.bulks();
        let surfaces = self.last.iter().map(|surface| surface_seen(surface, frame.stamp_ns));
        surfaces.chain(bulks.iter().map(|bulk| bulk_seen(bulk, frame.stamp_ns))).collect()
    }

    fn draw(&self, image: &mut RgbImage) {
        for surface in self.last.iter().filter(|surface| surface.probability > 0.5) {
            let half = surface.size.map(|edge| edge / 2.0);
            let corner = |[x, y]: [f64; 2]| {
                let at = Point3::new(x * half[0], y * half[1], 0.0);
                let in_left = self.root_from_left.inverse() * surface.root_from_surface * at;
                self.camera.project(&in_left).filter(|_| in_left.z > 0.1)
            };
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(corner);
            let corners: Option<Vec<_>> = corners.into_iter().collect();
            annotate::polygon(image, &corners.unwrap_or_default(), [0, 255, 255]);
        }
    }
}

fn surface_seen(surface: &SurfaceEstimate, stamp_ns: u64) -> Observation {
    let pose = &surface.root_from_surface;
    // Along the surface its middle is as certain as its extent.
    let axes = pose.rotation.to_rotation_matrix();
    let spread = Vector3::new(TABLE, TABLE, surface.covariance[(0, 0)].max(1e-9));
    let covariance = axes * Matrix3::from_diagonal(&spread) * axes.transpose();
    let covariance = (covariance + covariance.transpose()) * 0.5;
    posed((ENVIRONMENT, surface.class), stamp_ns, pose, &covariance)
        .named(&surface.name)
        .with_confidence(surface.probability)
        .with("size", [surface.size[0], surface.size[1], 0.0])
        .with("plane_covariance", surface.covariance.transpose().as_slice().to_vec())
}

fn bulk_seen(bulk: &BulkEstimate, stamp_ns: u64) -> Observation {
    posed((ENVIRONMENT, BulkEstimate::CLASS), stamp_ns, &bulk.root_from_box, &bulk.covariance)
        .named(&bulk.name)
        .with_confidence(bulk.probability)
        .with("size", bulk.size.as_slice().to_vec())
}
