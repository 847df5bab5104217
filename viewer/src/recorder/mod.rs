//! `run.mcap`: a recording of a run that opens in Foxglove and Rerun and that any MCAP library reads.
//!
//! Poses, joints, images and log lines use Foxglove's protobuf schemas; contact, wrench and chart events are JSON with
//! a schema in the file. Poses, joints and forces are rounded to grids finer than any figure or sensor resolves (see
//! `grid`), because the digits below are noise that does not compress. Messages are collected in compressed chunks. A
//! chunk is written as a whole, at the latest every [`RecorderOptions::flush_period_ns`]. After a crash the file lacks
//! its index, but readers that read it sequentially get all except the last moments.
//!
//! The recorder keeps one chunk and its index in memory, whatever the run's length. It never reads a clock: the caller
//! gives each message's time.

mod grid;
mod messages;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, IntoInnerError, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use armarium_visionx::{JpegPixel, RgbImage, encode_jpeg};
use foxglove::messages as fg;
use foxglove::{Channel, Context, McapCompression, McapWriteOptions, McapWriterHandle, RawChannel, Schema};
use nalgebra::Isometry3;
use serde::Serialize;

pub use messages::{LogLevel, TrueContact, WrenchSample};

/// Options of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecorderOptions {
    /// Longest time that a message stays in memory, ns of the run's time.
    pub flush_period_ns: u64,
    /// Size of an uncompressed chunk, bytes: the memory that the recorder needs, and a reader for unpacking.
    pub chunk_bytes: u64,
    /// Least time between poses repeated on `/tf` for 3D views, ns; 0 repeats none.
    pub transform_period_ns: u64,
    /// Least time between recorded images of one topic, ns; images in between are dropped.
    pub image_period_ns: u64,
    /// Quality of JPEG images, 1 to 100.
    pub jpeg_quality: u8,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            flush_period_ns: 2_000_000_000,
            chunk_bytes: 1 << 20,
            transform_period_ns: 20_000_000,
            image_period_ns: 2_000_000_000,
            jpeg_quality: 70,
        }
    }
}

/// Why a recording cannot be created or completed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum RecorderError {
    /// The file cannot be created.
    #[error("cannot create the recording `{path}`")]
    Create { path: String, source: std::io::Error },
    /// The file cannot be written.
    #[error("cannot write the recording")]
    Write {
        #[from]
        source: foxglove::FoxgloveError,
    },
    /// Foxglove's WebSocket cannot be served.
    #[error("port {port} of this machine, for Foxglove")]
    Foxglove { port: u16, source: foxglove::FoxgloveError },
    /// A message cannot be encoded.
    #[error("cannot encode a message for `{topic}`: {what}")]
    Encode { topic: String, what: String },
}

/// The file, which remembers why it could not be written first: what its writers say then is only that they cannot go on.
struct RecordingFile {
    file: File,
    first_error: Arc<OnceLock<io::Error>>,
}

impl RecordingFile {
    fn noted<T>(&self, result: io::Result<T>) -> io::Result<T> {
        result.inspect_err(|error| {
            // Only the first one counts.
            let _ = self.first_error.set(same(error)).is_ok();
        })
    }
}

/// Another error that says the same.
fn same(error: &io::Error) -> io::Error {
    error
        .raw_os_error()
        .map_or_else(|| io::Error::new(error.kind(), error.to_string()), io::Error::from_raw_os_error)
}

impl Write for RecordingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes);
        self.noted(written)
    }
    fn flush(&mut self) -> io::Result<()> {
        let flushed = self.file.flush();
        self.noted(flushed)
    }
}

impl Seek for RecordingFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

struct PoseTopic {
    channel: Channel<fg::PoseInFrame>,
    transform: fg::FrameTransform,
    next_transform_ns: u64,
}

struct ImageTopic {
    channel: Channel<fg::CompressedImage>,
    next_ns: u64,
}

