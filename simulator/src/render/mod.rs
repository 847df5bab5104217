//! The simulated cameras: a software renderer for simple solids, in colour and depth.
//!
//! [`render`] draws a [`VisibleScene`] from a [`Viewpoint`]; [`ShadowedScene`] is one that several cameras look at.
//! [`SensorNoise`] adds the sensor's noise. [`hand`] is the coach's hand, [`robot`] the robot.
//!
//! The renderer has no physics, no time and no random source: the same scene gives the same bytes. It does not draw
//! glass, mirrors or light from other objects, and it does not smooth edges: a pixel shows what the ray through its
//! centre meets first, so that both cameras agree to a fraction of a pixel. Start reading at [`render`], then
//! `raster`.

mod depth;
mod exposure;
mod faces;
pub mod hand;
mod noise;
mod raster;
pub mod robot;
mod scene;
mod shading;
mod shadow;
mod solids;
mod tabletop;
#[cfg(test)]
mod tests;

use armarium_visionx::DepthImage;
use nalgebra::{Isometry3, Vector3};

pub use depth::DepthSensor;
use exposure::Exposure;
pub use noise::SensorNoise;
use raster::Canvas;
pub use scene::{
    Background, Bump, DirtTexture, ExposureMotion, Rendering, Shape, Viewpoint, VisibleForm, VisibleScene,
};
use shading::{Light, Shades};
use shadow::Shadow;

/// Number of pixels of the largest picture.
const MAX_PIXELS: u64 = 1 << 27;

/// Draws a scene as a camera sees it.
///
/// Depth is along the optical axis, m. The picture is empty if the camera has no pixels, if its pose or intrinsics
/// are not finite, or if it is outside the room and looks away from everything. For a camera of more than 2^27
/// pixels, the picture has no pixels. Shapes with a size or pose that is not finite are left out, as is everything
/// nearer than 1 cm or behind the camera.
pub fn render(scene: &VisibleScene, viewpoint: &Viewpoint) -> Rendering {
    draw(scene, &shadows(scene), viewpoint, true)
}

/// The depth of a scene's shapes without the room and without tabletops: 0 where there is none.
pub fn depth_of_shapes(scene: &VisibleScene, viewpoint: &Viewpoint) -> DepthImage {
    let shadows: Vec<_> = scene.shapes.iter().map(|_| None).collect();
    draw(scene, &shadows, viewpoint, false).depth
}

/// A scene with its shadows, which are the same for all cameras.
pub struct ShadowedScene {
    scene: VisibleScene,
    shadows: Vec<Option<Shadow>>,
}

impl ShadowedScene {
    /// Computes the shadows of a scene.
    pub fn new(scene: VisibleScene) -> Self {
        Self { shadows: shadows(&scene), scene }
    }

    /// As [`depth_of_shapes`].
    pub fn depth_of_shapes(&self, viewpoint: &Viewpoint) -> DepthImage {
        depth_of_shapes(&self.scene, viewpoint)
    }

    /// As [`render`].
    pub fn render(&self, viewpoint: &Viewpoint) -> Rendering {
        draw(&self.scene, &self.shadows, viewpoint, true)
    }
}

/// The shadows on each tabletop, by the index of its shape.
fn shadows(scene: &VisibleScene) -> Vec<Option<Shadow>> {
    let is_table =
        |shape: &Shape| matches!(shape.geometry, VisibleForm::Tabletop { .. }) && is_drawable(shape);
    let indexed = scene.shapes.iter().enumerate();
    indexed.map(|(i, shape)| is_table(shape).then(|| Shadow::on(scene, i))).collect()
}

fn draw(scene: &VisibleScene, shadows: &[Option<Shadow>], viewpoint: &Viewpoint, room: bool) -> Rendering {
    let mut camera = viewpoint.camera;
    if u64::from(camera.width) * u64::from(camera.height) > MAX_PIXELS {
        (camera.width, camera.height) = (0, 0);
    }
    let canvas = Canvas::new(camera, scene.background.wall);
    let sound = camera.focal > 0.0 && camera.focal.is_finite() && camera.center.iter().all(|c| c.is_finite());
    if sound && is_finite(&viewpoint.scene_from_camera) && canvas.bounds().is_some() {
        return Exposure::new(&canvas, scene, shadows, viewpoint, room).draw(canvas);
    }
    canvas.finish()
}

