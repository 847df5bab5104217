//! Frames in MCAP recordings as a provider; [`super::writing`] writes them.
//!
//! Armarium's recordings have a channel `/image/{provider}` of packed frames ([`super::wire`]) with the schema
//! [`SCHEMA`], and the provider's description as metadata. Recordings of runs and of other programs can be read too: a
//! topic of compressed images (`foxglove.CompressedImage`, PNG or JPEG) is a provider whose frames have the image
//! `image`. The file is read piece by piece, never loaded as a whole; nothing in it is trusted.

mod messages;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until};

use super::files::{Pace, seconds};
use super::{ImageDescription, ImageProvider, ProviderDescription, RawFrame};
use crate::frame::ImageError;
pub(super) use messages::MAX_RECORD_BYTES;
use messages::{FrameMessage, Messages};

/// The schema of packed frames in a recording.
pub(super) const SCHEMA: &str = "armarium.image.PackedFrame.v1";
/// Name of the metadata records with descriptions.
pub(super) const DESCRIPTION: &str = "image/description";

/// Why a recording cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file cannot be opened or created.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: std::io::Error,
    },
    /// It is not a readable recording.
    #[error("{path}: is no recording that can be read: {source}")]
    Mcap {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: mcap::McapError,
    },
    /// It cannot be written.
    #[error("{path}: cannot be written: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: mcap::McapError,
    },
    /// It contains no images, or not the requested ones.
    #[error("{path}: has no images{of}; it has {has}")]
    Nothing {
        /// The file.
        path: PathBuf,
        /// The requested provider or topic.
        of: String,
        /// The available ones.
        has: String,
    },
    /// A frame or description cannot be encoded.
    #[error("a frame cannot be written: {0}")]
    Encode(String),
}

/// Provides the frames of a recording.
pub struct RecordingProvider {
    path: PathBuf,
    topic: String,
    description: ProviderDescription,
    pace: Pace,
    state: Mutex<Playback>,
}

struct Playback {
    /// The file; `None` while a message is being read, and at the end.
    messages: Option<Messages>,
    began: Option<Instant>,
    first_ns: u64,
    /// Added to the stamps, so that they keep growing when playback starts again.
    shift_ns: u64,
    last_ns: u64,
    number: u64,
    /// Messages since playback last started.
    since_begin: u64,
}

/// The images of a recording: by provider or topic the number of frames and the first and last stamp, ns. A truncated
/// recording gives its frames up to the damage.
pub fn recorded(path: &Path) -> Result<BTreeMap<String, (u64, u64, u64)>, RecordingError> {
    let mut messages = Messages::open(path)?;
    let mut found: BTreeMap<String, (u64, u64, u64)> = BTreeMap::new();
    while let Some(message) = messages.next_whole(path, found.is_empty())? {
        let entry = found.entry(message.provider().to_owned());
        let (count, first, last) = entry.or_insert((0, message.stamp_ns, message.stamp_ns));
        *count += 1;
        (*first, *last) = ((*first).min(message.stamp_ns), (*last).max(message.stamp_ns));
    }
    Ok(found)
}

impl RecordingProvider {
    /// Opens the frames of a provider, or of a topic with compressed images; without a name, of the first.
    ///
    /// # Errors
    /// [`RecordingError`] when it cannot be read or has no such images.
    pub async fn open(path: &Path, wanted: Option<&str>, pace: Pace) -> Result<Self, RecordingError> {
        let (file, chosen) = (path.to_owned(), wanted.map(str::to_owned));
        let found = tokio::task::spawn_blocking(move || find(&file, chosen.as_deref())).await;
        let (topic, description) = found
            .unwrap_or_else(|error| Err(RecordingError::File { path: path.into(), source: error.into() }))?;
        let messages = Some(Messages::open(path)?);
        let play = Playback {
            messages,
            began: None,
            first_ns: 0,
            shift_ns: 0,
            last_ns: 0,
            number: 0,
            since_begin: 0,
        };
        Ok(Self { path: path.into(), topic, description, pace, state: Mutex::new(play) })
    }

