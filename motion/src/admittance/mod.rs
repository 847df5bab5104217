//! Guiding a robot by its hand: from the wrench of a person on the hand to the twist with which it follows.
//!
//! The hand moves as a free body of its own mass would, with damping and dry friction. The dry friction is the dead zone:
//! a wrench below it moves nothing, so that a sensor's errors do not either. Where a stiff person and the lag of the
//! drives would swing against each other, the damping grows with the stiffness of the person that is seen in force and
//! motion (`stiffness.rs`).
//!
//! It knows no robot and no limits of an arm: whoever executes the twist says with [`Admittance::hold_to`] what was possible.
//!
//! # Why it is passive
//!
//! The step solves `M (v' - v) / dt = f - D v' - F v' / |v'|` for the new velocity `v'`, so
//! `M (|v'|² - |v|²) / 2 <= dt (f . v' - D |v'|² - F |v'|)`: the stored energy grows by less than what the person gives,
//! whatever `dt` is, and however damping `D >= 0` and friction `F >= 0` change from step to step. A bound of the speed keeps
//! the direction, and so is nothing but more damping. Turning is the same by itself.

mod stiffness;
#[cfg(test)]
mod tests;

use nalgebra::{Vector3, Vector6};

use self::stiffness::StiffnessEstimate;
use crate::constants::{GAIN, POSITIVE};
use crate::error::{MotionError, sample_time, vector};

constants! {
    /// The constants of an [`Admittance`].
    pub struct AdmittanceConfig {
        /// Mass that the hand seems to have, kg; more than that of a person's hand, or the two swing against each other.
        mass: f64 = 5.0, GAIN;
        /// Inertia that it seems to have about each axis, kg m².
        inertia: f64 = 0.1, GAIN;
        /// Dry friction: a smaller force moves nothing, N.
        friction: f64 = 1.5, 0.0..=1e9;
        /// The same for turning, N m.
        turning_friction: f64 = 0.15, 0.0..=1e9;
        /// Damping for a person who is not stiff, N s/m.
        damping: f64 = 14.0, 0.0..=1e9;
        /// Damping of turning, N m s/rad.
        turning_damping: f64 = 1.0, 0.0..=1e9;
        /// Time from a change of the force to the motion that follows from it, s. With a person of the stiffness K it takes
        /// the damping K times this time from the two together; as much is added.
        lag: f64 = 0.03, 0.0..=10.0;
        /// Largest damping, N s/m.
        most_damping: f64 = 40.0, 0.0..=1e9;
        /// Largest speed, m/s.
        max_linear: f64 = 0.5, POSITIVE;
        /// Largest angular velocity, rad/s.
        max_angular: f64 = 1.0, POSITIVE;
        /// A larger force is no guiding, but a shove, N.
        shove: f64 = 30.0, POSITIVE;
        /// Time constant with which the zero of the wrench follows what is felt at rest, s.
        zero_time: f64 = 10.0, POSITIVE;
    }
}

/// What the hand does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GuidingStatus {
    /// It rests: nothing over the friction is felt.
    Resting,
    /// It is led.
    Led,
    /// It was shoved with this force, N, and stands from then on.
    Shoved(f64),
}

/// A step of an [`Admittance`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidedStep {
    /// Velocity, m/s, then angular velocity, rad/s, in the frame of the wrench.
    pub twist: Vector6<f64>,
    /// What the hand does.
    pub status: GuidingStatus,
    /// The damping in this step, N s/m.
    pub damping: f64,
}

/// A hand that is led by the wrench on it; see the module.
///
/// # Source
/// Hogan 1985 (impedance and admittance); Tsumugiwa, Yokogawa and Hara 2002 (damping in proportion to the stiffness of the
/// arm that leads; differs in: the stiffness is estimated from swinging only, and dry friction takes the place of a dead zone
/// of the force, with which a hand that is braked gives back more energy than it got).
#[derive(Debug, Clone)]
pub struct Admittance {
    config: AdmittanceConfig,
    twist: Vector6<f64>,
    zero: Vector6<f64>,
    stiffness: StiffnessEstimate,
    shoved: Option<f64>,
}

