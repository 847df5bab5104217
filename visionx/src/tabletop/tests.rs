use std::sync::Arc;

use armarium_values::random::StandardNormal;
use nalgebra::UnitQuaternion;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::processor::ImageProcessor;
use crate::providers::{ProviderDescription, RawImage, StereoPair, frame_of};
use crate::scenes::{CALIBRATION, Thing, empty_frames, frame_with_depth, table};
use crate::steps::OfStereo;
use crate::tabletop_step::TabletopStep;

const TOP: f64 = 0.90;

fn block(x: f64, y: f64, yaw: f64, size: [f64; 3], color: [u8; 3]) -> Thing {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    let root_from_block = Isometry3::from_parts(Vector3::new(x, y, TOP + size[2] / 2.0).into(), rotation);
    Thing::Block { root_from_block, size: Vector3::from(size), color }
}

fn noisy(mut frame: StereoFrame, deviation: f64) -> StereoFrame {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let depth = Arc::make_mut(frame.depth.as_mut().unwrap());
    for z in depth.data.iter_mut().filter(|z| **z > 0.0) {
        *z += (deviation * rng.sample::<f64, _>(StandardNormal)) as f32;
    }
    frame
}

fn yaw_apart(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(std::f64::consts::PI);
    d.min(std::f64::consts::PI - d)
}

#[test]
fn table_and_things_are_found_with_place_and_size() {
    let things = [
        table([150, 115, 80]),
        block(0.10, 0.50, 0.4, [0.10, 0.06, 0.04], [240, 210, 40]),
        block(0.36, 0.62, -0.7, [0.12, 0.05, 0.15], [40, 60, 200]),
    ];
    for noise in [0.0, 0.001] {
        let frame = noisy(frame_with_depth(&things, 0, 1), noise);
        let seen = TabletopSegmentation::new(CALIBRATION.camera).segment(&frame).unwrap();
        let up = seen.table.root_from_table.rotation * Vector3::z();
        assert!(up.angle(&Vector3::z()) < 0.003, "{up}");
        assert!((seen.table.root_from_table.translation.z - TOP).abs() < 0.001);
        assert!(seen.table.deviation < 0.0015, "{}", seen.table.deviation);
        assert_eq!(seen.objects.len(), 2, "{:?}", seen.objects);
        for (x, y, yaw, size, blue) in
            [(0.10, 0.50, 0.4, [0.10, 0.06, 0.04], false), (0.36, 0.62, -0.7, [0.12, 0.05, 0.15], true)]
        {
            let is_it = |o: &&TableObject| (o.color[2] > o.color[0]) == blue;
            let object = seen.objects.iter().find(is_it).unwrap();
            let middle = object.root_from_object.translation.vector;
            let error = middle - Vector3::new(x, y, TOP + size[2] / 2.0);
            let sigma = object.covariance[(0, 0)].sqrt();
            assert!(error.norm() < 0.006 && error.amax() < 4.0 * sigma, "{error} {sigma}");
            assert!((object.size - Vector3::from(size)).amax() < 0.010, "{:?}", object.size);
            let (_, _, turned) = object.root_from_object.rotation.euler_angles();
            assert!(yaw_apart(turned, yaw) < 0.09, "{turned} {yaw}");
        }
    }
}

#[test]
fn what_the_picture_cuts_is_no_thing() {
    let arm = block(0.25, 0.05, 0.0, [0.08, 1.2, 0.06], [90, 90, 95]);
    let cup = block(0.05, 0.60, 0.0, [0.07, 0.07, 0.09], [200, 40, 40]);
    let frame = frame_with_depth(&[table([150, 115, 80]), arm, cup], 0, 2);
    let seen = TabletopSegmentation::new(CALIBRATION.camera).segment(&frame).unwrap();
    assert_eq!(seen.objects.len(), 1, "{:?}", seen.objects);
    assert!(seen.objects[0].color[0] > 100);
}

