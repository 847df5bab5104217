//! Conversion between the frames of providers and the stereo frames that skills and trackers use.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;

use super::{
    ImageProvider, PixelFormat, PixelOwner, Pixels, ProviderDescription, RawFrame, RawImage, StereoPair,
};
use crate::camera::StereoCalibration;
use crate::frame::{ImageError, SharedImage, StereoFrame};
use crate::image_source::ImageSource;

/// An [`ImageSource`] as a provider. Pixels are not copied; depth is.
pub struct StereoProvider {
    source: Arc<dyn ImageSource>,
    description: ProviderDescription,
    count: AtomicU64,
}

/// A provider of stereo pairs as an [`ImageSource`].
pub struct StereoView {
    provider: Arc<dyn ImageProvider>,
    pair: StereoPair,
}

impl PixelOwner for SharedImage {
    fn bytes(&self) -> &[u8] {
        self.data()
    }
}

impl StereoProvider {
    /// A provider of the frames of `source`; `frame_id` names the left camera's coordinate frame.
    pub fn new(source: Arc<dyn ImageSource>, frame_id: &str) -> Self {
        let description = ProviderDescription::of_stereo(source.name(), frame_id, &source.calibration());
        Self { source, description, count: AtomicU64::new(0) }
    }
}

#[async_trait]
impl ImageProvider for StereoProvider {
    fn description(&self) -> ProviderDescription {
        self.description.clone()
    }

    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let stereo = self.source.next().await?;
        let number = self.count.fetch_add(1, Ordering::Relaxed) + 1;
        frame_of(&stereo, number, &self.description.frame_id).map(Arc::new)
    }
}

/// Converts a stereo frame to a provider's frame. Pixels are not copied; depth is.
///
/// # Errors
/// [`ImageError::Size`] when an image is empty or larger than frames can be.
pub fn frame_of(stereo: &StereoFrame, number: u64, frame_id: &str) -> Result<RawFrame, ImageError> {
    let eye = |role: &str, image: &SharedImage| {
        let pixels = Pixels::part(Arc::new(image.clone()), 0, image.data().len());
        let pixels = pixels.expect("an image has its own bytes");
        RawImage::new(role, PixelFormat::Rgb8, (image.width(), image.height()), pixels)
    };
    let mut images = vec![eye("left", &stereo.left)?, eye("right", &stereo.right)?];
    if let Some(depth) = &stereo.depth {
        let bytes: Vec<u8> = depth.data.iter().flat_map(|z| z.to_le_bytes()).collect();
        images.push(RawImage::new("depth", PixelFormat::Depth32F, (depth.width, depth.height), bytes)?);
    }
    Ok(RawFrame {
        number,
        stamp_ns: stereo.stamp_ns,
        frame_id: frame_id.into(),
        root_from_camera: Some(stereo.root_from_left),
        images,
    })
}

impl StereoView {
    /// The stereo pairs of a provider.
    ///
    /// # Errors
    /// [`ImageError::Spoilt`] when it is not calibrated as a pair of identical, parallel cameras.
    pub fn new(provider: Arc<dyn ImageProvider>) -> Result<Self, ImageError> {
        let described = provider.description();
        match StereoPair::of(&described) {
            Ok(pair) => Ok(Self { provider, pair }),
            Err(error) => Err(ImageError::Spoilt { provider: described.name, what: error.to_string() }),
        }
    }
}

#[async_trait]
impl ImageSource for StereoView {
    fn name(&self) -> &str {
        self.pair.provider()
    }

    fn calibration(&self) -> StereoCalibration {
        self.pair.calibration()
    }

    /// Skips frames that are damaged, no pair of the calibration's size, or overwritten while they were copied.
    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        loop {
            let frame = match self.provider.next().await {
                Ok(frame) => Some(frame),
                Err(ImageError::Spoilt { .. }) => None,
                Err(error) => return Err(error),
            };
            let stereo = frame.as_ref().and_then(|frame| self.pair.frame(frame).ok());
            if let Some(stereo) = stereo.filter(|_| frame.is_some_and(|frame| frame.is_intact())) {
                return Ok(Arc::new(stereo));
            }
            // A provider that fails repeatedly must not starve other tasks.
            tokio::task::yield_now().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{CALIBRATION, TestCamera, frame_with_depth, table};

    #[tokio::test(start_paused = true)]
    async fn there_and_back_again_is_the_same_frame() {
        let frame = frame_with_depth(&[table([150, 115, 80])], 0, 1);
        let provider = Arc::new(StereoProvider::new(TestCamera::of(frame.clone(), 2, None), "camera_left"));
        let given = provider.next().await.unwrap();
        assert_eq!((given.number, given.stamp_ns, given.frame_id.as_str()), (1, 0, "camera_left"));
        let view = StereoView::new(provider).unwrap();
        assert_eq!((view.name(), view.calibration()), ("camera", CALIBRATION));
        assert_eq!(*view.next().await.unwrap(), StereoFrame { stamp_ns: 1, ..frame });
    }
}
