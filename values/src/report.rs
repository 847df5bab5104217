//! A report as plain data: sections of blocks. Who measured something supplies a section and does not know who draws it; a
//! page, a document and a terminal draw the same blocks.
//!
//! Lengths are in metres, times in seconds, in the frames that a block's labels name.

use serde::{Deserialize, Serialize};

/// A part of a report with a title of its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// Its heading.
    pub title: String,
    /// One sentence under it; may be empty.
    pub note: String,
    /// What it shows, from top to bottom.
    pub blocks: Vec<Block>,
}

impl Section {
    /// A section with these blocks.
    #[must_use]
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

/// Something that a section shows. A block without content is not shown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Block {
    /// Measured values and what is asked of them.
    Figures(Vec<Figure>),
    /// Signals over the time of the run.
    Plot(TimePlot),
    /// Many plots over the time of the run, drawn small beside each other.
    SmallPlots(Vec<TimePlot>),
    /// Something seen from above.
    Plan(Plan),
    /// States through time.
    Gantt(Vec<StateSpan>),
    /// Rows and columns.
    Table(Table),
    /// How often something was taken for something else.
    Confusion(Confusion),
    /// Pictures with captions.
    Pictures(Vec<Picture>),
    /// Lines of text as they are.
    Lines(Vec<String>),
}

/// What is asked of a value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Requirement {
    /// At most this.
    AtMost(f64),
    /// At least this.
    AtLeast(f64),
    /// Between these two.
    Between(f64, f64),
    /// Nothing: it is shown, not judged.
    Shown,
}

/// A measured value and what is asked of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// What it belongs to: `Grasp`, `Force` ...
    pub group: String,
    /// What was measured.
    pub name: String,
    /// The value, in the unit; `None` when the run did not come so far.
    pub value: Option<f64>,
    /// Its unit as shown; empty for a number without one.
    pub unit: String,
    /// What is asked of it.
    pub requirement: Requirement,
    /// Digits after the point.
    pub digits: usize,
}

impl Figure {
    /// Whether the value is as required; `None` when nothing is required. A missing value, or one that is not a
    /// number, is not.
    #[must_use]
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

/// Something seen from above: x to the right, y up, one scale for both.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Plan {
    /// What is drawn.
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
    /// Its name in the legend.
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
    /// In a colour of its own, with a dot where it begins.
    #[default]
    Line,
    /// Dashed, on top of the others: what they are compared with.
    Reference,
    /// Thin: for orientation, such as the table's edge. The plan need not show all of it.
    Outline,
    /// Over areas.
    Overlay,
}

/// A grid of cells of several kinds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cells {
    /// Where the first cell's outer corner is (least x and y), m.
    pub origin: [f64; 2],
    /// A cell's side, m.
    pub cell_m: f64,
    /// Cells along x.
    pub columns: usize,
    /// The names of the kinds, for the legend, with their tones; kind 0 is nothing and has none.
    pub kinds: Vec<(String, Tone)>,
    /// The kind of each cell: rows along y, from the least y; each has `columns` cells.
    pub cells: Vec<u8>,
}

impl Cells {
    /// Rows along y.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.cells.len().checked_div(self.columns).unwrap_or(0)
    }
}

/// What something coloured means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tone {
    /// As it should be.
    Good,
    /// As it should not be.
    Bad,
    /// Neither.
    #[default]
    Neutral,
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

/// Rows and columns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// The headings; a column of numbers is aligned to the right.
    pub columns: Vec<Column>,
    /// The rows, each with a cell a column.
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
    /// A table with a column of text for each title, and one of numbers where the title begins with `#`.
    #[must_use]
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
pub enum Cell {
    /// There is nothing to say.
    Absent,
    /// Text.
    Text(String),
    /// A name out of a file or a program.
    Code(String),
    /// Numbers of one unit, with digits after the point.
    Numbers {
        /// One, or the components of a vector.
        values: Vec<f64>,
        /// Their unit as shown; may be empty.
        unit: String,
        /// Digits after the point.
        digits: usize,
    },
}

impl Cell {
    /// A number with its unit.
    #[must_use]
    pub fn number(value: f64, unit: &str, digits: usize) -> Self {
        Self::Numbers { values: vec![value], unit: unit.into(), digits }
    }

    /// A number with its unit, where there is one.
    #[must_use]
    pub fn optional(value: Option<f64>, unit: &str, digits: usize) -> Self {
        value.map_or(Self::Absent, |value| Self::number(value, unit, digits))
    }
}

/// How often something was taken for something else.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confusion {
    /// What there may be, in the order of the columns.
    pub names: Vec<String>,
    /// What there was, and how often it was taken for each of the names.
    pub rows: Vec<(String, Vec<u32>)>,
}

/// A picture, as PNG or JPEG.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Picture {
    /// What is to be seen, and when.
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
