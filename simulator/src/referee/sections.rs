//! The report's sections about the truth of a wiping run: figures with their requirements, paths over the table,
//! the contact force, the wiped area, and the effect of coaching.
//!
//! Nothing that is judged is computed here; see [`super::figures`] for that.

use std::collections::BTreeSet;

use armarium_values::report::{
    Band, Block, Cell, Cells, Confusion, Path, PathStyle, Plan, Section, Series, Table, TimePlot, Tone,
};

use super::figures::judged_object;
use super::requirements::judged_figures;
use super::{Mark, Record, RefereeReport, TruthLog, WipedCells};
use crate::coach::{ActionEvent, CoachPath, EventKind};
use crate::table::DIRT_CELL;
use crate::world::World;

/// Interval of the drawn points of a path, ms.
const STRIDE: usize = 10;
/// The coach's tool counts as on the ideal path up to this distance, over the path's half width.
const NEAR: f64 = 0.4;

const SECOND: u64 = 1_000_000_000;

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

/// The time of the last mark for which `test` is true, ns.
fn time_of(marks: &[(u64, Mark)], test: impl Fn(&Mark) -> bool) -> Option<u64> {
    marks.iter().rev().find(|(_, mark)| test(mark)).map(|(t, _)| *t)
}

fn ended_adapting(marks: &[(u64, Mark)]) -> Option<u64> {
    time_of(marks, |m| matches!(m, Mark::AdaptationEnded { .. }))
}

/// The name of an action: `push`, `fist` ...
fn name(action: &ActionEvent) -> String {
    action.kind.name().replace('_', " ")
}

fn actions(log: &TruthLog, event: EventKind) -> impl Iterator<Item = &ActionEvent> {
    log.coach.iter().filter(move |e| e.event == event)
}

/// The coach's path, the one performed in free space, the one wiped, and the one after each of the coach's actions.
/// Each is one period, except that the coach's path has all its periods.
fn paths(world: &World, log: &TruthLog, marks: &[(u64, Mark)]) -> Vec<Path> {
    let Some(shown) = &world.coach.demonstration else { return Vec::new() };
    let end = log.records.last().map_or(0, |r| r.stamp_ns);
    let period = (1.05 / shown.frequency * 1e9) as u64;
    let mut paths = Vec::new();
    let mut add = |label: String, style, points: Vec<[f64; 2]>| {
        if points.len() > 1 {
            paths.push(Path { label, style, points });
        }
    };
    let performed = |from: u64, to: u64| {
        let records = log.between(from, to).iter().step_by(STRIDE);
        records.map(|r| [r.tcp.translation.x, r.tcp.translation.y]).collect()
    };
    let learned = time_of(marks, |m| *m == Mark::LearningEnded).unwrap_or(end);
    let tool = demonstrated(&CoachPath::new(shown), log.between(0, learned.max(1)));
    add("demonstrated by the coach".into(), PathStyle::Reference, tool);
    if let Some(steady) = time_of(marks, |m| *m == Mark::FreeSpaceSteady) {
        add("performed in free space".into(), PathStyle::Line, performed(steady, steady + period));
    }
    let Some(adapted) = ended_adapting(marks) else { return paths };
    // The end of wiping; after it the tool is lifted.
    let over = log.records.iter().rev().find(|r| r.normal > 1.0).map_or(end, |r| r.stamp_ns);
    let over = over.saturating_sub(SECOND / 2);
    let begins: Vec<u64> = actions(log, EventKind::Began).map(|e| (e.t * 1e9) as u64).collect();
    let until = begins.first().copied().unwrap_or(over);
    add("wiped".into(), PathStyle::Line, performed(until.saturating_sub(period).max(adapted), until));
    for action in actions(log, EventKind::Ended) {
        let gone = (action.t * 1e9) as u64;
        let next = begins.iter().copied().find(|t| *t >= gone).unwrap_or(over);
        let from = next.saturating_sub(period).max(gone);
        add(format!("after the {}", name(action)), PathStyle::Line, performed(from, next));
    }
    paths
}

