//! The probe `guiding`: the force with which a person leads the robot's hand, how the hand rests when nobody does, and how it
//! stands after a shove or when its sensor fails.

use armarium_values::report::Requirement::{AtLeast, AtMost, Shown};
use armarium_values::report::{Block, Cell, Figure, Path, PathStyle, Section, Series, Table, TimePlot};
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::{Value, json};

use super::imitation::plan;
use super::log::Record;
use super::probes::{Probe, cell, figure, table_of, things};
use super::run::{JudgedRun, ns, seconds};
use super::{Milestone, TruthLog};
use crate::physics::LedHand;
use crate::world::{Disturbance, HAND, WorldEvent, WrenchFault};

pub(super) const PROBE: Probe = Probe { name: "guiding", measure, asks, section };

/// A hand that is led moves when it is faster than this, m/s.
const MOVING: f64 = 0.02;
/// Two hands that are led within this time are led once, ns.
const GAP_NS: u64 = 10_000_000;
/// A robot stands while all joints are slower than this, rad/s (m/s), ...
const STANDING: f64 = 0.01;
/// ... for this long, ns.
const STANDS_NS: u64 = 300_000_000;
/// The time in which a steady push moves the hand, s.
const AT_ONCE_S: f64 = 0.5;
/// A larger force is a shove and no push, N.
const SHOVE_N: f64 = 30.0;
/// Every so many milliseconds a point is drawn.
const STRIDE: usize = 10;

/// One hand led once.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct LeadFigures {
    /// The robot's arm, by its index among its arms.
    arm: usize,
    from_s: f64,
    for_s: f64,
    /// Mean of the force while the hand moved, N.
    mean_n: f64,
    /// Largest force, N.
    peak_n: f64,
    /// Length of the hand's way, m, and how far it was turned, degrees.
    way_m: f64,
    turned_deg: f64,
    /// Mean speed while it moved, m/s.
    speed_m_s: f64,
    /// From where the hand was at the end to where the person wanted it, m.
    behind_m: f64,
}

/// A force from outside on the hand.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct PushFigures {
    at_s: f64,
    force_n: f64,
    /// Whether it is a shove; else a push that shall move the hand.
    shove: bool,
    /// How far the hand was half a second after the beginning of a push, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    moved_m: Option<f64>,
    /// How far it gave way to a shove, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    gave_m: Option<f64>,
    /// From the end of a shove until all joints stood, s; absent if they did not.
    #[serde(skip_serializing_if = "Option::is_none")]
    stood_after_s: Option<f64>,
}

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    let started = run.first_time_of(|mark| *mark == Milestone::GuidingStarted)?;
    let leads: Vec<LeadFigures> = leads(run.log).iter().filter_map(|led| lead(led)).collect();
    let pushes: Vec<PushFigures> = pushes(run).map(|push| pushed(run.log, push)).collect();
    let mut figures = json!({"leads": leads, "pushes": pushes});
    let first = run.log.led.first().map_or(u64::MAX, |(at, _)| *at);
    let first = pushes_ns(run).chain(frozen_ns(run)).fold(first, u64::min);
    let resting = run.log.between(started, first);
    if let [begin, .., end] = resting {
        let off = resting.iter().map(|record| far(record, begin)).fold(0.0, f64::max);
        figures["rest_s"] = seconds(end.stamp_ns - begin.stamp_ns).into();
        figures["rest_drift_m"] = off.into();
    }
    if let Some(off) = played(run) {
        figures["played_rms_m"] = off.into();
    }
    if let Some(frozen) = frozen_ns(run) {
        figures["frozen_stood_after_s"] = stands_after(run.log, frozen).into();
    }
    Some(figures)
}

/// What happened to the hands that were led, each time.
fn leads(log: &TruthLog) -> Vec<Vec<(u64, LedHand)>> {
    let mut all: Vec<Vec<(u64, LedHand)>> = Vec::new();
    for (at, hand) in &log.led {
        let goes_on = |led: &&mut Vec<(u64, LedHand)>| {
            led.last().is_some_and(|(last, other)| other.arm == hand.arm && at - last <= GAP_NS)
        };
        match all.iter_mut().rev().find(goes_on) {
            Some(led) => led.push((*at, *hand)),
            None => all.push(vec![(*at, *hand)]),
        }
    }
    all
}

