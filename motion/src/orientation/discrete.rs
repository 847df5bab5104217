//! The movement of an orientation to a goal.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    OrientationState, check_orientations, rotation_rate, rotation_vector, rotation_vectors, state_of,
};
use crate::discrete::{DiscreteDmp, DiscreteDmpConfig};
use crate::discrete_periodic::differentiate;
use crate::error::{MotionError, constant};

/// A movement of an orientation to a goal; the equations are in the documentation of the module `orientation`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct DiscreteOrientationDmp {
    goal: UnitQuaternion<f64>,
    /// The primitive of the rotation vector from the goal, rad; its own goal is 0.
    primitive: DiscreteDmp,
}

impl DiscreteOrientationDmp {
    /// A primitive at rest at its goal, the identity. The number of degrees of freedom in `config` is not used.
    ///
    /// # Errors
    /// As [`DiscreteDmp::new`].
    pub fn new(config: DiscreteDmpConfig) -> Result<Self, MotionError> {
        let primitive = DiscreteDmp::new(DiscreteDmpConfig { dofs: 3, ..config })?;
        Ok(Self { goal: UnitQuaternion::identity(), primitive })
    }

    /// Learns from `orientations`, one every `dt` s. The last one becomes the goal, and the state is set to the
    /// first one. Returns the duration, s. Rotations of more than half a turn are followed.
    ///
    /// # Errors
    /// [`MotionError::TooFew`] for fewer than four orientations; also when a value is not finite or `dt` is not
    /// positive. Nothing is changed then.
    pub fn learn(&mut self, dt: f64, orientations: &[UnitQuaternion<f64>]) -> Result<f64, MotionError> {
        check_orientations(orientations)?;
        let Some(goal) = orientations.last().copied() else {
            return Err(MotionError::TooFew { what: "orientations", needed: 4, got: 0 });
        };
        let mut e = rotation_vectors(&goal, orientations.iter().rev(), Vector3::zeros());
        e.reverse();
        let positions: Vec<Vec<f64>> = e.iter().map(|e| e.as_slice().to_vec()).collect();
        let duration = self.primitive.learn_batch(&differentiate(dt, &positions)?)?;
        self.goal = goal;
        Ok(duration)
    }

    /// The primitive of the rotation vector from the goal, rad.
    pub fn primitive(&self) -> &DiscreteDmp {
        &self.primitive
    }

    /// The goal orientation.
    pub fn goal(&self) -> UnitQuaternion<f64> {
        self.goal
    }

    /// Rotates the goal while the movement runs: orientation and angular velocity follow smoothly, by the shortest
    /// rotation to the new goal. `duration` s is that of the movement.
    ///
    /// # Errors
    /// When a value is not finite or `duration` is not positive; nothing is changed.
    pub fn set_goal(&mut self, goal: UnitQuaternion<f64>, duration: f64) -> Result<(), MotionError> {
        check_orientations(&[goal])?;
        constant("duration", duration)?;
        let now = self.state();
        let e = rotation_vector(&goal, &now.orientation, &Vector3::zeros());
        let ed = rotation_rate(&e, &now.angular_velocity);
        self.primitive.put(e.as_slice(), ed.as_slice(), duration);
        self.goal = goal;
        Ok(())
    }

    /// Sets the state to the start of a movement of `duration` s, at an orientation and at rest. It rotates in the
    /// direction of the demonstration; without one, in the shortest direction.
    ///
    /// # Errors
    /// When a value is not finite or `duration` is not positive; nothing is changed.
    pub fn begin(&mut self, orientation: &UnitQuaternion<f64>, duration: f64) -> Result<(), MotionError> {
        check_orientations(&[*orientation])?;
        let shown = Vector3::from_column_slice(self.primitive.demonstrated_start());
        let e = rotation_vector(&self.goal, orientation, &shown);
        self.primitive.begin(e.as_slice(), &[0.0; 3], duration)
    }

    /// The share of the duration that has passed; 1 at the end and more after it.
    pub fn progress(&self) -> f64 {
        self.primitive.progress()
    }

    /// The state after the last step.
    pub fn state(&self) -> OrientationState {
        let state = self.primitive.state();
        state_of(&self.goal, state.y, state.yd)
    }

    /// Advances by `dt` s of a movement of `duration` s. After the duration the orientation continues to approach
    /// the goal. Does not allocate.
    ///
    /// # Errors
    /// As [`DiscreteDmp::step`]; the state is unchanged.
    pub fn step(&mut self, dt: f64, duration: f64) -> Result<OrientationState, MotionError> {
        self.primitive.step(dt, duration)?;
        Ok(self.state())
    }
}

stored!(DiscreteOrientationDmp { goal, primitive: DiscreteDmp });
