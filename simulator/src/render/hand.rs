//! The coach's hand: five jointed fingers that show gestures, and a sleeved forearm.
//!
//! It is a right hand. Hand frame: origin at the middle of the palm, z along the straight fingers, x out of the
//! palm (the side to which fingers bend), y to the side of the thumb. The measures are those of an adult: palm 85 x
//! 90 x 28 mm, middle finger 94 mm over its knuckle, 102 mm with its tip.

use armarium_robot::{Geometry, Visual};
use armarium_visionx::Gesture;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::robot::link_shapes;
use super::scene::Shape;

/// Mean colour of the skin, RGB; the parts differ from it by a few percent in brightness.
pub const SKIN: [u8; 3] = [224, 172, 138];
/// Colour of the sleeve, RGB.
pub const SLEEVE: [u8; 3] = [84, 102, 134];

/// The joints of the hand, so that a change of gesture is a movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandPose {
    /// How far each finger is bent, from thumb to little finger: 0 straight, 1 closed.
    pub flexion: [f64; 5],
    /// How far straight fingers are spread, rad: the angle between the index and the hand's z.
    pub spread: f64,
}

/// A finger other than the thumb. Lengths are between joints; the last one ends at the middle of the tip's rounding.
struct Finger {
    /// Its knuckle in the hand frame, m.
    knuckle: [f64; 3],
    /// Lengths of its phalanges, m.
    lengths: [f64; 3],
    /// Radii of its phalanges, m.
    radii: [f64; 3],
    /// Its share of the spread.
    spread: f64,
}

/// A capsule of the hand.
struct Capsule {
    from: Point3<f64>,
    to: Point3<f64>,
    radius: f64,
}

const fn finger(knuckle: [f64; 3], lengths: [f64; 3], radii: [f64; 3], spread: f64) -> Finger {
    Finger { knuckle, lengths, radii, spread }
}

/// Index to little finger.
const FINGERS: [Finger; 4] = [
    finger([0.0, 0.030, 0.043], [0.042, 0.025, 0.018], [0.0098, 0.0090, 0.0082], 1.0),
    finger([-0.001, 0.010, 0.046], [0.046, 0.029, 0.019], [0.0100, 0.0092, 0.0083], 0.1),
    finger([0.0, -0.010, 0.043], [0.042, 0.027, 0.019], [0.0096, 0.0088, 0.0080], -0.7),
    finger([0.002, -0.0285, 0.037], [0.033, 0.020, 0.017], [0.0088, 0.0080, 0.0074], -1.5),
];
/// Angles of a closed finger's joints from the knuckle on, rad.
const CLOSED: [f64; 3] = [1.48, 1.83, 1.10];
/// Where the metacarpal bones of the four fingers begin at the wrist, m.
const CARPALS: [[f64; 3]; 4] =
    [[0.0, 0.021, -0.042], [0.0, 0.007, -0.043], [0.0, -0.007, -0.043], [0.0, -0.020, -0.041]];
/// Radius of the palm about those bones, m.
const PALM_RADIUS: f64 = 0.0135;
/// Where the thumb begins, its lengths and radii, m.
const THUMB: Finger = finger([0.005, 0.022, -0.032], [0.045, 0.032, 0.025], [0.0150, 0.0105, 0.0090], 0.0);
/// Directions of the thumb's parts when it is straight, and when it lies over closed fingers.
const THUMB_STRAIGHT: [[f64; 3]; 3] = [[0.28, 0.70, 0.66], [0.16, 0.74, 0.65], [0.08, 0.74, 0.67]];
const THUMB_CLOSED: [[f64; 3]; 3] = [[0.68, 0.34, 0.65], [0.56, -0.22, 0.80], [0.08, -0.96, 0.26]];

impl HandPose {
    /// The pose in which the hand shows a gesture.
    pub fn of(gesture: Gesture) -> Self {
        let (flexion, spread) = match gesture {
            Gesture::Fist => ([1.0, 1.0, 1.0, 1.0, 1.0], 0.0),
            Gesture::OpenHand => ([0.0, 0.03, 0.02, 0.03, 0.05], 0.20),
            Gesture::PointOne => ([1.0, 0.02, 1.0, 1.0, 1.0], 0.0),
            Gesture::PointTwo => ([1.0, 0.02, 0.02, 1.0, 1.0], 0.22),
        };
        Self { flexion, spread }
    }

    /// Interpolates between two poses: `a` at `t` = 0, `b` at 1; `t` is clamped.
    pub fn blend(a: &Self, b: &Self, t: f64) -> Self {
        let t = t.clamp(0.0, 1.0);
        let between = |a: f64, b: f64| a * (1.0 - t) + b * t;
        let flexion = std::array::from_fn(|i| between(a.flexion[i], b.flexion[i]));
        Self { flexion, spread: between(a.spread, b.spread) }
    }
}