/// A message of a run, as a recording has it. Topics with images, poses and joints have these only; all others have JSON.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum RunMessage<'m> {
    /// A pose in the root frame, m; the topic's last part names the thing.
    Pose { topic: &'m str, pose: &'m Isometry3<f64> },
    /// The joints' names and positions, rad or m, in the same order.
    Joints { names: &'m [String], position: &'m [f64] },
    /// A message in JSON.
    Json { topic: &'m str, text: &'m str },
    /// An image.
    Image { topic: &'m str, jpeg: &'m [u8] },
}

/// Takes the messages of a run while it is recorded, or from its recording.
pub trait MessageSink: Send + Sync {
    /// Takes a message with its time, ns. It must return at once.
    fn take(&self, stamp_ns: u64, message: &RunMessage<'_>);
}

/// A recording that is being written. Dropping it completes the file; [`Recorder::finish`] also returns errors.
pub struct Recorder {
    options: RecorderOptions,
    context: Arc<Context>,
    writer: McapWriterHandle<BufWriter<RecordingFile>>,
    /// Why the file could not be written first.
    first_error: Arc<OnceLock<io::Error>>,
    poses: BTreeMap<String, PoseTopic>,
    images: BTreeMap<String, ImageTopic>,
    json: BTreeMap<String, Arc<RawChannel>>,
    transforms: Channel<fg::FrameTransform>,
    joints: Channel<fg::JointStates>,
    joint_states: fg::JointStates,
    log: Channel<fg::Log>,
    buffer: Vec<u8>,
    next_flush_ns: u64,
    /// Why nothing more can be written.
    broken: Option<RecorderError>,
    /// Who else is told.
    beside: Option<Arc<dyn MessageSink>>,
    websocket: Option<foxglove::WebSocketServerHandle>,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorder").field("options", &self.options).finish_non_exhaustive()
    }
}

/// Topics whose JSON messages have their own schema: topic, schema name, schema.
const JSON_SCHEMAS: [(&str, &str, &str); 6] = [
    ("/truth/contact", "armarium.Contact", messages::CONTACT_SCHEMA),
    ("/robot/wrench", "armarium.WrenchSample", messages::WRENCH_SCHEMA),
    ("/chart/events", "armarium.ChartEvent", messages::EVENT_SCHEMA),
    ("/truth/events", "armarium.TruthEvent", messages::TRUTH_EVENT_SCHEMA),
    ("/truth/hand", "armarium.ShownHand", messages::SHOWN_HAND_SCHEMA),
    ("/vision/hand", "armarium.SeenHand", messages::SEEN_HAND_SCHEMA),
];

impl Recorder {
    /// Creates the file; overwrites an existing one. `metadata` (seed, world, chart ...) is stored in it.
    ///
    /// # Errors
    /// [`RecorderError::Create`] when the file cannot be created, [`RecorderError::Write`] when it cannot be
    /// written.
    pub fn create(path: &Path, metadata: BTreeMap<String, String>) -> Result<Self, RecorderError> {
        Self::create_with(path, metadata, RecorderOptions::default())
    }

