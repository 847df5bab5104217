//! What finds a hand in one image of an unknown camera, and what it says about it.

use nalgebra::Point2;

use super::learned::HandLandmarks;
use super::recognizer::SeenFinger;
use super::skin::SkinSegmentation;
use crate::frame::RgbImage;
use crate::mask::Region;
use crate::tracking::hand::Fingertip;

/// Finds the hand in images.
pub trait HandDetector: Send {
    /// The hand in an image, `None` where there is none.
    fn find(&mut self, image: &RgbImage) -> Option<HandInPicture>;
}

/// A hand in one image.
#[derive(Clone, Debug)]
pub struct HandInPicture {
    /// Bounding box in the image.
    pub bounding_box: Region,
    /// Centre of the palm, px of the image.
    pub palm: Point2<f64>,
    /// Radius of the largest disc in the palm, px of the image.
    pub palm_radius: f64,
    /// Stretched fingers in order around the palm, px of the image.
    pub fingertips: Vec<Fingertip>,
    /// Possible stretched fingers, as input of a [`super::GestureRecognizer`].
    pub fingers: Vec<SeenFinger>,
    /// The gesture's name; `None` where the hand shows none that is known.
    pub gesture: Option<String>,
    /// Confidence that this is a hand with this gesture, 0 to 1.
    pub confidence: f64,
    /// Where it is in detail.
    pub outline: HandOutline,
}

/// What a detector has seen of a hand.
#[derive(Clone, Debug)]
pub enum HandOutline {
    /// Its pixels.
    Silhouette(SkinSegmentation),
    /// Its joints.
    Landmarks(Box<HandLandmarks>),
}
