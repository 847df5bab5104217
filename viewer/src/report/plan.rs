//! The table seen from above: paths, and what the sponge cleaned. x to the right, y forward, one scale for both.

use image::ImageEncoder as _;

use super::axes::{Axes, Key, legend, legend_height, range_of};
use super::data::{Cell, Path, PathRole, WipedArea};
use super::svg::{Anchor, Svg, data_uri};

const WIDTH: f64 = 760.0;

/// Axes with equal units, under a legend, whose height follows from what is shown.
fn frame(x: [f64; 2], y: [f64; 2], entries: &[(String, String, Key)]) -> Axes {
    let left = 58.0;
    let width = WIDTH - left - 16.0;
    let keys = legend_height(entries, width);
    let height = (width * (y[1] - y[0]) / (x[1] - x[0])).clamp(200.0, 560.0);
    Axes { left, top: 26.0 + keys, width, height, x, y }.with_equal_units()
}

fn draw_axes(svg: &mut Svg, axes: &Axes) {
    axes.draw(svg, "x, m (to the robot's right)");
    svg.text([axes.left, axes.top - 10.0], Anchor::Start, "label", "y, m (forward)");
}

fn classes(paths: &[Path]) -> Vec<String> {
    let mut coached = 1;
    paths
        .iter()
        .map(|path| match path.role {
            PathRole::Demonstrated => "line demonstrated".to_owned(),
            PathRole::Learned => "line c1".to_owned(),
            PathRole::Outline => "line outline".to_owned(),
            PathRole::Coached => {
                coached += 1;
                format!("line c{}", (coached - 1) % 6 + 1)
            }
        })
        .collect()
}

/// Paths as SVG; a dot marks where each begins.
pub(super) fn paths(paths: &[Path]) -> String {
    let shown = |axis: usize| {
        let inner = paths.iter().filter(|p| p.role != PathRole::Outline);
        range_of(inner.flat_map(|p| p.points.iter().map(move |point| point[axis])), 0.12)
    };
    let classes = classes(paths);
    let entries: Vec<_> =
        paths.iter().zip(&classes).map(|(p, class)| (p.label.clone(), class.clone(), Key::Line)).collect();
    let axes = frame(shown(0), shown(1), &entries);
    let mut svg = Svg::new(WIDTH, axes.bottom() + 42.0, "Paths over the table");
    legend(&mut svg, [axes.left, 2.0], axes.width, &entries);
    draw_axes(&mut svg, &axes);
    svg.clipped([axes.left, axes.top], [axes.width, axes.height], |svg| {
        // What was demonstrated lies on top: its dashes let the others through.
        let mut order: Vec<_> = paths.iter().zip(&classes).collect();
        order.sort_by_key(|(path, _)| path.role == PathRole::Demonstrated);
        for (path, class) in order {
            let finite = path.points.iter().filter(|p| p[0].is_finite() && p[1].is_finite());
            let points: Vec<[f64; 2]> = thinned(finite.map(|p| axes.point(p[0], p[1])));
            if path.role != PathRole::Outline
                && let Some(start) = points.first()
            {
                svg.circle(*start, 4.0, &class.replace("line", "dot"));
            }
            svg.polyline(points, class);
        }
    });
    svg.finish("plan")
}

