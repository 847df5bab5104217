//! What several memories knew of one thing: a plot of how far from the truth, and a table of what was told when.

use std::fmt::Write as _;

use super::data::{Memories, MemoryRow};
use super::page::{number, with_unit};
use super::svg::escape;
use super::timeplot;

/// The plot and the table as HTML.
pub(super) fn draw(known: &Memories, time: [f64; 2]) -> String {
    let plot = known.distance.as_ref().map(|plot| timeplot::draw(plot, time, timeplot::WIDE));
    let mut body = plot.unwrap_or_default();
    body.push_str(
        "<table><thead><tr><th>Memory of</th><th class=\"n\">When</th><th class=\"n\">Times</th><th>Entity</th>\
         <th>Found by</th><th>Says</th><th class=\"n\">At x, y, z</th><th class=\"n\">Trusted</th>\
         <th class=\"n\">Off by</th></tr></thead><tbody>",
    );
    known.rows.iter().for_each(|row| body.push_str(&line(row)));
    body.push_str("</tbody></table>");
    body
}

fn line(row: &MemoryRow) -> String {
    let seconds = |t: f64| with_unit(number(t, 1), "s");
    let place = row.position.map_or("–".to_owned(), |p| with_unit(p.map(|c| number(c, 3)).join(", "), "m"));
    let off = row.error_m.map_or("–".to_owned(), |e| with_unit(number(e * 1e3, 0), "mm"));
    let mut line = format!("<tr><td>{}</td>", escape(&row.agent));
    let when = if row.count > 1 {
        format!("{}\u{a0}–\u{a0}{}", number(row.from_s, 1), seconds(row.to_s))
    } else {
        seconds(row.from_s)
    };
    // What it is, an object or a relation, is plain from what it says.
    let entity = row.entity.split_once('/').map_or(row.entity.as_str(), |(_, entity)| entity);
    for cell in [when, row.count.to_string()] {
        let _ = write!(line, "<td class=\"n\">{}</td>", escape(&cell));
    }
    let _ = write!(
        line,
        "<td><code>{}</code></td><td>{}</td><td>{}</td>",
        escape(entity),
        escape(&row.origin),
        escape(&row.says)
    );
    for cell in [place, with_unit(number(row.confidence * 100.0, 0), "%"), off] {
        let _ = write!(line, "<td class=\"n\">{}</td>", escape(&cell));
    }
    line.push_str("</tr>");
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_who_knew_what_and_how_well() {
        let row = MemoryRow {
            agent: "alice".into(),
            entity: "ObjectInstances/bob.bob/<sponge>".into(),
            from_s: 12.34,
            to_s: 13.0,
            count: 2,
            origin: "bob".into(),
            says: "in bob/right_hand".into(),
            position: Some([0.351, -0.5, 1.0]),
            confidence: 0.9,
            error_m: Some(0.0042),
        };
        let line = line(&row);
        for expected in [
            "12.3\u{a0}–\u{a0}13.0\u{a0}s",
            "&lt;sponge&gt;",
            "0.351, −0.500, 1.000\u{a0}m",
            ">4\u{a0}mm<",
            "90\u{a0}%",
        ] {
            assert!(line.contains(expected), "{expected} in {line}");
        }
        let nowhere = MemoryRow::default();
        assert!(super::line(&nowhere).contains("<td class=\"n\">–</td>"));
    }
}
