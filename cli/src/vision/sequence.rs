//! A sequence of images: a folder of files, or the images of a recording (MCAP).

use std::path::{Path, PathBuf};

use armarium_visionx::files::{images_in, read_image};
use armarium_visionx::providers::convert::rgb_of;
use armarium_visionx::providers::{ImageProvider, Pace, RawFrame, RecordingProvider};
use armarium_visionx::{ImageError, RgbImage};
use tokio::runtime::Runtime;

/// The images of a sequence, decoded one at a time.
pub(super) enum Sequence {
    Files(Vec<PathBuf>),
    Recording { path: PathBuf, topic: Option<String>, runtime: Runtime },
}

/// The name of an image, and the image or the error.
pub(super) type Step = (String, Result<RgbImage, String>);

impl Sequence {
    /// The sequence in a folder, or that of a provider or topic in a recording: the named one, or the first.
    pub(super) fn open(path: &Path, topic: Option<&str>) -> Result<Self, String> {
        if path.is_dir() {
            let files = images_in(&[path.to_owned()]).map_err(|(p, e)| format!("{}: {e}", p.display()))?;
            return Ok(Self::Files(files));
        }
        let shown = path.display();
        let wanted = "give a folder of images, in the order of their names, or a recording (.mcap)";
        if !path.exists() {
            return Err(format!("{shown}: there is no such folder or recording; {wanted}"));
        }
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if ["png", "jpg", "jpeg"].contains(&ending.as_str()) {
            return Err(format!("{shown}: is one image and no sequence; {wanted}"));
        }
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build();
        let runtime = runtime.map_err(|e| e.to_string())?;
        let sequence = Self::Recording { path: path.to_owned(), topic: topic.map(str::to_owned), runtime };
        sequence.provider()?;
        Ok(sequence)
    }

    /// The files of a folder; empty for a recording.
    pub(super) fn files(&self) -> &[PathBuf] {
        match self {
            Self::Files(files) => files,
            Self::Recording { .. } => &[],
        }
    }

    fn provider(&self) -> Result<Option<RecordingProvider>, String> {
        let Self::Recording { path, topic, runtime } = self else { return Ok(None) };
        let pace = Pace { speed: None, repeat: false };
        let opened = runtime.block_on(RecordingProvider::open(path, topic.as_deref(), pace));
        opened.map(Some).map_err(|e| e.to_string())
    }

    /// Passes each image to `take`, in order, until it returns false.
    pub(super) fn each(&self, mut take: impl FnMut(Step) -> bool) -> Result<(), String> {
        match self {
            Self::Files(files) => {
                for file in files {
                    let image = read_image(file).map_err(|e| e.to_string());
                    if !take((file.display().to_string(), image)) {
                        break;
                    }
                }
                Ok(())
            }
            Self::Recording { runtime, .. } => {
                let Some(provider) = self.provider()? else { return Ok(()) };
                let name = provider.description().name;
                loop {
                    let step = match runtime.block_on(provider.next()) {
                        Ok(frame) => (format!("{name}@{}", frame.stamp_ns), picture(&frame)),
                        Err(ImageError::Gone { .. }) => return Ok(()),
                        Err(error) => (name.clone(), Err(error.to_string())),
                    };
                    if !take(step) {
                        return Ok(());
                    }
                }
            }
        }
    }
}

/// The first image with colours.
fn picture(frame: &RawFrame) -> Result<RgbImage, String> {
    frame.images.iter().find_map(rgb_of).ok_or_else(|| "has no image".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_sequence_is_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        assert!(Sequence::open(folder.path(), None).is_err());
        let file = folder.path().join("a.mcap");
        std::fs::write(&file, b"not a recording").expect("it can be written");
        assert!(Sequence::open(&file, None).is_err());
        let why = |name: &str| Sequence::open(&folder.path().join(name), None).err().unwrap_or_default();
        assert!(why("none").contains("no such folder"));
        std::fs::write(folder.path().join("a.JPG"), b"a photograph").expect("it can be written");
        assert!(why("a.JPG").contains("no sequence; give a folder"));
    }
}
