//! How often vision recognised the coach's gestures correctly.

use std::collections::BTreeMap;

use super::log::TruthLog;
use super::report::GestureFigures;
use crate::truth::FrameTruth;
use crate::world::Gesture;

/// How long a gesture (or no hand) must have lasted before a frame counts, s.
const STEADY_S: f64 = 0.3;

/// All frames between the first and the last that vision processed. A skipped frame counts as nothing recognised.
pub(super) fn gestures(log: &TruthLog, seen: &[(u64, Option<String>)]) -> Option<GestureFigures> {
    let answers: BTreeMap<u64, Option<&str>> = seen.iter().map(|(t, l)| (*t, l.as_deref())).collect();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gestures_are_counted_with_as_many_frames_without() {
        let mut log = TruthLog::default();
        let mut seen = Vec::new();
        for i in 0..100u64 {
            let gesture = (i >= 80).then_some(Gesture::Fist);
            log.frames.push(FrameTruth { stamp_ns: i, gesture, since_s: 1.0, visible: true });
            seen.push((i, (i >= 85).then(|| "fist".to_owned())));
        }
        let figures = gestures(&log, &seen).unwrap();
        assert_eq!(figures.frames, 40);
        assert!((figures.accuracy - 35.0 / 40.0).abs() < 1e-12);
        assert_eq!(figures.confusion["fist"]["none"], 5);
    }
}
