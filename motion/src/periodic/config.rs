//! The constants of the periodic primitive.

use crate::constants::GAIN;
use crate::dmp::Integrator;
use crate::error::{MotionError, kernel_width};

constants! {
    /// The constants of a [`PeriodicDmp`](crate::PeriodicDmp).
    pub struct PeriodicDmpConfig {
        /// Degrees of freedom n, at least 1.
        dofs: usize = 1, 1.0..=4096.0;
        /// Kernels N per degree of freedom, at least 2; 25 in the papers.
        kernels: usize = 25, 2.0..=4096.0;
        /// Kernel width h of (7), dimensionless; by default `2.5 N`.
        width: Option<f64> = None;
        /// Stiffness constant of (4), 1 per rad of phase.
        alpha_z: f64 = 8.0, GAIN;
        /// Damping constant of (4); `alpha_z / 4` makes it critically damped.
        beta_z: f64 = 2.0, GAIN;
        /// Forgetting factor lambda of (9) per 10 ms of learning, in (0, 1].
        forgetting: f64 = 0.9995, 1e-6..=1.0;
        /// P(0) of (9), and the upper bound to which P grows for a kernel that is not visited.
        initial_gain: f64 = 1.0, GAIN;
        /// How (4), (5) are integrated.
        integrator: Integrator = Integrator::Exact;
    }
}

impl PeriodicDmpConfig {
    pub(super) fn validate(&self) -> Result<(), MotionError> {
        self.check_ranges()?;
        if let Some(width) = self.width {
            kernel_width("width", width, self.kernels)?;
        }
        Ok(())
    }
}
