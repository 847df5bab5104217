//! Coaching of a running motion in task space: attract (fist), repel (2-finger pointing), shift (1-finger pointing), push (force),
//! and along a direction (an arm). It changes the weights or the centre of the [`PeriodicDmp`] that is executed.
//!
//! It is based on the paper's coupling (eqs. 10, 13, 14, 16), for a path of some centimetres. Differences:
//!
//! - It works in metres of the path. The effect of the weights on the steady path is known exactly
//!   ([`PathResponse`]), so each event has a target and ends there. The paper's coupling acts for as long as the
//!   hand is present.
//! - P of (9) is replaced by its fixed point, so that coaching does not depend on how long the motion was learned
//!   before.
//! - The kernels are selected earlier by the lag of the path behind the forcing term ([`PeriodicDmp::lag`]).
//! - It is local in the phase: only phases near the one that the hand addresses (`coach/phase.rs`) are moved. So of
//!   a doubled stroke or a crossing, one pass moves and the other does not.
//! - The field depends on the distance only, not on the angle of (15) ([`HandField`]).
//! - A hand acts only while it stands still, and its position is smoothed against the jitter of tracking.
//! - The change per pass and per event is bounded, nothing is changed along the surface normal, small forces have
//!   no effect, and a fist attracts the path to a standoff before the hand.
//! - Pointing with one finger shifts the centre; the paper has no such command.
//!
//! What it does not do: recognise gestures, or decide whether a force is a push (see [`crate::FrictionModel`]).

use nalgebra::Vector3;

use crate::error::{MotionError, positive, size, vector, within};
use crate::periodic::{PathResponse, PeriodicDmp};

mod config;
mod phase;

pub use self::config::{CoachConfig, HandField};

/// The coach's present action; positions in the frame of the motion, m.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum CoachInput {
    /// Nothing: the motion stays as it is.
    #[default]
    None,
    /// Pushes the end effector with this force, N.
    Push {
        /// The force beyond what wiping explains, N.
        force: Vector3<f64>,
    },
    /// A fist beside the path: the near part moves towards the hand.
    Attract {
        /// The hand.
        hand: Vector3<f64>,
    },
    /// Two fingers: the near part moves away from the hand.
    Repel {
        /// The hand.
        hand: Vector3<f64>,
    },
    /// An arm beside the path: the near part moves along `direction` (any length).
    Along {
        /// Where the arm acts.
        at: Vector3<f64>,
        /// Direction of the change.
        direction: Vector3<f64>,
    },
    /// One finger: the whole motion moves along `direction` (any length).
    Shift {
        /// Direction of the shift.
        direction: Vector3<f64>,
    },
}

/// The effect of the coach on the motion in the present event.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CoachReport {
    /// Whether the motion is being coached now.
    pub active: bool,
    /// The coached phase, rad: the one that the hand addresses, or the present one for a push.
    pub phase: f64,
    /// Displacement of the path at that phase along the coached direction since the event began, m.
    pub displacement: f64,
    /// Whether the hand may as well address another pass: two are about as near, and it was not seen when the hand came.
    pub ambiguous: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum InputKind {
    Push,
    Attract,
    Repel,
    Along,
    Shift,
}

/// Where the near part of the path goes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    ToHand,
    FromHand,
    Along(Vector3<f64>),
}

/// Changes a running motion by the coach's input. One coach belongs to one primitive.
#[derive(Debug, Clone)]
pub struct CoachedMotion {
    config: CoachConfig,
    normal: Option<Vector3<f64>>,
    response: PathResponse,
    event: Option<InputKind>,
    idle: f64,
    /// Weights, centre and path when the event began.
    weights: Vec<f64>,
    centre: Vector3<f64>,
    path: Vec<Vector3<f64>>,
    hand: Option<Vector3<f64>>,
    /// The phase at which the hand came to rest, rad.
    arrival: Option<f64>,
    /// The phase that the hand addresses while it stands still, rad.
    addressed: Option<f64>,
    /// How long the hand has stood still, s.
    still: f64,
    /// The position at which it stands.
    place: Option<Vector3<f64>>,
    /// How long it has been detected elsewhere, s.
    away: f64,
}

