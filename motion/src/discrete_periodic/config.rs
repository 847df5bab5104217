//! The constants of the discrete-periodic primitive.

use super::phase::CanonicalSystem;
use crate::constants::GAIN;
use crate::error::{MotionError, kernel_width};

constants! {
    /// The constants of a [`DiscretePeriodicDmp`](crate::DiscretePeriodicDmp); the defaults are the paper's.
    pub struct DiscretePeriodicConfig {
        /// Degrees of freedom n, at least 1.
        dofs: usize = 1, 1.0..=4096.0;
        /// Kernels of the discrete part, at least 2.
        discrete_kernels: usize = 25, 2.0..=1024.0;
        /// Kernels of the periodic part, at least 2.
        periodic_kernels: usize = 25, 2.0..=1024.0;
        /// Width l of (6), dimensionless; by default 1.25 times the number of kernels.
        periodic_width: Option<f64> = None;
        /// Stiffness constant of (1), 1 per rad of phase.
        alpha_z: f64 = 48.0, GAIN;
        /// Damping constant of (1); `alpha_z / 4` makes it critically damped.
        beta_z: f64 = 12.0, GAIN;
        /// Ridge of the regression, in squared kernel values.
        ridge: f64 = 1e-8, 0.0..=1e6;
        /// The canonical system (3), (4).
        canonical: CanonicalSystem = CanonicalSystem::default();
    }
}

impl DiscretePeriodicConfig {
    pub(super) fn validate(&self) -> Result<(), MotionError> {
        self.check_ranges()?;
        if let Some(width) = self.periodic_width {
            kernel_width("periodic_width", width, self.periodic_kernels)?;
        }
        self.canonical.validate()
    }
}
