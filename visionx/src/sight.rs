//! A processor at work on the stereo pairs of this process: it takes each new frame as soon as it has done the last, and keeps
//! what it observed for whoever started it. It knows no memory; who reads it passes on what is to be remembered.

use std::sync::Arc;

use armarium_values::{Frame, Observation, Search};
use nalgebra::Isometry3;
use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::frame::ImageError;
use crate::image_source::ImageSource;
use crate::processor::Workers;
use crate::steps::{StereoStep, observations_of, search_of};

/// What a processor observed in one frame, in the root frame.
#[derive(Clone, Debug)]
pub struct Sighting {
    /// The time of the frame, ns.
    pub stamp_ns: u64,
    /// Where the left camera was.
    pub root_from_left: Isometry3<f64>,
    /// What was observed.
    pub observations: Vec<Observation>,
    /// What was looked for, and where that would have been seen.
    pub search: Option<Search>,
}

impl Sighting {
    /// The first observation of a class.
    pub fn of_class(&self, class: &str) -> Option<&Observation> {
        self.observations.iter().find(|seen| seen.class == class)
    }
}

type Newest = Option<Result<Arc<Sighting>, ImageError>>;

/// A processor that works until this is dropped.
pub struct Sight {
    newest: watch::Receiver<Newest>,
    task: JoinHandle<()>,
}

impl Sight {
    /// Starts a processor of these images; frames are made while it works.
    pub fn start(images: &Arc<dyn ImageSource>, step: impl StereoStep + 'static, workers: Workers) -> Self {
        let (sender, newest) = watch::channel(None);
        let (images, calibration) = (Arc::clone(images), images.calibration());
        let task = tokio::spawn(async move {
            let mut step = step;
            loop {
                let frame = match images.next().await {
                    Ok(frame) => frame,
                    Err(error) => {
                        let ended = matches!(error, ImageError::Gone { .. });
                        if sender.send(Some(Err(error))).is_err() || ended {
                            return;
                        }
                        // A source that fails repeatedly must not starve other tasks.
                        tokio::task::yield_now().await;
                        continue;
                    }
                };
                let sighting;
                (step, sighting) = workers
                    .work(step, move |step| {
                        let observations = observations_of(step, &frame, &Frame::root());
                        let (stamp_ns, root_from_left) = (frame.stamp_ns, frame.root_from_left);
                        let search = search_of(step, &frame, &calibration);
                        Sighting { stamp_ns, root_from_left, observations, search }
                    })
                    .await;
                if sender.send(Some(Ok(Arc::new(sighting)))).is_err() {
                    return;
                }
            }
        });
        Self { newest, task }
    }

    /// What was observed since the last call, if there was a frame.
    ///
    /// # Errors
    /// Why there are no frames.
    pub fn newest(&mut self) -> Result<Option<Arc<Sighting>>, ImageError> {
        if !self.newest.has_changed().unwrap_or(false) {
            return Ok(None);
        }
        self.newest.borrow_and_update().clone().transpose()
    }

    /// Waits for the next frame.
    ///
    /// # Errors
    /// Why there is none.
    pub async fn next(&mut self) -> Result<Arc<Sighting>, ImageError> {
        let gone = || ImageError::Gone { provider: String::new() };
        self.newest.changed().await.map_err(|_| gone())?;
        self.newest.borrow_and_update().clone().unwrap_or_else(|| Err(gone()))
    }
}

impl Drop for Sight {
    fn drop(&mut self) {
        self.task.abort();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{CALIBRATION, TestCamera};
    use crate::steps::HandStep;
    use crate::tracking::hand::HandObserver;

    #[tokio::test(start_paused = true)]
    async fn each_frame_is_told_once_and_what_is_wrong_with_it() {
        let images: Arc<dyn ImageSource> = TestCamera::new(5, Some(2));
        let mut sight = Sight::start(&images, HandStep::new(HandObserver::new(CALIBRATION)), Workers::Joined);
        let mut told = Vec::new();
        for _ in 0..7 {
            told.push(sight.next().await.map(|seen| (seen.stamp_ns, seen.observations.len())));
        }
        let spoilt = ImageError::Spoilt { provider: "camera".into(), what: "nothing".into() };
        let frames = [Ok((0, 1)), Ok((1, 1)), Err(spoilt), Ok((3, 1)), Ok((4, 1))];
        assert_eq!(told[..5], frames);
        assert!(told[5..].iter().all(|end| matches!(end, Err(ImageError::Gone { .. }))), "{told:?}");
        assert!(sight.newest().unwrap().is_none());
    }
}
