//! A movement of a hand from a start to a goal as skills and memory share it: learned from poses, for instance of a hand that
//! was led, and played with the speed at which it was shown.
//!
//! A loaded movement is complete: sizes and values are checked, so that its execution cannot fail because of its content. Periodic
//! motions are [`Motion`](crate::Motion)s.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::discrete::{DiscreteDmp, DiscreteDmpConfig};
use crate::discrete_periodic::differentiate;
use crate::error::{MotionError, constant, sample_time, size};
use crate::orientation::DiscreteOrientationDmp;
use crate::straight_line::LinePoint;

/// Kernels per second of the demonstration, and the fewest and the most.
const KERNELS_PER_S: f64 = 6.0;
const KERNELS: (f64, f64) = (25.0, 300.0);

/// A learned movement of a hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "MovementFields")]
pub struct Movement(MovementFields);

/// What a movement is made of, as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MovementFields {
    name: String,
    frame: String,
    duration_s: f64,
    position: DiscreteDmp,
    orientation: DiscreteOrientationDmp,
    learned_from: String,
}

impl TryFrom<MovementFields> for Movement {
    type Error = MotionError;

    fn try_from(fields: MovementFields) -> Result<Self, MotionError> {
        if fields.name.is_empty() {
            return Err(MotionError::Degenerate { what: "name", why: "it is empty" });
        }
        constant("duration_s", fields.duration_s)?;
        size("position", 3, fields.position.dofs())?;
        Ok(Self(fields))
    }
}

impl Movement {
    /// Learns the movement `name` from `poses` of the hand in `frame`, one every `dt` s, m and rad.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for fewer than four poses; also when a pose is not finite, `dt` is not positive, or the name is empty.
    pub fn learn(
        name: impl Into<String>,
        frame: impl Into<String>,
        dt: f64,
        poses: &[Isometry3<f64>],
        learned_from: impl Into<String>,
    ) -> Result<Self, MotionError> {
        sample_time(dt)?;
        let seconds = dt * poses.len() as f64;
        let kernels = (KERNELS_PER_S * seconds).clamp(KERNELS.0, KERNELS.1).round() as usize;
        let config = DiscreteDmpConfig { dofs: 3, kernels, ..DiscreteDmpConfig::default() };
        let mut position = DiscreteDmp::new(config.clone())?;
        let places: Vec<Vec<f64>> =
            poses.iter().map(|pose| pose.translation.vector.as_slice().to_vec()).collect();
        let duration_s = position.learn_batch(&differentiate(dt, &places)?)?;
        let mut orientation = DiscreteOrientationDmp::new(config)?;
        orientation.learn(dt, &poses.iter().map(|pose| pose.rotation).collect::<Vec<_>>())?;
        let (name, frame, learned_from) = (name.into(), frame.into(), learned_from.into());
        Self::try_from(MovementFields { name, frame, duration_s, position, orientation, learned_from })
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// The frame of its poses.
    pub fn frame(&self) -> &str {
        &self.0.frame
    }

    /// How long it takes at the speed at which it was shown, s.
    pub fn duration_s(&self) -> f64 {
        self.0.duration_s
    }

    /// The source from which it was learned.
    pub fn learned_from(&self) -> &str {
        &self.0.learned_from
    }

    /// The pose in which it begins.
    pub fn start(&self) -> Isometry3<f64> {
        self.play().pose()
    }

    /// The movement at its start, ready to be stepped.
    pub fn play(&self) -> MovementPlay {
        MovementPlay { movement: self.0.clone() }
    }
}

/// A movement that is being executed.
#[derive(Debug, Clone)]
pub struct MovementPlay {
    movement: MovementFields,
}

impl MovementPlay {
    /// Advances by `dt` s. After its end the movement rests at its goal.
    ///
    /// # Errors
    /// When `dt` is not positive; nothing is changed.
    pub fn step(&mut self, dt: f64) -> Result<LinePoint, MotionError> {
        sample_time(dt)?;
        let MovementFields { position, orientation, duration_s, .. } = &mut self.movement;
        position.step(dt, *duration_s)?;
        let turned = orientation.step(dt, *duration_s)?;
        let linear = Vector3::from_column_slice(position.state().yd);
        Ok(LinePoint { pose: self.pose(), linear, angular: turned.angular_velocity })
    }

