//! The coaching field of the paper: converts a gesture in space to a coupling term (eqs. 14-16), and the two-handed
//! gesture interface of its second experiment (eqs. 18-21).
//!
//! Pure functions of positions. [`crate::CoachedMotion`] applies the coupling to the wiping motion; other callers use
//! [`crate::PeriodicDmp::couple`] (in joint space after a Jacobian pseudoinverse, eq. 17).

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

constants! {
    /// The constants of (14)-(16).
    ///
    /// The defaults are the paper's constants for the planar arm with links of 1 m (section III).
    #[derive(Copy)]
    pub struct PotentialField {
        /// Scale gamma of the coupling.
        gamma: f64 = 100.0;
        /// Steepness eta of the edge of the field, 1/m.
        eta: f64 = 20.0;
        /// Distance r_m at which the field has half its strength, m.
        r_m: f64 = 0.35;
        /// How fast the field decreases with the angle between motion and coaching point, 1/rad; only its magnitude
        /// counts.
        beta: f64 = -8.0 / std::f64::consts::PI;
    }
}

impl PotentialField {
    /// s(distance) of (16), 0 to 1; `distance` m.
    pub fn reach(&self, distance: f64) -> f64 {
        reach(self.eta, self.r_m, distance)
    }

    /// The magnitude of C_y in (14), to be multiplied by the direction d. `o` is the coaching point and `x` the end
    /// effector, m, `v` its velocity, m/s, all of the same dimension.
    ///
    /// # Source
    /// (14)-(16); differs in: the exponent is `-|beta| phi`, since with the printed negative beta the field would
    /// grow behind the hand; and where (15) is 0/0 (`o = x` or `v = 0`) the angle is pi/2.
    pub fn strength(&self, o: &[f64], x: &[f64], v: &[f64]) -> f64 {
        let offset = |i: usize| o[i] - x[i];
        let n = o.len().min(x.len()).min(v.len());
        let distance = (0..n).map(|i| offset(i) * offset(i)).sum::<f64>().sqrt();
        let speed = (0..n).map(|i| v[i] * v[i]).sum::<f64>().sqrt();
        let along: f64 = (0..n).map(|i| offset(i) * v[i]).sum();
        let cosine = along / (distance * speed);
        let angle = if cosine.is_finite() { libm::acos(cosine.clamp(-1.0, 1.0)) } else { FRAC_PI_2 };
        self.gamma * self.reach(distance) * libm::exp(-self.beta.abs() * angle)
    }
}

/// (16): 1 near the centre of the field, one half at `r_m`, 0 far from it.
pub(crate) fn reach(eta: f64, r_m: f64, distance: f64) -> f64 {
    1.0 / (1.0 + libm::exp(eta * (distance - r_m)))
}

/// One arm of the coach from a body tracker, in the robot's base frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoachArm {
    /// The wrist.
    pub wrist: Vector3<f64>,
    /// The elbow.
    pub elbow: Vector3<f64>,
}

/// Centre and direction of a gesture's field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoachingCommand {
    /// Centre o, m.
    pub o: Vector3<f64>,
    /// Unit direction d.
    pub d: Vector3<f64>,
}

/// The right hand pushes away from the coach: `distance` is xi_R, m. `None` if wrist and elbow coincide.
///
/// # Source
/// Eqs. (18), (20).
pub fn pushing_hand(arm: &CoachArm, distance: f64) -> Option<CoachingCommand> {
    let d = (arm.wrist - arm.elbow).try_normalize(1e-9)?;
    Some(CoachingCommand { o: arm.wrist + distance * d, d })
}

/// The left hand pulls towards the coach: `distance` is xi_L, m. `None` if wrist and elbow coincide.
///
/// # Source
/// Eqs. (19), (21).
pub fn pulling_hand(arm: &CoachArm, distance: f64) -> Option<CoachingCommand> {
    let d = (arm.elbow - arm.wrist).try_normalize(1e-9)?;
    Some(CoachingCommand { o: arm.wrist - distance * d, d })
}