#[test]
fn a_left_image_of_another_size_has_no_colours_and_ends_nothing() {
    let cup = block(0.05, 0.60, 0.0, [0.07, 0.07, 0.09], [200, 40, 40]);
    let mut frame = frame_with_depth(&[table([150, 115, 80]), cup], 0, 2);
    frame.left = crate::frame::RgbImage::painted(1, 1, |_, _| [0; 3]).into();
    let seen = TabletopSegmentation::new(CALIBRATION.camera).segment(&frame).unwrap();
    assert_eq!(seen.objects.iter().map(|o| o.color).collect::<Vec<_>>(), [[0; 3]]);
}

#[test]
fn where_there_is_no_table_nothing_is_seen() {
    let segmentation = TabletopSegmentation::new(CALIBRATION.camera);
    for frame in empty_frames() {
        assert_eq!(segmentation.segment(&frame), None);
    }
    let wall = Thing::Block {
        root_from_block: Isometry3::translation(0.25, 1.0, 1.0),
        size: Vector3::new(3.0, 0.1, 3.0),
        color: [200; 3],
    };
    assert_eq!(segmentation.segment(&frame_with_depth(&[wall], 0, 3)), None);
    let mut frame = frame_with_depth(&[table([150, 115, 80])], 0, 4);
    let depth = Arc::make_mut(frame.depth.as_mut().unwrap());
    depth.data.iter_mut().step_by(3).for_each(|z| *z = f32::NAN);
    depth.data.iter_mut().skip(1).step_by(3).for_each(|z| *z = -1.0);
    assert!(segmentation.segment(&frame).is_some_and(|seen| seen.objects.is_empty()));
    depth_of_another_size(&mut frame);
    assert_eq!(segmentation.segment(&frame), None);
}

fn depth_of_another_size(frame: &mut StereoFrame) {
    Arc::make_mut(frame.depth.as_mut().unwrap()).width = 3;
}

#[test]
fn a_frame_without_place_or_depth_is_no_table_but_an_error_that_says_what_is_missing() {
    let stereo = Arc::new(frame_with_depth(&[table([150, 115, 80])], 0, 1));
    let whole = frame_of(&stereo, 1, "camera_left").unwrap();
    let pair = StereoPair::of(&ProviderDescription::of_stereo("eyes", "camera_left", &CALIBRATION)).unwrap();
    let mut tabletop = OfStereo::new(TabletopStep::new(TabletopSegmentation::new(CALIBRATION.camera)), pair);
    let mut asked = |frame: RawFrame| tabletop.process(&[Arc::new(frame)]).map_err(|e| e.to_string());
    let seen = asked(whole.clone()).unwrap();
    assert_eq!(
        (seen.observations[0].segment.as_str(), seen.observations[0].class.as_str()),
        ("EnvironmentModels", "table")
    );

    let nowhere = RawFrame { root_from_camera: None, ..whole.clone() };
    assert!(asked(nowhere).unwrap_err().contains("give `root_from_camera` in the frame's header"));
    let mut flat = whole.clone();
    flat.images.retain(|image| image.role() != "depth");
    assert!(asked(flat).unwrap_err().contains("without depth"));
    let mut small = whole;
    small.images[2] = RawImage::new("depth", PixelFormat::Depth16, (2, 1), vec![9; 4]).unwrap();
    assert!(asked(small).unwrap_err().contains("a depth image of 2 x 1 pixels"));
}

#[test]
fn the_floor_is_found_under_a_table_as_it_seems_to_be_tilted() {
    let tilted = |angle: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle);
        let root_from_block = Isometry3::from_parts(Vector3::new(0.0, 1.0, -0.05).into(), turn);
        Thing::Block { root_from_block, size: Vector3::new(4.0, 4.0, 0.1), color: [120, 120, 120] }
    };
    let segmentation = TabletopSegmentation::new(CALIBRATION.camera);
    for angle in [0.0, 0.02, -0.03] {
        let frame = noisy(frame_with_depth(&[table([150, 115, 80]), tilted(angle)], 0, 1), 0.003);
        let floor = segmentation.floor(&frame).unwrap();
        let (up, true_up) = (
            floor.root_from_table * Vector3::z(),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle) * Vector3::z(),
        );
        assert!(up.angle(&true_up) < 0.002, "{angle}: {up}");
    }
    assert_eq!(segmentation.floor(&frame_with_depth(&[table([150, 115, 80])], 0, 1)), None);
}
