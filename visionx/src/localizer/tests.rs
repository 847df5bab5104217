//! Boxes in drawn scenes: alone, cut off, covered, and beside things of their colour.

use super::*;
use crate::scenes::{CALIBRATION, TABLE, Thing, empty_frames, frame, table};

const YELLOW: [u8; 3] = [240, 210, 40];
const SIZE: Vector3<f64> = Vector3::new(0.10, 0.07, 0.04);

fn block(x: f64, y: f64, yaw: f64, size: Vector3<f64>) -> Thing {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    let at = Translation3::new(x, y, 0.90 + size.z / 2.0);
    Thing::Block { root_from_block: Isometry3::from_parts(at, rotation), size, color: YELLOW }
}

fn localizer() -> ObjectLocalizer {
    ObjectLocalizer::new(CALIBRATION, SIZE, YELLOW)
}

fn errors(estimate: &ObjectEstimate, x: f64, y: f64, yaw: f64) -> (f64, f64) {
    let at = estimate.root_from_object.translation.vector - Vector3::new(x, y, 0.92);
    let turn = estimate.root_from_object.rotation.euler_angles().2;
    (at.norm(), half_turn(turn - yaw).abs())
}

#[test]
fn finds_place_and_yaw() {
    for (i, (x, y, yaw)) in
        [(0.3, 0.5, 0.3), (0.1, 0.6, -1.2), (0.4, 0.45, 1.5), (0.2, 0.65, 0.0)].iter().enumerate()
    {
        let scene = [table(TABLE), block(*x, *y, *yaw, SIZE)];
        let estimate = localizer().localize(&frame(&scene, 7, i as u64)).unwrap();
        let (place, turn) = errors(&estimate, *x, *y, *yaw);
        assert!(place < 0.004 && turn < 0.03, "{place} m, {turn} rad, {estimate:?}");
        assert!(estimate.visible > 0.95);
    }
}

#[test]
fn on_a_tilted_surface_the_box_is_tilted() {
    let tilt = UnitQuaternion::from_euler_angles(0.15, -0.15, 0.0);
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.4);
    let root_from_block = Isometry3::from_parts(Translation3::new(0.3, 0.5, 0.95), tilt * turned);
    let block = Thing::Block { root_from_block, size: SIZE, color: YELLOW };
    let frame = frame(&[block], 0, 3);
    let found = localizer().standing_on(tilt).localize(&frame).unwrap().root_from_object;
    let off = found.inverse() * root_from_block;
    assert!(off.translation.vector.norm() < 0.004, "{off}");
    assert!(off.rotation.angle().min(PI - off.rotation.angle()) < 0.03, "{off}");
}

#[test]
fn a_box_that_the_pictures_cut_off_is_followed_with_its_tilt() {
    let size = Vector3::new(0.7, 0.3, 0.03);
    let localizer = ObjectLocalizer::new(CALIBRATION, size, YELLOW);
    for (x, yaw, tilt) in [(-0.2, 0.1, [0.02, -0.03]), (0.95, -0.15, [-0.03, 0.02])] {
        let tilt = UnitQuaternion::from_euler_angles(tilt[0], tilt[1], 0.0);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        let root_from_block = Isometry3::from_parts(Translation3::new(x, 0.55, 0.93), tilt * turned);
        let scene = [table(TABLE), Thing::Block { root_from_block, size, color: YELLOW }];
        let frame = frame(&scene, 0, 4);
        let expected = Isometry3::new(Vector3::new(x + 0.015, 0.54, 0.93), Vector3::z() * (yaw + 0.03));
        // From frame to frame its tilt is found.
        let follow = |at: Isometry3<f64>, _| localizer.follow(&frame, &at).unwrap().root_from_object;
        let expected = (0..4).fold(expected, follow);
        let found = localizer.follow(&frame, &expected).unwrap();
        assert!(found.visible < 0.85, "{}", found.visible);
        let off = root_from_block.inverse() * found.root_from_object;
        assert!(off.translation.vector.norm() < 0.004 && off.rotation.angle() < 0.01, "{x}: {off}");
        // It is found without an expectation, too.
        let found = localizer.clone().standing_on(tilt).localize(&frame).unwrap().root_from_object;
        assert!((found.inverse() * root_from_block).translation.vector.norm() < 0.004, "{x}: {found}");
        let far = Translation3::new(0.0, 0.3, 0.0) * root_from_block;
        assert_eq!(localizer.follow(&frame, &far), None);
    }
}

/// What is followed for six frames from where it is stays there.
fn stays_in(frame: &StereoFrame, localizer: &ObjectLocalizer, at: &Isometry3<f64>) {
    let followed = |at: Isometry3<f64>, _| localizer.follow(frame, &at).unwrap().root_from_object;
    let off = at.inverse() * (0..6).fold(*at, followed);
    assert!(off.translation.vector.norm() < 0.002, "{off}");
}

