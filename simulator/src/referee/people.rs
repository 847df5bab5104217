//! The probe `people`: how near the robot came to each person, and how hard it touched them.

use armarium_values::report::Requirement::{AtMost, Shown};
use armarium_values::report::{Block, Cell, Figure, Section, Table};
use serde::Serialize;
use serde_json::Value;

use super::probes::{Probe, cell, figure, of_each, table_of, things};
use super::run::JudgedRun;
use crate::physics::Touched;

/// The largest permitted force on a hand that is clamped, N: ISO/TS 15066, annex A, hands and fingers. A force in free
/// space may be twice as large there; that is not used here.
const PERMITTED_N: f64 = 140.0;

pub(super) const PROBE: Probe = Probe {
    name: "people",
    measure: |run| of_each(&people(run)),
    asks: |own| things(own).iter().flat_map(asks).collect(),
    section: |_, own| {
        let note = "How near the robot's arms came to each person, and the largest force between them.";
        vec![Section::new("People", note, vec![Block::Table(table(own))])]
    },
};

#[derive(Clone, Debug, PartialEq, Serialize)]
struct PersonFigures {
    name: String,
    /// The smallest distance between the robot's arms and the person, m; looked at every 20 ms.
    nearest_m: f64,
    /// The largest force between them, N.
    touched_with_n: f64,
}

fn people(run: &JudgedRun<'_>) -> Vec<PersonFigures> {
    let one = |(index, spec): (usize, &crate::world::PersonSpec)| {
        Some(PersonFigures {
            name: spec.name.clone(),
            nearest_m: *run.log.nearest.get(index)?,
            touched_with_n: run.log.strongest.get(&Touched::Person(index)).copied().unwrap_or_default(),
        })
    };
    run.world.people().enumerate().filter_map(one).collect()
}

fn asks(person: &Value) -> Vec<Figure> {
    let group = format!("Person {}", person["name"].as_str().unwrap_or_default());
    let of = |name, key, unit, requirement| figure((&group, name), person, key, unit, requirement);
    vec![
        of("nearest", ("nearest_m", 1e3), ("mm", 0), Shown),
        of("touched with", ("touched_with_n", 1.0), ("N", 1), AtMost(PERMITTED_N)),
    ]
}

fn table(own: &Value) -> Table {
    table_of(own, &["Person", "#Nearest", "#Touched with"], |person| {
        vec![
            Cell::Text(person["name"].as_str().unwrap_or_default().to_owned()),
            cell(person, ("nearest_m", 1e3), "mm", 0),
            cell(person, ("touched_with_n", 1.0), "N", 1),
        ]
    })
}
