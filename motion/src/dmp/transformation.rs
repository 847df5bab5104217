//! The transformation system of a primitive: a critically damped spring to the goal, driven by the forcing term. As
//! a function of the phase it is linear with constant coefficients, and is therefore integrated exactly.
//!
//! It does not know the kernels: the forcing term is passed in.

use serde::{Deserialize, Serialize};

use crate::error::{MotionError, finite};

/// The integration method of a primitive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Exact for the linear part, with the mean forcing term over the step; stable for every step size.
    #[default]
    Exact,
    /// Explicit Euler as in the papers' experiments; refuses steps that are too large to be stable.
    Euler,
}

/// How fast the phase runs: a periodic movement at a frequency, a discrete one over a duration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum TimeScale {
    /// Omega, rad/s; not negative.
    Frequency(f64),
    /// `tau = 1 / Omega`, s; positive.
    Duration(f64),
}

impl TimeScale {
    /// Advance of the phase in `dt` s: rad, or a share of the duration.
    pub(crate) fn advance(self, dt: f64) -> f64 {
        match self {
            Self::Frequency(omega) => omega * dt,
            Self::Duration(duration) => dt / duration,
        }
    }

    /// Velocity (unit / s) from the derivative with respect to the phase.
    pub(crate) fn velocity(self, slope: f64) -> f64 {
        match self {
            Self::Frequency(omega) => omega * slope,
            Self::Duration(duration) => slope / duration,
        }
    }

    /// Acceleration (unit / s^2) from the second derivative with respect to the phase.
    pub(crate) fn acceleration(self, curvature: f64) -> f64 {
        match self {
            Self::Frequency(omega) => omega * omega * curvature,
            Self::Duration(duration) => curvature / (duration * duration),
        }
    }

    /// The derivative with respect to the phase from a velocity (unit / s).
    pub(crate) fn slope(self, velocity: f64) -> f64 {
        match self {
            Self::Frequency(omega) => velocity / omega,
            Self::Duration(duration) => duration * velocity,
        }
    }

    /// The second derivative with respect to the phase from an acceleration (unit / s^2).
    pub(crate) fn curvature(self, acceleration: f64) -> f64 {
        match self {
            Self::Frequency(omega) => acceleration / (omega * omega),
            Self::Duration(duration) => duration * duration * acceleration,
        }
    }
}

/// State and constants of the transformation system; one value per degree of freedom.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Transformation {
    alpha: f64,
    beta: f64,
    /// The goal, or the centre of a periodic movement.
    pub(crate) goal: Vec<f64>,
    pub(crate) y: Vec<f64>,
    /// Derivative with respect to the phase, without the added velocity.
    pub(crate) z: Vec<f64>,
    pub(crate) yd: Vec<f64>,
    pub(crate) ydd: Vec<f64>,
    /// Added to the forcing term in the next step only.
    pub(crate) perturbation: Vec<f64>,
    /// The state after the step, until it is known to be finite.
    next_y: Vec<f64>,
    next_z: Vec<f64>,
}

impl Transformation {
    pub(super) fn new(dofs: usize, alpha: f64, beta: f64) -> Self {
        let zeros = || vec![0.0; dofs];
        Self {
            alpha,
            beta,
            goal: zeros(),
            y: zeros(),
            z: zeros(),
            yd: zeros(),
            ydd: zeros(),
            perturbation: zeros(),
            next_y: zeros(),
            next_z: zeros(),
        }
    }

    pub(crate) fn dofs(&self) -> usize {
        self.y.len()
    }

    /// Sets the state to position `y` and velocity `yd` (unit / s); the sizes must match.
    pub(crate) fn put(&mut self, y: &[f64], yd: &[f64], scale: TimeScale) {
        self.y.copy_from_slice(y);
        self.yd.copy_from_slice(yd);
        for (z, v) in self.z.iter_mut().zip(yd) {
            *z = scale.slope(*v);
        }
    }

    /// Sets the state to position `y` and derivative `z` with respect to the phase; the sizes must match.
    pub(crate) fn put_slope(&mut self, y: &[f64], z: &[f64], scale: TimeScale) {
        self.y.copy_from_slice(y);
        self.z.copy_from_slice(z);
        for (yd, z) in self.yd.iter_mut().zip(z) {
            *yd = scale.velocity(*z);
        }
    }

    /// The forcing term for which the movement has position `y` and derivatives `dy`, `ddy` with respect to the
    /// phase, for a given goal.
    pub(crate) fn forcing(&self, goal: f64, y: f64, dy: f64, ddy: f64) -> f64 {
        ddy - self.pull(goal, y, dy)
    }

    fn pull(&self, goal: f64, y: f64, z: f64) -> f64 {
        self.alpha * (self.beta * (goal - y) - z)
    }

