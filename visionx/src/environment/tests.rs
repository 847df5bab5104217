use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use armarium_values::distance_from_box;
use armarium_values::random::StandardNormal;
use nalgebra::{Translation3, UnitQuaternion};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::scenes::{CALIBRATION, Thing, frame_with_depth, root_from_left, table};

fn block(x: f64, y: f64, top: f64, size: [f64; 3]) -> Thing {
    let root_from_block = Isometry3::translation(x, y, top - size[2] / 2.0);
    Thing::Block { root_from_block, size: Vector3::from(size), color: [90, 90, 95] }
}

/// Frames of a scene, 15 a second, with the noise of a depth camera.
fn frames(things: &[Thing], from: u64, count: u64) -> Vec<StereoFrame> {
    let still = frame_with_depth(things, 0, 1);
    let noisy = |n: u64| {
        let mut rng = ChaCha8Rng::seed_from_u64(n);
        let mut frame = StereoFrame { stamp_ns: n * 66_000_000, ..still.clone() };
        for z in Arc::make_mut(frame.depth.as_mut().unwrap()).data.iter_mut().filter(|z| **z > 0.0) {
            *z += (0.0014 * f64::from(*z).powi(2) * rng.sample::<f64, _>(StandardNormal)) as f32;
        }
        frame
    };
    (from..from + count).map(noisy).collect()
}

/// The same for a head that is turned by so much to the left, and up from where it looks down at a table, rad.
fn turned_frames(things: &[Thing], (left, up): (f64, f64), from: u64, count: u64) -> Vec<StereoFrame> {
    let straight = root_from_left();
    let pitch = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), up);
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), left);
    let root_from_left = Isometry3::from_parts(straight.translation, yaw * straight.rotation * pitch);
    // What it sees is what a head that is not turned sees of things that are turned the other way.
    let turned = straight * root_from_left.inverse();
    let moved = |thing: &Thing| match thing.clone() {
        Thing::Ball { center, radius, color } => Thing::Ball { center: turned * center, radius, color },
        Thing::Block { root_from_block, size, color } => {
            Thing::Block { root_from_block: turned * root_from_block, size, color }
        }
    };
    let things: Vec<Thing> = things.iter().map(moved).collect();
    frames(&things, from, count).into_iter().map(|frame| StereoFrame { root_from_left, ..frame }).collect()
}

fn seen(model: &mut EnvironmentModel, frames: &[StereoFrame]) -> Vec<SurfaceEstimate> {
    frames.iter().for_each(|frame| assert!(model.update(frame, &[])));
    model.surfaces()
}

fn one<'s>(surfaces: &'s [SurfaceEstimate], class: &str) -> &'s SurfaceEstimate {
    let of: Vec<&SurfaceEstimate> = surfaces.iter().filter(|s| s.class == class).collect();
    assert_eq!(of.len(), 1, "{surfaces:?}");
    of[0]
}

#[test]
fn a_table_is_known_once_with_its_height_and_tilt() {
    let things = [table([150, 115, 80]), block(0.2, 0.5, 1.0, [0.1, 0.1, 0.1])];
    let mut model = EnvironmentModel::new(CALIBRATION.camera);
    let surfaces = seen(&mut model, &frames(&things, 0, 20));
    let table = one(&surfaces, "table");
    let up = table.root_from_surface.rotation * Vector3::z();
    assert!(up.angle(&Vector3::z()) < 0.003, "{up}");
    assert!((table.root_from_surface.translation.z - 0.90).abs() < 0.001);
    assert!((table.size[1] - 0.7).abs() < 0.05, "{:?}", table.size);
    assert!(table.probability > 0.99 && table.name == "table");
    let sigma = table.covariance[(0, 0)].sqrt();
    assert!((1e-4..2e-3).contains(&sigma), "{sigma}");
    assert!(!model.update(&StereoFrame { depth: None, ..frames(&[], 30, 1).swap_remove(0) }, &[]));
}

