//! Rounds recorded numbers to fixed grids.
//!
//! At 1 kHz most of a recording would be the noisy last digits of measured numbers, which do not compress.
//! Rounding far below the resolution of figures and sensors halves the size of a number and saves a fifth of a
//! recording. Signals are not filtered or decimated here.

use nalgebra::{Isometry3, Quaternion, Translation3, Unit};

use super::messages::{TrueContact, WrenchSample};

/// Steps per metre of positions, and per unit of quaternion components: about a micrometre.
const POSE: f64 = (1 << 20) as f64;
/// Steps per radian (or metre) of joint positions: 0.03 mrad, a seventh of the sensor's noise.
const JOINT: f64 = (1 << 15) as f64;
/// Steps per rad/s (or m/s) of joint velocities: 0.5 mrad/s.
const JOINT_VELOCITY: f64 = (1 << 11) as f64;
/// Steps per newton of the wrist's forces; decimal, because they are written as text.
const FORCE: f64 = 1e2;
/// Steps per newton metre of the wrist's torques.
const TORQUE: f64 = 1e3;
/// Steps per newton of the true contact force.
const CONTACT: f64 = 1e3;

fn on(steps: f64, value: f64) -> f64 {
    (value * steps).round() / steps
}

pub(super) fn pose(pose: &Isometry3<f64>) -> Isometry3<f64> {
    let translation = Translation3::from(pose.translation.vector.map(|v| on(POSE, v)));
    let rotation = Quaternion::from(pose.rotation.coords.map(|v| on(POSE, v)));
    Isometry3::from_parts(translation, Unit::new_unchecked(rotation))
}

pub(super) fn joint_position(position: f64) -> f64 {
    on(JOINT, position)
}

pub(super) fn joint_velocity(velocity: f64) -> f64 {
    on(JOINT_VELOCITY, velocity)
}

pub(super) fn contact(contact: &TrueContact) -> TrueContact {
    TrueContact { normal_n: on(CONTACT, contact.normal_n), tangential_n: on(CONTACT, contact.tangential_n) }
}

pub(super) fn wrench(sample: &WrenchSample) -> WrenchSample {
    WrenchSample {
        force_raw: sample.force_raw.map(|v| on(FORCE, v)),
        torque_raw: sample.torque_raw.map(|v| on(TORQUE, v)),
        force: sample.force.map(|v| on(FORCE, v)),
        torque: sample.torque.map(|v| on(TORQUE, v)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_moves_by_less_than_a_micrometre_and_stays_a_rotation() {
        let exact = Isometry3::new([0.123_456_789, -0.5, 1.05].into(), [0.3, -0.7, 1.1].into());
        let kept = pose(&exact);
        assert!((kept.translation.vector - exact.translation.vector).amax() < 0.5e-6);
        assert!(kept.rotation.angle_to(&exact.rotation) < 3e-6);
        assert!((kept.rotation.norm() - 1.0).abs() < 2e-6);
        assert_eq!(pose(&kept), kept);
    }

    #[test]
    fn a_force_is_short_as_text_and_what_is_no_number_stays_none() {
        let kept = contact(&TrueContact { normal_n: 8.000_499_9, tangential_n: f64::NAN });
        assert_eq!(kept.normal_n.to_string(), "8");
        assert!(kept.tangential_n.is_nan());
    }
}
