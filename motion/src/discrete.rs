//! The discrete dynamic movement primitive of n degrees of freedom: from where it starts to a goal, on a phase that
//! decays. It takes the same two couplings as [`crate::PeriodicDmp`]: one that only perturbs (eq. 12) and one that the
//! weights learn (eq. 13), with which point-to-point movements are coached from one execution to the next.
//!
//! Learning from data is in `discrete_learning`. What it is not: it does not blend into a periodic motion.

use serde::{Deserialize, Serialize};

use crate::decay_kernels::DecayKernels;
use crate::error::{LARGEST, MotionError, constant, finite, positive, vector, within};
use crate::pdmp::Transition;

mod saved;

/// The constants of a [`DiscreteDmp`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscreteDmpConfig {
    /// Degrees of freedom n, at least 1.
    pub dofs: usize,
    /// Kernels N a degree of freedom, at least 2.
    pub kernels: usize,
    /// How fast the phase decays: it ends at `exp(-alpha_x)`. Small enough that the end can still be shaped.
    pub alpha_x: f64,
    /// Stiffness constant of (4), for one duration.
    pub alpha_z: f64,
    /// Damping constant of (4); `alpha_z / 4` makes it critically damped.
    pub beta_z: f64,
    /// Forgetting factor lambda of (9) for each 10 ms of learning, in (0, 1].
    pub forgetting: f64,
    /// P(0) of (9), which is also the most that P may grow to where a kernel is not visited.
    pub initial_gain: f64,
}

impl Default for DiscreteDmpConfig {
    fn default() -> Self {
        Self {
            dofs: 1,
            kernels: 25,
            alpha_x: 2.0,
            alpha_z: 48.0,
            beta_z: 12.0,
            forgetting: 0.9995,
            initial_gain: 1.0,
        }
    }
}

impl DiscreteDmpConfig {
    /// The default constants for `dofs` degrees of freedom.
    #[must_use]
    pub fn with_dofs(dofs: usize) -> Self {
        Self { dofs, ..Self::default() }
    }

    fn validate(&self) -> Result<(), MotionError> {
        within("dofs", self.dofs as f64, 1.0, 4096.0)?;
        within("kernels", self.kernels as f64, 2.0, 4096.0)?;
        within("alpha_x", self.alpha_x, 1e-3, 100.0)?;
        constant("alpha_z", self.alpha_z)?;
        constant("beta_z", self.beta_z)?;
        within("forgetting", self.forgetting, 1e-6, 1.0)?;
        constant("initial_gain", self.initial_gain)
    }
}

/// What a step yields; the slices have one value a degree of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscreteState<'a> {
    /// Phase, 1 at the start and `exp(-alpha_x)` after the duration.
    pub x: f64,
    /// Position, in the unit of the degree of freedom.
    pub y: &'a [f64],
    /// Velocity, unit / s.
    pub yd: &'a [f64],
    /// Acceleration, unit / s^2.
    pub ydd: &'a [f64],
}

/// A point-to-point movement of n degrees of freedom on one phase.
///
/// # Source
/// Ijspeert, Nakanishi, Hoffmann, Pastor and Schaal, "Dynamical movement primitives", Neural Computation 2013, in the
/// form of Petrič et al. (4)-(13): `tau z' = alpha_z (beta_z (g - y) - z) + f + C`, `tau y' = z`, `tau x' = -alpha_x x`,
/// `f = sum w psi / sum psi * x r`. Differs in: f is scaled by an amplitude r instead of the distance `g - y0`, which
/// may be 0; with goal, start and r scaled together the movement scales exactly.
///
/// ```
/// use armarium_motion::{DiscreteDmp, DiscreteDmpConfig, TimeSample};
///
/// // From 0 to 1 m in 2 s as half a cosine, seen at 50 Hz.
/// let w = std::f64::consts::FRAC_PI_2;
/// let sample = |k: i32| {
///     let (t, (sin, cos)) = (f64::from(k) * 0.02, (w * f64::from(k) * 0.02).sin_cos());
///     TimeSample { t, y: vec![0.5 - 0.5 * cos], yd: vec![0.5 * w * sin], ydd: vec![0.5 * w * w * cos] }
/// };
/// let mut dmp = DiscreteDmp::new(DiscreteDmpConfig::with_dofs(1))?;
/// let duration = dmp.learn_batch(&(0..=100).map(sample).collect::<Vec<_>>())?;
/// // The same to another goal, in half the time.
/// dmp.set_goal(&[1.2])?;
/// for _ in 0..1500 {
///     dmp.step(0.001, 0.5 * duration)?;
/// }
/// assert!((dmp.state().y[0] - 1.2).abs() < 0.01);
/// # Ok::<(), armarium_motion::MotionError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "saved::Saved", into = "saved::Saved")]
pub struct DiscreteDmp {
    pub(crate) config: DiscreteDmpConfig,
    pub(crate) kernels: DecayKernels,
    pub(crate) start: Vec<f64>,
    pub(crate) goal: Vec<f64>,
    pub(crate) amplitude: f64,
    /// Degree of freedom by degree of freedom: `weights[d * kernels + i]`.
    pub(crate) weights: Vec<f64>,
    /// P of (9), one a kernel.
    pub(crate) gain: Vec<f64>,
    x: f64,
    y: Vec<f64>,
    z: Vec<f64>,
    yd: Vec<f64>,
    ydd: Vec<f64>,
    perturbation: Vec<f64>,
    coupling: Vec<f64>,
    coupled: bool,
    /// Kernel values and forcing term at the phase of now, valid while `fresh`.
    pub(crate) psi: Vec<f64>,
    forcing: Vec<f64>,
    pub(crate) fresh: bool,
    next_forcing: Vec<f64>,
    next_y: Vec<f64>,
    next_z: Vec<f64>,
}