#[test]
fn what_is_taken_away_fades_within_three_seconds_of_being_looked_at() {
    let mut model = EnvironmentModel::new(CALIBRATION.camera);
    let floor = || block(0.0, 0.0, 0.0, [6.0, 6.0, 0.1]);
    let before = seen(&mut model, &frames(&[table([150, 115, 80]), floor()], 0, 20));
    assert_eq!(one(&before, "table").name, "table");
    // It stands 0.4 m lower now.
    let lower = Thing::Block {
        root_from_block: Isometry3::translation(0.25, 0.6, 0.48),
        size: Vector3::new(1.0, 0.7, 0.04),
        color: [150, 115, 80],
    };
    let after = seen(&mut model, &frames(&[lower, floor()], 20, 45));
    let gone = after.iter().find(|s| s.name == "table");
    assert!(gone.is_none_or(|s| s.probability == 0.0), "{gone:?}");
    let there: Vec<_> = after.iter().filter(|s| s.class == "table" && s.probability > 0.5).collect();
    assert_eq!(there.len(), 1);
    assert!((there[0].root_from_surface.translation.z - 0.5).abs() < 0.002);
    // A hand that is held before it hides it, and does not speak against it.
    let hand = Thing::Ball { center: Point3::new(0.1, 0.35, 1.3), radius: 0.2, color: [200, 150, 130] };
    let lower = Thing::Block {
        root_from_block: Isometry3::translation(0.25, 0.6, 0.48),
        size: Vector3::new(1.0, 0.7, 0.04),
        color: [150, 115, 80],
    };
    let hidden = seen(&mut model, &frames(&[lower, floor(), hand], 65, 45));
    assert!(hidden.iter().any(|s| s.name == there[0].name && s.probability > 0.9));
}

#[test]
fn what_is_remembered_is_found_again_under_its_name() {
    let mut model = EnvironmentModel::new(CALIBRATION.camera);
    let mut known = seen(&mut model, &frames(&[table([150, 115, 80])], 0, 20));
    // The camera's mounting was known less well the day before.
    for surface in &mut known {
        surface.root_from_surface = Translation3::new(0.0, 0.0, 0.01) * surface.root_from_surface;
        surface.name = "the_table".into();
    }
    let nowhere = SurfaceEstimate { covariance: Matrix3::repeat(f64::NAN), ..known[0].clone() };
    let floating = SurfaceEstimate {
        name: "table_9".into(),
        root_from_surface: Isometry3::from_parts(
            Translation3::new(0.25, 0.5, 1.2),
            UnitQuaternion::identity(),
        ),
        ..known[0].clone()
    };
    known.extend([nowhere, floating]);
    let mut again = EnvironmentModel::new(CALIBRATION.camera).remembering(known, Vec::new());
    let surfaces = seen(&mut again, &frames(&[table([150, 115, 80])], 1000, 20));
    let there: Vec<_> = surfaces.iter().filter(|s| s.probability > 0.5).collect();
    assert_eq!(there.len(), 1, "{there:?}");
    assert_eq!(there[0].name, "the_table");
    assert!((there[0].root_from_surface.translation.z - 0.90).abs() < 0.003);
}

#[test]
fn a_corner_of_the_room_is_two_walls_and_no_third_across_it() {
    let walls = [block(0.0, 2.65, 2.5, [6.0, 0.1, 2.5]), block(-2.05, 0.0, 2.5, [0.1, 6.0, 2.5])];
    let mut model = EnvironmentModel::new(CALIBRATION.camera);
    let mut surfaces = Vec::new();
    for (i, left) in [-0.2, 0.15, 0.45, 0.75, 1.1, 0.6].into_iter().enumerate() {
        surfaces = seen(&mut model, &turned_frames(&walls, (left, 0.65), 20 * i as u64, 20));
    }
    for surface in surfaces.iter().filter(|surface| surface.probability > 0.5) {
        let normal = surface.root_from_surface * Vector3::z();
        let off = normal.angle(&-Vector3::y()).min(normal.angle(&Vector3::x()));
        assert!(off < 0.05, "{off}: {surface:?}");
    }
    assert_eq!(surfaces.iter().filter(|surface| surface.class == "wall").count(), 2, "{surfaces:?}");
}

