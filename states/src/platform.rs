//! Where a platform is, and one that follows a hand that is led beyond its arm's reach, or what both hands carry.
//!
//! What it follows is free within a circle about where the arms work best. Beyond it the platform drives after it, the faster the
//! farther that is, and the arms take back from their own motion what the platform adds. After a hand it drives and does not turn.

use std::sync::Arc;

use armarium_motion::LinePoint;
use armarium_robot::{Lease, Limb, Model, Platform, PlatformKind, Sensed, Twist};
use armarium_runtime::skill::{Failure, SkillContext};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::arm::{lease, workspace};
use crate::equipment::Equipment;
use crate::motions::failed;

/// Radius of the circle in which a hand is free, m. A load has none: it moves as slowly as a platform can.
const FREE: f64 = 0.12;
/// Gain of what is beyond the circle, and of the missing turn, 1/s.
const GAIN: f64 = 3.0;
/// Time constant with which the platform takes its speed, s.
const SMOOTH: f64 = 0.15;

/// The platform, leased.
pub(crate) struct FollowingPlatform {
    lease: Lease,
    model: Arc<Model>,
    platform: Platform,
    /// Where what it follows is best, platform's frame.
    best: Isometry3<f64>,
    free: f64,
    turns: bool,
    /// Its velocity along the floor, root frame, m/s, and its turn to the left, rad/s.
    velocity: Vector3<f64>,
    turning: f64,
}

impl FollowingPlatform {
    /// The platform that carries an arm, to follow its hand; `None` if there is none, or somebody else drives it.
    pub(crate) fn after_hand(
        equipment: &Equipment,
        context: &SkillContext,
        arm: &Limb,
        sample: &Sensed,
    ) -> Result<Option<Self>, Failure> {
        let works = workspace(equipment.robot.model(), arm, &sample.position)?;
        let works = Isometry3::from_parts(works.translation, UnitQuaternion::identity());
        Ok(Self::take(equipment, context, sample, (&works, FREE, false)).ok())
    }

    /// The platform, to stay under what both hands carry as it is now, with that at `root_from_load`; a failure if there is none, or
    /// somebody else drives it.
    pub(crate) fn under_load(
        equipment: &Equipment,
        context: &SkillContext,
        sample: &Sensed,
        root_from_load: &Isometry3<f64>,
    ) -> Result<Self, Failure> {
        Self::take(equipment, context, sample, (root_from_load, 0.0, true))
    }

    fn take(
        equipment: &Equipment,
        context: &SkillContext,
        sample: &Sensed,
        (root_from_best, free, turns): (&Isometry3<f64>, f64, bool),
    ) -> Result<Self, Failure> {
        let model = Arc::clone(equipment.robot.model());
        let platform = platform_of(&model)?;
        let lease = lease(equipment, context, Platform::LIMB, &[])?;
        let best = place(&model, &platform, sample).inverse() * root_from_best;
        let (velocity, turning) = (Vector3::zeros(), 0.0);
        Ok(Self { lease, model, platform, best, free, turns, velocity, turning })
    }

    /// Drives for `dt` s after something that is at `point` (root frame) and moves like it.
    pub(crate) fn follow(&mut self, dt: f64, sample: &Sensed, point: &LinePoint) -> Result<(), Failure> {
        let here = place(&self.model, &self.platform, sample);
        let (missing, turn) = match self.turns {
            true => (turn_between(&(here * self.best).rotation, &point.pose.rotation), point.angular.z),
            false => (0.0, 0.0),
        };
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), missing) * here.rotation;
        let best = flat(turned * self.best.translation.vector);
        let off = self.drivable(&here, flat(point.pose.translation.vector - here.translation.vector) - best);
        let with_it = self.drivable(&here, flat(point.linear) - (Vector3::z() * turn).cross(&best));
        let beyond = off.try_normalize(1e-9).unwrap_or_default() * (GAIN * (off.norm() - self.free).max(0.0));
        let [along, _, about] = self.platform.joints.map(|joint| self.model.joints()[joint].velocity);
        let velocity = (with_it + beyond).cap_magnitude(along);
        let turning = (turn + GAIN * missing).clamp(-about, about);
        let share = 1.0 - libm::exp(-dt / SMOOTH);
        self.velocity += (velocity - self.velocity) * share;
        self.turning += (turning - self.turning) * share;
        self.command()
    }

    /// What of a motion along the floor it can drive where it is without turning.
    fn drivable(&self, here: &Isometry3<f64>, motion: Vector3<f64>) -> Vector3<f64> {
        let forward = here.rotation * Vector3::y();
        match self.platform.kind {
            PlatformKind::Differential => forward * forward.dot(&motion),
            _ => motion,
        }
    }

    /// The velocity with which it carries what is at a place in the root frame.
    pub(crate) fn carries(&self, sample: &Sensed, at: &Vector3<f64>) -> Twist {
        let here = place(&self.model, &self.platform, sample);
        let angular = Vector3::z() * self.turning;
        Twist { linear: self.velocity + angular.cross(&(at - here.translation.vector)), angular }
    }

    /// Stands.
    pub(crate) fn stand(&mut self) -> Result<(), Failure> {
        (self.velocity, self.turning) = (Vector3::zeros(), 0.0);
        self.command()
    }

    fn command(&self) -> Result<(), Failure> {
        self.lease.command(&[self.velocity.x, self.velocity.y, self.turning]).map_err(failed)
    }
}

/// What the robot drives on.
pub(crate) fn platform_of(model: &Model) -> Result<Platform, Failure> {
    let none = || Failure::new(format!("the robot `{}` has no platform", model.name()));
    model.platform().copied().ok_or_else(none)
}

/// Where a platform is, root frame.
pub(crate) fn place(model: &Model, platform: &Platform, sample: &Sensed) -> Isometry3<f64> {
    model.link_pose(&sample.position, platform.link)
}

/// What of a vector is along the floor.
fn flat(v: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x, v.y, 0.0)
}

/// How far one orientation is turned to the left from another about the vertical, rad, within half a turn.
pub(crate) fn turn_between(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>) -> f64 {
    let x = from.inverse() * (to * Vector3::x());
    libm::atan2(x.y, x.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_turn_is_the_shortest_one_to_the_left() {
        let yaw = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        assert!((turn_between(&yaw(3.0), &yaw(-3.0)) - (std::f64::consts::TAU - 6.0)).abs() < 1e-9);
        assert!((turn_between(&yaw(0.4), &yaw(0.1)) + 0.3).abs() < 1e-9);
    }
}
