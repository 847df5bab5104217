//! The probe `wiped_fraction`: the area that the object in the hand cleaned, as cells of the table under its pressed underside.

use std::f64::consts::TAU;

use armarium_values::report::Requirement::AtLeast;
use armarium_values::report::{Block, Cells, Figure, Path, PathStyle, Plan, Section, Tone};
use serde_json::Value;

use super::imitation::{STRIDE, plan};
use super::probes::Probe;
use super::run::{JudgedRun, ns};
use crate::coach::EventKind;
use crate::foundation::ElasticFoundation;
use crate::table::{DIRT_CELL, DirtGrid, TableTop, WIPE_EVERY};

pub(super) const PROBE: Probe = Probe {
    name: "wiped_fraction",
    measure: |run| wiped(run)?.fraction().map(Value::from),
    asks: |own: &Value| {
        vec![Figure {
            group: "Wiping".into(),
            name: "wiped fraction".into(),
            value: own.as_f64().map(|v| v * 1e2),
            unit: "%".into(),
            requirement: AtLeast(95.0),
            digits: 1,
        }]
    },
    section: |run, _| {
        let object = run.judged_object().and_then(|object| run.world.body_name(object)).unwrap_or("object");
        let note = format!(
            "What the {object} cleaned by pressing on it, seen from above, and the path of the hand until the coach acted."
        );
        let drawn = wiped(run).and_then(|cells| drawing(run, &cells));
        vec![Section::new("Wiped area", &note, drawn.map(Block::Plan).into_iter().collect())]
    },
};

/// Cells of the table, all in one grid.
#[derive(Clone, Debug, PartialEq)]
pub struct WipedCells {
    /// Cells that the object's footprint sweeps with the TCP on the coach's path.
    pub swept: DirtGrid,
    /// Cells that were cleaned before the coach first acted.
    pub cleaned: DirtGrid,
    /// Cells that were cleaned in the whole run.
    pub cleaned_in_the_end: DirtGrid,
}

impl WipedCells {
    /// The part of the swept cells that was cleaned before the coach acted.
    fn fraction(&self) -> Option<f64> {
        self.swept.covered_by(&self.cleaned)
    }
}

/// The footprint is that of the object as the hand holds it (its place and yaw in the hand at the end of
/// adaptation), with the TCP on the coach's path. Cells count as cleaned by the elastic pressure at the
/// object's true poses, every 5 ms.
pub(super) fn wiped(run: &JudgedRun<'_>) -> Option<WipedCells> {
    let record = run.log.at(run.adapted()?)?;
    let (object, pose) = record.object?;
    let spec = run.world.named_bodies().nth(object)?.softness()?;
    let tcp_from_object = record.tcp.inverse() * pose;
    let (table, bed) = (TableTop::new(&run.world.table), ElasticFoundation::new(&spec));
    let mut swept = DirtGrid::new(&table);
    for i in 0..360 {
        let [x, y] = run.path.point(TAU * f64::from(i) / 360.0);
        let mut tcp = record.tcp;
        (tcp.translation.x, tcp.translation.y) = (x, y);
        bed.cover(&table, &(tcp * tcp_from_object), &mut swept);
    }
    let wipe = |from: u64, to: u64, cells: &mut DirtGrid| {
        let step = WIPE_EVERY * 1_000_000;
        for r in run.log.between(from, to) {
            if r.stamp_ns.is_multiple_of(step)
                && r.normal > 0.0
                && let Some((other, pose)) = &r.object
                && *other == object
            {
                bed.wipe(&table, pose, cells);
            }
        }
    };
    let mut cleaned = DirtGrid::new(&table);
    wipe(0, run.coaching_ns(), &mut cleaned);
    let mut cleaned_in_the_end = cleaned.clone();
    wipe(run.coaching_ns(), u64::MAX, &mut cleaned_in_the_end);
    Some(WipedCells { swept, cleaned, cleaned_in_the_end })
}

/// The cleaned area, and the hand's path until the coach acted. The table's tilt of a few degrees is not drawn.
fn drawing(run: &JudgedRun<'_>, cells: &WipedCells) -> Option<Plan> {
    let adapted = run.adapted()?;
    let until = run.actions(EventKind::Began).next().map_or(u64::MAX, |e| ns(e.t));
    let swept = cells.swept.cells().iter().zip(cells.cleaned.cells()).zip(cells.cleaned_in_the_end.cells());
    let kind = |((swept, cleaned), later): ((&bool, &bool), &bool)| match (*swept, *cleaned, *later) {
        (true, true, _) => 1,
        (true, false, _) => 2,
        (false, _, true) => 3,
        (false, ..) => 0,
    };
    let wiping = run.log.between(adapted, until).iter().step_by(STRIDE).filter(|r| r.normal > 0.0);
    let fraction = cells.fraction();
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
            origin: std::array::from_fn(|k| run.world.table.center[k] - run.world.table.size[k] / 2.0),
            cell_m: DIRT_CELL,
            columns: cells.swept.columns(),
            kinds,
            cells: swept.map(kind).collect(),
        }),
        ..plan("Wiped area", vec![path])
    })
}
