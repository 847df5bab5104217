//! The constants of a coach.

use serde::{Deserialize, Serialize};

use crate::error::{MotionError, positive, vector, within};
use crate::field::reach;

/// The strength of a gesture as a function of its distance from the path: (14) and (16) without the angle of (15),
/// because a wiping path is coached in both directions along a line.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SavedField")]
pub struct HandField {
    /// Scale gamma, dimensionless.
    pub gamma: f64,
    /// Steepness eta of the edge of the field, 1/m.
    pub eta: f64,
    /// Distance r_m at which the field has half its strength, m.
    pub r_m: f64,
}

impl Default for HandField {
    /// For a hand that stands up to about 0.2 m beside the path.
    fn default() -> Self {
        Self { gamma: 1.0, eta: 60.0, r_m: 0.25 }
    }
}

impl HandField {
    /// The strength at `distance` m.
    #[must_use]
    pub fn strength(&self, distance: f64) -> f64 {
        self.gamma * reach(self.eta, self.r_m, distance)
    }
}

/// A stored field. Earlier files also have the constant of the angle, which never had an effect here.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct SavedField {
    gamma: f64,
    eta: f64,
    r_m: f64,
    beta: f64,
}

impl Default for SavedField {
    fn default() -> Self {
        let HandField { gamma, eta, r_m } = HandField::default();
        Self { gamma, eta, r_m, beta: 0.0 }
    }
}

impl TryFrom<SavedField> for HandField {
    type Error = MotionError;

    fn try_from(saved: SavedField) -> Result<Self, MotionError> {
        let SavedField { gamma, eta, r_m, beta } = saved;
        within("field.beta (a coach does not weigh the angle: leave it out or set it to 0)", beta, 0.0, 0.0)?;
        Ok(Self { gamma, eta, r_m })
    }
}

/// The constants of a [`Coach`](crate::Coach).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CoachConfig {
    /// The field of a hand; its `gamma` scales how far a gesture moves the path.
    pub field: HandField,
    /// Direction in which the motion must not be changed (the surface normal), any length; all zero for none.
    pub normal: [f64; 3],
    /// How far a push moves the path per pass, m/N.
    pub push_gain: f64,
    /// A force below this has no effect, N.
    pub push_dead_band: f64,
    /// Upper bound on the change per pass by a push of any strength, m.
    pub push_pass_limit: f64,
    /// Upper bound on the change by the pushes of one event, m.
    pub push_limit: f64,
    /// A fist attracts the path at most to this distance from the hand, m.
    pub standoff: f64,
    /// Upper bound on the change by one fist or 2-finger gesture, m.
    pub reach: f64,
    /// Time constant of a gesture, s.
    pub time_constant: f64,
    /// The part of the path that a gesture moves: up to this far from the addressed phase, share of a period.
    pub arc: f64,
    /// Speed of a shift, m/s.
    pub shift_speed: f64,
    /// Upper bound on the displacement by one shift, m.
    pub shift_limit: f64,
    /// An event ends when the coach has been inactive for this long, s; the limits then start anew.
    pub pause: f64,
}

impl Default for CoachConfig {
    fn default() -> Self {
        Self {
            field: HandField::default(),
            normal: [0.0, 0.0, 1.0],
            push_gain: 0.002,
            push_dead_band: 1.5,
            push_pass_limit: 0.025,
            push_limit: 0.05,
            standoff: 0.05,
            reach: 0.024,
            time_constant: 2.5,
            arc: 0.2,
            shift_speed: 0.006,
            shift_limit: 0.04,
            pause: 8.0,
        }
    }
}

impl CoachConfig {
    pub(super) fn validate(&self) -> Result<(), MotionError> {
        positive("time_constant", self.time_constant)?;
        positive("push_limit", self.push_limit)?;
        positive("arc", self.arc)?;
        for (what, value) in [
            ("push_gain", self.push_gain),
            ("push_dead_band", self.push_dead_band),
            ("push_pass_limit", self.push_pass_limit),
            ("standoff", self.standoff),
            ("reach", self.reach),
            ("shift_speed", self.shift_speed),
            ("shift_limit", self.shift_limit),
            ("pause", self.pause),
        ] {
            within(what, value, 0.0, 1e6)?;
        }
        vector("field", 3, &[self.field.gamma, self.field.eta, self.field.r_m])?;
        vector("normal", 3, &self.normal)
    }
}
