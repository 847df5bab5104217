//! A straight line from one pose to another, with a speed that rises and falls smoothly, for movements of the hand
//! that are not learned. It does not avoid obstacles.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::MotionError;
use crate::error::{finite, positive, sample_time};

/// Limit of the angular velocity, rad/s.
const MAX_ANGULAR_VELOCITY: f64 = 0.5;
/// Shortest duration of a line, s.
const MIN_DURATION: f64 = 0.2;
/// Ratio of the quintic's peak speed to its mean speed.
const PEAK: f64 = 1.875;

/// Pose and velocity on a line or another way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePoint {
    /// The pose, in the frame of both ends.
    pub pose: Isometry3<f64>,
    /// Velocity, m/s.
    pub linear: Vector3<f64>,
    /// Angular velocity in the frame of both ends, rad/s.
    pub angular: Vector3<f64>,
}

/// A line from one pose to another, with a quintic time law, so that velocity and acceleration begin and end at
/// zero (minimum jerk, Flash and Hogan 1985). The rotation is about one axis.
#[derive(Clone, Debug)]
pub struct StraightLine {
    from: Isometry3<f64>,
    travel: Vector3<f64>,
    turn: Vector3<f64>,
    duration: f64,
    time: f64,
}

impl StraightLine {
    /// A line between two poses in one frame, with at most `speed` m/s and at most 0.5 rad/s.
    ///
    /// # Errors
    /// [`MotionError`] for poses that are not finite and a speed that is not positive.
    pub fn new(from: Isometry3<f64>, to: Isometry3<f64>, speed: f64) -> Result<Self, MotionError> {
        positive("speed", speed)?;
        for (what, pose) in [("from", &from), ("to", &to)] {
            finite(what, pose.translation.vector.as_slice())?;
            finite(what, pose.rotation.coords.as_slice())?;
        }
        let travel = to.translation.vector - from.translation.vector;
        let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
        let duration = PEAK * (travel.norm() / speed).max(turn.norm() / MAX_ANGULAR_VELOCITY);
        Ok(Self { from, travel, turn, duration: duration.max(MIN_DURATION), time: 0.0 })
    }

    /// Duration of the line, s.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Advances by `dt` s; after its end the line rests there.
    ///
    /// # Errors
    /// [`MotionError`] for a time that is not positive and finite; the line is then unchanged.
    pub fn step(&mut self, dt: f64) -> Result<LinePoint, MotionError> {
        sample_time(dt)?;
        self.time += dt;
        let s = (self.time / self.duration).min(1.0);
        let share = s * s * s * (10.0 + s * (6.0 * s - 15.0));
        let rate = if s < 1.0 { 30.0 * s * s * (1.0 - s) * (1.0 - s) / self.duration } else { 0.0 };
        let rotation = UnitQuaternion::from_scaled_axis(self.turn * share) * self.from.rotation;
        let translation = Translation3::from(self.from.translation.vector + self.travel * share);
        Ok(LinePoint {
            pose: Isometry3::from_parts(translation, rotation),
            linear: self.travel * rate,
            angular: self.turn * rate,
        })
    }

    /// Whether the line has been at its end for `seconds`.
    pub fn rested(&self, seconds: f64) -> bool {
        self.time >= self.duration + seconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> StraightLine {
        let to = Isometry3::new(Vector3::new(0.3, 0.0, 0.4), Vector3::new(0.0, 0.0, 0.5));
        StraightLine::new(Isometry3::identity(), to, 0.25).unwrap()
    }

    #[test]
    fn it_goes_straight_no_faster_than_told_and_rests_at_its_end() {
        let mut line = line();
        assert!((line.duration() - 1.875 * 2.0).abs() < 1e-12);
        let (dt, mut before, mut fastest) = (1e-3, Isometry3::identity(), 0.0f64);
        while !line.rested(0.1) {
            let point = line.step(dt).unwrap();
            let moved = (point.pose.translation.vector - before.translation.vector) / dt;
            assert!((moved - point.linear).norm() < 2e-3, "{moved} {}", point.linear);
            assert!(point.pose.translation.vector.cross(&Vector3::new(0.6, 0.0, 0.8)).norm() < 1e-12);
            fastest = fastest.max(point.linear.norm());
            before = point.pose;
        }
        assert!((fastest - 0.25).abs() < 1e-6, "{fastest}");
        assert!((before.translation.vector - Vector3::new(0.3, 0.0, 0.4)).norm() < 1e-12);
        assert!((before.rotation.angle() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_line_is_refused_and_what_is_no_time_moves_nothing() {
        let bad = Isometry3::translation(f64::NAN, 0.0, 0.0);
        assert!(StraightLine::new(Isometry3::identity(), bad, 0.1).is_err());
        assert!(StraightLine::new(Isometry3::identity(), Isometry3::identity(), 0.0).is_err());
        let mut line = line();
        for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(line.step(dt).is_err(), "{dt}");
        }
        let first = line.step(1.0).unwrap();
        assert_eq!(Some(first), self::line().step(1.0).ok());
    }
}
