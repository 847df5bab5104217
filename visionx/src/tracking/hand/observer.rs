//! From frames to a hand: what each frame alone says of it (`silhouette`, `by_landmarks`), joined over time.

use nalgebra::{Point3, Vector3};

use super::by_landmarks::HandsByLandmarks;
use super::measured::MeasuredHand;
use super::silhouette::HandSilhouettes;
use super::{Gesture, HandObservation};
use crate::camera::StereoCalibration;
use crate::frame::StereoFrame;

/// How hands are found in frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HandDetection {
    /// By silhouettes: what stands out by depth or has the colour of skin.
    #[default]
    Skin,
    /// By networks that were trained on photographs of hands.
    Learned,
}

impl HandDetection {
    /// Its name on the command line and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Skin => "skin",
            Self::Learned => "learned",
        }
    }

    /// An observer of the frames of these cameras.
    #[must_use]
    pub fn observer(self, calibration: StereoCalibration) -> HandObserver {
        match self {
            Self::Skin => HandObserver::new(calibration),
            Self::Learned => HandObserver { calibration, by: By::Landmarks(Box::default()), memory: None },
        }
    }
}

/// Finds a hand and its gesture in a stream of frames.
#[derive(Clone, Debug)]
pub struct HandObserver {
    calibration: StereoCalibration,
    by: By,
    memory: Option<LastHand>,
}

/// How a hand is measured in one frame.
#[derive(Clone, Debug)]
enum By {
    Silhouettes(Box<HandSilhouettes>),
    Landmarks(Box<HandsByLandmarks>),
}

impl By {
    /// Forgets what is known from earlier frames.
    fn forget(&mut self) {
        match self {
            Self::Silhouettes(by) => by.forget(),
            Self::Landmarks(by) => by.forget(),
        }
    }
}

/// The state kept from the last frames.
#[derive(Clone, Debug)]
struct LastHand {
    stamp_ns: u64,
    /// Probability of each gesture.
    belief: [f64; 4],
    /// The pointing direction in the root frame.
    pointing: Option<Vector3<f64>>,
    /// The palm when the hand was last fully visible.
    palm: Option<Palm>,
    lone: LoneFinger,
}

/// Where a finger that is the only one has pointed in the last frames. One that points elsewhere each time is none, but an edge of
/// a fist, now this one and now that.
#[derive(Clone, Copy, Debug, Default)]
struct LoneFinger {
    /// The number of frames that had one, and the sum of its directions in the root frame; both decay.
    frames: f64,
    directions: Vector3<f64>,
}

impl LoneFinger {
    fn decay(&mut self) {
        self.frames *= 1.0 - FADES;
        self.directions *= 1.0 - FADES;
    }

    fn add(&mut self, direction: &Vector3<f64>) {
        self.decay();
        self.frames += 1.0;
        self.directions += direction;
    }

    /// From 1, when all directions are one, to 0, when they are as far apart as two that stand 120 degrees to each other.
    fn agreement(&self) -> f64 {
        if self.frames > 0.0 {
            (2.0 * self.directions.norm() / self.frames - 1.0).clamp(0.0, 1.0)
        } else {
            1.0
        }
    }
}

/// The palm of a fully visible hand.
#[derive(Clone, Copy, Debug)]
struct Palm {
    in_root: Point3<f64>,
    stamp_ns: u64,
    /// Whether it had not moved since the frame before.
    stands: bool,
}

/// Probability that a gesture continues in the next frame. With [`MIN_LIKELIHOOD`], a change takes two clear frames.
const P_STAY: f64 = 0.94;
/// Least likelihood of a gesture in one frame.
const MIN_LIKELIHOOD: f64 = 0.04;
/// Weight of a frame with a hidden hand for the gesture, relative to a fully visible one. Not zero, so that a hand
/// that is never fully visible still gets a gesture after some time.
const HIDDEN_COUNTS: f64 = 0.03;
/// The share that a frame's finger loses of its weight with each frame that comes after it.
const FADES: f64 = 0.02;
/// Place of [`Gesture::PointOne`] in [`Gesture::ALL`].
const POINT_ONE: usize = 2;
/// A hidden hand that did not move keeps its palm for this long, ns, unless the visible rest is farther away than
/// this, m.
const SAME_PLACE: (u64, f64) = (1_200_000_000, 0.12);
/// A palm that moved less than this since the frame before counts as still, m.
const STANDS: f64 = 0.012;
/// After this long without a hand the earlier state is discarded, ns.
const FORGET_AFTER_NS: u64 = 400_000_000;