/// Points at least half a pixel apart, the last one kept.
pub(super) fn thinned(points: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
    let mut kept: Vec<[f64; 2]> = Vec::new();
    let mut last = None;
    for point in points {
        let near = |k: &[f64; 2]| (k[0] - point[0]).hypot(k[1] - point[1]) < 0.5;
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

/// The cleaned cells as SVG; `None` when there is nothing to show.
pub(super) fn wiped(area: &WipedArea) -> Option<String> {
    let cell_of = |i: usize| (i % area.columns, i / area.columns);
    let touched = |i: &usize| area.cells[*i] != Cell::Untouched;
    let whole = area.columns * area.rows();
    if whole == 0 || !(area.cell_m.is_finite() && area.cell_m > 0.0) {
        return None;
    }
    let used: Vec<(usize, usize)> = (0..whole).filter(touched).map(cell_of).collect();
    let columns = [used.iter().map(|c| c.0).min()?, used.iter().map(|c| c.0).max()? + 1];
    let rows = [used.iter().map(|c| c.1).min()?, used.iter().map(|c| c.1).max()? + 1];
    let at = |axis: usize, cell: usize| area.origin[axis] + cell as f64 * area.cell_m;
    let (x, y) = (columns.map(|c| at(0, c)), rows.map(|r| at(1, r)));
    let percent = area.fraction().map_or(String::new(), |f| format!(" ({:.1} %)", f * 100.0));
    let mut entries = vec![
        (format!("cleaned{percent}"), "cleaned".to_owned(), Key::Area),
        ("missed".to_owned(), "missed".to_owned(), Key::Area),
        ("cleaned beside that or later".to_owned(), "beside".to_owned(), Key::Area),
    ];
    if !area.path.is_empty() {
        entries.push(("path of the hand".to_owned(), "line over".to_owned(), Key::Line));
    }
    let axes = frame(range_of(x, 0.1), range_of(y, 0.1), &entries);
    let mut svg = Svg::new(WIDTH, axes.bottom() + 42.0, "Wiped area");
    legend(&mut svg, [axes.left, 2.0], axes.width, &entries);
    draw_axes(&mut svg, &axes);
    let [left, top] = axes.point(x[0], y[1]);
    let [right, bottom] = axes.point(x[1], y[0]);
    let png = cells_as_png(area, columns, rows)?;
    svg.image([left, top], [right - left, bottom - top], &data_uri("image/png", &png));
    let path = area.path.iter().filter(|p| p[0].is_finite() && p[1].is_finite());
    svg.clipped([axes.left, axes.top], [axes.width, axes.height], |svg| {
        svg.polyline(thinned(path.map(|p| axes.point(p[0], p[1]))), "line over");
    });
    Some(svg.finish("plan"))
}

fn cells_as_png(area: &WipedArea, columns: [usize; 2], rows: [usize; 2]) -> Option<Vec<u8>> {
    let colour = |cell: Cell| match cell {
        Cell::Untouched => [0, 0, 0, 0],
        Cell::Cleaned => [42, 157, 143, 235],
        Cell::Missed => [214, 73, 51, 255],
        Cell::Beside => [150, 195, 235, 190],
    };
    let pixels: Vec<u8> = (rows[0]..rows[1])
        .rev()
        .flat_map(|row| (columns[0]..columns[1]).map(move |column| row * area.columns + column))
        .flat_map(|i| colour(area.cells[i]))
        .collect();
    let (width, height) = (columns[1] - columns[0], rows[1] - rows[0]);
    let mut png = Vec::new();
    image::codecs::png::PngEncoder::new(&mut png)
        .write_image(
            &pixels,
            u32::try_from(width).ok()?,
            u32::try_from(height).ok()?,
            image::ExtendedColorType::Rgba8,
        )
        .ok()?;
    Some(png)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_area_without_a_touched_cell_or_a_size_is_not_drawn() {
        assert!(wiped(&WipedArea::default()).is_none());
        let untouched = WipedArea {
            origin: [0.0; 2],
            cell_m: 0.01,
            columns: 2,
            cells: vec![Cell::Untouched; 5],
            path: vec![[0.0, 0.0], [f64::NAN, 0.0]],
        };
        assert!(wiped(&untouched).is_none());
        let touched = WipedArea { cells: vec![Cell::Cleaned; 5], ..untouched };
        assert!(wiped(&touched).is_some());
        assert_eq!(touched.fraction(), Some(1.0));
    }

    #[test]
    fn thinning_keeps_the_ends() {
        let dense = (0..=1000).map(|i| [f64::from(i) * 0.01, 0.0]);
        let thin = thinned(dense);
        assert!(thin.len() < 30);
        assert_eq!((thin[0], thin[thin.len() - 1]), ([0.0, 0.0], [10.0, 0.0]));
    }
}
