//! Axes: mapping of values to pixels, round ticks, grid, labels, legend.

use super::svg::{Anchor, Svg, text_width};

/// A plot's rectangle in pixels and the values at its edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axes {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) width: f64,
    pub(super) height: f64,
    /// Values at the left and right edge.
    pub(super) x: [f64; 2],
    /// Values at the lower and upper edge.
    pub(super) y: [f64; 2],
}

impl Axes {
    pub(super) fn point(&self, x: f64, y: f64) -> [f64; 2] {
        let across = (x - self.x[0]) / (self.x[1] - self.x[0]);
        let up = (y - self.y[0]) / (self.y[1] - self.y[0]);
        [self.left + across * self.width, self.top + (1.0 - up) * self.height]
    }

    pub(super) fn right(&self) -> f64 {
        self.left + self.width
    }

    pub(super) fn bottom(&self) -> f64 {
        self.top + self.height
    }

    /// The same centre, with ranges widened until one unit is as long along x as along y.
    #[must_use]
    pub(super) fn with_equal_units(mut self) -> Self {
        let per_x = (self.x[1] - self.x[0]) / self.width;
        let per_y = (self.y[1] - self.y[0]) / self.height;
        let unit = per_x.max(per_y);
        for (range, length) in [(&mut self.x, self.width), (&mut self.y, self.height)] {
            let centre = (range[0] + range[1]) / 2.0;
            *range = [centre - unit * length / 2.0, centre + unit * length / 2.0];
        }
        self
    }

    /// Draws grid, ticks with numbers, the frame, and the x label below it.
    pub(super) fn draw(&self, svg: &mut Svg, x_label: &str) {
        for (tick, text) in ticks(self.x, (self.width / 80.0).clamp(3.0, 12.0) as usize) {
            let [px, _] = self.point(tick, self.y[0]);
            svg.line([px, self.top], [px, self.bottom()], "grid");
            svg.text([px, self.bottom() + 17.0], Anchor::Middle, "tick", &text);
        }
        for (tick, text) in ticks(
            self.y,
            (self.height / if self.height < 180.0 { 26.0 } else { 42.0 }).clamp(3.0, 10.0) as usize,
        ) {
            let [_, py] = self.point(self.x[0], tick);
            svg.line([self.left, py], [self.right(), py], "grid");
            svg.text([self.left - 7.0, py + 4.0], Anchor::End, "tick", &text);
        }
        svg.line([self.left, self.bottom()], [self.right(), self.bottom()], "axis");
        svg.line([self.left, self.top], [self.left, self.bottom()], "axis");
        if !x_label.is_empty() {
            svg.text([self.right(), self.bottom() + 34.0], Anchor::End, "label", x_label);
        }
    }
}

/// Round numbers within a range, about `count` of them, as values and as texts of equal precision.
pub(super) fn ticks(range: [f64; 2], count: usize) -> Vec<(f64, String)> {
    let span = range[1] - range[0];
    if !span.is_finite() || span <= 0.0 {
        return Vec::new();
    }
    let raw = span / count.max(1) as f64;
    let power = libm::pow(10_f64, libm::log10(raw).floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= raw * 0.999).unwrap_or(raw);
    let digits = (-libm::log10(step * 1.001).floor()).clamp(0.0, 9.0) as usize;
    let first = (range[0] / step - 1e-9).ceil() as i64;
    let last = (range[1] / step + 1e-9).floor() as i64;
    (first..=last.min(first.saturating_add(100)))
        .map(|i| {
            let value = i as f64 * step;
            (value, format!("{value:.digits$}").replace('-', "−"))
        })
        .collect()
}

/// The smallest range that contains all finite values, slightly enlarged; one unit around a single value.
pub(super) fn range_of(values: impl IntoIterator<Item = f64>, margin: f64) -> [f64; 2] {
    let (low, high) = values
        .into_iter()
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return [0.0, 1.0];
    }
    let span = high - low;
    let extra = if span > 1e-9 * (1.0 + low.abs()) { span * margin } else { 0.5 };
    [low - extra, high + extra]
}

/// The symbol of a legend entry.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Key {
    Line,
    Area,
}

/// Height that a legend of these entries needs within a width, px.
pub(super) fn legend_height(entries: &[(String, String, Key)], width: f64) -> f64 {
    layout(entries, width).last().map_or(0.0, |[_, y]| y + 20.0)
}

fn layout(entries: &[(String, String, Key)], width: f64) -> Vec<[f64; 2]> {
    let mut at = [0.0_f64, 0.0];
    entries
        .iter()
        .map(|(label, ..)| {
            let needed = 30.0 + text_width(label);
            if at[0] > 0.0 && at[0] + needed > width {
                at = [0.0, at[1] + 20.0];
            }
            let place = at;
            at[0] += needed + 18.0;
            place
        })
        .collect()
}

/// Draws a legend: entries are name, class and kind.
pub(super) fn legend(svg: &mut Svg, at: [f64; 2], width: f64, entries: &[(String, String, Key)]) {
    for ([dx, dy], (label, class, key)) in layout(entries, width).into_iter().zip(entries) {
        let (x, y) = (at[0] + dx, at[1] + dy);
        match key {
            Key::Line => svg.line([x, y + 9.0], [x + 22.0, y + 9.0], class),
            Key::Area => svg.rect([x, y + 3.0], [22.0, 12.0], class, ""),
        }
        svg.text([x + 28.0, y + 13.5], Anchor::Start, "label", label);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(range: [f64; 2], count: usize) -> Vec<String> {
        ticks(range, count).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_round_and_within_the_range() {
        assert_eq!(texts([0.0, 10.0], 5), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(texts([-0.11, 0.12], 4), ["−0.1", "0.0", "0.1"]);
        assert_eq!(texts([0.0, 97.0], 10), ["0", "10", "20", "30", "40", "50", "60", "70", "80", "90"]);
        assert!(texts([f64::NAN, 1.0], 4).is_empty() && texts([1.0, 1.0], 4).is_empty());
    }

    #[test]
    fn a_range_holds_what_is_finite() {
        assert_eq!(range_of([1.0, f64::NAN, 3.0], 0.5), [0.0, 4.0]);
        assert_eq!(range_of([2.0], 0.1), [1.5, 2.5]);
        assert_eq!(range_of([], 0.1), [0.0, 1.0]);
    }

    #[test]
    fn equal_units_keep_the_centre_and_never_narrow() {
        let axes = Axes { left: 0.0, top: 0.0, width: 200.0, height: 100.0, x: [0.0, 1.0], y: [0.0, 1.0] };
        let equal = axes.with_equal_units();
        assert_eq!((equal.x, equal.y), ([-0.5, 1.5], [0.0, 1.0]));
    }
}