/// The shapes of the hand in a pose, with its forearm.
pub fn hand_shapes(pose: &HandPose, scene_from_hand: &Isometry3<f64>) -> Vec<Shape> {
    let mut shapes = link_shapes(&hand_visuals(pose), scene_from_hand);
    shapes.extend(link_shapes(&forearm(), scene_from_hand));
    shapes
}

/// The hand in a pose without its forearm, in the hand frame.
pub fn hand_visuals(pose: &HandPose) -> Vec<Visual> {
    let mut visuals = vec![palm_core()];
    let parts = [(thumb(pose), 0.98), (palm(), 1.0)].into_iter();
    let fingers = FINGERS
        .iter()
        .enumerate()
        .map(|(i, finger)| (finger_segments(finger, i, pose), 1.0 - 0.02 * (i % 2) as f64));
    for (segments, brightness) in parts.chain(fingers) {
        for (i, segment) in segments.iter().enumerate() {
            // Fingers redden towards their tips.
            visuals.push(segment.visual(tinted(SKIN, brightness, 0.012 * i as f64)));
        }
    }
    visuals
}

/// The centres of the rounded fingertips in the hand frame, m, from thumb to little finger. The fingers end one
/// [`tip_radius`] farther.
pub fn fingertips(pose: &HandPose) -> [Point3<f64>; 5] {
    let last = |segments: Vec<Capsule>| segments.last().map_or_else(Point3::origin, |segment| segment.to);
    std::array::from_fn(|i| match i {
        0 => last(thumb(pose)),
        _ => last(finger_segments(&FINGERS[i - 1], i - 1, pose)),
    })
}

/// The radius of a fingertip, m; 0 is the thumb, 4 and more the little finger.
pub fn tip_radius(finger: usize) -> f64 {
    match finger {
        0 => THUMB.radii[2],
        _ => FINGERS[finger.min(4) - 1].radii[2],
    }
}

/// Balls (centre in the hand frame and radius, m) whose convex hull contains the hand without its forearm. The
/// whole hand is in a picture if all of them are.
pub fn landmarks(pose: &HandPose) -> Vec<(Point3<f64>, f64)> {
    let fingers = FINGERS.iter().enumerate().flat_map(|(i, finger)| finger_segments(finger, i, pose));
    let segments = palm().into_iter().chain(thumb(pose)).chain(fingers);
    segments.flat_map(|s| [(s.from, s.radius), (s.to, s.radius)]).collect()
}

fn finger_segments(finger: &Finger, index: usize, pose: &HandPose) -> Vec<Capsule> {
    let flexion = pose.flexion[index + 1];
    // Bent fingers are less spread.
    let spread = pose.spread * finger.spread * (1.0 - flexion).max(0.0);
    let straight = Vector3::new(0.0, libm::sin(spread), libm::cos(spread));
    let mut angle = 0.0;
    chain(finger, |joint| {
        angle += CLOSED[joint] * flexion;
        Vector3::x() * libm::sin(angle) + straight * libm::cos(angle)
    })
}

fn thumb(pose: &HandPose) -> Vec<Capsule> {
    chain(&THUMB, |joint| {
        let (straight, closed) = (Vector3::from(THUMB_STRAIGHT[joint]), Vector3::from(THUMB_CLOSED[joint]));
        straight.lerp(&closed, pose.flexion[0]).try_normalize(1e-9).unwrap_or(straight)
    })
}

/// Three phalanges, each in its direction from the end of the previous one.
fn chain(finger: &Finger, mut direction: impl FnMut(usize) -> Vector3<f64>) -> Vec<Capsule> {
    let mut from = Point3::from(finger.knuckle);
    let phalanx = |joint: usize| {
        let to = from + direction(joint) * finger.lengths[joint];
        let segment = Capsule { from, to, radius: finger.radii[joint] };
        from = to;
        segment
    };
    (0..3).map(phalanx).collect()
}

/// The four metacarpals.
fn palm() -> Vec<Capsule> {
    let bone = |(from, finger): (&[f64; 3], &Finger)| Capsule {
        from: Point3::from(*from),
        to: Point3::from(finger.knuckle) - Vector3::z() * 0.004,
        radius: PALM_RADIUS,
    };
    CARPALS.iter().zip(&FINGERS).map(bone).collect()
}

/// The body that fills the gaps between the metacarpals.
fn palm_core() -> Visual {
    let size = 2.0 * Vector3::new(0.0128, 0.0235, 0.042);
    Visual { shape: Geometry::Box { size }, link_from_shape: Isometry3::identity(), color: SKIN }
}

/// Wrist and sleeve.
fn forearm() -> Vec<Visual> {
    let wrist =
        |y: f64| Capsule { from: Point3::new(0.0, y, -0.04), to: Point3::new(0.0, y, -0.12), radius: 0.021 };
    let mut visuals: Vec<_> =
        [-0.0095, 0.0095].iter().map(|&y| wrist(y).visual(tinted(SKIN, 0.97, 0.0))).collect();
    visuals.push(Visual {
        shape: Geometry::Cylinder { radius: 0.043, length: 0.32 },
        link_from_shape: Isometry3::translation(0.0, 0.0, -0.26),
        color: SLEEVE,
    });
    visuals
}

