//! What every primitive offers in the same way: access to its constants, weights, amplitude and couplings.

/// Implements `config`, `dofs`, `weights` and `set_weights` for a primitive with the fields `config` and `dmp`, and
/// `with_dofs` for its constants.
macro_rules! primitive {
    ($primitive:ty, $config:ty) => {
        impl $config {
            /// The default constants for `dofs` degrees of freedom.
            pub fn with_dofs(dofs: usize) -> Self {
                Self { dofs, ..Self::default() }
            }
        }

        impl $primitive {
            /// The constants.
            pub fn config(&self) -> &$config {
                &self.config
            }

            /// Degrees of freedom n.
            pub fn dofs(&self) -> usize {
                self.config.dofs
            }

            /// Weights of the forcing term: degree of freedom by degree of freedom, in the order of the kernels.
            pub fn weights(&self) -> &[f64] {
                self.dmp.weights()
            }

            /// Replaces the weights of the forcing term; the state is unchanged, so that the position does not jump.
            ///
            /// # Errors
            /// When their number is not that of all kernels of all degrees of freedom, or one is not finite.
            pub fn set_weights(&mut self, weights: &[f64]) -> Result<(), MotionError> {
                self.dmp.set_weights(0, "weights", weights)
            }
        }
    };
}

/// Implements the amplitude and the two couplings for a primitive that also has the field `learner`.
macro_rules! coached {
    ($primitive:ty) => {
        impl $primitive {
            /// Amplitude factor r of (6), dimensionless; 1 is the movement as learned.
            pub fn amplitude(&self) -> f64 {
                self.dmp.amplitude()
            }

            /// Scales the movement about its goal or centre, which stays; the position follows smoothly.
            ///
            /// # Errors
            /// When the factor is not finite.
            pub fn set_amplitude(&mut self, amplitude: f64) -> Result<(), MotionError> {
                self.dmp.set_amplitude(amplitude)
            }

            /// Adds `c` (one per degree of freedom) to (4) for the next step only: the movement yields and returns.
            ///
            /// # Errors
            /// When sizes differ or a value is not finite.
            ///
            /// # Source
            /// Eq. (12).
            pub fn perturb(&mut self, c: &[f64]) -> Result<(), MotionError> {
                vector("perturbation", self.dofs(), c)?;
                self.dmp.transformation.perturbation.copy_from_slice(c);
                Ok(())
            }

            /// Lets the weights learn the coupling term `c` in the next step, at the present phase: the movement, and
            /// later executions, keep the change. P of (9) is updated in such a step too. So a coach that stays
            /// present calls this in each step, with zeros outside his field.
            ///
            /// # Errors
            /// When sizes differ or a value is not finite.
            ///
            /// # Source
            /// Eqs. (9), (10), (13); with `x r` in place of r for a discrete movement.
            pub fn couple(&mut self, c: &[f64]) -> Result<(), MotionError> {
                self.learner.couple(c)
            }
        }
    };
}
