//! A model of the tangential force at the wrist that wiping itself causes, learned while wiping. The rest of the
//! force is a push.
//!
//! Friction is Coulomb's with presliding: a bristle bends with the motion up to its full deflection, so that a
//! reversal does not look like a hit. Recursive least squares estimate the friction coefficient and a slow bias.
//! The bending law (in proportion to the displacement up to its limit, as a sponge shears, or exponentially, as
//! Dahl's) and the presliding length are selected from several candidates that run in parallel. During a push the
//! model learns hardly anything.

use std::f64::consts::FRAC_PI_4;

use nalgebra::{Matrix3, RowVector3, Vector2, Vector3};

use crate::constants::POSITIVE;
use crate::error::{MotionError, finite, positive, within};

constants! {
    /// The constants of a [`FrictionModel`].
    pub struct FrictionConfig {
        /// First guess of the friction coefficient.
        mu: f64 = 0.4, 0.0..=10.0;
        /// Time constant of coefficient and bias, s.
        memory: f64 = 15.0, POSITIVE;
        /// The model counts as learned after this much sliding, m.
        learning_distance: f64 = 0.4, POSITIVE;
        /// After learning, a residual larger than this counts as a push and is hardly learned from, N.
        gate: f64 = 3.0, POSITIVE;
        /// Time constant that smooths the residual, s.
        smoothing: f64 = 0.02, POSITIVE;
    }
}

/// Presliding lengths of the candidates, m.
const LENGTHS: [f64; 9] = [1e-4, 3e-4, 6e-4, 1e-3, 1.7e-3, 3e-3, 5e-3, 8e-3, 1.3e-2];

/// Index of the candidate that bounds how late the friction reverses after the motion: 3 mm, elastic.
const TURNS_WITHIN: usize = 10;

/// The bending law of a bristle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bend {
    /// In proportion to the displacement, up to its limit.
    Elastic,
    /// Towards its limit exponentially (Dahl).
    Dahl,
}

/// One presliding length and bending law with its own estimate.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    length: f64,
    bend: Bend,
    /// Deflection of the bristle, of length 1 at most, along the motion.
    bristle: Vector2<f64>,
    /// mu and the bias, N.
    estimate: Vector3<f64>,
    covariance: Matrix3<f64>,
    /// Mean square of the residual, N^2.
    square: f64,
    residual: Vector2<f64>,
}

/// Predicts the tangential force of wiping.
#[derive(Debug, Clone)]
pub struct FrictionModel {
    config: FrictionConfig,
    candidates: [Candidate; 18],
    best: usize,
    slid: f64,
    smooth: Vector2<f64>,
}

impl FrictionModel {
    /// A model before its first sample.
    ///
    /// # Errors
    /// When a constant is invalid.
    pub fn new(config: FrictionConfig) -> Result<Self, MotionError> {
        config.check_ranges()?;
        let candidate = |i: usize| Candidate {
            length: LENGTHS[i / 2],
            bend: if i.is_multiple_of(2) { Bend::Elastic } else { Bend::Dahl },
            bristle: Vector2::zeros(),
            estimate: Vector3::new(config.mu, 0.0, 0.0),
            covariance: initial_covariance(),
            square: 1.0,
            residual: Vector2::zeros(),
        };
        Ok(Self {
            candidates: std::array::from_fn(candidate),
            best: 8,
            slid: 0.0,
            smooth: Vector2::zeros(),
            config,
        })
    }

