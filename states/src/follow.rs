//! A platform that follows a hand which is led beyond the arm's reach.
//!
//! The hand is free within a circle about where the arm works best. Beyond it the platform drives after the hand, the faster the
//! farther the hand is, and the arm takes back from its own motion what the platform adds. It drives and does not turn.

use std::sync::Arc;

use armarium_robot::{Lease, Limb, Model, Platform, PlatformKind, Sensed};
use armarium_runtime::skill::{Failure, SkillContext};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::arm::{lease, workspace};
use crate::equipment::Equipment;
use crate::motions::failed;

/// Radius of the circle in which the hand is free, m, and the gain of what is beyond it, 1/s.
const FREE: f64 = 0.12;
const GAIN: f64 = 3.0;
/// Time constant with which the platform takes its speed, s.
const SMOOTH: f64 = 0.15;

/// The platform, leased.
pub(crate) struct FollowingPlatform {
    lease: Lease,
    model: Arc<Model>,
    platform: Platform,
    /// Where the arm works best, platform's frame.
    middle: Point3<f64>,
    velocity: Vector3<f64>,
}

impl FollowingPlatform {
    /// The platform that carries an arm; `None` if there is none, or somebody else drives it.
    pub(crate) fn take(
        equipment: &Equipment,
        context: &SkillContext,
        arm: &Limb,
        sample: &Sensed,
    ) -> Result<Option<Self>, Failure> {
        let model = Arc::clone(equipment.robot.model());
        let Some(platform) = model.platform().copied() else { return Ok(None) };
        let Ok(lease) = lease(equipment, context, Platform::LIMB, &[]) else { return Ok(None) };
        let root_from_platform = model.link_pose(&sample.position, platform.link);
        let works = workspace(&model, arm, &sample.position)?;
        let middle = root_from_platform.inverse() * Point3::from(works.translation.vector);
        Ok(Some(Self { lease, platform, middle, velocity: Vector3::zeros(), model }))
    }

    /// Drives after a hand at `root_from_tcp` for `dt` s. Returns the velocity with which it carries the arm, root frame, m/s.
    pub(crate) fn follow(
        &mut self,
        dt: f64,
        sample: &Sensed,
        root_from_tcp: &Isometry3<f64>,
    ) -> Result<Vector3<f64>, Failure> {
        let root_from_platform = self.model.link_pose(&sample.position, self.platform.link);
        let mut off = root_from_tcp.translation.vector - (root_from_platform * self.middle).coords;
        off.z = 0.0;
        if self.platform.kind == PlatformKind::Differential {
            let forward = root_from_platform.rotation * Vector3::y();
            off = forward * forward.dot(&off);
        }
        let beyond = (off.norm() - FREE).max(0.0);
        let fastest = self.model.joints()[self.platform.joints[0]].velocity;
        let wanted = off.try_normalize(1e-9).unwrap_or_default() * (GAIN * beyond).min(fastest);
        self.velocity += (wanted - self.velocity) * (1.0 - libm::exp(-dt / SMOOTH));
        self.command(self.velocity)?;
        Ok(self.velocity)
    }

    /// Stands.
    pub(crate) fn stand(&mut self) -> Result<(), Failure> {
        self.velocity = Vector3::zeros();
        self.command(self.velocity)
    }

    fn command(&self, v: Vector3<f64>) -> Result<(), Failure> {
        self.lease.command(&[v.x, v.y, 0.0]).map_err(failed)
    }
}