    /// Like [`Recorder::create`], with options.
    ///
    /// # Errors
    /// As [`Recorder::create`].
    pub fn create_with(
        path: &Path,
        metadata: BTreeMap<String, String>,
        options: RecorderOptions,
    ) -> Result<Self, RecorderError> {
        let file = File::create(path)
            .map_err(|source| RecorderError::Create { path: path.display().to_string(), source })?;
        let first_error = Arc::new(OnceLock::new());
        let file = RecordingFile { file, first_error: Arc::clone(&first_error) };
        let context = Context::new();
        // Without seeking, a chunk is written as a whole: a crash never leaves a chunk of unknown length.
        let write = McapWriteOptions::new()
            .compression(Some(McapCompression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(options.chunk_bytes))
            .disable_seeking(true);
        let writer =
            context.mcap_writer_with_options(write).create(BufWriter::with_capacity(1 << 16, file))?;
        writer.write_metadata("run", metadata)?;
        Ok(Self {
            transforms: context.channel_builder("/tf").build(),
            joints: context.channel_builder("/robot/joints").build(),
            log: context.channel_builder("/log").build(),
            next_flush_ns: options.flush_period_ns,
            options,
            context,
            writer,
            first_error,
            poses: BTreeMap::new(),
            images: BTreeMap::new(),
            json: BTreeMap::new(),
            joint_states: fg::JointStates::default(),
            buffer: Vec::with_capacity(1024),
            broken: None,
            beside: None,
            websocket: None,
        })
    }

    /// Serves all topics to Foxglove on a port of this machine, 0 for any that is free, as long as this writes. Returns the address.
    ///
    /// # Errors
    /// [`RecorderError::Foxglove`] when the port cannot be listened on.
    pub fn serve_foxglove(&mut self, port: u16) -> Result<String, RecorderError> {
        let server = foxglove::WebSocketServer::new().name("Armarium").context(&self.context);
        let server = server.bind("127.0.0.1", port);
        // It has threads of its own, and begins on one that belongs to no other runtime.
        let started = std::thread::scope(|scope| scope.spawn(|| server.start_blocking()).join());
        let server = started.unwrap_or_else(|panicked| std::panic::resume_unwind(panicked));
        let server = server.map_err(|source| RecorderError::Foxglove { port, source })?;
        let address = format!("ws://127.0.0.1:{}", server.port());
        self.websocket = Some(server);
        Ok(address)
    }

    /// Tells each message to `sink`, and writes no file.
    ///
    /// # Errors
    /// As [`Recorder::create`].
    pub fn without_file(sink: Arc<dyn MessageSink>) -> Result<Self, RecorderError> {
        let mut recorder = Self::create(Path::new("/dev/null"), BTreeMap::new())?;
        recorder.tell(sink);
        Ok(recorder)
    }

    /// Tells each message to `sink`, too, as long as this writes.
    pub fn tell(&mut self, sink: Arc<dyn MessageSink>) {
        self.beside = Some(sink);
    }

    fn beside(&self, t_ns: u64, message: &RunMessage<'_>) {
        if let Some(sink) = &self.beside {
            sink.take(t_ns, message);
        }
    }

    /// Records the pose `root_from_thing`, m. The topic's last part names the object.
    pub fn pose(&mut self, topic: &str, t_ns: u64, root_from_thing: &Isometry3<f64>) {
        self.tick(t_ns);
        self.beside(t_ns, &RunMessage::Pose { topic, pose: root_from_thing });
        let pose = messages::pose(&grid::pose(root_from_thing));
        let message = fg::PoseInFrame {
            timestamp: messages::stamp(t_ns),
            frame_id: messages::ROOT.into(),
            pose: Some(pose),
        };
        let period = self.options.transform_period_ns;
        if !self.poses.contains_key(topic) {
            let entry = PoseTopic {
                channel: self.context.channel_builder(topic).build(),
                transform: messages::transform(topic),
                next_transform_ns: t_ns,
            };
            self.poses.insert(topic.to_owned(), entry);
        }
        let Some(entry) = self.poses.get_mut(topic) else { return };
        entry.channel.log_with_time(&message, t_ns);
        if period > 0 && t_ns >= entry.next_transform_ns {
            entry.next_transform_ns = t_ns.saturating_add(period);
            entry.transform.timestamp = messages::stamp(t_ns);
            entry.transform.translation = pose.position;
            entry.transform.rotation = pose.orientation;
            self.transforms.log_with_time(&entry.transform, t_ns);
        }
    }

    /// Records where a frame is in the root frame, m, on `/tf` only.
    pub fn transform(&mut self, frame: &str, t_ns: u64, root_from_frame: &Isometry3<f64>) {
        self.tick(t_ns);
        self.beside(t_ns, &RunMessage::Pose { topic: frame, pose: root_from_frame });
        let pose = messages::pose(&grid::pose(root_from_frame));
        let transform = fg::FrameTransform {
            timestamp: messages::stamp(t_ns),
            translation: pose.position,
            rotation: pose.orientation,
            ..messages::transform(frame)
        };
        self.transforms.log_with_time(&transform, t_ns);
    }

    /// Records the true contact of the object in the hand with the table on `/truth/contact`.
    ///
    /// # Errors
    /// [`RecorderError::Encode`] when the message cannot be encoded.
    pub fn contact(&mut self, t_ns: u64, contact: &TrueContact) -> Result<(), RecorderError> {
        self.json("/truth/contact", t_ns, &grid::contact(contact))
    }

    /// Records positions (rad or m) and velocities (rad/s or m/s) of all joints on `/robot/joints`. The slices
    /// have the same order; a missing value is not recorded.
    pub fn joints(&mut self, t_ns: u64, names: &[String], position: &[f64], velocity: &[f64]) {
        self.tick(t_ns);
        self.beside(t_ns, &RunMessage::Joints { names, position });
        let joints = &mut self.joint_states.joints;
        if joints.len() != names.len() || joints.iter().zip(names).any(|(joint, name)| joint.name != *name) {
            *joints = names
                .iter()
                .map(|name| fg::JointState { name: name.clone(), ..Default::default() })
                .collect();
        }
        for (i, joint) in joints.iter_mut().enumerate() {
            joint.position = position.get(i).copied().map(grid::joint_position);
            joint.velocity = velocity.get(i).copied().map(grid::joint_velocity);
        }
        self.joint_states.timestamp = messages::stamp(t_ns);
        self.joints.log_with_time(&self.joint_states, t_ns);
    }

    /// Records the wrist's force and torque on `/robot/wrench`.
    ///
    /// # Errors
    /// [`RecorderError::Encode`] when the message cannot be encoded.
    pub fn wrench(&mut self, t_ns: u64, sample: &WrenchSample) -> Result<(), RecorderError> {
        self.json("/robot/wrench", t_ns, &grid::wrench(sample))
    }

    /// Records a chart event, a JSON object, on `/chart/events`.
    ///
    /// # Errors
    /// [`RecorderError::Encode`] when the message cannot be encoded.
    pub fn event(&mut self, t_ns: u64, event: &serde_json::Value) -> Result<(), RecorderError> {
        self.json("/chart/events", t_ns, event)
    }

    /// Records a JSON message on any topic.
    ///
    /// # Errors
    /// [`RecorderError::Encode`] when the message cannot be encoded.
    pub fn json(&mut self, topic: &str, t_ns: u64, message: &impl Serialize) -> Result<(), RecorderError> {
        self.tick(t_ns);
        let encode = |what: String| RecorderError::Encode { topic: topic.to_owned(), what };
        self.buffer.clear();
        serde_json::to_writer(&mut self.buffer, message).map_err(|e| encode(e.to_string()))?;
        if let (Some(sink), Ok(text)) = (&self.beside, std::str::from_utf8(&self.buffer)) {
            sink.take(t_ns, &RunMessage::Json { topic, text });
        }
        if let Some(channel) = self.json.get(topic) {
            channel.log_with_meta(&self.buffer, foxglove::PartialMetadata::with_log_time(t_ns));
            return Ok(());
        }
        let (_, name, schema) = JSON_SCHEMAS.into_iter().find(|(known, ..)| *known == topic).unwrap_or((
            topic,
            "armarium.Object",
            messages::OBJECT_SCHEMA,
        ));
        let channel = self
            .context
            .channel_builder(topic)
            .message_encoding("json")
            .schema(Schema::new(name, "jsonschema", schema.as_bytes()))
            .build_raw()?;
        channel.log_with_meta(&self.buffer, foxglove::PartialMetadata::with_log_time(t_ns));
        self.json.insert(topic.to_owned(), channel);
        Ok(())
    }

    /// Whether an image of this topic and time would be recorded; check it before rendering an image only for
    /// the recording.
    pub fn wants_image(&self, topic: &str, t_ns: u64) -> bool {
        self.images.get(topic).is_none_or(|image| t_ns >= image.next_ns)
    }

    /// Records an image as JPEG, unless the last one of this topic is less than [`RecorderOptions::image_period_ns`] ago.
    ///
    /// # Errors
    /// [`RecorderError::Encode`] when JPEG cannot hold the image.
    pub fn image(&mut self, topic: &str, t_ns: u64, image: &RgbImage) -> Result<(), RecorderError> {
        self.tick(t_ns);
        if self.wants_image(topic, t_ns) {
            let file = jpeg(image, self.options.jpeg_quality)
                .map_err(|e| RecorderError::Encode { topic: topic.to_owned(), what: e.to_string() })?;
            self.jpeg(topic, t_ns, file);
        }
        Ok(())
    }

    /// Records an image that is a JPEG file already.
    pub fn jpeg(&mut self, topic: &str, t_ns: u64, file: Vec<u8>) {
        self.tick(t_ns);
        self.beside(t_ns, &RunMessage::Image { topic, jpeg: &file });
        let next_ns = t_ns.saturating_add(self.options.image_period_ns);
        let new = || ImageTopic { channel: self.context.channel_builder(topic).build(), next_ns };
        let entry = self.images.entry(topic.to_owned()).or_insert_with(new);
        entry.next_ns = next_ns;
        entry.channel.log_with_time(&messages::compressed_image(topic, t_ns, file), t_ns);
    }

    /// Records a log line on `/log`; `source` names its origin, for instance a state's path.
    pub fn log(&mut self, t_ns: u64, level: LogLevel, source: &str, message: &str) {
        self.tick(t_ns);
        self.log.log_with_time(&messages::log(t_ns, level, source, message), t_ns);
    }

    /// Stores a file inside the recording, for instance the chart or the world.
    ///
    /// # Errors
    /// [`RecorderError::Write`] when it cannot be written.
    pub fn attach(&mut self, name: &str, media_type: &str, data: &[u8]) -> Result<(), RecorderError> {
        let attachment = foxglove::McapAttachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: data.into(),
        };
        Ok(self.writer.attach(&attachment)?)
    }

