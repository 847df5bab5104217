//! Single images: a hand with its gesture, fingertips and pixels; an object of one colour.

use std::io::{self, Write};
use std::path::Path;

use armarium_source::Source;
use armarium_visionx::files::{images_in, read_image};
use armarium_visionx::tracking::{
    GestureRecognizer, HandDetector, HandInPicture, HandOutline, SkinHandDetector, SkinSegmentation,
};
use armarium_visionx::{ColorModel, Region, RgbImage, annotate, components};

use super::LookArgs;
use super::album::Album;
use super::report::{ErrorLine, HandLine, MarkerLine, MarkerPlace, SkinLine, Tip, json, rounded};
use crate::failure::CommandFailure;
use crate::render_findings::lines;

pub(super) enum Seek {
    /// The hand, its fingertips, and its gesture, as this detector sees them.
    Hand(Box<dyn HandDetector>),
    Skin,
    Marker([u8; 3]),
}

/// Fewest pixels of a marker.
const MIN_MARKER: u32 = 12;
const DRAWN: [u8; 3] = [255, 40, 200];

/// Analyses each image. Returns 2 when one is unusable or has no output file, 1 when an annotated image cannot be
/// written.
pub(super) fn run(
    args: &LookArgs,
    mut seek: Seek,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    let files = images_in(&args.images).map_err(|(path, error)| format!("{}: {error}", path.display()))?;
    let mut album = Album::of(&args.annotate, &files)?;
    let mut status = 0;
    for file in files {
        let name = file.display().to_string();
        let mut image = match read_image(&file) {
            Ok(image) => image,
            Err(error) => {
                status = 2;
                if args.json {
                    json(&ErrorLine { file: name.clone(), error: error.to_string() }, out)?;
                }
                writeln!(err, "error: {name}: {error}")?;
                continue;
            }
        };
        look(&name, &mut image, &mut seek, args.json, out)?;
        if let Err(message) = album.keep(&name, &image) {
            writeln!(err, "error: {message}")?;
            status = status.max(1);
        }
    }
    Ok(status)
}

/// The recogniser with the patterns of a file, if one is given.
pub(super) fn recognizer(patterns: Option<&Path>) -> Result<Option<GestureRecognizer>, String> {
    let Some(path) = patterns else { return Ok(None) };
    let source = Source::read(path).map_err(|finding| finding.to_string())?;
    GestureRecognizer::read(source).map(Some).map_err(|findings| lines(&findings))
}

/// Prints the detections and draws them into the image.
fn look(
    file: &str,
    image: &mut RgbImage,
    seek: &mut Seek,
    as_json: bool,
    out: &mut dyn Write,
) -> io::Result<()> {
    let detector = match seek {
        Seek::Marker(color) => return marker(file, image, *color, as_json, out),
        Seek::Skin => return skin(file, image, as_json, out),
        Seek::Hand(detector) => detector,
    };
    let hand = detector.find(image);
    let line = hand_line(file, hand.as_ref());
    if let Some(hand) = &hand {
        annotate::hand_in_picture(image, hand);
    }
    if as_json { json(&line, out) } else { line.text(out) }
}

pub(super) fn hand_line(file: &str, hand: Option<&HandInPicture>) -> HandLine {
    let file = file.to_owned();
    let Some(hand) = hand else {
        return HandLine { file, gesture: None, confidence: 0.0, hand: None, fingertips: Vec::new() };
    };
    let tip = |t: &armarium_visionx::Fingertip| Tip {
        x: rounded(t.px.x, 1),
        y: rounded(t.px.y, 1),
        score: rounded(t.score, 3),
        id: None,
    };
    HandLine {
        file,
        gesture: hand.gesture.clone(),
        confidence: rounded(hand.confidence, 3),
        hand: Some(hand.bounding_box.into()),
        fingertips: hand.fingertips.iter().map(tip).collect(),
    }
}

fn skin(file: &str, image: &mut RgbImage, as_json: bool, out: &mut dyn Write) -> io::Result<()> {
    let hand = SkinHandDetector::default().find(image);
    let seen = hand.as_ref().and_then(|hand| match &hand.outline {
        HandOutline::Silhouette(segmentation) => Some((hand, segmentation)),
        HandOutline::Landmarks(_) => None,
    });
    let line = skin_line(file, seen, image);
    if let Some((_, segmentation)) = seen {
        annotate::silhouette(image, segmentation);
    }
    match as_json {
        true => json(&line, out),
        false => writeln!(out, "{file}: {:.1} % of the image is hand", 100.0 * line.share),
    }
}