impl DiscreteDmp {
    /// A primitive at rest at its goal 0: all weights 0, amplitude 1.
    ///
    /// # Errors
    /// [`MotionError::OutOfRange`] or [`MotionError::NotFinite`] names the constant that cannot be.
    pub fn new(config: DiscreteDmpConfig) -> Result<Self, MotionError> {
        config.validate()?;
        let (n, k) = (config.dofs, config.kernels);
        let zeros = || vec![0.0; n];
        Ok(Self {
            kernels: DecayKernels::new(k, config.alpha_x),
            gain: vec![config.initial_gain; k],
            config,
            start: zeros(),
            goal: zeros(),
            amplitude: 1.0,
            weights: vec![0.0; n * k],
            x: 1.0,
            y: zeros(),
            z: zeros(),
            yd: zeros(),
            ydd: zeros(),
            perturbation: zeros(),
            coupling: zeros(),
            coupled: false,
            psi: vec![0.0; k],
            forcing: zeros(),
            fresh: false,
            next_forcing: zeros(),
            next_y: zeros(),
            next_z: zeros(),
        })
    }

    /// The constants.
    #[must_use]
    pub fn config(&self) -> &DiscreteDmpConfig {
        &self.config
    }

    /// Degrees of freedom n.
    #[must_use]
    pub fn dofs(&self) -> usize {
        self.config.dofs
    }

    /// All weights, degree of freedom by degree of freedom, N each.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Replaces all weights; the state stays.
    ///
    /// # Errors
    /// When their number is not `dofs * kernels` or one is not finite.
    pub fn set_weights(&mut self, weights: &[f64]) -> Result<(), MotionError> {
        vector("weights", self.weights.len(), weights)?;
        self.weights.copy_from_slice(weights);
        self.fresh = false;
        Ok(())
    }

    /// Where the demonstration began, one value a degree of freedom.
    #[must_use]
    pub fn demonstrated_start(&self) -> &[f64] {
        &self.start
    }

    /// Where the movement ends, one value a degree of freedom.
    #[must_use]
    pub fn goal(&self) -> &[f64] {
        &self.goal
    }

