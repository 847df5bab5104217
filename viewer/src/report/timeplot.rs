//! Signals over time, with their target band, limits, and marked times.

use armarium_values::report::TimePlot;

use super::axes::{Axes, Key, legend, legend_height, range_of};
use super::series::thinned;
use super::svg::{Anchor, Svg, fit, text_width};

/// The size of a plot.
#[derive(Clone, Copy)]
pub(super) struct PlotSize {
    pub(super) width: f64,
    pub(super) height: f64,
    /// Whether it is one of several: title inside the picture, no repeated labels.
    pub(super) small: bool,
}

/// The page's whole width.
pub(super) const WIDE: PlotSize = PlotSize { width: 1000.0, height: 320.0, small: false };
/// Two side by side.
pub(super) const SMALL: PlotSize = PlotSize { width: 490.0, height: 190.0, small: true };

/// Draws the plot as SVG.
pub(super) fn draw(plot: &TimePlot, time: [f64; 2], size: PlotSize) -> String {
    let entries = entries(plot, size);
    let left = 58.0;
    let width = size.width - left - 16.0;
    let keys = legend_height(&entries, width);
    let bottom = if size.small { 24.0 } else { 42.0 };
    let height = size.height - 26.0 - bottom;
    let mut axes = Axes { left, top: 26.0 + keys, width, height, x: time, y: value_range(plot) };
    let marks = place_marks(plot, &axes);
    let names = marks.iter().map(|mark| MARK_LINE * (mark.level + 1) as f64).fold(0.0, f64::max);
    let y_label_at = [axes.left, axes.top - 10.0];
    axes.top += names;
    let mut svg = Svg::new(size.width, size.height + keys + names, &plot.title);
    legend(&mut svg, [left, 2.0], width, &entries);
    let y_label =
        if size.small { format!("{} · {}", plot.title, plot.y_label) } else { plot.y_label.clone() };
    axes.draw(&mut svg, if size.small { "" } else { "time, s" });
    svg.text(y_label_at, Anchor::Start, "label", &y_label);
    svg.clipped([axes.left, axes.top], [axes.width, axes.height], |svg| content(svg, plot, &axes));
    draw_marks(&mut svg, &marks, &axes);
    svg.finish(if size.small { "small" } else { "wide" })
}

fn value_range(plot: &TimePlot) -> [f64; 2] {
    if let Some([low, high]) = plot.y_range.filter(|[low, high]| low < high && (high - low).is_finite()) {
        return [low, high];
    }
    let data = plot.series.iter().flat_map(|s| s.y.iter().copied());
    let limits = plot.limits.iter().map(|(value, _)| *value);
    let band = plot.band.iter().flat_map(|b| [b.value - b.tolerance, b.value + b.tolerance]);
    range_of(data.chain(limits).chain(band), 0.06)
}

fn class_of(index: usize) -> String {
    format!("line c{}", index % 6 + 1)
}

fn entries(plot: &TimePlot, size: PlotSize) -> Vec<(String, String, Key)> {
    if size.small && plot.series.len() < 2 {
        return Vec::new();
    }
    let mut entries: Vec<_> = plot
        .series
        .iter()
        .enumerate()
        .map(|(i, series)| (series.label.clone(), class_of(i), Key::Line))
        .collect();
    entries.extend(plot.band.iter().map(|band| (band.label.clone(), "band".to_owned(), Key::Area)));
    let mut limits: Vec<&String> = plot.limits.iter().map(|(_, name)| name).collect();
    limits.dedup();
    entries.extend(limits.into_iter().map(|name| (name.clone(), "limit".to_owned(), Key::Line)));
    entries
}

fn content(svg: &mut Svg, plot: &TimePlot, axes: &Axes) {
    if let Some(band) = &plot.band {
        let from = band.from_s.unwrap_or(axes.x[0]).max(axes.x[0]);
        let to = band.to_s.unwrap_or(axes.x[1]).min(axes.x[1]);
        let [x0, y0] = axes.point(from, band.value + band.tolerance);
        let [x1, y1] = axes.point(to, band.value - band.tolerance);
        svg.rect([x0, y0], [x1 - x0, y1 - y0], "band", &band.label);
        let middle = axes.point(from, band.value)[1];
        svg.line([x0, middle], [x1, middle], "target");
    }
    for (value, _) in &plot.limits {
        let y = axes.point(axes.x[0], *value)[1];
        svg.line([axes.left, y], [axes.right(), y], "limit");
    }
    for (i, series) in plot.series.iter().enumerate() {
        for piece in thinned(&series.t_s, &series.y, axes.x, (axes.width * 0.9) as usize) {
            svg.polyline(piece.into_iter().map(|[t, y]| axes.point(t, y)), &class_of(i));
        }
    }
}

/// A marked time: its line, and its name with a position.
struct BandMark {
    x: f64,
    name: String,
    anchor: Anchor,
    level: usize,
}

const MARK_LEVELS: usize = 3;
const MARK_LINE: f64 = 16.0;

/// Places the marks' names on up to three lines without overlap; a name without space is omitted, its line
/// stays.
fn place_marks(plot: &TimePlot, axes: &Axes) -> Vec<BandMark> {
    let mut ends = [f64::NEG_INFINITY; MARK_LEVELS];
    let mut marks: Vec<BandMark> = Vec::new();
    for (t, name) in plot.marks.iter().filter(|(t, _)| (axes.x[0]..=axes.x[1]).contains(t)) {
        let x = axes.point(*t, axes.y[0])[0];
        let mut name = fit(name, 150.0);
        let width = text_width(&name);
        let (anchor, start) =
            if x + width > axes.right() { (Anchor::End, x - width) } else { (Anchor::Start, x) };
        let level = ends.iter().position(|end| *end + 10.0 < start).unwrap_or_else(|| {
            name.clear();
            0
        });
        if !name.is_empty() {
            ends[level] = start + width;
        }
        marks.push(BandMark { x, name, anchor, level });
    }
    marks
}

fn draw_marks(svg: &mut Svg, marks: &[BandMark], axes: &Axes) {
    for mark in marks {
        let top = axes.top - MARK_LINE * mark.level as f64;
        svg.line([mark.x, top], [mark.x, axes.bottom()], "mark");
        svg.text([mark.x, top - 4.0], mark.anchor, "marked", &mark.name);
    }
}