/// The command of the hand whose wrist is nearer to the end effector at `x` (m): the right pushes, the left pulls.
pub fn nearer_hand(
    right: &CoachArm,
    left: &CoachArm,
    x: &Vector3<f64>,
    distance: f64,
) -> Option<CoachingCommand> {
    if (right.wrist - x).norm() <= (left.wrist - x).norm() {
        pushing_hand(right, distance)
    } else {
        pulling_hand(left, distance)
    }
}

constants! {
    /// Slows the motion down as the coach's hand comes near.
    #[derive(Copy)]
    pub struct SlowDown {
        /// At this distance or less, m, the motion is slowest.
        near: f64 = 0.20;
        /// From this distance on, m, the motion has the learned speed.
        far: f64 = 0.40;
        /// The frequency at `near` as a share of the learned one, 0 to 1.
        slowest: f64 = 0.55;
    }
}

impl SlowDown {
    /// The factor on the frequency for a hand `distance` m from the end effector: smooth, and 1 without a hand
    /// (infinite or NaN).
    pub fn factor(&self, distance: f64) -> f64 {
        if !distance.is_finite() {
            return 1.0;
        }
        let span = (self.far - self.near).max(1e-9);
        let s = ((distance - self.near) / span).clamp(0.0, 1.0);
        self.slowest + (1.0 - self.slowest) * s * s * (3.0 - 2.0 * s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_has_half_its_strength_at_r_m_and_fades_behind() {
        let field = PotentialField::default();
        let ahead = field.strength(&[0.35, 0.0], &[0.0, 0.0], &[1.0, 0.0]);
        assert!((ahead - 50.0).abs() < 1e-9);
        let behind = field.strength(&[-0.35, 0.0], &[0.0, 0.0], &[1.0, 0.0]);
        assert!((behind / ahead - libm::exp(-8.0_f64)).abs() < 1e-12);
    }

    #[test]
    fn the_field_is_defined_where_the_angle_is_not() {
        let field = PotentialField::default();
        let beside = libm::exp(-4.0_f64);
        assert!(
            (field.strength(&[0.0; 3], &[0.0; 3], &[1.0, 0.0, 0.0]) / field.gamma / field.reach(0.0)
                - beside)
                .abs()
                < 1e-12
        );
        assert!((field.strength(&[0.35, 0.0], &[0.0; 2], &[0.0; 2]) - 50.0 * beside).abs() < 1e-9);
        assert!(field.strength(&[1e200, 0.0], &[0.0; 2], &[1.0, 0.0]).is_finite());
    }

    #[test]
    fn hands_push_and_pull_along_the_forearm() {
        let arm = CoachArm { wrist: Vector3::new(1.0, 0.0, 0.0), elbow: Vector3::new(0.7, 0.0, 0.0) };
        let push = pushing_hand(&arm, 0.1).unwrap();
        assert!(
            (push.d - Vector3::x()).norm() < 1e-12 && (push.o - Vector3::new(1.1, 0.0, 0.0)).norm() < 1e-12
        );
        let pull = pulling_hand(&arm, 0.1).unwrap();
        assert!(
            (pull.d + Vector3::x()).norm() < 1e-12 && (pull.o - Vector3::new(1.1, 0.0, 0.0)).norm() < 1e-12
        );
        let far = CoachArm { wrist: Vector3::new(5.0, 0.0, 0.0), elbow: Vector3::new(5.3, 0.0, 0.0) };
        assert_eq!(nearer_hand(&arm, &far, &Vector3::zeros(), 0.1), Some(push));
        assert_eq!(pushing_hand(&CoachArm { wrist: arm.wrist, elbow: arm.wrist }, 0.1), None);
    }

    #[test]
    fn the_motion_slows_only_near_the_hand() {
        let slow = SlowDown::default();
        assert_eq!(slow.factor(f64::INFINITY), 1.0);
        assert_eq!(slow.factor(1.0), 1.0);
        assert!((slow.factor(0.0) - 0.55).abs() < 1e-12);
        assert!(slow.factor(0.25) < slow.factor(0.3));
    }
}
