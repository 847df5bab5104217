//! Curves over any two axes as a separate SVG file, used for the reproduced experiments.
//!
//! The plots of the page share its style sheet. A separate file embeds the part it needs, so that it follows the light
//! and dark colour scheme wherever it is shown.

use super::axes::{Axes, Key, legend, legend_height, range_of};
use super::svg::{Anchor, Svg};

const STYLE: &str = include_str!("style.css");
const WIDTH: f64 = 1000.0;
const GAP: f64 = 14.0;

/// The style of a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Look {
    /// In the next colour.
    #[default]
    Next,
    /// In the colour of this number (1 to 6), so that the same quantity has the same colour in every panel.
    Colour(u8),
    /// Dashed and grey: an earlier state, or a reference.
    Reference,
    /// Thin and pale: one of many curves.
    Faint,
    /// Separate points in the colour of this number (1 to 6).
    Dots(u8),
}

/// Points joined by a line, in the given order. A point that is not finite interrupts the line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Its name in the legend; an empty name omits it from the legend.
    pub label: String,
    /// Points x, y.
    pub points: Vec<[f64; 2]>,
    /// Its style.
    pub look: Look,
}

/// One pair of axes with its curves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// The horizontal axis with its unit.
    pub x_label: String,
    /// The vertical axis with its unit.
    pub y_label: String,
    /// The curves; later ones are drawn on top.
    pub curves: Vec<Curve>,
    /// Marked places on the horizontal axis, with their names.
    pub marks: Vec<(f64, String)>,
    /// Whether both axes have the same scale: for paths in space.
    pub equal_units: bool,
    /// Range of y, if it should not follow the data.
    pub y_range: Option<[f64; 2]>,
}

/// Panels side by side, of equal width.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PanelRow {
    /// Height with labels and legend, px of a picture 1000 px wide.
    pub height: f64,
    /// The panels from left to right.
    pub panels: Vec<Panel>,
}

impl Curve {
    /// A curve of this name in the next colour.
    pub fn new(label: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { label: label.into(), points, look: Look::Next }
    }

    /// The same with this style.
    #[must_use]
    pub fn looking(self, look: Look) -> Self {
        Self { look, ..self }
    }
}

/// Draws the rows as one SVG file. `title` is for screen readers.
pub fn picture(title: &str, rows: &[PanelRow]) -> String {
    let height: f64 = rows.iter().map(|row| row.height + GAP).sum::<f64>() + GAP;
    let mut svg = Svg::new(WIDTH, height, title);
    svg.rect([0.0, 0.0], [WIDTH, height], "paper", "");
    let mut top = GAP;
    for row in rows {
        let width = WIDTH / row.panels.len().max(1) as f64;
        for (i, panel) in row.panels.iter().enumerate() {
            draw(&mut svg, panel, [width * i as f64, top], [width, row.height]);
        }
        top += row.height + GAP;
    }
    let picture = svg.finish("wide");
    picture.replacen('>', &format!("><style>{}</style>", style()), 1) + "\n"
}

/// The rules of the page's style sheet that a separate file needs, and its own rules.
fn style() -> String {
    let own = ".plot text{font-family:system-ui,\"DejaVu Sans\",sans-serif}.plot .paper{fill:var(--card)}\
               .plot .faint{stroke:var(--soft);stroke-width:.7;opacity:.45}";
    let needed = |line: &&str| {
        line.starts_with(":root") || line.starts_with("@media (prefers") || line.starts_with(".plot ")
    };
    STYLE.lines().filter(needed).collect::<String>() + own
}

fn class_of(look: Look, index: usize) -> String {
    match look {
        Look::Next => format!("line c{}", index % 6 + 1),
        Look::Colour(n) => format!("line c{}", (n.max(1) - 1) % 6 + 1),
        Look::Reference => "line demonstrated".to_owned(),
        Look::Faint => "line faint".to_owned(),
        Look::Dots(n) => format!("dot c{}", (n.max(1) - 1) % 6 + 1),
    }
}

fn draw(svg: &mut Svg, panel: &Panel, at: [f64; 2], size: [f64; 2]) {
    let classes: Vec<String> = panel.curves.iter().enumerate().map(|(i, c)| class_of(c.look, i)).collect();
    let entries: Vec<_> = (panel.curves.iter().zip(&classes))
        .filter(|(curve, _)| !curve.label.is_empty())
        .map(|(curve, class)| (curve.label.clone(), class.replace("dot", "line"), Key::Line))
        .collect();
    let (left, width) = (at[0] + 62.0, size[0] - 62.0 - 16.0);
    let keys = legend_height(&entries, width);
    let values = |axis: usize| panel.curves.iter().flat_map(move |c| c.points.iter().map(move |p| p[axis]));
    let margin = if panel.equal_units { 0.08 } else { 0.0 };
    let axes = Axes {
        left,
        top: at[1] + 26.0 + keys,
        width,
        height: (size[1] - keys - 26.0 - 42.0).max(40.0),
        x: range_of(values(0), margin),
        y: panel.y_range.filter(|[low, high]| low < high).unwrap_or_else(|| range_of(values(1), 0.08)),
    };
    let axes = if panel.equal_units { axes.with_equal_units() } else { axes };
    legend(svg, [left, at[1] + 2.0], width, &entries);
    axes.draw(svg, &panel.x_label);
    svg.text([axes.left, axes.top - 10.0], Anchor::Start, "label", &panel.y_label);
    svg.clipped([axes.left, axes.top], [axes.width, axes.height], |svg| {
        for (curve, class) in panel.curves.iter().zip(&classes) {
            line(svg, curve, class, &axes);
        }
    });
    for (x, name) in &panel.marks {
        let [x, _] = axes.point(*x, axes.y[0]);
        svg.line([x, axes.top], [x, axes.bottom()], "mark");
        svg.text([x + 4.0, axes.top + 14.0], Anchor::Start, "marked", name);
    }
}

