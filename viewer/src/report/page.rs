//! The page: sections in order; empty sections are omitted.

use std::fmt::Write as _;

use armarium_values::report::{
    Block, Cell, Confusion, Figure, Picture, Requirement, Section, Table, TimePlot,
};

use crate::markup::escape;

use super::data::ReportData;
use super::svg::data_uri;
use super::{gantt, plan, timeplot};

const STYLE: &str = include_str!("style.css");

/// The whole page as HTML. Text from charts, worlds and reasons is escaped.
pub fn render(data: &ReportData) -> String {
    let title = if data.title.is_empty() { "Run" } else { &data.title };
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{}: {}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n",
        escape(title),
        escape(&data.outcome),
    );
    page.push_str(&header(title, data));
    page.push_str(&failure(data));
    page.push_str(&fragment(&data.sections));
    page.push_str("</main>\n</body>\n</html>\n");
    page
}

/// The report's styles for what is inside elements of the class `report` only.
pub(crate) fn scoped_style() -> String {
    format!("@scope (.report) {{\n{}}}\n", STYLE.replace(":root", ":scope"))
}

/// Sections as a part of a page that has styles of its own; see [`scoped_style`].
pub(crate) fn fragment(sections: &[Section]) -> String {
    let time = time(sections);
    sections.iter().map(|shown| section(shown, time)).collect()
}

/// The time axis of all plots: from 0 to the last time in any of them, s.
fn time(sections: &[Section]) -> [f64; 2] {
    let last = |plot: &TimePlot| plot.series.iter().filter_map(|s| s.t_s.last().copied()).fold(0.0, later);
    let end = |block: &Block| match block {
        Block::Plot(plot) => last(plot),
        Block::SmallPlots(plots) => plots.iter().map(last).fold(0.0, later),
        Block::Gantt(spans) => spans.iter().flat_map(|s| [Some(s.from_s), s.to_s]).flatten().fold(0.0, later),
        _ => 0.0,
    };
    let end = sections.iter().flat_map(|section| &section.blocks).map(end).fold(0.0, later);
    [0.0, if end > 0.0 { end } else { 1.0 }]
}

/// The later of two times; ignores NaN.
fn later(a: f64, b: f64) -> f64 {
    if b.is_finite() { a.max(b) } else { a }
}

/// A section; an empty string when none of its blocks has content.
fn section(section: &Section, time: [f64; 2]) -> String {
    let body: String = section.blocks.iter().map(|shown| block(shown, time)).collect();
    if body.is_empty() {
        return String::new();
    }
    let judged: Vec<bool> = section.figures().filter_map(Figure::passed).collect();
    let met = judged.iter().filter(|met| **met).count();
    let mut note = section.note.clone();
    if !judged.is_empty() {
        let _ = write!(note, "{}{met} of {} met.", if note.is_empty() { "" } else { " " }, judged.len());
    }
    let note =
        if note.is_empty() { String::new() } else { format!("<p class=\"note\">{}</p>\n", escape(&note)) };
    format!("<section>\n<h2>{}</h2>\n{note}{body}\n</section>\n", escape(&section.title))
}

fn block(block: &Block, time: [f64; 2]) -> String {
    match block {
        Block::Figures(list) if !list.is_empty() => figures(list),
        Block::Plot(plot) if !plot.series.is_empty() => timeplot::draw(plot, time, timeplot::WIDE),
        Block::SmallPlots(plots) if !plots.is_empty() => {
            let plots: String =
                plots.iter().map(|plot| timeplot::draw(plot, time, timeplot::SMALL)).collect();
            format!("<div class=\"grid2\">{plots}</div>")
        }
        Block::Plan(shown) => plan::draw(shown).unwrap_or_default(),
        Block::Gantt(spans) if !spans.is_empty() => gantt::draw(spans, time),
        Block::Table(shown) if !shown.rows.is_empty() => table(shown),
        Block::Confusion(shown) if !shown.rows.is_empty() => confusion(shown),
        Block::Pictures(list) if !list.is_empty() => pictures(list),
        Block::Lines(lines) if !lines.is_empty() => format!("<pre>{}</pre>", escape(&lines.join("\n"))),
        _ => String::new(),
    }
}

