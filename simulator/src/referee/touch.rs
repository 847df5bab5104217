//! The probe `touch`: when a hand that comes to a thing truly touches it first, when the robot knows that, and whether it holds the thing
//! in the end.

use armarium_values::report::Requirement::{AtLeast, AtMost, Shown};
use armarium_values::report::{Block, Cell, Figure, Section};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::probes::{Probe, cell, figure, table_of};
use super::run::{JudgedRun, seconds};

pub(super) const PROBE: Probe = Probe { name: "touch", measure, asks, section };

/// What is asked: the delay, s, and the travel, m, from touching a thing to knowing it.
const DELAY: f64 = 0.25;
const TRAVEL: f64 = 0.015;
/// A thing that an approach moved less, m, was not pushed: a finger may brush it.
const PUSHED: f64 = 0.015;
/// A held thing has been lifted by so much, m.
const LIFTED: f64 = 0.04;

#[derive(Clone, Debug, PartialEq, Serialize)]
struct TouchFigures {
    approaches: Vec<ApproachFigures>,
    /// Approaches in which a thing was touched and pushed, or the touch noticed.
    touches: usize,
    /// Of them, those that were noticed within the delay and the travel that are asked.
    in_time: usize,
    /// Of the seen ones, those with the right finger.
    #[serde(skip_serializing_if = "Option::is_none")]
    right_finger: Option<f64>,
    /// Touches that were noticed before anything was touched.
    false_alarms: usize,
    /// The longest delay, s, and the longest travel, m, of those that were noticed.
    #[serde(skip_serializing_if = "Option::is_none")]
    worst_delay_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    worst_travel_m: Option<f64>,
    /// Touches with a push that were not noticed.
    missed: usize,
    /// 1 if a thing was lifted and is held in the end.
    grasped: usize,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct ApproachFigures {
    at_s: f64,
    /// The finger that touched first.
    #[serde(skip_serializing_if = "Option::is_none")]
    finger: Option<String>,
    /// From the true contact until memory was told, s, and how far the TCP went in that time, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    delay_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    travel_m: Option<f64>,
    /// `seen` or `felt`, and the finger that the robot believes to have touched.
    #[serde(skip_serializing_if = "Option::is_none")]
    by: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    believed_finger: Option<String>,
    /// How far the touched thing was moved, m.
    pushed_m: f64,
}

impl ApproachFigures {
    fn is_false_alarm(&self) -> bool {
        self.by.is_some() && self.delay_s.is_none()
    }

    fn is_missed(&self) -> bool {
        self.by.is_none() && self.pushed_m > PUSHED
    }

    fn in_time(&self) -> bool {
        let within = |value: Option<f64>, most: f64| value.is_some_and(|value| value <= most);
        within(self.delay_s, DELAY) && within(self.travel_m, TRAVEL)
    }
}

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    let begun = |(_, mark): &&(u64, Milestone)| *mark == Milestone::ApproachStarted;
    let starts: Vec<u64> = run.marks().iter().filter(begun).map(|(at, _)| *at).collect();
    let ends = starts.iter().skip(1).copied().chain([run.end_ns()]);
    let approaches: Vec<ApproachFigures> =
        starts.iter().zip(ends).map(|(from, to)| approach(run, *from, to)).collect();
    if approaches.is_empty() {
        return None;
    }
    let noticed = || approaches.iter().filter(|a| a.delay_s.is_some());
    let seen = || noticed().filter(|a| a.by.as_deref() == Some("seen"));
    let right = seen().filter(|a| a.finger == a.believed_finger).count();
    let missed = approaches.iter().filter(|a| a.is_missed()).count();
    let most = |of: &dyn Fn(&ApproachFigures) -> Option<f64>| noticed().filter_map(of).max_by(f64::total_cmp);
    let figures = TouchFigures {
        touches: noticed().count() + missed,
        in_time: noticed().filter(|a| a.in_time()).count(),
        right_finger: (seen().count() > 0).then(|| right as f64 / seen().count() as f64),
        false_alarms: approaches.iter().filter(|a| a.is_false_alarm()).count(),
        worst_delay_s: most(&|a| a.delay_s),
        worst_travel_m: most(&|a| a.travel_m),
        missed,
        grasped: usize::from(is_grasped(run)),
        approaches,
    };
    serde_json::to_value(figures).ok()
}

/// The approach that begins at a time, ns; another one, or the end of the run, is at `to`.
fn approach(run: &JudgedRun<'_>, from: u64, to: u64) -> ApproachFigures {
    let within = |at: u64| at >= from && at < to;
    let ended = run.marks().iter().find(|(at, mark)| *mark == Milestone::ApproachEnded && within(*at));
    let known = run.log.touches.iter().find(|(at, _)| within(*at));
    let until = ended.map(|(at, _)| *at).or(known.map(|(at, _)| *at)).unwrap_or(to);
    let contact = run.log.contacts.iter().find(|(at, ..)| *at >= from && *at <= until);
    let mut figures = ApproachFigures { at_s: seconds(from), ..ApproachFigures::default() };
    if let Some((_, known)) = known {
        (figures.by, figures.believed_finger) = (Some(known.by.clone()), Some(known.finger.clone()));
    }
    let Some((touched_ns, link, body)) = contact else { return figures };
    let model = run.world.model().ok();
    figures.finger = model.and_then(|model| Some(model.links().get(link.index())?.name.clone()));
    let place = |at: u64| run.log.object_at(*body, at).map(|pose| pose.translation.vector);
    figures.pushed_m = place(*touched_ns).zip(place(until)).map_or(0.0, |(a, b)| (b - a).norm());
    if let Some((known_ns, _)) = known {
        figures.delay_s = Some(seconds(known_ns.saturating_sub(*touched_ns)));
        let tcp = |at: u64| run.log.at(at).map(|record| record.tcp.translation.vector);
        figures.travel_m = tcp(*touched_ns).zip(tcp(*known_ns)).map(|(a, b)| (b - a).norm());
    }
    figures
}

