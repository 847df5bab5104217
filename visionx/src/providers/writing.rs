//! Writes frames into a recording, whole and lossless; [`super::recording`] reads it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};

use super::recording::{DESCRIPTION, MAX_RECORD_BYTES, RecordingError, SCHEMA};
use super::wire::pack;
use super::{ProviderDescription, RawFrame};

/// The encoding of messages with packed frames.
const ENCODING: &str = "armarium-packed-frame";
/// Bytes of a chunk. A crash loses at most the last chunk.
const CHUNK: u64 = 4 << 20;
/// Limit of a frame's images, bytes, so that the record with its headers is short enough to be read again.
const MAX_FRAME_BYTES: usize = MAX_RECORD_BYTES - (64 << 10);

/// A recording that is being written. Frames are compressed without loss.
pub struct RecordingWriter {
    path: PathBuf,
    writer: mcap::Writer<BufWriter<File>>,
    channels: BTreeMap<String, u16>,
    frames: u64,
}

impl RecordingWriter {
    /// Creates a recording; an existing file is overwritten.
    pub fn create(path: &Path) -> Result<Self, RecordingError> {
        let file = File::create(path).map_err(|source| RecordingError::File { path: path.into(), source })?;
        let options = mcap::WriteOptions::new().chunk_size(Some(CHUNK)).library("armarium");
        let writer = options.compression_level(1).create(BufWriter::new(file));
        let writer = writer.map_err(|source| RecordingError::Write { path: path.into(), source })?;
        Ok(Self { path: path.into(), writer, channels: BTreeMap::new(), frames: 0 })
    }

    fn failed(&self) -> impl Fn(mcap::McapError) -> RecordingError + use<> {
        let path = self.path.clone();
        move |source| RecordingError::Write { path: path.clone(), source }
    }

    /// Writes the description of a provider; must come before its frames.
    pub fn add_provider(&mut self, description: &ProviderDescription) -> Result<(), RecordingError> {
        let said = armarium_bus::encode(description).map_err(|e| RecordingError::Encode(e.to_string()))?;
        let said = said.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let metadata = BTreeMap::from([("name".into(), description.name.clone()), ("cbor".into(), said)]);
        let failed = self.failed();
        let schema = self.writer.add_schema(SCHEMA, "", &[]).map_err(&failed)?;
        let topic = format!("/image/{}", description.name);
        let channel = self.writer.add_channel(schema, &topic, ENCODING, &BTreeMap::new()).map_err(&failed)?;
        self.channels.insert(description.name.clone(), channel);
        self.writer.write_metadata(&Metadata { name: DESCRIPTION.into(), metadata }).map_err(&failed)
    }

    /// Writes a frame of an added provider.
    pub fn add(&mut self, provider: &str, frame: &RawFrame) -> Result<(), RecordingError> {
        let unknown = || RecordingError::Encode(format!("there is no provider `{provider}` in it"));
        let channel_id = *self.channels.get(provider).ok_or_else(unknown)?;
        if frame.bytes() > MAX_FRAME_BYTES {
            let what = format!("it has {} bytes; at most {MAX_FRAME_BYTES} are recorded", frame.bytes());
            return Err(RecordingError::Encode(what));
        }
        let data = pack(frame, 0, 0).map_err(|e| RecordingError::Encode(e.to_string()))?;
        let header = MessageHeader {
            channel_id,
            // For viewers only; the frame carries its own number.
            sequence: frame.number as u32,
            log_time: frame.stamp_ns,
            publish_time: frame.stamp_ns,
        };
        self.writer.write_to_known_channel(&header, &data).map_err(self.failed())?;
        self.frames += 1;
        Ok(())
    }

    /// Number of frames written.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Completes the recording.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        let failed = self.failed();
        self.writer.finish().map(|_| ()).map_err(failed)
    }
}