/// Time constant over which the jitter of a tracked hand is smoothed, s: three camera frames.
const HAND_SMOOTHING: f64 = 0.2;
/// A hand farther than this from its smoothed position is moving and has no effect, m.
const HAND_MOVES: f64 = 0.02;
/// The same of an arm, which is seen less exactly, m.
const ARM_MOVES: f64 = 0.05;
/// How long a hand must stand still before it coaches, s.
const HAND_STANDS: f64 = 0.3;
/// How long a hand must be detected elsewhere before it has left its place: the least time, s, and the least share
/// of a period. The robot's own arm hides a part of the hand once in each period.
const HAND_AWAY: (f64, f64) = (0.8, 0.4);

impl CoachedMotion {
    /// A coach for `dmp`, whose first three degrees of freedom are x, y, z in metres.
    ///
    /// # Errors
    /// When the primitive has fewer than three degrees of freedom or a constant is invalid.
    pub fn new(config: CoachConfig, dmp: &PeriodicDmp) -> Result<Self, MotionError> {
        config.validate()?;
        if dmp.dofs() < 3 {
            return Err(MotionError::TooFew { what: "dofs", needed: 3, got: dmp.dofs() });
        }
        let response = PathResponse::new(dmp)?;
        let path = vec![Vector3::zeros(); response.samples()];
        Ok(Self {
            normal: Vector3::from(config.normal).try_normalize(1e-9),
            config,
            response,
            event: None,
            idle: 0.0,
            weights: dmp.weights().to_vec(),
            centre: Vector3::zeros(),
            path,
            hand: None,
            arrival: None,
            addressed: None,
            still: 0.0,
            place: None,
            away: 0.0,
        })
    }

    /// Sets the `phase` (rad) of the motion at which the hand of a gesture came to rest, if it was observed. A
    /// coach times his hand to the pass that he wants to change: of several passes at about the same distance from
    /// the hand, this one is taken. The value holds until the next call; a phase that is not finite means that none
    /// was observed.
    pub fn set_arrival(&mut self, phase: Option<f64>) {
        self.arrival = phase.filter(|p| p.is_finite());
    }

    /// Applies the coach's input to `dmp`, `dt` s after the last call. To be called before each
    /// [`PeriodicDmp::step`] with the same `dt` and `omega` (rad/s). Does not allocate.
    ///
    /// # Errors
    /// When the primitive differs in size from the coach's, a value is not finite, `dt` is not positive or `omega`
    /// is negative. Nothing is changed then.
    pub fn step(
        &mut self,
        dmp: &mut PeriodicDmp,
        dt: f64,
        omega: f64,
        input: CoachInput,
    ) -> Result<CoachReport, MotionError> {
        positive("dt", dt)?;
        within("omega", omega, 0.0, 1e6)?;
        size("weights", self.weights.len(), dmp.weights().len())?;
        // What acts, where or how, and the direction of an arm.
        let (kind, given, direction) = match input {
            CoachInput::None => {
                self.idle += dt;
                if self.idle > self.config.pause {
                    self.event = None;
                }
                return Ok(CoachReport::default());
            }
            CoachInput::Push { force } => (InputKind::Push, force, Vector3::zeros()),
            CoachInput::Attract { hand } => (InputKind::Attract, hand, Vector3::zeros()),
            CoachInput::Repel { hand } => (InputKind::Repel, hand, Vector3::zeros()),
            CoachInput::Along { at, direction } => (InputKind::Along, at, direction),
            CoachInput::Shift { direction } => (InputKind::Shift, direction, Vector3::zeros()),
        };
        vector("direction", 3, direction.as_slice())?;
        vector("coach", 3, given.as_slice())?;
        if self.event != Some(kind) {
            self.begin(kind, dmp);
        }
        self.idle = 0.0;
        match kind {
            InputKind::Push => self.push(dmp, omega * dt, given),
            InputKind::Attract => self.gesture(dmp, (dt, omega), given, Way::ToHand),
            InputKind::Repel => self.gesture(dmp, (dt, omega), given, Way::FromHand),
            InputKind::Along => self.gesture(dmp, (dt, omega), given, Way::Along(direction)),
            InputKind::Shift => self.shift(dmp, dt, given),
        }
    }