fn skin_line(file: &str, seen: Option<(&HandInPicture, &SkinSegmentation)>, image: &RgbImage) -> SkinLine {
    let share = |s: &SkinSegmentation| {
        let pixels = f64::from(image.width()) * f64::from(image.height());
        s.mask.count() as f64 * s.scale.powi(2) / pixels
    };
    SkinLine {
        file: file.to_owned(),
        confidence: seen.map_or(0.0, |(_, s)| rounded(s.confidence, 3)),
        hand: seen.map(|(hand, _)| hand.bounding_box.into()),
        share: seen.map_or(0.0, |(_, s)| rounded(share(s).min(1.0), 4)),
    }
}

fn marker(
    file: &str,
    image: &mut RgbImage,
    color: [u8; 3],
    as_json: bool,
    out: &mut dyn Write,
) -> io::Result<()> {
    let whole = Region::whole(image.width(), image.height());
    let found = components(&ColorModel::from_rgb(color).segment_region(image, whole), MIN_MARKER);
    let place = found.first().map(|c| MarkerPlace {
        x: rounded(c.centroid.x, 2),
        y: rounded(c.centroid.y, 2),
        area: c.area,
        bounds: c.bounds.into(),
    });
    if let Some(component) = found.first() {
        annotate::region(image, &component.bounds, DRAWN);
        annotate::cross(image, &component.centroid, 9.0, DRAWN);
    }
    match (as_json, place) {
        (true, marker) => json(&MarkerLine { file: file.to_owned(), marker }, out),
        (false, None) => writeln!(out, "{file}: nothing of that colour"),
        (false, Some(p)) => writeln!(out, "{file}: {} pixels at ({:.1}, {:.1})", p.area, p.x, p.y),
    }
}

/// A colour from the command line.
pub(crate) fn color(text: &str) -> Result<[u8; 3], String> {
    let wrong = || "three numbers from 0 to 255, as in 40,170,60".to_owned();
    let parts: Vec<u8> =
        text.split(',').map(|p| p.trim().parse()).collect::<Result<_, _>>().map_err(|_| wrong())?;
    parts.try_into().map_err(|_| wrong())
}

#[cfg(test)]
mod tests {
    use super::super::{AnnotateArgs, Detector, DetectorArgs};
    use std::fs;

    use super::*;

    fn looked(args: LookArgs, seek: Seek) -> (u8, String, String) {
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let done = run(&args, seek, &mut out, &mut err).or_else(|failure| failure.say(&mut err));
        let status = done.expect("memory takes everything");
        let text = |bytes| String::from_utf8(bytes).expect("it is text");
        (status, text(out), text(err))
    }

    fn args(images: Vec<std::path::PathBuf>) -> LookArgs {
        LookArgs { images, annotate: AnnotateArgs::default(), json: true }
    }

    #[test]
    fn a_broken_file_is_told_and_the_next_one_looked_at() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        fs::write(folder.path().join("a.png"), b"broken").expect("it can be written");
        let mut image = RgbImage::from_rgb(64, 48, vec![20; 64 * 48 * 3]).expect("it has the size");
        for (y, x) in (10..30).flat_map(|y| (8..28).map(move |x| (y, x))) {
            annotate::pixel(&mut image, x, y, [40, 170, 60]);
        }
        let file = annotate::png(&image).expect("it is a picture");
        fs::write(folder.path().join("b.png"), file).expect("it can be written");
        let annotated = folder.path().join("seen");
        let to = AnnotateArgs { annotate: Some(annotated.clone()) };
        let asked = LookArgs { annotate: to, ..args(vec![folder.path().into()]) };
        let (status, out, err) = looked(asked, Seek::Marker([40, 170, 60]));
        let lines: Vec<serde_json::Value> =
            out.lines().map(|l| serde_json::from_str(l).expect("a line of JSON")).collect();
        assert_eq!((status, lines.len()), (2, 2), "{out}");
        assert!(lines[0]["error"].is_string() && err.contains("a.png"), "{err}");
        assert_eq!(lines[1]["marker"]["x"], 17.5);
        assert_eq!(lines[1]["marker"]["area"], 400);
        assert!(annotated.join("b.png").is_file() && !annotated.join("a.png").exists());
        for detector in [Detector::Learned, Detector::Skin] {
            let detector = DetectorArgs { detector }.of_images(None);
            let (_, out, _) = looked(args(vec![folder.path().join("b.png")]), Seek::Hand(detector));
            let line: serde_json::Value = serde_json::from_str(&out).expect("a line of JSON");
            assert!(
                line["gesture"].is_null()
                    && line["hand"].is_null()
                    && line["fingertips"] == serde_json::json!([])
            );
        }
    }

    #[test]
    fn arguments_that_make_no_sense_are_refused() {
        assert_eq!(color("40, 170,60"), Ok([40, 170, 60]));
        for text in ["", "1,2", "1,2,3,4", "1,2,256", "red"] {
            assert!(color(text).is_err(), "{text}");
        }
        assert_eq!(looked(args(vec!["/nowhere/at/all.png".into()]), Seek::Skin).0, 2);
        assert!(recognizer(Some(Path::new("/nowhere/patterns.yaml"))).is_err());
    }
}