impl HandObserver {
    /// An observer without earlier frames, by silhouettes: what stands out by depth or has the colour of skin.
    pub fn new(calibration: StereoCalibration) -> Self {
        Self { calibration, by: By::Silhouettes(Box::new(HandSilhouettes::new())), memory: None }
    }

    /// The same for scenes where the hand may come so near, to about 0.3 m, that it hides much of the rest. The hand
    /// must then be the nearest object. Networks know no such scenes.
    #[must_use]
    pub fn with_near_hands(mut self) -> Self {
        if let By::Silhouettes(silhouettes) = &mut self.by {
            silhouettes.near = true;
        }
        self
    }

    /// Processes a frame; returns the hand in it, `None` when there is none or when the images do not have
    /// the calibration's size.
    pub fn update(&mut self, frame: &StereoFrame) -> Option<HandObservation> {
        if !self.calibration.fits(frame) {
            return None;
        }
        let forgotten =
            |m: &LastHand| frame.stamp_ns < m.stamp_ns || frame.stamp_ns - m.stamp_ns > FORGET_AFTER_NS;
        if self.memory.as_ref().is_some_and(forgotten) {
            self.memory = None;
            self.by.forget();
        }
        let measured = match &mut self.by {
            By::Silhouettes(by) => by.measure(frame, &self.calibration),
            By::Landmarks(by) => by.measure(frame, &self.calibration),
        };
        self.follow(frame, measured?)
    }

    /// Joins what was measured with what is known from the frames before.
    fn follow(&mut self, frame: &StereoFrame, measured: MeasuredHand) -> Option<HandObservation> {
        let MeasuredHand { palm: seen_palm, hidden, direction, fingertips, .. } = measured;
        let whole = hidden < HandObservation::HIDDEN;
        let palm = self.palm(frame.root_from_left * seen_palm, whole, frame.stamp_ns);
        let palm_in_left =
            palm.map_or(seen_palm, |p| frame.root_from_left.inverse_transform_point(&p.in_root));

        let mut lone = self.memory.as_ref().map_or_else(LoneFinger::default, |memory| memory.lone);
        if let Some((direction, 1)) = direction {
            lone.add(&(frame.root_from_left * direction));
        } else if whole {
            lone.decay();
        }
        let mut likelihoods = measured.likelihoods;
        likelihoods[POINT_ONE] *= lone.agreement();
        let belief = self.update_belief(&likelihoods, if whole { 1.0 } else { HIDDEN_COUNTS });
        let best = (0..4).max_by(|&a, &b| belief[a].total_cmp(&belief[b]))?;
        let gesture = Gesture::ALL[best];
        let fits =
            |fingers: usize| matches!((gesture, fingers), (Gesture::PointOne, 1) | (Gesture::PointTwo, 2));
        let direction = direction.filter(|(_, fingers)| fits(*fingers)).map(|(direction, _)| direction);
        let points = matches!(gesture, Gesture::PointOne | Gesture::PointTwo);
        let pointing = self.smooth(direction, points, frame);
        self.memory = Some(LastHand {
            stamp_ns: frame.stamp_ns,
            belief,
            pointing: pointing.map(|p| frame.root_from_left * p),
            palm,
            lone,
        });
        Some(HandObservation {
            gesture,
            confidence: belief[best],
            palm_in_left,
            palm_px: measured.palm_px,
            palm_radius_px: measured.palm_radius_px,
            pointing,
            fingertips,
            hidden,
            bounding_box: measured.bounds,
        })
    }

    /// The palm: as `seen` (root frame, m) when the hand is fully visible, as shortly before when a part is hidden.
    fn palm(&self, seen: Point3<f64>, whole: bool, stamp_ns: u64) -> Option<Palm> {
        let before = self.memory.as_ref().and_then(|m| m.palm);
        let near = |p: &Palm, reach: f64| (p.in_root - seen).norm() < reach;
        if whole {
            let stands = before.is_some_and(|p| near(&p, STANDS));
            return Some(Palm { in_root: seen, stamp_ns, stands });
        }
        let (patience, reach) = SAME_PLACE;
        before.filter(|p| p.stands && near(p, reach) && stamp_ns.saturating_sub(p.stamp_ns) < patience)
    }