#[test]
fn parts_of_the_floor_beside_something_are_one_floor() {
    let parts = [block(-0.9, 1.6, 0.0, [1.2, 2.4, 0.1]), block(0.9, 1.6, 0.0, [1.2, 2.4, 0.1])];
    let mut model = EnvironmentModel::new(CALIBRATION.camera);
    let mut surfaces = Vec::new();
    for (i, left) in [0.6, -0.6].into_iter().enumerate() {
        surfaces = seen(&mut model, &turned_frames(&parts, (left, 0.2), 20 * i as u64, 20));
    }
    let floor = one(&surfaces, "floor");
    assert!(floor.size[0] > 2.5, "{floor:?}");
}

#[test]
fn what_is_solid_and_no_surface_is_a_bulk_until_it_is_gone() {
    let ball = Thing::Ball { center: Point3::new(-0.2, 1.2, 0.9), radius: 0.25, color: [60, 120, 60] };
    let things = |with: bool| -> Vec<Thing> {
        let wall = block(0.0, 2.4, 2.5, [6.0, 0.1, 2.5]);
        let room = [table([150, 115, 80]), block(0.0, 1.0, 0.0, [4.0, 4.0, 0.1]), wall];
        room.into_iter().chain(with.then(|| ball.clone())).collect()
    };
    let mut model = EnvironmentModel::new(CALIBRATION.camera);
    let view = (0.3, 0.1);
    seen(&mut model, &turned_frames(&things(true), view, 0, 20));
    let bulks = model.bulks();
    assert_eq!(bulks.len(), 1, "{bulks:?}");
    // Only what faces the eye, above the table's edge, is seen.
    let off = distance_from_box(&Point3::new(-0.2, 1.2, 0.9), &bulks[0].root_from_box, &bulks[0].size);
    assert!(off < 0.2, "{off} {bulks:?}");
    assert!(bulks[0].size.iter().all(|edge| (0.05..=0.7).contains(edge)), "{:?}", bulks[0].size);
    assert!(bulks[0].probability > 0.85 && bulks[0].name == "bulk");

    let mut again = EnvironmentModel::new(CALIBRATION.camera).remembering(Vec::new(), bulks);
    seen(&mut again, &turned_frames(&things(false), view, 20, 45));
    assert!(again.bulks().iter().all(|bulk| bulk.probability == 0.0), "it fades in 3 s");

    // In a robot that has turned since, it is where it was.
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
    let root_from_box = Isometry3::from_parts(Vector3::new(-0.95, 0.25, 0.85).into(), quarter);
    let before = BulkEstimate {
        name: "bulk_3".into(),
        root_from_box,
        size: Vector3::new(0.6, 0.2, 0.4),
        covariance: Matrix3::identity(),
        probability: 0.9,
    };
    let turned = EnvironmentModel::new(CALIBRATION.camera).remembering(Vec::new(), vec![before]).bulks();
    assert_eq!(turned[0].name, "bulk_3");
    assert!((turned[0].size - Vector3::new(0.2, 0.6, 0.4)).norm() < 1e-9, "{turned:?}");
    let moved = turned[0].root_from_box.translation.vector - Vector3::new(-0.95, 0.25, 0.85);
    assert!(moved.norm() < 1e-9, "{moved}");

    // The robot's own body is none.
    let own = OwnPart { root_from_box: Isometry3::translation(-0.2, 1.2, 0.9), size: Vector3::repeat(0.5) };
    let mut model = EnvironmentModel::new(CALIBRATION.camera);
    turned_frames(&things(true), view, 0, 20).iter().for_each(|frame| assert!(model.update(frame, &[own])));
    assert_eq!(model.bulks(), []);
}