impl Admittance {
    /// A hand at rest that feels nothing.
    ///
    /// # Errors
    /// When a constant is outside its range.
    pub fn new(config: AdmittanceConfig) -> Result<Self, MotionError> {
        config.check_ranges()?;
        let (twist, zero) = (Vector6::zeros(), Vector6::zeros());
        Ok(Self { config, twist, zero, stiffness: StiffnessEstimate::default(), shoved: None })
    }

    /// Advances by `dt` s. `wrench`: compensated force, N, and torque about the hand's reference point, N m; `position`: where
    /// that point is, m, both in one frame that does not turn. Does not allocate.
    ///
    /// # Errors
    /// When `dt` is not positive or a number is not finite; nothing is changed.
    pub fn step(
        &mut self,
        dt: f64,
        wrench: &Vector6<f64>,
        position: &Vector3<f64>,
    ) -> Result<GuidedStep, MotionError> {
        sample_time(dt)?;
        vector("wrench", 6, wrench.as_slice())?;
        vector("position", 3, position.as_slice())?;
        let felt = wrench - self.zero;
        let (force, torque) = parts(&felt);
        if force.norm() > self.config.shove || self.shoved.is_some() {
            let worst = self.shoved.unwrap_or_default().max(force.norm());
            self.shoved = Some(worst);
            self.twist = Vector6::zeros();
            return Ok(self.now(GuidingStatus::Shoved(worst), 0.0));
        }
        self.stiffness.observe(dt, &force, position);
        let c = &self.config;
        let damping = (c.damping + c.lag * self.stiffness.value()).min(c.most_damping);
        let (linear, angular) = parts(&self.twist);
        let linear = FreeBody { mass: c.mass, damping, friction: c.friction, fastest: c.max_linear }
            .moved_by(&force, &linear, dt);
        let angular = FreeBody {
            mass: c.inertia,
            damping: c.turning_damping,
            friction: c.turning_friction,
            fastest: c.max_angular,
        }
        .moved_by(&torque, &angular, dt);
        self.twist = joined(&linear, &angular);
        if self.twist == Vector6::zeros() {
            self.zero += felt * (1.0 - libm::exp(-dt / c.zero_time));
            return Ok(self.now(GuidingStatus::Resting, damping));
        }
        Ok(self.now(GuidingStatus::Led, damping))
    }

    /// Goes on from the twist that was possible instead of the one that was asked for: an arm at the end of its reach, or
    /// slower than the person. It never adds energy: a larger velocity than the own one is not taken over.
    ///
    /// # Errors
    /// When the twist is not finite; nothing is changed.
    pub fn hold_to(&mut self, possible: &Vector6<f64>) -> Result<(), MotionError> {
        vector("possible", 6, possible.as_slice())?;
        let ((linear, angular), (asked, turned)) = (parts(possible), parts(&self.twist));
        self.twist = joined(&linear.cap_magnitude(asked.norm()), &angular.cap_magnitude(turned.norm()));
        Ok(())
    }

    /// The stiffness with which the person seems to hold the hand, N/m.
    pub fn stiffness(&self) -> f64 {
        self.stiffness.value()
    }

    /// The wrench that counts as zero: what was felt at rest, N and N m.
    pub fn zero(&self) -> &Vector6<f64> {
        &self.zero
    }

    fn now(&self, status: GuidingStatus, damping: f64) -> GuidedStep {
        GuidedStep { twist: self.twist, status, damping }
    }
}

/// A free body with damping and dry friction; mass and force may as well be inertia and torque.
struct FreeBody {
    mass: f64,
    damping: f64,
    friction: f64,
    fastest: f64,
}

impl FreeBody {
    /// The velocity after `dt`, by the implicit step of the module.
    fn moved_by(&self, force: &Vector3<f64>, velocity: &Vector3<f64>, dt: f64) -> Vector3<f64> {
        let pushed = velocity + force * (dt / self.mass);
        let speed = pushed.norm();
        let kept = (speed - dt * self.friction / self.mass) / (1.0 + dt * self.damping / self.mass);
        if kept <= 0.0 { Vector3::zeros() } else { pushed * (kept.min(self.fastest) / speed) }
    }
}

fn parts(v: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (v.fixed_rows::<3>(0).into_owned(), v.fixed_rows::<3>(3).into_owned())
}

fn joined(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}
