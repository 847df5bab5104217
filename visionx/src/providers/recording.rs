//! Frames in MCAP recordings as a provider; [`super::writing`] writes them.
//!
//! A recording of ours has a channel `/image/{provider}` of packed frames ([`super::wire`]) with the schema
//! [`SCHEMA`], and the provider's description as metadata. Recordings of runs and of other programs are read too: a topic of compressed
//! images (`foxglove.CompressedImage`, PNG or JPEG) is a provider whose frames have the image `image`. The file is read
//! piece by piece and never held as a whole; nothing in it is trusted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use async_trait::async_trait;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until};

use super::compressed::image_field;
use super::files::{Pace, seconds};
use super::wire::unpack;
use super::{Description, Frame, FrameImage, ImageDescription, ImageProvider, PixelFormat};
use crate::files::decode_image;
use crate::frame::ImageError;

/// The schema of packed frames in a recording.
pub(super) const SCHEMA: &str = "armarium.image.PackedFrame.v1";
/// The schema of compressed images.
const COMPRESSED: &str = "foxglove.CompressedImage";
/// Longest record that is read, bytes.
const LONGEST_RECORD: usize = 2 << 30;
/// Name of the metadata records with descriptions.
pub(super) const DESCRIPTION: &str = "image/description";

/// Why there is no recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file cannot be opened or made.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It cannot be written, or what was read is no recording.
    #[error("{path}: is no recording that can be read, or cannot be written: {source}")]
    Mcap {
        /// The file.
        path: PathBuf,
        /// Why.
        source: mcap::McapError,
    },
    /// There are no images in it, or not those that are asked for.
    #[error("{path}: has no images{of}; it has {has}")]
    Nothing {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        of: String,
        /// What there is.
        has: String,
    },
    /// A frame or description cannot be encoded.
    #[error("a frame cannot be written: {what}")]
    Encode {
        /// Why.
        what: String,
    },
}

/// Gives the frames of a recording.
pub struct RecordingProvider {
    path: PathBuf,
    topic: String,
    description: Description,
    pace: Pace,
    state: Mutex<Play>,
}

struct Play {
    /// The file, while there is more of it; taken while it is read.
    messages: Option<Messages>,
    began: Option<Instant>,
    first_ns: u64,
    /// Added to the stamps, so that they grow when the recording begins again.
    shift_ns: u64,
    last_ns: u64,
    number: u64,
}

/// The messages of a recording's image channels, one after the other.
struct Messages {
    file: BufReader<File>,
    reader: LinearReader,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, (String, String)>,
    descriptions: BTreeMap<String, Description>,
}

struct Message {
    topic: String,
    schema: String,
    stamp_ns: u64,
    data: Vec<u8>,
}

