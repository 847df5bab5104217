//! The states over time: one row per state, bars while it is active, regions below their parents.

use std::collections::BTreeMap;

use armarium_values::report::StateSpan;

use super::axes::{Axes, ticks};
use super::svg::{Anchor, Svg, fit};

const ROW: f64 = 21.0;
const MAX_ROWS: usize = 150;

/// Draws the picture as SVG for the interval `time`, s.
pub(super) fn draw(spans: &[StateSpan], time: [f64; 2]) -> String {
    let rows = rows(spans);
    let left = 250.0;
    let width = 1000.0 - left - 16.0;
    let height = ROW * rows.len() as f64;
    let axes = Axes { left, top: 6.0, width, height, x: time, y: [0.0, 1.0] };
    let mut svg = Svg::new(1000.0, height + 46.0, "Active states through time");
    for (i, row) in rows.iter().enumerate() {
        let y = axes.top + ROW * i as f64;
        if i % 2 == 1 {
            svg.rect([0.0, y], [1000.0 - 16.0, ROW], "stripe", "");
        }
        let indent = 8.0 + 14.0 * row.depth as f64;
        let class = if row.leaf { "label" } else { "label group" };
        svg.text([indent, y + 15.0], Anchor::Start, class, &fit(row.name, left - indent - 8.0));
    }
    for (tick, text) in ticks(axes.x, 10) {
        let x = axes.point(tick, 0.0)[0];
        svg.line([x, axes.top], [x, axes.bottom()], "grid");
        svg.text([x, axes.bottom() + 17.0], Anchor::Middle, "tick", &text);
    }
    svg.line([axes.left, axes.bottom()], [axes.right(), axes.bottom()], "axis");
    svg.text([axes.right(), axes.bottom() + 34.0], Anchor::End, "label", "time, s");
    bars(&mut svg, spans, &rows, &axes);
    svg.finish("wide")
}

struct StateRow<'a> {
    path: &'a str,
    name: &'a str,
    depth: usize,
    leaf: bool,
    colour: usize,
}

/// One row per state: parents before children, otherwise in order of first entry.
fn rows(spans: &[StateSpan]) -> Vec<StateRow<'_>> {
    let mut first: BTreeMap<&str, usize> = BTreeMap::new();
    for (i, span) in spans.iter().enumerate() {
        for path in prefixes(&span.path) {
            first.entry(path).or_insert(i);
        }
    }
    let mut paths: Vec<&str> = first.keys().copied().collect();
    paths.sort_by_key(|path| {
        prefixes(path).map(|prefix| (first.get(prefix).copied(), prefix)).collect::<Vec<_>>()
    });
    let mut roots: Vec<&str> = Vec::new();
    paths
        .iter()
        .take(MAX_ROWS)
        .map(|&path| {
            let root = path.split('.').next().unwrap_or(path);
            if !roots.contains(&root) {
                roots.push(root);
            }
            let inside = |other: &&str| other.strip_prefix(path).is_some_and(|rest| rest.starts_with('.'));
            StateRow {
                path,
                name: path.rsplit('.').next().unwrap_or(path),
                depth: path.matches('.').count(),
                leaf: !paths.iter().any(inside),
                colour: roots.iter().position(|r| *r == root).unwrap_or(0) % 6 + 1,
            }
        })
        .collect()
}

fn prefixes(path: &str) -> impl Iterator<Item = &str> {
    path.match_indices('.').map(|(i, _)| &path[..i]).chain(std::iter::once(path))
}

fn bars(svg: &mut Svg, spans: &[StateSpan], rows: &[StateRow<'_>], axes: &Axes) {
    for span in spans {
        let Some(i) = rows.iter().position(|row| row.path == span.path) else { continue };
        let (row, y) = (&rows[i], axes.top + ROW * i as f64);
        let end = span.to_s.unwrap_or(axes.x[1]).min(axes.x[1]);
        let x0 = axes.point(span.from_s.max(axes.x[0]), 0.0)[0];
        let x1 = axes.point(end, 0.0)[0].max(x0 + 1.5);
        let failed = span.outcome.as_deref() == Some("failure");
        let class = match (failed, row.leaf) {
            (true, _) => "bar failed".to_owned(),
            (false, true) => format!("bar f{}", row.colour),
            (false, false) => format!("bar outer f{}", row.colour),
        };
        let outcome = span.outcome.as_deref().map_or(String::new(), |o| format!(", {o}"));
        let tip = format!("{}: {:.2} to {end:.2} s{outcome}", span.path, span.from_s);
        let (inset, tall) = if row.leaf || failed { (4.0, ROW - 8.0) } else { (7.0, ROW - 14.0) };
        svg.rect([x0, y + inset], [x1 - x0, tall], &class, &tip);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parents_come_before_children_and_siblings_in_order_of_entry() {
        let spans: Vec<StateSpan> = ["Learn", "Wipe.B.Watch", "Wipe.A.Run", "Wipe.B.Act", "Done"]
            .into_iter()
            .enumerate()
            .map(|(i, path)| StateSpan { path: path.into(), from_s: i as f64, to_s: None, outcome: None })
            .collect();
        let rows: Vec<(&str, usize, bool)> = rows(&spans).iter().map(|r| (r.path, r.depth, r.leaf)).collect();
        assert_eq!(
            rows,
            [
                ("Learn", 0, true),
                ("Wipe", 0, false),
                ("Wipe.B", 1, false),
                ("Wipe.B.Watch", 2, true),
                ("Wipe.B.Act", 2, true),
                ("Wipe.A", 1, false),
                ("Wipe.A.Run", 2, true),
                ("Done", 0, true),
            ]
        );
    }
}
