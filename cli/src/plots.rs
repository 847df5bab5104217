//! What the report draws of the referee's log: paths over the table, the contact force, the wiped area.
//!
//! Nothing is computed here that is judged; see the referee's figures for that.

use armarium_simulator::coach::{ActionEvent, ActionKind, CoachPath, EventKind};
use armarium_simulator::referee::{Record, TruthLog, WipedCells};
use armarium_simulator::table::DIRT_CELL;
use armarium_simulator::{Mark, World};
use armarium_viewer::report::{Band, Cell, Path, PathRole, Series, TimePlot, WipedArea};

/// Every how many milliseconds a path is drawn.
const STRIDE: usize = 10;
/// How far from the ideal path the coach's tool counts as on it, over the path's half width.
const NEAR: f64 = 0.4;

const SECOND: u64 = 1_000_000_000;

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

/// The last mark that passes, ns.
fn time_of(marks: &[(u64, Mark)], test: impl Fn(&Mark) -> bool) -> Option<u64> {
    marks.iter().rev().find(|(_, mark)| test(mark)).map(|(t, _)| *t)
}

fn ended_adapting(marks: &[(u64, Mark)]) -> Option<u64> {
    time_of(marks, |m| matches!(m, Mark::AdaptationEnded { .. }))
}

/// What an action is called: `push`, `fist` ...
fn name(action: &ActionEvent) -> String {
    let said = match action.kind {
        ActionKind::Push => Ok("push".into()),
        ActionKind::Gesture(gesture) => serde_json::to_value(gesture),
    };
    said.ok().and_then(|v| v.as_str().map(|s| s.replace('_', " "))).unwrap_or_default()
}

fn actions(log: &TruthLog, event: EventKind) -> impl Iterator<Item = &ActionEvent> {
    log.coach.iter().filter(move |e| e.event == event)
}

/// The coach's path, the one performed in free space, the one wiped, and the one after each of the coach's actions;
/// a period each, the coach's with all its periods.
pub(crate) fn paths(world: &World, log: &TruthLog, marks: &[(u64, Mark)]) -> Vec<Path> {
    let Some(shown) = &world.coach.demonstration else { return Vec::new() };
    let end = log.records.last().map_or(0, |r| r.stamp_ns);
    let period = (1.05 / shown.frequency * 1e9) as u64;
    let mut paths = Vec::new();
    let mut add = |label: String, role, points: Vec<[f64; 2]>| {
        if points.len() > 1 {
            paths.push(Path { label, role, points });
        }
    };
    let performed = |from: u64, to: u64| {
        let records = log.between(from, to).iter().step_by(STRIDE);
        records.map(|r| [r.tcp.translation.x, r.tcp.translation.y]).collect()
    };
    let learned = time_of(marks, |m| *m == Mark::LearningEnded).unwrap_or(end);
    let tool = demonstrated(&CoachPath::new(shown), log.between(0, learned.max(1)));
    add("demonstrated by the coach".into(), PathRole::Demonstrated, tool);
    if let Some(steady) = time_of(marks, |m| *m == Mark::FreeSpaceSteady) {
        add("performed in free space".into(), PathRole::Learned, performed(steady, steady + period));
    }
    let Some(adapted) = ended_adapting(marks) else { return paths };
    // The last moment of wiping: what comes after is lifting the sponge.
    let over = log.records.iter().rev().find(|r| r.normal > 1.0).map_or(end, |r| r.stamp_ns);
    let over = over.saturating_sub(SECOND / 2);
    let begins: Vec<u64> = actions(log, EventKind::Began).map(|e| (e.t * 1e9) as u64).collect();
    let until = begins.first().copied().unwrap_or(over);
    add("wiped".into(), PathRole::Coached, performed(until.saturating_sub(period).max(adapted), until));
    for action in actions(log, EventKind::Ended) {
        let gone = (action.t * 1e9) as u64;
        let next = begins.iter().copied().find(|t| *t >= gone).unwrap_or(over);
        let from = next.saturating_sub(period).max(gone);
        add(format!("after the {}", name(action)), PathRole::Coached, performed(from, next));
    }
    paths
}

/// The periodic part of a demonstration, without coming, swiping and going: the longest stretch near the ideal path.
fn demonstrated(path: &CoachPath, records: &[Record]) -> Vec<[f64; 2]> {
    let ideal: Vec<[f64; 2]> =
        (0..180).map(|i| path.point(std::f64::consts::TAU * f64::from(i) / 180.0)).collect();
    let half = path.half();
    let far = NEAR * half[0].max(half[1]);
    let near = |p: &[f64; 2]| ideal.iter().any(|q| (p[0] - q[0]).hypot(p[1] - q[1]) < far);
    let tool = |r: &Record| r.tool.map(|t| [t.x, t.y]).filter(near);
    let points: Vec<Option<[f64; 2]>> = records.iter().step_by(STRIDE).map(tool).collect();
    let stretches = points.split(Option::is_none);
    stretches.max_by_key(|s| s.len()).unwrap_or_default().iter().copied().flatten().collect()
}

/// The true contact force from touching down on, and when the coach came.
pub(crate) fn force(log: &TruthLog, marks: &[(u64, Mark)]) -> Option<TimePlot> {
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

/// What the sponge cleaned, and the hand's path until the coach acted. The table's tilt of a few degrees is not drawn.
pub(crate) fn wiped(
    world: &World,
    log: &TruthLog,
    marks: &[(u64, Mark)],
    cells: &WipedCells,
) -> Option<WipedArea> {
    let adapted = ended_adapting(marks)?;
    let until = actions(log, EventKind::Began).next().map_or(u64::MAX, |e| (e.t * 1e9) as u64);
    let swept = cells.swept.cells().iter().zip(cells.cleaned.cells()).zip(cells.cleaned_in_the_end.cells());
    let kind = |((swept, cleaned), later): ((&bool, &bool), &bool)| match (*swept, *cleaned, *later) {
        (true, true, _) => Cell::Cleaned,
        (true, false, _) => Cell::Missed,
        (false, _, true) => Cell::Beside,
        (false, ..) => Cell::Untouched,
    };
    let wiping = log.between(adapted, until).iter().step_by(STRIDE).filter(|r| r.normal > 0.0);
    Some(WipedArea {
        origin: std::array::from_fn(|k| world.table.center[k] - world.table.size[k] / 2.0),
        cell_m: DIRT_CELL,
        columns: cells.swept.columns(),
        cells: swept.map(kind).collect(),
        path: wiping.map(|r| [r.tcp.translation.x, r.tcp.translation.y]).collect(),
    })
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
                sponge: None,
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
