//! The probe `reaching`: how exactly both hands came to the two handles of one thing, and whether they arrived together.

use armarium_values::report::Requirement::{AtMost, Shown};
use armarium_values::report::{Block, Figure, Section, Series, TimePlot};
use nalgebra::Isometry3;
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::probes::{Probe, figure};
use super::run::{JudgedRun, seconds};
use crate::world::BodySpec;

pub(super) const PROBE: Probe = Probe { name: "reaching", measure, asks, section };

/// A hand has arrived when it is this near to its grasp, m and degrees, ...
const NEAR: (f64, f64) = (0.005, 3.0);
/// ... for so many milliseconds.
const STAYS: usize = 300;
/// Every so many milliseconds a point is drawn.
const STRIDE: usize = 10;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct ReachingFigures {
    /// The body whose handles they are.
    body: String,
    /// How long they took, s.
    for_s: f64,
    /// The larger distance and the larger angle of a hand from its true grasp frame at the end, m and degrees.
    error_m: f64,
    angle_deg: f64,
    /// Between the arrivals of both, s; none where one did not arrive.
    #[serde(skip_serializing_if = "Option::is_none")]
    apart_s: Option<f64>,
}

/// The distance, m, and the angle, degrees, of each hand from its grasp, each millisecond.
struct GraspErrors {
    body: BodySpec,
    errors: Vec<(u64, [(f64, f64); 2])>,
}

/// While the hands went to the handles.
fn reached(run: &JudgedRun<'_>) -> Option<GraspErrors> {
    let to = run.time_of(|mark| *mark == Milestone::GraspsReached)?;
    let from = run.first_time_of(|mark| *mark == Milestone::ReachingStarted)?;
    let has_two = |(_, body): &(usize, BodySpec)| body.handle_places().len() >= 2;
    let (index, body) = run.world.named_bodies().enumerate().find(has_two)?;
    let model = run.world.robot.load().ok()?;
    let in_tcp: Vec<Isometry3<f64>> =
        model.arms().take(2).filter_map(|arm| Some(model.hand_of(arm)?.grasp_in_tcp)).collect();
    let [first, second] = in_tcp[..] else { return None };
    let places = run.log.moved.get(&index)?;
    let mut next = 0;
    let mut errors = Vec::new();
    let tcps = run.log.tcps.iter().filter(|(at, _)| (from..=to).contains(at));
    let error = |tcp: &Isometry3<f64>, grasp: &Isometry3<f64>| {
        let off = tcp.translation.vector - grasp.translation.vector;
        (off.norm(), tcp.rotation.angle_to(&grasp.rotation).to_degrees())
    };
    for (at, tcps) in tcps {
        next += places[next..].partition_point(|(moved, _)| moved <= at);
        let (_, pose) = places[next.checked_sub(1)?];
        let nearest = |tcp: &Isometry3<f64>, in_tcp: &Isometry3<f64>| {
            let grasps = body.handle_grasps().into_iter().map(|grasp| pose * grasp * in_tcp.inverse());
            grasps.map(|grasp| error(tcp, &grasp)).min_by(|a, b| a.0.total_cmp(&b.0))
        };
        errors.push((*at, [nearest(&tcps[0], &first)?, nearest(&tcps[1], &second)?]));
    }
    (!errors.is_empty()).then_some(GraspErrors { body, errors })
}

