//! A sequence of images from an unknown camera: tracks the fingertips of one hand from image to image.

use std::io::{self, Write};
use std::path::Path;

use armarium_source::Source;
use armarium_visionx::tracking::{ContourNode, FingerARModel, TipFollower};
use armarium_visionx::{RgbImage, annotate};

use super::TrackArgs;
use super::album::Album;
use super::look::hand_line;
use super::report::{ErrorLine, HandLine, Tip, json, rounded};
use super::sequence::Sequence;
use crate::failure::CommandFailure;
use crate::render_findings::lines;

/// Tracks and prints. Returns 2 when the sequence or one of its images cannot be used, 1 when an annotated image
/// cannot be written.
pub(super) fn run(args: &TrackArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<u8, CommandFailure> {
    let model = model(args.model.as_deref())?;
    let sequence = Sequence::open(&args.folder, args.topic.as_deref())?;
    let mut album = Album::of(&args.annotate, sequence.files())?;
    let mut follower = TipFollower::new(args.detector.of_sequence(), model, args.focal);
    let (mut status, mut failed) = (0u8, Ok(()));
    let played = sequence.each(|(name, image)| {
        let written = match image {
            Ok(mut image) => one(&name, &mut image, &mut follower, (&mut album, args.json), out, err),
            Err(error) => complain(&name, &error, args.json, out, err),
        };
        match written {
            Ok(worse) => status = status.max(worse),
            Err(error) => failed = Err(error),
        }
        failed.is_ok()
    });
    failed?;
    played?;
    Ok(status)
}

/// The model in a file, or the built-in one.
pub(super) fn model(path: Option<&Path>) -> Result<FingerARModel, String> {
    let Some(path) = path else { return Ok(FingerARModel::default()) };
    let source = Source::read(path).map_err(|finding| finding.to_string())?;
    FingerARModel::read(source).map_err(|findings| lines(&findings))
}

fn complain(
    name: &str,
    error: &str,
    as_json: bool,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> io::Result<u8> {
    if as_json {
        json(&ErrorLine { file: name.to_owned(), error: error.to_owned() }, out)?;
    }
    writeln!(err, "error: {name}: {error}")?;
    Ok(2)
}

fn one(
    name: &str,
    image: &mut RgbImage,
    follower: &mut TipFollower,
    (album, as_json): (&mut Album, bool),
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> io::Result<u8> {
    let seen = follower.update(image);
    let tip = |n: &ContourNode| Tip {
        x: rounded(n.px.x, 1),
        y: rounded(n.px.y, 1),
        score: rounded(1.0 / f64::from(1 + n.unseen), 3),
        id: Some(n.id),
    };
    let fingertips = seen.nodes.iter().map(tip).collect();
    let line = HandLine { fingertips, ..hand_line(name, seen.hand.as_ref()) };
    if as_json {
        json(&line, out)?;
    } else {
        line.text(out)?;
    }
    if let Some(hand) = &seen.hand {
        annotate::region(image, &hand.bounding_box, [255, 40, 200]);
    }
    seen.nodes.iter().for_each(|n| annotate::mark(image, &n.px, 3.0 + n.deviation));
    match album.keep(name, image) {
        Ok(()) => Ok(0),
        Err(message) => writeln!(err, "error: {message}").map(|()| 1),
    }
}