    /// State after `dt` s, exact for a forcing term and a velocity input that are constant over the step.
    pub(super) fn advance_exactly(
        &mut self,
        dt: f64,
        scale: TimeScale,
        forcing: impl Fn(usize) -> f64,
        input: impl Fn(usize) -> f64,
    ) {
        let advance = scale.advance(dt);
        let transition = StepMatrix::new(self.alpha, self.beta, advance);
        let stiffness = self.alpha * self.beta;
        let now = self.y.iter().zip(&self.z).zip(self.goal.iter().zip(&self.perturbation));
        let next = self.next_y.iter_mut().zip(&mut self.next_z);
        for (d, ((next_y, next_z), ((y, z), (goal, perturbation)))) in next.zip(now).enumerate() {
            let u = input(d);
            if u != 0.0 && advance == 0.0 {
                // The phase stands still: only the input moves the state.
                (*next_y, *next_z) = (y + u * dt, *z);
                continue;
            }
            let mut rest = goal + (forcing(d) + perturbation) / stiffness;
            let mut slope = 0.0;
            if u != 0.0 {
                slope = scale.slope(u);
                rest += slope / self.beta;
            }
            let (offset, z) = transition.apply(y - rest, z + slope);
            (*next_y, *next_z) = (rest + offset, z - slope);
        }
    }

    /// State after `dt` s by Euler's rule.
    pub(super) fn advance_by_euler(&mut self, dt: f64, scale: TimeScale, forcing: impl Fn(usize) -> f64) {
        let advance = scale.advance(dt);
        for d in 0..self.dofs() {
            let pull = self.pull(self.goal[d], self.y[d], self.z[d]);
            self.next_y[d] = self.y[d] + advance * self.z[d];
            self.next_z[d] = self.z[d] + advance * (pull + forcing(d) + self.perturbation[d]);
        }
    }

    /// Refuses a step whose result is not finite.
    pub(super) fn check(&self) -> Result<(), MotionError> {
        finite("position", &self.next_y)?;
        finite("velocity", &self.next_z)
    }

    /// Accepts the step; `forcing` and `input` are the values at its end.
    pub(super) fn commit(
        &mut self,
        scale: TimeScale,
        forcing: impl Fn(usize) -> f64,
        input: impl Fn(usize) -> f64,
    ) {
        std::mem::swap(&mut self.y, &mut self.next_y);
        std::mem::swap(&mut self.z, &mut self.next_z);
        let (alpha, beta) = (self.alpha, self.beta);
        let state = self.y.iter().zip(&self.z).zip(self.goal.iter().zip(&mut self.perturbation));
        let derivatives = self.yd.iter_mut().zip(&mut self.ydd);
        for (d, ((yd, ydd), ((y, z), (goal, perturbation)))) in derivatives.zip(state).enumerate() {
            let pull = alpha * (beta * (goal - y) - z);
            *yd = scale.velocity(*z) + input(d);
            *ydd = scale.acceleration(pull + forcing(d) + *perturbation);
            *perturbation = 0.0;
        }
    }
}

/// The value of `alpha_z * omega * dt` from which Euler's rule on (4), (5) is no longer stable (Jury's criterion on
/// `l^2 - (2 - u) l + 1 - u + u^2 beta / alpha`): 4 for critical damping.
pub(crate) fn widest_euler_step(alpha: f64, beta: f64) -> f64 {
    let ratio = beta / alpha;
    if 4.0 * ratio < 1.0 { 4.0 / (1.0 + (1.0 - 4.0 * ratio).sqrt()) } else { 1.0 / ratio }
}

/// The exact transition of `(y - rest, z)` over a phase step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepMatrix {
    yy: f64,
    yz: f64,
    zy: f64,
    zz: f64,
}

impl StepMatrix {
    /// `exp(M advance)` of `M = [[0, 1], [-alpha beta, -alpha]]`, in its three cases.
    pub(crate) fn new(alpha: f64, beta: f64, advance: f64) -> Self {
        let half = 0.5 * alpha;
        let stiffness = alpha * beta;
        let squared = stiffness - half * half;
        // exp(-half a) times cos and sin / rate, written so that nothing overflows for wide steps.
        let (cosine, sine) = if squared > 1e-12 * stiffness {
            let rate = squared.sqrt();
            let decay = libm::exp(-half * advance);
            (decay * libm::cos(rate * advance), decay * libm::sin(rate * advance) / rate)
        } else if squared < -1e-12 * stiffness {
            let rate = (-squared).sqrt();
            let slow = libm::exp((rate - half) * advance);
            let fast = libm::exp((-rate - half) * advance);
            (0.5 * (slow + fast), 0.5 * (slow - fast) / rate)
        } else {
            let decay = libm::exp(-half * advance);
            (decay, decay * advance)
        };
        Self { yy: cosine + half * sine, yz: sine, zy: -stiffness * sine, zz: cosine - half * sine }
    }

    pub(crate) fn apply(&self, y: f64, z: f64) -> (f64, f64) {
        (self.yy * y + self.yz * z, self.zy * y + self.zz * z)
    }
}
