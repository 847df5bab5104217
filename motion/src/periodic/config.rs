//! The constants of the periodic primitive.

use serde::{Deserialize, Serialize};

use crate::dmp::Integrator;
use crate::error::{MotionError, constant, kernel_width, within};

/// The constants of a [`PeriodicDmp`](crate::PeriodicDmp).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PeriodicDmpConfig {
    /// Degrees of freedom n, at least 1.
    pub dofs: usize,
    /// Kernels N per degree of freedom, at least 2; 25 in the papers.
    pub kernels: usize,
    /// Kernel width h of (7), dimensionless; by default `2.5 N`.
    pub width: Option<f64>,
    /// Stiffness constant of (4), 1 per rad of phase.
    pub alpha_z: f64,
    /// Damping constant of (4); `alpha_z / 4` makes it critically damped.
    pub beta_z: f64,
    /// Forgetting factor lambda of (9) per 10 ms of learning, in (0, 1].
    pub forgetting: f64,
    /// P(0) of (9), and the upper bound to which P grows for a kernel that is not visited.
    pub initial_gain: f64,
    /// How (4), (5) are integrated.
    pub integrator: Integrator,
}

impl Default for PeriodicDmpConfig {
    fn default() -> Self {
        Self {
            dofs: 1,
            kernels: 25,
            width: None,
            alpha_z: 8.0,
            beta_z: 2.0,
            forgetting: 0.9995,
            initial_gain: 1.0,
            integrator: Integrator::Exact,
        }
    }
}

impl PeriodicDmpConfig {
    /// The default constants for `dofs` degrees of freedom.
    #[must_use]
    pub fn with_dofs(dofs: usize) -> Self {
        Self { dofs, ..Self::default() }
    }

    pub(super) fn validate(&self) -> Result<(), MotionError> {
        within("dofs", self.dofs as f64, 1.0, 4096.0)?;
        within("kernels", self.kernels as f64, 2.0, 4096.0)?;
        if let Some(width) = self.width {
            kernel_width("width", width, self.kernels)?;
        }
        constant("alpha_z", self.alpha_z)?;
        constant("beta_z", self.beta_z)?;
        within("forgetting", self.forgetting, 1e-6, 1.0)?;
        constant("initial_gain", self.initial_gain)
    }
}