    /// Records the motion at the start of an event, so that the effect can be measured and bounded.
    fn begin(&mut self, kind: InputKind, dmp: &PeriodicDmp) {
        self.event = Some(kind);
        self.hand = None;
        self.addressed = None;
        self.still = 0.0;
        self.place = None;
        self.away = 0.0;
        self.weights.copy_from_slice(dmp.weights());
        self.centre = centre_of(dmp);
        let k = dmp.kernels().len();
        for (s, point) in self.path.iter_mut().enumerate() {
            let at = |d: usize| self.response.at_row(s, &self.weights[d * k..(d + 1) * k]);
            *point = self.centre + dmp.amplitude() * Vector3::new(at(0), at(1), at(2));
        }
    }

    /// Displacement of the steady path at table row `row` since the event began.
    fn moved(&self, dmp: &PeriodicDmp, row: usize) -> Vector3<f64> {
        let k = dmp.kernels().len();
        let at = |d: usize| {
            let weights = &dmp.weights()[d * k..(d + 1) * k];
            self.response.at_row(row, weights) * dmp.amplitude() + dmp.centre()[d]
        };
        Vector3::new(at(0), at(1), at(2)) - self.path[row]
    }

    fn in_surface(&self, v: Vector3<f64>) -> Vector3<f64> {
        self.normal.map_or(v, |n| v - n * n.dot(&v))
    }

    fn push(
        &mut self,
        dmp: &mut PeriodicDmp,
        advance: f64,
        force: Vector3<f64>,
    ) -> Result<CoachReport, MotionError> {
        let force = self.in_surface(force);
        let size = force.norm();
        let phase = dmp.phase();
        if size <= self.config.push_dead_band {
            return Ok(CoachReport { phase, ..CoachReport::default() });
        }
        let direction = force / size;
        let displacement = self.moved(dmp, self.response.row(phase)).dot(&direction);
        let room = (1.0 - displacement / self.config.push_limit).clamp(0.0, 1.0);
        let pass = self.config.push_gain * (size - self.config.push_dead_band);
        let shift = direction * (pass.min(self.config.push_pass_limit) * room);
        displace(dmp, phase, advance, &shift)?;
        Ok(CoachReport { active: true, phase, displacement, ambiguous: false })
    }

    fn gesture(
        &mut self,
        dmp: &mut PeriodicDmp,
        (dt, omega): (f64, f64),
        hand: Vector3<f64>,
        way: Way,
    ) -> Result<CoachReport, MotionError> {
        let Some(hand) = self.stands_at(hand, dt, omega) else {
            self.addressed = None;
            return Ok(CoachReport { phase: dmp.phase(), ..CoachReport::default() });
        };
        let distance = |row: usize| self.in_surface(hand - self.path[row]).norm();
        let row = phase::addressed_row(self.path.len(), distance, self.arrival, self.addressed);
        let (phase, nearest) = (self.response.phase(row), distance(row));
        let ambiguous =
            self.addressed.is_none() && phase::is_ambiguous(self.path.len(), distance, self.arrival, row);
        let offset = hand - self.path[row];
        self.addressed = Some(phase);
        let wanted = match way {
            Way::ToHand => offset,
            Way::FromHand => -offset,
            Way::Along(direction) => direction,
        };
        let Some(direction) = self.in_surface(wanted).try_normalize(1e-6) else {
            return Ok(CoachReport { phase, ..CoachReport::default() });
        };
        let goal = self.goal(nearest, offset.norm(), way);
        let here = self.response.row(dmp.phase());
        let wanted = goal * phase::window(dmp.phase() - phase, self.config.arc * std::f64::consts::TAU);
        let missing = wanted - self.moved(dmp, here).dot(&direction);
        // One pass corrects the share that corresponds to the time of one period, at most all of it.
        let share = (std::f64::consts::TAU / (omega * self.config.time_constant)).min(1.0);
        displace(dmp, dmp.phase(), omega * dt, &(direction * (missing * share)))?;
        let displacement = self.moved(dmp, row).dot(&direction);
        Ok(CoachReport { active: true, phase, displacement, ambiguous })
    }

