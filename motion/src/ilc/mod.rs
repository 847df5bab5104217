//! Current-iteration iterative learning control (11)-(14) of a [`DiscretePeriodicDmp`]: from one epoch to the next,
//! the primitive learns the control signal of the feedback, until no error is left.
//!
//! An epoch is one discrete part and any number of periods. The definition of the error is not part of it:
//! [`FeedbackError`] computes one from forces and velocities, in task or in joint space, but any signal can be used
//! whose sign gives the direction of correction. Equation numbers refer to Gams, Ude and Morimoto 2015, as in
//! [`crate::DiscretePeriodicDmp`].

use nalgebra::SVector;

use crate::coupling::joint_coupling;
use crate::discrete_periodic::DiscretePeriodicDmp;
use crate::error::{MAX_MAGNITUDE, MotionError, size, vector, within};

constants! {
    /// The constants of (11).
    #[derive(Copy)]
    pub struct LearningControlConfig {
        /// Q, dimensionless: below 1 it forgets, which gives robustness and leaves an error.
        q: f64 = 1.0, 0.0..=1.0;
        /// L, unit / s of control per unit of error: how much of the last epoch's error is learned.
        l: f64 = 0.3, -1e6..=1e6;
        /// C, in the unit of L: feedback within the epoch.
        c: f64 = 0.3, -1e6..=1e6;
    }
}

/// Learns the control signal of a primitive from epoch to epoch.
///
/// # Source
/// (11): `u_{j+1}(k) = Q (u_j(k) + L e_j(k+1)) + C e_{j+1}(k)`, where u_j is the whole last signal with its
/// feedback. The feedforward part is stored as weights (13), for all periods of an epoch together. The error after
/// the last sample is assumed to equal that of the last sample.
#[derive(Debug, Clone)]
pub struct LearningControl {
    config: LearningControlConfig,
    dofs: usize,
    capacity: usize,
    /// The current epoch: phases, and control signals and errors at the demonstrated frequency.
    phases: Vec<(f64, f64)>,
    control: Vec<f64>,
    error: Vec<f64>,
    scratch: Vec<f64>,
    epochs: u32,
}

impl LearningControl {
    /// For primitives of `dofs` degrees of freedom and epochs of at most `samples` steps.
    ///
    /// # Errors
    /// Names the invalid constant.
    pub fn new(config: LearningControlConfig, dofs: usize, samples: usize) -> Result<Self, MotionError> {
        config.check_ranges()?;
        within("dofs", dofs as f64, 1.0, 4096.0)?;
        within("samples", samples as f64, 2.0, 1e8)?;
        Ok(Self {
            config,
            dofs,
            capacity: samples,
            phases: Vec::with_capacity(samples),
            control: Vec::with_capacity(samples * dofs),
            error: Vec::with_capacity(samples * dofs),
            scratch: vec![0.0; dofs],
            epochs: 0,
        })
    }

    /// The constants.
    pub fn config(&self) -> &LearningControlConfig {
        &self.config
    }

    /// Epochs learned so far.
    pub fn epochs(&self) -> u32 {
        self.epochs
    }

    /// Number of steps recorded in the current epoch.
    pub fn samples(&self) -> usize {
        self.phases.len()
    }

    /// Processes the error `error` (one value per degree of freedom) at the present phase: feeds `C e` into `dmp`'s
    /// next step at `omega` rad/s, and records both. To be called before each [`DiscretePeriodicDmp::step`]. Does
    /// not allocate.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite, `omega` is not positive or the epoch exceeds its maximal length;
    /// nothing is changed.
    ///
    /// # Source
    /// The feedback term of (11), and (12).
    pub fn step(
        &mut self,
        dmp: &mut DiscretePeriodicDmp,
        omega: f64,
        error: &[f64],
    ) -> Result<(), MotionError> {
        size("dofs", self.dofs, dmp.dofs())?;
        vector("error", self.dofs, error)?;
        within("omega", omega, 1e-9, MAX_MAGNITUDE)?;
        within("samples in the epoch", (self.phases.len() + 1) as f64, 1.0, self.capacity as f64)?;
        for (s, e) in self.scratch.iter_mut().zip(error) {
            *s = self.config.c * e;
        }
        dmp.correct(&self.scratch)?;
        let scale = dmp.demonstrated_omega() / omega;
        let feedback = self.control.len();
        self.control.extend(self.scratch.iter().map(|u| u * scale));
        self.error.extend(error.iter().map(|e| e * scale));
        dmp.control(omega, &mut self.scratch)?;
        for (whole, u) in self.control[feedback..].iter_mut().zip(&self.scratch) {
            *whole += u * scale;
        }
        let state = dmp.state();
        self.phases.push((state.phase, state.radius));
        Ok(())
    }