/// The shapes that can be drawn: the nearest first, so that few pixels are painted twice; tabletops last, as they
/// are large.
fn nearest_first(scene: &VisibleScene, camera_from_scene: &Isometry3<f64>) -> Vec<usize> {
    let key = |index: &usize| {
        let shape = &scene.shapes[*index];
        let center = camera_from_scene * shape.scene_from_shape.translation.vector;
        let distance = (camera_from_scene.translation.vector + center).norm() - reach(&shape.geometry);
        (matches!(shape.geometry, VisibleForm::Tabletop { .. }), distance)
    };
    let mut order: Vec<_> = (0..scene.shapes.len()).filter(|&i| is_drawable(&scene.shapes[i])).collect();
    order.sort_by(|a, b| {
        let (a, b) = (key(a), key(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    order
}

fn draw_shape(
    canvas: &mut Canvas,
    shape: &Shape,
    shadow: Option<&Shadow>,
    camera_from_shape: Isometry3<f64>,
    light: Light,
) {
    let shades = Shades::new(shape.color);
    let axial = |radius: f64, half_length: f64| solids::Axial { radius, half_length, camera_from_shape };
    match &shape.geometry {
        VisibleForm::Box { half } => faces::cuboid(canvas, &camera_from_shape, half, light, &shades),
        VisibleForm::Sphere { radius } => {
            solids::ball(canvas, &camera_from_shape.translation.vector, *radius, light, &shades);
        }
        VisibleForm::Cylinder { radius, half_length } => {
            solids::cylinder(canvas, &axial(*radius, *half_length), light, &shades);
        }
        VisibleForm::Capsule { radius, half_length } => {
            solids::capsule(canvas, &axial(*radius, *half_length), light, &shades);
        }
        VisibleForm::Mesh { mesh } => faces::mesh(canvas, &camera_from_shape, mesh, light, &shades),
        VisibleForm::Tabletop { half, bumps, dirt } => {
            let Some(shadow) = shadow else { return };
            let table = tabletop::DrawnTabletop {
                camera_from_shape,
                half: *half,
                bumps,
                dirt: dirt.as_deref(),
                shadow,
            };
            tabletop::tabletop(canvas, &table, light, &shades);
        }
    }
}

/// Largest distance of a form's points from its centre, m.
fn reach(geometry: &VisibleForm) -> f64 {
    match geometry {
        VisibleForm::Box { half } | VisibleForm::Tabletop { half, .. } => half.norm(),
        VisibleForm::Sphere { radius } => *radius,
        VisibleForm::Cylinder { radius, half_length } | VisibleForm::Capsule { radius, half_length } => {
            radius + half_length
        }
        VisibleForm::Mesh { mesh } => mesh
            .bounds()
            .iter()
            .map(|corner| corner.coords.abs())
            .fold(Vector3::zeros(), |a, b| a.sup(&b))
            .norm(),
    }
}

fn is_drawable(shape: &Shape) -> bool {
    let positive = |half: &Vector3<f64>| half.iter().all(|v| *v > 0.0);
    let sound = match &shape.geometry {
        VisibleForm::Box { half } | VisibleForm::Tabletop { half, .. } => positive(half),
        VisibleForm::Sphere { radius } => *radius > 0.0,
        VisibleForm::Cylinder { radius, half_length } => *radius > 0.0 && *half_length > 0.0,
        VisibleForm::Capsule { radius, half_length } => *radius > 0.0 && *half_length >= 0.0,
        VisibleForm::Mesh { .. } => true,
    };
    sound && reach(&shape.geometry).is_finite() && is_finite(&shape.scene_from_shape)
}

fn is_finite(pose: &Isometry3<f64>) -> bool {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    t.iter().chain(q.iter()).all(|v| v.is_finite())
}
