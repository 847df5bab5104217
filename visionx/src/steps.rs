//! The trackers as processors: a [`StereoStep`] works on one provider of stereo pairs, and [`OfStereo`] turns it
//! into an [`ImageProcessor`].

use std::sync::Arc;

use crate::annotate;
use crate::frame::{Image, ImageError, StereoFrame};
use crate::localizer::ObjectLocalizer;
use crate::marker::ColorMarkerObjectTracking;
use crate::processor::{Finding, ImageProcessor};
use crate::providers::{Frame, StereoPair};
use crate::tabletop::TabletopSegmentation;
use crate::tracking::FingerTipTracking;
use crate::tracking::hand::HandObserver;

/// A processor of one provider of stereo pairs.
pub trait StereoStep: Send {
    /// Its name.
    fn name(&self) -> &str;
    /// What a frame lacks for this step, as a message for people; `None` when it is complete.
    fn lacks(&self, frame: &Frame) -> Option<String> {
        let _ = frame;
        None
    }
    /// Processes a frame.
    fn step(&mut self, frame: &StereoFrame) -> Finding;
    /// Draws the finding into the left image.
    fn draw(&self, image: &mut Image, finding: &Finding);
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

    fn process(&mut self, frames: &[Arc<Frame>]) -> Result<Finding, ImageError> {
        let [frame, ..] = frames else {
            return Err(ImageError::Spoilt { provider: self.name().into(), what: "no frame".into() });
        };
        if let Some(what) = self.step.lacks(frame) {
            return Err(ImageError::Spoilt { provider: self.pair.provider().into(), what });
        }
        Ok(self.step.step(&self.pair.frame(frame)?))
    }

    fn annotated(&self, frames: &[Arc<Frame>], finding: &Finding) -> Option<Image> {
        let mut image = self.pair.frame(frames.first()?).ok()?.left;
        self.step.draw(&mut image, finding);
        Some(image)
    }
}

impl StereoStep for ColorMarkerObjectTracking {
    fn name(&self) -> &str {
        "marker"
    }

    fn step(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Marker(self.update(frame))
    }

    fn draw(&self, image: &mut Image, finding: &Finding) {
        if let Finding::Marker(Some(marker)) = finding {
            annotate::marker(image, marker);
        }
    }
}

impl StereoStep for ObjectLocalizer {
    fn name(&self) -> &str {
        "object"
    }

    fn step(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Object(self.localize(frame))
    }

    fn draw(&self, image: &mut Image, finding: &Finding) {
        if let Finding::Object(Some(object)) = finding {
            annotate::object(image, object);
        }
    }
}

impl StereoStep for TabletopSegmentation {
    fn name(&self) -> &str {
        "tabletop"
    }

    fn lacks(&self, frame: &Frame) -> Option<String> {
        self.lacks(frame)
    }

    fn step(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Tabletop(self.segment(frame))
    }

    fn draw(&self, image: &mut Image, finding: &Finding) {
        if let Finding::Tabletop(Some(seen)) = finding {
            seen.objects.iter().for_each(|o| annotate::region(image, &o.bounding_box, [255, 0, 255]));
        }
    }
}

impl StereoStep for HandObserver {
    fn name(&self) -> &str {
        "hand"
    }

    fn step(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Hand(self.update(frame))
    }

    fn draw(&self, image: &mut Image, finding: &Finding) {
        if let Finding::Hand(Some(hand)) = finding {
            annotate::hand(image, hand);
        }
    }
}

impl StereoStep for FingerTipTracking {
    fn name(&self) -> &str {
        "fingertips"
    }

    fn step(&mut self, frame: &StereoFrame) -> Finding {
        Finding::Fingertips(self.update(frame))
    }

    fn draw(&self, image: &mut Image, finding: &Finding) {
        if let Finding::Fingertips(tips) = finding {
            for tip in tips {
                annotate::circle(image, &tip.px, tip.radius, [255, 0, 255]);
            }
        }
    }
}
