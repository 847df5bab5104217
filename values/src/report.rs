//! A report as plain data: sections of blocks. The code that measures supplies a section without knowing how it is
//! drawn; a page, a document and a terminal draw the same blocks.
//!
//! Lengths are in metres, times in seconds, in the frames that a block's labels name.

use serde::{Deserialize, Serialize};

/// A part of a report with its own title.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// Its heading.
    pub title: String,
    /// One sentence below the heading; may be empty.
    pub note: String,
    /// Its content, from top to bottom.
    pub blocks: Vec<Block>,
}

impl Section {
    /// A section with these blocks.
    pub fn new(title: &str, note: &str, blocks: Vec<Block>) -> Self {
        Self { title: title.into(), note: note.into(), blocks }
    }

    /// The figures of all its blocks.
    pub fn figures(&self) -> impl Iterator<Item = &Figure> {
        self.blocks
            .iter()
            .filter_map(|block| if let Block::Figures(figures) = block { Some(figures) } else { None })
            .flatten()
    }
}

/// Content of a section. An empty block is not shown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Block {
    /// Measured values with their requirements.
    Figures(Vec<Figure>),
    /// Signals over the time of the run.
    Plot(TimePlot),
    /// Many plots over the time of the run, drawn small beside each other.
    SmallPlots(Vec<TimePlot>),
    /// A view from above.
    Plan(Plan),
    /// States through time.
    Gantt(Vec<StateSpan>),
    /// Rows and columns.
    Table(Table),
    /// A confusion matrix.
    Confusion(Confusion),
    /// Pictures with captions.
    Pictures(Vec<Picture>),
    /// Preformatted lines of text.
    Lines(Vec<String>),
}

/// The requirement on a value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Requirement {
    /// At most this.
    AtMost(f64),
    /// At least this.
    AtLeast(f64),
    /// Between these two.
    Between(f64, f64),
    /// No requirement: the value is shown, not judged.
    Shown,
}

/// A measured value with its requirement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Its group: `Grasp`, `Force` ...
    pub group: String,
    /// What was measured.
    pub name: String,
    /// The value, in the unit; `None` when the run ended before the measurement.
    pub value: Option<f64>,
    /// Its unit as text; empty for a number without unit.
    pub unit: String,
    /// Its requirement.
    pub requirement: Requirement,
    /// Digits after the point.
    pub digits: usize,
}

impl Figure {
    /// Whether the value meets its requirement; `None` when there is none. A missing value or a NaN fails.
    pub fn passed(&self) -> Option<bool> {
        let good = |test: &dyn Fn(f64) -> bool| Some(self.value.is_some_and(test));
        match self.requirement {
            Requirement::AtMost(bound) => good(&|v| v <= bound),
            Requirement::AtLeast(bound) => good(&|v| v >= bound),
            Requirement::Between(low, high) => good(&|v| (low..=high).contains(&v)),
            Requirement::Shown => None,
        }
    }
}

/// Signals over time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TimePlot {
    /// Its title.
    pub title: String,
    /// The vertical axis with its unit: `Normal force, N`.
    pub y_label: String,
    /// The signals.
    pub series: Vec<Series>,
    /// The desired range of the signal.
    pub band: Option<Band>,
    /// Limits that the signal must not exceed, with their names.
    pub limits: Vec<(f64, String)>,
    /// Marked times, s, with their names.
    pub marks: Vec<(f64, String)>,
    /// The shown range of values; `None` follows the data.
    pub y_range: Option<[f64; 2]>,
}

/// One signal. Times ascend; both lists have the same length. NaN interrupts the line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Its name in the legend.
    pub label: String,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Values, in the plot's unit.
    pub y: Vec<f64>,
}

/// The desired range of a signal, for a part of the time or all of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// The desired value.
    pub value: f64,
    /// The accepted deviation.
    pub tolerance: f64,
    /// Its name in the legend.
    pub label: String,
    /// Start, s; `None`: from the beginning.
    pub from_s: Option<f64>,
    /// End, s; `None`: to the end.
    pub to_s: Option<f64>,
}

/// A view from above: x to the right, y up, the same scale for both.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Plan {
    /// Its title.
    pub title: String,
    /// The horizontal axis with its unit.
    pub x_label: String,
    /// The vertical axis with its unit.
    pub y_label: String,
    /// Areas, under the lines.
    pub cells: Option<Cells>,
    /// Lines.
    pub paths: Vec<Path>,
}

/// A line of a plan.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Its name in the legend; lines with one name are drawn alike and stand there once.
    pub label: String,
    /// How it is drawn.
    pub style: PathStyle,
    /// Points x, y, m.
    pub points: Vec<[f64; 2]>,
}

/// How a line of a plan is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PathStyle {
    /// In its own colour, with a dot at the start unless it is closed.
    #[default]
    Line,
    /// Dashed, on top of the others: the reference for a comparison.
    Reference,
    /// Thin, for orientation, such as the table's edge. It may extend beyond the plan.
    Outline,
    /// On top of the areas.
    Overlay,
}

