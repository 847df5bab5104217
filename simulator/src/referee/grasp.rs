//! The probe `grasp`: where the object is in the hand when it has closed.

use armarium_values::report::Requirement::AtMost;
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::probes::{Probe, figure};
use super::run::JudgedRun;

pub(super) const PROBE: Probe = Probe {
    name: "grasp",
    measure: |run| serde_json::to_value(grasp(run)?).ok(),
    asks: |own: &Value| {
        vec![figure(("Grasp", "position error"), own, ("position_error_m", 1e3), ("mm", 1), AtMost(15.0))]
    },
    section: |_, _| Vec::new(),
};

#[derive(Clone, Debug, PartialEq, Serialize)]
struct GraspFigures {
    /// The object that is judged: the one in the hand when it closed.
    object: String,
    /// True pose of the object in the hand less the nominal grasp when closing has ended, m.
    position_error_m: f64,
}

/// Of the object in the hand when it closed last; of the one in question if there was none in it.
fn grasp(run: &JudgedRun<'_>) -> Option<GraspFigures> {
    let record = run.log.at(run.time_of(|m| *m == Milestone::GraspClosed)?)?;
    let (object, pose) = record.object?;
    let in_tcp = record.tcp.inverse() * pose;
    let off = in_tcp.translation.vector - run.world.grasp_in_tcp();
    let object = run.world.body_name(object)?.to_owned();
    Some(GraspFigures { object, position_error_m: off.norm() })
}
