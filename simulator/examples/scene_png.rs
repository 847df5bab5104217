//! Draws a table with a sponge, the robot and the coach's hand in every gesture, as seen by the robot's left eye,
//! and prints the time per picture: `cargo run --release -p armarium-simulator --example scene_png -- DIRECTORY`.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use armarium_robot::description::default_robot;
use armarium_robot::{Kinematics, Model};
use armarium_simulator::render::hand::{HandPose, hand_shapes};
use armarium_simulator::render::robot::robot_shapes;
use armarium_simulator::render::{
    Bump, DirtTexture, ExposureMotion, SensorNoise, Shape, Viewpoint, VisibleForm, VisibleScene, render,
};
use armarium_visionx::{Gesture, PinholeCamera, annotate};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

const CAMERA: PinholeCamera = PinholeCamera { width: 640, height: 480, focal: 515.0, center: [319.5, 239.5] };
/// Pictures drawn to measure the speed.
const ROUNDS: u32 = 200;

fn main() -> std::io::Result<()> {
    let directory = std::env::args().nth(1).unwrap_or_else(|| ".".into());
    let directory = Path::new(&directory);
    let robot = looking_down();
    let cameras = robot.model().camera().expect("the robot has cameras");
    let [left, right] = [cameras.left, cameras.right].map(|eye| Viewpoint {
        scene_from_camera: *robot.pose(eye),
        motion: ExposureMotion::default(),
        camera: CAMERA,
    });
    let noise = SensorNoise::new(2.0, 1);

    let scene = |gesture| {
        let shapes = [table(), robot_shapes(&robot, &Isometry3::identity()), hand(gesture)];
        VisibleScene::new(shapes.concat())
    };
    for (number, gesture) in Gesture::ALL.into_iter().enumerate() {
        let scene = scene(gesture);
        let [mut seen, mut other] = [left, right].map(|eye| render(&scene, &eye));
        noise.apply(&mut seen.image, number as u64, 0);
        noise.apply(&mut other.image, number as u64, 1);
        for (eye, image) in [("left", &seen.image), ("right", &other.image)] {
            let png = annotate::png(image).map_err(std::io::Error::other)?;
            std::fs::write(directory.join(format!("scene_{gesture:?}_{eye}.png")), png)?;
        }
    }

    let scene = scene(Gesture::OpenHand);
    let began = Instant::now();
    for frame in 0..ROUNDS {
        let mut seen = render(&scene, &left);
        noise.apply(&mut seen.image, u64::from(frame), 0);
    }
    let one = f64::from(ROUNDS) / began.elapsed().as_secs_f64();
    writeln!(
        std::io::stdout(),
        "{} shapes: {one:.0} pictures/s on one thread, with noise",
        scene.shapes.len()
    )
}

fn table() -> Vec<Shape> {
    let half = Vector3::new(0.5, 0.35, 0.015);
    let mut dirt = DirtTexture::clean(200, 140, [92, 80, 60]);
    for (i, cell) in dirt.cells.iter_mut().enumerate() {
        let [x, y] = [(i % 200) as f64 * 0.005 - 0.5, (i / 200) as f64 * 0.005 - 0.35];
        let (across, along) = ((x - 0.05) / 0.2, (y + 0.03) / 0.14);
        if across * across + along * along < 1.0 {
            *cell = 110 + (i * 37 % 60) as u8;
        }
    }
    let bumps = Arc::from([Bump { at: [0.03, -0.05], height: 0.004, radius: 0.05 }]);
    let pose = |x: f64, y: f64, z: f64, turn: UnitQuaternion<f64>| {
        Isometry3::from_parts(Translation3::new(x, y, z), turn)
    };
    let tilt = UnitQuaternion::from_euler_angles(0.017, -0.026, 0.0);
    let yaw = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.35);
    let mut shapes = vec![
        Shape {
            geometry: VisibleForm::Tabletop { half, bumps, dirt: Some(Arc::new(dirt)) },
            scene_from_shape: pose(0.25, 0.60, 0.935, tilt),
            color: [150, 115, 80],
        },
        Shape {
            geometry: VisibleForm::Box { half: Vector3::new(0.05, 0.035, 0.02) },
            scene_from_shape: pose(0.38, 0.47, 0.973, tilt * yaw),
            color: [240, 210, 40],
        },
    ];
    for [x, y] in [[-0.2, 0.3], [0.7, 0.3], [-0.2, 0.9], [0.7, 0.9]] {
        shapes.push(Shape {
            geometry: VisibleForm::Cylinder { radius: 0.025, half_length: 0.46 },
            scene_from_shape: pose(x, y, 0.46, UnitQuaternion::identity()),
            color: [96, 98, 104],
        });
    }
    shapes
}

/// The robot as it begins, with its eyes on the table.
fn looking_down() -> Kinematics {
    let model = Model::shipped(default_robot()).expect("the program carries it");
    let mut kinematics = Kinematics::new(&model);
    kinematics.update(model.start());
    kinematics
}

/// The hand over the far side of the table, its back up, pointing at the robot.
fn hand(gesture: Gesture) -> Vec<Shape> {
    let axes = Matrix3::from_columns(&[-Vector3::z(), Vector3::x(), -Vector3::y()]);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    hand_shapes(&HandPose::of(gesture), &Isometry3::from_parts(Translation3::new(0.12, 0.66, 1.06), turn))
}
