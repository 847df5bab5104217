//! Dynamic movement primitives of orientations, as unit quaternions: [`PeriodicOrientationDmp`] for periodic
//! movements, [`DiscreteOrientationDmp`] for a movement to a goal.
//!
//! An orientation q is described by the rotation vector e from the goal (or centre) g to q, in the frame in which
//! both are given:
//!
//! ```text
//! e = 2 log(q g*)          tau z' = alpha_z (beta_z (0 - e) - z) + f
//! q = exp(e / 2) g         tau e' = z
//! ```
//!
//! So the core of all primitives (`dmp/mod.rs`) integrates e, and all its properties (exact steps, steady paths,
//! learning, couplings) hold for orientations too. The angular velocity is `J(e) e'` with the left Jacobian J of
//! rotations. The norm of q is 1 by construction.
//!
//! # Source
//! Abu-Dakka, Saveriano and Peternel, "Periodic DMP formulation for quaternion trajectories", ICAR 2021 (the
//! approach by projection onto the tangent space); the discrete form after Ude, Nemec, Petrič and Morimoto,
//! "Orientation in Cartesian space dynamic movement primitives", ICRA 2014. Differs from the latter in: z is the
//! derivative of e with respect to the phase and not the angular velocity. For rotations about one axis both are
//! the same; otherwise they differ in second order of e.
//!
//! Positions are not part of it: they are degrees of freedom of the other primitives.

/// Stores a primitive with its goal or centre as w, x, y, z.
macro_rules! stored {
    ($dmp:ident { $anchor:ident, primitive: $primitive:ty }) => {
        #[derive(serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Stored {
            $anchor: [f64; 4],
            primitive: $primitive,
        }

        impl From<$dmp> for Stored {
            fn from(dmp: $dmp) -> Self {
                let q = dmp.$anchor;
                Self { $anchor: [q.w, q.i, q.j, q.k], primitive: dmp.primitive }
            }
        }

        impl TryFrom<Stored> for $dmp {
            type Error = MotionError;

            fn try_from(stored: Stored) -> Result<Self, MotionError> {
                crate::error::size("dofs of the orientation", 3, stored.primitive.dofs())?;
                Ok(Self { $anchor: super::read(stored.$anchor)?, primitive: stored.primitive })
            }
        }
    };
}

mod discrete;
mod periodic;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

pub use self::discrete::DiscreteOrientationDmp;
pub use self::periodic::PeriodicOrientationDmp;
use crate::error::{MotionError, finite};

/// The result of a step of an orientation, in the frame of the demonstration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientationState {
    /// The orientation.
    pub orientation: UnitQuaternion<f64>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
}

/// The orientation with its angular velocity, from the rotation vector `e` from `goal` and its derivative `ed`, rad/s.
fn state_of(goal: &UnitQuaternion<f64>, e: &[f64], ed: &[f64]) -> OrientationState {
    let (e, ed) = (Vector3::from_column_slice(e), Vector3::from_column_slice(ed));
    OrientationState {
        orientation: UnitQuaternion::from_scaled_axis(e) * goal,
        angular_velocity: angular_velocity(&e, &ed),
    }
}

/// `J(e) ed`: the angular velocity of `exp(e)` in the fixed frame.
fn angular_velocity(e: &Vector3<f64>, ed: &Vector3<f64>) -> Vector3<f64> {
    let angle2 = e.norm_squared();
    let angle = angle2.sqrt();
    // Near 0 the quotients lose precision; the next terms of their series are below rounding there.
    let (a, b) = if angle < 1e-4 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        ((1.0 - libm::cos(angle)) / angle2, (angle - libm::sin(angle)) / (angle2 * angle))
    };
    let turned = e.cross(ed);
    ed + a * turned + b * e.cross(&turned)
}

/// `J(e)^-1 omega`: the derivative of the rotation vector `e` at an angular velocity, rad/s.
fn rotation_rate(e: &Vector3<f64>, omega: &Vector3<f64>) -> Vector3<f64> {
    let angle2 = e.norm_squared();
    let angle = angle2.sqrt();
    let c = if angle < 1e-4 {
        1.0 / 12.0 + angle2 / 720.0
    } else {
        (1.0 - 0.5 * angle * libm::cos(0.5 * angle) / libm::sin(0.5 * angle)) / angle2
    };
    let turned = e.cross(omega);
    omega - 0.5 * turned + c * e.cross(&turned)
}

/// The rotation vector from `goal` to `q`: of all equivalent ones, the one nearest to `near`; for `near` = 0 the
/// shortest.
fn rotation_vector(goal: &UnitQuaternion<f64>, q: &UnitQuaternion<f64>, near: &Vector3<f64>) -> Vector3<f64> {
    let shortest = (q * goal.inverse()).scaled_axis();
    // Additional full turns about its own axis lead to the same orientation; without an axis, those about that of
    // `near`.
    let Some(axis) = shortest.try_normalize(1e-12).or_else(|| near.try_normalize(1e-12)) else {
        return shortest;
    };
    let turns = ((near - shortest).dot(&axis) / std::f64::consts::TAU).round();
    shortest + axis * (std::f64::consts::TAU * turns)
}

/// The rotation vectors from `goal` to `orientations`, each the one nearest to the previous one, starting with
/// `near`.
fn rotation_vectors<'q>(
    goal: &UnitQuaternion<f64>,
    orientations: impl Iterator<Item = &'q UnitQuaternion<f64>>,
    near: Vector3<f64>,
) -> Vec<Vector3<f64>> {
    orientations
        .scan(near, |last, q| {
            *last = rotation_vector(goal, q, last);
            Some(*last)
        })
        .collect()
}

/// Refuses values that are not finite.
fn check_orientations(orientations: &[UnitQuaternion<f64>]) -> Result<(), MotionError> {
    orientations.iter().try_for_each(|q| finite("orientation", q.coords.as_slice()))
}

/// A unit quaternion from its stored form w, x, y, z.
fn read([w, x, y, z]: [f64; 4]) -> Result<UnitQuaternion<f64>, MotionError> {
    finite("orientation", &[w, x, y, z])?;
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)
        .ok_or(MotionError::Degenerate { what: "orientation", why: "the quaternion has no length" })
}

#[cfg(test)]
mod tests;
