//! What a report shows: plain data that the program fills. Everything may be absent; what is absent is not shown.

use std::collections::BTreeMap;

use armarium_visionx::Image;
use serde::{Deserialize, Serialize};

use super::figures::Figure;

/// All that the page shows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ReportData {
    /// The page's title, usually the chart's name.
    pub title: String,
    /// One sentence under it, usually the chart's description.
    pub subtitle: String,
    /// `success`, or how else the run ended.
    pub outcome: String,
    /// Why, when it is not success.
    pub reason: Option<String>,
    /// The states that the failure came through, innermost first.
    pub failure_chain: Vec<ChainLink>,
    /// What describes the run (seed, world, durations ...) in the order shown.
    pub facts: Vec<(String, String)>,
    /// What was measured and what is asked of it; see [`super::figures::figures`].
    pub figures: Vec<Figure>,
    /// The states through time, in order of entry.
    pub states: Vec<StateSpan>,
    /// Paths over the table seen from above.
    pub paths: Vec<Path>,
    /// The contact force.
    pub force: Option<TimePlot>,
    /// Further signals, each drawn as large as the force.
    pub signals: Vec<TimePlot>,
    /// Joint trajectories, drawn small beside each other.
    pub joints: Vec<TimePlot>,
    /// What the sponge cleaned.
    pub wiped: Option<WipedArea>,
    /// What each coaching did.
    pub coaching: Vec<CoachingRow>,
    /// What the memories of several agents knew.
    pub memories: Option<Memories>,
    /// Gestures: true, then seen, then in how many frames.
    pub confusion: BTreeMap<String, BTreeMap<String, u64>>,
    /// Camera images with what was seen in them.
    pub pictures: Vec<Picture>,
    /// The last lines of the log.
    pub log: Vec<String>,
}

/// One state of a failure's chain.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainLink {
    /// The state's path.
    pub state: String,
    /// What it says, where it adds something.
    pub reason: Option<String>,
}

/// One stay in one state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StateSpan {
    /// The state's path from the root, parts separated by dots: `Wipe.Coaching.Watching`.
    pub path: String,
    /// Entry, s of the run.
    pub from_s: f64,
    /// Exit, s of the run; `None` when it was still active at the end.
    pub to_s: Option<f64>,
    /// How it ended, where it reported that: `success`, `failure` ...
    pub outcome: Option<String>,
}

/// What a path is, which decides how it is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PathRole {
    /// What the coach showed.
    Demonstrated,
    /// What was learned from it.
    #[default]
    Learned,
    /// What was executed after a coaching.
    Coached,
    /// Something for orientation, such as the table's edge.
    Outline,
}

/// A line over the table, seen from above.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Its name in the legend.
    pub label: String,
    /// What it is.
    pub role: PathRole,
    /// Points x, y in the root frame, m.
    pub points: Vec<[f64; 2]>,
}

/// Signals over time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TimePlot {
    /// What is drawn.
    pub title: String,
    /// The vertical axis with its unit: `Normal force, N`.
    pub y_label: String,
    /// The signals.
    pub series: Vec<Series>,
    /// Where the signal should be.
    pub band: Option<Band>,
    /// Limits: values that must not be passed, with their names.
    pub limits: Vec<(f64, String)>,
    /// Instants, s, with their names.
    pub marks: Vec<(f64, String)>,
    /// Shown range of values, when it should not follow the data.
    pub y_range: Option<[f64; 2]>,
}

/// One signal. Times ascend; the two are of one length. NaN interrupts the line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Its name in the legend.
    pub label: String,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Values, in the plot's unit.
    pub y: Vec<f64>,
}

/// Where a signal should be, for part of the time or all of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// The desired value.
    pub value: f64,
    /// How far from it is still good.
    pub tolerance: f64,
    /// Its name in the legend.
    pub label: String,
    /// From when, s.
    pub from_s: Option<f64>,
    /// Until when, s.
    pub to_s: Option<f64>,
}

