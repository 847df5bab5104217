//! The probe `gestures`: how often vision recognised the coach's gestures correctly.

use std::collections::{BTreeMap, BTreeSet};

use armarium_values::report::Requirement::AtLeast;
use armarium_values::report::{Block, Confusion, Section};
use serde::Serialize;
use serde_json::Value;

use super::probes::{Probe, figure};
use super::run::JudgedRun;
use crate::truth::FrameTruth;
use crate::world::Gesture;

/// How long a gesture (or no hand) must have lasted before a frame counts, s.
const STEADY_S: f64 = 0.3;

pub(super) const PROBE: Probe = Probe {
    name: "gestures",
    measure: |run| serde_json::to_value(gestures(run)?).ok(),
    asks: |own: &Value| vec![figure(("Gestures", "right"), own, ("accuracy", 1e2), ("%", 1), AtLeast(90.0))],
    section: |_, own| {
        let note = "Camera frames by the gesture that was shown and the one that was seen.";
        vec![Section::new("Gestures", note, vec![Block::Confusion(confusion(own))])]
    },
};

/// How often gestures were recognised correctly.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct GestureFigures {
    /// Number of frames that count: with a hand, and as many without.
    frames: usize,
    /// Share of them that was recognised correctly.
    accuracy: f64,
    /// Recognised gestures, by the gesture that was shown; `none` is no hand.
    confusion: BTreeMap<String, BTreeMap<String, u32>>,
}

/// All frames between the first and the last that vision processed. A skipped frame counts as nothing recognised.
fn gestures(run: &JudgedRun<'_>) -> Option<GestureFigures> {
    let JudgedRun { log, seen: answers, .. } = run;
    let (first, _) = answers.first_key_value()?;
    let (last, _) = answers.last_key_value()?;
    let looked_at = log.frames.iter().filter(|f| (*first..=*last).contains(&f.stamp_ns));
    let steady = looked_at.filter(|f| f.since_s >= STEADY_S);
    let (with, without): (Vec<&FrameTruth>, Vec<&FrameTruth>) = steady.partition(|f| f.gesture.is_some());
    let with: Vec<_> = with.into_iter().filter(|f| f.visible).collect();
    let some = with.len().min(without.len());
    let spread = (0..some).map(|i| without[i * without.len() / some]);
    let mut figures = GestureFigures::default();
    let mut right = 0usize;
    for frame in with.iter().copied().chain(spread) {
        let shown = frame.gesture.map_or("none", Gesture::name);
        let answer = answers.get(&frame.stamp_ns).copied().flatten().unwrap_or("none");
        right += usize::from(shown == answer);
        figures.frames += 1;
        *figures.confusion.entry(shown.into()).or_default().entry(answer.into()).or_default() += 1;
    }
    (figures.frames > 0).then(|| {
        figures.accuracy = right as f64 / figures.frames as f64;
        figures
    })
}

/// The confusion matrix of the gestures; no hand comes last.
fn confusion(own: &Value) -> Confusion {
    let counted: BTreeMap<String, BTreeMap<String, u32>> =
        serde_json::from_value(own["confusion"].clone()).unwrap_or_default();
    let order = |name: &String| (name == "none", name.clone());
    let names: BTreeSet<(bool, String)> =
        counted.keys().chain(counted.values().flat_map(|row| row.keys())).map(order).collect();
    let names: Vec<String> = names.into_iter().map(|(_, name)| name).collect();
    let row = |shown: &String| {
        let row = counted.get(shown)?;
        let counts = names.iter().map(|seen| row.get(seen).copied().unwrap_or(0)).collect();
        Some((shown.clone(), counts))
    };
    Confusion { rows: names.iter().filter_map(row).collect(), names: names.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::referee::TruthLog;
    use crate::world::World;

    #[test]
    fn gestures_are_counted_with_as_many_frames_without() {
        let (world, mut log) = (World::default(), TruthLog::default());
        let mut seen = Vec::new();
        for i in 0..100u64 {
            let gesture = (i >= 80).then_some(Gesture::Fist);
            log.frames.push(FrameTruth {
                stamp_ns: i,
                gesture,
                since_s: 1.0,
                visible: true,
                root_from_left: nalgebra::Isometry3::identity(),
            });
            seen.push((i, (i >= 85).then(|| "fist".to_owned())));
        }
        let figures = gestures(&JudgedRun::new(&world, &log, &[], &seen)).unwrap();
        assert_eq!(figures.frames, 40);
        assert!((figures.accuracy - 35.0 / 40.0).abs() < 1e-12);
        assert_eq!(figures.confusion["fist"]["none"], 5);
    }
}