impl GraspErrors {
    /// When a hand arrived.
    fn arrival(&self, hand: usize) -> Option<u64> {
        let (near, straight) = NEAR;
        let there =
            |(_, errors): &(u64, [(f64, f64); 2])| errors[hand].0 <= near && errors[hand].1 <= straight;
        let mut stayed = 0;
        for (i, entry) in self.errors.iter().enumerate() {
            stayed = if there(entry) { stayed + 1 } else { 0 };
            if stayed == STAYS {
                return Some(self.errors[i + 1 - STAYS].0);
            }
        }
        None
    }
}

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    let reached = reached(run)?;
    let (begin, end) = (reached.errors.first()?, reached.errors.last()?);
    let apart = reached.arrival(0).zip(reached.arrival(1)).map(|(a, b)| seconds(a.abs_diff(b)));
    let figures = ReachingFigures {
        body: reached.body.name.clone(),
        for_s: seconds(end.0 - begin.0),
        error_m: end.1[0].0.max(end.1[1].0),
        angle_deg: end.1[0].1.max(end.1[1].1),
        apart_s: apart,
    };
    serde_json::to_value(figures).ok()
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Reaching", name), own, key, unit, requirement);
    vec![
        of("took", ("for_s", 1.0), ("s", 1), Shown),
        of("error of a hand", ("error_m", 1e3), ("mm", 1), AtMost(NEAR.0 * 1e3)),
        of("angle of a hand", ("angle_deg", 1.0), ("°", 1), AtMost(NEAR.1)),
        of("arrived apart by", ("apart_s", 1.0), ("s", 2), AtMost(0.2)),
    ]
}

fn section(run: &JudgedRun<'_>, _: &Value) -> Vec<Section> {
    let Some(reached) = reached(run) else { return Vec::new() };
    let series = |hand: usize, label: &str| {
        let drawn = || reached.errors.iter().step_by(STRIDE);
        Series {
            label: label.into(),
            t_s: drawn().map(|(at, _)| seconds(*at)).collect(),
            y: drawn().map(|(_, errors)| errors[hand].0 * 1e3).collect(),
        }
    };
    let plot = TimePlot {
        title: "Distance of both hands from their grasps".into(),
        y_label: "Distance, mm".into(),
        series: vec![series(0, "first hand"), series(1, "second hand")],
        ..TimePlot::default()
    };
    let note = "How near both hands came to the handles of one thing.";
    vec![Section::new("Reaching", note, vec![Block::Plot(plot)])]
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::referee::TruthLog;
    use crate::world::{BodyShape, World};

    /// Both hands come down on the handles of a tray in a second; one of them is late by `late` ms, and off by `off` m.
    fn figures(late: u64, off: f64) -> Value {
        let tray = BodySpec {
            name: "tray".into(),
            shape: BodyShape::Tray,
            size: [0.6, 0.3, 0.03],
            handles: vec![[-0.28, 0.0, 0.05], [0.28, 0.0, 0.05]],
            ..BodySpec::default()
        };
        let world = World { objects: Vec::new(), bodies: vec![tray.clone()], ..World::ideal() };
        let pose = Isometry3::translation(0.0, 0.5, 0.95);
        let mut log = TruthLog::default();
        log.moved.insert(0, vec![(0, pose)]);
        let in_tcp = world.robot.load().unwrap().hands()["right_hand"].grasp_in_tcp;
        for ms in 0..3000_u64 {
            let tcp = |i: usize, late: u64, off: f64| {
                let far = 0.1 * (1.0 - ms.saturating_sub(late) as f64 * 1e-3).max(0.0);
                let mut tcp = pose * tray.handle_grasps()[i] * in_tcp.inverse();
                tcp.translation.vector += Vector3::new(off, 0.0, far);
                tcp
            };
            log.tcps.push((ms * 1_000_000, [tcp(1, 0, 0.0), tcp(0, late, off)]));
        }
        let marks = [(0, Milestone::ReachingStarted), (2_990_000_000, Milestone::GraspsReached)];
        measure(&JudgedRun::new(&world, &log, &marks, &[])).unwrap()
    }

    #[test]
    fn hands_that_are_late_or_beside_their_handles_are_found() {
        let missed = |own: &Value| -> Vec<String> {
            asks(own).into_iter().filter(|f| f.passed() == Some(false)).map(|f| f.name).collect()
        };
        let good = figures(100, 0.001);
        assert!((good["apart_s"].as_f64().unwrap() - 0.1).abs() < 0.01, "{good}");
        assert!((good["error_m"].as_f64().unwrap() - 0.001).abs() < 1e-6, "{good}");
        assert!(missed(&good).is_empty(), "{good}");
        assert_eq!(missed(&figures(300, 0.0)), ["arrived apart by"]);
        assert_eq!(missed(&figures(0, 0.007)), ["error of a hand", "arrived apart by"]);
    }
}