    /// Reads the next message on a blocking thread.
    async fn message(&self, play: &mut Playback) -> Option<FrameMessage> {
        loop {
            let mut messages = play.messages.take()?;
            let topic = self.topic.clone();
            let read = tokio::task::spawn_blocking(move || {
                loop {
                    match messages.next() {
                        Ok(Some(message)) if message.topic == topic => return Some((messages, message)),
                        Ok(Some(_)) => {}
                        Ok(None) => return None,
                        Err(error) => {
                            tracing::warn!("the recording ends here: {error}");
                            return None;
                        }
                    }
                }
            });
            if let Ok(Some((messages, message))) = read.await {
                play.messages = Some(messages);
                play.since_begin += 1;
                return Some(message);
            }
            // A file that gave no message since playback last started will give none again.
            if !self.pace.repeat || std::mem::take(&mut play.since_begin) == 0 {
                return None;
            }
            play.messages = Messages::open(&self.path).ok();
            // The gap between the last frame and the first one of the next pass is one mean interval.
            let span = play.last_ns.saturating_sub(play.first_ns);
            let again_ns = play.last_ns.saturating_add(span / play.number.max(1));
            play.shift_ns = again_ns.saturating_sub(play.first_ns);
        }
    }
}

/// The topic and description of the requested images.
fn find(path: &Path, wanted: Option<&str>) -> Result<(String, ProviderDescription), RecordingError> {
    let mut messages = Messages::open(path)?;
    let mut has = BTreeSet::new();
    while let Some(message) = messages.next_whole(path, has.is_empty())? {
        if wanted.is_none_or(|wanted| message.topic == wanted || message.provider() == wanted) {
            let (topic, name) = (message.topic.clone(), message.provider().to_owned());
            let described = messages.descriptions.remove(&name);
            return Ok((topic, described.unwrap_or_else(|| describe(&name, message))));
        }
        has.insert(message.topic);
    }
    let of = wanted.map(|w| format!(" of `{w}`")).unwrap_or_default();
    let names: Vec<String> = has.into_iter().collect();
    let has = if names.is_empty() { "none".into() } else { names.join(", ") };
    Err(RecordingError::Nothing { path: path.into(), of, has })
}

/// The description of a topic that is known only by its first message.
fn describe(name: &str, first: FrameMessage) -> ProviderDescription {
    let images = first.frame().map(|frame| frame.images).unwrap_or_default();
    ProviderDescription {
        name: name.trim_start_matches('/').replace('/', "_"),
        about: "a recording".into(),
        frame_id: "camera".into(),
        rate_hz: None,
        images: images.iter().map(|image| ImageDescription::of(image, None)).collect(),
    }
}

#[async_trait]
impl ImageProvider for RecordingProvider {
    fn description(&self) -> ProviderDescription {
        self.description.clone()
    }

    async fn next(&self) -> Result<Arc<RawFrame>, ImageError> {
        let provider = || self.description.name.clone();
        let mut play = self.state.lock().await;
        let message = self.message(&mut play).await;
        let message = message.ok_or_else(|| ImageError::Gone { provider: provider() })?;
        if play.number == 0 {
            play.first_ns = message.stamp_ns;
        }
        play.number += 1;
        let stamp_ns = message.stamp_ns.saturating_add(play.shift_ns);
        play.last_ns = play.last_ns.max(stamp_ns);
        if let Some(speed) = self.pace.speed {
            let began = *play.began.get_or_insert_with(Instant::now);
            let since_s = stamp_ns.saturating_sub(play.first_ns) as f64 * 1e-9;
            sleep_until(began + seconds(since_s / speed)).await;
        }
        let number = play.number;
        let spoilt = |error: &dyn std::error::Error| ImageError::Spoilt {
            provider: provider(),
            what: error.to_string(),
        };
        let frame = tokio::task::spawn_blocking(move || message.frame()).await;
        let frame = frame.map_err(|error| spoilt(&error))?.map_err(|error| spoilt(&error))?;
        Ok(Arc::new(RawFrame { number, stamp_ns, ..frame }))
    }
}

#[cfg(test)]
mod tests;
