//! The coach's actions while the robot wipes: one after the other, from the world file.
//!
//! A push acts on the robot's hand; its force rises and falls smoothly with the phase. A gesture is shown beside
//! the path as the robot executed it last. The hand comes from one side and returns there; it shows the same
//! gesture all the time and is turned towards the robot's cameras. It times its approach: it arrives when the
//! robot's hand comes to the coached phase.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::clearance::lift;
use super::demonstration::minimum_jerk;
use super::path::{CoachPath, PhaseTracker};
use super::{CoachState, SeenArm};
use crate::world::{CoachSpec, CoachingAction, CoachingStep, Gesture, Palm, Push, Show, Timing};

/// Time that the hand needs to come and to go at its usual speed, s.
const COME_S: f64 = 1.0;
/// How far a palm that may look anywhere is turned about the fingers and tilted at most, rad.
const MOST_TURNED: [f64; 2] = [1.05, 0.44];
/// The hand may come faster or slower by at most this factor, to arrive in time.
const MAX_HASTE: f64 = 1.7;
/// The robot slows down as the hand comes: the share of the path that it still covers meanwhile.
const SLOWED: f64 = 0.75;
/// The coach waits at most this many periods for the right pass.
const MAX_WAIT_PERIODS: f64 = 2.0;
/// Length of the hand's way, m.
const DISTANCE: f64 = 0.35;
/// Number of places on the path that the coach remembers.
const BINS: usize = 64;
/// A push is given up after this many times its cycles.
const MAX_CYCLES_FACTOR: f64 = 4.0;
/// The tracker's step, s.
const TRACK_DT: f64 = 0.005;
/// Preferred direction of the forearm, in which it hides neither the path nor the robot's right arm: far and left. For the
/// left arm it is mirrored.
const FOREARM: Vector3<f64> = Vector3::new(-0.6, 0.8, 0.0);

/// The coach's bare hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandShown {
    /// Pose of the hand: origin in the palm's middle, z along the fingers, x out of the palm, y to the thumb.
    pub root_from_hand: Isometry3<f64>,
    /// The gesture.
    pub gesture: Gesture,
    /// How long it has been shown, s.
    pub shown_s: f64,
    /// Whether the hand stands beside the path (rather than coming or going).
    pub in_place: bool,
}

/// Kind of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionKind {
    /// A push.
    Push,
    /// A gesture.
    Gesture(Gesture),
}

impl ActionKind {
    /// Its name in reports: `push`, or the gesture's.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Push => "push",
            Self::Gesture(gesture) => gesture.name(),
        }
    }
}

/// What happened to an action.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// The coach's hand appears, or the first push begins.
    Began,
    /// The hand has reached its place.
    Arrived {
        /// Position of the palm, root frame, m.
        palm: [f64; 3],
    },
    /// The hand begins to go.
    Leaves,
    /// The hand has gone, or the push is over.
    Ended,
}

/// The begin or end of a part of an action.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ActionEvent {
    /// Index of the step of the world's coaching, from 0.
    pub step: usize,
    /// Its kind.
    pub kind: ActionKind,
    /// What happened.
    pub event: EventKind,
    /// Time, s of the robot's clock.
    pub t: f64,
}

#[derive(Clone, Debug)]
enum Activity {
    Idle,
    Pushing { began: Option<f64>, from: f64, inside: bool, done: u32 },
    Showing(Showing),
}

/// A hand that is shown.
#[derive(Clone, Debug)]
struct Showing {
    since: f64,
    place: Isometry3<f64>,
    away: Vector3<f64>,
    /// Share of its way that it has covered, 0 to 1.
    come: f64,
    arrived: Option<f64>,
    leaves: Option<f64>,
}

#[derive(Clone, Debug)]
pub(super) struct Coaching {
    steps: Vec<CoachingStep>,
    /// For each step, how far its palm is turned about the fingers and tilted, rad.
    turns: Vec<[f64; 2]>,
    /// Time that a hand needs to come and to go, s.
    come_s: f64,
    /// Whether a gesture arrives when the robot's hand does.
    matched: bool,
    ends: f64,
    camera: Point3<f64>,
    forearm: Vector3<f64>,
    path: CoachPath,
    tracker: PhaseTracker,
    since_tracked: f64,
    seen: Vec<Option<SeenArm>>,
    since: Option<f64>,
    next: usize,
    activity: Activity,
    events: Vec<ActionEvent>,
}