impl Messages {
    fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|source| RecordingError::File { path: path.into(), source })?;
        let options = LinearReaderOptions::default().with_record_length_limit(LONGEST_RECORD);
        Ok(Self {
            file: BufReader::new(file),
            reader: LinearReader::new_with_options(options),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            descriptions: BTreeMap::new(),
        })
    }

    /// The next image; `None` at the end.
    fn next(&mut self) -> Result<Option<Message>, mcap::McapError> {
        while let Some(event) = self.reader.next_event() {
            let (opcode, data) = match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    // Not more at once than what a file of that length may have.
                    let read = self.file.read(self.reader.insert(wanted.min(1 << 20)))?;
                    self.reader.notify_read(read);
                    continue;
                }
                LinearReadEvent::Record { opcode, data } => (opcode, data),
            };
            match mcap::parse_record(opcode, data)? {
                Record::Schema { header, .. } => {
                    self.schemas.insert(header.id, header.name);
                }
                Record::Channel(channel) => {
                    let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                    if schema == COMPRESSED || schema == SCHEMA {
                        self.channels.insert(channel.id, (channel.topic, schema));
                    }
                }
                Record::Metadata(metadata) if metadata.name == DESCRIPTION => {
                    if let Some(description) = metadata.metadata.get("cbor").and_then(|hex| described(hex)) {
                        self.descriptions.insert(description.name.clone(), description);
                    }
                }
                Record::Message { header, data } => {
                    if let Some((topic, schema)) = self.channels.get(&header.channel_id) {
                        let (topic, schema) = (topic.clone(), schema.clone());
                        let (stamp_ns, data) = (header.log_time, data.into_owned());
                        return Ok(Some(Message { topic, schema, stamp_ns, data }));
                    }
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

impl Message {
    fn frame(self) -> Result<Frame, String> {
        if self.schema == SCHEMA {
            return unpack(self.data).map(|(_, frame)| frame).map_err(|e| e.to_string());
        }
        let file = image_field(&self.data).ok_or("a message that is no compressed image")?;
        let image = decode_image(file).map_err(|e| format!("an image {e}"))?;
        let size = (image.width(), image.height());
        let image = FrameImage::new("image", PixelFormat::Rgb8, size, image.data().to_vec());
        let images = vec![image.map_err(|e| e.to_string())?];
        Ok(Frame { stamp_ns: self.stamp_ns, frame_id: "camera".into(), images, ..Frame::default() })
    }
}

/// What images a recording has: the providers' names or topics, how many frames each, and the first and last stamp, ns.
/// The end of a recording that was cut off is missing.
///
/// # Errors
/// [`RecordingError`].
pub fn recorded(path: &Path) -> Result<BTreeMap<String, (u64, u64, u64)>, RecordingError> {
    let mut messages = Messages::open(path)?;
    let mut found: BTreeMap<String, (u64, u64, u64)> = BTreeMap::new();
    loop {
        match messages.next() {
            Ok(Some(message)) => {
                let name = message.topic.strip_prefix("/image/").unwrap_or(&message.topic).to_owned();
                let entry = found.entry(name).or_insert((0, message.stamp_ns, message.stamp_ns));
                *entry = (entry.0 + 1, entry.1.min(message.stamp_ns), entry.2.max(message.stamp_ns));
            }
            Ok(None) => return Ok(found),
            Err(source) if found.is_empty() => {
                return Err(RecordingError::Mcap { path: path.into(), source });
            }
            Err(_) => return Ok(found),
        }
    }
}

impl RecordingProvider {
    /// The frames of a provider, or of a topic with compressed images, in a recording; of the first without a name.
    ///
    /// # Errors
    /// [`RecordingError`] when it cannot be read or has no such images.
    pub async fn open(path: &Path, wanted: Option<&str>, pace: Pace) -> Result<Self, RecordingError> {
        let (file, chosen) = (path.to_owned(), wanted.map(str::to_owned));
        let found = tokio::task::spawn_blocking(move || find(&file, chosen.as_deref())).await;
        let (topic, description) = found
            .unwrap_or_else(|error| Err(RecordingError::File { path: path.into(), source: error.into() }))?;
        let messages = Some(Messages::open(path)?);
        let play = Play { messages, began: None, first_ns: 0, shift_ns: 0, last_ns: 0, number: 0 };
        Ok(Self { path: path.into(), topic, description, pace, state: Mutex::new(play) })
    }

    /// Reads the next message, off the threads that others wait on.
    async fn message(&self, play: &mut Play) -> Option<Message> {
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
                return Some(message);
            }
            if !self.pace.repeat || play.number == 0 {
                return None;
            }
            play.messages = Messages::open(&self.path).ok();
            // One mean interval between the last frame and the first again.
            let span = play.last_ns.saturating_sub(play.first_ns);
            play.shift_ns = play.last_ns + span / play.number.max(1) - play.first_ns.min(play.last_ns);
        }
    }
}

/// The topic and description of what is wanted.
fn find(path: &Path, wanted: Option<&str>) -> Result<(String, Description), RecordingError> {
    let mut messages = Messages::open(path)?;
    let mut has = BTreeMap::new();
    let fits = |topic: &str| wanted.is_none_or(|w| topic == w || topic.strip_prefix("/image/") == Some(w));
    loop {
        match messages.next() {
            Ok(Some(message)) if fits(&message.topic) => {
                let name = message.topic.strip_prefix("/image/").unwrap_or(&message.topic).to_owned();
                let topic = message.topic.clone();
                let described = messages.descriptions.remove(&name);
                let description = described.unwrap_or_else(|| describe(&name, message));
                return Ok((topic, description));
            }
            Ok(Some(message)) => {
                has.insert(message.topic, ());
            }
            Ok(None) => break,
            Err(source) if has.is_empty() => return Err(RecordingError::Mcap { path: path.into(), source }),
            Err(_) => break,
        }
    }
    let of = wanted.map(|w| format!(" of `{w}`")).unwrap_or_default();
    let names: Vec<String> = has.into_keys().collect();
    let has = if names.is_empty() { "none".into() } else { names.join(", ") };
    Err(RecordingError::Nothing { path: path.into(), of, has })
}

/// The description of what is only known by its first message.
fn describe(name: &str, first: Message) -> Description {
    let images = first.frame().map(|frame| frame.images).unwrap_or_default();
    let images = images.iter().map(|image| ImageDescription {
        role: image.role().into(),
        format: image.format(),
        width: image.width(),
        height: image.height(),
        camera: None,
    });
    Description {
        name: name.trim_start_matches('/').replace('/', "_"),
        about: "a recording".into(),
        frame_id: "camera".into(),
        rate_hz: None,
        images: images.collect(),
    }
}