    /// Moves the goal, also while running; the position follows smoothly.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    pub fn set_goal(&mut self, goal: &[f64]) -> Result<(), MotionError> {
        vector("goal", self.goal.len(), goal)?;
        self.goal.copy_from_slice(goal);
        Ok(())
    }

    /// Amplitude factor r of (6), dimensionless.
    #[must_use]
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// Scales the shape of the movement (not its goal).
    ///
    /// # Errors
    /// When the factor is not finite.
    pub fn set_amplitude(&mut self, amplitude: f64) -> Result<(), MotionError> {
        vector("amplitude", 1, &[amplitude])?;
        self.amplitude = amplitude;
        self.fresh = false;
        Ok(())
    }

    /// Puts the primitive to its beginning at position `y` with velocity `yd` (unit / s), for a movement of `duration`
    /// s. What was learned stays.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite or `duration` is not positive; nothing is changed.
    pub fn begin(&mut self, y: &[f64], yd: &[f64], duration: f64) -> Result<(), MotionError> {
        vector("y", self.y.len(), y)?;
        vector("yd", self.y.len(), yd)?;
        constant("duration", duration)?;
        self.x = 1.0;
        self.y.copy_from_slice(y);
        self.yd.copy_from_slice(yd);
        for (z, v) in self.z.iter_mut().zip(yd) {
            *z = v * duration;
        }
        self.perturbation.fill(0.0);
        self.coupled = false;
        self.fresh = false;
        Ok(())
    }

    /// The state after the last step.
    #[must_use]
    pub fn state(&self) -> DiscreteState<'_> {
        DiscreteState { x: self.x, y: &self.y, yd: &self.yd, ydd: &self.ydd }
    }

    /// Which share of the duration has passed, 1 at its end and more after it.
    #[must_use]
    pub fn progress(&self) -> f64 {
        -self.x.ln() / self.config.alpha_x
    }

    /// Adds `c` (one a degree of freedom) to (4) for the next step only: the movement gives way and comes back.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    ///
    /// # Source
    /// Eq. (12).
    pub fn perturb(&mut self, c: &[f64]) -> Result<(), MotionError> {
        vector("perturbation", self.perturbation.len(), c)?;
        self.perturbation.copy_from_slice(c);
        Ok(())
    }

    /// Hands the coupling term `c` to the weights in the next step: the next executions keep it.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    ///
    /// # Source
    /// Eqs. (9), (10), (13) with `x r` in place of r.
    pub fn couple(&mut self, c: &[f64]) -> Result<(), MotionError> {
        vector("coupling", self.coupling.len(), c)?;
        self.coupling.copy_from_slice(c);
        self.coupled = true;
        Ok(())
    }

    /// Advances by `dt` s of a movement of `duration` s, which may change while it runs. After the duration the
    /// position goes on to the goal. Does not allocate.
    ///
    /// # Errors
    /// When `dt` or `duration` is not positive or the result would not be finite; the state is unchanged.
    pub fn step(&mut self, dt: f64, duration: f64) -> Result<DiscreteState<'_>, MotionError> {
        positive("dt", dt)?;
        constant("duration", duration)?;
        let advance = dt / duration;
        within("dt / duration", advance, 0.0, LARGEST)?;
        self.refresh();
        if self.coupled {
            let coupling = std::mem::take(&mut self.coupling);
            self.update_weights(dt, self.x, &coupling);
            self.coupling = coupling;
        }
        // The floor keeps the kernels' arguments apart from 0, long after the end.
        let x = (self.x * (-self.config.alpha_x * advance).exp()).max(1e-12);
        self.evaluate_forcing(x);
        self.fresh = false;
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        let transition = Transition::new(alpha, beta, advance);
        for d in 0..self.y.len() {
            let forcing = 0.5 * (self.forcing[d] + self.next_forcing[d]) + self.perturbation[d];
            let rest = self.goal[d] + forcing / (alpha * beta);
            let (offset, z) = transition.apply(self.y[d] - rest, self.z[d]);
            self.next_y[d] = rest + offset;
            self.next_z[d] = z;
        }
        self.commit(x, duration)
    }

    fn commit(&mut self, x: f64, duration: f64) -> Result<DiscreteState<'_>, MotionError> {
        let (alpha, beta) = (self.config.alpha_z, self.config.beta_z);
        self.coupled = false;
        finite("position", &self.next_y)?;
        finite("velocity", &self.next_z)?;
        std::mem::swap(&mut self.y, &mut self.next_y);
        std::mem::swap(&mut self.z, &mut self.next_z);
        std::mem::swap(&mut self.forcing, &mut self.next_forcing);
        self.x = x;
        self.fresh = true;
        for d in 0..self.y.len() {
            let pull = alpha * (beta * (self.goal[d] - self.y[d]) - self.z[d]);
            self.yd[d] = self.z[d] / duration;
            self.ydd[d] = (pull + self.forcing[d] + self.perturbation[d]) / (duration * duration);
            self.perturbation[d] = 0.0;
        }
        Ok(self.state())
    }

    /// Brings kernel values and forcing term up to date with phase, weights and amplitude.
    fn refresh(&mut self) {
        if !self.fresh {
            self.evaluate_forcing(self.x);
            std::mem::swap(&mut self.forcing, &mut self.next_forcing);
            self.fresh = true;
        }
    }

    fn evaluate_forcing(&mut self, x: f64) {
        let sum = self.kernels.evaluate(x, &mut self.psi);
        let scale = self.amplitude * x / sum;
        for (f, w) in self.next_forcing.iter_mut().zip(self.weights.chunks_exact(self.psi.len())) {
            *f = scale * w.iter().zip(&self.psi).map(|(w, p)| w * p).sum::<f64>();
        }
    }
}

#[cfg(test)]
mod tests;