impl Coaching {
    pub(super) fn new(
        spec: &CoachSpec,
        path: CoachPath,
        (camera, side): (Point3<f64>, f64),
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let turn = |most: f64, rng: &mut ChaCha8Rng| most * (2.0 * rng.random::<f64>() - 1.0);
        let turns = spec.coaching.iter().map(|_| match spec.palm {
            Palm::Camera => [0.0; 2],
            Palm::Any => MOST_TURNED.map(|most| turn(most, rng)),
        });
        Self {
            turns: turns.collect(),
            come_s: COME_S / spec.speed,
            matched: spec.timing == Timing::Matched,
            steps: spec.coaching.clone(),
            ends: spec.ends,
            camera,
            forearm: FOREARM.component_mul(&Vector3::new(side, 1.0, 1.0)),
            tracker: PhaseTracker::new(path.clone()),
            path,
            since_tracked: 0.0,
            seen: vec![None; BINS],
            since: None,
            next: 0,
            activity: Activity::Idle,
            events: Vec::new(),
        }
    }

    pub(super) fn begin(&mut self, t: f64) {
        self.since.get_or_insert(t);
    }

    pub(super) fn since(&self) -> Option<f64> {
        self.since
    }

    pub(super) fn take_events(&mut self) -> Vec<ActionEvent> {
        std::mem::take(&mut self.events)
    }

    pub(super) fn is_done(&self, t: f64) -> bool {
        let idle = matches!(self.activity, Activity::Idle);
        idle && (self.next >= self.steps.len() || self.since.is_some_and(|s| t > s + self.ends))
    }

    pub(super) fn step(&mut self, t: f64, arm: impl FnOnce() -> SeenArm, dt: f64, state: &mut CoachState) {
        *state = CoachState::default();
        let Some(since) = self.since else { return };
        self.track(arm, dt);
        state.phase = self.tracker.phase();
        let gone = t - since > self.ends;
        let Some(step) = self.steps.get(self.next).cloned() else { return };
        if matches!(self.activity, Activity::Idle) {
            if gone || t - since < step.at || !self.in_time(&step, t - since) {
                return;
            }
            self.start(&step, t);
        }
        match &step.action {
            CoachingAction::Push { push } => self.push(push, t, gone, state),
            CoachingAction::Show(show) => self.show(show, t, dt, gone, state),
        }
    }

    fn track(&mut self, arm: impl FnOnce() -> SeenArm, dt: f64) {
        self.since_tracked += dt;
        if self.since_tracked + 1e-9 < TRACK_DT {
            return;
        }
        let arm = arm();
        let SeenArm { tcp, velocity, .. } = arm;
        self.tracker.update([tcp.x, tcp.y], [velocity.x, velocity.y], self.since_tracked);
        self.since_tracked = 0.0;
        if let Some(phase) = self.tracker.phase() {
            let bin = ((phase * BINS as f64) as usize).min(BINS - 1);
            self.seen[bin] = Some(arm);
        }
    }

    /// Whether a hand that sets out now, `elapsed` s after wiping began, arrives when the robot comes to the
    /// coached phase. A push waits for its phase by itself.
    fn in_time(&self, step: &CoachingStep, elapsed: f64) -> bool {
        let CoachingAction::Show(show) = &step.action else { return true };
        if !self.matched {
            return true;
        }
        let Some(cycles) = self.until(show.phase) else { return true };
        let needed = SLOWED * self.come_s * self.tracker.frequency();
        let over = elapsed - step.at > MAX_WAIT_PERIODS / self.path.frequency();
        over || (needed - cycles).rem_euclid(1.0) < 0.1
    }

    /// Cycles until the robot comes to `phase`, 0 to 1.
    fn until(&self, phase: f64) -> Option<f64> {
        Some((phase - self.tracker.phase()?).rem_euclid(1.0))
    }

    fn start(&mut self, step: &CoachingStep, t: f64) {
        match &step.action {
            CoachingAction::Push { .. } => {
                self.activity = Activity::Pushing { began: None, from: t, inside: false, done: 0 };
            }
            CoachingAction::Show(show) => {
                let place = self.place(show);
                let away = -(place.rotation * Vector3::z()) * DISTANCE + Vector3::z() * 0.05;
                let showing = Showing { since: t, place, away, come: 0.0, arrived: None, leaves: None };
                self.activity = Activity::Showing(showing);
                self.note(ActionKind::Gesture(show.gesture), EventKind::Began, t);
            }
        }
    }

