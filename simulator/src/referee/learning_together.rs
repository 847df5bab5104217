//! The probe `learning_together`: how far two hands that lift and shake a load disagree, from epoch to epoch.

use armarium_values::report::Requirement::{AtLeast, AtMost, Shown};
use armarium_values::report::{Block, Figure, Section, Series, Table, TimePlot};
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::{Value, json};

use super::Milestone;
use super::carrying::{CRUSHED_N, Pressed, between, in_hands, internal_force, tilt};
use super::probes::{Probe, cell, figure, table_of, things};
use super::run::{JudgedRun, seconds};

pub(super) const PROBE: Probe = Probe { name: "learning_together", measure, asks, section };

/// By how much the distance error shall have fallen after so many epochs.
const FALLS: f64 = 10.0;
const EPOCHS: usize = 10;
/// Hands that go on from what they learned before begin with less than this distance error, mm.
const BEGINS_MM: f64 = 5.0;
/// Every so many milliseconds a point is drawn.
const STRIDE: usize = 10;

/// One epoch.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct EpochFigures {
    from_s: f64,
    for_s: f64,
    /// Deviation of the way from the first contact to the second from that at the beginning, RMS, m: in the whole epoch, in its
    /// discrete part, and in its periods.
    distance_rms_m: f64,
    discrete_rms_m: f64,
    periods_rms_m: f64,
    /// Deviation of the internal force from that at the beginning, RMS, N.
    force_rms_n: f64,
    /// Largest internal force along the line between both contacts, N.
    internal_most_n: f64,
    /// Largest angle of the load's z to the vertical, less that at the beginning, degrees.
    tilt_deg: f64,
    /// How far the load has slipped between the hands at the end, m.
    slipped_m: f64,
    /// Share of the time in which both hands touched it.
    held: f64,
}

/// When an epoch began, when its periods began, and when it ended, ns.
struct Epoch {
    from: u64,
    periods: u64,
    to: u64,
}

/// The epochs that were done to their end.
fn epochs(run: &JudgedRun<'_>) -> Vec<Epoch> {
    let mut all = Vec::new();
    let (mut from, mut periods) = (None, None);
    for (at, mark) in run.marks() {
        match mark {
            Milestone::EpochStarted => (from, periods) = (Some(*at), None),
            Milestone::PeriodsStarted => periods = Some(*at),
            Milestone::EpochEnded => {
                all.extend(from.zip(periods).map(|(from, periods)| Epoch { from, periods, to: *at }));
                (from, periods) = (None, None);
            }
            _ => {}
        }
    }
    all
}

fn apart((_, load, _): &Pressed) -> Vector3<f64> {
    load.hands[1].at - load.hands[0].at
}

/// The root of the mean square of the distance from its first value.
fn rms(part: &[Pressed], first: &Pressed, of: impl Fn(&Pressed) -> Vector3<f64>) -> f64 {
    let begin = of(first);
    let sum: f64 = part.iter().map(|now| (of(now) - begin).norm_squared()).sum();
    (sum / part.len().max(1) as f64).sqrt()
}

fn judge(run: &JudgedRun<'_>, epoch: &Epoch) -> Option<EpochFigures> {
    let all = between(run, epoch.from, epoch.to);
    let [first, .., last] = all else { return None };
    let (discrete, periods) = all.split_at(all.partition_point(|(at, ..)| *at < epoch.periods));
    let touched = |(_, load, _): &&Pressed| load.hands.iter().all(|hand| hand.force != Vector3::zeros());
    let lean = |(_, _, pose): &Pressed| (tilt(pose) - tilt(&first.2)).abs().to_degrees();
    let force = |(_, load, _): &Pressed| (load.hands[0].force - load.hands[1].force) / 2.0;
    Some(EpochFigures {
        from_s: seconds(first.0),
        for_s: seconds(last.0 - first.0),
        distance_rms_m: rms(all, first, apart),
        discrete_rms_m: rms(discrete, first, apart),
        periods_rms_m: rms(periods, first, apart),
        force_rms_n: rms(all, first, force),
        internal_most_n: all.iter().map(|(_, load, _)| internal_force(load)).fold(0.0, f64::max),
        tilt_deg: all.iter().map(lean).fold(0.0, f64::max),
        slipped_m: (in_hands(last) - in_hands(first)).norm(),
        held: all.iter().filter(touched).count() as f64 / all.len() as f64,
    })
}

