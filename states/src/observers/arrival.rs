//! Finds the phase of the running motion at which the coach's hand came to rest. A coach times his hand to the pass
//! that he wants to change: where two passes lie side by side, the time distinguishes them and the place does not.

use nalgebra::Vector3;

use crate::arm::seconds;

/// Time constant over which the jitter of the tracked hand is smoothed, s.
const SMOOTHING: f64 = 0.2;
/// The hand is moving when it is this far from its smoothed position, m.
const MIN_MOTION: f64 = 0.02;
/// How long a hand must rest before it has arrived, s.
const REST_TIME: f64 = 0.3;
/// A hand that is this far from its resting place, m, for [`ELSEWHERE_TIMES`], has moved to another place.
const ELSEWHERE: f64 = 0.06;
/// See [`ELSEWHERE`]: the least time, s, and the least share of the motion's period. The robot's arm hides a part
/// of the hand for a shorter time as it passes.
const ELSEWHERE_TIMES: (f64, f64) = (1.0, 0.4);
/// A hand that has not been seen for this long is gone, s.
const GONE_AFTER: f64 = 1.5;

/// Tracks one hand.
#[derive(Debug, Default)]
pub(super) struct Arrival {
    smooth: Option<Vector3<f64>>,
    /// When it was seen last, ns.
    seen_ns: u64,
    /// Where it was then, and the phase.
    seen: Option<(Vector3<f64>, Option<f64>)>,
    /// Whether the hand has been seen moving. If it was at rest when first seen, its time of arrival is unknown.
    moved: bool,
    /// Since when it is seen at rest (ns), and the phase at which it came to rest: that at that time, or where it was hidden before and
    /// is still in its place, that at which it was seen last.
    stands: Option<(u64, Option<f64>)>,
    /// The place where it has arrived, and the phase at that time.
    place: Option<(Vector3<f64>, Option<f64>)>,
    /// Since when it is away from `place`, ns.
    elsewhere: Option<u64>,
}

impl Arrival {
    /// Processes a frame of time `stamp_ns` with the palm at `palm` (root frame, m), at the motion's phase (rad)
    /// and frequency (Hz). Returns the phase at which the hand arrived at its present place, if its arrival was
    /// seen.
    pub(super) fn update(
        &mut self,
        stamp_ns: u64,
        palm: Option<Vector3<f64>>,
        motion: Option<(f64, f64)>,
    ) -> Option<f64> {
        let unseen = seconds(self.seen_ns, stamp_ns);
        let Some(palm) = palm else {
            if unseen > GONE_AFTER {
                *self = Self { seen_ns: self.seen_ns, ..Self::default() };
            }
            return self.came();
        };
        if unseen > GONE_AFTER {
            *self = Self::default();
        }
        let phase = motion.map(|(phase, _)| phase);
        let before = self.seen.replace((palm, phase)).filter(|_| unseen > SMOOTHING);
        let before = before.filter(|(last, _)| (palm - last).norm() < MIN_MOTION);
        let from = (stamp_ns, before.map_or(phase, |(_, phase)| phase));
        self.seen_ns = stamp_ns;
        let share = 1.0 - libm::exp(-unseen / SMOOTHING);
        let smooth = self.smooth.map_or(palm, |old| old + (palm - old) * share);
        self.smooth = Some(smooth);
        let period = motion.map_or(0.0, |(_, frequency)| 1.0 / frequency.max(0.05));
        self.leave(stamp_ns, &smooth, ELSEWHERE_TIMES.0.max(ELSEWHERE_TIMES.1 * period));
        self.stand(stamp_ns, (palm - smooth).norm() > MIN_MOTION, from);
        self.came()
    }

    fn came(&self) -> Option<f64> {
        self.place.and_then(|(_, phase)| phase)
    }

    /// Clears the place when the hand has been elsewhere for `patience` s.
    fn leave(&mut self, now: u64, at: &Vector3<f64>, patience: f64) {
        let Some((place, _)) = self.place else { return };
        if (at - place).norm() < ELSEWHERE {
            self.elsewhere = None;
            return;
        }
        let since = *self.elsewhere.get_or_insert(now);
        if seconds(since, now) > patience {
            (self.place, self.elsewhere, self.moved) = (None, None, true);
        }
    }

    /// If it rests and did not before, `from` says since when that is seen (ns), and the phase at which it came to rest.
    fn stand(&mut self, now: u64, moves: bool, from: (u64, Option<f64>)) {
        if moves {
            (self.stands, self.moved) = (None, true);
            return;
        }
        let (since, then) = *self.stands.get_or_insert(from);
        if let (None, Some(at)) = (self.place, self.smooth)
            && seconds(since, now) >= REST_TIME
        {
            self.place = Some((at, then.filter(|_| self.moved)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames at 15 Hz of a hand at `x(t)` m while the phase is `2 t`. Returns the result after each frame.
    fn watch(seconds: f64, x: impl Fn(f64) -> Option<f64>) -> Vec<Option<f64>> {
        let mut arrival = Arrival::default();
        let frames = 0..(seconds * 15.0) as u64;
        frames
            .map(|k| {
                let t = k as f64 / 15.0;
                let palm = x(t).map(|x| Vector3::new(x, 0.0, 0.0));
                arrival.update((t * 1e9) as u64, palm, Some((2.0 * t, 1.0 / std::f64::consts::PI)))
            })
            .collect()
    }

    /// The hand is 0.35 m away at first, and in place 1 s later.
    fn coming(t: f64) -> f64 {
        let s = t.clamp(0.0, 1.0);
        0.35 * (1.0 - s * s * s * (10.0 + s * (6.0 * s - 15.0)))
    }

    #[test]
    fn a_hand_came_when_it_stopped() {
        let came = watch(4.0, |t| Some(coming(t)));
        assert_eq!(came[10], None, "still on its way");
        let came = came[40].unwrap();
        assert!((came - 2.0).abs() < 0.4, "{came}");
    }

    #[test]
    fn what_hides_it_in_passing_changes_nothing_and_going_elsewhere_does() {
        let hidden = |t: f64| {
            (!(3.0..3.4).contains(&t)).then(|| coming(t) + if t > 3.4 && t < 3.9 { 0.1 } else { 0.0 })
        };
        let came = watch(8.0, hidden);
        assert_eq!(came[40], came[110]);
        let again = watch(8.0, |t| Some(coming(t) + 0.35 - coming(t - 4.0)));
        assert!((again[115].unwrap() - 10.0).abs() < 2.5, "{again:?}");
    }

    #[test]
    fn a_hand_that_is_hidden_as_soon_as_it_stops_came_then_and_not_when_it_is_seen_again() {
        let came = watch(4.0, |t| (!(0.95..1.8).contains(&t)).then(|| coming(t)));
        let came = came.last().unwrap().unwrap();
        assert!((came - 2.0).abs() < 0.4, "{came}");
    }

    #[test]
    fn a_hand_that_passes_a_place_where_it_was_hidden_has_not_come_there() {
        let passes = |t: f64| {
            if t < 0.6 { Some(coming(t)) } else { (t > 1.2).then(|| coming(0.6) - 0.6 * (t - 1.2)) }
        };
        assert!(watch(1.8, passes).iter().all(Option::is_none));
    }

    #[test]
    fn a_hand_that_was_there_from_the_first_came_nobody_knows_when() {
        assert!(watch(3.0, |_| Some(0.1)).iter().all(Option::is_none));
        assert!(watch(6.0, |t| (t < 3.0).then(|| coming(t))).last().unwrap().is_none(), "gone");
    }
}
