//! `armarium vision`: applies the project's vision to image files. Each image is analysed alone, without depth or
//! calibration; `track` takes images as a sequence.

mod album;
mod figures;
mod label;
mod look;
mod report;
mod sequence;
mod track;
mod train;

use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::path::PathBuf;

use armarium_visionx::HandDetection;
use armarium_visionx::tracking::{GestureRecognizer, HandDetector, LearnedHandDetector, SkinHandDetector};
pub(crate) use look::color;

use crate::failure::CommandFailure;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct VisionArgs {
    #[command(subcommand)]
    command: VisionCommand,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum VisionCommand {
    /// The hand in each image, its gesture and its fingertips.
    Gesture(GestureArgs),
    /// The fingertips of the hand in each image.
    Fingertips(FingertipArgs),
    /// The largest object of a colour in each image.
    Marker(MarkerArgs),
    /// The pixels of the hand in each image.
    Skin(LookArgs),
    /// The fingertips in a sequence: a folder of images in the order of their names, or a recording.
    Track(TrackArgs),
    /// Learn how fingertips move from sequences, and save the model.
    Train(TrainArgs),
    /// Click the hands in the images of a folder or a recording, on a page of this machine: wrist, knuckle, fingertips, gesture.
    Label(LabelArgs),
    /// How well each detector does on labelled images.
    Score(ScoreArgs),
    /// Track simulated hands with parts of the tracking left out, and print the quality.
    Figures(FiguresArgs),
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LookArgs {
    /// PNG or JPEG files, or folders of them.
    #[arg(value_name = "IMAGE", required = true)]
    pub(crate) images: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) annotate: AnnotateArgs,
    /// One line of JSON per image.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct AnnotateArgs {
    /// Write each image with its detections into this folder, as PNG; input images are never replaced.
    #[arg(long, value_name = "DIR")]
    pub(crate) annotate: Option<PathBuf>,
}

/// How hands are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Detector {
    /// By networks that were trained on photographs of hands.
    Learned,
    /// By the colour of skin and the hand's silhouette.
    Skin,
}

