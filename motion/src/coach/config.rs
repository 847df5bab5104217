//! The constants of a coach.

use serde::{Deserialize, Serialize};

use crate::error::{MotionError, positive, vector, within};
use crate::field::PotentialField;

/// The constants of a [`Coach`](crate::Coach).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CoachConfig {
    /// The field of a hand; its `gamma` scales how far a gesture moves the path.
    pub field: PotentialField,
    /// Direction in which nothing may be coached (the surface normal), any length; all zero for none.
    pub normal: [f64; 3],
    /// How far a push moves the path in each pass, m/N.
    pub push_gain: f64,
    /// Force that does nothing, N.
    pub push_dead_band: f64,
    /// The most that one pass moves the path however strong the push, m.
    pub push_pass_limit: f64,
    /// The most that pushes of one event move the path, m.
    pub push_limit: f64,
    /// How near to the hand a fist draws the path at most, m.
    pub standoff: f64,
    /// The most that one fist or 2-finger gesture moves the path, m.
    pub reach: f64,
    /// Time constant of a gesture, s.
    pub time_constant: f64,
    /// Which part of the path a hand holds: up to this far from the phase that it means, share of a period.
    pub arc: f64,
    /// Speed of a shift, m/s.
    pub shift_speed: f64,
    /// The most that one shift moves the motion, m.
    pub shift_limit: f64,
    /// An event is over when the coach has done nothing for this long, s; then limits count anew.
    pub pause: f64,
}

impl Default for CoachConfig {
    fn default() -> Self {
        Self {
            field: PotentialField::wiping(),
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
        let field = [self.field.gamma, self.field.eta, self.field.r_m, self.field.beta];
        vector("field", 4, &field)?;
        vector("normal", 3, &self.normal)
    }
}
