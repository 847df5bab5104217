//! A top view: areas, and lines over them. x to the right, y up, equal scales.

use std::collections::BTreeSet;

use armarium_values::report::{Cells, Path, PathStyle, Plan, Tone};
use image::ImageEncoder as _;

use super::axes::{Axes, Key, legend, legend_height, range_of};
use super::svg::{Anchor, Svg, data_uri};

const WIDTH: f64 = 760.0;

/// Axes with equal units below a legend; the height follows from the content.
fn frame(x: [f64; 2], y: [f64; 2], entries: &[(String, String, Key)]) -> Axes {
    let left = 58.0;
    let width = WIDTH - left - 16.0;
    let keys = legend_height(entries, width);
    let height = (width * (y[1] - y[0]) / (x[1] - x[0])).clamp(200.0, 560.0);
    Axes { left, top: 26.0 + keys, width, height, x, y }.with_equal_units()
}

/// The class of each path; lines without an own colour are numbered in order, and those with one label have one.
fn classes(paths: &[Path]) -> Vec<String> {
    let mut labels: Vec<String> = Vec::new();
    let class = |path: &Path| match path.style {
        PathStyle::Reference => "line demonstrated".to_owned(),
        PathStyle::Outline => "line outline".to_owned(),
        PathStyle::Overlay => "line over".to_owned(),
        PathStyle::Line => {
            let known = labels.iter().position(|label| *label == path.label);
            let number = known.unwrap_or_else(|| {
                labels.push(path.label.clone());
                labels.len() - 1
            });
            format!("line c{}", number % 6 + 1)
        }
    };
    paths.iter().map(class).collect()
}

/// Draws a plan as SVG; `None` when it has no content.
pub(super) fn draw(plan: &Plan) -> Option<String> {
    let cells = plan.cells.as_ref().and_then(UsedCells::of);
    let [x, y] = match &cells {
        Some(used) => [range_of(used.x, 0.1), range_of(used.y, 0.1)],
        None => [0, 1].map(|axis| {
            let inner = plan.paths.iter().filter(|p| p.style != PathStyle::Outline);
            range_of(inner.flat_map(|p| p.points.iter().map(move |point| point[axis])), 0.12)
        }),
    };
    let classes = classes(&plan.paths);
    let mut lines: Vec<_> = plan.paths.iter().zip(&classes).collect();
    lines.retain(|(path, _)| !path.points.is_empty());
    // A plan whose areas are empty is not drawn, and neither are its lines.
    if cells.is_none() && (plan.cells.is_some() || lines.is_empty()) {
        return None;
    }
    let kinds = plan.cells.iter().flat_map(|cells| &cells.kinds);
    let kinds = kinds.map(|(label, tone)| (label.clone(), area_class(*tone).to_owned(), Key::Area));
    let mut entries: Vec<_> = kinds
        .chain(lines.iter().map(|(path, class)| (path.label.clone(), (*class).clone(), Key::Line)))
        .collect();
    let mut named = BTreeSet::new();
    entries.retain(|(label, class, _)| named.insert((label.clone(), class.clone())));
    let axes = frame(x, y, &entries);
    let mut svg = Svg::new(WIDTH, axes.bottom() + 42.0, &plan.title);
    legend(&mut svg, [axes.left, 2.0], axes.width, &entries);
    axes.draw(&mut svg, &plan.x_label);
    svg.text([axes.left, axes.top - 10.0], Anchor::Start, "label", &plan.y_label);
    if let Some(used) = &cells {
        let [left, top] = axes.point(used.x[0], used.y[1]);
        let [right, bottom] = axes.point(used.x[1], used.y[0]);
        svg.image([left, top], [right - left, bottom - top], &data_uri("image/png", &used.png()?));
    }
    svg.clipped([axes.left, axes.top], [axes.width, axes.height], |svg| {
        // References are drawn on top; the lines below stay visible between their dashes.
        lines.sort_by_key(|(path, _)| path.style == PathStyle::Reference);
        for (path, class) in lines {
            let finite = path.points.iter().filter(|p| p[0].is_finite() && p[1].is_finite());
            let points: Vec<[f64; 2]> = thinned(finite.map(|p| axes.point(p[0], p[1])));
            let is_closed = path.points.len() > 1 && path.points.first() == path.points.last();
            if matches!(path.style, PathStyle::Line | PathStyle::Reference)
                && !is_closed
                && let Some(start) = points.first()
            {
                svg.circle(*start, 4.0, &class.replace("line", "dot"));
            }
            svg.polyline(points, class);
        }
    });
    Some(svg.finish("plan"))
}

/// Points at least half a pixel apart; the last point is kept.
pub(super) fn thinned(points: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
    let mut kept: Vec<[f64; 2]> = Vec::new();
    let mut last = None;
    for point in points {
        let near = |k: &[f64; 2]| libm::hypot(k[0] - point[0], k[1] - point[1]) < 0.5;
        if kept.last().is_some_and(near) {
            last = Some(point);
        } else {
            kept.push(point);
            last = None;
        }
    }
    kept.extend(last);
    kept
}

