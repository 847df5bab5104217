//! `armarium vision label` and `score`: a page on which somebody clicks hands in images, and how well each detector does on them.

use std::collections::BTreeMap;
use std::io::Write;
use std::num::NonZeroUsize;

use armarium_viewer::label_page::{self, ImageFile, ImagesToLabel};
use armarium_visionx::files::read_image;
use armarium_visionx::providers::convert::jpeg;
use armarium_visionx::tracking::{DetectorScore, HandLabels};
use tokio::net::TcpListener;

use super::report::json;
use super::sequence::Sequence;
use super::{Detector, DetectorArgs, LabelArgs, LabelledArgs, ScoreArgs};
use crate::failure::CommandFailure;
use crate::stopped::stopped;

/// Most images of a recording that are kept to be labelled.
const MOST: usize = 500;

fn open(of: &LabelledArgs) -> Result<(HandLabels, Sequence), String> {
    let wrong = |error| format!("{}: {error}", of.labels.display());
    Ok((HandLabels::load(&of.labels).map_err(wrong)?, Sequence::open(&of.folder, of.topic.as_deref())?))
}

/// The images with their names, as JPEG files: those of a folder when they are asked for, those of a recording at once.
fn images(sequence: &Sequence, every: NonZeroUsize) -> Result<(Vec<String>, ImageFile), String> {
    let files: Vec<_> = sequence.files().iter().step_by(every.get()).cloned().collect();
    if !files.is_empty() {
        let names = files.iter().map(|file| file.display().to_string()).collect();
        return Ok((names, Box::new(move |n| jpeg(&read_image(files.get(n)?).ok()?).ok())));
    }
    let (mut names, mut kept, mut number) = (Vec::new(), Vec::new(), 0);
    sequence.each(|(name, image)| {
        let coded = image.ok().filter(|_| number % every == 0).and_then(|image| jpeg(&image).ok());
        number += 1;
        if let Some(coded) = coded {
            names.push(name);
            kept.push(coded);
        }
        kept.len() < MOST
    })?;
    Ok((names, Box::new(move |n| kept.get(n).cloned())))
}

/// Serves the page until Ctrl-C. Returns 2 when the images or labels cannot be used.
pub(super) fn label(args: &LabelArgs, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    let (labels, sequence) = open(&args.of)?;
    let (names, image) = images(&sequence, args.every)?;
    if names.is_empty() {
        return Err(format!("{}: has no images", args.of.folder.display()).into());
    }
    let (count, file) = (names.len(), args.of.labels.clone());
    let keep = Box::new(move |labels: &HandLabels| labels.save(&file));
    let page = ImagesToLabel { names, labels, image, keep };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let listener = TcpListener::bind(("127.0.0.1", args.port)).await;
        let listener =
            listener.map_err(|error| format!("the page cannot be at port {}: {error}", args.port))?;
        let address = listener.local_addr()?;
        writeln!(
            out,
            "http://{address}/ shows {count} images; labels go to {}; Ctrl-C ends it",
            args.of.labels.display()
        )?;
        out.flush()?;
        tokio::select! {
            biased;
            () = stopped() => Ok(0),
            served = label_page::serve(listener, page) => served.map(|()| 0).map_err(CommandFailure::Output),
        }
    })
}

/// Lets detectors look at the labelled images, and prints how well they do. Returns 2 when images or labels cannot be used.
pub(super) fn score(args: &ScoreArgs, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    let (labels, sequence) = open(&args.of)?;
    let mut detectors = [("learned", Detector::Learned), ("skin", Detector::Skin)]
        .map(|(name, detector)| (name, DetectorArgs { detector }.of_images(None), DetectorScore::default()));
    let mut used = 0;
    sequence.each(|(name, image)| {
        if let (Some(label), Ok(image)) = (labels.0.get(&name), image) {
            let each = detectors.iter_mut();
            each.for_each(|(_, find, score)| score.count(label.as_ref(), find.find(&image).as_ref()));
            used += 1;
        }
        true
    })?;
    if used == 0 {
        let why =
            "no image has a label; `armarium vision label` with the same folder or recording makes them";
        return Err(format!("{}: {why}", args.of.labels.display()).into());
    }
    let scores: BTreeMap<_, _> = detectors.iter().map(|(name, _, score)| (*name, score)).collect();
    if args.json {
        json(&scores, out)?;
        return Ok(0);
    }
    writeln!(out, "{used} labelled images")?;
    for (name, score) in scores {
        let error = score.median_error().map_or("none".to_owned(), |error| format!("{:.1} %", 100.0 * error));
        let DetectorScore { hands, found, without, false_hands, gestures, right_gestures, .. } = score;
        let (tips, near) = (score.fingertips, score.near_fingertips);
        writeln!(
            out,
            "{name}: {found} of {hands} hands, {false_hands} in {without} images without one; gestures {right_gestures} of {gestures}; {near} of {tips} fingertips within 4 %, median {error}"
        )?;
    }
    Ok(0)
}
