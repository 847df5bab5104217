//! What people say of hands in images, and how well a detector does on them.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use nalgebra::{Point2, distance};
use serde::{Deserialize, Serialize};

use super::detector::HandInPicture;

/// A hand in an image, as somebody has labelled it. All places in px of the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelledHand {
    /// The middle of the wrist.
    pub wrist: Point2<f64>,
    /// The knuckle of the middle finger.
    pub knuckle: Point2<f64>,
    /// The tips of stretched fingers, in any order.
    #[serde(default)]
    pub fingertips: Vec<Point2<f64>>,
    /// The gesture's name; `None` where it shows none that has a name.
    #[serde(default)]
    pub gesture: Option<String>,
}

impl LabelledHand {
    /// The hand's size, px: twice the distance from wrist to knuckle, about the length of a stretched hand.
    #[must_use]
    pub fn size(&self) -> f64 {
        2.0 * distance(&self.wrist, &self.knuckle)
    }
}

/// Labels of images by their names; `None` for an image without a hand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HandLabels(pub BTreeMap<String, Option<LabelledHand>>);

/// Why there are no labels.
#[derive(Debug, thiserror::Error)]
pub enum LabelError {
    /// A line that is no label.
    #[error("line {line}: {why}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What is wrong.
        why: String,
    },
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] io::Error),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LabelledImage {
    image: String,
    hand: Option<LabelledHand>,
}

impl HandLabels {
    /// Reads a file of labels: a line of JSON for each image. A later line replaces an earlier one for the same image.
    ///
    /// # Errors
    /// [`LabelError`] for the first line that is none: also a hand without a size.
    pub fn read(text: &str) -> Result<Self, LabelError> {
        let mut labels = BTreeMap::new();
        for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let wrong = |why: String| LabelError::Line { line: i + 1, why };
            // The reader of JSON has seen this line only, and takes it for the first.
            let why =
                |error: serde_json::Error| error.to_string().replace(" at line 1 column ", ", in column ");
            let LabelledImage { image, hand } =
                serde_json::from_str(line).map_err(|error| wrong(why(error)))?;
            if hand.as_ref().is_some_and(|hand| !(hand.size() > 0.0 && hand.size().is_finite())) {
                return Err(wrong(format!("the wrist and the knuckle of `{image}` are at the same place")));
            }
            labels.insert(image, hand);
        }
        Ok(Self(labels))
    }

    /// Reads a file of labels; there are none where there is no file.
    ///
    /// # Errors
    /// [`LabelError`].
    pub fn load(file: &Path) -> Result<Self, LabelError> {
        match std::fs::read_to_string(file) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            text => Self::read(&text?),
        }
    }

    /// Writes a file of labels. It takes the place of the former one when it is whole.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn save(&self, file: &Path) -> io::Result<()> {
        let beside = file.with_extension("unfinished");
        std::fs::write(&beside, self.write())?;
        std::fs::rename(&beside, file)
    }

    /// The file's text.
    #[must_use]
    pub fn write(&self) -> String {
        let line = |(image, hand): (&String, &Option<LabelledHand>)| {
            serde_json::to_string(&LabelledImage { image: image.clone(), hand: hand.clone() })
                .map(|line| line + "\n")
        };
        self.0.iter().filter_map(|label| line(label).ok()).collect()
    }
}

/// How far from a labelled tip one that is found may be, and how far from the middle of the palm the palm that is found, over the
/// hand's size.
const TIP: f64 = 0.04;
const PALM: f64 = 0.5;

/// How well a detector does on labelled images.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DetectorScore {
    /// Images with a hand, and those of them in which it was found: the palm within half the hand's size of where it is.
    pub hands: usize,
    /// Of these, found.
    pub found: usize,
    /// Images without a hand.
    pub without: usize,
    /// Of these, with something that was taken for one.
    pub false_hands: usize,
    /// Hands that were labelled with a gesture, and those of them whose gesture is right.
    pub gestures: usize,
    /// Of these, right.
    pub right_gestures: usize,
    /// Labelled fingertips, and those that were found within 4 % of the hand's size.
    pub fingertips: usize,
    /// Of these, near.
    pub near_fingertips: usize,
    /// Fingertips that were found where none was labelled, in hands that were found.
    pub false_fingertips: usize,
    /// Distance of each labelled tip to the one that was found for it, over the hand's size.
    pub errors: Vec<f64>,
}

