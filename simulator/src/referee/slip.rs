//! The probe `slip`: when a thing that a hand holds truly begins to slip while the robot watches it, and when the robot knows that.

use armarium_values::report::Figure;
use armarium_values::report::Requirement::{AtMost, Shown};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::probes::{Probe, figure};
use super::run::{JudgedRun, ns, seconds};

pub(super) const PROBE: Probe = Probe { name: "slip", measure, asks, section: |_, _| Vec::new() };

/// What is asked: the delay from slipping to knowing it, s.
const DELAY: f64 = 0.25;
/// A held thing that has moved in the hand by so much, m, slips.
const SLIPPED: f64 = 0.003;

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct SlipFigures {
    /// When it began to slip, s; absent if it did not.
    #[serde(skip_serializing_if = "Option::is_none")]
    at_s: Option<f64>,
    /// From then until memory was told, s, the longest, and how far the thing then was from where it was held, m; absent if it was never told.
    #[serde(skip_serializing_if = "Option::is_none")]
    delay_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    moved_m: Option<f64>,
    /// How often memory was told of a slip while nothing slipped.
    false_alarms: usize,
    /// How often something slipped and nobody noticed.
    missed: usize,
}

/// The slips in all the time in which the robot watched, of each watch the first.
fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    let body = run.judged_object()?;
    let times = |mark: Milestone| {
        run.marks().iter().filter(move |(_, known)| *known == mark).map(|(at, _)| *at).collect::<Vec<_>>()
    };
    let (begins, ends) = (times(Milestone::GraspWatched), times(Milestone::WatchEnded));
    let end_of = |from: u64| ends.iter().copied().find(|end| *end >= from).unwrap_or_else(|| run.end_ns());
    let watches: Vec<SlipFigures> =
        begins.iter().filter_map(|from| watched(run, body, (*from, end_of(*from)))).collect();
    let worst =
        watches.iter().max_by(|a, b| a.delay_s.unwrap_or(-1.0).total_cmp(&b.delay_s.unwrap_or(-1.0)))?;
    let figures = SlipFigures {
        false_alarms: watches.iter().map(|watch| watch.false_alarms).sum(),
        missed: watches.iter().map(|watch| watch.missed).sum(),
        ..worst.clone()
    };
    serde_json::to_value(figures).ok()
}

/// What slipped in a watch, ns. What begins to slip so shortly before its end that it need not be known by then is not missed.
fn watched(run: &JudgedRun<'_>, body: usize, (from, end): (u64, u64)) -> Option<SlipFigures> {
    let in_hand = |at: u64| {
        let tcp = run.log.at(at)?.tcp;
        Some((tcp.inverse() * run.log.object_at(body, at)?).translation.vector)
    };
    let held = in_hand(from)?;
    let moved = |at: u64| in_hand(at).map(|place| (place - held).norm());
    let known = run.log.slips.iter().copied().find(|at| (from..=end).contains(at));
    let until = known.unwrap_or(end);
    let mut times =
        run.log.records.iter().map(|record| record.stamp_ns).filter(|at| (from..=until).contains(at));
    let begun = times.find(|at| moved(*at).is_some_and(|moved| moved > SLIPPED));
    let noticed = begun.zip(known);
    let in_time = |begun: u64| end.saturating_sub(begun) > ns(DELAY);
    Some(SlipFigures {
        at_s: begun.map(seconds),
        delay_s: noticed.map(|(begun, known)| seconds(known - begun)),
        moved_m: noticed.and_then(|(_, known)| moved(known)),
        false_alarms: usize::from(known.is_some() && begun.is_none()),
        missed: usize::from(known.is_none() && begun.is_some_and(in_time)),
    })
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Slip", name), own, key, unit, requirement);
    let mut all = vec![
        of("false alarms", ("false_alarms", 1.0), ("", 0), AtMost(0.0)),
        of("missed", ("missed", 1.0), ("", 0), AtMost(0.0)),
    ];
    if own.get("delay_s").is_some() {
        all.push(of("delay", ("delay_s", 1e3), ("ms", 0), AtMost(DELAY * 1e3)));
        all.push(of("moved in the hand", ("moved_m", 1e3), ("mm", 1), Shown));
    }
    all
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};
    use serde_json::json;

    use super::*;
    use crate::referee::{TruthLog, measure};
    use crate::truth::TruthSample;
    use crate::world::World;

    const MS: u64 = 1_000_000;

    /// A hand rises with a thing, which stays behind from 500 ms on at 0.1 m/s unless it is held; memory is told at `known`.
    fn figures(held: bool, known: Option<u64>) -> Value {
        let mut log = TruthLog::default();
        for t in 0..1000_u64 {
            let (z, behind) = (1.0 + 1e-4 * t as f64, if held { 0 } else { t.saturating_sub(500) });
            log.sample(&TruthSample {
                stamp_ns: t * MS,
                tcp: Isometry3::from(Vector3::new(0.3, 0.5, z)),
                object: Some(0),
                objects: vec![Isometry3::translation(0.3, 0.5, z - 1e-4 * behind as f64)],
                ..TruthSample::default()
            });
        }
        log.slips.extend(known.map(|at| at * MS));
        // A first watch ended without a slip.
        let marks = [
            (90 * MS, Milestone::GraspClosed),
            (100 * MS, Milestone::GraspWatched),
            (200 * MS, Milestone::WatchEnded),
            (300 * MS, Milestone::GraspWatched),
            (950 * MS, Milestone::WatchEnded),
        ];
        measure(&World::default(), &log, &marks, &[])["slip"].clone()
    }

    #[test]
    fn a_slip_is_known_late_or_never_or_falsely() {
        let late = figures(false, Some(700));
        let delay = late["delay_s"].as_f64().unwrap();
        assert!(
            (delay - 0.169).abs() < 0.002 && (late["moved_m"].as_f64().unwrap() - 0.02).abs() < 1e-6,
            "{late}"
        );
        let counts = |figures: &Value| [figures["missed"].clone(), figures["false_alarms"].clone()];
        assert_eq!(counts(&late), [json!(0), json!(0)]);
        assert_eq!(counts(&figures(false, None)), [json!(1), json!(0)]);
        assert_eq!(counts(&figures(true, Some(700))), [json!(0), json!(1)]);
        assert_eq!(counts(&figures(true, None)), [json!(0), json!(0)]);
    }
}
