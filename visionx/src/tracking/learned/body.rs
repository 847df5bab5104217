//! Bodies of people found by networks that were trained on photographs: [`LearnedBodyDetector`].
//!
//! One network finds people in the whole image, another one 33 landmarks in the square around one of them. The networks are those of
//! MediaPipe (`visionx/models/NOTICE.md`); the pipeline around them follows it, except that shrinking averages pixels. It knows one
//! image of an unknown camera; where a body is in space is said by [`crate::people`].
//!
//! # Source
//! Bazarevsky et al. 2020, "BlazePose: On-device Real-time Body Pose tracking".

use std::sync::LazyLock;

use nalgebra::{Point2, Point3, Vector2};

use super::candidates::{self, Candidate, Detector};
use super::shipped;
use super::square::{Outside, Square};
use crate::frame::RgbImage;
use crate::network::{Network, sigmoid};

static PEOPLE: LazyLock<Network> =
    LazyLock::new(|| shipped(include_bytes!("../../../models/pose_detection.tflite"), &candidates::OUTPUTS));
static LANDMARKS: LazyLock<Network> =
    LazyLock::new(|| shipped(include_bytes!("../../../models/pose_landmark_full.tflite"), &OUTPUTS));

/// The outputs for landmarks: places in the square, whether there is a body, places in metres.
const OUTPUTS: [&str; 3] = ["Identity", "Identity_1", "Identity_4"];
/// The network looks at 2254 places.
const DETECTOR: Detector =
    Detector { input: 224, range: [-1.0, 1.0], grids: &[(28, 2), (14, 2), (7, 6)], least_score: 0.5 };
/// The sizes of the square in which the network sees an image, relative to the smallest around it. A body that fills an image is
/// found when it is shown smaller.
const SCALES: [f64; 2] = [1.0, 2.0];
/// Width of the input for landmarks, px.
const INPUT: usize = 256;
/// Number of landmarks of a body; two more say where it will be in the next image.
const COUNT: usize = 33;
const CENTER: usize = 33;
const EDGE: usize = 34;
/// Values of a landmark: x, y, z, visibility, presence.
const VALUES: usize = 5;
/// Least presence of a body.
const LEAST_PRESENCE: f32 = 0.5;
/// The side of the square around a body, relative to its circle's diameter.
const SIDE: f64 = 1.25;

/// A body in an image: face (0 to 10), shoulders (11, 12), elbows (13, 14), wrists (15, 16), hands (17 to 22), hips (23, 24), legs (25 to
/// 32); of pairs the left one has the odd number.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyLandmarks {
    /// In the image, px.
    pub points: [Point2<f64>; COUNT],
    /// About the middle of the hips, m, for a body of usual size: x to the right of the image, y downwards, z away from the camera.
    pub in_body: [Point3<f64>; COUNT],
    /// Probability that each is in the image and not hidden, 0 to 1.
    pub visible: [f64; COUNT],
    /// Probability that this is a body, 0.5 to 1.
    pub presence: f64,
    /// Where it is looked for in the next image.
    square: Option<Square>,
}

impl BodyLandmarks {
    /// The same with left and right exchanged, but for eyes and mouth.
    #[must_use]
    pub fn mirrored(mut self) -> Self {
        for left in (7..COUNT).step_by(2) {
            self.points.swap(left, left + 1);
            self.in_body.swap(left, left + 1);
            self.visible.swap(left, left + 1);
        }
        self
    }
}

/// Finds a body in the images of one camera: where it was, it is looked for first.
#[derive(Clone, Debug)]
pub struct LearnedBodyDetector {
    people: Network,
    landmarks: Network,
    /// Where the body is expected in the next image, and the size of the last one, px.
    expected: Option<(Square, [u32; 2])>,
}

impl Default for LearnedBodyDetector {
    fn default() -> Self {
        Self { people: PEOPLE.clone(), landmarks: LANDMARKS.clone(), expected: None }
    }
}

impl LearnedBodyDetector {
    /// The body in an image, `None` where there is none.
    pub fn find(&mut self, image: &RgbImage) -> Option<BodyLandmarks> {
        let size = [image.width(), image.height()];
        let expected = self.expected.take().filter(|(_, last)| *last == size);
        let followed = expected.and_then(|(square, _)| in_square(&mut self.landmarks, image, &square));
        let body = followed.or_else(|| self.search(image))?;
        self.expected = body.square.map(|square| (square, size));
        Some(body)
    }

    /// Forgets where the body was, so that it is searched for in the next image.
    pub fn forget(&mut self) {
        self.expected = None;
    }

    fn search(&mut self, image: &RgbImage) -> Option<BodyLandmarks> {
        let first = SCALES.iter().find_map(|scale| {
            let found = DETECTOR.find::<6>(&mut self.people, image, *scale);
            let squares = found.iter().filter_map(square);
            squares.take(1).find_map(|square| in_square(&mut self.landmarks, image, &square))
        })?;
        // A square around the landmarks fits the body better than one around where it was found.
        let again = first.square.and_then(|square| in_square(&mut self.landmarks, image, &square));
        Some(again.unwrap_or(first))
    }
}

/// The square around a person who was found: the first point is the middle of the hips, the second one on the circle around all.
fn square(person: &Candidate<6>) -> Option<Square> {
    around(person.place(2), person.place(3))
}

fn around(center: Point2<f64>, edge: Point2<f64>) -> Option<Square> {
    let down: Vector2<f64> = center - edge;
    Square { center, side: 2.0 * SIDE * down.norm(), down: down.try_normalize(1e-6)? }.usable()
}

/// The body in a square, `None` where there is none.
fn in_square(network: &mut Network, image: &RgbImage, square: &Square) -> Option<BodyLandmarks> {
    let input = square.sample(image, INPUT, Outside::Black);
    let outputs = network.run(&input);
    let [places, presence, metres] = outputs[..] else { return None };
    let presence = *presence.first().filter(|presence| **presence >= LEAST_PRESENCE)?;
    let places = places.as_chunks::<VALUES>().0;
    let point = |i: usize| -> Option<Point2<f64>> {
        let [x, y, ..] = *places.get(i)?;
        let [x, y] = [x, y].map(|at| f64::from(at) / INPUT as f64);
        Some(square.in_image(x, y)).filter(|point| point.coords.amax().is_finite())
    };
    let mut body = BodyLandmarks {
        points: [Point2::origin(); COUNT],
        in_body: [Point3::origin(); COUNT],
        visible: [0.0; COUNT],
        presence: f64::from(presence),
        square: around(point(CENTER)?, point(EDGE)?),
    };
    let landmarks = places.iter().zip(metres.as_chunks::<3>().0);
    for (i, ([.., visible, _], metres)) in landmarks.enumerate().take(COUNT) {
        body.points[i] = point(i)?;
        body.visible[i] = f64::from(sigmoid(*visible));
        let [u, v, depth] = metres.map(f64::from);
        let across: Vector2<f64> = square.right() * u + square.down * v;
        body.in_body[i] = Point3::new(across.x, across.y, depth);
    }
    body.in_body.iter().all(|p| p.coords.amax().is_finite()).then_some(body)
}
