//! The 21 landmarks of a hand in a square of an image.

use std::array::from_fn;

use nalgebra::{Const, OPoint, Point2, Point3, SVector, Vector2};

use super::square::{Outside, Square};
use crate::frame::RgbImage;
use crate::mask::Region;
use crate::network::Network;

/// The network's outputs: places in the square, whether there is a hand, places in metres.
pub(super) const OUTPUTS: [&str; 3] = ["Identity", "Identity_1", "Identity_3"];
/// Width of the network's input, px.
const INPUT: usize = 224;
/// Least presence of a hand.
const LEAST_PRESENCE: f32 = 0.5;
/// How far the skin reaches beyond the landmarks, palm radii: half of a finger's width.
const FLESH: f64 = 0.22;
/// The landmarks that hardly move when a hand opens or closes.
const STEADY: [usize; 12] = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18];
/// The side of the square for the next image, and how far it lies towards the fingers, relative to the steady landmarks.
const SIDE: f64 = 2.0;
const SHIFT: f64 = 0.1;

/// How far the end of a finger is beyond its last landmark, relative to the piece before it. Of the pointing fingers in photographs it is
/// 0.29 of that piece beyond a straight one and 0.52 beyond a bent one; of rendered fingers about 0.15.
const BEYOND: f64 = 0.25;
/// The landmarks around the palm: its heel, which counts twice as it is the whole lower edge, the base of the thumb and the four knuckles.
const PALM: [usize; 7] = [0, 0, 1, 5, 9, 13, 17];

/// The joints of a hand: the wrist (0), then from its base to its tip the thumb (1 to 4), the index (5 to 8), middle (9 to 12), ring
/// (13 to 16) and little finger (17 to 20).
#[derive(Clone, Debug, PartialEq)]
pub struct HandLandmarks {
    /// In the image, px.
    pub points: [Point2<f64>; Self::COUNT],
    /// About the hand's own centre, m, for a hand of usual size: x to the right of the image, y downwards, z away from the camera.
    pub in_hand: [Point3<f64>; Self::COUNT],
    /// Probability that this is a hand, 0.5 to 1.
    pub presence: f64,
}

/// The hand in a square, `None` where there is none.
pub(super) fn in_square(network: &mut Network, image: &RgbImage, square: &Square) -> Option<HandLandmarks> {
    let input = square.sample(image, INPUT, Outside::Nearest);
    let outputs = network.run(&input);
    let [places, presence, metres] = outputs[..] else { return None };
    let presence = *presence.first().filter(|presence| **presence >= LEAST_PRESENCE)?;
    let triple = |values: &[f32], i: usize| -> Option<[f64; 3]> {
        values.get(3 * i..3 * i + 3)?.try_into().ok().map(|v: [f32; 3]| v.map(f64::from))
    };
    let mut points = [Point2::origin(); HandLandmarks::COUNT];
    let mut in_hand = [Point3::origin(); HandLandmarks::COUNT];
    for i in 0..HandLandmarks::COUNT {
        let ([x, y, _], [u, v, depth]) = (triple(places, i)?, triple(metres, i)?);
        points[i] = square.in_image(x / INPUT as f64, y / INPUT as f64);
        let across: Vector2<f64> = square.right() * u + square.down * v;
        in_hand[i] = Point3::new(across.x, across.y, depth);
    }
    let finite = points.iter().all(|p| p.coords.amax().is_finite());
    (finite && in_hand.iter().all(|p| p.coords.amax().is_finite())).then_some(HandLandmarks {
        points,
        in_hand,
        presence: f64::from(presence),
    })
}

impl HandLandmarks {
    /// Number of landmarks.
    pub(crate) const COUNT: usize = 21;
    /// The fingers from knuckle to tip: thumb, index, middle, ring and little finger.
    pub(crate) const FINGERS: [[usize; 4]; 5] =
        [[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12], [13, 14, 15, 16], [17, 18, 19, 20]];

    /// The square in which the hand is expected in the next image; `None` where the hand has no size.
    pub(super) fn square(&self) -> Option<Square> {
        let [index, middle, ring] = [5, 9, 13].map(|i| self.points[i]);
        let knuckles = nalgebra::center(&nalgebra::center(&index, &ring), &middle);
        let down = (self.points[0] - knuckles).try_normalize(1e-6)?;
        let upright = Square { center: Point2::origin(), side: 1.0, down };
        let turned = |i: usize| {
            Point2::new(self.points[i].coords.dot(&upright.right()), self.points[i].coords.dot(&down))
        };
        let (mut low, mut high) = (turned(0), turned(0));
        for i in STEADY {
            (low, high) = (low.inf(&turned(i)), high.sup(&turned(i)));
        }
        let size = high - low;
        let middle = nalgebra::center(&low, &high);
        let center = Point2::from(upright.right() * middle.x + down * (middle.y - SHIFT * size.y));
        Some(Square { center, side: SIDE * size.max(), down }).filter(|square| square.side >= 1.0)
    }

    /// The middle of the palm, and about the radius of the largest disc in it, px.
    #[must_use]
    pub fn palm(&self) -> (Point2<f64>, f64) {
        // Seen from the side a palm is narrow, seen from its end it is short.
        let across = (self.points[5] - self.points[17]).norm();
        let along = (self.points[0] - self.points[9]).norm();
        (middle_of(&self.points), (0.55 * across).max(0.42 * along).max(1.0))
    }

    /// The palm's middle about the hand's own centre, m.
    pub(crate) fn palm_in_hand(&self) -> Point3<f64> {
        middle_of(&self.in_hand)
    }

    /// Bounding box of a hand with this radius of the palm.
    pub(crate) fn bounds(&self, palm_radius: f64, image: &RgbImage) -> Region {
        Region::around(self.points.iter().copied(), FLESH * palm_radius, image.width(), image.height())
    }

    /// The end of a finger, px.
    pub(crate) fn fingertip(&self, [_, _, joint, tip]: [usize; 4]) -> Point2<f64> {
        self.points[tip] + (self.points[tip] - self.points[joint]) * BEYOND
    }

    /// The chains of joints from the wrist to the tip of each finger but the thumb, m.
    pub(super) fn chains(&self) -> [[Point3<f64>; 5]; 4] {
        let [_, fingers @ ..] = Self::FINGERS;
        fingers.map(|finger| from_fn(|i| self.in_hand[if i == 0 { 0 } else { finger[i - 1] }]))
    }
}

/// The middle of the palm.
fn middle_of<const D: usize>(
    landmarks: &[OPoint<f64, Const<D>>; HandLandmarks::COUNT],
) -> OPoint<f64, Const<D>> {
    let around = PALM.map(|i| landmarks[i].coords);
    OPoint::from(around.iter().sum::<SVector<f64, D>>() / around.len() as f64)
}
