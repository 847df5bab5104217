//! A sequence of images from an unknown camera: tracks the fingertips of one hand from image to image.

use std::io::{self, Write};
use std::path::Path;

use armarium_source::Source;
use armarium_visionx::tracking::{
    ContourNode, FilterFrame, FingerARModel, GestureRecognizer, HandInPicture, ParticleFilterFingerTracking,
    TipCandidate,
};
use armarium_visionx::{RgbImage, annotate};
use nalgebra::Vector2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::TrackArgs;
use super::album::Album;
use super::look::{hand_line, mark, refuse};
use super::report::{ErrorLine, HandLine, Tip, json, rounded};
use super::sequence::Sequence;
use crate::render_findings::lines;

/// Number of particles; analysing an image takes far longer than they do.
const PARTICLES: usize = 300;
/// Radius of a fingertip, palm radii.
const TIP: f64 = 0.2;
/// Default focal length, relative to the longer side of the image.
const USUAL_FOCAL: f64 = 1.2;

/// Tracks fingertips through the images of one camera.
pub(super) struct Follower {
    filter: ParticleFilterFingerTracking,
    rng: ChaCha8Rng,
    focal: Option<f64>,
    /// Width and height of the last image, px.
    size: Option<(u32, u32)>,
}

/// The detections in one image of a sequence.
pub(super) struct ImageDetections {
    pub(super) hand: Option<HandInPicture>,
    /// The tracked tips, px.
    pub(super) nodes: Vec<ContourNode>,
    /// Focal length and principal point, px.
    pub(super) focal: f64,
    pub(super) center: [f64; 2],
}

impl Follower {
    pub(super) fn new(model: FingerARModel, focal: Option<f64>) -> Self {
        let filter = ParticleFilterFingerTracking::new(model, PARTICLES);
        Self { filter, rng: ChaCha8Rng::seed_from_u64(1), focal, size: None }
    }

    /// Processes the next image. Tracking restarts when the image size changes, because positions would not
    /// correspond. Tips that leave the image are dropped.
    pub(super) fn update(&mut self, image: &RgbImage) -> ImageDetections {
        let size = (image.width(), image.height());
        if self.size.replace(size).is_some_and(|last| last != size) {
            self.filter.clear();
        }
        let (w, h) = (f64::from(image.width()), f64::from(image.height()));
        let focal = self.focal.unwrap_or(USUAL_FOCAL * w.max(h));
        let center = [(w - 1.0) / 2.0, (h - 1.0) / 2.0];
        let hand = HandInPicture::find(image);
        if let Some(hand) = &hand {
            let radius = TIP * hand.palm_radius;
            let outward = |t: &armarium_visionx::Fingertip| (t.px - hand.palm).try_normalize(1e-9);
            let candidate = |t: &armarium_visionx::Fingertip| TipCandidate {
                center: t.px,
                radius,
                outward: outward(t).unwrap_or_else(Vector2::y),
                score: t.score,
            };
            let candidates: Vec<TipCandidate> = hand.fingertips.iter().map(candidate).collect();
            let told = FilterFrame { focal, center, radius, palm: hand.palm, candidates: &candidates };
            self.filter.update(&told, &mut self.rng);
        } else {
            self.filter.predict(&mut self.rng);
        }
        let inside = |n: &ContourNode| (0.0..w).contains(&n.px.x) && (0.0..h).contains(&n.px.y);
        let nodes = self.filter.nodes(focal, center).into_iter().filter(inside).collect();
        ImageDetections { hand, nodes, focal, center }
    }
}

/// Tracks and prints. Returns 2 when the sequence or one of its images cannot be used, 1 when an annotated image
/// cannot be written.
pub(super) fn run(args: &TrackArgs, out: &mut dyn Write, err: &mut dyn Write) -> io::Result<u8> {
    let model = match model(args.model.as_deref()) {
        Ok(model) => model,
        Err(message) => return refuse(&message, err),
    };
    let sequence = match Sequence::open(&args.folder, args.topic.as_deref()) {
        Ok(sequence) => sequence,
        Err(message) => return refuse(&message, err),
    };
    let mut album = match Album::of(&args.annotate, sequence.files()) {
        Ok(album) => album,
        Err(message) => return refuse(&message, err),
    };
    let mut follower = Follower::new(model, args.focal);
    let recognizer = GestureRecognizer::default();
    let (mut status, mut failed) = (0u8, Ok(()));
    let played = sequence.each(|(name, image)| {
        let written = match image {
            Ok(mut image) => {
                one(&name, &mut image, &mut follower, (&recognizer, &mut album, args.json), out, err)
            }
            Err(error) => complain(&name, &error, args.json, out, err),
        };
        match written {
            Ok(worse) => status = status.max(worse),
            Err(error) => failed = Err(error),
        }
        failed.is_ok()
    });
    failed?;
    match played {
        Ok(()) => Ok(status),
        Err(message) => refuse(&message, err),
    }
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
    follower: &mut Follower,
    (recognizer, album, as_json): (&GestureRecognizer, &mut Album, bool),
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
    let line = HandLine { fingertips, ..hand_line(name, seen.hand.as_ref(), recognizer) };
    if as_json {
        json(&line, out)?;
    } else {
        line.text(out)?;
    }
    if let Some(hand) = &seen.hand {
        annotate::region(image, &hand.bounding_box, [255, 40, 200]);
    }
    seen.nodes.iter().for_each(|n| mark(image, &n.px, 3.0 + n.deviation));
    match album.keep(name, image) {
        Ok(()) => Ok(0),
        Err(message) => writeln!(err, "error: {message}").map(|()| 1),
    }
}
