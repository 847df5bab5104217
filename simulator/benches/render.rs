//! How many pictures of 640 by 480, colour and depth, the renderer draws a second on one core: the default world's table with its
//! objects, and the same beside a surface of 50 000 triangles. The machine's own speed is measured in turn with them, by a loop that
//! reads and writes as much memory as a picture has: how many of these loops a picture takes says what the code costs, on a slow
//! day too.

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

/// Each is measured so many times, in turn.
const ROUNDS: usize = 15;
/// Pictures with the fine surface in one measurement.
const PICTURES: u32 = 12;

fn main() {
    let camera = PinholeCamera { width: 640, height: 480, focal: 515.0, center: [320.0, 240.0] };
    let eye = Viewpoint::look_at(camera, Vector3::new(0.0, -0.1, 1.6), Vector3::new(0.25, 0.6, 0.95));
    let mut kitchen = VisibleScene::new(robot());
    kitchen.shapes.extend([table(), thing(0.35, 0.5), thing(0.1, 0.7)]);
    let mut both = kitchen.clone();
    both.shapes.push(ball(50_000));
    let mut seconds = [const { Vec::new() }; 3];
    for _ in 0..ROUNDS {
        seconds[0].push(timed(3 * PICTURES, reference));
        seconds[1].push(timed(3 * PICTURES, || drop(black_box(render(black_box(&kitchen), &eye)))));
        seconds[2].push(timed(PICTURES, || drop(black_box(render(black_box(&both), &eye)))));
    }
    let [reference, kitchen, both] = seconds.map(median);
    let line = |name, picture: f64| {
        println!(
            "{:4.0} pictures/s of {name}, {:.1} reference loops each",
            1.0 / picture,
            picture / reference
        );
    };
    line("the kitchen", kitchen);
    line("the kitchen with 50 000 triangles", both);
    println!("{:4.0} reference loops/s", 1.0 / reference);
}

/// The time that one of some calls takes, s.
fn timed(calls: u32, mut call: impl FnMut()) -> f64 {
    let start = Instant::now();
    (0..calls).for_each(|_| call());
    start.elapsed().as_secs_f64() / f64::from(calls)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Fills the memory of a picture's colours and depths, and reads it.
fn reference() {
    let mut memory = vec![1u8; 640 * 480 * 7];
    let mut last = 0u8;
    for byte in &mut memory {
        last = last.wrapping_mul(5).wrapping_add(*byte);
        *byte = last;
    }
    black_box(memory);
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
        let across = libm::sin(polar);
        Point3::new(across * libm::cos(angle), across * libm::sin(angle), libm::cos(polar)) * 0.15
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
