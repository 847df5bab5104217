//! The probe `bodies`: where the world's `bodies` began and ended, whether they fell or were spilled, and how hard the robot
//! touched them.

use armarium_values::report::Requirement::{AtMost, Shown};
use armarium_values::report::{Block, Cell, Figure, Section, Table};
use nalgebra::{Point3, Vector3};
use serde::Serialize;
use serde_json::Value;

use super::probes::{Probe, cell, figure, of_each, table_of, things};
use super::run::JudgedRun;
use crate::physics::Touched;
use crate::world::BodySpec;

/// A body that is lower than at the start by more than this has fallen, m.
const FALLEN: f64 = 0.3;

pub(super) const PROBE: Probe = Probe {
    name: "bodies",
    measure: |run| of_each(&bodies(run)),
    asks: |own| things(own).iter().flat_map(asks).collect(),
    section: |_, own| {
        let note = "Where each body of the world was at the end, against where it began, and the largest force of the robot on it.";
        vec![Section::new("Bodies", note, vec![Block::Table(table(own))])]
    },
};

#[derive(Clone, Debug, PartialEq, Serialize)]
struct BodyFigures {
    name: String,
    /// From where it began to where it ended, m.
    moved_m: f64,
    /// The angle between its z axis at the start and at the end, degrees.
    tipped_deg: f64,
    /// Whether it ended lower than it began by more than 0.3 m.
    fell: bool,
    /// How many of the balls in it are no longer inside.
    #[serde(skip_serializing_if = "Option::is_none")]
    spilled: Option<usize>,
    /// The largest force between the robot and it, N.
    touched_with_n: f64,
}

fn bodies(run: &JudgedRun<'_>) -> Vec<BodyFigures> {
    let objects = run.world.objects.len();
    let named = objects + run.world.bodies.len();
    let mut inside = named;
    let one = |(index, spec): (usize, &BodySpec)| {
        let balls = spec.contents.as_ref().map(|contents| contents.balls as usize);
        let own = inside..inside + balls.unwrap_or(0);
        inside = own.end;
        let (begin, end) = run.log.begin_and_end(index)?;
        let moved = end.translation.vector - begin.translation.vector;
        let [then, now] = [begin, end].map(|pose| pose.rotation * Vector3::z());
        let (half, body_from_room) = (spec.half(), end.inverse());
        // What lies on top of the others may stand out by half of the height.
        let reach = [half.x, half.y, 2.0 * half.z];
        let is_inside = |place: Point3<f64>| (0..3).all(|k| place[k].abs() <= reach[k]);
        let is_out = |ball: &usize| {
            let end = run.log.begin_and_end(*ball).map(|(_, end)| Point3::from(end.translation.vector));
            !end.is_some_and(|end| is_inside(body_from_room * end))
        };
        Some(BodyFigures {
            name: spec.name.clone(),
            moved_m: moved.norm(),
            tipped_deg: libm::acos(then.dot(&now).clamp(-1.0, 1.0)).to_degrees(),
            fell: moved.z < -FALLEN,
            spilled: balls.map(|_| own.filter(is_out).count()),
            touched_with_n: run.log.strongest.get(&Touched::Body(index)).copied().unwrap_or_default(),
        })
    };
    (objects..).zip(&run.world.bodies).filter_map(one).collect()
}

fn asks(body: &Value) -> Vec<Figure> {
    let name = body["name"].as_str().unwrap_or_default();
    let group = format!("Body {name}");
    let of = |name, key, unit, requirement| figure((&group, name), body, key, unit, requirement);
    let mut figures = vec![of("moved", ("moved_m", 1e3), ("mm", 0), Shown)];
    if body.get("spilled").is_some() {
        figures.push(of("balls spilled", ("spilled", 1.0), ("", 0), AtMost(0.0)));
    }
    figures
}

fn table(own: &Value) -> Table {
    let titles = ["Body", "#Moved", "#Tipped", "Fell", "#Spilled", "#Touched with"];
    table_of(own, &titles, |body| {
        vec![
            Cell::Text(body["name"].as_str().unwrap_or_default().to_owned()),
            cell(body, ("moved_m", 1e3), "mm", 0),
            cell(body, ("tipped_deg", 1.0), "°", 1),
            Cell::Text(if body["fell"] == true { "yes" } else { "no" }.to_owned()),
            cell(body, ("spilled", 1.0), "", 0),
            cell(body, ("touched_with_n", 1.0), "N", 1),
        ]
    })
}
