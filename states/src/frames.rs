//! The newest camera frame, for a skill that also commands at the robot's rate.
//!
//! A task waits for frames, so that the skill does not have to; it ends with the skill.

use std::sync::Arc;

use armarium_runtime::skill::Failure;
use armarium_visionx::{ImageError, ImageSource, StereoFrame};
use tokio::sync::watch;
use tokio::task::JoinHandle;

type LatestFrame = Option<Result<Arc<StereoFrame>, ImageError>>;

/// A subscription to a camera; frames are produced while it lives.
pub(crate) struct Frames {
    newest: watch::Receiver<LatestFrame>,
    task: JoinHandle<()>,
}

impl Frames {
    /// The frames as they arrive.
    pub(crate) fn of(images: &Arc<dyn ImageSource>) -> Self {
        let (sender, newest) = watch::channel(None);
        let images = Arc::clone(images);
        let task = tokio::spawn(async move {
            loop {
                let frame = images.next().await;
                let ended = frame.is_err();
                if sender.send(Some(frame)).is_err() || ended {
                    return;
                }
            }
        });
        Self { newest, task }
    }

    /// The frame that arrived since the last call, if any.
    pub(crate) fn new_frame(&mut self) -> Result<Option<Arc<StereoFrame>>, Failure> {
        if !self.newest.has_changed().unwrap_or(false) {
            return Ok(None);
        }
        match &*self.newest.borrow_and_update() {
            None => Ok(None),
            Some(Ok(frame)) => Ok(Some(Arc::clone(frame))),
            Some(Err(error)) => Err(Failure::new(error.to_string())),
        }
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        self.task.abort();
    }
}