fn line(svg: &mut Svg, curve: &Curve, class: &str, axes: &Axes) {
    let finite = |p: &[f64; 2]| p[0].is_finite() && p[1].is_finite();
    for piece in curve.points.split(|p| !finite(p)).filter(|piece| !piece.is_empty()) {
        let points = piece.iter().map(|p| axes.point(p[0], p[1]));
        if let Look::Dots(_) = curve.look {
            points.for_each(|p| svg.circle(p, 3.5, class));
        } else {
            svg.polyline(simplified(&points.collect::<Vec<_>>()), class);
        }
    }
}

/// Largest deviation of the simplified line from the curve, in the picture's unit; less than a screen
/// resolves.
const TOLERANCE: f64 = 0.12;

/// A small subset of the points whose line stays within [`TOLERANCE`] of all points, peaks included (Douglas
/// and Peucker 1973).
fn simplified(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut keep = vec![false; points.len()];
    for end in [0, points.len().saturating_sub(1)] {
        keep.get_mut(end).into_iter().for_each(|keep| *keep = true);
    }
    let mut open = vec![(0, points.len().saturating_sub(1))];
    while let Some((from, to)) = open.pop() {
        let off = |k: &usize| distance(points[*k], points[from], points[to]);
        let Some(farthest) = (from + 1..to).max_by(|a, b| off(a).total_cmp(&off(b))) else { continue };
        if off(&farthest) > TOLERANCE {
            keep[farthest] = true;
            open.extend([(from, farthest), (farthest, to)]);
        }
    }
    points.iter().zip(keep).filter(|(_, keep)| *keep).map(|(p, _)| *p).collect()
}

/// Distance of `p` from the line segment between `a` and `b`.
fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let from = [p[0] - a[0], p[1] - a[1]];
    let length = along[0] * along[0] + along[1] * along[1];
    let share = if length > 0.0 { (from[0] * along[0] + from[1] * along[1]) / length } else { 0.0 };
    let share = share.clamp(0.0, 1.0);
    libm::hypot(from[0] - share * along[0], from[1] - share * along[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_stands_alone_and_holds_every_curve() {
        let wave = |f: f64| (0..100).map(|i| f64::from(i) * 0.1).map(|t| [t, libm::sin(f * t)]).collect();
        let mut broken: Vec<[f64; 2]> = wave(2.0);
        broken[50][1] = f64::NAN;
        let panel = Panel {
            x_label: "time, s".into(),
            y_label: "a < b".into(),
            curves: vec![Curve::new("one", wave(1.0)), Curve::new("", broken).looking(Look::Reference)],
            marks: vec![(5.0, "half".into())],
            ..Panel::default()
        };
        let svg = picture("waves", &[PanelRow { height: 200.0, panels: vec![panel.clone(), panel] }]);
        assert!(svg.starts_with("<svg") && svg.contains("<style>:root") && svg.contains("a &lt; b"));
        assert_eq!(svg.matches("<polyline").count(), 6, "a line that is interrupted is two");
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn a_curve_is_drawn_with_few_points_and_no_peak_is_lost() {
        let mut points: Vec<[f64; 2]> =
            (0..5000).map(|i| [f64::from(i) * 0.2, 50.0 * libm::sin(f64::from(i) * 0.01)]).collect();
        points[2500][1] = 400.0;
        let few = simplified(&points);
        assert!(few.len() < 700 && few.contains(&[500.0, 400.0]), "{}", few.len());
        for p in &points {
            let nearest = few.windows(2).map(|w| distance(*p, w[0], w[1])).fold(f64::INFINITY, f64::min);
            assert!(nearest <= TOLERANCE);
        }
        assert_eq!(simplified(&[]), Vec::<[f64; 2]>::new());
        assert_eq!(simplified(&[[1.0, 2.0]; 9]).len(), 2);
    }

    #[test]
    fn nothing_is_drawn_of_nothing() {
        let svg =
            picture("", &[PanelRow { height: 100.0, panels: vec![Panel::default()] }, PanelRow::default()]);
        assert!(svg.ends_with("</svg>\n") && !svg.contains("<polyline"));
    }
}