fn header(title: &str, data: &ReportData) -> String {
    let class = if data.outcome == "success" { "good" } else { "bad" };
    let facts: String = data.facts.iter().fold(String::new(), |mut out, (name, value)| {
        let _ = write!(out, "<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value));
        out
    });
    let subtitle = if data.subtitle.is_empty() {
        String::new()
    } else {
        format!("<p class=\"sub\">{}</p>\n", escape(&data.subtitle))
    };
    format!(
        "<header>\n<h1>{}<span class=\"badge {class}\">{}</span></h1>\n{subtitle}\
         <dl class=\"facts\">{facts}</dl>\n</header>\n",
        escape(title),
        escape(&data.outcome),
    )
}

fn failure(data: &ReportData) -> String {
    if data.outcome == "success" {
        return String::new();
    }
    let reason = data.reason.as_deref().unwrap_or("No reason was given.");
    let mut chain = String::new();
    for link in &data.failure_chain {
        let why = link.reason.as_deref().map_or(String::new(), |r| format!(" <span>{}</span>", escape(r)));
        let _ = write!(chain, "<li><code>{}</code>{why}</li>", escape(&link.state));
    }
    if !chain.is_empty() {
        chain =
            format!("<p class=\"note\">It came through these states, innermost first:</p><ol>{chain}</ol>");
    }
    format!(
        "<section class=\"failure\">\n<h2>Why it did not succeed</h2>\n<p class=\"reason\">{}</p>\n{chain}\n</section>\n",
        escape(reason)
    )
}

fn number(value: f64, digits: usize) -> String {
    if value.is_finite() {
        format!("{value:.digits$}").replace('-', "−")
    } else {
        "not a number".to_owned()
    }
}

fn with_unit(text: String, unit: &str) -> String {
    if unit.is_empty() { text } else { format!("{text}\u{a0}{unit}") }
}

fn requirement(figure: &Figure) -> String {
    let show = |v: f64| with_unit(format!("{v}").replace('-', "−"), &figure.unit);
    match figure.requirement {
        Requirement::AtMost(0.0) => "none".to_owned(),
        Requirement::AtMost(bound) => format!("at most {}", show(bound)),
        Requirement::AtLeast(bound) => format!("at least {}", show(bound)),
        Requirement::Between(low, high) => format!("{low} to {}", show(high)),
        Requirement::Shown => String::new(),
    }
}

fn figures(figures: &[Figure]) -> String {
    let mut body = String::from(
        "<table><thead><tr><th></th><th>Figure</th><th class=\"n\">Measured</th><th>Required</th><th></th></tr></thead><tbody>",
    );
    let mut group = "";
    for figure in figures {
        let shown = if figure.group == group { "" } else { figure.group.as_str() };
        group = &figure.group;
        let value = figure
            .value
            .map_or("not reached".to_owned(), |v| with_unit(number(v, figure.digits), &figure.unit));
        let (class, verdict) = match figure.passed() {
            Some(true) => ("good", "✓ met"),
            Some(false) => ("bad", "✗ missed"),
            None => ("", ""),
        };
        let _ = write!(
            body,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td><td>{}</td><td class=\"{class}\">{verdict}</td></tr>",
            escape(shown),
            escape(&figure.name),
            escape(&value),
            escape(&requirement(figure)),
        );
    }
    body.push_str("</tbody></table>");
    body
}

fn table(table: &Table) -> String {
    let class = |is_number: bool| if is_number { " class=\"n\"" } else { "" };
    let mut body = String::from("<table><thead><tr>");
    for column in &table.columns {
        let _ = write!(body, "<th{}>{}</th>", class(column.is_number), escape(&column.title));
    }
    body.push_str("</tr></thead><tbody>");
    for row in &table.rows {
        body.push_str("<tr>");
        for (column, shown) in table.columns.iter().zip(row) {
            let _ = write!(body, "<td{}>{}</td>", class(column.is_number), cell(shown));
        }
        body.push_str("</tr>");
    }
    body.push_str("</tbody></table>");
    body
}

fn cell(cell: &Cell) -> String {
    match cell {
        Cell::Absent => "–".to_owned(),
        Cell::Text(text) => escape(text),
        Cell::Code(text) => format!("<code>{}</code>", escape(text)),
        Cell::Link { text, to } => format!("<a href=\"{}\">{}</a>", escape(to), escape(text)),
        Cell::Numbers { values, unit, digits } => {
            let numbers: Vec<String> = values.iter().map(|value| number(*value, *digits)).collect();
            escape(&with_unit(numbers.join(", "), unit))
        }
    }
}

fn confusion(confusion: &Confusion) -> String {
    let mut body = String::from("<table class=\"matrix\"><thead><tr><th>shown \\ seen</th>");
    for name in &confusion.names {
        let _ = write!(body, "<th>{}</th>", escape(&name.replace('_', " ")));
    }
    body.push_str("</tr></thead><tbody>");
    for (shown, counts) in &confusion.rows {
        let _ = write!(body, "<tr><th>{}</th>", escape(&shown.replace('_', " ")));
        for (seen, count) in confusion.names.iter().zip(counts) {
            let class = match (count, shown == seen) {
                (0, _) => "",
                (_, true) => "on",
                (_, false) => "off",
            };
            let _ = write!(body, "<td class=\"{class}\">{count}</td>");
        }
        body.push_str("</tr>");
    }
    body.push_str("</tbody></table>");
    body
}

fn pictures(pictures: &[Picture]) -> String {
    let mut body = String::from("<div class=\"pictures\">");
    for picture in pictures {
        let caption = escape(&picture.caption);
        let uri = data_uri(&picture.media_type, &picture.data);
        let _ = write!(
            body,
            "<figure><img alt=\"{caption}\" src=\"{uri}\"><figcaption>{caption}</figcaption></figure>"
        );
    }
    body.push_str("</div>");
    body
}