    /// Ends the epoch: the primitive's control signal becomes the feedforward term of the next one. The primitive's
    /// state is unchanged; [`DiscretePeriodicDmp::restart`] begins the next epoch.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for fewer than two steps; [`MotionError::NotFinite`] or [`MotionError::OutOfRange`]
    /// when the signal has diverged. The primitive is not changed then, and the epoch continues.
    ///
    /// # Source
    /// The feedforward term of (11), and (13).
    pub fn finish(&mut self, dmp: &mut DiscretePeriodicDmp) -> Result<(), MotionError> {
        size("dofs", self.dofs, dmp.dofs())?;
        let (n, samples) = (self.dofs, self.phases.len());
        if samples < 2 {
            return Err(MotionError::TooFew { what: "samples in the epoch", needed: 2, got: samples });
        }
        let next = |i: usize| if i + n < self.error.len() { self.error[i + n] } else { self.error[i] };
        let feedforward: Vec<f64> =
            (0..samples * n).map(|i| self.config.q * (self.control[i] + self.config.l * next(i))).collect();
        let weights = dmp.regress(&self.phases, &feedforward)?;
        dmp.set_control_weights(&weights)?;
        self.abandon();
        self.epochs = self.epochs.saturating_add(1);
        Ok(())
    }

    /// Discards the current epoch, for example after a disturbance that must not be learned.
    pub fn abandon(&mut self) {
        self.phases.clear();
        self.control.clear();
        self.error.clear();
    }
}

constants! {
    /// The feedback error of an arm that moves an object together with another arm, in the velocity unit of the
    /// primitive.
    ///
    /// The force of the second arm on the object enters as `F_d - F_2`: an arm that lags is dragged by the object and
    /// exerts a force against the motion, so the error points forward.
    #[derive(Copy)]
    pub struct FeedbackError {
        /// K1: unit / s per N (in task space), 1 / (N m s) on joint torques.
        k1: f64 = 0.3;
        /// K2, dimensionless; 0 gives (10) alone. Its product with C of (11) must stay below 1.
        k2: f64 = 1.0;
        /// Damping of the pseudoinverse, in the unit of the Jacobian; needed if there are fewer joints than
        /// coordinates.
        damping: f64 = 1e-3;
    }
}

impl FeedbackError {
    /// The error in task space, written to `out`: `wrench` is `F_d - F_2` (N, N m), `twist` is the velocity of the
    /// other arm relative to this one, `v_1 - v_2` (m/s, rad/s). Does not allocate.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite; `out` is unchanged.
    ///
    /// # Source
    /// (10), with the second term of (14).
    pub fn in_task_space(&self, wrench: &[f64], twist: &[f64], out: &mut [f64]) -> Result<(), MotionError> {
        vector("wrench", out.len(), wrench)?;
        vector("twist", out.len(), twist)?;
        for ((o, f), v) in out.iter_mut().zip(wrench).zip(twist) {
            *o = self.k1 * f + self.k2 * v;
        }
        Ok(())
    }

    /// The error in joint space, written to `out` (one value per joint). `columns` are those of the second arm's
    /// Jacobian, one per joint, in the D coordinates of `wrench` and `twist` (3 for forces, 6 with moments). Does
    /// not allocate.
    ///
    /// # Errors
    /// When sizes differ, a value is not finite, or the posture is singular and `damping` is 0; `out` is unchanged.
    ///
    /// # Source
    /// (14): `K1 J^T (F_d - F_2) + K2 J^+ (v_1 - v_2)`, with the pseudoinverse in its second term.
    pub fn in_joint_space<const D: usize>(
        &self,
        columns: &[SVector<f64, D>],
        wrench: &SVector<f64, D>,
        twist: &SVector<f64, D>,
        out: &mut [f64],
    ) -> Result<(), MotionError> {
        size("feedback error", columns.len(), out.len())?;
        vector("wrench", D, wrench.as_slice())?;
        vector("twist", D, twist.as_slice())?;
        if self.k2 == 0.0 {
            columns.iter().try_for_each(|column| vector("Jacobian", D, column.as_slice()))?;
            out.fill(0.0);
        } else {
            joint_coupling(columns, &(twist * self.k2), self.damping, out)?;
        }
        for (o, column) in out.iter_mut().zip(columns) {
            *o += self.k1 * column.dot(wrench);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