fn area_class(tone: Tone) -> &'static str {
    match tone {
        Tone::Good => "cleaned",
        Tone::Bad => "missed",
        Tone::Neutral => "beside",
    }
}

/// The cells of a plan with content, and their bounding rectangle.
struct UsedCells<'c> {
    cells: &'c Cells,
    columns: [usize; 2],
    rows: [usize; 2],
    x: [f64; 2],
    y: [f64; 2],
}

impl<'c> UsedCells<'c> {
    fn of(cells: &'c Cells) -> Option<Self> {
        if !(cells.cell_m.is_finite() && cells.cell_m > 0.0) {
            return None;
        }
        let used = (0..cells.columns * cells.rows()).filter(|i| cells.cells[*i] != 0);
        let used: Vec<(usize, usize)> = used.map(|i| (i % cells.columns, i / cells.columns)).collect();
        let columns = [used.iter().map(|c| c.0).min()?, used.iter().map(|c| c.0).max()? + 1];
        let rows = [used.iter().map(|c| c.1).min()?, used.iter().map(|c| c.1).max()? + 1];
        let at = |axis: usize, cell: usize| cells.origin[axis] + cell as f64 * cells.cell_m;
        let (x, y) = (columns.map(|c| at(0, c)), rows.map(|r| at(1, r)));
        Some(Self { cells, columns, rows, x, y })
    }

    fn png(&self) -> Option<Vec<u8>> {
        let colour = |kind: u8| {
            let tone = usize::from(kind).checked_sub(1).and_then(|kind| self.cells.kinds.get(kind));
            match tone.map(|(_, tone)| tone) {
                None => [0, 0, 0, 0],
                Some(Tone::Good) => [42, 157, 143, 235],
                Some(Tone::Bad) => [214, 73, 51, 255],
                Some(Tone::Neutral) => [150, 195, 235, 190],
            }
        };
        let columns = self.columns[0]..self.columns[1];
        let of_row = |row: usize| columns.clone().map(move |column| row * self.cells.columns + column);
        let pixels = (self.rows[0]..self.rows[1]).rev().flat_map(of_row);
        let pixels: Vec<u8> = pixels.flat_map(|i| colour(self.cells.cells[i])).collect();
        let width = u32::try_from(self.columns[1] - self.columns[0]).ok()?;
        let height = u32::try_from(self.rows[1] - self.rows[0]).ok()?;
        let mut png = Vec::new();
        image::codecs::png::PngEncoder::new(&mut png)
            .write_image(&pixels, width, height, image::ExtendedColorType::Rgba8)
            .ok()?;
        Some(png)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_without_a_used_cell_or_a_size_is_not_drawn() {
        assert!(draw(&Plan::default()).is_none());
        let cells = |cells: Vec<u8>, cell_m: f64| Cells {
            cell_m,
            columns: 2,
            kinds: vec![("cleaned".into(), Tone::Good)],
            cells,
            ..Cells::default()
        };
        let path = Path { points: vec![[0.0, 0.0], [f64::NAN, 0.0]], ..Path::default() };
        let plan = |cells: Cells| Plan { cells: Some(cells), paths: vec![path.clone()], ..Plan::default() };
        assert!(draw(&plan(cells(vec![0; 5], 0.01))).is_none());
        assert!(draw(&plan(cells(vec![1; 5], f64::NAN))).is_none());
        assert!(draw(&plan(cells(vec![1; 5], 0.01))).is_some());
        assert!(draw(&plan(cells(vec![9; 5], 0.01))).is_some(), "a kind without a name is nothing");
    }

    #[test]
    fn lines_of_one_name_are_one_kind_and_closed_ones_have_no_dot() {
        let path = |label: &str, last: [f64; 2]| Path {
            label: label.into(),
            points: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], last],
            ..Path::default()
        };
        let drawn = |paths: Vec<Path>| draw(&Plan { paths, ..Plan::default() }).unwrap();
        let closed = drawn(vec![path("one", [0.0; 2]), path("one", [0.0; 2]), path("two", [0.0; 2])]);
        assert_eq!((closed.matches(">one<").count(), closed.matches(">two<").count()), (1, 1), "{closed}");
        assert!(!closed.contains("<circle") && drawn(vec![path("open", [0.0, 1.0])]).contains("<circle"));
    }

    #[test]
    fn thinning_keeps_the_ends() {
        let dense = (0..=1000).map(|i| [f64::from(i) * 0.01, 0.0]);
        let thin = thinned(dense);
        assert!(thin.len() < 30);
        assert_eq!((thin[0], thin[thin.len() - 1]), ([0.0, 0.0], [10.0, 0.0]));
    }
}
