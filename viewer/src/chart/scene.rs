//! A picture as a list of shapes with positions, which [`svg`](super::svg) and [`png`](super::png) write. Each shape has
//! the part that its colour plays; a theme gives the colour.

use armarium_runtime::chart::{Outline, OutlineKind};

use super::font::{LINE, SIZE, Weight, width};
use super::geometry::{LineStep, Point, Rect, Size};
use super::graph::Graph;
use super::nested::{DOT, EXIT_GAP, PAD, PILL, PILL_PAD, Placed, exit_target, label_size, lay_out};

/// Margin around the picture, px.
const MARGIN: f64 = 12.0;
/// Width of a chart that should not be exceeded, px: fitted to a screen of 1600 px, its text has 11 of its 12 px.
const BREADTH: f64 = 1700.0;

/// Half the width of an arrow's head relative to its length.
const HEAD_SLOPE: f64 = 0.45;

/// What a colour is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ink {
    Paper,
    Text,
    Soft,
    Label,
    Line,
    Box,
    Skill,
    Chart,
    End,
    Bad,
}

/// For each ink, in order: its name, and its colour in the light and in the dark theme, red, green and blue.
pub(super) const PALETTE: [(&str, u32, u32); 10] = [
    ("paper", 0xff_ff_ff, 0x14_17_1d),
    ("text", 0x1c_23_30, 0xe6_e9_f0),
    ("soft", 0x4c_55_66, 0xa9_b2_c4),
    ("label", 0x1f_4e_8c, 0x9d_bc_f0),
    ("line", 0x56_62_7a, 0x8d_99_b0),
    ("box", 0xf3_f5_f9, 0x1d_22_2b),
    ("skill", 0xdf_eb_fb, 0x1d_30_4c),
    ("chart", 0xe6_e1_fa, 0x2e_28_4d),
    ("end", 0xdc_f1_e0, 0x1c_3a_27),
    ("bad", 0xfa_e0_dd, 0x4d_26_23),
];

/// A shape; later shapes lie above earlier ones.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum DrawnShape {
    /// A rectangle with round corners and a border.
    Frame {
        at: Rect,
        radius: f64,
        fill: Ink,
        dashed: bool,
        /// The path of the state whose box it is.
        state: Option<String>,
    },
    /// A line of straight and curved parts.
    Line(Vec<LineStep>),
    /// The triangle at the end of an arrow; the tip is in the middle.
    Head([Point; 3]),
    /// A dot: centre and radius.
    Dot(Point, f64),
    /// A line of text: left end of its base line.
    Text { at: Point, text: String, ink: Ink, weight: Weight },
}

/// A picture.
pub(super) struct ChartPicture {
    pub(super) title: String,
    pub(super) size: Size,
    pub(super) shapes: Vec<DrawnShape>,
}

impl ChartPicture {
    /// The picture of a chart.
    pub(super) fn of(outline: &Outline) -> Self {
        let mut whole = lay_out(outline, &Graph::of(outline), 0, BREADTH);
        whole.move_by((MARGIN, MARGIN));
        let Size { width, height } = whole.frame.size;
        let size = Size { width: width + 2.0 * MARGIN, height: height + 2.0 * MARGIN };
        let mut scene = Self { title: whole.title.clone(), size, shapes: Vec::new() };
        scene.state(outline, &whole, 0);
        scene
    }

