//! A camera on Linux (V4L2): its JPEG, YUYV or gray images become RGB or gray frames. Needs the feature `camera`.
//!
//! A blocking thread of tokio waits for the driver; readers get the newest frame.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use async_trait::async_trait;
use linuxvideo::format::{PixFormat, PixelFormat as DriverFormat};
use linuxvideo::stream::ReadStream;
use linuxvideo::{BufType, Device};
use tokio::time::Instant;

use super::channel::{FrameChannel, FrameSender, channel};
use super::{ImageDescription, ImageProvider, PixelFormat, ProviderDescription, RawFrame, RawImage};
use crate::files::decode_image;
use crate::frame::ImageError;

/// Provides the frames of a camera.
#[derive(Debug)]
pub struct CameraProvider {
    frames: FrameChannel,
    ends: Arc<AtomicBool>,
}

/// The layout of the driver's bytes.
#[derive(Clone, Copy, Debug)]
struct Layout {
    coding: DriverFormat,
    width: u32,
    height: u32,
    bytes_per_line: usize,
}

impl CameraProvider {
    /// Opens `/dev/videoN` near the requested size; the driver chooses the nearest size that it has.
    ///
    /// # Errors
    /// The driver's error, or none of its formats is supported.
    pub fn open(device: &Path, name: &str, (width, height): (u32, u32)) -> io::Result<Self> {
        let camera = Device::open(device)?;
        let mut offered = Vec::new();
        for format in camera.formats(BufType::VIDEO_CAPTURE) {
            offered.push(format?.pixel_format());
        }
        let understood = [DriverFormat::YUYV, DriverFormat::MJPG, DriverFormat::JPEG];
        let coding = understood.into_iter().find(|format| offered.contains(format)).ok_or_else(|| {
            io::Error::new(
                io::ErrorKind::Unsupported,
                format!("the camera gives {offered:?}; YUYV or JPEG is needed"),
            )
        })?;
        let capture = camera.video_capture(PixFormat::new(width, height, coding))?;
        let given = capture.format();
        let layout = Layout {
            coding: given.pixel_format(),
            width: given.width(),
            height: given.height(),
            bytes_per_line: given.bytes_per_line() as usize,
        };
        let image = ImageDescription {
            role: "image".into(),
            format: PixelFormat::Rgb8,
            width: layout.width,
            height: layout.height,
            camera: None,
        };
        let (sender, frames) = channel(ProviderDescription {
            name: name.into(),
            about: format!("the camera {}", device.display()),
            frame_id: "camera".into(),
            rate_hz: None,
            images: vec![image],
        });
        let stream = capture.into_stream()?;
        let ends = Arc::new(AtomicBool::new(false));
        let (ended, device) = (Arc::clone(&ends), device.to_owned());
        tokio::task::spawn_blocking(move || watch(stream, layout, &sender, &ended, &device));
        Ok(Self { frames, ends })
    }
}

impl Drop for CameraProvider {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

#[async_trait]
impl ImageProvider for CameraProvider {
    fn description(&self) -> ProviderDescription {
        self.frames.description()
    }

    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        self.frames.next().await
    }
}

/// Passes on the driver's frames until there is no reader or the camera fails; then the provider ends.
fn watch(mut stream: ReadStream, layout: Layout, to: &FrameSender, ends: &AtomicBool, device: &Path) {
    let began = Instant::now();
    while !ends.load(Ordering::Relaxed) && to.is_wanted() {
        let taken = stream.dequeue(|view| Ok((!view.is_error()).then(|| layout.image(&view)).flatten()));
        let stamp_ns = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        match taken {
            Ok(Some(image)) => {
                let (frame_id, images) = ("camera".into(), vec![image]);
                to.send(RawFrame { stamp_ns, frame_id, images, ..RawFrame::default() });
            }
            // A damaged image; the next may be intact.
            Ok(None) => {}
            Err(error) => {
                tracing::warn!("{}: {error}", device.display());
                return;
            }
        }
    }
}

impl Layout {
    fn image(self, bytes: &[u8]) -> Option<RawImage> {
        let (size, data) = if self.coding == DriverFormat::YUYV {
            ((self.width, self.height), self.yuyv(bytes)?)
        } else {
            let image = decode_image(bytes).ok()?;
            ((image.width(), image.height()), image.into_data())
        };
        RawImage::new("image", PixelFormat::Rgb8, size, data).ok()
    }

    /// RGB of two pixels in four bytes: brightness, blue difference, brightness, red difference (ITU-R BT.601, the
    /// video range 16 to 235).
    fn yuyv(self, bytes: &[u8]) -> Option<Vec<u8>> {
        let mut data = Vec::new();
        for y in 0..self.height as usize {
            let start = y.checked_mul(self.bytes_per_line)?;
            let row = bytes.get(start..start.checked_add(self.width as usize * 2)?)?;
            for [first, blue, second, red] in row.as_chunks::<4>().0 {
                let (u, v) = (f32::from(*blue) - 128.0, f32::from(*red) - 128.0);
                for luma in [first, second] {
                    let l = 1.164 * (f32::from(*luma) - 16.0);
                    // A cast from f32 saturates.
                    data.extend(
                        [l + 1.596 * v, l - 0.392 * u - 0.813 * v, l + 2.017 * u].map(|c| c.round() as u8),
                    );
                }
            }
        }
        Some(data)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yuyv_becomes_rgb_and_short_buffers_nothing() {
        let layout = Layout { coding: DriverFormat::YUYV, width: 2, height: 2, bytes_per_line: 6 };
        // White and black; then red as in BT.601, and padding at each row's end.
        let bytes = [235, 128, 16, 128, 0, 0, 81, 90, 81, 240];
        let image = layout.image(&bytes).unwrap();
        assert_eq!(image.bytes()[..6], [255, 255, 255, 0, 0, 0]);
        assert!(image.bytes()[6] > 250 && image.bytes()[7] < 5 && image.bytes()[8] < 5);
        assert!(layout.image(&bytes[..9]).is_none());
        let jpeg = Layout { coding: DriverFormat::MJPG, ..layout };
        assert!(jpeg.image(&bytes).is_none());
    }

    #[test]
    fn what_is_no_camera_is_an_error() {
        assert!(CameraProvider::open(Path::new("/dev/null"), "eye", (640, 480)).is_err());
        assert!(CameraProvider::open(Path::new("/dev/none"), "eye", (640, 480)).is_err());
    }
}
