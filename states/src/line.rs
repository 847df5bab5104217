//! A straight line for the TCP, at a speed that rises and falls smoothly.

use nalgebra::{Isometry3, Translation3, Vector3};

/// How fast the hand turns at most on a line, rad/s.
const TURNING: f64 = 0.5;

/// Where the reference is and how it moves.
pub(crate) struct LinePoint {
    /// Root frame.
    pub(crate) pose: Isometry3<f64>,
    /// m/s
    pub(crate) linear: Vector3<f64>,
    /// rad/s
    pub(crate) angular: Vector3<f64>,
}

/// A line from one pose to another, travelled in a quintic of time (no jump in velocity or acceleration).
pub(crate) struct Line {
    from: Isometry3<f64>,
    travel: Vector3<f64>,
    turn: Vector3<f64>,
    duration: f64,
    time: f64,
}

impl Line {
    /// A line at `speed`, m/s, on the average of its middle part.
    pub(crate) fn new(from: Isometry3<f64>, to: Isometry3<f64>, speed: f64) -> Self {
        let travel = to.translation.vector - from.translation.vector;
        let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
        // The quintic's fastest moment is 1.875 times its mean speed.
        let duration = 1.875 * (travel.norm() / speed.max(1e-3)).max(turn.norm() / TURNING);
        Self { from, travel, turn, duration: duration.max(0.2), time: 0.0 }
    }

    /// `dt` s further.
    pub(crate) fn step(&mut self, dt: f64) -> LinePoint {
        self.time += dt;
        let s = (self.time / self.duration).min(1.0);
        let share = s * s * s * (10.0 + s * (6.0 * s - 15.0));
        let rate = if s < 1.0 { 30.0 * s * s * (1.0 - s) * (1.0 - s) / self.duration } else { 0.0 };
        let rotation = nalgebra::UnitQuaternion::from_scaled_axis(self.turn * share) * self.from.rotation;
        let translation = Translation3::from(self.from.translation.vector + self.travel * share);
        LinePoint {
            pose: Isometry3::from_parts(translation, rotation),
            linear: self.travel * rate,
            angular: self.turn * rate,
        }
    }

    /// Whether the reference has been there for `seconds`.
    pub(crate) fn rested(&self, seconds: f64) -> bool {
        self.time >= self.duration + seconds
    }
}
