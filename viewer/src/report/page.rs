//! The page: sections in order, each left out when it has nothing to show.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use super::data::{CoachingRow, ReportData, TimePlot};
use super::figures::{Figure, Requirement};
use super::svg::{data_uri, escape};
use super::{gantt, memories, plan, timeplot};

const STYLE: &str = include_str!("style.css");

/// The whole page as HTML. Text from charts, worlds and reasons is escaped.
#[must_use]
pub fn render(data: &ReportData) -> String {
    let title = if data.title.is_empty() { "Run" } else { &data.title };
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{}: {}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n",
        escape(title),
        escape(&data.outcome),
    );
    let sections = [
        header(title, data),
        failure(data),
        figures(&data.figures),
        states(data),
        memories(data),
        paths(data),
        signals(data),
        wiped(data),
        coaching(&data.coaching),
        gestures(data),
        joints(data),
        pictures(data),
        log(data),
    ];
    sections.iter().for_each(|section| page.push_str(section));
    page.push_str("</main>\n</body>\n</html>\n");
    page
}

/// The time that all plots show: from 0 to the last instant of any of them, s.
fn time(data: &ReportData) -> [f64; 2] {
    let plots = data.force.iter().chain(&data.signals).chain(&data.joints);
    let signals = plots.flat_map(|p| &p.series).filter_map(|s| s.t_s.last().copied());
    let states = data.states.iter().flat_map(|s| [Some(s.from_s), s.to_s]).flatten();
    let end = signals.chain(states).filter(|t| t.is_finite()).fold(0.0, f64::max);
    [0.0, if end > 0.0 { end } else { 1.0 }]
}

fn section(title: &str, note: &str, body: &str) -> String {
    let note =
        if note.is_empty() { String::new() } else { format!("<p class=\"note\">{}</p>\n", escape(note)) };
    format!("<section>\n<h2>{}</h2>\n{note}{body}\n</section>\n", escape(title))
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
        "<section class=\"failure\">\n<h2>The run did not succeed</h2>\n<p class=\"reason\">{}</p>\n{chain}\n</section>\n",
        escape(reason)
    )
}

pub(super) fn number(value: f64, digits: usize) -> String {
    if value.is_finite() {
        format!("{value:.digits$}").replace('-', "−")
    } else {
        "not a number".to_owned()
    }
}

pub(super) fn with_unit(text: String, unit: &str) -> String {
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
    if figures.is_empty() {
        return String::new();
    }
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
    let judged: Vec<bool> = figures.iter().filter_map(Figure::passed).collect();
    let met = judged.iter().filter(|met| **met).count();
    section(
        "Figures",
        &format!("Measured against the simulator's truth. {met} of {} met.", judged.len()),
        &body,
    )
}

fn states(data: &ReportData) -> String {
    if data.states.is_empty() {
        return String::new();
    }
    let note = "Which states were active, and when. A thin bar is a state with states inside.";
    section("States", note, &gantt::draw(&data.states, time(data)))
}

fn memories(data: &ReportData) -> String {
    let Some(known) = &data.memories else { return String::new() };
    let note = "What each agent's memory came to know, as it told others. Places are in the robot's root frame, set \
                beside the simulator's truth of that moment; the plot takes what speaks of the latest time.";
    section(&format!("Memories of the {}", known.subject), note, &memories::draw(known, time(data)))
}

fn paths(data: &ReportData) -> String {
    if data.paths.iter().all(|path| path.points.is_empty()) {
        return String::new();
    }
    section("Paths", "The table seen from above; a dot marks where each begins.", &plan::paths(&data.paths))
}

fn signals(data: &ReportData) -> String {
    let time = time(data);
    let draw = |plot: &TimePlot| section(&plot.title, "", &timeplot::draw(plot, time, timeplot::WIDE));
    data.force.iter().chain(&data.signals).filter(|plot| !plot.series.is_empty()).map(draw).collect()
}

