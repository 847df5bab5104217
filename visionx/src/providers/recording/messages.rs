//! Reads the messages with images in an MCAP file piece by piece. Nothing in the file is trusted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read as _};
use std::path::Path;

use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::super::compressed::image_field;
use super::super::wire::{WireError, unpack};
use super::super::{PixelFormat, ProviderDescription, RawFrame, RawImage};
use super::{DESCRIPTION, RecordingError, SCHEMA};
use crate::files::{FileError, decode_image};
use crate::frame::ImageError;

/// The schema of compressed images.
const COMPRESSED: &str = "foxglove.CompressedImage";
/// Longest record read and longest message written, bytes. A compressed chunk of a few kilobytes may claim any
/// size.
pub(in crate::providers) const MAX_RECORD_BYTES: usize = 512 << 20;

/// The messages of a recording's image channels, one after the other.
pub(super) struct Messages {
    file: BufReader<File>,
    reader: LinearReader,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, (String, String)>,
    /// The descriptions read so far, by provider.
    pub(super) descriptions: BTreeMap<String, ProviderDescription>,
}

/// A message with an image or a frame.
pub(super) struct FrameMessage {
    pub(super) topic: String,
    schema: String,
    pub(super) stamp_ns: u64,
    data: Vec<u8>,
}

/// Why a message is not a frame.
#[derive(Debug, thiserror::Error)]
pub(super) enum MessageError {
    #[error(transparent)]
    Packed(#[from] WireError),
    #[error("a message that is no compressed image")]
    NoImage,
    #[error("an image {0}")]
    File(#[from] FileError),
    #[error(transparent)]
    Image(#[from] ImageError),
}

impl Messages {
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|source| RecordingError::File { path: path.into(), source })?;
        let options = LinearReaderOptions::default().with_record_length_limit(MAX_RECORD_BYTES);
        Ok(Self {
            file: BufReader::new(file),
            reader: LinearReader::new_with_options(options),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            descriptions: BTreeMap::new(),
        })
    }

    /// The next image; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<FrameMessage>, mcap::McapError> {
        while let Some(event) = self.reader.next_event() {
            let (opcode, data) = match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    // A corrupt length must not allocate more than this at once.
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
                        return Ok(Some(FrameMessage { topic, schema, stamp_ns, data }));
                    }
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// The same of the file at `path`; damage is its end, unless it is at the beginning.
    pub(super) fn next_whole(
        &mut self,
        path: &Path,
        at_beginning: bool,
    ) -> Result<Option<FrameMessage>, RecordingError> {
        match self.next() {
            Err(source) if at_beginning => Err(RecordingError::Mcap { path: path.into(), source }),
            next => Ok(next.unwrap_or_default()),
        }
    }
}

impl FrameMessage {
    /// The provider's name, or else the topic.
    pub(super) fn provider(&self) -> &str {
        self.topic.strip_prefix("/image/").unwrap_or(&self.topic)
    }

    pub(super) fn frame(self) -> Result<RawFrame, MessageError> {
        if self.schema == SCHEMA {
            return Ok(unpack(self.data)?.1);
        }
        let file = image_field(&self.data).ok_or(MessageError::NoImage)?;
        let image = decode_image(file)?;
        let size = (image.width(), image.height());
        let image = RawImage::new("image", PixelFormat::Rgb8, size, image.into_data());
        let images = vec![image?];
        Ok(RawFrame { stamp_ns: self.stamp_ns, frame_id: "camera".into(), images, ..RawFrame::default() })
    }
}

fn described(hex: &str) -> Option<ProviderDescription> {
    let digits = hex.as_bytes().chunks(2).map(|two| {
        let digit = |at: usize| char::from(*two.get(at)?).to_digit(16);
        Some((digit(0)? * 16 + digit(1)?) as u8)
    });
    armarium_bus::decode(&digits.collect::<Option<Vec<u8>>>()?).ok()
}
