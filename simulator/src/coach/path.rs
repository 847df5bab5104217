//! The coach's path, the unsteadiness of a hand, and a tracker for the phase of a motion along the path.
//!
//! Closed formulas and one tracker; independent of clock and robot.

use std::f64::consts::{PI, TAU};

use rand::{Rng, RngExt};

use crate::world::{DemonstrationSpec, PathShape};

/// The periodic part of a demonstration, in the horizontal plane of the root frame.
#[derive(Clone, Debug, PartialEq)]
pub struct CoachPath {
    shape: PathShape,
    center: [f64; 2],
    half: [f64; 2],
    frequency: f64,
}

impl CoachPath {
    /// The path of a demonstration, about the middle of its swipe.
    pub fn new(demonstration: &DemonstrationSpec) -> Self {
        let swipe = &demonstration.swipe;
        Self {
            shape: demonstration.shape,
            center: [(swipe.from[0] + swipe.to[0]) / 2.0, (swipe.from[1] + swipe.to[1]) / 2.0],
            half: demonstration.size.map(|s| s / 2.0),
            frequency: demonstration.frequency,
        }
    }

    /// The point at `theta` rad, m.
    pub fn point(&self, theta: f64) -> [f64; 2] {
        let y = match self.shape {
            PathShape::Ellipse => libm::sin(theta),
            PathShape::Eight => libm::sin(2.0 * theta),
            PathShape::Line => libm::cos(theta),
        };
        [self.center[0] + self.half[0] * libm::cos(theta), self.center[1] + self.half[1] * y]
    }

    /// The derivative of the point by `theta`, m/rad.
    pub fn tangent(&self, theta: f64) -> [f64; 2] {
        let y = match self.shape {
            PathShape::Ellipse => libm::cos(theta),
            PathShape::Eight => 2.0 * libm::cos(2.0 * theta),
            PathShape::Line => -libm::sin(theta),
        };
        [-self.half[0] * libm::sin(theta), self.half[1] * y]
    }

    /// The middle, m.
    pub fn center(&self) -> [f64; 2] {
        self.center
    }

    /// Half its width and depth, m; negative for a mirrored path.
    pub fn half(&self) -> [f64; 2] {
        self.half
    }

    /// Repetitions of the whole path per second, Hz.
    pub fn frequency(&self) -> f64 {
        self.frequency
    }
}