fn wiped(data: &ReportData) -> String {
    let Some(plan) = data.wiped.as_ref().and_then(plan::wiped) else { return String::new() };
    section(
        "Wiped area",
        "What the sponge cleaned by pressing on it, seen from above, and the path of the hand until the coach acted.",
        &plan,
    )
}

fn coaching(rows: &[CoachingRow]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut body = String::from(
        "<table><thead><tr><th>Coach</th><th class=\"n\">At</th><th class=\"n\">Moved the motion</th>\
         <th class=\"n\">Kept</th><th class=\"n\">Far side, RMS</th><th class=\"n\">Slowed to</th></tr></thead><tbody>",
    );
    let cell = |value: Option<f64>, factor: f64, digits: usize, unit: &str| {
        let text = value.map_or("–".to_owned(), |v| with_unit(number(v * factor, digits), unit));
        format!("<td class=\"n\">{}</td>", escape(&text))
    };
    for row in rows {
        let _ = write!(
            body,
            "<tr><td>{}</td>{}{}{}{}{}</tr>",
            escape(&row.kind.replace('_', " ")),
            cell(Some(row.at_s), 1.0, 1, "s"),
            cell(row.displacement_m, 1e3, 1, "mm"),
            cell(row.retained_m, 1e3, 1, "mm"),
            cell(row.far_side_rms_m, 1e3, 1, "mm"),
            cell(row.slowed_to, 1e2, 0, "%"),
        );
    }
    body.push_str("</tbody></table>");
    section(
        "Coaching",
        "How far each coaching moved the motion, and what stayed when the coach had gone.",
        &body,
    )
}

fn gestures(data: &ReportData) -> String {
    if data.confusion.is_empty() {
        return String::new();
    }
    // No hand at all comes last.
    let order = |name: &'_ String| (name == "none", name.clone());
    let names: BTreeSet<(bool, String)> =
        data.confusion.keys().chain(data.confusion.values().flat_map(|r| r.keys())).map(order).collect();
    let names: Vec<String> = names.into_iter().map(|(_, name)| name).collect();
    let nothing = BTreeMap::new();
    let mut body = String::from("<table class=\"matrix\"><thead><tr><th>shown \\ seen</th>");
    for name in &names {
        let _ = write!(body, "<th>{}</th>", escape(&name.replace('_', " ")));
    }
    body.push_str("</tr></thead><tbody>");
    for shown in names.iter().filter(|name| data.confusion.contains_key(*name)) {
        let row = data.confusion.get(shown).unwrap_or(&nothing);
        let _ = write!(body, "<tr><th>{}</th>", escape(&shown.replace('_', " ")));
        for seen in &names {
            let count = row.get(seen).copied().unwrap_or(0);
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
    section("Gestures", "Camera frames by the gesture that was shown and the one that was seen.", &body)
}

fn joints(data: &ReportData) -> String {
    if data.joints.is_empty() {
        return String::new();
    }
    let time = time(data);
    let plots: String = data.joints.iter().map(|plot| timeplot::draw(plot, time, timeplot::SMALL)).collect();
    section(
        "Joints",
        "Trajectories over time in seconds; dashed lines are limits.",
        &format!("<div class=\"grid2\">{plots}</div>"),
    )
}

fn pictures(data: &ReportData) -> String {
    if data.pictures.is_empty() {
        return String::new();
    }
    let mut body = String::from("<div class=\"pictures\">");
    for picture in &data.pictures {
        let caption = escape(&picture.caption);
        let uri = data_uri(&picture.media_type, &picture.data);
        let _ = write!(
            body,
            "<figure><img alt=\"{caption}\" src=\"{uri}\"><figcaption>{caption}</figcaption></figure>"
        );
    }
    body.push_str("</div>");
    section("What the cameras saw", "", &body)
}

fn log(data: &ReportData) -> String {
    if data.log.is_empty() {
        return String::new();
    }
    section("Log", "", &format!("<pre>{}</pre>", escape(&data.log.join("\n"))))
}
