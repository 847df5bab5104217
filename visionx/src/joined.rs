//! Frames joined with where the camera was at their time: a picture arrives later than it was taken, and the head may have
//! turned meanwhile. It reads no pixels.

use std::sync::Arc;
use std::time::Duration;

use armarium_values::Frame;
use armarium_values::transforms::{TransformError, Transforms};
use async_trait::async_trait;
use nalgebra::Isometry3;
use parking_lot::RwLock;

use crate::camera::StereoCalibration;
use crate::frame::{ImageError, StereoFrame};
use crate::image_source::ImageSource;

/// How often and how many times it is asked again for a pose that may still come.
const PAUSE: Duration = Duration::from_millis(1);
const QUESTIONS: u32 = 100;
/// Poses that differ by less, m and rad, are one: the picture need not be copied.
const SAME: f64 = 1e-9;

/// A source of frames whose camera poses come from a buffer of transforms.
pub struct JoinedImages {
    source: Arc<dyn ImageSource>,
    transforms: Arc<RwLock<Transforms>>,
    camera: Frame,
}

impl JoinedImages {
    /// The frames of `source`, whose left camera is at the frame `camera`.
    pub fn new(source: Arc<dyn ImageSource>, transforms: &Arc<RwLock<Transforms>>, camera: Frame) -> Self {
        Self { source, transforms: Arc::clone(transforms), camera }
    }

    /// Where the left camera was, in the root frame; waits up to 0.1 s for what is to come.
    async fn pose(&self, stamp_ns: u64) -> Result<Isometry3<f64>, TransformError> {
        for _ in 0..QUESTIONS {
            let found = self.transforms.read().transform(&Frame::root(), &self.camera, stamp_ns);
            match found {
                Err(TransformError::NotYet { .. }) => tokio::time::sleep(PAUSE).await,
                known => return known,
            }
        }
        self.transforms.read().transform(&Frame::root(), &self.camera, stamp_ns)
    }
}

#[async_trait]
impl ImageSource for JoinedImages {
    fn name(&self) -> &str {
        self.source.name()
    }

    fn calibration(&self) -> StereoCalibration {
        self.source.calibration()
    }

    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        let (frame, root_from_left) = loop {
            let frame = self.source.next().await?;
            match self.pose(frame.stamp_ns).await {
                Ok(pose) => break (frame, pose),
                // One frame is lost; later ones may be joined.
                Err(error @ (TransformError::TooOld { .. } | TransformError::NotYet { .. })) => {
                    tracing::warn!("a frame of `{}` is left out: {error}", self.name());
                }
                Err(error) => {
                    let what = format!("a frame of which it is not known where the camera was: {error}");
                    return Err(ImageError::Spoilt { provider: self.name().to_owned(), what });
                }
            }
        };
        let off = frame.root_from_left.inverse() * root_from_left;
        if off.translation.vector.norm() < SAME && off.rotation.angle() < SAME {
            return Ok(frame);
        }
        Ok(Arc::new(StereoFrame { root_from_left, ..StereoFrame::clone(&frame) }))
    }
}
