//! Images, camera models, providers and processors, tracking and gestures.
//!
//! - [`RgbImage`], [`DepthImage`], [`StereoFrame`]: the trackers' input. [`ImageSource`]: hands frames to skills.
//! - [`providers`]: frames of any format from cameras, files, recordings and other processes, and how they are
//!   published.
//! - [`PinholeCamera`], [`StereoCalibration`]: from pixels to points; [`EpipolarCheck`]: checks a calibration.
//! - [`ColorModel`], [`Mask`], [`components`]: colour segmentation and connected components.
//! - [`ColorMarkerObjectTracking`]: tracks an object of known colour. [`ObjectLocalizer`]: the pose of a box of known
//!   colour and size. [`TabletopSegmentation`]: a table and the objects on it.
//!   [`EnvironmentModel`]: tables, shelves, walls and the floor, fused over time. [`HandObserver`]: a person's hand, its
//!   gesture and where it points.
//! - [`segmentation`]: unknown things on a table, told apart by what moves together. [`TouchStep`], [`SlipStep`]: that the own hand touches
//!   something, and that what it holds slips.
//! - [`BodyObserver`]: a person's head, shoulders, elbows and wrists.
//! - [`tracking`]: fingertips in streams and in single photographs. [`files`]: images from files and folders.
//! - [`ImageProcessor`], [`ResultSink`], [`run_processor`]: from streams of frames to a stream of results.
//!   [`StereoStep`]: a tracker as a processing step. [`Sight`]: such a step at work on the pairs of this process.
//! - [`annotate`]: draws results into images.
//!
//! This room knows no robot and no memory: results are plain values in the camera's frame, or in the root frame
//! through the pose that comes with the frame.

pub mod annotate;
mod camera;
mod color;
mod components;
mod counter;
mod distance;
mod environment;
mod epipolar;
pub mod files;
mod frame;
mod image_source;
mod joined;
mod jpeg;
mod localizer;
mod marker;
mod mask;
mod minimize;
pub mod network;
mod outline;
mod own_part;
mod particles;
mod people;
mod plane;
mod points;
mod processor;
pub mod providers;
mod rectangle;
#[cfg(test)]
mod scenes;
pub mod segmentation;
mod sight;
mod steps;
mod tabletop;
mod tabletop_step;
mod touch;
pub mod tracking;

pub use camera::{PinholeCamera, StereoCalibration};
pub use color::ColorModel;
pub use components::{Component, components};
pub use counter::{Counter, Latency};
pub use environment::{BulkEstimate, EnvironmentModel, EnvironmentStep, SurfaceEstimate};
pub use epipolar::EpipolarCheck;
pub use frame::{DepthImage, ImageError, RgbImage, SharedImage, StereoFrame};
pub use image_source::ImageSource;
pub use joined::JoinedImages;
pub use jpeg::{JPEG_QUALITY, JpegPixel, encode_jpeg};
pub use localizer::{ObjectEstimate, ObjectLocalizer};
pub use marker::{ColorMarkerObjectTracking, MarkerEstimate};
pub use mask::{Mask, PixelRun, Region};
pub use own_part::OwnPart;
pub use people::{BodyJoint, BodyObservation, BodyObserver, PeopleStep, SeenJoint};
pub use processor::{
    ImageProcessor, ProcessorLoop, ProcessorStatistics, ResultSink, Seen, SeenBy, Trigger, Workers,
    run_processor,
};
pub use providers::rectify::Rectification;
pub use sight::{Sight, Sighting};
pub use steps::{FingertipStep, HandStep, MarkerStep, ObjectStep, OfStereo, StereoStep};
pub use tabletop::{TableEstimate, TableObject, Tabletop, TabletopSegmentation};
pub use tabletop_step::{FloorStep, TabletopStep};
pub use touch::{OwnFinger, OwnHand, SlipStep, TouchStep, TouchedTable};
pub use tracking::hand::{Fingertip, Gesture, HandDetection, HandObservation, HandObserver};