    fn note(&mut self, kind: ActionKind, event: EventKind, t: f64) {
        self.events.push(ActionEvent { step: self.next, kind, event, t });
    }

    fn finish(&mut self, kind: ActionKind, t: f64) {
        self.note(kind, EventKind::Ended, t);
        self.activity = Activity::Idle;
        self.next += 1;
    }

    fn push(&mut self, push: &Push, t: f64, gone: bool, state: &mut CoachState) {
        let Activity::Pushing { began, from, inside, done } = &mut self.activity else { return };
        let Some(phase) = state.phase else { return };
        let off = phase - push.phase;
        let near = (off - off.round()).abs() / push.arc;
        // A push starts only near the beginning of the arc, so that it is complete in each cycle.
        let now_inside = near < 1.0 && (*inside || near > 0.6);
        let patience = MAX_CYCLES_FACTOR * f64::from(push.cycles) / self.path.frequency();
        let over = t - *from > patience || (gone && !now_inside);
        if now_inside {
            state.push = Vector3::from(push.force) * libm::cos(FRAC_PI_2 * near).powi(2);
        }
        let left = *inside && !now_inside;
        *inside = now_inside;
        *done += u32::from(left);
        let finished = *done >= push.cycles || over;
        let first = now_inside && began.is_none();
        if first {
            *began = Some(t);
        }
        if first {
            self.note(ActionKind::Push, EventKind::Began, t);
        }
        if finished {
            self.finish(ActionKind::Push, t);
        }
    }

    fn show(&mut self, show: &Show, t: f64, dt: f64, gone: bool, state: &mut CoachState) {
        let kind = ActionKind::Gesture(show.gesture);
        let (rate, come_s) = (self.approach_rate(show.phase), self.come_s);
        let Activity::Showing(hand) = &mut self.activity else { return };
        hand.come = (hand.come + rate * dt).min(1.0);
        let mut happened = None;
        if hand.arrived.is_none() && hand.come >= 1.0 {
            hand.arrived = Some(t);
            happened = Some(EventKind::Arrived { palm: hand.place.translation.vector.into() });
        } else if let (None, Some(arrived)) = (hand.leaves, hand.arrived)
            && (t >= arrived + show.duration || gone)
        {
            hand.leaves = Some(t);
            happened = Some(EventKind::Leaves);
        }
        let apart = match hand.leaves {
            Some(left) => minimum_jerk((t - left) / come_s),
            None => 1.0 - minimum_jerk(hand.come),
        };
        let root_from_hand = Translation3::from(hand.away * apart) * hand.place;
        let over = hand.leaves.is_some_and(|left| t - left >= come_s);
        let in_place = hand.arrived.is_some() && hand.leaves.is_none();
        let shown_s = t - hand.since;
        if let Some(event) = happened {
            self.note(kind, event, t);
        }
        if over {
            self.finish(kind, t);
        } else {
            state.hand = Some(HandShown { root_from_hand, gesture: show.gesture, shown_s, in_place });
        }
    }

    /// Speed of the approaching hand, as share of its way per s: the rest of its way in the time that the robot
    /// needs to the coached phase, limited by [`MAX_HASTE`].
    fn approach_rate(&self, phase: f64) -> f64 {
        let Activity::Showing(hand) = &self.activity else { return 0.0 };
        let come_s = self.come_s;
        let Some(cycles) = self.until(phase).filter(|_| self.matched) else { return 1.0 / come_s };
        // If the phase was just missed, do not wait for the next pass.
        let left = if cycles > 0.8 { 0.0 } else { cycles / self.tracker.frequency().max(1e-3) };
        ((1.0 - hand.come) / left.max(1e-3)).clamp(1.0 / (MAX_HASTE * come_s), MAX_HASTE / come_s)
    }