    /// Advances by `dt` s with the normal force `normal` (N, pressing is positive), the velocity of the hand along
    /// the surface (m/s) and the force on the hand along the surface (N), in the same two axes. Returns the push:
    /// the smoothed force that friction and bias do not explain, N. Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive or a value is not finite; nothing is changed.
    pub fn step(
        &mut self,
        dt: f64,
        normal: f64,
        velocity: [f64; 2],
        force: [f64; 2],
    ) -> Result<[f64; 2], MotionError> {
        positive("dt", dt)?;
        within("normal force", normal, -1e6, 1e6)?;
        finite("velocity", &velocity)?;
        for f in force {
            within("tangential force", f, -1e6, 1e6)?;
        }
        let (velocity, force) = (Vector2::from(velocity), Vector2::from(force));
        let way = velocity.norm() * dt;
        let normal = normal.max(0.0);
        if normal > 1.0 {
            self.slid += way.min(0.01);
        }
        for candidate in &mut self.candidates {
            candidate.bend(velocity, way);
            candidate.explain(normal, force);
        }
        // A force that any candidate explains is no push, so that no candidate has an advantage from treating
        // friction as a push.
        let least = self.candidates.iter().map(|c| c.residual.norm()).fold(f64::INFINITY, f64::min);
        let pushed = self.learned() && least > self.config.gate;
        let unexplained = self.unexplained(normal, force);
        let learned = self.learned();
        for candidate in &mut self.candidates {
            candidate.score(&self.config, dt, pushed);
            candidate.learn(&self.config, dt, normal, force, learned);
        }
        self.choose();
        let share = 1.0 - libm::exp(-dt / self.config.smoothing);
        self.smooth += (unexplained - self.smooth) * share;
        Ok(self.smooth.into())
    }

    fn choose(&mut self) {
        for i in 0..self.candidates.len() {
            if self.candidates[i].square < 0.9 * self.candidates[self.best].square {
                self.best = i;
            }
        }
    }

    /// The difference between the force and the nearest force that wiping may explain: the friction of each
    /// candidate that is about as good as the best one, and, during a reversal, any value between the friction
    /// before and after it. There the tool, which hangs from the hand, reverses earlier or later than the hand.
    fn unexplained(&self, normal: f64, force: Vector2<f64>) -> Vector2<f64> {
        let best = &self.candidates[self.best];
        let plausible = |c: &&Candidate| c.square <= 1.7 * best.square + 0.02;
        let smaller =
            |a: &&Candidate, b: &&Candidate| a.residual.norm_squared().total_cmp(&b.residual.norm_squared());
        let single = self.candidates.iter().filter(plausible).min_by(smaller).unwrap_or(best).residual;
        let limit = best.estimate.x * normal;
        let late = &self.candidates[TURNS_WITHIN];
        let turn = Reversal { before: -late.bristle * limit, after: -self.candidates[0].bristle * limit };
        let force = force - Vector2::new(best.estimate.y, best.estimate.z);
        let turning = force - turn.nearest(force);
        // A contact with a longer presliding length reverses as the candidates do.
        let sharp = self.best < TURNS_WITHIN + 2;
        if sharp && turning.norm_squared() < single.norm_squared() { turning } else { single }
    }

    /// The push at the last step, N.
    pub fn push(&self) -> [f64; 2] {
        self.smooth.into()
    }

    /// The friction coefficient.
    pub fn mu(&self) -> f64 {
        self.candidates[self.best].estimate.x
    }

    /// The bias, N.
    pub fn bias(&self) -> [f64; 2] {
        [self.candidates[self.best].estimate.y, self.candidates[self.best].estimate.z]
    }

    /// Whether the hand has slid far enough for the model to be reliable.
    pub fn learned(&self) -> bool {
        self.slid >= self.config.learning_distance
    }
}

fn initial_covariance() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(0.25, 4.0, 4.0))
}

impl Candidate {
    /// Bends the bristle by a displacement of `way` m; exact for constant velocity.
    fn bend(&mut self, velocity: Vector2<f64>, way: f64) {
        let Some(direction) = velocity.try_normalize(1e-12) else { return };
        match self.bend {
            Bend::Elastic => {
                self.bristle += direction * (way / self.length);
                self.bristle /= self.bristle.norm().max(1.0);
            }
            Bend::Dahl => {
                self.bristle = direction + (self.bristle - direction) * libm::exp(-way / self.length);
            }
        }
    }