fn lead(led: &[(u64, LedHand)]) -> Option<LeadFigures> {
    let [(from, begin), .., (to, end)] = led else { return None };
    let steps = led.windows(2).map(|pair| {
        let way = (pair[1].1.tcp.translation.vector - pair[0].1.tcp.translation.vector).norm();
        (way, seconds(pair[1].0 - pair[0].0), pair[1].1.force.norm())
    });
    let (mut way, mut moving, mut work) = (0.0, 0.0, 0.0);
    for (step, dt, force) in steps.filter(|(step, dt, _)| *step > MOVING * dt) {
        way += step;
        moving += dt;
        work += force * dt;
    }
    let per = |sum: f64| if moving > 0.0 { sum / moving } else { 0.0 };
    Some(LeadFigures {
        arm: begin.arm,
        from_s: seconds(*from),
        for_s: seconds(to - from),
        mean_n: per(work),
        peak_n: led.iter().map(|(_, hand)| hand.force.norm()).fold(0.0, f64::max),
        way_m: way,
        turned_deg: begin.tcp.rotation.angle_to(&end.tcp.rotation).to_degrees(),
        speed_m_s: per(way),
        behind_m: end.behind.norm(),
    })
}

/// The distance of the path that was played from the one that was led last, RMS, minimised over the time between them, m. Both
/// are those of the true TCP.
fn played(run: &JudgedRun<'_>) -> Option<f64> {
    let from = run.time_of(|mark| *mark == Milestone::PlayStarted)?;
    let to = run.time_of(|mark| *mark == Milestone::PlayEnded)?;
    let all = leads(run.log);
    let led = all.last()?;
    let moving = |pair: &[(u64, LedHand)]| {
        let step = (pair[1].1.tcp.translation.vector - pair[0].1.tcp.translation.vector).norm();
        step > MOVING * seconds(pair[1].0 - pair[0].0)
    };
    let led = led.windows(2).filter(|pair| moving(pair)).step_by(STRIDE);
    let led: Vec<Vector3<f64>> = led.map(|pair| pair[0].1.tcp.translation.vector).collect();
    let records = run.log.between(from, to).iter().step_by(STRIDE);
    let played: Vec<Vector3<f64>> = records.map(|record| record.tcp.translation.vector).collect();
    if led.is_empty() || played.is_empty() {
        return None;
    }
    let (least, most) = (-(played.len() as i64), led.len() as i64);
    let off = |shift: i64| {
        let at = |k: usize| led[(k as i64 + shift).clamp(0, most - 1) as usize];
        played.iter().enumerate().map(|(k, place)| (place - at(k)).norm_squared()).sum::<f64>()
    };
    let best = (least..most).step_by(2).map(off).fold(f64::INFINITY, f64::min);
    Some((best / played.len() as f64).sqrt())
}

/// The forces on the hand at times that the world's file says. One that is there from the start is a weight, and no push.
fn pushes<'r>(run: &'r JudgedRun<'_>) -> impl Iterator<Item = &'r Disturbance> {
    let on_the_hand = |d: &&Disturbance| d.after == WorldEvent::Start && d.at > 0.0 && d.knock == HAND;
    run.world.disturbances.iter().filter(on_the_hand)
}

fn pushes_ns(run: &JudgedRun<'_>) -> impl Iterator<Item = u64> {
    pushes(run).map(|push| ns(push.at))
}

fn frozen_ns(run: &JudgedRun<'_>) -> Option<u64> {
    let faults = &run.world.faults;
    (faults.wrench == WrenchFault::Frozen).then(|| ns(faults.from))
}

fn pushed(log: &TruthLog, push: &Disturbance) -> PushFigures {
    let (begins, ends) = (ns(push.at), ns(push.at + push.duration));
    let force_n = Vector3::from(push.force).norm();
    let shove = force_n > SHOVE_N;
    let begin = log.at(begins);
    let off = |at: u64| Some(far(log.at(at)?, begin?));
    let stood = stands_after(log, ends);
    let until = ends + stood.map_or(2 * STANDS_NS, ns);
    let farthest =
        || Some(log.between(begins, until).iter().map(|r| far(r, begin.unwrap_or(r))).fold(0.0, f64::max));
    PushFigures {
        at_s: push.at,
        force_n,
        shove,
        moved_m: if shove { None } else { off(begins + ns(AT_ONCE_S)) },
        gave_m: if shove { farthest() } else { None },
        stood_after_s: stood.filter(|_| shove),
    }
}

/// The distance between the hand's places, m.
fn far(a: &Record, b: &Record) -> f64 {
    (a.tcp.translation.vector - b.tcp.translation.vector).norm()
}

/// How long it takes from a time until all joints stand and go on standing, s.
fn stands_after(log: &TruthLog, from: u64) -> Option<f64> {
    let after = log.between(from, u64::MAX);
    let mut since = None;
    for record in after {
        if record.fastest_joint > STANDING {
            since = None;
        } else if record.stamp_ns - *since.get_or_insert(record.stamp_ns) >= STANDS_NS {
            break;
        }
    }
    since.map(|at: u64| seconds(at - from))
}

