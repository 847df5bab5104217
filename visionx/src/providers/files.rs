//! Image files as a provider. Each file is a frame; files whose names differ only in `_left`, `_right`, `_depth` form
//! one frame. `calibration.yaml` beside them describes the cameras.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use async_trait::async_trait;
use nalgebra::Isometry3;
use tokio::sync::Mutex;
use tokio::time::{Duration, Instant, sleep_until};

use super::calibration::Calibration;
use super::description::{ImageDescription, ProviderDescription};
use super::{ImageProvider, PixelFormat, RawFrame, RawImage};
use crate::files::{FileError, images_in, read_depth, read_image};
use crate::frame::ImageError;

/// The roles that a file name can end in.
const ROLES: [&str; 3] = ["left", "right", "depth"];

/// The playback of files or recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Speed relative to the original; `None`: as fast as the reader asks, without dropping frames.
    pub speed: Option<f64>,
    /// Whether playback starts again at the end.
    pub repeat: bool,
}

/// Provides the images of files.
#[derive(Debug)]
pub struct FileProvider {
    description: ProviderDescription,
    frames: Vec<BTreeMap<String, PathBuf>>,
    rate_hz: f64,
    pace: Pace,
    root_from_camera: Option<Isometry3<f64>>,
    state: Mutex<(u64, Option<Instant>)>,
}

impl FileProvider {
    /// Opens files and folders, sorted by name, at `rate_hz` frames per second at the original speed. The description
    /// is that of the first frame.
    ///
    /// # Errors
    /// The path and [`FileError`] when a folder has no images, the first cannot be read, or the calibration is not
    /// valid.
    pub async fn open(
        name: &str,
        paths: &[PathBuf],
        rate_hz: f64,
        pace: Pace,
    ) -> Result<Self, (PathBuf, FileError)> {
        let frames = grouped(images_in(paths)?);
        let nothing = || (paths.first().cloned().unwrap_or_default(), FileError::Empty);
        let first = frames.first().ok_or_else(nothing)?;
        let file = first.values().next().ok_or_else(nothing)?.clone();
        let images = read(first.clone()).await?;
        let Calibration { cameras, root_from_camera } = Calibration::beside(&file)?;
        let described = |image: &RawImage| ImageDescription::of(image, cameras.get(image.role()).copied());
        let description = ProviderDescription {
            name: name.into(),
            about: format!("{} frames from files", frames.len()),
            frame_id: "camera".into(),
            rate_hz: Some(rate_hz * pace.speed.unwrap_or(1.0)),
            images: images.iter().map(described).collect(),
        };
        let rate_hz = if rate_hz > 0.0 && rate_hz.is_finite() { rate_hz } else { 30.0 };
        Ok(Self { description, frames, rate_hz, pace, root_from_camera, state: Mutex::new((0, None)) })
    }
}

#[async_trait]
impl ImageProvider for FileProvider {
    fn description(&self) -> ProviderDescription {
        self.description.clone()
    }

    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let mut state = self.state.lock().await;
        let (number, began) = &mut *state;
        let files = self.frames.len() as u64;
        if *number >= files && !self.pace.repeat {
            return Err(ImageError::Gone { provider: self.description.name.clone() });
        }
        let at = *number;
        let elapsed_s = at as f64 / self.rate_hz;
        if let Some(speed) = self.pace.speed {
            let began = *began.get_or_insert_with(Instant::now);
            sleep_until(began + seconds(elapsed_s / speed)).await;
        }
        *number += 1;
        let files = &self.frames[usize::try_from(at % files).unwrap_or(0)];
        let images = read(files.clone()).await.map_err(|(file, error)| ImageError::Spoilt {
            provider: self.description.name.clone(),
            what: format!("{}: {error}", file.display()),
        })?;
        Ok(Arc::new(RawFrame {
            number: at + 1,
            stamp_ns: (elapsed_s * 1e9).round() as u64,
            frame_id: self.description.frame_id.clone(),
            root_from_camera: self.root_from_camera,
            images,
        }))
    }
}

/// A duration that tokio's clock can hold.
pub(super) fn seconds(s: f64) -> Duration {
    Duration::try_from_secs_f64(s.max(0.0))
        .unwrap_or(Duration::from_secs(86_400))
        .min(Duration::from_secs(86_400))
}