impl Capsule {
    fn visual(&self, color: [u8; 3]) -> Visual {
        let along = self.to - self.from;
        // A rotation to the opposite of z needs an axis; any perpendicular one will do.
        let turn = Rotation3::rotation_between(&Vector3::z(), &along)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let middle = Translation3::from(self.from.coords + along / 2.0);
        let link_from_shape = Isometry3::from_parts(middle, UnitQuaternion::from_rotation_matrix(&turn));
        let shape = Geometry::Capsule { radius: self.radius, length: along.norm() };
        Visual { shape, link_from_shape, color }
    }
}

/// A colour scaled by `brightness`; green and blue are reduced by the share `redness`.
fn tinted(color: [u8; 3], brightness: f64, redness: f64) -> [u8; 3] {
    let [r, g, b] = color.map(f64::from);
    let cold = brightness * (1.0 - redness);
    [(r * brightness).round() as u8, (g * cold).round() as u8, (b * cold).round() as u8]
}

#[cfg(test)]
mod tests {
    use super::super::{Viewpoint, VisibleScene, render};
    use super::*;
    use armarium_visionx::PinholeCamera;

    #[test]
    fn only_straight_fingers_reach_out() {
        for (gesture, straight) in Gesture::ALL.into_iter().zip([&[][..], &[1, 2, 3, 4], &[1], &[1, 2]]) {
            for (finger, tip) in fingertips(&HandPose::of(gesture)).iter().enumerate().skip(1) {
                assert_eq!(tip.z > 0.09, straight.contains(&finger), "{gesture:?} {finger} {tip}");
                assert!(tip.z > 0.0 && tip.x > -0.01, "{gesture:?} {finger} {tip}");
            }
        }
    }

    #[test]
    fn straight_fingertips_stand_apart() {
        for gesture in [Gesture::OpenHand, Gesture::PointTwo] {
            let tips = fingertips(&HandPose::of(gesture));
            let straight = if gesture == Gesture::OpenHand { 0..5 } else { 1..3 };
            for pair in tips[straight].windows(2) {
                let gap = (pair[0] - pair[1]).norm();
                assert!((0.028..0.11).contains(&gap), "{gesture:?}: {gap} m");
            }
        }
    }

    #[test]
    fn a_change_of_gesture_is_a_movement() {
        let (a, b) = (HandPose::of(Gesture::Fist), HandPose::of(Gesture::OpenHand));
        assert_eq!(HandPose::blend(&a, &b, 0.0), a);
        assert_eq!(HandPose::blend(&a, &b, 1.5), b);
        for step in 0..100 {
            let at = |i: i32| fingertips(&HandPose::blend(&a, &b, f64::from(i) / 100.0));
            for (before, after) in at(step).iter().zip(at(step + 1)) {
                assert!(
                    (before - after).norm() < 0.006,
                    "a hundredth of the way moves a tip {before} to {after}"
                );
            }
        }
    }

    #[test]
    fn the_camera_sees_the_tips_where_they_are_and_in_the_colour_of_skin() {
        let camera = PinholeCamera { width: 320, height: 240, focal: 257.5, center: [159.5, 119.5] };
        // The back of the hand, its fingers up in the picture.
        let viewpoint =
            Viewpoint::look_at(camera, Vector3::new(0.0, -0.6, 1.03), Vector3::new(0.0, 0.0, 1.03));
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let scene_from_hand = Isometry3::from_parts(Translation3::new(0.0, 0.0, 1.0), turn);
        for (gesture, straight) in [(Gesture::OpenHand, 1..5), (Gesture::PointTwo, 1..3)] {
            let scene = VisibleScene::new(hand_shapes(&HandPose::of(gesture), &scene_from_hand));
            let seen = render(&scene, &viewpoint);
            let tips = fingertips(&HandPose::of(gesture));
            for finger in straight {
                let tip = viewpoint.scene_from_camera.inverse() * scene_from_hand * tips[finger];
                let at = camera.project(&tip).unwrap();
                let (u, v) = (at.x.round() as u32, at.y.round() as u32);
                let depth = f64::from(seen.depth.data[(v * 320 + u) as usize]);
                assert!(
                    (depth - (tip.z - tip_radius(finger))).abs() < 0.002,
                    "{gesture:?} {finger}: {depth} {tip}"
                );
                let [r, g, b] = seen.image.pixel(u, v).map(f64::from);
                assert!((g / r - 0.757).abs() < 0.03 && (b / r - 0.605).abs() < 0.03, "{r} {g} {b}");
            }
        }
    }

    #[test]
    fn the_landmarks_hold_the_hand() {
        for gesture in Gesture::ALL {
            let pose = HandPose::of(gesture);
            let landmarks = landmarks(&pose);
            assert_eq!(landmarks.len(), 2 * (4 + 5 * 3));
            for tip in fingertips(&pose) {
                assert!(landmarks.iter().any(|(ball, _)| (ball - tip).norm() < 1e-12));
            }
        }
    }
}
