//! The chart as SVG. Its own style sheet follows the light and dark colour scheme.

use std::fmt::Write as _;

use armarium_runtime::chart::{Outline, OutlineKind};

use super::graph::{Arrow, Graph};
use super::layers::Route;
use super::measure::{LINE, SIZE};
use super::nested::{DOT, Placed, lay_out, move_by};

/// Margin around the picture, px.
const MARGIN: f64 = 12.0;

const STYLE: &str = "\
svg{--ink:#1c2330;--soft:#5b6475;--line:#56627a;--paper:#ffffff;--box:#f7f8fb;--skill:#e4eefc;--chart:#e9e5fb;\
--end:#e3f4e6;--bad:#fbe6e4;--label:#2d4a7c;background:var(--paper)}\
@media(prefers-color-scheme:dark){svg{--ink:#e6e9f0;--soft:#a5aec0;--line:#8d99b0;--paper:#14171d;--box:#1b1f27;\
--skill:#1d2d45;--chart:#2a2545;--end:#1d3524;--bad:#452422;--label:#9dbcf0}}\
text{font-family:'Helvetica Neue',Helvetica,Arial,'Liberation Sans','DejaVu Sans',sans-serif;font-size:12px;fill:var(--ink)}\
.title{font-weight:600}.soft{fill:var(--soft)}.label{fill:var(--label);text-anchor:middle}.mid{text-anchor:middle}\
.state{fill:var(--box);stroke:var(--line);stroke-width:1.2}.skill{fill:var(--skill)}.chart{fill:var(--chart)}\
.end{fill:var(--end)}.bad{fill:var(--bad)}.outer{fill:var(--paper)}\
.arrow{fill:none;stroke:var(--line);stroke-width:1.2}.part{stroke:var(--line);stroke-dasharray:5 4}\
.dot,.head{fill:var(--line)}";

/// Draws a chart as a separate SVG file: nested boxes, layered arrows, labels without overlap.
#[must_use]
pub fn svg(outline: &Outline) -> String {
    let graph = Graph::of(outline);
    let mut whole = lay_out(outline, &graph, 0);
    move_by(&mut whole, MARGIN, MARGIN);
    let (width, height) = (whole.size.width + 2.0 * MARGIN, whole.size.height + 2.0 * MARGIN);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\">\n<title>{}</title>\n<style>{STYLE}</style>\n\
         <defs><marker id=\"head\" viewBox=\"0 0 8 8\" refX=\"7\" refY=\"4\" markerWidth=\"8\" markerHeight=\"8\" \
         orient=\"auto\"><path class=\"head\" d=\"M0 0.6 8 4 0 7.4z\"/></marker></defs>\n",
        escape(&whole.title)
    );
    state(outline, &whole, 0, &mut out);
    out.push_str("</svg>\n");
    out
}

fn state(outline: &Outline, placed: &Placed, depth: usize, out: &mut String) {
    let Placed { x, y, size, .. } = placed;
    let kind = &outline.states[placed.state].kind;
    let class = match kind {
        OutlineKind::Skill(_) => "state skill",
        OutlineKind::Chart(_) | OutlineKind::Remote(_) => "state chart",
        OutlineKind::Final(outcome) if outcome == "failure" => "state bad",
        OutlineKind::Final(_) => "state end",
        _ if depth.is_multiple_of(2) => "state outer",
        _ => "state",
    };
    let round = if matches!(kind, OutlineKind::History { .. }) { size.height / 2.0 } else { 8.0 };
    // Writing into a `String` cannot fail.
    let _ = writeln!(
        out,
        "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"{round}\"/>",
        size.width, size.height
    );
    if matches!(kind, OutlineKind::Final(_)) {
        let _ = writeln!(
            out,
            "<rect class=\"{class}\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"6\"/>",
            x + 3.0,
            y + 3.0,
            size.width - 6.0,
            size.height - 6.0
        );
    }
    texts(placed, out);
    for (x, from, to) in &placed.partings {
        let _ = writeln!(out, "<path class=\"part\" d=\"M{x:.1} {from:.1}V{to:.1}\"/>");
    }
    if let Some((x, y)) = placed.dot {
        let r = DOT / 2.0;
        let _ = writeln!(out, "<circle class=\"dot\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"{r}\"/>", x + r, y + r);
    }
    placed.inside.iter().for_each(|inner| state(outline, inner, depth + 1, out));
    for (arrow, route) in &placed.arrows {
        line(route, out);
        label(arrow, route, out);
    }
}

fn texts(placed: &Placed, out: &mut String) {
    let (middle, mut y) = (placed.x + placed.size.width / 2.0, placed.y + 7.0 + SIZE);
    if placed.title.starts_with('H') && placed.size.width < 30.0 {
        y = placed.y + placed.size.height / 2.0 + SIZE / 3.0;
    }
    let mut write = |class: &str, x: f64, text: &str| {
        let _ = writeln!(out, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escape(text));
        y += LINE;
    };
    write("title mid", middle, &placed.title);
    if !placed.subtitle.is_empty() {
        write("soft mid", middle, &placed.subtitle);
    }
    for note in &placed.notes {
        write("soft", placed.x + 14.0, note);
    }
}

/// A line that is straight within ranks and curved between them.
fn line(route: &Route, out: &mut String) {
    let Some((first, rest)) = route.points.split_first() else { return };
    let mut path = format!("M{:.1} {:.1}", first.0, first.1);
    let mut last = *first;
    for point in rest {
        if (point.0 - last.0).abs() < 0.05 {
            let _ = write!(path, "V{:.1}", point.1);
        } else {
            let middle = (last.1 + point.1) / 2.0;
            let _ = write!(
                path,
                "C{:.1} {middle:.1} {:.1} {middle:.1} {:.1} {:.1}",
                last.0, point.0, point.0, point.1
            );
        }
        last = *point;
    }
    let _ = writeln!(out, "<path class=\"arrow\" d=\"{path}\" marker-end=\"url(#head)\"/>");
}

fn label(arrow: &Arrow, route: &Route, out: &mut String) {
    let (x, y) = route.label;
    let top = y - arrow.label.len() as f64 * LINE / 2.0;
    if arrow.label.is_empty() {
        return;
    }
    // The line is drawn behind its own label.
    let width = arrow.label.iter().map(|l| super::measure::width(l)).fold(0.0, f64::max);
    let _ = writeln!(
        out,
        "<rect x=\"{:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"3\" fill=\"var(--paper)\" opacity=\"0.92\"/>",
        x - width / 2.0 - 2.0,
        width + 4.0,
        arrow.label.len() as f64 * LINE
    );
    for (number, text) in arrow.label.iter().enumerate() {
        let y = top + number as f64 * LINE + SIZE - 1.0;
        let _ = writeln!(out, "<text class=\"label\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escape(text));
    }
}

fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}