/// The periodic part of a demonstration, without coming, swiping and going: the longest stretch near the ideal
/// path.
fn demonstrated(path: &CoachPath, records: &[Record]) -> Vec<[f64; 2]> {
    let ideal: Vec<[f64; 2]> =
        (0..180).map(|i| path.point(std::f64::consts::TAU * f64::from(i) / 180.0)).collect();
    let half = path.half();
    let far = NEAR * half[0].abs().max(half[1].abs());
    let near = |p: &[f64; 2]| ideal.iter().any(|q| (p[0] - q[0]).hypot(p[1] - q[1]) < far);
    let tool = |r: &Record| r.tool.map(|t| [t.x, t.y]).filter(near);
    let points: Vec<Option<[f64; 2]>> = records.iter().step_by(STRIDE).map(tool).collect();
    let stretches = points.split(Option::is_none);
    stretches.max_by_key(|s| s.len()).unwrap_or_default().iter().copied().flatten().collect()
}

/// The true contact force from touchdown on, and the times at which the coach acted.
fn force(log: &TruthLog, marks: &[(u64, Mark)]) -> Option<TimePlot> {
    let from = time_of(marks, |m| *m == Mark::AdaptationStarted)?;
    let wanted = marks.iter().rev().find_map(|(t, mark)| match mark {
        Mark::AdaptationEnded { desired_n, .. } => Some((*t, *desired_n)),
        _ => None,
    });
    let records = log.between(from, u64::MAX);
    let adapted = wanted.map(|(t, _)| (seconds(t), "adapted".to_owned()));
    let came = actions(log, EventKind::Began).map(|e| (e.t, name(e)));
    Some(TimePlot {
        title: "Force between tool and table".into(),
        y_label: "Normal force, N".into(),
        series: vec![Series {
            label: "true normal force".into(),
            t_s: records.iter().map(|r| seconds(r.stamp_ns)).collect(),
            y: records.iter().map(|r| r.normal).collect(),
        }],
        band: wanted.map(|(t, value)| Band {
            value,
            tolerance: 1.0,
            label: "desired, within 1 N".into(),
            from_s: Some(seconds(t)),
            to_s: None,
        }),
        marks: adapted.into_iter().chain(came).collect(),
        ..TimePlot::default()
    })
}

/// The cleaned area, and the hand's path until the coach acted. The table's tilt of a few degrees is not drawn.
fn wiped(world: &World, log: &TruthLog, marks: &[(u64, Mark)], cells: &WipedCells) -> Option<Plan> {
    let adapted = ended_adapting(marks)?;
    let until = actions(log, EventKind::Began).next().map_or(u64::MAX, |e| (e.t * 1e9) as u64);
    let swept = cells.swept.cells().iter().zip(cells.cleaned.cells()).zip(cells.cleaned_in_the_end.cells());
    let kind = |((swept, cleaned), later): ((&bool, &bool), &bool)| match (*swept, *cleaned, *later) {
        (true, true, _) => 1,
        (true, false, _) => 2,
        (false, _, true) => 3,
        (false, ..) => 0,
    };
    let wiping = log.between(adapted, until).iter().step_by(STRIDE).filter(|r| r.normal > 0.0);
    let fraction = cells.swept.covered_by(&cells.cleaned);
    let percent = fraction.map_or(String::new(), |f| format!(" ({:.1} %)", f * 100.0));
    let kinds = vec![
        (format!("cleaned{percent}"), Tone::Good),
        ("missed".to_owned(), Tone::Bad),
        ("cleaned beside that or later".to_owned(), Tone::Neutral),
    ];
    let path = Path {
        label: "path of the hand".into(),
        style: PathStyle::Overlay,
        points: wiping.map(|r| [r.tcp.translation.x, r.tcp.translation.y]).collect(),
    };
    Some(Plan {
        cells: Some(Cells {
            origin: std::array::from_fn(|k| world.table.center[k] - world.table.size[k] / 2.0),
            cell_m: DIRT_CELL,
            columns: cells.swept.columns(),
            kinds,
            cells: swept.map(kind).collect(),
        }),
        ..plan("Wiped area", vec![path])
    })
}

/// A plan of the table.
fn plan(title: &str, paths: Vec<Path>) -> Plan {
    Plan {
        title: title.into(),
        x_label: "x, m (to the robot's right)".into(),
        y_label: "y, m (forward)".into(),
        cells: None,
        paths,
    }
}

