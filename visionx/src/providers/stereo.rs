//! Between the frames of providers and the stereo frames that skills and trackers work with.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;
use nalgebra::Isometry3;

use super::convert::{depth_of, rgb_of};
use super::{Description, Frame, FrameImage, ImageProvider, PixelFormat, PixelOwner, Pixels};
use crate::camera::StereoCalibration;
use crate::frame::{ImageError, ImageSource, StereoFrame};

/// An [`ImageSource`] as a provider. Pixels are not copied; depth is.
pub struct StereoProvider {
    source: Arc<dyn ImageSource>,
    description: Description,
    count: AtomicU64,
}

/// A provider of stereo pairs as an [`ImageSource`].
pub struct StereoView {
    provider: Arc<dyn ImageProvider>,
    name: String,
    calibration: StereoCalibration,
    torn: AtomicU64,
}

/// One eye of a frame that is shared.
struct Eye {
    frame: Arc<StereoFrame>,
    right: bool,
}

impl PixelOwner for Eye {
    fn bytes(&self) -> &[u8] {
        if self.right { self.frame.right.data() } else { self.frame.left.data() }
    }
}

impl StereoProvider {
    /// A provider of what `source` gives; `frame_id` names the left camera's coordinate frame.
    #[must_use]
    pub fn new(source: Arc<dyn ImageSource>, frame_id: &str) -> Self {
        let description = Description::of_stereo(source.name(), frame_id, &source.calibration());
        Self { source, description, count: AtomicU64::new(0) }
    }
}

#[async_trait]
impl ImageProvider for StereoProvider {
    fn description(&self) -> Description {
        self.description.clone()
    }

    async fn next(&self) -> Result<Arc<Frame>, ImageError> {
        let stereo = self.source.next().await?;
        let number = self.count.fetch_add(1, Ordering::Relaxed) + 1;
        frame_of(&stereo, number, &self.description.frame_id).map(Arc::new)
    }
}

/// A stereo frame as a provider gives it. Pixels are not copied; depth is.
///
/// # Errors
/// [`ImageError::Size`] when an image is empty or larger than frames can be.
pub fn frame_of(stereo: &Arc<StereoFrame>, number: u64, frame_id: &str) -> Result<Frame, ImageError> {
    let eye = |role: &str, right: bool| {
        let image = if right { &stereo.right } else { &stereo.left };
        let owner: Arc<dyn PixelOwner> = Arc::new(Eye { frame: Arc::clone(stereo), right });
        let pixels = Pixels::part(owner, 0, image.data().len());
        let pixels = pixels.expect("an image has its own bytes");
        FrameImage::new(role, PixelFormat::Rgb8, (image.width(), image.height()), pixels)
    };
    let mut images = vec![eye("left", false)?, eye("right", true)?];
    if let Some(depth) = &stereo.depth {
        let bytes: Vec<u8> = depth.data.iter().flat_map(|z| z.to_le_bytes()).collect();
        images.push(FrameImage::new("depth", PixelFormat::Depth32F, (depth.width, depth.height), bytes)?);
    }
    Ok(Frame {
        number,
        stamp_ns: stereo.stamp_ns,
        frame_id: frame_id.into(),
        root_from_camera: Some(stereo.root_from_left),
        images,
    })
}

/// The stereo frame of a frame with the images `left` and `right`, and `depth` if there is one. A frame that does not
/// say where its camera is has it at the root.
///
/// # Errors
/// [`ImageError::Spoilt`] when an eye is missing.
pub fn stereo_frame(frame: &Frame, provider: &str) -> Result<StereoFrame, ImageError> {
    let spoilt = |what: String| ImageError::Spoilt { provider: provider.into(), what };
    let eye = |role: &str| {
        let image = frame.image(role).ok_or_else(|| spoilt(format!("a frame without the image `{role}`")))?;
        rgb_of(image).ok_or_else(|| spoilt(format!("the image `{role}` has no colours")))
    };
    Ok(StereoFrame {
        stamp_ns: frame.stamp_ns,
        left: eye("left")?,
        right: eye("right")?,
        depth: frame.image("depth").and_then(depth_of),
        root_from_left: frame.root_from_camera.unwrap_or_else(Isometry3::identity),
    })
}

impl StereoView {
    /// The stereo pairs of a provider.
    ///
    /// # Errors
    /// [`ImageError::Spoilt`] when it is not calibrated as a pair of equal, parallel cameras.
    pub fn new(provider: Arc<dyn ImageProvider>) -> Result<Self, ImageError> {
        let description = provider.description();
        let calibration = description.stereo();
        let calibration =
            calibration.map_err(|what| ImageError::Spoilt { provider: description.name.clone(), what })?;
        Ok(Self { provider, name: description.name, calibration, torn: AtomicU64::new(0) })
    }

    /// Frames that were taken away while they were copied.
    #[must_use]
    pub fn torn(&self) -> u64 {
        self.torn.load(Ordering::Relaxed)
    }
}

#[async_trait]
impl ImageSource for StereoView {
    fn name(&self) -> &str {
        &self.name
    }

    fn calibration(&self) -> StereoCalibration {
        self.calibration
    }

    /// A frame that is not a whole stereo pair is left out.
    async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
        loop {
            let frame = match self.provider.next().await {
                Ok(frame) => frame,
                Err(ImageError::Spoilt { .. }) => continue,
                Err(error) => return Err(error),
            };
            let stereo = stereo_frame(&frame, &self.name);
            match stereo {
                Ok(stereo) if frame.is_intact() => return Ok(Arc::new(stereo)),
                Ok(_) | Err(_) => self.torn.fetch_add(1, Ordering::Relaxed),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{CALIBRATION, frame_with_depth, table};

    struct Once(StereoFrame);

    #[async_trait]
    impl ImageSource for Once {
        fn name(&self) -> &str {
            "once"
        }

        fn calibration(&self) -> StereoCalibration {
            CALIBRATION
        }

        async fn next(&self) -> Result<Arc<StereoFrame>, ImageError> {
            Ok(Arc::new(self.0.clone()))
        }
    }

    #[tokio::test]
    async fn there_and_back_again_is_the_same_frame() {
        let frame = frame_with_depth(&[table([150, 115, 80])], 77, 1);
        let provider = Arc::new(StereoProvider::new(Arc::new(Once(frame.clone())), "camera_left"));
        let given = provider.next().await.unwrap();
        assert_eq!((given.number, given.stamp_ns, given.frame_id.as_str()), (1, 77, "camera_left"));
        let view = StereoView::new(provider).unwrap();
        assert_eq!((view.name(), view.calibration()), ("once", CALIBRATION));
        assert_eq!(*view.next().await.unwrap(), frame);
        assert_eq!(view.torn(), 0);
    }
}