#[test]
fn a_part_of_the_robot_before_it_is_no_part_of_it() {
    let (size, blue) = (Vector3::new(0.7, 0.3, 0.03), [40, 90, 200]);
    let localizer = ObjectLocalizer::new(CALIBRATION, size, blue);
    let at = Isometry3::new(Vector3::new(0.28, 0.55, 0.915), Vector3::z() * 0.05);
    let tray = Thing::Block { root_from_block: at, size, color: blue };
    let chest = Thing::Block {
        root_from_block: Isometry3::new(Vector3::new(0.2, 0.38, 1.0), Vector3::z() * 0.05),
        size: Vector3::new(1.2, 0.08, 0.08),
        color: [38, 52, 100],
    };
    stays_in(&frame(&[table(TABLE), tray, chest], 0, 3), &localizer, &at);
}

#[test]
fn where_a_hand_covers_its_end_its_border_is_not_the_hands() {
    let size = Vector3::new(0.7, 0.3, 0.03);
    let localizer = ObjectLocalizer::new(CALIBRATION, size, YELLOW);
    let at = Isometry3::new(Vector3::new(0.0, 0.55, 0.915), Vector3::z() * 0.1);
    let tray = Thing::Block { root_from_block: at, size, color: YELLOW };
    // Its left end is out of view; the hand covers all of the right one but a corner.
    let hand = Thing::Block {
        root_from_block: Isometry3::new(Vector3::new(0.38, 0.53, 1.0), Vector3::z() * 0.2),
        size: Vector3::new(0.15, 0.2, 0.08),
        color: [70, 70, 74],
    };
    stays_in(&frame(&[table(TABLE), tray, hand], 0, 4), &localizer, &at);
}

#[test]
fn a_darker_thing_of_its_hue_beside_it_is_no_part_of_it() {
    let arm = Thing::Block {
        root_from_block: Isometry3::translation(0.3, 0.33, 1.0),
        size: Vector3::new(0.5, 0.12, 0.1),
        color: [66, 58, 11],
    };
    let scene = [table(TABLE), block(0.3, 0.5, 0.3, SIZE), arm];
    let found = localizer().localize(&frame(&scene, 0, 2)).unwrap();
    let (place, turn) = errors(&found, 0.3, 0.5, 0.3);
    assert!(place < 0.004 && turn < 0.03, "{place} m, {turn} rad");
}

#[test]
fn a_dark_thing_whose_hue_is_noise_is_no_part_of_it() {
    let (size, blue) = (Vector3::new(0.7, 0.3, 0.03), [40, 90, 200]);
    let localizer = ObjectLocalizer::new(CALIBRATION, size, blue);
    let at = Isometry3::new(Vector3::new(0.28, 0.55, 0.915), Vector3::z() * 0.05);
    let tray = Thing::Block { root_from_block: at, size, color: blue };
    let chest = Thing::Block {
        root_from_block: Isometry3::translation(0.1, 0.3, 1.0),
        size: Vector3::new(0.3, 0.02, 0.02),
        color: [20, 27, 52],
    };
    let found = localizer.localize(&frame(&[table(TABLE), tray, chest], 0, 3)).unwrap();
    let off = at.inverse() * found.root_from_object;
    assert!(off.translation.vector.norm() < 0.004, "{off}");
}

#[test]
fn partly_covered_it_is_less_sure_and_still_right() {
    let free = [table(TABLE), block(0.3, 0.5, 0.4, SIZE)];
    let cover = Thing::Block {
        root_from_block: Isometry3::translation(0.32, 0.47, 1.0),
        size: Vector3::new(0.08, 0.3, 0.03),
        color: [110, 112, 118],
    };
    let covered = [free[0].clone(), free[1].clone(), cover];
    let [a, b] = [&free[..], &covered[..]].map(|scene| localizer().localize(&frame(scene, 0, 5)).unwrap());
    assert!(b.visible < 0.9 && b.visible > 0.3, "{}", b.visible);
    assert!(b.covariance.trace() > 1.5 * a.covariance.trace());
    let (place, turn) = errors(&b, 0.3, 0.5, 0.4);
    assert!(place < 0.01 && turn < 0.06, "{place} {turn}");
}

#[test]
fn other_things_of_its_colour_are_not_it() {
    let others = [
        block(0.3, 0.5, 0.4, Vector3::new(0.2, 0.14, 0.08)),
        block(0.3, 0.5, 0.4, Vector3::new(0.05, 0.035, 0.02)),
        block(0.3, 0.5, 0.4, Vector3::new(0.25, 0.03, 0.03)),
        Thing::Ball { center: Point3::new(0.3, 0.5, 0.95), radius: 0.05, color: YELLOW },
    ];
    for (i, other) in others.into_iter().enumerate() {
        let found = localizer().localize(&frame(&[table(TABLE), other.clone()], 0, 1));
        assert_eq!(found, None, "{i}");
        let scene = [table(TABLE), other, block(0.05, 0.6, 0.4, SIZE)];
        let found = localizer().localize(&frame(&scene, 0, 1)).unwrap();
        assert!(errors(&found, 0.05, 0.6, 0.4).0 < 0.005);
    }
}

#[test]
fn nothing_is_found_where_nothing_is() {
    for frame in empty_frames() {
        assert_eq!(localizer().localize(&frame), None);
    }
    let nonsense = ObjectLocalizer::new(CALIBRATION, Vector3::repeat(f64::NAN), YELLOW);
    let scene = [table(TABLE), block(0.3, 0.5, 0.3, SIZE)];
    assert_eq!(nonsense.localize(&frame(&scene, 0, 0)), None);
}
