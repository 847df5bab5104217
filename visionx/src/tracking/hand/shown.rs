//! What a person shows with a hand, over time: the gesture that was clearly visible for longest in the last seconds, since when,
//! and where the hand was when it last showed it clearly.
//!
//! The robot's own arm passes between its cameras and the hand in each cycle and hides a part of it. What is read of the visible
//! rest is often wrong and gets little weight. This is the only place that decides when a gesture begins and ends.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};

use super::{Gesture, HandObservation};

/// How long a gesture must be visible before it counts as shown, and how long a hand must be out of sight before it shows
/// nothing any more, s.
const MIN_VISIBLE: f64 = 0.4;
/// The time constant of the decay, s, and the largest accumulated time, s. A change of the gesture counts after 1.5 s.
const DECAY: f64 = 4.0;
const MAX_ACCUMULATED: f64 = 2.0;
/// The least confidence of a gesture that counts, as a probability.
const MIN_CONFIDENCE: f64 = 0.6;
/// The weight of a partly hidden hand, relative to a fully visible one.
const HIDDEN_COUNTS: f64 = 0.1;
/// A hand that has not been seen for this long is gone, s.
const GONE_AFTER: f64 = 1.5;
/// Longest time that one frame stands for, s.
const LONGEST_FRAME: f64 = 0.3;

/// What a hand shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShownGesture {
    /// The gesture; `None` where none has been visible for long enough.
    pub gesture: Option<Gesture>,
    /// How long it has been shown, s.
    pub for_s: f64,
    /// The palm when it was last clear, root frame, m.
    pub palm: Option<Point3<f64>>,
    /// Where it pointed then, unit vector in the root frame.
    pub direction: Option<Vector3<f64>>,
    /// The palm when it was last seen at all, root frame, m; `None` when that is long ago.
    pub seen_at: Option<Point3<f64>>,
}

/// Follows what a hand shows from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct GestureOverTime {
    shown: ShownGesture,
    /// How long each gesture has been clearly visible, s; decays over time.
    visible: BTreeMap<Gesture, f64>,
    /// How long there has been no hand, s.
    gone: f64,
    last_ns: Option<u64>,
}

impl GestureOverTime {
    /// What is shown after a frame of the time `stamp_ns`, from a camera at `root_from_left`.
    pub fn update(
        &mut self,
        stamp_ns: u64,
        hand: Option<&HandObservation>,
        root_from_left: &Isometry3<f64>,
    ) -> &ShownGesture {
        let before = self.last_ns.replace(stamp_ns).unwrap_or(stamp_ns);
        let dt = (stamp_ns.saturating_sub(before) as f64 * 1e-9).min(LONGEST_FRAME);
        match hand {
            Some(hand) => self.see(dt, hand, root_from_left),
            None => {
                self.gone += dt;
                if self.gone >= MIN_VISIBLE {
                    let seen_at = self.shown.seen_at.filter(|_| self.gone < GONE_AFTER);
                    self.shown = ShownGesture { seen_at, ..ShownGesture::default() };
                    self.visible.clear();
                }
            }
        }
        if self.shown.gesture.is_some() {
            self.shown.for_s += dt;
        }
        &self.shown
    }

    fn see(&mut self, dt: f64, hand: &HandObservation, root_from_left: &Isometry3<f64>) {
        self.gone = 0.0;
        let hidden = hand.hidden >= HandObservation::HIDDEN;
        if hand.confidence >= MIN_CONFIDENCE {
            let counts = if hidden { HIDDEN_COUNTS } else { 1.0 };
            self.visible.values_mut().for_each(|time| *time *= 1.0 - counts * dt / DECAY);
            let time = self.visible.entry(hand.gesture).or_default();
            *time = (*time + counts * dt).min(MAX_ACCUMULATED);
            let longest = self.visible.iter().max_by(|a, b| a.1.total_cmp(b.1));
            if let Some((gesture, _)) = longest.filter(|(_, time)| **time >= MIN_VISIBLE)
                && self.shown.gesture != Some(*gesture)
            {
                (self.shown.gesture, self.shown.for_s) = (Some(*gesture), 0.0);
            }
        }
        let palm = root_from_left * hand.palm_in_left;
        self.shown.seen_at = Some(palm);
        if self.shown.gesture == Some(hand.gesture) && (!hidden || self.shown.palm.is_none()) {
            self.shown.palm = Some(palm);
            self.shown.direction = hand.pointing.map(|direction| root_from_left * direction);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::*;
    use crate::mask::Region;

    fn hand(gesture: Gesture, x: f64) -> HandObservation {
        HandObservation {
            gesture,
            confidence: 0.9,
            palm_in_left: Point3::new(x, 0.0, 0.0),
            palm_px: Point2::origin(),
            palm_radius_px: 20.0,
            pointing: None,
            fingertips: Vec::new(),
            hidden: 0.0,
            bounding_box: Region { x: 0, y: 0, width: 1, height: 1 },
        }
    }

    #[test]
    fn what_is_read_of_a_half_hidden_hand_changes_neither_gesture_nor_place() {
        let (mut over_time, mut now_ns) = (GestureOverTime::default(), 0);
        let mut after = |seconds: f64, hand: Option<HandObservation>| {
            for _ in 0..(seconds * 15.0).round() as u32 {
                now_ns += 66_666_667;
                over_time.update(now_ns, hand.as_ref(), &Isometry3::identity());
            }
            let shown = over_time.shown.clone();
            (shown.gesture, shown.palm.map(|palm| palm.x))
        };
        let (fist, pair) = (Gesture::Fist, Gesture::PointTwo);
        let shown = (Some(fist), Some(0.3));
        assert_eq!(after(0.3, Some(hand(fist, 0.3))), (None, None), "not yet");
        assert_eq!(after(0.3, Some(hand(fist, 0.3))), shown);
        assert_eq!(after(1.0, Some(hand(fist, 0.3))), shown);
        assert_eq!(after(1.0, Some(hand(pair, 0.2))), shown, "half hidden by the robot's arm");
        assert_eq!(after(1.0, Some(hand(fist, 0.3))), shown);
        assert_eq!(after(0.2, None), shown, "hidden for some frames");
        let doubtful = HandObservation { confidence: 0.5, ..hand(pair, 0.2) };
        assert_eq!(after(3.0, Some(doubtful)), shown, "doubtful");
        let hidden = HandObservation { hidden: 0.2, ..hand(pair, 0.2) };
        assert_eq!(after(3.0, Some(hidden)), shown, "hidden for long");
        assert_eq!(after(2.5, Some(hand(pair, 0.2))), (Some(pair), Some(0.2)), "changed");
        assert_eq!(after(0.6, None), (None, None), "gone");
        assert!(over_time.shown.seen_at.is_some(), "but where it was is known for a while");
        for _ in 0..20 {
            now_ns += 66_666_667;
            over_time.update(now_ns, None, &Isometry3::identity());
        }
        assert_eq!(over_time.shown, ShownGesture::default());
    }
}