    fn state(&mut self, outline: &Outline, placed: &Placed, depth: usize) {
        let of = &outline.states[placed.state];
        let at = placed.frame;
        let fill = match &of.kind {
            OutlineKind::Composite | OutlineKind::Parallel if !of.children.is_empty() => {
                if depth.is_multiple_of(2) { Ink::Paper } else { Ink::Box }
            }
            // What has more inside than is shown looks like a chart.
            OutlineKind::Composite | OutlineKind::Parallel => Ink::Chart,
            kind => of_leaf(kind),
        };
        let region = of.parent.is_some_and(|p| outline.states[p].kind == OutlineKind::Parallel);
        let history = matches!(of.kind, OutlineKind::History { .. });
        let radius = if history { at.size.height / 2.0 } else { 8.0 };
        let state = Some(outline.path(placed.state)).filter(|path| !path.is_empty());
        self.shapes.push(DrawnShape::Frame { at, radius, fill, dashed: region, state });
        if matches!(of.kind, OutlineKind::Final(_)) {
            let inner = Rect {
                x: at.x + 3.0,
                y: at.y + 3.0,
                size: Size { width: at.size.width - 6.0, height: at.size.height - 6.0 },
            };
            self.shapes.push(DrawnShape::Frame { at: inner, radius: 6.0, fill, dashed: false, state: None });
        }
        self.texts(outline, placed, history);
        if let Some((x, y)) = placed.dot {
            self.shapes.push(DrawnShape::Dot((x + DOT / 2.0, y + DOT / 2.0), DOT / 2.0));
        }
        placed.inside.iter().for_each(|inner| self.state(outline, inner, depth + 1));
        for (label, route) in &placed.arrows {
            self.shapes.push(DrawnShape::Line(route.line.clone()));
            let (base, tip) = route.head;
            let aside = ((tip.1 - base.1) * HEAD_SLOPE, (tip.0 - base.0) * HEAD_SLOPE);
            let corners = [(base.0 - aside.0, base.1 - aside.1), tip, (base.0 + aside.0, base.1 + aside.1)];
            self.shapes.push(DrawnShape::Head(corners));
            let top = route.label.1 - label_size(label).height / 2.0;
            for (number, line) in label.iter().enumerate() {
                let x = route.label.0 - width(line, Weight::Regular) / 2.0;
                self.text((x, top + number as f64 * LINE), line, Ink::Label, Weight::Regular);
            }
        }
    }

    /// The texts of a state from top to bottom: name and kind in the middle, notes and exits at the left.
    fn texts(&mut self, outline: &Outline, placed: &Placed, history: bool) {
        let Rect { x, y, size } = placed.frame;
        let middle = |text: &str, weight| x + (size.width - width(text, weight)) / 2.0;
        let mut y = if history { y + (size.height - LINE) / 2.0 } else { y + 6.0 };
        self.text((middle(&placed.title, Weight::Bold), y), &placed.title, Ink::Text, Weight::Bold);
        y += LINE;
        if !placed.subtitle.is_empty() {
            let x = middle(&placed.subtitle, Weight::Regular);
            self.text((x, y), &placed.subtitle, Ink::Soft, Weight::Regular);
            y += LINE;
        }
        for note in &placed.notes {
            self.text((x + PAD, y), note, Ink::Soft, Weight::Regular);
            y += LINE;
        }
        let labels = placed.exits.iter().map(|exit| label_size(&exit.label).width).fold(0.0, f64::max);
        let left = x + PAD + labels + PILL_PAD;
        for exit in &placed.exits {
            y += EXIT_GAP;
            for (number, line) in exit.label.iter().enumerate() {
                self.text((x + PAD, y + 1.0 + number as f64 * LINE), line, Ink::Label, Weight::Regular);
            }
            let target = exit_target(outline, exit);
            let width = width(&target, Weight::Regular) + 2.0 * PILL_PAD;
            let at = Rect { x: left, y, size: Size { width, height: PILL } };
            let fill = of_leaf(&outline.states[exit.target].kind);
            self.shapes.push(DrawnShape::Frame { at, radius: PILL / 2.0, fill, dashed: false, state: None });
            self.text((left + PILL_PAD, y + 1.0), &target, Ink::Text, Weight::Regular);
            y += (exit.label.len() as f64 * LINE).max(PILL);
        }
    }

    /// Adds a line of text by the upper left corner of its line.
    fn text(&mut self, (x, top): Point, text: &str, ink: Ink, weight: Weight) {
        let at = (x, top + (LINE + SIZE) / 2.0 - 2.0);
        self.shapes.push(DrawnShape::Text { at, text: text.to_owned(), ink, weight });
    }
}

fn of_leaf(kind: &OutlineKind) -> Ink {
    match kind {
        OutlineKind::Skill(_) => Ink::Skill,
        OutlineKind::Chart(_) | OutlineKind::Remote(_) => Ink::Chart,
        OutlineKind::Final(outcome) if outcome == "failure" => Ink::Bad,
        OutlineKind::Final(_) => Ink::End,
        _ => Ink::Box,
    }
}
