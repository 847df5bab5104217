//! The constants of a coach.

use serde::{Deserialize, Serialize};

use crate::constants::POSITIVE;
use crate::error::{MotionError, vector, within};
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

constants! {
    /// The constants of a [`CoachedMotion`](crate::CoachedMotion).
    pub struct CoachConfig {
        /// The field of a hand; its `gamma` scales how far a gesture moves the path.
        field: HandField = HandField::default();
        /// Direction in which the motion must not be changed (the surface normal), any length; all zero for none.
        normal: [f64; 3] = [0.0, 0.0, 1.0];
        /// How far a push moves the path per pass, m/N.
        push_gain: f64 = 0.002, 0.0..=1e6;
        /// A force below this has no effect, N.
        push_dead_band: f64 = 1.5, 0.0..=1e6;
        /// Upper bound on the change per pass by a push of any strength, m.
        push_pass_limit: f64 = 0.025, 0.0..=1e6;
        /// Upper bound on the change by the pushes of one event, m.
        push_limit: f64 = 0.05, POSITIVE;
        /// A fist attracts the path at most to this distance from the hand, m.
        standoff: f64 = 0.05, 0.0..=1e6;
        /// Upper bound on the change by one fist or 2-finger gesture, m.
        reach: f64 = 0.024, 0.0..=1e6;
        /// Upper bound on the change by one push or pull of an arm, m.
        arm_reach: f64 = 0.035, 0.0..=1e6;
        /// Time constant of a gesture, s.
        time_constant: f64 = 2.5, POSITIVE;
        /// The part of the path that a gesture moves: up to this far from the addressed phase, share of a period.
        arc: f64 = 0.2, POSITIVE;
        /// Speed of a shift, m/s.
        shift_speed: f64 = 0.006, 0.0..=1e6;
        /// Upper bound on the displacement by one shift, m.
        shift_limit: f64 = 0.04, 0.0..=1e6;
        /// An event ends when the coach has been inactive for this long, s; the limits then start anew.
        pause: f64 = 8.0, 0.0..=1e6;
    }
}

impl CoachConfig {
    pub(super) fn validate(&self) -> Result<(), MotionError> {
        self.check_ranges()?;
        vector("field", 3, &[self.field.gamma, self.field.eta, self.field.r_m])?;
        vector("normal", 3, &self.normal)
    }
}