/// Files by frame and role.
fn grouped(files: Vec<PathBuf>) -> Vec<BTreeMap<String, PathBuf>> {
    let mut frames: Vec<(PathBuf, BTreeMap<String, PathBuf>)> = Vec::new();
    for file in files {
        let stem = file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let parts = ROLES.iter().find_map(|role| Some((stem.strip_suffix(role)?.strip_suffix('_')?, *role)));
        let (base, role) = parts.unwrap_or((&stem, "image"));
        let of = if parts.is_some() { file.with_file_name(base) } else { file.clone() };
        match frames.iter_mut().rev().take(ROLES.len()).find(|(other, _)| *other == of) {
            Some((_, frame)) => {
                frame.insert(role.into(), file);
            }
            None => frames.push((of, BTreeMap::from([(role.to_owned(), file)]))),
        }
    }
    frames.into_iter().map(|(_, frame)| frame).collect()
}

/// Reads the files of a frame on a blocking thread.
async fn read(files: BTreeMap<String, PathBuf>) -> Result<Vec<RawImage>, (PathBuf, FileError)> {
    let task = tokio::task::spawn_blocking(move || {
        let order = |role: &str| ROLES.iter().position(|r| *r == role);
        let mut files: Vec<(String, PathBuf)> = files.into_iter().collect();
        files.sort_by_key(|(role, _)| order(role));
        files.into_iter().map(|(role, file)| image(&role, &file).map_err(|e| (file, e))).collect()
    });
    task.await.unwrap_or_else(|error| Err((PathBuf::new(), FileError::Read(error.into()))))
}

fn image(role: &str, file: &Path) -> Result<RawImage, FileError> {
    let (format, size, bytes) = if role == "depth" {
        let (width, height, bytes) = read_depth(file)?;
        (PixelFormat::Depth16, (width, height), bytes)
    } else {
        let image = read_image(file)?;
        (PixelFormat::Rgb8, (image.width(), image.height()), image.data().to_vec())
    };
    RawImage::new(role, format, size, bytes)
        .map_err(|_| FileError::TooLarge { width: size.0, height: size.1 })
}

#[cfg(test)]
mod tests {
    use super::super::calibration::CALIBRATION;
    use super::super::description::CameraModel;
    use super::*;
    use crate::annotate::png;
    use crate::frame::RgbImage;

    const ALL: Pace = Pace { speed: None, repeat: false };

    fn write(folder: &Path, name: &str, width: u32) {
        let image = RgbImage::painted(width, 2, |_, _| [width as u8; 3]);
        std::fs::write(folder.join(name), png(&image).unwrap()).unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn pairs_are_one_frame_sizes_may_change_and_what_is_broken_spoils_one_frame() {
        let folder = tempfile::tempdir().unwrap();
        for (name, width) in [("0_left.png", 3), ("0_right.png", 3), ("1.png", 5), ("3.png", 1)] {
            write(folder.path(), name, width);
        }
        std::fs::write(folder.path().join("2.png"), b"broken").unwrap();
        let camera = CameraModel::ideal(&crate::scenes::CALIBRATION.camera, 0.0);
        let text = serde_json::to_string(&BTreeMap::from([("left", camera)])).unwrap();
        std::fs::write(folder.path().join(CALIBRATION), text).unwrap();
        let provider = FileProvider::open("files", &[folder.path().into()], 10.0, ALL).await.unwrap();
        let described = provider.description();
        assert_eq!(described.image("left").unwrap().camera, Some(camera));
        assert_eq!(described.images.len(), 2);
        let first = provider.next().await.unwrap();
        assert_eq!([first.images[0].role(), first.images[1].role()], ["left", "right"]);
        let second = provider.next().await.unwrap();
        assert_eq!((second.image("image").unwrap().width(), second.stamp_ns), (5, 100_000_000));
        assert!(matches!(provider.next().await, Err(ImageError::Spoilt { .. })));
        assert_eq!(provider.next().await.unwrap().number, 4);
        assert!(matches!(provider.next().await, Err(ImageError::Gone { .. })));
    }

    #[tokio::test(start_paused = true)]
    async fn files_come_at_their_pace_and_again() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "a.png", 1);
        write(folder.path(), "b.png", 2);
        let pace = Pace { speed: Some(2.0), repeat: true };
        let provider = FileProvider::open("files", &[folder.path().into()], 10.0, pace).await.unwrap();
        let began = Instant::now();
        for expected in [1, 2, 1, 2, 1] {
            assert_eq!(provider.next().await.unwrap().images[0].width(), expected);
        }
        let elapsed = began.elapsed().as_secs_f64();
        assert!((elapsed - 0.2).abs() < 0.01, "4 intervals of 0.1 s at double speed: {elapsed}");
    }
}
