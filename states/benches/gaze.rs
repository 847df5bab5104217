//! The duration of a choice of where to look, with the neck's inverse kinematics: `cargo bench -p armarium-states`. 20 ms are asked.

#![allow(clippy::unwrap_used, missing_docs, reason = "a bench that cannot go on says where")]

use armarium_motion::{GazeConfig, GazeSelection, GazeStrategy, GazeTarget};
use armarium_robot::{Gaze, Kinematics, Model};
use divan::Bencher;
use nalgebra::{Point3, Unit, Vector3};

fn main() {
    divan::main();
}

/// Things around a middle (root frame, m), all of which are needed; so many views hold several of them.
fn things(count: usize, eye: &Point3<f64>, middle: Vector3<f64>) -> Vec<GazeTarget> {
    let thing = |i: usize| {
        let (sin, cos) = libm::sincos(i as f64 * 2.4);
        let place = Point3::from(middle + Vector3::new(cos, sin, 0.2 * sin) * (0.1 + 0.02 * i as f64));
        let direction = Unit::new_normalize(place - eye);
        GazeTarget { name: format!("thing{i}"), direction, need: 0.9 - 0.01 * i as f64, weight: 1.0 }
    };
    (0..count).map(thing).collect()
}

/// Of 4 and of 100 things, on the table or beside the robot, where the neck does not reach all of them.
#[divan::bench(args = [(4, false), (100, false), (4, true), (100, true)])]
fn choice(bencher: Bencher, (count, beside): (usize, bool)) {
    let model = Model::shipped("armar3").unwrap();
    let gaze = Gaze::of(&model).unwrap();
    let left = model.camera().unwrap().left;
    let start = model.start().to_vec();
    let look = |q: &[f64]| {
        let mut kinematics = Kinematics::new(&model);
        kinematics.update(q);
        let pose = *kinematics.pose(left);
        (Point3::from(pose.translation.vector), Unit::new_unchecked(pose.rotation * Vector3::z()))
    };
    let (eye, axis) = look(&start);
    let middle = if beside { Vector3::new(1.2, -0.1, 1.3) } else { Vector3::new(0.1, 0.6, 1.0) };
    let targets = things(count, &eye, middle);
    bencher.bench_local(|| {
        let mut selection = GazeSelection::new(GazeConfig::default(), GazeStrategy::Saliency).unwrap();
        selection.choose(0.01, &axis, &targets, |direction| {
            let q = gaze.look_at(&model, &start, &(eye + direction.into_inner()));
            look(&q.unwrap_or_else(|error| error.nearest)).1
        })
    });
}