/// Whether the hand holds a thing at the end that it has lifted.
fn is_grasped(run: &JudgedRun<'_>) -> bool {
    let closed = run.marks().iter().any(|(_, mark)| *mark == Milestone::GraspClosed);
    let lifted = |body: usize| {
        let ends = run.log.begin_and_end(body);
        ends.is_some_and(|(begin, end)| end.translation.z - begin.translation.z > LIFTED)
    };
    closed && run.judged_object().is_some_and(lifted)
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Touch", name), own, key, unit, requirement);
    let mut all = vec![
        of("touches", ("touches", 1.0), ("", 0), Shown),
        of("false alarms", ("false_alarms", 1.0), ("", 0), AtMost(0.0)),
        of("missed", ("missed", 1.0), ("", 0), AtMost(0.0)),
        of("grasped", ("grasped", 1.0), ("", 0), AtLeast(1.0)),
    ];
    if own.get("worst_delay_s").is_some() {
        all.push(of("delay", ("worst_delay_s", 1e3), ("ms", 0), AtMost(DELAY * 1e3)));
        all.push(of("travel", ("worst_travel_m", 1e3), ("mm", 1), AtMost(TRAVEL * 1e3)));
    }
    if own.get("right_finger").is_some() {
        all.push(of("right finger", ("right_finger", 1e2), ("%", 0), AtLeast(85.0)));
    }
    all
}

fn section(_: &JudgedRun<'_>, own: &Value) -> Vec<Section> {
    if own.is_null() {
        return Vec::new();
    }
    let titles = ["#from", "touched by", "noticed", "taken for", "#delay", "#travel", "#pushed"];
    let table = table_of(&own["approaches"], &titles, |approach| {
        let text = |key: &str| Cell::Text(approach[key].as_str().unwrap_or("-").to_owned());
        vec![
            cell(approach, ("at_s", 1.0), "s", 1),
            text("finger"),
            text("by"),
            text("believed_finger"),
            cell(approach, ("delay_s", 1e3), "ms", 0),
            cell(approach, ("travel_m", 1e3), "mm", 1),
            cell(approach, ("pushed_m", 1e3), "mm", 1),
        ]
    });
    let note = "Each way of the hand to a thing: when a finger truly touched something first, and what the robot noticed of it.";
    vec![Section::new("Touches", note, vec![Block::Table(table)])]
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};
    use serde_json::json;

    use super::*;
    use crate::referee::{KnownTouch, TruthLog, measure};
    use crate::truth::TruthSample;
    use crate::world::World;

    const MS: u64 = 1_000_000;

    /// The hand goes along y at 50 mm/s, begins to push the first object after 500 ms with its left finger, and knows it at `known`.
    fn figures(known: Option<(u64, &str)>) -> Value {
        let world = World::default();
        let finger = world.model().unwrap().link("finger_left_r").unwrap();
        let mut log = TruthLog::default();
        for t in 0..1500 {
            let y = 5e-5 * t as f64;
            let object = Isometry3::translation(0.3, 0.6 + (y - 0.025).max(0.0), 1.0);
            log.sample(&TruthSample {
                stamp_ns: t * MS,
                tcp: Isometry3::from(Vector3::new(0.3, 0.5 + y, 1.0)),
                object: Some(0),
                objects: vec![object],
                links_touching: if t >= 500 { vec![(finger, 0)] } else { Vec::new() },
                ..TruthSample::default()
            });
        }
        let touch = |finger: &str| KnownTouch { finger: finger.into(), by: "seen".into() };
        log.touches.extend(known.map(|(at, finger)| (at * MS, touch(finger))));
        let marks = [(100 * MS, Milestone::ApproachStarted), (1400 * MS, Milestone::ApproachEnded)];
        let marks = if known.is_some() { &marks[..1] } else { &marks[..] };
        measure(&world, &log, marks, &[])["touch"].clone()
    }

    #[test]
    fn a_touch_is_late_by_the_time_and_the_way_from_the_true_contact() {
        let touch = figures(Some((660, "finger_left_r")));
        let first = &touch["approaches"][0];
        assert!((first["delay_s"].as_f64().unwrap() - 0.16).abs() < 1e-9, "{first}");
        assert!((first["travel_m"].as_f64().unwrap() - 0.008).abs() < 1e-9, "{first}");
        assert_eq!(
            (&touch["in_time"], &touch["right_finger"], &touch["false_alarms"]),
            (&json!(1), &json!(1.0), &json!(0))
        );
        let late = figures(Some((900, "finger_right_r")));
        assert_eq!((&late["in_time"], &late["right_finger"]), (&json!(0), &json!(0.0)));
    }

    #[test]
    fn what_is_known_before_it_happens_is_a_false_alarm_and_what_is_never_known_is_missed() {
        let early = figures(Some((400, "finger_left_r")));
        assert_eq!((&early["false_alarms"], &early["touches"]), (&json!(1), &json!(0)));
        let never = figures(None);
        assert_eq!(
            (&never["missed"], &never["touches"], &never["in_time"]),
            (&json!(1), &json!(1), &json!(0))
        );
        assert!(asks(&never).iter().any(|figure| figure.name == "missed" && figure.passed() == Some(false)));
    }
}