    /// Its present pose.
    pub fn pose(&self) -> Isometry3<f64> {
        let place = Point3::from_slice(self.movement.position.state().y);
        Isometry3::from_parts(place.into(), self.movement.orientation.state().orientation)
    }

    /// The share of the duration that has passed; 1 at the end and more after it.
    pub fn progress(&self) -> f64 {
        self.movement.position.progress()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Through three corners and back, 0.55 m in 4 s with rounded corners, turned by 20 degrees.
    fn led(dt: f64) -> Vec<Isometry3<f64>> {
        let corners =
            [[0.0, 0.0, 0.0], [-0.15, 0.03, 0.05], [0.0, 0.12, 0.1], [0.08, -0.05, 0.0], [0.0, 0.0, 0.05]];
        let mut rounded = [Vector3::zeros(); 2];
        (0..(5.0 / dt) as usize)
            .map(|k| {
                let t = (k as f64 * dt - 0.3).clamp(0.0, 3.999);
                let (i, part) = (t as usize, t.fract());
                let [a, b] = [corners[i], corners[i + 1]].map(Vector3::from);
                let share = 1.0 - libm::exp(-dt / 0.12);
                rounded[0] += (a + (b - a) * part - rounded[0]) * share;
                let first = rounded[0];
                rounded[1] += (first - rounded[1]) * share;
                Isometry3::new(
                    Vector3::new(0.3, 0.5, 1.0) + rounded[1],
                    Vector3::new(0.0, 0.1, 0.35) * (t / 4.0),
                )
            })
            .collect()
    }

    #[test]
    fn what_was_led_is_played_again_and_survives_its_file() {
        let shown = led(0.02);
        let movement = Movement::learn("led", "root", 0.02, &shown, "a hand that was led").unwrap();
        let json = serde_json::to_string(&movement).unwrap();
        let movement: Movement = serde_json::from_str(&json).unwrap();
        assert!((movement.duration_s() - 4.98).abs() < 1e-9);
        assert!((movement.start().translation.vector - shown[0].translation.vector).norm() < 1e-9);
        let mut play = movement.play();
        let (mut off, mut turned, mut n) = (0.0_f64, 0.0_f64, 0.0);
        let mut last = movement.start();
        while play.progress() < 1.0 {
            let point = play.step(1e-3).unwrap();
            let k = (play.progress() * (shown.len() - 1) as f64).round() as usize;
            let at = &shown[k.min(shown.len() - 1)];
            off += (point.pose.translation.vector - at.translation.vector).norm_squared();
            turned = turned.max(point.pose.rotation.angle_to(&at.rotation));
            let moved = (point.pose.translation.vector - last.translation.vector) / 1e-3;
            assert!((moved - point.linear).norm() < 0.02, "{moved} {}", point.linear);
            last = point.pose;
            n += 1.0;
        }
        assert!((off / n).sqrt() < 2e-3, "{} m", (off / n).sqrt());
        assert!(turned < 0.02, "{turned} rad");
    }

    #[test]
    fn what_is_no_movement_is_refused() {
        let poses = led(0.02);
        assert!(Movement::learn("led", "root", 0.02, &poses[..3], "").is_err());
        assert!(Movement::learn("", "root", 0.02, &poses, "").is_err());
        assert!(Movement::learn("led", "root", 0.0, &poses, "").is_err());
        let mut json =
            serde_json::to_value(Movement::learn("led", "root", 0.02, &poses, "").unwrap()).unwrap();
        json["duration_s"] = 0.0.into();
        assert!(serde_json::from_value::<Movement>(json).is_err());
    }
}
