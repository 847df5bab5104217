//! The probes of the referee. Each is a file that reads the truth, owns its figures with what is asked of them, and writes its
//! own section of the report. A world names those that it wants; by default each one judges that finds something.
//!
//! The page of a report and the repository's own check ask the same figures the same, so that they cannot disagree.

use armarium_values::report::{Cell, Figure, Requirement, Section, Table};
use serde::Serialize;
use serde_json::{Map, Value};

use super::run::JudgedRun;
use super::{
    bodies, body_coached, carrying, coached, environment, force, gaze, gestures, grasp, guiding, imitation,
    learning_together, people, reaching, segmentation, slip, touch, wiped,
};

/// A probe.
pub(super) struct Probe {
    /// Its name, by which a world names it, and under which its figures are in `report.json`.
    pub(super) name: &'static str,
    /// Its figures; `None` where the run has nothing to judge.
    pub(super) measure: fn(&JudgedRun<'_>) -> Option<Value>,
    /// What is asked of its figures.
    pub(super) asks: fn(&Value) -> Vec<Figure>,
    /// Its section of the report, with its figures if it has any.
    pub(super) section: fn(&JudgedRun<'_>, &Value) -> Vec<Section>,
}

/// All probes, in the order of the report.
const PROBES: [&Probe; 18] = [
    &grasp::PROBE,
    &imitation::PROBE,
    &force::PROBE,
    &wiped::PROBE,
    &gestures::PROBE,
    &coached::PROBE,
    &body_coached::PROBE,
    &bodies::PROBE,
    &people::PROBE,
    &guiding::PROBE,
    &reaching::PROBE,
    &carrying::PROBE,
    &learning_together::PROBE,
    &environment::PROBE,
    &gaze::PROBE,
    &segmentation::PROBE,
    &touch::PROBE,
    &slip::PROBE,
];

/// The figures of the probes that the world wants and that find something, by their names.
pub(super) fn measure(run: &JudgedRun<'_>) -> Map<String, Value> {
    let wanted = |probe: &&&Probe| {
        let named = &run.world.probes;
        named.is_empty() || named.iter().any(|name| name == probe.name)
    };
    let figures = PROBES.iter().filter(wanted);
    figures.filter_map(|probe| Some((probe.name.to_owned(), (probe.measure)(run)?))).collect()
}

/// Values of a run's report (`report.json`) with their requirements, in the order of display.
pub fn judged_figures(report: &Value) -> Vec<Figure> {
    let found =
        |probe: &&Probe| report.get(probe.name).filter(|value| !value.is_null()).map(|own| (probe.asks)(own));
    PROBES.iter().filter_map(found).flatten().collect()
}

/// The sections of all probes that have figures, after one with all figures.
pub(super) fn sections(run: &JudgedRun<'_>, report: &Value) -> Vec<Section> {
    let figures = armarium_values::report::Block::Figures(judged_figures(report));
    let mut all = vec![Section::new("Figures", "Measured against the simulator's truth.", vec![figures])];
    for probe in PROBES {
        let own = report.get(probe.name).unwrap_or(&Value::Null);
        all.extend((probe.section)(run, own));
    }
    all
}

/// A figure of a report: its group and name, the value at `key` times `factor`, its unit and digits, and what is asked of it.
pub(super) fn figure(
    (group, name): (&str, &str),
    own: &Value,
    (key, factor): (&str, f64),
    (unit, digits): (&str, usize),
    requirement: Requirement,
) -> Figure {
    let value = own.get(key).and_then(Value::as_f64).map(|v| v * factor);
    Figure { group: group.into(), name: name.into(), value, unit: unit.into(), requirement, digits }
}

/// The figures of each of several things; `None` of nothing.
pub(super) fn of_each<T: Serialize>(things: &[T]) -> Option<Value> {
    (!things.is_empty()).then(|| serde_json::to_value(things).ok())?
}

/// The things whose figures [`of_each`] gives.
pub(super) fn things(own: &Value) -> &[Value] {
    own.as_array().map_or(&[], Vec::as_slice)
}

/// A table with a row for each of them.
pub(super) fn table_of(own: &Value, titles: &[&str], row: impl FnMut(&Value) -> Vec<Cell>) -> Table {
    let mut table = Table::new(titles);
    table.rows = things(own).iter().map(row).collect();
    table
}

/// The value at `key` times `factor`, as a cell.
pub(super) fn cell(of: &Value, (key, factor): (&str, f64), unit: &'static str, digits: usize) -> Cell {
    Cell::optional(of.get(key).and_then(Value::as_f64).map(|v| v * factor), unit, digits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_know_all_probes_by_their_names() {
        assert_eq!(PROBES.map(|probe| probe.name), crate::world::PROBES);
    }
}
