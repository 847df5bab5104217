//! The body of a person: where its parts are when the hands are somewhere, of which solids the physics makes it, and how it looks.
//!
//! A part is a rod, a ball or a trunk in a frame of its own; `looks` draws clothes, a face and fingers there. It has no physics, no
//! schedule and no time.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use armarium_robot::{Geometry, Mesh, Visual};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::render::hand::{HandPose, SKIN, hand_visuals};
use crate::world::{PersonSpec, Sleeves};

/// Lengths of a body, all as shares of its height.
const HIP: f64 = 0.50;
const SHOULDER: f64 = 0.80;
const HEAD: f64 = 0.935;
const HALF_SHOULDERS: f64 = 0.11;
pub(crate) const UPPER_ARM: f64 = 0.17;
/// From the elbow to the middle of the hand.
pub(crate) const FOREARM: f64 = 0.16;
/// Radius of a hand, m.
pub const HAND_RADIUS: f64 = 0.05;
/// From the middle of the hand to the wrist, m.
const WRIST: f64 = 0.05;
/// The height for which the forms below are, m; others are larger or smaller by the same share.
const USUAL: f64 = 1.75;

/// Colours of legs, shoes, hair, lips and the dark of the eyes.
const TROUSERS: [u8; 3] = [58, 60, 68];
const SHOES: [u8; 3] = [40, 36, 34];
const HAIR: [u8; 3] = [62, 44, 32];
const LIPS: [u8; 3] = [176, 96, 88];
const DARK: [u8; 3] = [40, 30, 26];
const WHITE: [u8; 3] = [236, 232, 226];
/// How far the fingers of a hand are bent that shows nothing.
const RELAXED: HandPose = HandPose { flexion: [0.3, 0.15, 0.2, 0.25, 0.3], spread: 0.06 };
/// Corners of a ring of a surface.
const CORNERS: u32 = 20;

/// A ring of a surface around the z axis of its part: height, half the width and half the depth, and how far it is ahead, m.
type Ring = [f64; 4];

/// The trunk from the hips to the neck, about its middle.
const TRUNK: [Ring; 10] = [
    [-0.225, 0.158, 0.108, 0.0],
    [-0.15, 0.160, 0.108, 0.0],
    [-0.06, 0.150, 0.102, 0.0],
    [0.05, 0.162, 0.112, 0.004],
    [0.15, 0.182, 0.116, 0.004],
    [0.22, 0.200, 0.104, 0.0],
    [0.275, 0.206, 0.080, -0.004],
    [0.305, 0.176, 0.070, -0.006],
    [0.33, 0.112, 0.064, -0.006],
    [0.35, 0.064, 0.060, -0.004],
];
/// The hips, in the colour of the legs.
const HIPS: [Ring; 4] = [
    [-0.40, 0.06, 0.06, 0.0],
    [-0.36, 0.150, 0.100, 0.0],
    [-0.28, 0.166, 0.112, 0.0],
    [-0.21, 0.156, 0.106, 0.0],
];
/// The neck.
const NECK: [Ring; 2] = [[0.31, 0.056, 0.056, -0.004], [0.42, 0.054, 0.058, 0.0]];
/// The head, about its middle, from the chin to the crown.
const FACE: [Ring; 9] = [
    [-0.118, 0.020, 0.024, 0.050],
    [-0.108, 0.036, 0.046, 0.038],
    [-0.085, 0.054, 0.070, 0.022],
    [-0.045, 0.068, 0.088, 0.008],
    [0.0, 0.074, 0.094, 0.0],
    [0.04, 0.076, 0.096, -0.002],
    [0.075, 0.066, 0.086, -0.004],
    [0.10, 0.044, 0.058, -0.006],
    [0.113, 0.012, 0.016, -0.008],
];
/// The hair, which leaves the face free.
const CAP: [Ring; 8] = [
    [-0.07, 0.058, 0.050, -0.036],
    [-0.04, 0.071, 0.074, -0.024],
    [0.0, 0.078, 0.080, -0.022],
    [0.04, 0.081, 0.086, -0.020],
    [0.062, 0.078, 0.094, -0.010],
    [0.085, 0.068, 0.086, -0.006],
    [0.11, 0.042, 0.056, -0.008],
    [0.123, 0.012, 0.016, -0.010],
];