fn asks(own: &Value) -> Vec<Figure> {
    let mut figures = Vec::new();
    for led in things(&own["leads"]) {
        let group = format!("Led at {:.0} s", led["from_s"].as_f64().unwrap_or_default());
        let of = |name, key, unit, requirement| figure((&group, name), led, key, unit, requirement);
        figures.extend([
            of("mean force", ("mean_n", 1.0), ("N", 1), AtMost(10.0)),
            of("largest force", ("peak_n", 1.0), ("N", 1), AtMost(20.0)),
            of("way", ("way_m", 1.0), ("m", 2), Shown),
            of("turned", ("turned_deg", 1.0), ("°", 1), Shown),
            of("behind at the end", ("behind_m", 1e3), ("mm", 0), AtMost(40.0)),
        ]);
    }
    for push in things(&own["pushes"]) {
        let at = push["at_s"].as_f64().unwrap_or_default();
        let group = format!("{} at {at:.0} s", if push["shove"] == true { "Shove" } else { "Push" });
        let of = |name, key, unit, requirement| figure((&group, name), push, key, unit, requirement);
        if push["shove"] == true {
            figures.push(of("gave way", ("gave_m", 1e3), ("mm", 0), AtMost(50.0)));
            figures.push(of("stood after", ("stood_after_s", 1e3), ("ms", 0), AtMost(200.0)));
        } else {
            figures.push(of("moved within 0.5 s", ("moved_m", 1e3), ("mm", 0), AtLeast(10.0)));
        }
    }
    let of = |name, key, unit, requirement| figure(("Hand at rest", name), own, key, unit, requirement);
    if own.get("rest_s").is_some() {
        figures.push(of("rested", ("rest_s", 1.0), ("s", 0), Shown));
        figures.push(of("drift", ("rest_drift_m", 1e3), ("mm", 2), AtMost(2.0)));
    }
    if own.get("played_rms_m").is_some() {
        let key = ("played_rms_m", 1e3);
        figures.push(figure(("Kept motion", "played against led, RMS"), own, key, ("mm", 1), AtMost(10.0)));
    }
    if own.get("frozen_stood_after_s").is_some() {
        let key = ("frozen_stood_after_s", 1e3);
        figures.push(of("stood after its sensor froze", key, ("ms", 0), AtMost(250.0)));
    }
    figures
}

fn section(run: &JudgedRun<'_>, own: &Value) -> Vec<Section> {
    if own.is_null() {
        return Vec::new();
    }
    let note =
        "The force between a person who leads the robot's hand and that hand, and the way that it went.";
    let leads = leads(run.log);
    let name = |i: usize, led: &[(u64, LedHand)]| format!("lead {}, arm {}", i + 1, led[0].1.arm + 1);
    let series = leads.iter().enumerate().map(|(i, led)| Series {
        label: name(i, led),
        t_s: led.iter().map(|(at, _)| seconds(*at)).collect(),
        y: led.iter().map(|(_, hand)| hand.force.norm()).collect(),
    });
    let place = |(_, hand): &(u64, LedHand)| [hand.tcp.translation.x, hand.tcp.translation.y];
    let paths = leads.iter().enumerate().map(|(i, led)| Path {
        label: name(i, led),
        style: PathStyle::Line,
        points: led.iter().step_by(STRIDE).map(place).collect(),
    });
    let plot = TimePlot {
        title: "Force of the person on the hand".into(),
        y_label: "Force, N".into(),
        series: series.collect(),
        limits: vec![(20.0, "at most".into())],
        ..TimePlot::default()
    };
    let mut blocks = vec![Block::Table(table(&own["leads"]))];
    if !leads.is_empty() {
        blocks.push(Block::Plot(plot));
        blocks.push(Block::Plan(plan("The way of the hand that was led", paths.collect())));
    }
    vec![Section::new("Guiding", note, blocks)]
}

