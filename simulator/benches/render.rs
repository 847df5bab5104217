//! How many pictures of 640 by 480, colour and depth, the renderer draws a second on one core: the default world's table with its
//! objects and a hand, and the same beside a surface of 50 000 triangles.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]
#![expect(clippy::print_stdout, reason = "a bench measures time and prints it")]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use armarium_robot::{Kinematics, Mesh, Model};
use armarium_simulator::render::robot::robot_shapes;
use armarium_simulator::render::{Bump, DirtTexture, Shape, Viewpoint, VisibleForm, VisibleScene, render};
use armarium_visionx::PinholeCamera;
use nalgebra::{Isometry3, Point3, Vector3};

fn main() {
    let camera = PinholeCamera { width: 640, height: 480, focal: 515.0, center: [320.0, 240.0] };
    let eye = Viewpoint::look_at(camera, Vector3::new(0.0, -0.1, 1.6), Vector3::new(0.25, 0.6, 0.95));
    let mut kitchen = VisibleScene::new(robot());
    kitchen.shapes.extend([table(), thing(0.35, 0.5), thing(0.1, 0.7)]);
    let pictures = |scene: &VisibleScene, count: u32| {
        let start = Instant::now();
        (0..count).for_each(|_| drop(black_box(render(black_box(scene), &eye))));
        f64::from(count) / start.elapsed().as_secs_f64()
    };
    println!("{:.0} pictures/s of the kitchen", pictures(&kitchen, 600));
    kitchen.shapes.push(ball(50_000));
    println!("{:.0} pictures/s with 50 000 triangles more", pictures(&kitchen, 200));
}

fn robot() -> Vec<Shape> {
    let model = Arc::new(Model::shipped("armar3").expect("it ships"));
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(model.start());
    robot_shapes(&kinematics, &Isometry3::identity())
}

fn table() -> Shape {
    let bump = Bump { at: [0.03, -0.05], height: 0.004, radius: 0.05 };
    let mut dirt = DirtTexture::clean(200, 140, [90, 60, 40]);
    for (at, cell) in dirt.cells.iter_mut().enumerate() {
        *cell = if at % 7 < 3 { 120 } else { 0 };
    }
    Shape {
        geometry: VisibleForm::Tabletop {
            half: Vector3::new(0.5, 0.35, 0.02),
            bumps: [bump].into(),
            dirt: Some(Arc::new(dirt)),
        },
        scene_from_shape: Isometry3::translation(0.25, 0.6, 0.93),
        color: [150, 115, 80],
    }
}

fn thing(x: f64, y: f64) -> Shape {
    Shape {
        geometry: VisibleForm::Box { half: Vector3::new(0.05, 0.035, 0.02) },
        scene_from_shape: Isometry3::translation(x, y, 0.97),
        color: [240, 210, 40],
    }
}

/// A ball of triangles in front of the camera.
fn ball(triangles: u32) -> Shape {
    let rings = (f64::from(triangles) / 4.0).sqrt() as u32;
    let around = 2 * rings;
    let point = |i: u32, j: u32| {
        let (polar, angle) = (
            std::f64::consts::PI * f64::from(i) / f64::from(rings),
            std::f64::consts::TAU * f64::from(j) / f64::from(around),
        );
        let across = polar.sin();
        Point3::new(across * angle.cos(), across * angle.sin(), polar.cos()) * 0.15
    };
    let vertices = (0..=rings).flat_map(|i| (0..around).map(move |j| point(i, j))).collect();
    let quads = (0..rings).flat_map(|i| (0..around).map(move |j| (i, j)));
    let faces = quads.flat_map(|(i, j)| {
        let at = |i: u32, j: u32| i * around + j % around;
        [[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)]]
    });
    let mesh = Mesh::new(vertices, faces.collect()).expect("the ball is a surface");
    Shape {
        geometry: VisibleForm::Mesh { mesh: Arc::new(mesh) },
        scene_from_shape: Isometry3::translation(0.2, 0.45, 1.15),
        color: [90, 120, 200],
    }
}