/// 1 for the right side, -1 for the left.
pub(crate) fn sign(side: usize) -> f64 {
    if side == 0 { 1.0 } else { -1.0 }
}

pub(crate) fn shoulder(feet: &Isometry3<f64>, height: f64, side: usize) -> Point3<f64> {
    feet * Point3::new(sign(side) * HALF_SHOULDERS * height, 0.0, SHOULDER * height)
}

/// The solids of a person's parts in frames of their own: legs, trunk, head, upper arms, forearms, and last the hands.
pub fn parts(spec: &PersonSpec) -> Vec<Visual> {
    let h = spec.height;
    let part = |shape: Geometry, color| Visual { shape, link_from_shape: Isometry3::identity(), color };
    let rod = |radius: f64, length: f64, color| part(Geometry::Capsule { radius, length }, color);
    let leg = || rod(0.075, HIP * h - 0.15, TROUSERS);
    let upper = || rod(0.045, UPPER_ARM * h, spec.color);
    let fore = || rod(0.04, FOREARM * h, forearm_color(spec));
    let hand = || part(Geometry::Sphere { radius: HAND_RADIUS }, SKIN);
    let trunk = rod(0.15, (SHOULDER - HIP) * h - 0.15, spec.color);
    vec![
        leg(),
        leg(),
        trunk,
        part(Geometry::Sphere { radius: 0.11 }, SKIN),
        upper(),
        upper(),
        fore(),
        fore(),
        hand(),
        hand(),
    ]
}

/// How each of a person's [`parts`] looks, in the part's frame.
pub fn looks(spec: &PersonSpec) -> Vec<Vec<Visual>> {
    let size = spec.height / USUAL;
    let surface = |rings: &[Ring], color| loft(rings, size, color);
    let trunk = vec![surface(&HIPS, TROUSERS), surface(&TRUNK, spec.color), surface(&NECK, SKIN)];
    let hand = hand_visuals(&RELAXED);
    let mirrored: Vec<Visual> = hand.iter().map(mirrored).collect();
    let (leg, [upper, fore]) = (leg(spec), arm(spec));
    vec![leg.clone(), leg, trunk, head(size), upper.clone(), upper, fore.clone(), fore, hand, mirrored]
}

/// The poses of a person's parts in the order of [`parts`], with their hands where they are.
pub fn poses(spec: &PersonSpec, feet: &Isometry3<f64>, hands: &[Point3<f64>; 2]) -> Vec<Isometry3<f64>> {
    let h = spec.height;
    let upright = |x: f64, z: f64| feet * Isometry3::translation(x, 0.0, z);
    let arms = [0, 1].map(|side| {
        let shoulder = shoulder(feet, h, side);
        let elbow = elbow(feet, h, side, &hands[side]);
        let palm = feet.rotation * Vector3::x() * -sign(side);
        let hand = Isometry3::from_parts(hands[side].coords.into(), hand_turn(&(hands[side] - elbow), &palm));
        [along(&shoulder, &elbow), along(&elbow, &hands[side]), hand]
    });
    vec![
        upright(0.09, HIP * h / 2.0),
        upright(-0.09, HIP * h / 2.0),
        upright(0.0, (HIP + SHOULDER) / 2.0 * h),
        upright(0.0, HEAD * h),
        arms[0][0],
        arms[1][0],
        arms[0][1],
        arms[1][1],
        arms[0][2],
        arms[1][2],
    ]
}