#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct DetectorArgs {
    /// How hands are found.
    #[arg(long, value_enum, default_value_t = Detector::Learned)]
    pub(crate) detector: Detector,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct FingertipArgs {
    #[command(flatten)]
    pub(crate) look: LookArgs,
    #[command(flatten)]
    pub(crate) detector: DetectorArgs,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct GestureArgs {
    #[command(flatten)]
    pub(crate) look: LookArgs,
    #[command(flatten)]
    pub(crate) detector: DetectorArgs,
    /// A YAML file of labelled finger patterns instead of the built-in ones.
    #[arg(long, value_name = "FILE")]
    pub(crate) patterns: Option<PathBuf>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct MarkerArgs {
    #[command(flatten)]
    pub(crate) look: LookArgs,
    /// The colour in full light, red, green and blue from 0 to 255.
    #[arg(long, value_name = "R,G,B", default_value = "40,170,60", value_parser = look::color)]
    pub(crate) color: [u8; 3],
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct TrackArgs {
    /// A folder of PNG or JPEG files, or a recording (MCAP) with compressed images.
    #[arg(value_name = "FOLDER|RECORDING")]
    pub(crate) folder: PathBuf,
    /// The recording's topic; the first one with images if not given.
    #[arg(long, value_name = "TOPIC")]
    pub(crate) topic: Option<String>,
    #[command(flatten)]
    pub(crate) detector: DetectorArgs,
    #[command(flatten)]
    pub(crate) annotate: AnnotateArgs,
    /// One line of JSON per image.
    #[arg(long)]
    pub(crate) json: bool,
    /// Focal length, px; 1.2 times the longer side if not given.
    #[arg(long, value_name = "PX", value_parser = positive)]
    pub(crate) focal: Option<f64>,
    /// A motion model instead of the built-in one.
    #[arg(long, value_name = "FILE")]
    pub(crate) model: Option<PathBuf>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct TrainArgs {
    /// Folders of images or recordings, one per sequence; none with --simulated.
    #[arg(value_name = "FOLDER|RECORDING", required_unless_present = "simulated")]
    pub(crate) folders: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) detector: DetectorArgs,
    /// The output file of the model.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
    /// Images per second of the sequences.
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = positive)]
    pub(crate) rate: f64,
    /// Focal length, px; 1.2 times the longer side if not given.
    #[arg(long, value_name = "PX", value_parser = positive)]
    pub(crate) focal: Option<f64>,
    /// Learn from this many simulated sequences as well.
    #[arg(long, value_name = "N")]
    pub(crate) simulated: Option<u64>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LabelledArgs {
    /// A folder of PNG or JPEG files, or a recording (MCAP) with compressed images.
    #[arg(value_name = "FOLDER|RECORDING")]
    pub(crate) folder: PathBuf,
    /// The recording's topic; the first one with images if not given.
    #[arg(long, value_name = "TOPIC")]
    pub(crate) topic: Option<String>,
    /// The file of labels, a line of JSON for each image.
    #[arg(long, value_name = "FILE", default_value = "labels.jsonl")]
    pub(crate) labels: PathBuf,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LabelArgs {
    #[command(flatten)]
    pub(crate) of: LabelledArgs,
    /// Only each N-th image. Of a recording 500 are shown at most.
    #[arg(long, value_name = "N", default_value = "1")]
    pub(crate) every: NonZeroUsize,
    /// The page's port; any that is free if not given.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    pub(crate) port: u16,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ScoreArgs {
    #[command(flatten)]
    pub(crate) of: LabelledArgs,
    /// As JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct FiguresArgs {
    /// Number of seeds; each is used with three backgrounds.
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub(crate) seeds: u64,
    /// Frames per sequence.
    #[arg(long, value_name = "N", default_value_t = 120)]
    pub(crate) frames: u64,
    /// Only the complete tracking, without the table of its parts.
    #[arg(long)]
    pub(crate) whole: bool,
}

impl Detector {
    /// Its name on the command line.
    pub(crate) fn name(self) -> String {
        HandDetection::from(self).name().to_owned()
    }
}

impl From<Detector> for HandDetection {
    fn from(detector: Detector) -> Self {
        match detector {
            Detector::Learned => Self::Learned,
            Detector::Skin => Self::Skin,
        }
    }
}

impl DetectorArgs {
    /// A detector for single images, with patterns of gestures instead of the built-in ones.
    pub(crate) fn of_images(self, patterns: Option<GestureRecognizer>) -> Box<dyn HandDetector> {
        match (self.detector, patterns) {
            (Detector::Skin, patterns) => Box::new(SkinHandDetector::new(patterns.unwrap_or_default())),
            (Detector::Learned, None) => Box::new(LearnedHandDetector::of_images()),
            (Detector::Learned, Some(patterns)) => {
                Box::new(LearnedHandDetector::of_images().with_patterns(patterns))
            }
        }
    }

    /// A detector for the images of a sequence.
    pub(crate) fn of_sequence(self) -> Box<dyn HandDetector> {
        match self.detector {
            Detector::Skin => Box::new(SkinHandDetector::default()),
            Detector::Learned => Box::new(LearnedHandDetector::of_sequence()),
        }
    }
}

/// A number from the command line that must be greater than 0.
fn positive(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "this is no number".to_owned())?;
    let fits = number.is_finite() && number > 0.0;
    fits.then_some(number).ok_or_else(|| "give a number greater than 0".to_owned())
}

/// Executes the command. Returns the exit status: 1 when something cannot be written, 2 when a file cannot be used.
pub(crate) fn run(args: &VisionArgs, out: &mut dyn Write, err: &mut dyn Write) -> io::Result<u8> {
    carry_out(&args.command, out, err).or_else(|failure| failure.say(err))
}

fn carry_out(
    command: &VisionCommand,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    match command {
        VisionCommand::Gesture(args) => {
            let detector = args.detector.of_images(look::recognizer(args.patterns.as_deref())?);
            look::run(&args.look, look::Seek::Hand(detector), out, err)
        }
        VisionCommand::Fingertips(args) => {
            look::run(&args.look, look::Seek::Hand(args.detector.of_images(None)), out, err)
        }
        VisionCommand::Skin(args) => look::run(args, look::Seek::Skin, out, err),
        VisionCommand::Marker(args) => look::run(&args.look, look::Seek::Marker(args.color), out, err),
        VisionCommand::Track(args) => track::run(args, out, err),
        VisionCommand::Train(args) => train::run(args, out),
        VisionCommand::Label(args) => label::label(args, out),
        VisionCommand::Score(args) => label::score(args, out),
        VisionCommand::Figures(args) => Ok(figures::run(*args, out)?),
    }
}

#[cfg(test)]
mod tests {
    use super::positive;

    #[test]
    fn lengths_and_rates_are_greater_than_0() {
        assert_eq!(positive("515.5"), Ok(515.5));
        for text in ["0", "-5", "nan", "inf", "-0.0", "wide", ""] {
            assert!(positive(text).is_err(), "{text}");
        }
    }
}