/// One row for each of the coach's actions.
fn coaching(report: &RefereeReport) -> Table {
    let titles = ["Coach", "#At", "#Moved the motion", "#Kept", "#Far side, RMS", "#Slowed to"];
    let mut table = Table::new(&titles);
    let mm = |value: Option<f64>| Cell::optional(value.map(|v| v * 1e3), "mm", 1);
    table.rows = report
        .coaching
        .iter()
        .map(|step| {
            vec![
                Cell::Text(step.kind.replace('_', " ")),
                Cell::number(step.at_s, "s", 1),
                mm(step.displacement_m),
                mm(step.retained_m),
                mm(step.far_side_rms_m),
                Cell::optional(step.slowed_to.map(|v| v * 1e2), "%", 0),
            ]
        })
        .collect();
    table
}

/// The confusion matrix of the gestures; no hand comes last.
fn confusion(report: &RefereeReport) -> Confusion {
    let Some(gestures) = &report.gestures else { return Confusion::default() };
    let order = |name: &String| (name == "none", name.clone());
    let counted = &gestures.confusion;
    let names: BTreeSet<(bool, String)> =
        counted.keys().chain(counted.values().flat_map(|row| row.keys())).map(order).collect();
    let names: Vec<String> = names.into_iter().map(|(_, name)| name).collect();
    let row = |shown: &String| {
        let row = counted.get(shown)?;
        let counts = names.iter().map(|seen| row.get(seen).copied().unwrap_or(0)).collect();
        Some((shown.clone(), counts))
    };
    Confusion { rows: names.iter().filter_map(row).collect(), names: names.clone() }
}

/// The sections of a run, the figures first.
pub(super) fn sections(
    world: &World,
    log: &TruthLog,
    marks: &[(u64, Mark)],
    report: &RefereeReport,
    cells: Option<&WipedCells>,
) -> Vec<Section> {
    let figures = serde_json::to_value(report).map(|json| judged_figures(&json)).unwrap_or_default();
    let force = force(log, marks);
    let force_title = force.as_ref().map_or(String::new(), |plot| plot.title.clone());
    let wiped = cells.and_then(|cells| wiped(world, log, marks, cells));
    let object = judged_object(log, marks).and_then(|object| world.objects.get(object));
    let object = object.map_or("object", |object| object.name.as_str());
    let wiped_note = format!(
        "What the {object} cleaned by pressing on it, seen from above, and the path of the hand until the coach acted."
    );
    vec![
        Section::new("Figures", "Measured against the simulator's truth.", vec![Block::Figures(figures)]),
        Section::new(
            "Paths",
            "The table seen from above; a dot marks where each begins.",
            vec![Block::Plan(plan("Paths over the table", paths(world, log, marks)))],
        ),
        Section::new(&force_title, "", force.map(Block::Plot).into_iter().collect()),
        Section::new("Wiped area", &wiped_note, wiped.map(Block::Plan).into_iter().collect()),
        Section::new(
            "Coaching",
            "How far each coaching moved the motion, and what stayed when the coach had gone.",
            vec![Block::Table(coaching(report))],
        ),
        Section::new(
            "Gestures",
            "Camera frames by the gesture that was shown and the one that was seen.",
            vec![Block::Confusion(confusion(report))],
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tool comes from afar, swipes through the middle, circles three times and goes.
    #[test]
    fn of_the_coachs_tool_only_the_periodic_part_is_drawn() {
        let shown = World::default().coach.demonstration.unwrap();
        let path = CoachPath::new(&shown);
        let [cx, cy] = path.center();
        let turns = (0..30_000).map(|i| path.point(std::f64::consts::TAU * f64::from(i) / 10_000.0));
        let away = |dy: f64| (0..1500).map(move |i| [cx, cy + dy * f64::from(i) / 1500.0]);
        let points = away(0.4).chain(turns).chain(away(0.4));
        let records: Vec<Record> = points
            .enumerate()
            .map(|(i, [x, y])| Record {
                stamp_ns: i as u64 * 1_000_000,
                tcp: nalgebra::Isometry3::identity(),
                object: None,
                normal: 0.0,
                tangential: 0.0,
                tool: Some(nalgebra::Vector3::new(x, y, 1.1)),
            })
            .collect();
        let drawn = demonstrated(&path, &records);
        assert!((3000..3100).contains(&drawn.len()), "{}", drawn.len());
        let reach = 0.7 * shown.size[0].max(shown.size[1]);
        assert!(drawn.iter().all(|p| (p[0] - cx).hypot(p[1] - cy) < reach));
        assert!(demonstrated(&path, &[]).is_empty());
    }
}