    /// The gestures' probabilities after one more frame with the weight `counts` (0 to 1): a hidden Markov
    /// model.
    fn update_belief(&self, likelihoods: &[f64; 4], counts: f64) -> [f64; 4] {
        let before = self.memory.as_ref().map_or([0.25; 4], |m| m.belief);
        let change = (1.0 - P_STAY) * counts;
        let mut belief = [0.0; 4];
        for i in 0..4 {
            let predicted = before[i] * (1.0 - change) + (1.0 - before[i]) * change / 3.0;
            belief[i] = predicted * libm::pow(likelihoods[i] + MIN_LIKELIHOOD, counts);
        }
        let sum: f64 = belief.iter().sum();
        belief.map(|b| b / sum)
    }

    /// Low-pass filters the direction; keeps the last one while the hand goes on pointing.
    fn smooth(&self, now: Option<Vector3<f64>>, points: bool, frame: &StereoFrame) -> Option<Vector3<f64>> {
        let before =
            self.memory.as_ref().and_then(|m| m.pointing).map(|p| frame.root_from_left.inverse() * p);
        match (now, before) {
            _ if !points => None,
            (Some(now), Some(before)) if now.dot(&before) > 0.5 => (now + before).try_normalize(1e-9),
            (Some(now), _) => Some(now),
            (None, before) => before,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::DepthImage;
    use crate::scenes::{
        CALIBRATION, SKIN, TABLE, Thing, empty_frames, frame, frame_with_depth, hand, root_from_left, table,
    };
    use nalgebra::Isometry3;
    use std::sync::Arc;

    const PLACE: Point3<f64> = Point3::new(0.02, -0.02, 0.7);

    fn scene(gesture: Gesture, roll: f64, back: bool, tilt: f64) -> (Vec<Thing>, Vector3<f64>) {
        let (mut things, direction) = hand(gesture, PLACE, roll, back, tilt);
        things.push(table(TABLE));
        (things, direction)
    }

    /// What is seen in a single frame.
    fn look(frame: &StereoFrame) -> Option<HandObservation> {
        HandObserver::new(CALIBRATION).update(frame)
    }

    #[test]
    fn knows_the_gestures_from_both_sides() {
        for gesture in Gesture::ALL {
            for (i, (roll, back, tilt)) in
                [(-1.6, true, 0.0), (0.2, false, 0.3), (2.9, true, -0.3)].into_iter().enumerate()
            {
                let (things, _) = scene(gesture, roll, back, tilt);
                let seen = look(&frame(&things, 0, i as u64)).unwrap();
                assert_eq!(seen.gesture, gesture, "roll {roll} back {back} tilt {tilt}: {seen:?}");
                assert!((seen.palm_in_left - PLACE).norm() < 0.04, "{:?}", seen.palm_in_left);
            }
        }
    }

    #[test]
    fn the_tables_colour_does_not_matter_where_there_is_depth() {
        for color in [SKIN, [120, 84, 60], [150, 112, 90], [225, 190, 150]] {
            for (i, gesture) in Gesture::ALL.into_iter().enumerate() {
                let (mut things, _) = hand(gesture, PLACE, 0.2, i % 2 == 0, 0.2);
                things.push(table(color));
                let seen = look(&frame_with_depth(&things, 0, 1)).unwrap();
                assert_eq!(seen.gesture, gesture, "{color:?}: {seen:?}");
                assert!((seen.palm_in_left - PLACE).norm() < 0.03, "{:?}", seen.palm_in_left);
            }
            assert_eq!(look(&frame_with_depth(&[table(color)], 0, 2)), None);
        }
    }

    #[test]
    fn a_patch_of_the_surface_around_is_no_hand() {
        let (things, _) = scene(Gesture::Fist, 0.2, false, 0.3);
        let mut flat = frame(&things, 0, 1);
        let (width, height) = (flat.left.width(), flat.left.height());
        assert!(look(&flat).is_some());
        let data = vec![0.7; (width * height) as usize];
        flat.depth = Some(Arc::new(DepthImage { width, height, data }));
        assert_eq!(look(&flat), None);
    }

    #[test]
    fn measures_where_a_finger_points() {
        for (roll, tilt) in [(-1.6, 0.0), (0.3, 0.3), (0.3, -0.3), (2.5, 0.2)] {
            let (things, direction) = scene(Gesture::PointOne, roll, true, tilt);
            let seen = look(&frame(&things, 0, 1)).unwrap();
            let angle = seen.pointing.unwrap().angle(&direction);
            assert!(angle < 0.2, "{angle} at roll {roll}, tilt {tilt}");
            let tip = seen.fingertips[0].in_left.unwrap();
            assert!((tip - PLACE).dot(&direction) > 0.1, "{tip}");
        }
    }

    #[test]
    fn what_is_left_of_a_hidden_hand_changes_neither_gesture_nor_place() {
        let (open, _) = scene(Gesture::PointTwo, 0.2, true, 0.1);
        // Something nearer hides the fingers; the visible rest of the hand looks like a fist.
        let fingers = root_from_left() * (PLACE + Vector3::new(0.055, 0.02, -0.10));
        let arm = Thing::Block {
            root_from_block: Isometry3::from_parts(fingers.coords.into(), root_from_left().rotation),
            size: Vector3::new(0.09, 0.30, 0.04),
            color: [60, 60, 70],
        };
        let covered: Vec<Thing> = open.iter().cloned().chain([arm]).collect();
        let mut observer = HandObserver::new(CALIBRATION);
        let at = |i: u64, things: &[Thing]| frame_with_depth(things, i * 66_000_000, i);
        let alone = look(&at(0, &covered)).unwrap();
        assert!(alone.confidence < 0.5, "{alone:?}");
        let whole = (0..4).filter_map(|i| observer.update(&at(i, &open))).last().unwrap();
        assert_eq!(whole.gesture, Gesture::PointTwo);
        for i in 4..14 {
            let seen = observer.update(&at(i, &covered)).unwrap();
            assert_eq!(seen.gesture, Gesture::PointTwo, "frame {i}");
            assert!((seen.palm_in_left - whole.palm_in_left).norm() < 1e-9, "frame {i}");
        }
    }

    #[test]
    fn a_finger_that_points_elsewhere_each_time_is_none() {
        let mut lone = LoneFinger::default();
        assert_eq!(lone.agreement(), 1.0);
        for frame in 0..100 {
            let (sin, cos) = libm::sincos(0.1 * f64::from(frame % 3));
            lone.add(&Vector3::new(cos, sin, 0.0));
        }
        assert!(lone.agreement() > 0.98, "it trembles: {}", lone.agreement());
        for frame in 0..100 {
            lone.add(&if frame % 20 < 10 { Vector3::x() } else { -Vector3::y() });
        }
        assert!(lone.agreement() < 0.6, "{}", lone.agreement());
        assert_eq!(Gesture::ALL[POINT_ONE], Gesture::PointOne);
    }

    #[test]
    fn notices_a_change_within_four_frames() {
        let mut observer = HandObserver::new(CALIBRATION);
        let mut late = 0;
        for (i, gesture) in
            [[Gesture::Fist; 4], [Gesture::PointTwo; 4], [Gesture::OpenHand; 4]].concat().iter().enumerate()
        {
            let (things, _) = scene(*gesture, -1.6, true, 0.1);
            let seen = observer.update(&frame(&things, i as u64 * 66_000_000, i as u64)).unwrap();
            late = if seen.gesture == *gesture { 0 } else { late + 1 };
            assert!(late < 4, "frame {i}");
        }
    }

    #[test]
    fn without_a_hand_there_is_none() {
        let mut observer = HandObserver::new(CALIBRATION);
        for frame in empty_frames() {
            assert_eq!(observer.update(&frame), None);
        }
        for color in [TABLE, [205, 190, 165], [180, 140, 100], [224, 172, 138]] {
            let at = |x, y| Isometry3::translation(x, y, 0.93);
            let block =
                |x, y, color| Thing::Block { root_from_block: at(x, y), size: Vector3::repeat(0.07), color };
            let things = [
                table(color),
                block(0.1, 0.5, [240, 210, 40]),
                block(0.3, 0.5, [40, 170, 60]),
                block(0.3, 0.65, [120, 122, 128]),
                block(0.1, 0.65, [230, 120, 20]),
            ];
            assert_eq!(observer.update(&frame(&things, 0, 4)), None, "{color:?}");
        }
    }
}