    /// The desired displacement of the path at the addressed phase, m.
    fn goal(&self, in_surface: f64, distance: f64, way: Way) -> f64 {
        let strength = self.config.field.strength(distance);
        match way {
            Way::ToHand => (self.config.reach * strength).min((in_surface - self.config.standoff).max(0.0)),
            Way::FromHand => self.config.reach * strength,
            Way::Along(_) => self.config.arm_reach * strength,
        }
    }

    /// The position at which the hand stands, m, if it does. Short detections elsewhere are ignored: the robot's
    /// own arm hides a part of the hand each time it passes.
    fn stands_at(&mut self, hand: Vector3<f64>, dt: f64, omega: f64) -> Option<Vector3<f64>> {
        let share = 1.0 - libm::exp(-dt / HAND_SMOOTHING);
        let smooth = self.hand.map_or(hand, |old| old + (hand - old) * share);
        self.hand = Some(smooth);
        let moves = if self.event == Some(InputKind::Along) { ARM_MOVES } else { HAND_MOVES };
        self.still = if (hand - smooth).norm() < moves { self.still + dt } else { 0.0 };
        let there = self.place.is_some_and(|place| (smooth - place).norm() < 2.0 * moves);
        self.away = if there { 0.0 } else { self.away + dt };
        let passage = HAND_AWAY.0.max(HAND_AWAY.1 * std::f64::consts::TAU / omega.max(0.3));
        if !there && (self.place.is_none() || self.away > passage) {
            self.place = (self.still >= HAND_STANDS).then_some(smooth);
            self.addressed = None;
            self.away = 0.0;
        }
        self.place
    }

    fn shift(
        &mut self,
        dmp: &mut PeriodicDmp,
        dt: f64,
        direction: Vector3<f64>,
    ) -> Result<CoachReport, MotionError> {
        let phase = dmp.phase();
        let Some(direction) = self.in_surface(direction).try_normalize(1e-9) else {
            return Ok(CoachReport { phase, ..CoachReport::default() });
        };
        let shifted = centre_of(dmp) + direction * (self.config.shift_speed * dt) - self.centre;
        let distance = shifted.norm();
        let bounded = shifted * (self.config.shift_limit / distance.max(self.config.shift_limit).max(1e-12));
        let centre = self.centre + bounded;
        dmp.centre_mut()[..3].copy_from_slice(centre.as_slice());
        Ok(CoachReport { active: true, phase, displacement: bounded.dot(&direction), ambiguous: false })
    }
}

fn centre_of(dmp: &PeriodicDmp) -> Vector3<f64> {
    Vector3::new(dmp.centre()[0], dmp.centre()[1], dmp.centre()[2])
}

/// [`PeriodicDmp::displace`] for the first three degrees of freedom. A step that skips a whole kernel moves it as
/// one pass would.
fn displace(
    dmp: &mut PeriodicDmp,
    phase: f64,
    advance: f64,
    shift: &Vector3<f64>,
) -> Result<(), MotionError> {
    let kernel = std::f64::consts::TAU * dmp.kernels().mean();
    dmp.displace_some(phase, advance.min(kernel), shift.as_slice())
}

#[cfg(test)]
mod tests;
