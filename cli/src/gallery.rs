//! A few camera images of the run for the report, and what is seen in them.
//!
//! The gallery stands between the cameras and the skills and keeps a frame every few seconds of those that are made
//! anyway; it never asks for one.

use std::sync::{Arc, Mutex};

use armarium_viewer::report::Picture;
use armarium_visionx::{
    Gesture, HandObserver, Image, ImageError, ImageSource, StereoCalibration, StereoFrame, annotate,
};
use async_trait::async_trait;

use crate::recording::locked;

/// Frames are at least this far apart, ns.
const APART_NS: u64 = 4_000_000_000;
/// Frames that are kept; later ones replace every second one.
const MOST: usize = 24;

/// Keeps some of the frames that pass.
pub(crate) struct Gallery {
    cameras: Arc<dyn ImageSource>,
    kept: Mutex<Vec<Arc<StereoFrame>>>,
}

impl Gallery {
    /// A gallery of what the cameras give.
    pub(crate) fn of(cameras: Arc<dyn ImageSource>) -> Self {
        Self { cameras, kept: Mutex::new(Vec::new()) }
    }

    fn look(&self, frame: &Arc<StereoFrame>) {
        let mut kept = locked(&self.kept);
        let due = kept.last().is_none_or(|last| frame.stamp_ns >= last.stamp_ns + APART_NS);
        if !due {
            return;
        }
        if kept.len() >= MOST {
            let mut even = false;
            kept.retain(|_| {
                even = !even;
                even
            });
        }
        kept.push(Arc::clone(frame));
    }

    /// The pictures, with the coach's hand marked where it is seen; `state_at` names what the robot did then.
    pub(crate) fn pictures(&self, state_at: &dyn Fn(u64) -> String) -> Vec<Picture> {
        let calibration = self.cameras.calibration();
        let kept = locked(&self.kept);
        kept.iter().filter_map(|frame| picture(calibration, frame, state_at)).collect()
    }
}

fn picture(
    calibration: StereoCalibration,
    frame: &StereoFrame,
    state_at: &dyn Fn(u64) -> String,
) -> Option<Picture> {
    let mut image: Image = frame.left.clone();
    let hand = HandObserver::new(calibration).update(frame);
    let seen = hand.as_ref().map_or_else(String::new, |hand| {
        annotate::hand(&mut image, hand);
        let gesture: Gesture = hand.gesture;
        format!(" · a hand: {gesture}")
    });
    let caption = format!("{:.1} s · {}{seen}", frame.stamp_ns as f64 * 1e-9, state_at(frame.stamp_ns));
    Picture::jpeg(&image, caption).ok()
}

#[async_trait]
impl ImageSource for Gallery {
    fn name(&self) -> &str {
        self.cameras.name()
    }

    fn calibration(&self) -> StereoCalibration {
        self.cameras.calibration()
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let frame = self.cameras.next().await?;
        self.look(&frame);
        Ok(frame)
    }
}
