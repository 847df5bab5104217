//! The constants of the discrete-periodic primitive.

use serde::{Deserialize, Serialize};

use super::phase::CanonicalSystem;
use crate::error::{MotionError, constant, kernel_width, within};

/// The constants of a [`DiscretePeriodicDmp`](crate::DiscretePeriodicDmp); the defaults are the paper's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscretePeriodicConfig {
    /// Degrees of freedom n, at least 1.
    pub dofs: usize,
    /// Kernels of the discrete part, at least 2.
    pub discrete_kernels: usize,
    /// Kernels of the periodic part, at least 2.
    pub periodic_kernels: usize,
    /// Width l of (6), dimensionless; by default 1.25 times the number of kernels.
    pub periodic_width: Option<f64>,
    /// Stiffness constant of (1), 1 per rad of phase.
    pub alpha_z: f64,
    /// Damping constant of (1); `alpha_z / 4` makes it critically damped.
    pub beta_z: f64,
    /// Ridge of the regression, in squared kernel values.
    pub ridge: f64,
    /// The canonical system (3), (4).
    pub canonical: CanonicalSystem,
}

impl Default for DiscretePeriodicConfig {
    fn default() -> Self {
        Self {
            dofs: 1,
            discrete_kernels: 25,
            periodic_kernels: 25,
            periodic_width: None,
            alpha_z: 48.0,
            beta_z: 12.0,
            ridge: 1e-8,
            canonical: CanonicalSystem::default(),
        }
    }
}

impl DiscretePeriodicConfig {
    /// The default constants for `dofs` degrees of freedom.
    #[must_use]
    pub fn with_dofs(dofs: usize) -> Self {
        Self { dofs, ..Self::default() }
    }

    pub(super) fn validate(&self) -> Result<(), MotionError> {
        within("dofs", self.dofs as f64, 1.0, 4096.0)?;
        within("discrete_kernels", self.discrete_kernels as f64, 2.0, 1024.0)?;
        within("periodic_kernels", self.periodic_kernels as f64, 2.0, 1024.0)?;
        if let Some(width) = self.periodic_width {
            kernel_width("periodic_width", width, self.periodic_kernels)?;
        }
        constant("alpha_z", self.alpha_z)?;
        constant("beta_z", self.beta_z)?;
        within("ridge", self.ridge, 0.0, 1e6)?;
        self.canonical.validate()
    }
}