/// A grid of cells of several kinds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cells {
    /// The outer corner of the first cell (least x and y), m.
    pub origin: [f64; 2],
    /// A cell's side, m.
    pub cell_m: f64,
    /// Cells along x.
    pub columns: usize,
    /// The names of the kinds for the legend, with their tones; kind 0 is empty and has none.
    pub kinds: Vec<(String, Tone)>,
    /// The kind of each cell: rows along y, from the least y; each has `columns` cells.
    pub cells: Vec<u8>,
}

impl Cells {
    /// Rows along y.
    pub fn rows(&self) -> usize {
        self.cells.len().checked_div(self.columns).unwrap_or(0)
    }
}

/// The meaning of a colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tone {
    /// As desired.
    Good,
    /// Not as desired.
    Bad,
    /// Neither.
    #[default]
    Neutral,
}

/// One activation of a state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StateSpan {
    /// The state's path from the root, parts separated by dots: `Wipe.Coaching.Watching`.
    pub path: String,
    /// Entry, s of the run.
    pub from_s: f64,
    /// Exit, s of the run; `None` when it was active at the end.
    pub to_s: Option<f64>,
    /// Its outcome, if it reported one: `success`, `failure` ...
    pub outcome: Option<String>,
}

/// Rows and columns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// The columns; columns of numbers are aligned to the right.
    pub columns: Vec<Column>,
    /// The rows, each with one cell per column.
    pub rows: Vec<Vec<Cell>>,
}

/// A column of a table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Its heading.
    pub title: String,
    /// Whether it holds numbers.
    pub is_number: bool,
}

impl Table {
    /// A table with one text column per title; titles that begin with `#` are columns of numbers.
    pub fn new(titles: &[&str]) -> Self {
        let column = |title: &&str| match title.strip_prefix('#') {
            Some(title) => Column { title: title.into(), is_number: true },
            None => Column { title: (*title).into(), is_number: false },
        };
        Self { columns: titles.iter().map(column).collect(), rows: Vec::new() }
    }
}

/// A cell of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum Cell {
    /// No content.
    Absent,
    /// Text.
    Text(String),
    /// A name from a file or a program, shown as code.
    Code(String),
    /// A link to another file, by its path relative to the page.
    Link { text: String, to: String },
    /// One number, or the components of a vector; the unit may be empty, `digits` are those after the point.
    Numbers { values: Vec<f64>, unit: String, digits: usize },
}

impl Cell {
    /// A number with its unit.
    pub fn number(value: f64, unit: &str, digits: usize) -> Self {
        Self::Numbers { values: vec![value], unit: unit.into(), digits }
    }

    /// A number with its unit, or an empty cell.
    pub fn optional(value: Option<f64>, unit: &str, digits: usize) -> Self {
        value.map_or(Self::Absent, |value| Self::number(value, unit, digits))
    }
}

/// A confusion matrix: true classes against recognised classes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confusion {
    /// The recognised classes, in the order of the columns.
    pub names: Vec<String>,
    /// The true classes, each with its counts per recognised class.
    pub rows: Vec<(String, Vec<u32>)>,
}

/// A picture, as PNG or JPEG.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Picture {
    /// What the picture shows, and when.
    pub caption: String,
    /// The encoded image.
    pub data: Vec<u8>,
    /// `image/png` or `image/jpeg`.
    pub media_type: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure(value: Option<f64>, requirement: Requirement) -> Figure {
        let text = || "x".to_owned();
        Figure { group: text(), name: text(), value, unit: String::new(), requirement, digits: 1 }
    }

    #[test]
    fn a_bound_counts_as_kept_and_a_missing_value_or_nan_does_not() {
        assert_eq!(figure(Some(15.0), Requirement::AtMost(15.0)).passed(), Some(true));
        assert_eq!(figure(Some(95.0), Requirement::AtLeast(95.0)).passed(), Some(true));
        assert_eq!(figure(Some(2.1), Requirement::Between(1.0, 2.0)).passed(), Some(false));
        assert_eq!(figure(None, Requirement::AtMost(15.0)).passed(), Some(false));
        assert_eq!(figure(Some(f64::NAN), Requirement::AtLeast(0.0)).passed(), Some(false));
        assert_eq!(figure(None, Requirement::Shown).passed(), None);
    }

    #[test]
    fn a_report_is_plain_data() {
        let section = Section::new(
            "Force",
            "",
            vec![
                Block::Figures(vec![figure(Some(1.0), Requirement::AtMost(2.0))]),
                Block::Table(Table {
                    rows: vec![vec![Cell::Text("a".into()), Cell::optional(None, "m", 1)]],
                    ..Table::new(&["who", "#how far"])
                }),
            ],
        );
        let text = serde_json::to_string(&section).unwrap();
        assert_eq!(serde_json::from_str::<Section>(&text).unwrap(), section);
        assert_eq!(section.figures().count(), 1);
    }
}