/// What became of one cell of the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cell {
    /// Neither to be cleaned nor cleaned.
    #[default]
    Untouched,
    /// On the sponge's way along the coach's path, and cleaned.
    Cleaned,
    /// On the sponge's way along the coach's path, and not cleaned.
    Missed,
    /// Cleaned beside that way.
    Beside,
}

/// The table's cells, seen from above.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WipedArea {
    /// Where the first cell's outer corner is (least x and y), root frame, m.
    pub origin: [f64; 2],
    /// A cell's side, m.
    pub cell_m: f64,
    /// Cells along x.
    pub columns: usize,
    /// Rows along y, from the least y; each has `columns` cells.
    pub cells: Vec<Cell>,
    /// The path that cleaned them, root frame, m; may be empty.
    #[serde(default)]
    pub path: Vec<[f64; 2]>,
}

/// One line of the coaching table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CoachingRow {
    /// What the coach did: `push` or the gesture.
    pub kind: String,
    /// When, s of the run.
    pub at_s: f64,
    /// Signed shift at the coached phase, m.
    pub displacement_m: Option<f64>,
    /// What was left of it two cycles after the coach had gone, m.
    pub retained_m: Option<f64>,
    /// How much the rest of the motion moved, m RMS.
    pub far_side_rms_m: Option<f64>,
    /// Lowest frequency over the learned one while the hand was near.
    pub slowed_to: Option<f64>,
}

/// What the memories of several agents knew of one thing over time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Memories {
    /// The thing.
    pub subject: String,
    /// What each came to know, in order of time.
    pub rows: Vec<MemoryRow>,
    /// How far each was from the truth.
    pub distance: Option<TimePlot>,
}

/// Something that one memory came to know, once or several times in a row.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MemoryRow {
    /// Whose memory.
    pub agent: String,
    /// The entity's address there.
    pub entity: String,
    /// When it came to know it first, s of the run.
    pub from_s: f64,
    /// When it was told the same for the last time, s.
    pub to_s: f64,
    /// How often it was told.
    pub count: u64,
    /// The agent who found it out.
    pub origin: String,
    /// What is said, beside the place.
    pub says: String,
    /// Where the thing is said to be, robot's root frame, m.
    pub position: Option<[f64; 3]>,
    /// How far it is trusted, 0 to 1.
    pub confidence: f64,
    /// How far that was from the truth when it came, m.
    pub error_m: Option<f64>,
}

/// A picture of the run, as PNG or JPEG.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Picture {
    /// What is to be seen, and when.
    pub caption: String,
    /// The encoded image.
    pub data: Vec<u8>,
    /// `image/png` or `image/jpeg`.
    pub media_type: String,
}

impl Picture {
    /// A picture of an image, as JPEG of good quality.
    ///
    /// # Errors
    /// What the encoder says, when it cannot hold the image.
    pub fn jpeg(image: &Image, caption: impl Into<String>) -> Result<Self, image::ImageError> {
        let mut data = Vec::with_capacity(image.data().len() / 8);
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut data, 85).encode(
            image.data(),
            image.width(),
            image.height(),
            image::ExtendedColorType::Rgb8,
        )?;
        Ok(Self { caption: caption.into(), data, media_type: "image/jpeg".into() })
    }
}

impl WipedArea {
    /// Rows along y.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.cells.len().checked_div(self.columns).unwrap_or(0)
    }

    /// Part of the cells on the sponge's way that were cleaned; `None` when there are none.
    #[must_use]
    pub fn fraction(&self) -> Option<f64> {
        let count = |kind: Cell| self.cells.iter().filter(|cell| **cell == kind).count() as f64;
        let (cleaned, missed) = (count(Cell::Cleaned), count(Cell::Missed));
        (cleaned + missed > 0.0).then(|| cleaned / (cleaned + missed))
    }
}