    /// Where the hand stands: beside the path as executed last, the palm turned to the cameras. It is lifted if the
    /// robot's arm would otherwise touch it for most of a cycle (see [`lift`]).
    fn place(&self, show: &Show) -> Isometry3<f64> {
        let palm = self.path_point(show.phase) + Vector3::from(show.offset);
        let view = (self.camera.coords - palm).try_normalize(1e-6).unwrap_or_else(Vector3::z);
        let fingers = match show.direction.map(Vector3::from).and_then(|d| d.try_normalize(1e-9)) {
            Some(direction) => direction,
            None => across(&Vector3::from(show.offset), &view, &self.forearm),
        };
        let [about, tilt] = self.turns.get(self.next).copied().unwrap_or_default();
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), about)
            * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt);
        let beside = Isometry3::from_parts(Translation3::from(palm), facing(&fingers, &view) * turned);
        Translation3::from(Vector3::z() * lift(&beside, &self.seen)) * beside
    }

    /// The executed path at a phase; without one, the coach's own path at the executed height.
    fn path_point(&self, phase: f64) -> Vector3<f64> {
        let bin = (phase.rem_euclid(1.0) * BINS as f64) as usize % BINS;
        let seen = (0..4).find_map(|d| self.seen[(bin + d) % BINS].or(self.seen[(bin + BINS - d) % BINS]));
        let seen = seen.map(|arm| arm.tcp.coords);
        let own = self.path.point(phase * std::f64::consts::TAU);
        match seen {
            Some(p) if libm::hypot(p.x - own[0], p.y - own[1]) < 0.12 => p,
            other => Vector3::new(own[0], own[1], other.map_or(1.05, |p| p.z)),
        }
    }
}

/// The direction perpendicular to the offset and the view, so that neither fingers nor forearm reach over the path.
fn across(offset: &Vector3<f64>, view: &Vector3<f64>, forearm: &Vector3<f64>) -> Vector3<f64> {
    let along = view
        .cross(offset)
        .try_normalize(1e-6)
        .unwrap_or_else(|| view.cross(&Vector3::x()).try_normalize(1e-6).unwrap_or_else(Vector3::y));
    if along.dot(forearm) > 0.0 { -along } else { along }
}