impl DetectorScore {
    /// Counts an image: its label, and what was found.
    pub fn count(&mut self, label: Option<&LabelledHand>, seen: Option<&HandInPicture>) {
        let Some(label) = label else {
            self.without += 1;
            self.false_hands += usize::from(seen.is_some());
            return;
        };
        self.hands += 1;
        self.gestures += usize::from(label.gesture.is_some());
        self.fingertips += label.fingertips.len();
        let palm = nalgebra::center(&label.wrist, &label.knuckle);
        let Some(seen) = seen.filter(|seen| distance(&seen.palm, &palm) < PALM * label.size()) else {
            return;
        };
        self.found += 1;
        self.right_gestures += usize::from(label.gesture.is_some() && label.gesture == seen.gesture);
        let mut left: Vec<Point2<f64>> = seen.fingertips.iter().map(|tip| tip.px).collect();
        let mut wanted = label.fingertips.clone();
        // The nearest pairs first.
        let nearest = |left: &[Point2<f64>], wanted: &[Point2<f64>]| {
            let pairs = (0..wanted.len()).flat_map(|w| (0..left.len()).map(move |l| (w, l)));
            pairs.min_by(|a, b| {
                distance(&wanted[a.0], &left[a.1]).total_cmp(&distance(&wanted[b.0], &left[b.1]))
            })
        };
        while let Some((w, l)) = nearest(&left, &wanted) {
            let error = distance(&wanted.swap_remove(w), &left.swap_remove(l)) / label.size();
            self.near_fingertips += usize::from(error <= TIP);
            self.errors.push(error);
        }
        self.false_fingertips += left.len();
    }

    /// The median distance of fingertips that were found, over the hand's size.
    #[must_use]
    pub fn median_error(&self) -> Option<f64> {
        let mut errors = self.errors.clone();
        errors.sort_by(f64::total_cmp);
        errors.get(errors.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::{Mask, Region};
    use crate::tracking::hand::Fingertip;
    use crate::tracking::{HandOutline, SkinSegmentation};

    #[test]
    fn labels_are_read_as_they_were_written_and_what_is_wrong_is_said_with_its_line() {
        let text = "{\"image\":\"a\",\"hand\":null}\n\n{\"image\":\"b\",\"hand\":{\"wrist\":[1.0,2.0],\"knuckle\":[1.0,52.0]}}\n";
        let labels = HandLabels::read(text).unwrap();
        assert_eq!(labels.0["a"], None);
        assert_eq!(labels.0["b"].as_ref().unwrap().size(), 100.0);
        assert_eq!(HandLabels::read(&labels.write()).unwrap(), labels);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("labels.jsonl");
        assert_eq!(HandLabels::load(&file).unwrap(), HandLabels::default());
        labels.save(&file).unwrap();
        assert_eq!(HandLabels::load(&file).unwrap(), labels);
        for (text, what) in [
            ("{\"image\":\"a\",\"hand\":null}\n{", "line 2"),
            ("{\"image\":\"a\",\"hand\":{\"wrist\":[1,2],\"knuckle\":[1,2]}}", "same place"),
            ("{\"image\":\"a\",\"hand\":null,\"foot\":1}", "foot"),
        ] {
            assert!(HandLabels::read(text).unwrap_err().to_string().contains(what), "{what}");
        }
    }

    #[test]
    fn a_score_counts_hands_gestures_and_tips() {
        let seen = |palm: [f64; 2], tips: &[[f64; 2]]| HandInPicture {
            bounding_box: Region::whole(10, 10),
            palm: palm.into(),
            palm_radius: 10.0,
            fingertips: tips
                .iter()
                .map(|px| Fingertip { px: (*px).into(), in_left: None, score: 1.0 })
                .collect(),
            fingers: Vec::new(),
            gesture: Some("fist".into()),
            confidence: 1.0,
            outline: HandOutline::Silhouette(SkinSegmentation {
                mask: Mask::empty(Region::whole(1, 1)),
                scale: 1.0,
                confidence: 1.0,
            }),
        };
        let label = LabelledHand {
            wrist: Point2::new(0.0, 0.0),
            knuckle: Point2::new(0.0, 50.0),
            fingertips: vec![Point2::new(0.0, 100.0), Point2::new(20.0, 100.0)],
            gesture: Some("point_two".into()),
        };
        let mut score = DetectorScore::default();
        score.count(Some(&label), Some(&seen([0.0, 30.0], &[[21.0, 100.0], [5.0, 100.0], [60.0, 0.0]])));
        score.count(Some(&label), Some(&seen([90.0, 30.0], &[])));
        score.count(Some(&label), None);
        score.count(None, Some(&seen([0.0, 0.0], &[])));
        score.count(None, None);
        assert_eq!((score.hands, score.found, score.without, score.false_hands), (3, 1, 2, 1));
        assert_eq!((score.gestures, score.right_gestures), (3, 0));
        assert_eq!((score.fingertips, score.near_fingertips, score.false_fingertips), (6, 1, 1));
        assert_eq!(score.median_error(), Some(0.05));
    }
}