fn measure(run: &JudgedRun<'_>) -> Option<Value> {
    run.first_time_of(|mark| *mark == Milestone::EpochStarted)?;
    let epochs: Vec<EpochFigures> = epochs(run).iter().filter_map(|epoch| judge(run, epoch)).collect();
    let mut figures = json!({"epochs": epochs});
    if let Some((_, Milestone::LearnedTogether { before })) =
        run.marked(|mark| matches!(mark, Milestone::LearnedTogether { .. }))
    {
        figures["epochs_before"] = before.into();
    }
    if let [first, .., last] = epochs.as_slice() {
        let fell = |of: fn(&EpochFigures) -> f64| of(first) / of(last).max(1e-9);
        figures["distance_fell"] = fell(|epoch| epoch.distance_rms_m).into();
        figures["discrete_fell"] = fell(|epoch| epoch.discrete_rms_m).into();
        figures["periods_fell"] = fell(|epoch| epoch.periods_rms_m).into();
    }
    if let [first, .., last] | [first @ last] = epochs.as_slice() {
        let most = |of: fn(&EpochFigures) -> f64| epochs.iter().map(of).fold(0.0, f64::max);
        figures["first_rms_m"] = first.distance_rms_m.into();
        figures["last_rms_m"] = last.distance_rms_m.into();
        figures["last_tilt_deg"] = last.tilt_deg.into();
        figures["internal_most_n"] = most(|epoch| epoch.internal_most_n).into();
        figures["slipped_m"] = most(|epoch| epoch.slipped_m).into();
        figures["held"] = epochs.iter().map(|epoch| epoch.held).fold(1.0, f64::min).into();
    }
    Some(figures)
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Learning together", name), own, key, unit, requirement);
    let goes_on = own["epochs_before"].as_u64().is_some_and(|before| before > 0);
    let falls = if goes_on || things(&own["epochs"]).len() < EPOCHS { Shown } else { AtLeast(FALLS) };
    let begins = if goes_on { AtMost(BEGINS_MM) } else { Shown };
    vec![
        of("distance error, first epoch", ("first_rms_m", 1e3), ("mm", 2), begins),
        of("distance error, last epoch", ("last_rms_m", 1e3), ("mm", 2), Shown),
        of("it fell by", ("distance_fell", 1.0), ("", 1), falls),
        of("in the discrete part by", ("discrete_fell", 1.0), ("", 1), falls),
        of("in the periods by", ("periods_fell", 1.0), ("", 1), falls),
        of("internal force, largest", ("internal_most_n", 1.0), ("N", 1), AtMost(CRUSHED_N)),
        of("tilt in the last epoch", ("last_tilt_deg", 1.0), ("°", 1), AtMost(3.0)),
        of("slipped, most in an epoch", ("slipped_m", 1e3), ("mm", 1), AtMost(5.0)),
        of("touched by both hands", ("held", 100.0), ("%", 1), AtLeast(100.0)),
    ]
}

fn section(run: &JudgedRun<'_>, own: &Value) -> Vec<Section> {
    let epochs = epochs(run);
    let (Some(first), Some(last)) = (epochs.first(), epochs.last()) else { return Vec::new() };
    let ended = |epoch: &Value| Some(epoch["from_s"].as_f64()? + epoch["for_s"].as_f64()?);
    let each = |label: &str, key: &str| Series {
        label: label.into(),
        t_s: things(&own["epochs"]).iter().filter_map(ended).collect(),
        y: things(&own["epochs"]).iter().filter_map(|epoch| Some(1e3 * epoch[key].as_f64()?)).collect(),
    };
    let falls = TimePlot {
        title: "Distance error of each epoch, at its end".into(),
        y_label: "RMS, mm".into(),
        series: vec![
            each("whole epoch", "distance_rms_m"),
            each("discrete part", "discrete_rms_m"),
            each("periods", "periods_rms_m"),
        ],
        ..TimePlot::default()
    };
    let mut blocks = vec![Block::Table(table(&own["epochs"])), Block::Plot(falls)];
    for (title, epoch) in
        [("Heights of the hands in the first epoch", first), ("The same in the last one", last)]
    {
        blocks.push(Block::Plot(heights(run, title, epoch)));
    }
    let note = "How far two hands that lift and shake a load disagree: the way from one contact to the other against that at the beginning of an epoch.";
    vec![Section::new("Learning together", note, blocks)]
}

fn table(epochs: &Value) -> Table {
    let titles = [
        "#Begins",
        "#Distance error",
        "#Discrete part",
        "#Periods",
        "#Force error",
        "#Largest squeeze",
        "#Tilt",
        "#Slipped",
    ];
    table_of(epochs, &titles, |epoch| {
        vec![
            cell(epoch, ("from_s", 1.0), "s", 1),
            cell(epoch, ("distance_rms_m", 1e3), "mm", 2),
            cell(epoch, ("discrete_rms_m", 1e3), "mm", 2),
            cell(epoch, ("periods_rms_m", 1e3), "mm", 2),
            cell(epoch, ("force_rms_n", 1.0), "N", 2),
            cell(epoch, ("internal_most_n", 1.0), "N", 1),
            cell(epoch, ("tilt_deg", 1.0), "°", 1),
            cell(epoch, ("slipped_m", 1e3), "mm", 1),
        ]
    })
}

