//! The discrete dynamic movement primitive with n degrees of freedom: from a start to a goal, on a decaying phase.
//! It takes the same two couplings as [`crate::PeriodicDmp`]: one that only perturbs (eq. 12) and one that the
//! weights learn (eq. 13), by which point-to-point movements are coached from one execution to the next.
//!
//! Learning from data is in `learning.rs`. Blending into a periodic motion is not part of it.

mod kernels;
mod learning;
mod saved;

use serde::{Deserialize, Serialize};

use self::kernels::DecayKernels;
use crate::constants::GAIN;
use crate::dmp::{CouplingLearner, Dmp, Integrator, TimeScale};
use crate::error::{MAX_MAGNITUDE, MotionError, constant, positive, vector, within};

constants! {
    /// The constants of a [`DiscreteDmp`].
    pub struct DiscreteDmpConfig {
        /// Degrees of freedom n, at least 1.
        dofs: usize = 1, 1.0..=4096.0;
        /// Kernels N per degree of freedom, at least 2.
        kernels: usize = 25, 2.0..=4096.0;
        /// Decay rate of the phase, which ends at `exp(-alpha_x)`. It is small enough that the end can still be shaped.
        alpha_x: f64 = 2.0, 1e-3..=100.0;
        /// Stiffness constant of (4), for one duration.
        alpha_z: f64 = 48.0, GAIN;
        /// Damping constant of (4); `alpha_z / 4` makes it critically damped.
        beta_z: f64 = 12.0, GAIN;
        /// Forgetting factor lambda of (9) per 10 ms of learning, in (0, 1].
        forgetting: f64 = 0.9995, 1e-6..=1.0;
        /// P(0) of (9), and the upper bound to which P grows for a kernel that is not visited.
        initial_gain: f64 = 1.0, GAIN;
    }
}

/// The result of a step; the slices have one value per degree of freedom.
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
/// // From 0 to 1 m in 2 s as half a cosine, sampled at 50 Hz.
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
#[serde(try_from = "saved::SavedDiscrete", into = "saved::SavedDiscrete")]
pub struct DiscreteDmp {
    config: DiscreteDmpConfig,
    start: Vec<f64>,
    dmp: Dmp<DecayKernels>,
    learner: CouplingLearner,
}

primitive!(DiscreteDmp, DiscreteDmpConfig);
coached!(DiscreteDmp);

impl DiscreteDmp {
    /// A primitive at rest at its goal 0: all weights 0, amplitude 1.
    ///
    /// # Errors
    /// [`MotionError::OutOfRange`] or [`MotionError::NotFinite`] names the invalid constant.
    pub fn new(config: DiscreteDmpConfig) -> Result<Self, MotionError> {
        config.check_ranges()?;
        let (n, k) = (config.dofs, config.kernels);
        let kernels = DecayKernels::new(k, config.alpha_x);
        Ok(Self {
            dmp: Dmp::new(kernels, 1.0, n, config.alpha_z, config.beta_z),
            learner: CouplingLearner::new(n, k, config.forgetting, config.initial_gain),
            start: vec![0.0; n],
            config,
        })
    }

    /// The start of the demonstration, one value per degree of freedom.
    pub fn demonstrated_start(&self) -> &[f64] {
        &self.start
    }

    /// The goal, one value per degree of freedom.
    pub fn goal(&self) -> &[f64] {
        &self.dmp.transformation.goal
    }

    /// Sets the goal, also while running; the position follows smoothly.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    pub fn set_goal(&mut self, goal: &[f64]) -> Result<(), MotionError> {
        vector("goal", self.dofs(), goal)?;
        self.dmp.transformation.goal.copy_from_slice(goal);
        Ok(())
    }

    /// Sets the state to the start of a movement of `duration` s, at position `y` with velocity `yd` (unit / s).
    /// The weights are kept.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite or `duration` is not positive; nothing is changed.
    pub fn begin(&mut self, y: &[f64], yd: &[f64], duration: f64) -> Result<(), MotionError> {
        vector("y", self.dofs(), y)?;
        vector("yd", self.dofs(), yd)?;
        constant("duration", duration)?;
        self.dmp.set_phase(1.0);
        self.dmp.transformation.put(y, yd, TimeScale::Duration(duration));
        self.dmp.transformation.perturbation.fill(0.0);
        self.learner.coupled = false;
        Ok(())
    }

    /// Sets position and velocity (unit / s) at the present phase.
    pub(crate) fn put(&mut self, y: &[f64], yd: &[f64], duration: f64) {
        self.dmp.transformation.put(y, yd, TimeScale::Duration(duration));
    }

    /// The state after the last step.
    pub fn state(&self) -> DiscreteState<'_> {
        let state = &self.dmp.transformation;
        DiscreteState { x: self.dmp.phase(), y: &state.y, yd: &state.yd, ydd: &state.ydd }
    }

    /// The share of the duration that has passed; 1 at the end and more after it.
    pub fn progress(&self) -> f64 {
        -libm::log(self.dmp.phase()) / self.config.alpha_x
    }

    /// Advances by `dt` s of a movement of `duration` s, which may change while running. After the duration the
    /// position continues to approach the goal. Does not allocate.
    ///
    /// # Errors
    /// When `dt` or `duration` is not positive or the result would not be finite. State and weights are then
    /// unchanged, and a pending coupling waits for the next step.
    pub fn step(&mut self, dt: f64, duration: f64) -> Result<DiscreteState<'_>, MotionError> {
        positive("dt", dt)?;
        constant("duration", duration)?;
        within("dt / duration", dt / duration, 0.0, MAX_MAGNITUDE)?;
        let step =
            |dmp: &mut Dmp<_>| dmp.step(dt, TimeScale::Duration(duration), Integrator::Exact, |_, _| 0.0);
        self.learner.step(&mut self.dmp, dt, step)?;
        Ok(self.state())
    }
}

#[cfg(test)]
mod tests;