fn table(leads: &Value) -> Table {
    let titles = ["#From", "#For", "#Arm", "#Mean force", "#Largest", "#Way", "#Turned", "#Speed", "#Behind"];
    table_of(leads, &titles, |led| {
        vec![
            cell(led, ("from_s", 1.0), "s", 1),
            cell(led, ("for_s", 1.0), "s", 1),
            Cell::Text((led["arm"].as_u64().unwrap_or_default() + 1).to_string()),
            cell(led, ("mean_n", 1.0), "N", 1),
            cell(led, ("peak_n", 1.0), "N", 1),
            cell(led, ("way_m", 1.0), "m", 2),
            cell(led, ("turned_deg", 1.0), "°", 1),
            cell(led, ("speed_m_s", 1.0), "m/s", 2),
            cell(led, ("behind_m", 1e3), "mm", 0),
        ]
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;
    use crate::world::World;

    /// A hand that rests for 10 s, is led along x at 0.2 m/s for 2.5 s with 6 N, and stands.
    fn led() -> (World, TruthLog) {
        let mut log = TruthLog::default();
        for ms in 0..20_000_u64 {
            let t = ms as f64 * 1e-3;
            let moving = (10.0..12.5).contains(&t);
            let tcp = Isometry3::translation(0.3 + 0.2 * (t - 10.0).clamp(0.0, 2.5), 0.5, 1.0);
            log.records.push(Record {
                stamp_ns: ms * 1_000_000,
                tcp,
                object: None,
                normal: 0.0,
                tangential: 0.0,
                tool: None,
                fastest_joint: if moving { 0.3 } else { 0.0 },
            });
            if (9.5..13.5).contains(&t) {
                let force = Vector3::x() * if moving { 6.0 } else { 1.0 };
                let (torque, behind) = (Vector3::zeros(), Vector3::x() * 0.004);
                log.led.push((ms * 1_000_000, LedHand { arm: 1, tcp, force, torque, behind }));
            }
        }
        (World::default(), log)
    }

    fn figures(world: &World, log: &TruthLog) -> Value {
        let marks = [(1_000_000_000, Milestone::GuidingStarted)];
        measure(&JudgedRun::new(world, log, &marks, &[])).unwrap()
    }

    #[test]
    fn a_lead_has_its_force_and_its_way_and_a_hand_its_rest() {
        let (world, log) = led();
        let own = figures(&world, &log);
        let lead = &own["leads"][0];
        let is = |key: &str, expected: f64| {
            let value = lead[key].as_f64().unwrap();
            assert!((value - expected).abs() < 2e-3 * expected.abs().max(1.0), "{key}: {value}");
        };
        is("mean_n", 6.0);
        is("peak_n", 6.0);
        is("way_m", 0.5);
        is("speed_m_s", 0.2);
        is("behind_m", 0.004);
        assert_eq!((lead["arm"].as_u64(), own["leads"].as_array().unwrap().len()), (Some(1), 1));
        assert!((own["rest_s"].as_f64().unwrap() - 8.5).abs() < 0.01 && own["rest_drift_m"] == 0.0);
        assert!(asks(&own).iter().all(|figure| figure.passed() != Some(false)));
    }

    #[test]
    fn too_much_force_is_found_and_so_is_a_hand_that_does_not_come() {
        let (world, mut log) = led();
        for (_, hand) in &mut log.led {
            hand.force *= 4.0;
            hand.behind *= 20.0;
        }
        let missed: Vec<String> = asks(&figures(&world, &log))
            .into_iter()
            .filter(|f| f.passed() == Some(false))
            .map(|f| f.name)
            .collect();
        assert_eq!(missed, ["mean force", "largest force", "behind at the end"]);
    }

    #[test]
    fn after_a_shove_it_has_to_stand_and_a_push_has_to_move_it() {
        let (mut world, log) = led();
        let force = |force: f64, at: f64, duration: f64| Disturbance {
            after: WorldEvent::Start,
            at,
            knock: HAND.into(),
            force: [force, 0.0, 0.0],
            duration,
            steady: true,
            by: None,
            slippery: None,
        };
        // The hand moves from 10 s to 12.5 s, whatever moves it.
        world.disturbances = vec![force(60.0, 11.9, 0.15), force(5.0, 10.0, 1.0), force(5.0, 14.0, 1.0)];
        world.faults.wrench = WrenchFault::Frozen;
        world.faults.from = 12.2;
        let own = figures(&world, &log);
        let shove = &own["pushes"][0];
        assert!((shove["gave_m"].as_f64().unwrap() - 0.12).abs() < 1e-3, "{shove}");
        assert!((shove["stood_after_s"].as_f64().unwrap() - 0.45).abs() < 2e-3, "{shove}");
        let moved = |i: usize| own["pushes"][i]["moved_m"].as_f64().unwrap();
        assert!((moved(1) - 0.1).abs() < 1e-3 && moved(2) == 0.0);
        assert!((own["frozen_stood_after_s"].as_f64().unwrap() - 0.3).abs() < 2e-3);
        let missed = asks(&own).into_iter().filter(|figure| figure.passed() == Some(false)).count();
        assert_eq!(missed, 4, "the way and the time of the shove, a push, and the time after the fault");
    }
}
