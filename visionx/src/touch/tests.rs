//! A hand made of blocks comes along a table; what it sees is ray cast.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::picture::Picture;
use super::{OwnFinger, OwnHand, OwnPart, SlipStep, TouchStep, TouchedTable};
use crate::scenes::{CALIBRATION, SKIN, TABLE, Thing, frame, frame_with_depth, table};
use crate::steps::StereoStep;

/// Height of the table's surface, m.
const SURFACE: f64 = 0.90;
/// Way of the hand between two pictures, m: 50 mm/s at 15 Hz.
const STEP: f64 = 0.0033;
/// Where the hand begins along y, where its fingers meet the box, and how many pictures there are.
const BEGIN: f64 = 0.465;
const MEETS: f64 = 0.495;
const PICTURES: u64 = 15;
/// The picture in which the box has moved first.
const TOUCHED: u64 = 10;

const BLACK: [u8; 3] = [40, 40, 45];

fn under() -> TouchedTable {
    TouchedTable { at: Point3::new(0.25, 0.5, SURFACE), normal: Vector3::z_axis() }
}

/// The hand with its fingers forward, along the root frame's y, palm down; the finger `right` is at larger x.
fn hand(y: f64) -> OwnHand {
    let axes = Matrix3::from_columns(&[-Vector3::z(), -Vector3::x(), Vector3::y()]);
    let turned = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let root_from_hand = Isometry3::from_parts(Vector3::new(0.25, y, SURFACE + 0.095).into(), turned);
    let part = |x, y, z, size: [f64; 3]| OwnPart {
        root_from_box: root_from_hand * Isometry3::translation(x, y, z),
        size: size.into(),
    };
    let finger = |name: &str, side: f64| OwnFinger {
        name: name.into(),
        part: part(0.0525, side, 0.0, [0.065, 0.008, 0.05]),
    };
    let fingers = vec![finger("left", 0.065), finger("right", -0.065)];
    let palm = part(-0.005, 0.0, -0.03, [0.05, 0.1, 0.12]);
    let parts = fingers.iter().map(|finger| finger.part).chain([palm]).collect();
    OwnHand { root_from_hand, fingers, parts }
}

/// Where the hand is in a picture.
fn way(picture: u64) -> f64 {
    BEGIN + STEP * picture as f64
}

/// The box of which a side is 0.52 m away, beside the middle of the hand by `x` m, after it has been pushed by `by` m.
fn pushed_box(x: f64, by: f64) -> Thing {
    let root_from_block = Isometry3::translation(0.25 + x, 0.56 + by, SURFACE + 0.025);
    Thing::Block { root_from_block, size: Vector3::new(0.08, 0.08, 0.05), color: [190, 50, 45] }
}

/// Where the hand holds something, in its frame: between the fingers.
fn held() -> Point3<f64> {
    Point3::new(0.06, 0.0, 0.045)
}

/// In how many pictures the box has moved.
fn since(picture: u64) -> f64 {
    picture.saturating_sub(TOUCHED) as f64
}

/// Whether a slip is told in each picture: of a hand with a box in it, which is `off` its place there, m, root frame.
fn slips(off: impl Fn(u64) -> Vector3<f64>) -> Vec<bool> {
    let mut step =
        SlipStep::new(CALIBRATION.camera, "hand", held(), Some(under()), |stamp| Some(hand(way(stamp))));
    let told = (0..PICTURES).map(|picture| {
        let own = hand(way(picture));
        let at = own.root_from_hand * held() + off(picture);
        let carried = Thing::Block {
            root_from_block: Isometry3::translation(at.x, at.y, at.z),
            size: Vector3::new(0.08, 0.08, 0.05),
            color: [190, 50, 45],
        };
        let parts = own.parts.into_iter().map(|part| Thing::Block {
            root_from_block: part.root_from_box,
            size: part.size,
            color: BLACK,
        });
        let all: Vec<Thing> = [table(TABLE), carried].into_iter().chain(parts).collect();
        !step.step(&frame_with_depth(&all, picture, picture)).is_empty()
    });
    told.collect()
}

/// What the step tells of each picture of a table with the hand and these things.
fn told(depth: bool, things: impl Fn(u64) -> Vec<Thing>) -> Vec<Option<(String, Point3<f64>)>> {
    let mut step = TouchStep::new(CALIBRATION.camera, "hand", under(), |stamp| Some(hand(way(stamp))));
    let told = (0..PICTURES).map(|picture| {
        let own = hand(way(picture)).parts.into_iter().map(|part| Thing::Block {
            root_from_block: part.root_from_box,
            size: part.size,
            color: BLACK,
        });
        let all: Vec<Thing> = [table(TABLE)].into_iter().chain(own).chain(things(picture)).collect();
        let seen = match depth {
            true => step.step(&frame_with_depth(&all, picture, picture)),
            false => step.step(&frame(&all, picture, picture)),
        };
        let seen = seen.into_iter().next()?;
        let finger = seen.attributes["finger"].as_str().unwrap().to_owned();
        Some((finger, seen.place.unwrap().position.vector().into()))
    });
    told.collect()
}

