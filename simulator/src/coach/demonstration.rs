//! How the coach demonstrates the motion: the tool comes, swipes across the workspace, wipes in the air, and goes.
//!
//! A function from the time since the start to the tool's pose. All random deviations are drawn at the start.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::Rng;

use super::path::{CoachPath, Wobble};
use crate::world::DemonstrationSpec;

/// Time in which the tool comes and goes, s.
const COME_S: f64 = 1.5;
/// Rest before the swipe, s.
const REST: f64 = 0.8;
/// Rest after the swipe, s.
const PAUSE: f64 = 0.6;
/// Time to move to the start of the periodic path, s.
const GO: f64 = 1.0;
/// Time in which the periodic motion reaches full speed, and in which it comes to rest, s.
const RAMP: f64 = 0.5;
/// Mean speed of the swipe, m/s.
const SWIPE_SPEED: f64 = 0.10;
/// Where the tool comes from and goes to, relative to the path, m.
const AWAY: Vector3<f64> = Vector3::new(0.0, 0.40, 0.15);

/// A demonstration that has begun.
#[derive(Clone, Debug)]
pub struct Performance {
    path: CoachPath,
    from: Vector3<f64>,
    to: Vector3<f64>,
    height: f64,
    swipe_s: f64,
    periodic_s: f64,
    jitter: f64,
    position_wobble: [Wobble; 3],
    speed_wobble: Wobble,
    yaw_wobble: Wobble,
}

/// The coach's state at a time of the performance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolShown {
    /// Pose of the tool's middle.
    pub root_from_tool: Isometry3<f64>,
    /// Phase of the periodic path, rad, unwrapped, while it is performed.
    pub theta: Option<f64>,
}

impl Performance {
    /// Draws the random deviations of one performance over a table of height `table_height`, m.
    pub fn new(demonstration: &DemonstrationSpec, table_height: f64, rng: &mut impl Rng) -> Self {
        let height = table_height + demonstration.height;
        let at = |p: [f64; 2]| Vector3::new(p[0], p[1], height);
        let (from, to) = (at(demonstration.swipe.from), at(demonstration.swipe.to));
        Self {
            path: CoachPath::new(demonstration),
            from,
            to,
            height,
            swipe_s: ((to - from).norm() / SWIPE_SPEED).max(1.2),
            periodic_s: f64::from(demonstration.periods) / demonstration.frequency + RAMP,
            jitter: demonstration.jitter,
            position_wobble: std::array::from_fn(|_| Wobble::new(rng)),
            speed_wobble: Wobble::new(rng),
            yaw_wobble: Wobble::new(rng),
        }
    }

    /// Its duration, s.
    pub fn duration(&self) -> f64 {
        self.periodic_start() + self.periodic_s + COME_S
    }

    /// When the periodic part begins, s.
    pub fn periodic_start(&self) -> f64 {
        COME_S + REST + self.swipe_s + PAUSE + GO
    }

    /// The state `t` s after the start; `None` before the start and after the end.
    pub fn at(&self, t: f64) -> Option<ToolShown> {
        if !(0.0..=self.duration()).contains(&t) {
            return None;
        }
        let (position, theta) = self.steady(t);
        let half = self.path.half();
        let reach = half[0].abs().max(half[1].abs());
        let scale = Vector3::new(half[0], half[1], 0.5 * reach) * self.jitter;
        let wobble = Vector3::from_fn(|k, _| self.position_wobble[k].at(t));
        let yaw = self.jitter * self.yaw_wobble.at(t);
        let root_from_tool = Isometry3::from_parts(
            Translation3::from(position + wobble.component_mul(&scale)),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        );
        Some(ToolShown { root_from_tool, theta })
    }

    /// Position and phase without random deviations.
    fn steady(&self, t: f64) -> (Vector3<f64>, Option<f64>) {
        let on_path = |theta: f64| {
            let p = self.path.point(theta);
            Vector3::new(p[0], p[1], self.height)
        };
        let mut t = t;
        for (from, to, lasts) in [
            (self.from + AWAY, self.from, COME_S),
            (self.from, self.from, REST),
            (self.from, self.to, self.swipe_s),
            (self.to, self.to, PAUSE),
            (self.to, on_path(0.0), GO),
        ] {
            if t < lasts {
                return (from + (to - from) * minimum_jerk(t / lasts), None);
            }
            t -= lasts;
        }
        if t < self.periodic_s {
            let theta = self.theta(t);
            return (on_path(theta), Some(theta));
        }
        let end = on_path(self.theta(self.periodic_s));
        (end + AWAY * minimum_jerk((t - self.periodic_s) / COME_S), None)
    }

    /// The phase `t` s after the start of the periodic part: constant speed between two ramps, with the jitter
    /// added.
    fn theta(&self, t: f64) -> f64 {
        let ramped = |t: f64| if t < RAMP { t * t / (2.0 * RAMP) } else { t - RAMP / 2.0 };
        let rest = self.periodic_s - t;
        let steady =
            if rest < RAMP { self.periodic_s - RAMP - rest * rest / (2.0 * RAMP) } else { ramped(t) };
        TAU * self.path.frequency() * (steady + self.jitter * self.speed_wobble.integral(steady))
    }
}

/// Flash and Hogan's minimum-jerk profile from 0 to 1.
pub(crate) fn minimum_jerk(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn performance(jitter: f64) -> Performance {
        let d = DemonstrationSpec { jitter, ..DemonstrationSpec::default() };
        Performance::new(&d, 0.95, &mut ChaCha8Rng::seed_from_u64(3))
    }

    #[test]
    fn it_swipes_then_shows_the_path_at_its_frequency() {
        let p = performance(0.0);
        let at = |t| p.at(t).unwrap().root_from_tool.translation.vector;
        assert!((at(COME_S) - Vector3::new(0.20, 0.48, 1.15)).norm() < 1e-12);
        let swiped = at(COME_S + REST + p.swipe_s);
        assert!((swiped - Vector3::new(0.36, 0.58, 1.15)).norm() < 1e-12);
        let t = p.periodic_start() + 5.0;
        assert!((at(t) - at(t + 2.0)).norm() < 1e-12);
        assert!((at(t) - at(t + 1.0)).norm() > 0.05);
        assert_eq!(p.at(p.duration() + 0.1), None);
        let last = p.at(p.periodic_start() + p.periodic_s - 1e-9).unwrap().theta.unwrap();
        assert!((last - 15.0 * TAU).abs() < 1e-6);
    }

    #[test]
    fn it_never_jumps() {
        let p = performance(0.05);
        let mut last = p.at(0.0).unwrap().root_from_tool.translation.vector;
        let mut fastest = 0.0f64;
        for i in 1..(p.duration() * 1000.0) as u32 {
            let now = p.at(f64::from(i) * 1e-3).unwrap().root_from_tool.translation.vector;
            fastest = fastest.max((now - last).norm() * 1000.0);
            last = now;
        }
        assert!(fastest < 0.8, "{fastest}");
    }

    #[test]
    fn jitter_keeps_the_frequency() {
        let p = performance(0.05);
        let theta = |t: f64| p.at(p.periodic_start() + t).unwrap().theta.unwrap();
        let f = (theta(27.0) - theta(1.0)) / TAU / 26.0;
        assert!((f / 0.5 - 1.0).abs() < 0.003, "{f}");
    }
}