/// An angle between -pi and pi.
pub fn wrap(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// Smooth noise of zero mean and unit variance: seven sines between 0.3 and 2 Hz with random phases.
#[derive(Clone, Debug)]
pub struct Wobble {
    waves: [(f64, f64); 7],
}

impl Wobble {
    /// Draws the phases.
    pub fn new(rng: &mut impl Rng) -> Self {
        let waves = std::array::from_fn(|i| {
            let f = 0.3 + 1.7 * (i as f64 + rng.random::<f64>()) / 7.0;
            (TAU * f, TAU * rng.random::<f64>())
        });
        Self { waves }
    }

    /// The noise at a time, s.
    pub fn at(&self, t: f64) -> f64 {
        self.waves.iter().map(|(w, p)| libm::sin(w * t + p)).sum::<f64>() * (2.0f64 / 7.0).sqrt()
    }

    /// The integral of the noise from 0 to a time, s.
    pub fn integral(&self, t: f64) -> f64 {
        let sum: f64 = self.waves.iter().map(|(w, p)| (libm::cos(*p) - libm::cos(w * t + p)) / w).sum();
        sum * (2.0f64 / 7.0).sqrt()
    }
}

/// Samples of the path that the tracker compares with.
const SAMPLES: usize = 180;

/// Tracks the phase of a motion along the coach's path, or along a similar one.
///
/// It takes the nearest point in position and direction of motion, and prefers to continue from the last one. This
/// distinguishes the branches of crossings (eight) and doubled strokes (line). The path may be shifted: the tracker
/// follows its middle slowly.
#[derive(Clone, Debug)]
pub struct PhaseTracker {
    path: CoachPath,
    shift: [f64; 2],
    theta: Option<f64>,
    omega: f64,
}

impl PhaseTracker {
    /// A tracker along a path.
    pub fn new(path: CoachPath) -> Self {
        let omega = TAU * path.frequency;
        Self { path, shift: [0.0; 2], theta: None, omega }
    }

    /// The unwrapped phase, rad; it increases while the motion goes forward.
    pub fn theta(&self) -> Option<f64> {
        self.theta
    }

    /// The phase, 0 to 1.
    pub fn phase(&self) -> Option<f64> {
        self.theta.map(|t| (t / TAU).rem_euclid(1.0))
    }

    /// Rate of the phase, cycles/s, smoothed over 0.3 s.
    pub fn frequency(&self) -> f64 {
        self.omega / TAU
    }

    /// Takes the position, m, and velocity, m/s, `dt` s after the last; returns the unwrapped phase, rad.
    pub fn update(&mut self, position: [f64; 2], velocity: [f64; 2], dt: f64) -> f64 {
        self.follow_middle(position, dt);
        let predicted = self.theta.map(|t| t + self.omega * dt);
        let best = self.nearest(position, velocity, predicted);
        let theta = match predicted {
            None => best,
            Some(p) => p + (dt / 0.03).min(1.0) * wrap(best - p),
        };
        if let Some(old) = self.theta {
            let nominal = TAU * self.path.frequency;
            let rate = ((theta - old) / dt).clamp(0.0, 1.5 * nominal);
            self.omega += (dt / 0.3).min(1.0) * (rate - self.omega);
        }
        self.theta = Some(theta);
        theta
    }

    /// The middle of the motion lies within its extremes: a slow mean over about two periods.
    fn follow_middle(&mut self, position: [f64; 2], dt: f64) {
        let rate = (dt * self.path.frequency / 2.0).min(1.0);
        let middle = self.path.center;
        for ((shift, at), middle) in self.shift.iter_mut().zip(position).zip(middle) {
            *shift = (*shift + rate * (at - middle - *shift)).clamp(-0.2, 0.2);
        }
    }

    fn nearest(&self, position: [f64; 2], velocity: [f64; 2], predicted: Option<f64>) -> f64 {
        let scale = TAU * self.path.frequency;
        let half = self.path.half;
        let radius_squared = half[0] * half[0] + half[1] * half[1];
        let cost = |theta: f64| {
            let (p, d) = (self.path.point(theta), self.path.tangent(theta));
            let mut sum = 0.0;
            for k in 0..2 {
                sum += (position[k] - self.shift[k] - p[k]).powi(2);
                sum += 0.5 * (velocity[k] / scale - d[k]).powi(2);
            }
            sum + predicted.map_or(0.0, |p| 0.2 * radius_squared * wrap(theta - p).powi(2))
        };
        let mut best = (f64::INFINITY, 0.0);
        for i in 0..SAMPLES {
            let theta = TAU * i as f64 / SAMPLES as f64;
            let c = cost(theta);
            if c < best.0 {
                best = (c, theta);
            }
        }
        wrap(best.1 - PI) + PI
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn path(shape: PathShape) -> CoachPath {
        CoachPath::new(&DemonstrationSpec { shape, ..DemonstrationSpec::default() })
    }

    #[test]
    fn tangents_are_derivatives() {
        for shape in [PathShape::Ellipse, PathShape::Eight, PathShape::Line] {
            let p = path(shape);
            for i in 0..20 {
                let (t, h) = (f64::from(i) * 0.37, 1e-6);
                let (a, b, d) = (p.point(t - h), p.point(t + h), p.tangent(t));
                for k in 0..2 {
                    assert!(((b[k] - a[k]) / (2.0 * h) - d[k]).abs() < 1e-8);
                }
            }
        }
    }

    #[test]
    fn the_middle_is_the_swipes() {
        let c = path(PathShape::Eight).center();
        assert!((c[0] - 0.28).abs() < 1e-12 && (c[1] - 0.53).abs() < 1e-12);
    }

    #[test]
    fn wobble_has_unit_variance_and_the_right_integral() {
        let w = Wobble::new(&mut ChaCha8Rng::seed_from_u64(1));
        let n = 200_000;
        let mean_square: f64 = (0..n).map(|i| w.at(f64::from(i) * 0.01).powi(2)).sum::<f64>() / f64::from(n);
        assert!((mean_square - 1.0).abs() < 0.02, "{mean_square}");
        let h = 1e-6;
        assert!(((w.integral(3.0 + h) - w.integral(3.0 - h)) / (2.0 * h) - w.at(3.0)).abs() < 1e-6);
        assert_eq!(w.integral(0.0), 0.0);
    }

    /// Along each shape, shifted, at another speed than the coach's, the phase is found within a twentieth of a period.
    #[test]
    fn the_phase_is_tracked() {
        for shape in [PathShape::Ellipse, PathShape::Eight, PathShape::Line] {
            for (shift, speed) in [([0.0, 0.0], 1.0), ([0.01, 0.03], 1.0), ([0.0, 0.0], 0.6)] {
                let p = path(shape);
                let mut tracker = PhaseTracker::new(p.clone());
                let omega = TAU * p.frequency() * speed;
                let dt = 0.005;
                for i in 0..4000 {
                    let theta = omega * dt * f64::from(i);
                    let (x, d) = (p.point(theta), p.tangent(theta));
                    let at = [x[0] + shift[0], x[1] + shift[1]];
                    let found = tracker.update(at, d.map(|v| v * omega), dt);
                    if i > 2000 {
                        let error = wrap(found - theta).abs();
                        assert!(error < 0.31, "{shape:?} {shift:?} {speed} {error}");
                    }
                }
            }
        }
    }
}
