//! Couplings of a primitive with its environment: from task space to joints, and around obstacles.
//!
//! Their effect depends on where they are applied: with [`crate::PeriodicDmp::perturb`] (12) the motion yields and
//! returns, with [`crate::PeriodicDmp::couple`] (13) the weights learn the change. The coaching field itself is
//! [`crate::PotentialField`].

use nalgebra::{SMatrix, SVector, Vector3};

use crate::error::{MotionError, finite, size, vector, within};

/// Converts a coupling in task space (M values) to one in joint space: writes `J^+ task` to `joints`. `columns` are
/// those of the Jacobian, one per joint. With `damping` (in the Jacobian's unit; 0 is the plain pseudoinverse) the
/// result stays bounded near singular postures. Does not allocate.
///
/// # Errors
/// When sizes differ, a value is not finite, or the Jacobian has lost its rank and `damping` is 0; `joints` is then
/// unchanged.
///
/// # Source
/// Eq. (17), `C_q = J^+ C_y`, as `J^T (J J^T + damping^2)^-1 C_y`, for at least as many joints as task coordinates.
pub fn joint_coupling<const M: usize>(
    columns: &[SVector<f64, M>],
    task: &SVector<f64, M>,
    damping: f64,
    joints: &mut [f64],
) -> Result<(), MotionError> {
    size("joint coupling", columns.len(), joints.len())?;
    vector("task coupling", M, task.as_slice())?;
    within("damping", damping, 0.0, 1e6)?;
    for column in columns {
        vector("Jacobian", M, column.as_slice())?;
    }
    let square: SMatrix<f64, M, M> = columns.iter().map(|c| c * c.transpose()).sum();
    let square = square + SMatrix::identity() * (damping * damping);
    // Below this, the smallest direction is rounding error, and the result would be noise.
    let floor = 1e-13 * square.trace();
    let decomposed = square.cholesky().filter(|c| c.l_dirty().diagonal().iter().all(|l| l * l > floor));
    let Some(decomposed) = decomposed else {
        return Err(MotionError::Degenerate { what: "Jacobian", why: "the posture is singular" });
    };
    let multiplier = decomposed.solve(task);
    finite("joint coupling", multiplier.as_slice())?;
    for (joint, column) in joints.iter_mut().zip(columns) {
        *joint = column.dot(&multiplier);
    }
    Ok(())
}

constants! {
    /// Avoids an obstacle point by rotating the motion's velocity away from it.
    ///
    /// The defaults are Hoffmann's constants.
    #[derive(Copy)]
    pub struct ObstacleAvoidance {
        /// Strength gamma, 1/s.
        gamma: f64 = 1000.0;
        /// How fast the effect decreases with the angle between motion and obstacle, 1/rad.
        beta: f64 = 20.0 / std::f64::consts::PI;
        /// Distance over which it decreases, m; infinite for no decrease, as in the paper.
        reach: f64 = f64::INFINITY;
    }
}

impl ObstacleAvoidance {
    /// The acceleration (m/s^2) that turns an end effector at `x` (m) with velocity `v` (m/s) around the obstacle
    /// at `o` (m). It is perpendicular to `v`, in the plane of `v` and `o - x`; zero if there is no such plane.
    /// Divide by `omega^2` (or multiply by `tau^2`) for [`crate::PeriodicDmp::perturb`]
    /// ([`crate::DiscreteDmp::perturb`]).
    ///
    /// # Source
    /// Hoffmann, Pastor, Park and Schaal, "Biologically-inspired dynamical systems for movement generation", ICRA
    /// 2009: `gamma R v phi exp(-beta phi)` with R a rotation by 90 degrees about `(o - x) x v`; differs in:
    /// `exp(-|o - x| / reach)`.
    pub fn coupling(&self, o: &Vector3<f64>, x: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
        let towards = o - x;
        let axis = towards.cross(v);
        let Some(axis) = axis.try_normalize(1e-12 * towards.norm() * v.norm()) else {
            return Vector3::zeros();
        };
        let angle = towards.angle(v);
        let fade = libm::exp(-towards.norm() / self.reach);
        let c = axis.cross(v) * (self.gamma * angle * libm::exp(-self.beta * angle) * fade);
        if c.iter().all(|c| c.is_finite()) { c } else { Vector3::zeros() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3xX, Vector2};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_joint_coupling_is_the_least_that_makes_the_task_coupling(
            j in prop::collection::vec(-1.0..1.0_f64, 21), c in prop::array::uniform3(-5.0..5.0_f64)
        ) {
            let j = Matrix3xX::from_column_slice(&j);
            let columns: Vec<Vector3<f64>> = j.column_iter().map(|c| c.into_owned()).collect();
            let mut q = [0.0; 7];
            let Ok(()) = joint_coupling(&columns, &Vector3::from(c), 0.0, &mut q) else { return Ok(()) };
            let pseudo = j.pseudo_inverse(1e-12).unwrap() * Vector3::from(c);
            for (a, b) in q.iter().zip(pseudo.iter()) {
                prop_assert!((a - b).abs() < 1e-6 * (1.0 + pseudo.norm()), "{a} {b}");
            }
        }
    }

    #[test]
    fn a_singular_posture_needs_damping() {
        // An outstretched arm cannot be pushed along itself.
        let columns = [Vector2::new(0.0, 3.0), Vector2::new(0.0, 2.0), Vector2::new(0.0, 1.0)];
        let mut q = [7.0; 3];
        let along = Vector2::new(1.0, 0.0);
        let refused = joint_coupling(&columns, &along, 0.0, &mut q);
        assert!(matches!(refused, Err(MotionError::Degenerate { .. })));
        assert_eq!(q, [7.0; 3]);
        joint_coupling(&columns, &along, 0.1, &mut q).unwrap();
        assert!(q.iter().all(|q| q.abs() < 1e-12));
        assert!(joint_coupling(&columns, &Vector2::new(f64::NAN, 0.0), 0.1, &mut q).is_err());
        assert!(joint_coupling(&columns, &along, 0.1, &mut q[..2]).is_err());
    }

    #[test]
    fn an_obstacle_turns_the_velocity_away_and_gives_no_speed() {
        let avoid = ObstacleAvoidance::default();
        let v = Vector3::new(1.0, 0.0, 0.0);
        let left_ahead = Vector3::new(1.0, 0.2, 0.0);
        let c = avoid.coupling(&left_ahead, &Vector3::zeros(), &v);
        assert!(c.y < -1.0 && c.dot(&v).abs() < 1e-9 && c.z.abs() < 1e-9, "{c}");
        let right_ahead = Vector3::new(1.0, -0.2, 0.0);
        assert!((avoid.coupling(&right_ahead, &Vector3::zeros(), &v) + c).norm() < 1e-9);
        let behind = avoid.coupling(&Vector3::new(-1.0, 0.2, 0.0), &Vector3::zeros(), &v);
        assert!(behind.norm() < 1e-4 * c.norm());
        assert_eq!(
            avoid.coupling(&v, &Vector3::zeros(), &v),
            Vector3::zeros(),
            "straight ahead there is no side"
        );
        assert_eq!(avoid.coupling(&v, &v, &v), Vector3::zeros());
    }
}