/// A hand whose fingers point along `fingers` and whose palm is turned to `view` as far as that allows.
fn facing(fingers: &Vector3<f64>, view: &Vector3<f64>) -> UnitQuaternion<f64> {
    let sideways = view - fingers * view.dot(fingers);
    let palm = sideways.try_normalize(1e-6).unwrap_or_else(|| {
        let other = if fingers.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        (other - fingers * other.dot(fingers)).normalize()
    });
    let thumb = fingers.cross(&palm);
    let axes = Matrix3::from_columns(&[palm, thumb, *fingers]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::world::DemonstrationSpec;
    use rand::SeedableRng as _;

    const DT: f64 = 1e-3;

    /// Moves an ideal hand along the coach's own path. Returns the coach's state at each ms, and the events.
    fn wipe(spec: &CoachSpec, seconds: f64) -> (Vec<CoachState>, Vec<ActionEvent>) {
        let path = CoachPath::new(&DemonstrationSpec::default());
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut coaching = Coaching::new(spec, path.clone(), (Point3::new(0.0, 0.24, 1.65), 1.0), &mut rng);
        coaching.begin(0.0);
        let omega = TAU * path.frequency();
        let mut states = Vec::new();
        let mut state = CoachState::default();
        for i in 0..(seconds / DT) as u32 {
            let t = f64::from(i) * DT;
            let (p, d) = (path.point(omega * t), path.tangent(omega * t));
            let velocity = Vector3::new(d[0], d[1], 0.0) * omega;
            let tcp = Point3::new(p[0], p[1], 1.05);
            let arm = SeenArm { tcp, velocity, wrist: tcp, elbow: tcp };
            coaching.step(t, || arm, DT, &mut state);
            states.push(state);
        }
        (states, coaching.take_events())
    }

    fn only(action: CoachingAction) -> CoachSpec {
        CoachSpec { coaching: vec![CoachingStep { at: 6.0, action }], ..CoachSpec::default() }
    }

    #[test]
    fn a_push_comes_once_a_cycle_about_its_phase() {
        let (states, events) = wipe(&only(CoachingAction::Push { push: Push::default() }), 25.0);
        assert_eq!(events.len(), 2, "{events:?}");
        let pushes = states.windows(2).filter(|w| w[0].push.y == 0.0 && w[1].push.y > 0.0).count();
        assert_eq!(pushes, 6);
        let strongest = states.iter().max_by(|a, b| a.push.y.total_cmp(&b.push.y)).unwrap();
        assert!((strongest.push.y - 12.0).abs() < 0.1);
        assert!((strongest.phase.unwrap() - 0.25).abs() < 0.02);
        let jump = states.windows(2).map(|w| (w[1].push - w[0].push).norm()).fold(0.0, f64::max);
        assert!(jump < 5.0, "{jump}");
    }

    #[test]
    fn a_gesture_comes_waits_beside_the_path_and_goes() {
        let show = Show {
            gesture: Gesture::Fist,
            phase: 0.75,
            offset: [0.0, -0.12, 0.0],
            duration: 5.0,
            direction: None,
        };
        let (states, events) = wipe(&only(CoachingAction::Show(show)), 15.0);
        let kinds: Vec<_> = events.iter().map(|e| e.event).collect();
        assert_eq!(kinds.len(), 4);
        let EventKind::Arrived { palm } = kinds[1] else { panic!("{kinds:?}") };
        let expected = Vector3::new(0.28, 0.50 - 0.12, 1.05);
        assert!((Vector3::from(palm) - expected).norm() < 0.01, "{palm:?}");
        let waits = states.iter().filter(|s| s.hand.is_some_and(|h| h.in_place)).count();
        assert!((4999..=5001).contains(&waits), "{waits}");
        assert!((events[3].t - events[0].t - 7.0).abs() < 0.5);
        let reached = states.iter().position(|s| s.hand.is_some_and(|h| h.in_place));
        let phase = states[reached.unwrap()].phase.unwrap();
        assert!((phase - 0.75).abs() < 0.03, "{phase}");
        for w in states.windows(2) {
            if let [Some(a), Some(b)] = [w[0].hand, w[1].hand] {
                let step = b.root_from_hand.translation.vector - a.root_from_hand.translation.vector;
                assert!(step.norm() < 1e-3);
            }
        }
    }

    #[test]
    fn a_coach_of_his_own_mind_comes_at_once_and_turns_his_palm() {
        let show = Show {
            gesture: Gesture::Fist,
            phase: 0.75,
            offset: [0.0, -0.12, 0.0],
            duration: 5.0,
            direction: None,
        };
        let shown = |palm, timing, speed| {
            let spec = CoachSpec { palm, timing, speed, ..only(CoachingAction::Show(show.clone())) };
            let (states, events) = wipe(&spec, 15.0);
            let hand = states.iter().filter_map(|s| s.hand).find(|hand| hand.in_place).unwrap();
            (hand.root_from_hand.rotation, events[0].t, events[1].t - events[0].t)
        };
        let (facing, ..) = shown(Palm::Camera, Timing::Matched, 1.0);
        let (turned, came, took) = shown(Palm::Any, Timing::Free, 2.0);
        assert!(facing.angle_to(&turned) > 0.05, "{}", facing.angle_to(&turned));
        assert!((came - 6.0).abs() < 2e-3 && (took - 0.5).abs() < 5e-3, "{came} {took}");
    }

    #[test]
    fn one_finger_points_and_the_palm_faces_the_camera() {
        let view = Vector3::new(-0.3, -0.4, 0.8).normalize();
        let q = facing(&Vector3::y(), &view);
        assert!((q * Vector3::z() - Vector3::y()).norm() < 1e-12);
        assert!((q * Vector3::x()).dot(&view) > 0.85);
        assert!((q * Vector3::y() - Vector3::y().cross(&(q * Vector3::x()))).norm() < 1e-12);
        let q = facing(&view, &view);
        assert!((q * Vector3::z() - view).norm() < 1e-12);
    }

    #[test]
    fn the_coach_leaves_at_the_end() {
        let show = Show {
            gesture: Gesture::OpenHand,
            phase: 0.0,
            offset: [0.1, 0.0, 0.0],
            duration: 500.0,
            direction: None,
        };
        let spec = CoachSpec { ends: 10.0, ..only(CoachingAction::Show(show)) };
        let (states, events) = wipe(&spec, 13.0);
        assert_eq!(events.last().unwrap().event, EventKind::Ended);
        assert_eq!(states.last().unwrap().hand, None);
    }
}