#[test]
fn a_box_that_begins_to_move_with_the_hand_is_touched_by_the_finger_on_its_side() {
    for (x, name) in [(0.05, "right"), (-0.05, "left")] {
        let told = told(true, |picture| vec![pushed_box(x, (way(picture) - MEETS).max(0.0))]);
        let first = told.iter().position(Option::is_some).unwrap() as u64;
        assert!((TOUCHED..TOUCHED + 3).contains(&first), "{first}: {told:?}");
        let (finger, place) = told[first as usize].clone().unwrap();
        assert_eq!(finger, name);
        // Along the hand's way only edges show where the box is.
        assert!((place.x - 0.25 - x).abs() < 0.006 && (place.y - 0.56).abs() < 0.05, "{place}");
    }
}

#[test]
fn nothing_is_touched_where_the_box_stays() {
    assert!(told(true, |_| vec![pushed_box(0.0, 0.0)]).iter().all(Option::is_none));
}

#[test]
fn a_shadow_that_moves_with_the_hand_is_no_touch() {
    let shadow = |picture: u64| Thing::Block {
        root_from_block: Isometry3::translation(0.33, way(picture) + 0.06, SURFACE),
        size: Vector3::new(0.1, 0.1, 0.001),
        color: TABLE.map(|c| (f64::from(c) * 0.6) as u8),
    };
    assert!(told(true, |picture| vec![pushed_box(0.0, 0.0), shadow(picture)]).iter().all(Option::is_none));
}

#[test]
fn a_hand_that_passes_over_the_box_is_no_touch() {
    for speed in [0.1, 0.3, 0.8] {
        let ball = |picture: u64| Thing::Ball {
            center: Point3::new(0.25, 0.62, 1.05)
                + Vector3::new(-1.0, 0.3, 0.0) * (speed * (picture as f64 - 8.0) / 15.0),
            radius: 0.05,
            color: SKIN,
        };
        let told = told(true, |picture| vec![pushed_box(0.0, 0.0), ball(picture)]);
        assert!(told.iter().all(Option::is_none), "{speed}: {told:?}");
    }
}

#[test]
fn what_begins_to_move_with_the_hand_is_no_touch_where_the_table_is_seen_between() {
    let ball = |picture: u64| Thing::Ball {
        center: Point3::new(0.41, 0.52 + (way(picture) - MEETS).max(0.0), SURFACE + 0.05),
        radius: 0.035,
        color: SKIN,
    };
    let told = told(true, |picture| vec![ball(picture)]);
    assert!(told.iter().all(Option::is_none), "{told:?}");
}

#[test]
fn pictures_are_aligned_by_the_table_whatever_moves_above_it() {
    let tiles = |count: i32, height: f64, x: f64| {
        (0..count * count).map(move |i| Thing::Block {
            root_from_block: Isometry3::translation(
                x + 0.04 * f64::from(i % count),
                0.4 + 0.04 * f64::from(i / count),
                SURFACE + height,
            ),
            size: Vector3::new(0.02, 0.02, 0.001),
            color: BLACK,
        })
    };
    let picture = |stamp: u64, moved: f64| {
        let all: Vec<Thing> = [table(TABLE)]
            .into_iter()
            .chain(tiles(6, 0.001, 0.0))
            .chain(tiles(6, 0.15, 0.26 + moved))
            .collect();
        Picture::new(&frame_with_depth(&all, stamp, stamp), &CALIBRATION.camera, hand(BEGIN)).unwrap()
    };
    let shift = picture(0, 0.0).shift_of(&picture(1, 0.003), &under());
    assert!(shift.norm() < 0.1, "{shift}");
}

#[test]
fn what_stays_behind_the_hand_or_falls_out_of_it_slips() {
    assert!(slips(|_| Vector3::zeros()).iter().all(|told| !told), "it is held");
    for (name, per_picture) in
        [("stays", Vector3::new(0.0, -STEP, 0.0)), ("falls", Vector3::new(0.0, 0.0, -0.04))]
    {
        let told = slips(|picture| per_picture * since(picture));
        let first = told.iter().position(|told| *told).unwrap() as u64;
        assert!((TOUCHED + 1..=TOUCHED + 3).contains(&first), "{name}: {first}");
    }
}

#[test]
fn what_stays_behind_ahead_of_the_fingers_does_not_slip() {
    let ahead = |picture| Vector3::new(0.0, 0.07 - STEP * since(picture), 0.0);
    assert!(slips(ahead).iter().all(|told| !told), "it came with the hand, but no finger reaches it");
}

#[test]
fn without_depth_nothing_is_told() {
    assert!(
        told(false, |picture| vec![pushed_box(0.05, (way(picture) - MEETS).max(0.0))])
            .iter()
            .all(Option::is_none)
    );
}
