//! Bodies without images: lifting, sides over time, and the own body's pixels.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::follower::BodyFollower;
use super::own_body::{own_pixels, without};
use super::{BodyJoint, SeenJoint};
use crate::frame::{DepthImage, RgbImage};
use crate::own_part::OwnPart;
use crate::scenes::CALIBRATION;

/// A person's joints, the arms stretched by `reach` m.
fn joints(reach: f64) -> [Option<SeenJoint>; 7] {
    let at = |joint: BodyJoint| match joint {
        BodyJoint::Head => [0.0, 1.2, 1.6],
        BodyJoint::RightShoulder => [-0.18, 1.2, 1.4],
        BodyJoint::RightElbow => [-0.25, 1.1, 1.15],
        BodyJoint::RightWrist => [-0.25, 1.0 - reach, 1.1],
        BodyJoint::LeftShoulder => [0.18, 1.2, 1.4],
        BodyJoint::LeftElbow => [0.25, 1.1, 1.15],
        BodyJoint::LeftWrist => [0.25, 1.0, 1.1],
    };
    let covariance = Matrix3::identity() * 0.03f64.powi(2);
    BodyJoint::ALL.map(|joint| Some(SeenJoint { at: Point3::from(at(joint)), covariance }))
}

fn exchanged(seen: [Option<SeenJoint>; 7]) -> [Option<SeenJoint>; 7] {
    BodyJoint::ALL.map(|joint| seen[joint.mirrored() as usize])
}

const FRAME_NS: u64 = 66_000_000;

#[test]
fn sides_that_are_exchanged_in_some_frames_are_put_right() {
    let mut follower = BodyFollower::default();
    for frame in 0..60 {
        let seen = joints(0.002 * frame as f64);
        let given = if frame % 7 == 3 { exchanged(seen) } else { seen };
        let known = follower.update(frame * FRAME_NS, given);
        let wrist = BodyJoint::RightWrist as usize;
        assert!((known[wrist].unwrap().at - seen[wrist].unwrap().at).norm() < 0.02, "{frame}");
    }
    // Who was mistaken at first is believed in the end.
    for frame in 60..80 {
        follower.update(frame * FRAME_NS, exchanged(joints(0.12)));
    }
    let known = follower.at(80 * FRAME_NS);
    assert!(known[BodyJoint::RightShoulder as usize].unwrap().at.x > 0.1);
}

#[test]
fn a_joint_that_jumps_once_stays_and_one_that_is_not_seen_is_forgotten() {
    let mut follower = BodyFollower::default();
    let wrist = BodyJoint::LeftWrist as usize;
    for frame in 0..20 {
        let mut seen = joints(0.0);
        if frame == 15 {
            seen[wrist].as_mut().unwrap().at += Vector3::new(0.0, 0.8, 0.0);
        }
        let known = follower.update(frame * FRAME_NS, seen)[wrist].unwrap();
        assert!((known.at - joints(0.0)[wrist].unwrap().at).norm() < 0.01, "{frame}: {known:?}");
    }
    let spread = |known: [Option<SeenJoint>; 7]| known[wrist].map(|joint| joint.covariance.trace());
    let (now, later) = (spread(follower.at(20 * FRAME_NS)), spread(follower.at(25 * FRAME_NS)));
    assert!(later.unwrap() > 2.0 * now.unwrap());
    assert_eq!(spread(follower.at(40 * FRAME_NS)), None);
    assert!(follower.is_empty());
}

#[test]
fn the_own_body_is_where_its_boxes_are_and_not_what_is_before_them() {
    let camera = CALIBRATION.camera;
    let (width, height) = (camera.width, camera.height);
    let part =
        OwnPart { root_from_box: Isometry3::translation(0.0, 0.0, 1.0), size: Vector3::new(0.1, 2.0, 0.1) };
    let at = Isometry3::identity();
    let own = own_pixels(&[part], &camera, (&at, 0.0), None);
    assert!(own.contains(320, 240) && own.contains(300, 100) && !own.contains(420, 240));
    // Something at 0.6 m hides the upper half.
    let data = (0..height).flat_map(|y| (0..width).map(move |_| if y < 240 { 0.6 } else { 0.97 })).collect();
    let depth = DepthImage { width, height, data };
    let own = own_pixels(&[part], &camera, (&at, 0.0), Some(&depth));
    assert!(!own.contains(320, 100) && own.contains(320, 300));
    // Across the own body the picture goes on as it is beside it.
    let image =
        RgbImage::painted(width, height, |x, _| if (291..350).contains(&x) { [0; 3] } else { [200; 3] });
    let free = without(&image, &own_pixels(&[part], &camera, (&at, 0.0), None));
    assert_eq!(free.pixel(320, 240), [200; 3]);
}