    fn explain(&mut self, normal: f64, force: Vector2<f64>) {
        let bias = Vector2::new(self.estimate.y, self.estimate.z);
        self.residual = force + self.bristle * (self.estimate.x * normal) - bias;
    }

    /// Updates how well it explains the force without pushes.
    fn score(&mut self, config: &FrictionConfig, dt: f64, pushed: bool) {
        let trust = if pushed { 0.01 } else { 1.0 };
        let share = 1.0 - libm::exp(-trust * dt / (0.3 * config.memory));
        let square = self.residual.norm_squared().min(4.0 * config.gate * config.gate);
        self.square += (square - self.square) * share;
    }

    fn learn(&mut self, config: &FrictionConfig, dt: f64, normal: f64, force: Vector2<f64>, learned: bool) {
        let pushed = learned && self.residual.norm() > config.gate;
        let trust = if pushed { 0.01 } else { 1.0 };
        if normal < 1.0 {
            return;
        }
        let forgetting = libm::exp(-trust * dt / config.memory);
        let rows = [
            RowVector3::new(-normal * self.bristle.x, 1.0, 0.0),
            RowVector3::new(-normal * self.bristle.y, 0.0, 1.0),
        ];
        for (row, value) in rows.into_iter().zip([force.x, force.y]) {
            self.least_squares(&row, value, trust * dt / 0.001);
        }
        self.covariance /= forgetting;
        // Directions that are not excited keep their present estimate.
        for i in 0..3 {
            let most = initial_covariance()[(i, i)];
            if self.covariance[(i, i)] > most {
                let scale = (most / self.covariance[(i, i)]).sqrt();
                let mut squeeze = Vector3::repeat(1.0);
                squeeze[i] = scale;
                let squeeze = Matrix3::from_diagonal(&squeeze);
                self.covariance = squeeze * self.covariance * squeeze;
            }
        }
        self.estimate.x = self.estimate.x.clamp(0.0, 3.0);
    }

    /// One row of recursive least squares with weight `weight`; the noise of a sample is assumed to be 1 N.
    fn least_squares(&mut self, row: &RowVector3<f64>, value: f64, weight: f64) {
        let spread = self.covariance * row.transpose();
        let gain = spread / (1.0 / weight + (row * spread).x);
        self.estimate += gain * (value - (row * self.estimate).x);
        self.covariance -= gain * spread.transpose();
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
    }
}

/// Friction that changes from one direction to another, N.
struct Reversal {
    before: Vector2<f64>,
    after: Vector2<f64>,
}

impl Reversal {
    /// The nearest value to `force` that may occur during the change: its direction is between the two, its
    /// magnitude between that of their mean (a straight reversal goes through zero) and that of the larger one.
    fn nearest(&self, force: Vector2<f64>) -> Vector2<f64> {
        let least = 0.5 * (self.before + self.after).norm();
        let most = self.before.norm().max(self.after.norm());
        let size = force.norm().clamp(least.min(most), most);
        let mean = self.before + self.after;
        let (Some(middle), Some(wing)) = (mean.try_normalize(1e-6), self.before.try_normalize(1e-9)) else {
            return force.try_normalize(1e-9).map_or_else(Vector2::zeros, |u| u * size);
        };
        let half = libm::acos(middle.dot(&wing).clamp(-1.0, 1.0));
        // The larger the change of direction, the less is known about the side over which it goes.
        let half = half + 3.0 * (half - FRAC_PI_4).max(0.0);
        let angle = libm::atan2(middle.perp(&force), middle.dot(&force)).clamp(-half, half);
        let (sin, cos) = libm::sincos(angle);
        let direction = Vector2::new(cos * middle.x - sin * middle.y, sin * middle.x + cos * middle.y);
        direction * direction.dot(&force).clamp(least.min(most), most)
    }
}

#[cfg(test)]
mod tests;