/// The joints of a person by the poses of their [`parts`]: the middle of the head, and of the right and of the left arm shoulder, elbow
/// and wrist.
pub fn joints(spec: &PersonSpec, poses: &[Isometry3<f64>]) -> Option<[Point3<f64>; 7]> {
    let [_, _, _, head, rest @ ..] = poses else { return None };
    let [right, left, _, _, right_hand, left_hand] = rest else { return None };
    let half = Point3::new(0.0, 0.0, UPPER_ARM * spec.height / 2.0);
    let arm = |upper: &Isometry3<f64>, hand: &Isometry3<f64>| {
        [upper * -half, upper * half, hand * Point3::new(0.0, 0.0, -WRIST)]
    };
    let ([a, b, c], [d, e, f]) = (arm(right, right_hand), arm(left, left_hand));
    Some([head.translation.vector.into(), a, b, c, d, e, f])
}

/// Where the elbow is when the hand is there: it hangs down and outwards.
pub(crate) fn elbow(feet: &Isometry3<f64>, height: f64, side: usize, hand: &Point3<f64>) -> Point3<f64> {
    let (a, b) = (UPPER_ARM * height, FOREARM * height);
    let shoulder = shoulder(feet, height, side);
    let way = hand - shoulder;
    let far = way.norm().clamp((a - b).abs() + 1e-3, a + b - 1e-6);
    let ahead = way.try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    let along = (a * a + far * far - b * b) / (2.0 * far);
    let off = (a * a - along * along).max(0.0).sqrt();
    let down = feet.rotation * Vector3::new(0.4 * sign(side), -0.3, -1.0);
    let across = down - ahead * down.dot(&ahead);
    let across = across.try_normalize(1e-6).unwrap_or_else(|| feet.rotation * Vector3::y() * -1.0);
    shoulder + ahead * along + across * off
}

/// The pose of a rod between two points: z along it.
fn along(from: &Point3<f64>, to: &Point3<f64>) -> Isometry3<f64> {
    let way = to - from;
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &way)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
    Isometry3::from_parts(nalgebra::center(from, to).coords.into(), turn)
}

/// How a hand is turned: its z along the forearm, its palm (x) towards `palm` as far as it goes.
fn hand_turn(forearm: &Vector3<f64>, palm: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = forearm.try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    let across = |v: &Vector3<f64>| (v - z * z.dot(v)).try_normalize(0.1);
    let x = across(palm).or_else(|| across(&-Vector3::z())).unwrap_or_else(|| z.cross(&Vector3::z()));
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

fn forearm_color(spec: &PersonSpec) -> [u8; 3] {
    match spec.sleeves {
        Sleeves::Long => spec.color,
        Sleeves::Short => SKIN,
    }
}

fn leg(spec: &PersonSpec) -> Vec<Visual> {
    let half = HIP * spec.height / 2.0;
    let rings = [[-half + 0.08, 0.05, 0.055, 0.0], [0.0, 0.066, 0.07, 0.0], [half, 0.084, 0.088, 0.0]];
    vec![loft(&rings, 1.0, TROUSERS), boxed([0.09, 0.26, 0.08], [0.0, 0.05, 0.04 - half], SHOES)]
}

/// The upper arm and the forearm with its wrist.
fn arm(spec: &PersonSpec) -> [Vec<Visual>; 2] {
    let (upper, fore) = (UPPER_ARM * spec.height / 2.0, FOREARM * spec.height / 2.0);
    let skin = forearm_color(spec);
    let sleeve = match spec.sleeves {
        Sleeves::Long => upper,
        Sleeves::Short => 0.3 * upper,
    };
    let round = |z: f64, radius: f64| [z, radius, radius, 0.0];
    let wrist = fore - WRIST;
    [
        vec![
            ball(0.054, [0.0, 0.0, -upper], spec.color),
            loft(&[round(-upper, 0.054), round(-0.3 * upper, 0.050), round(sleeve, 0.046)], 1.0, spec.color),
            loft(&[round(-upper, 0.042), round(upper, 0.041)], 1.0, skin),
            ball(0.041, [0.0, 0.0, upper], skin),
        ],
        vec![
            loft(&[round(-fore, 0.041), round(-0.4 * fore, 0.043), round(wrist - 0.02, 0.031)], 1.0, skin),
            loft(&[[wrist - 0.03, 0.022, 0.027, 0.0], [wrist + 0.015, 0.021, 0.026, 0.0]], 1.0, SKIN),
        ],
    ]
}

fn head(size: f64) -> Vec<Visual> {
    let at = |place: [f64; 3]| place.map(|x| size * x);
    let mut head = vec![loft(&FACE, size, SKIN), loft(&CAP, size, HAIR)];
    for side in [1.0, -1.0] {
        head.push(ball(0.013 * size, at([side * 0.031, 0.078, 0.006]), WHITE));
        head.push(ball(0.0075 * size, at([side * 0.031, 0.0855, 0.006]), DARK));
        head.push(boxed(at([0.034, 0.010, 0.007]), at([side * 0.032, 0.084, 0.027]), HAIR));
        head.push(ball(0.017 * size, at([side * 0.074, -0.006, -0.012]), SKIN));
    }
    let nose = Vector3::new(0.0, 0.098, -0.018) * size;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.25);
    head.push(Visual {
        shape: Geometry::Capsule { radius: 0.011 * size, length: 0.032 * size },
        link_from_shape: Isometry3::from_parts(nose.into(), turn),
        color: SKIN,
    });
    head.push(boxed(at([0.046, 0.012, 0.012]), at([0.0, 0.087, -0.066]), LIPS));
    head
}

