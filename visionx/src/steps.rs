//! The trackers as processors: a [`StereoStep`] works on one provider of stereo pairs, and [`OfStereo`] turns it
//! into an [`ImageProcessor`].

use std::sync::Arc;

use crate::annotate;
use crate::frame::{ImageError, RgbImage, StereoFrame};
use crate::localizer::ObjectLocalizer;
use crate::marker::ColorMarkerObjectTracking;
use crate::processor::{ImageFinding, ImageProcessor};
use crate::providers::{RawFrame, StereoPair};
use crate::tabletop::TabletopSegmentation;
use crate::tracking::FingerTipTracking;
use crate::tracking::hand::HandObserver;

/// A processor of one provider of stereo pairs.
pub trait StereoStep: Send {
    /// Its name.
    fn name(&self) -> &str;
    /// What a frame lacks for this step, as a message for people; `None` when it is complete.
    fn missing_input(&self, frame: &RawFrame) -> Option<String> {
        let _ = frame;
        None
    }
    /// Processes a frame.
    fn step(&mut self, frame: &StereoFrame) -> ImageFinding;
}

/// Turns a [`StereoStep`] into an [`ImageProcessor`].
pub struct OfStereo<S> {
    step: S,
    pair: StereoPair,
}

impl<S: StereoStep> OfStereo<S> {
    /// A processor of these pairs; `step` was made with their calibration.
    pub fn new(step: S, pair: StereoPair) -> Self {
        Self { step, pair }
    }
}

impl<S: StereoStep> ImageProcessor for OfStereo<S> {
    fn name(&self) -> &str {
        self.step.name()
    }

    fn process(&mut self, frames: &[Arc<RawFrame>]) -> Result<ImageFinding, ImageError> {
        let [frame, ..] = frames else {
            return Err(ImageError::Spoilt { provider: self.name().into(), what: "no frame".into() });
        };
        if let Some(what) = self.step.missing_input(frame) {
            return Err(ImageError::Spoilt { provider: self.pair.provider().into(), what });
        }
        Ok(self.step.step(&self.pair.frame(frame)?))
    }

    fn annotated(&self, frames: &[Arc<RawFrame>], finding: &ImageFinding) -> Option<RgbImage> {
        let mut image = self.pair.frame(frames.first()?).ok()?.left;
        finding.draw(&mut image);
        Some(image)
    }
}

impl ImageFinding {
    /// Draws the finding into the left image.
    pub fn draw(&self, image: &mut RgbImage) {
        match self {
            Self::Marker(marker) => marker.iter().for_each(|marker| annotate::marker(image, marker)),
            Self::Object(object) => object.iter().for_each(|object| annotate::object(image, object)),
            Self::Hand(hand) => hand.iter().for_each(|hand| annotate::hand(image, hand)),
            Self::Tabletop(seen) => {
                let objects = seen.iter().flat_map(|seen| &seen.objects);
                objects.for_each(|o| annotate::region(image, &o.bounding_box, [255, 0, 255]));
            }
            Self::Fingertips(tips) => {
                tips.iter().for_each(|tip| annotate::circle(image, &tip.px, tip.radius, [255, 0, 255]));
            }
        }
    }
}

impl StereoStep for ColorMarkerObjectTracking {
    fn name(&self) -> &str {
        "marker"
    }

    fn step(&mut self, frame: &StereoFrame) -> ImageFinding {
        ImageFinding::Marker(self.update(frame))
    }
}

impl StereoStep for ObjectLocalizer {
    fn name(&self) -> &str {
        "object"
    }

    fn step(&mut self, frame: &StereoFrame) -> ImageFinding {
        ImageFinding::Object(self.localize(frame))
    }
}

impl StereoStep for TabletopSegmentation {
    fn name(&self) -> &str {
        "tabletop"
    }

    fn missing_input(&self, frame: &RawFrame) -> Option<String> {
        self.missing_input(frame)
    }

    fn step(&mut self, frame: &StereoFrame) -> ImageFinding {
        ImageFinding::Tabletop(self.segment(frame))
    }
}

impl StereoStep for HandObserver {
    fn name(&self) -> &str {
        "hand"
    }

    fn step(&mut self, frame: &StereoFrame) -> ImageFinding {
        ImageFinding::Hand(self.update(frame))
    }
}

impl StereoStep for FingerTipTracking {
    fn name(&self) -> &str {
        "fingertips"
    }

    fn step(&mut self, frame: &StereoFrame) -> ImageFinding {
        ImageFinding::Fingertips(self.update(frame))
    }
}
