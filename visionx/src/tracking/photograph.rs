//! A hand in one image of an unknown camera by its colour: its palm, its stretched fingers and its gesture.
//!
//! [`SkinSegmentation`] segments the hand. Its distance is unknown, so its palm is assumed to have a typical size,
//! and all lengths are relative to it.

use nalgebra::{Point2, Vector2};

use super::detector::{HandDetector, HandInPicture, HandOutline};
use super::recognizer::GestureRecognizer;
use super::skin::SkinSegmentation;
use crate::components::largest;
use crate::distance::inside;
use crate::frame::RgbImage;
use crate::mask::{Mask, Region};
use crate::tracking::hand::Fingertip;
use crate::tracking::hand::shape::{Finger, HandShape, hand_shape};

/// Radius of the largest disc in a typical palm, m.
const PALM: f64 = 0.040;
/// Distance of the reported fingertip inside of the finger's measured end, m.
const PAD: f64 = 0.0022;
/// Largest distance of a hand's pixel from the palm's centre, palm radii; farther pixels are arm.
const REACH: f64 = 5.2;

/// Finds the hand by the colour of skin and its silhouette.
#[derive(Clone, Debug, Default)]
pub struct SkinHandDetector {
    recognizer: GestureRecognizer,
}

impl SkinHandDetector {
    /// A detector that knows gestures by these patterns.
    pub fn new(recognizer: GestureRecognizer) -> Self {
        Self { recognizer }
    }
}

impl HandDetector for SkinHandDetector {
    fn find(&mut self, image: &RgbImage) -> Option<HandInPicture> {
        let segmentation = SkinSegmentation::of(image)?;
        let (shape, hand, radius) = measured(&segmentation.mask)?;
        let pixel_m = PALM / radius;
        let scale = segmentation.scale;
        let place = |p: &Point2<f64>| Point2::from(p.coords * scale + Vector2::repeat((scale - 1.0) / 2.0));
        let fingertips = shape.fingers.iter().filter(|f| f.score > 0.5);
        let fingertips = fingertips
            .map(|f| Fingertip { px: place(&inside_end(f, pixel_m)), in_left: None, score: f.score })
            .collect();
        let fingers: Vec<_> = shape.fingers.iter().map(|f| f.seen(shape.palm_radius)).collect();
        let (gesture, sure) = self.recognizer.recognize(&fingers);
        let whole = Region::whole(image.width(), image.height());
        Some(HandInPicture {
            bounding_box: enlarged(&largest(&hand)?.bounds, scale, &whole),
            palm: place(&shape.palm),
            palm_radius: radius * scale,
            fingertips,
            fingers,
            gesture: Some(gesture),
            confidence: sure * segmentation.confidence,
            outline: HandOutline::Silhouette(segmentation),
        })
    }
}

/// The shape of a silhouette, assuming a typical palm; the silhouette without the arm, and the palm's radius, px.
pub(super) fn measured(mask: &Mask) -> Option<(HandShape, Mask, f64)> {
    let (palm, radius) = widest(mask)?;
    let hand = near(mask, &palm, REACH * radius);
    Some((hand_shape(&hand, PALM / radius)?, hand, radius))
}

/// The finger's pad, slightly inside of its end.
fn inside_end(finger: &Finger, pixel_m: f64) -> Point2<f64> {
    let back = (finger.base - finger.tip).try_normalize(1e-9).unwrap_or_default();
    finger.tip + back * (PAD / pixel_m)
}

/// The centre and the radius of the widest part of a mask, px.
fn widest(mask: &Mask) -> Option<(Point2<f64>, f64)> {
    let distances = inside(mask);
    let (i, radius) = distances.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let middle = Point2::new((i % mask.width()) as f64, (i / mask.width()) as f64);
    (*radius > 2.0).then_some((middle, f64::from(*radius)))
}

/// The part of a mask within `reach` px of a point.
fn near(mask: &Mask, middle: &Point2<f64>, reach: f64) -> Mask {
    let whole = mask.region();
    let region = Region::around([*middle], reach, whole.width, whole.height);
    let is_near = |(x, y)| (Point2::new(f64::from(x), f64::from(y)) - middle).norm() <= reach;
    let bit = |(x, y)| is_near((x, y)) && mask.contains(i64::from(x), i64::from(y));
    Mask::of(region, region.pixels().map(bit))
}

/// Scales a region of a reduced image to the full image.
fn enlarged(region: &Region, scale: f64, whole: &Region) -> Region {
    let [x0, y0] = [region.x, region.y].map(|v| f64::from(v) * scale);
    let [x1, y1] = [region.x + region.width, region.y + region.height].map(|v| f64::from(v) * scale - 1.0);
    Region::spanning(x0, y0, x1, y1, whole.width, whole.height)
}
