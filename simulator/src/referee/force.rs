//! The probe `force`: the normal force between the object in the hand and the table, over the first five cycles after
//! adaptation.

use armarium_values::report::Requirement::{AtMost, Shown};
use armarium_values::report::{Band, Block, Figure, Section, Series, TimePlot};
use serde::Serialize;
use serde_json::Value;

use super::Milestone;
use super::paths::{positions, repeat_period};
use super::probes::{Probe, figure};
use super::run::{JudgedRun, name, seconds};
use crate::coach::EventKind;

pub(super) const PROBE: Probe = Probe {
    name: "force",
    measure: |run| serde_json::to_value(force(run)?).ok(),
    asks,
    section: |run, _| {
        let plot = plot(run);
        let title = plot.as_ref().map_or(String::new(), |plot| plot.title.clone());
        vec![Section::new(&title, "", plot.map(Block::Plot).into_iter().collect())]
    },
};

/// Contact counts as lost below this normal force, mN. What a recording does not keep decides nothing: the figures computed from it are the same.
const LOST_MN: f64 = 200.0;
/// Window after the first touch in which its peak is searched, s.
const TOUCHDOWN_S: f64 = 0.5;
/// Number of cycles over which the force is judged.
const FORCE_CYCLES: f64 = 5.0;

/// The normal force between the object in the hand and the table over the first 5 cycles after adaptation.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ForceFigures {
    /// The desired force, N.
    desired_n: f64,
    /// Its mean, N.
    mean_n: f64,
    /// RMS difference from the desired force, N.
    rms_error_n: f64,
    /// Its maximum, N.
    max_n: f64,
    /// Total time under 0.2 N, s.
    contact_lost_s: f64,
    /// Its maximum in the half second after the first touch, N.
    touchdown_max_n: f64,
    /// Cycles spent adapting.
    cycles: u32,
}

fn asks(own: &Value) -> Vec<Figure> {
    let of = |name, key, unit, requirement| figure(("Force", name), own, key, unit, requirement);
    // The RMS error: at most 1 N at 8 N, and an eighth of the desired force above that.
    let desired = own.get("desired_n").and_then(Value::as_f64).unwrap_or(8.0);
    vec![
        of("mean", ("mean_n", 1.0), ("N", 2), Shown),
        of("error, RMS", ("rms_error_n", 1.0), ("N", 2), AtMost((desired / 8.0).max(1.0))),
        of("cycles of adaptation", ("cycles", 1.0), ("", 0), Shown),
        of("largest", ("max_n", 1.0), ("N", 1), Shown),
        of("contact lost", ("contact_lost_s", 1.0), ("s", 3), AtMost(0.0)),
        of("largest at touchdown", ("touchdown_max_n", 1.0), ("N", 1), AtMost(25.0)),
    ]
}

/// Five periods of the executed motion from the end of adaptation, or fewer if the coach acts before.
fn force(run: &JudgedRun<'_>) -> Option<ForceFigures> {
    let (ended, mark) = run.marked(|m| matches!(m, Milestone::AdaptationEnded { .. }))?;
    let Milestone::AdaptationEnded { desired_n, cycles } = mark else { return None };
    let until = run.coaching_ns().max(ended);
    let after = run.log.between(ended, until);
    let period_s = repeat_period(&positions(&after[..after.len().min(15_000)]))?;
    let count = ((FORCE_CYCLES * period_s * 1e3).round() as usize).min(after.len());
    let forces: Vec<f64> = after[..count].iter().map(|r| r.normal).collect();
    let n = forces.len() as f64;
    let squares: f64 = forces.iter().map(|f| (f - desired_n).powi(2)).sum();
    Some(ForceFigures {
        desired_n,
        mean_n: forces.iter().sum::<f64>() / n,
        rms_error_n: (squares / n).sqrt(),
        max_n: forces.iter().copied().fold(0.0, f64::max),
        contact_lost_s: forces.iter().filter(|f| millinewtons(**f) < LOST_MN).count() as f64 * 1e-3,
        touchdown_max_n: touchdown(run, ended),
        cycles,
    })
}

/// A force, N, as a recording keeps it: mN.
fn millinewtons(force: f64) -> f64 {
    (force * 1e3).round()
}

fn touchdown(run: &JudgedRun<'_>, ended: u64) -> f64 {
    let started = run.time_of(|m| *m == Milestone::AdaptationStarted).unwrap_or(0);
    let adapting = run.log.between(started.min(ended), ended);
    let touched = adapting.iter().position(|r| millinewtons(r.normal) > LOST_MN).unwrap_or(adapting.len());
    adapting[touched..].iter().take((TOUCHDOWN_S * 1e3) as usize).map(|r| r.normal).fold(0.0, f64::max)
}

/// The true contact force from touchdown on, and the times at which the coach acted.
fn plot(run: &JudgedRun<'_>) -> Option<TimePlot> {
    let from = run.time_of(|m| *m == Milestone::AdaptationStarted)?;
    let adapted = run.marked(|m| matches!(m, Milestone::AdaptationEnded { .. }));
    let wanted = adapted.and_then(|(t, mark)| match mark {
        Milestone::AdaptationEnded { desired_n, .. } => Some((t, desired_n)),
        _ => None,
    });
    let records = run.log.between(from, u64::MAX);
    let adapted = wanted.map(|(t, _)| (seconds(t), "adapted".to_owned()));
    let came = run.actions(EventKind::Began).map(|e| (e.t, name(e)));
    Some(TimePlot {
        title: "Force between tool and table".into(),
        y_label: "Normal force, N".into(),
        series: vec![Series {
            label: "true normal force".into(),
            t_s: records.iter().map(|r| seconds(r.stamp_ns)).collect(),
            y: records.iter().map(|r| r.normal).collect(),
        }],
        band: wanted.map(|(t, value)| Band {
            value,
            tolerance: 1.0,
            label: "desired, within 1 N".into(),
            from_s: Some(seconds(t)),
            to_s: None,
        }),
        marks: adapted.into_iter().chain(came).collect(),
        ..TimePlot::default()
    })
}