fn heights(run: &JudgedRun<'_>, title: &str, epoch: &Epoch) -> TimePlot {
    let all = between(run, epoch.from, epoch.to);
    let drawn = || all.iter().step_by(STRIDE);
    let height = |hand: usize| {
        let begin = all.first().map_or(0.0, |(_, load, _)| load.hands[hand].at.z);
        drawn().map(|(_, load, _)| 1e3 * (load.hands[hand].at.z - begin)).collect()
    };
    let t_s = || drawn().map(|(at, ..)| seconds(*at)).collect::<Vec<_>>();
    let series = |label: &str, y| Series { label: label.into(), t_s: t_s(), y };
    TimePlot {
        title: title.into(),
        y_label: "Height over the beginning, mm".into(),
        series: vec![series("first hand", height(0)), series("second hand", height(1))],
        marks: vec![(seconds(epoch.periods), "periods".into())],
        ..TimePlot::default()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3};

    use super::*;
    use crate::physics::{PressedLoad, PressingHand};
    use crate::referee::TruthLog;
    use crate::world::{BodySpec, World};

    /// Epochs of two seconds, half of each for its discrete part, in which the second hand is `off` m higher than the first, once
    /// an epoch has begun.
    fn figures(off: &[f64], before: u32) -> Value {
        let load = BodySpec { name: "box".into(), mass: 1.0, ..BodySpec::default() };
        let world = World { objects: Vec::new(), bodies: vec![load], ..World::ideal() };
        let (mut log, mut marks) = (TruthLog::default(), Vec::new());
        for (k, off) in off.iter().enumerate() {
            let begin = 3000 * k as u64;
            for ms in begin..begin + 2000 {
                let higher = if ms > begin { *off } else { 0.0 };
                let hand = |x: f64, z: f64| PressingHand {
                    at: Point3::new(0.2 * x, 0.5, z),
                    force: Vector3::new(-25.0 * x, 0.0, 5.0),
                    slipping: 0,
                };
                let hands = [hand(1.0, 1.0), hand(-1.0, 1.0 + higher)];
                // The load is carried in the middle between both hands.
                let pose = Isometry3::translation(0.0, 0.5, 1.0 + higher / 2.0);
                log.pressed.push((
                    ms * 1_000_000,
                    PressedLoad { body: 0, hands, borne_n: 0.0, gripped: false },
                    pose,
                ));
            }
            let at = |ms: u64| (begin + ms) * 1_000_000;
            marks.push((at(0), Milestone::EpochStarted));
            marks.push((at(1000), Milestone::PeriodsStarted));
            marks.push((at(2000), Milestone::EpochEnded));
        }
        // One that was disturbed does not count.
        marks.push((100_000_000_000, Milestone::EpochStarted));
        marks.push((101_000_000_000, Milestone::LearnedTogether { before }));
        measure(&JudgedRun::new(&world, &log, &marks, &[])).unwrap()
    }

    fn missed(own: &Value) -> Vec<String> {
        asks(own)
            .into_iter()
            .filter(|figure| figure.passed() == Some(false))
            .map(|figure| figure.name)
            .collect()
    }

    #[test]
    fn an_error_that_falls_tenfold_passes() {
        let own = figures(&[0.02, 0.015, 0.01, 0.008, 0.006, 0.004, 0.003, 0.002, 0.0015, 0.001], 0);
        assert_eq!(things(&own["epochs"]).len(), 10);
        assert!((own["distance_fell"].as_f64().unwrap() - 20.0).abs() < 0.1, "{own}");
        assert!((own["first_rms_m"].as_f64().unwrap() - 0.02).abs() < 1e-4);
        assert_eq!(missed(&own), Vec::<String>::new());
    }

    #[test]
    fn one_that_does_not_fall_is_found_and_so_is_a_day_that_begins_anew() {
        let own = figures(&[0.02; 10], 0);
        assert_eq!(missed(&own), ["it fell by", "in the discrete part by", "in the periods by"]);
        assert_eq!(missed(&figures(&[0.02, 0.01], 10)), ["distance error, first epoch"]);
        assert_eq!(missed(&figures(&[0.001, 0.001], 10)), Vec::<String>::new());
    }
}