#[async_trait]
impl ImageProvider for RecordingProvider {
    fn description(&self) -> Description {
        self.description.clone()
    }

    async fn next(&self) -> Result<Arc<Frame>, ImageError> {
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
        let frame = tokio::task::spawn_blocking(move || message.frame()).await;
        let frame = frame.unwrap_or_else(|error| Err(error.to_string()));
        let frame = frame.map_err(|what| ImageError::Spoilt { provider: provider(), what })?;
        Ok(Arc::new(Frame { number, stamp_ns, ..frame }))
    }
}

fn described(hex: &str) -> Option<Description> {
    let digits = hex.as_bytes().chunks(2).map(|two| {
        let digit = |at: usize| char::from(*two.get(at)?).to_digit(16);
        Some((digit(0)? * 16 + digit(1)?) as u8)
    });
    armarium_bus::decode(&digits.collect::<Option<Vec<u8>>>()?).ok()
}

#[cfg(test)]
mod tests {
    use super::super::writing::Recording;
    use super::*;

    const ALL: Pace = Pace { speed: None, repeat: false };

    fn frame(number: u64) -> Frame {
        let depth: Vec<u8> = (0..6u32).flat_map(|i| (i as f32 * 0.1).to_le_bytes()).collect();
        Frame {
            number,
            stamp_ns: number * 50_000_000,
            frame_id: "eye".into(),
            root_from_camera: None,
            images: vec![
                FrameImage::new("left", PixelFormat::Rgb8, (3, 2), vec![number as u8; 18]).unwrap(),
                FrameImage::new("depth", PixelFormat::Depth32F, (3, 2), depth).unwrap(),
            ],
        }
    }

    fn description(name: &str) -> Description {
        Description::of_stereo(name, "eye", &crate::scenes::CALIBRATION)
    }

    fn record(path: &Path) {
        let mut recording = Recording::create(path).unwrap();
        for name in ["eyes", "other"] {
            recording.add_provider(&description(name)).unwrap();
        }
        for number in 1..=5 {
            recording.add("eyes", &frame(number)).unwrap();
            recording.add("other", &frame(number)).unwrap();
        }
        assert!(recording.add("none", &frame(1)).is_err());
        assert_eq!(recording.frames(), 10);
        recording.finish().unwrap();
    }

    async fn stamps(provider: &RecordingProvider, most: usize) -> Vec<u64> {
        let mut stamps = Vec::new();
        while let Ok(frame) = provider.next().await {
            stamps.push(frame.stamp_ns / 1_000_000);
            if stamps.len() == most {
                break;
            }
        }
        stamps
    }

    #[tokio::test(start_paused = true)]
    async fn what_was_recorded_is_given_again_at_its_pace() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        record(&path);
        assert_eq!(recorded(&path).unwrap()["other"], (5, 50_000_000, 250_000_000));
        let provider = RecordingProvider::open(&path, Some("other"), ALL).await.unwrap();
        assert_eq!(provider.description(), description("other"));
        for number in 1..=5 {
            assert_eq!(*provider.next().await.unwrap(), frame(number));
        }
        assert!(matches!(provider.next().await, Err(ImageError::Gone { .. })));

        let pace = Pace { speed: Some(0.5), repeat: true };
        let provider = RecordingProvider::open(&path, None, pace).await.unwrap();
        let began = Instant::now();
        assert_eq!(stamps(&provider, 8).await, [50, 100, 150, 200, 250, 290, 340, 390]);
        let elapsed = began.elapsed().as_secs_f64();
        assert!((elapsed - 0.68).abs() < 0.01, "340 ms at half speed: {elapsed}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_recording_that_was_cut_off_gives_what_is_there_and_none_gives_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let (path, cut) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
        record(&path);
        let whole = std::fs::read(&path).unwrap();
        for end in (0..whole.len()).step_by(whole.len() / 60) {
            std::fs::write(&cut, &whole[..end]).unwrap();
            if let Ok(provider) = RecordingProvider::open(&cut, None, ALL).await {
                assert!(stamps(&provider, 9).await.len() <= 5);
            }
        }
        std::fs::write(&cut, b"not a recording").unwrap();
        assert!(matches!(recorded(&cut), Err(RecordingError::Mcap { .. })));
        assert!(RecordingProvider::open(&cut, None, ALL).await.is_err());
        assert!(RecordingProvider::open(&folder.path().join("none"), None, ALL).await.is_err());
        let nothing = RecordingProvider::open(&path, Some("third"), ALL).await.map(|_| ()).unwrap_err();
        assert!(nothing.to_string().contains("/image/eyes, /image/other"), "{nothing}");
    }
}