    /// Writes the index and closes the file.
    ///
    /// # Errors
    /// [`RecorderError::Write`] when writing failed, now or earlier.
    pub fn finish(self) -> Result<(), RecorderError> {
        let Self { writer, first_error, .. } = self;
        let file = writer.close().map_err(|error| cause(&first_error, error))?;
        let error = |e: IntoInnerError<_>| cause(&first_error, foxglove::FoxgloveError::from(e.into_error()));
        file.into_inner().map(drop).map_err(error)
    }

    /// Whether what was recorded so far could be written, as far as that was tried.
    ///
    /// # Errors
    /// [`RecorderError::Write`], once: the recording is of no use any more.
    pub fn health(&mut self) -> Result<(), RecorderError> {
        self.broken.take().map_or(Ok(()), Err)
    }

    /// Flushes the collected messages when it is time. [`Recorder::health`] and [`Recorder::finish`] report errors.
    fn tick(&mut self, t_ns: u64) {
        if t_ns >= self.next_flush_ns {
            self.next_flush_ns = t_ns.saturating_add(self.options.flush_period_ns);
            self.broken = self.writer.flush().err().map(|error| cause(&self.first_error, error));
        }
    }
}

/// What made the file fail, or else what its writer says.
fn cause(first: &OnceLock<io::Error>, error: foxglove::FoxgloveError) -> RecorderError {
    first.get().map_or(error, |first| foxglove::FoxgloveError::from(same(first))).into()
}

fn jpeg(image: &RgbImage, quality: u8) -> Result<Vec<u8>, image::ImageError> {
    let mut data = Vec::with_capacity(image.data().len() / 8);
    encode_jpeg(&mut data, image.data(), (image.width(), image.height()), JpegPixel::Rgb, quality)?;
    Ok(data)
}