fn ball(radius: f64, [x, y, z]: [f64; 3], color: [u8; 3]) -> Visual {
    Visual { shape: Geometry::Sphere { radius }, link_from_shape: Isometry3::translation(x, y, z), color }
}

fn boxed(size: [f64; 3], [x, y, z]: [f64; 3], color: [u8; 3]) -> Visual {
    let shape = Geometry::Box { size: size.into() };
    Visual { shape, link_from_shape: Isometry3::translation(x, y, z), color }
}

/// A part of the right hand as one of the left hand: mirrored across its y.
fn mirrored(of: &Visual) -> Visual {
    let Isometry3 { rotation, translation } = of.link_from_shape;
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    // The forms of a hand are their own mirror images, so that both sides of the rotation may be mirrored.
    let turn = flip * rotation.to_rotation_matrix().into_inner() * flip;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    let link_from_shape = Isometry3::from_parts((flip * translation.vector).into(), rotation);
    Visual { link_from_shape, ..of.clone() }
}

/// A closed surface through rings from the lowest to the highest, `size` times as large.
fn loft(rings: &[Ring], size: f64, color: [u8; 3]) -> Visual {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for [height, width, depth, ahead] in rings {
        for corner in 0..CORNERS {
            let angle = TAU * f64::from(corner) / f64::from(CORNERS);
            let (x, y) = (width * libm::cos(angle), ahead + depth * libm::sin(angle));
            vertices.push(Point3::new(x, y, *height) * size);
        }
    }
    let around = |corner: u32| (corner + 1) % CORNERS;
    for ring in 1..rings.len() as u32 {
        let (below, above) = ((ring - 1) * CORNERS, ring * CORNERS);
        for corner in 0..CORNERS {
            let [a, b] = [corner, around(corner)].map(|corner| below + corner);
            let [c, d] = [corner, around(corner)].map(|corner| above + corner);
            triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    let last = (rings.len() as u32).saturating_sub(1) * CORNERS;
    for first in [0, last] {
        triangles.extend((2..CORNERS).map(|corner| [first, first + corner - 1, first + corner]));
    }
    let mesh = Mesh::new(vertices, triangles).expect("rings have corners");
    Visual { shape: Geometry::Mesh(Arc::new(mesh)), link_from_shape: Isometry3::identity(), color }
}
