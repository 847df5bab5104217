//! The periodic movement of an orientation about a centre.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    OrientationState, angular_velocity, check_orientations, rotation_rate, rotation_vector, rotation_vectors,
    state_of,
};
use crate::error::{MotionError, frequency};
use crate::periodic::{PeriodicDmp, PeriodicDmpConfig, PhaseSample};

/// A periodic movement of an orientation; the equations are in the documentation of the module `orientation`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct PeriodicOrientationDmp {
    centre: UnitQuaternion<f64>,
    /// The primitive of the rotation vector from the centre, rad.
    primitive: PeriodicDmp,
}

/// The smallest number of orientations per period that can be learned.
const MIN_SAMPLES: usize = 8;
/// The mean orientation has converged when it changes by less than this, rad.
const MEAN_TOLERANCE: f64 = 1e-12;

impl PeriodicOrientationDmp {
    /// A primitive at rest at the identity. The number of degrees of freedom in `config` is not used.
    ///
    /// # Errors
    /// As [`PeriodicDmp::new`].
    pub fn new(config: PeriodicDmpConfig) -> Result<Self, MotionError> {
        let primitive = PeriodicDmp::new(PeriodicDmpConfig { dofs: 3, ..config })?;
        Ok(Self { centre: UnitQuaternion::identity(), primitive })
    }

    /// Learns from `orientations` that are evenly spaced over one period; the centre becomes their mean.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for fewer than 8 orientations; [`MotionError::Degenerate`] when they rotate by full
    /// turns in one direction, so that they have no centre. Nothing is changed then.
    pub fn learn_period(&mut self, orientations: &[UnitQuaternion<f64>]) -> Result<(), MotionError> {
        let n = orientations.len();
        if n < MIN_SAMPLES {
            return Err(MotionError::TooFew { what: "orientations", needed: MIN_SAMPLES, got: n });
        }
        check_orientations(orientations)?;
        let (centre, e) = about_their_mean(orientations)?;
        let h = TAU / n as f64;
        let at = |s: usize, offset: usize| e[(s + offset) % n];
        let samples: Vec<PhaseSample> = (0..n)
            .map(|s| {
                // Fourth-order central differences, around the period.
                let [b2, b1, a1, a2] = [at(s, n - 2), at(s, n - 1), at(s, 1), at(s, 2)];
                let dy = (b2 - a2 + 8.0 * (a1 - b1)) / (12.0 * h);
                let ddy = (16.0 * (b1 + a1) - 30.0 * e[s] - b2 - a2) / (12.0 * h * h);
                let row = |v: Vector3<f64>| v.as_slice().to_vec();
                PhaseSample { phase: h * s as f64, y: row(e[s]), dy: row(dy), ddy: row(ddy) }
            })
            .collect();
        self.primitive.learn_batch(&samples)?;
        self.centre = centre;
        Ok(())
    }

    /// The primitive of the rotation vector from the centre, rad.
    pub fn primitive(&self) -> &PeriodicDmp {
        &self.primitive
    }

    /// The centre of the movement.
    pub fn centre(&self) -> UnitQuaternion<f64> {
        self.centre
    }

    /// Rotates the whole movement; orientation and angular velocity follow smoothly. `omega` is its frequency,
    /// rad/s.
    ///
    /// # Errors
    /// When a value is not finite or `omega` is not positive.
    pub fn set_centre(&mut self, centre: UnitQuaternion<f64>, omega: f64) -> Result<(), MotionError> {
        check_orientations(&[centre])?;
        let now = self.state();
        let e = rotation_vector(&centre, &now.orientation, &Vector3::zeros());
        let ed = rotation_rate(&e, &now.angular_velocity);
        self.primitive.reset(self.primitive.phase(), e.as_slice(), ed.as_slice(), omega)?;
        self.centre = centre;
        Ok(())
    }

    /// Scales the movement about its centre; 1 is as learned.
    ///
    /// # Errors
    /// When the factor is not finite.
    pub fn set_amplitude(&mut self, amplitude: f64) -> Result<(), MotionError> {
        self.primitive.set_amplitude(amplitude)
    }

    /// Starts at `phase` rad from an orientation with an angular velocity (rad/s), for a movement of `omega` rad/s.
    ///
    /// # Errors
    /// When a value is not finite or `omega` is not positive.
    pub fn reset(
        &mut self,
        phase: f64,
        orientation: &UnitQuaternion<f64>,
        angular_velocity: &Vector3<f64>,
        omega: f64,
    ) -> Result<(), MotionError> {
        check_orientations(&[*orientation])?;
        let e = rotation_vector(&self.centre, orientation, &Vector3::zeros());
        let ed = rotation_rate(&e, angular_velocity);
        self.primitive.reset(phase, e.as_slice(), ed.as_slice(), omega)
    }

    /// Sets the state to the steady path at `phase` rad, for a movement of `omega` rad/s: there is no transient.
    ///
    /// # Errors
    /// When a value is not finite or `omega` not positive.
    pub fn start_on_path(&mut self, phase: f64, omega: f64) -> Result<(), MotionError> {
        frequency("omega", omega)?;
        self.primitive.start_on_path(phase, omega)
    }

    /// The orientation on the steady path at `phase` rad, and its derivative with respect to the phase as a
    /// rotation vector, rad/rad.
    pub fn steady_state(&self, phase: f64) -> (UnitQuaternion<f64>, Vector3<f64>) {
        let (e, de) = self.primitive.steady_state(phase);
        let (e, de) = (Vector3::from_column_slice(&e), Vector3::from_column_slice(&de));
        (UnitQuaternion::from_scaled_axis(e) * self.centre, angular_velocity(&e, &de))
    }

    /// The state after the last step.
    pub fn state(&self) -> OrientationState {
        let state = self.primitive.state();
        state_of(&self.centre, state.y, state.yd)
    }

    /// Advances by `dt` s at `omega` rad/s (0 stands still). Does not allocate.
    ///
    /// # Errors
    /// As [`PeriodicDmp::step`]; the state is unchanged.
    pub fn step(&mut self, dt: f64, omega: f64) -> Result<OrientationState, MotionError> {
        self.primitive.step(dt, omega)?;
        Ok(self.state())
    }
}

/// The mean of orientations on a closed path (Karcher's), and the rotation vectors from it to them.
fn about_their_mean(
    orientations: &[UnitQuaternion<f64>],
) -> Result<(UnitQuaternion<f64>, Vec<Vector3<f64>>), MotionError> {
    let mut mean = orientations[0];
    let mut e = Vec::new();
    for _ in 0..100 {
        e = rotation_vectors(&mean, orientations.iter(), Vector3::zeros());
        let closed = rotation_vector(&mean, &orientations[0], &e[e.len() - 1]);
        if (closed - e[0]).norm() > 1e-6 {
            let why = "they turn on and on, so that they have no centre";
            return Err(MotionError::Degenerate { what: "orientations", why });
        }
        let shift = e.iter().sum::<Vector3<f64>>() / e.len() as f64;
        mean = UnitQuaternion::from_scaled_axis(shift) * mean;
        mean.renormalize();
        if shift.norm() < MEAN_TOLERANCE {
            break;
        }
    }
    Ok((mean, e))
}

stored!(PeriodicOrientationDmp { centre, primitive: PeriodicDmp });
