//! `armarium image`: lists, shows, records, plays, measures and checks providers of images, from other processes or
//! from files.

mod calibrate;
mod live;
mod play;
mod record;
mod source;
mod stats;
mod view;

use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Duration;

use armarium_bus::SessionConfig;
use armarium_host::Connection;
use armarium_visionx::providers::{FoundProvider, providers};
use serde_json::json;

use crate::connection_args::{ConnectionArgs, explained};
use crate::console;
use crate::vision::Detector;

/// How long to wait for providers to appear.
const DISCOVERY_TIME: Duration = Duration::from_secs(2);

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ImageArgs {
    #[command(subcommand)]
    command: ImageCommand,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum ImageCommand {
    /// List the providers that can be reached, with their images.
    Ls(LsArgs),
    /// Show a provider live in a browser page of this machine, or write its images as PNG.
    View(ImageViewArgs),
    /// Record providers into an MCAP file, without loss.
    Record(RecordArgs),
    /// Offer a recording, or images of files, as a provider.
    Play(PlayArgs),
    /// Measure a provider's frames: rate, latency, size, losses.
    Stats(StatsArgs),
    /// Check a stereo provider's calibration with its images.
    CalibrateCheck(CalibrateArgs),
    /// Run a processor on a provider: results as lines of JSON, into a memory, and as an annotated provider.
    Process(ProcessArgs),
}

#[derive(Clone, Debug, clap::Args)]
struct LsArgs {
    /// One line of JSON per provider.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: ConnectionArgs,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct SourceArgs {
    /// `AGENT/PROVIDER`, or a recording, an image file or a folder of images.
    #[arg(value_name = "SOURCE")]
    pub(crate) source: String,
    /// The provider or topic in a recording; the first if not given.
    #[arg(long, value_name = "NAME")]
    pub(crate) topic: Option<String>,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ImageViewArgs {
    #[command(flatten)]
    pub(crate) source: SourceArgs,
    /// Write each image as a PNG file into this folder, instead of showing a page; depth as 16 bit gray, mm.
    #[arg(long, value_name = "DIR")]
    pub(crate) png: Option<PathBuf>,
    /// How many frames to write.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) frames: u64,
    /// Port of the page; a free port if not given.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    pub(crate) port: u16,
    /// Receive the images as JPEG, for a slow link.
    #[arg(long)]
    pub(crate) jpeg: bool,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RecordArgs {
    /// `AGENT/PROVIDER`; may be repeated.
    #[arg(value_name = "PROVIDER", required = true)]
    pub(crate) providers: Vec<String>,
    /// The recording.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Replace an existing recording.
    #[arg(long)]
    pub(crate) force: bool,
    /// End after this many seconds; otherwise with Ctrl-C.
    #[arg(long, value_name = "S")]
    pub(crate) seconds: Option<f64>,
    /// End after this many frames.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<u64>,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct PlayArgs {
    /// A recording (MCAP), image files, or folders of them.
    #[arg(value_name = "FILE", required = true)]
    pub(crate) files: Vec<PathBuf>,
    /// The agent that offers it.
    #[arg(long, default_value = "player")]
    pub(crate) name: String,
    /// The provider's name, for image files.
    #[arg(long, value_name = "NAME", default_value = "files")]
    pub(crate) provider: String,
    /// The provider or topic in a recording; the first if not given.
    #[arg(long, value_name = "NAME")]
    pub(crate) topic: Option<String>,
    /// Speed, relative to the original.
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    pub(crate) speed: f64,
    /// Repeat from the beginning.
    #[arg(long = "loop")]
    pub(crate) repeat: bool,
    /// Frames per second of image files.
    #[arg(long, value_name = "HZ", default_value_t = 30.0)]
    pub(crate) rate: f64,
    #[command(flatten)]
    pub(crate) connection: ConnectionArgs,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct StatsArgs {
    #[command(flatten)]
    pub(crate) source: SourceArgs,
    /// How long to measure, s.
    #[arg(long, value_name = "S", default_value_t = 5.0)]
    pub(crate) seconds: f64,
    /// One line of JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct CalibrateArgs {
    #[command(flatten)]
    pub(crate) source: SourceArgs,
    /// How many frames to check.
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub(crate) frames: u64,
    /// One line of JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ProcessArgs {
    #[command(flatten)]
    pub(crate) source: SourceArgs,
    /// What to look for.
    #[arg(long, value_enum, default_value_t = live::LookFor::Hand)]
    pub(crate) look: live::LookFor,
    /// How a hand is found.
    #[arg(long, value_enum, default_value_t = Detector::Skin)]
    pub(crate) detector: Detector,
    /// The marker's colour in full light.
    #[arg(long, value_name = "R,G,B", default_value = "40,170,60", value_parser = crate::vision::color)]
    pub(crate) color: [u8; 3],
    /// Write what is observed into the memory of this agent.
    #[arg(long, value_name = "AGENT")]
    pub(crate) memory: Option<String>,
    /// Offer the annotated images as a provider of this agent, named after the processor.
    #[arg(long, value_name = "AGENT")]
    pub(crate) offer: Option<String>,
    /// Process the newest frame at this rate, Hz, instead of each frame.
    #[arg(long, value_name = "HZ")]
    pub(crate) rate: Option<f64>,
    /// End after this many frames.
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<u64>,
}

/// Why a command fails.
pub(crate) enum ImageFailure {
    /// An argument or file is invalid: exit status 2.
    Argument(String),
    /// The operation failed: exit status 1.
    Failed(String),
}

/// Executes the command. Returns the exit status: 0 success, 1 the operation failed, 2 an argument or file is
/// invalid.
pub(crate) fn run(args: &ImageArgs, out: &mut dyn Write, err: &mut dyn Write) -> io::Result<u8> {
    let session = match args.connection().config() {
        Ok(session) => SessionConfig { shared_memory: true, ..session },
        Err(error) => return writeln!(err, "error: {}", explained(&error)).map(|()| 2),
    };
    let connection = match Connection::open(&session) {
        Ok(connection) => connection,
        Err(error) => return console::refuse(&error, err),
    };
    if let Err(message) = crate::warnings::show() {
        return writeln!(err, "error: {message}").map(|()| 2);
    }
    let doing = async {
        match &args.command {
            ImageCommand::Ls(args) => list(args, &connection, out).await,
            ImageCommand::View(args) => view::run(args, &connection, out).await,
            ImageCommand::Record(args) => record::run(args, &connection, out).await,
            ImageCommand::Play(args) => play::run(args, &connection, out).await,
            ImageCommand::Stats(args) => stats::run(args, &connection, out).await,
            ImageCommand::CalibrateCheck(args) => calibrate::run(args, &connection, out).await,
            ImageCommand::Process(args) => live::run(args, &connection, out).await,
        }
    };
    match connection.runtime().block_on(doing) {
        Ok(()) => Ok(0),
        Err(ImageFailure::Argument(message)) => writeln!(err, "error: {message}").map(|()| 2),
        Err(ImageFailure::Failed(message)) => writeln!(err, "error: {message}").map(|()| 1),
    }
}

impl ImageArgs {
    fn connection(&self) -> &ConnectionArgs {
        match &self.command {
            ImageCommand::Ls(args) => &args.connection,
            ImageCommand::View(args) => &args.source.connection,
            ImageCommand::Record(args) => &args.connection,
            ImageCommand::Play(args) => &args.connection,
            ImageCommand::Stats(args) => &args.source.connection,
            ImageCommand::CalibrateCheck(args) => &args.source.connection,
            ImageCommand::Process(args) => &args.source.connection,
        }
    }
}

impl From<io::Error> for ImageFailure {
    fn from(error: io::Error) -> Self {
        Self::Failed(error.to_string())
    }
}

pub(crate) fn argument(error: impl std::fmt::Display) -> ImageFailure {
    ImageFailure::Argument(error.to_string())
}

pub(crate) fn failed(error: impl std::fmt::Display) -> ImageFailure {
    ImageFailure::Failed(error.to_string())
}

async fn list(args: &LsArgs, connection: &Connection, out: &mut dyn Write) -> Result<(), ImageFailure> {
    let found = providers(connection.session(), None, None, DISCOVERY_TIME).await.map_err(failed)?;
    if found.is_empty() && !args.json {
        let hint =
            if args.connection.connect.is_empty() { "; say where they are with --connect" } else { "" };
        writeln!(out, "no provider answers{hint}")?;
    }
    for FoundProvider { agent, provider, description } in found {
        let description = match description {
            Ok(description) => description,
            Err(what) => {
                if args.json {
                    let line =
                        json!({"agent": agent, "provider": {"name": provider}, "error": what.to_string()});
                    writeln!(out, "{line}")?;
                } else {
                    writeln!(out, "{agent}/{provider}: cannot be read (see docs/wire-images.md): {what}")?;
                }
                continue;
            }
        };
        if args.json {
            writeln!(out, "{}", json!({"agent": agent, "provider": description}))?;
            continue;
        }
        let rate = description.rate_hz.map(|hz| format!(", {hz} frames/s")).unwrap_or_default();
        writeln!(out, "{agent}/{}: {}{rate}", description.name, description.about)?;
        for image in &description.images {
            let calibrated = if image.camera.is_some() { "calibrated" } else { "not calibrated" };
            let (role, width, height) = (&image.role, image.width, image.height);
            // The name that documents and JSON use.
            let format = json!(image.format);
            let format = format.as_str().unwrap_or_default();
            writeln!(out, "  {role}: {width} x {height}, {format}, {calibrated}")?;
        }
    }
    Ok(())
}
