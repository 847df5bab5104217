//! The motion of one hand of two that lift and shake a load: a discrete-periodic primitive of its TCP's place or of its arm's
//! joints.

use armarium_motion::{DiscretePeriodicConfig, DiscretePeriodicDmp, LiftAndShake, LinePoint, differentiate};
use armarium_robot::Sensed;
use armarium_runtime::skill::Failure;
use nalgebra::{Isometry3, Vector3};

use crate::arm::LeasedArm;
use crate::both::at_rest;
use crate::motions::failed;

/// Time between the samples of a demonstration, s.
const DT: f64 = 5e-3;
/// Constants of the primitive's transformation system: softer than the paper's, so that feedback moves the hand.
const ALPHA_Z: f64 = 8.0;

/// The space in which a motion is learned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Space {
    /// The place of the TCP, root frame; the hand does not turn.
    Task,
    /// The arm's joints.
    Joint,
}

/// A hand's motion.
pub(crate) struct HandMotion {
    space: Space,
    pub(crate) primitive: DiscretePeriodicDmp,
    /// Where the TCP is at the beginning, and the joints.
    home: Isometry3<f64>,
    posture: Vec<f64>,
}

impl HandMotion {
    /// Learns the motion from a demonstration: the hand lifts and shakes from where it is, level, for so many periods.
    pub(crate) fn demonstrated(
        arm: &mut LeasedArm,
        sample: &Sensed,
        space: Space,
        path: &LiftAndShake,
        periods: f64,
    ) -> Result<Self, Failure> {
        path.check().map_err(failed)?;
        let (home, posture) = (arm.tcp(sample), arm.positions(sample));
        let period = std::f64::consts::TAU / path.omega;
        let samples = ((path.duration + periods * period) / DT).round() as usize;
        let way = (0..=samples).map(|k| {
            let [height, speed] = path.at(DT * k as f64);
            let mut pose = home;
            pose.translation.z += height;
            LinePoint { linear: Vector3::z() * speed, ..at_rest(pose) }
        });
        let shown: Vec<Vec<f64>> = match space {
            Space::Task => way.map(|point| point.pose.translation.vector.as_slice().to_vec()).collect(),
            Space::Joint => arm.joints_along(sample, DT, way)?,
        };
        let dofs = shown.first().map_or(1, Vec::len);
        let config = DiscretePeriodicConfig {
            alpha_z: ALPHA_Z,
            beta_z: ALPHA_Z / 4.0,
            ..DiscretePeriodicConfig::with_dofs(dofs)
        };
        let mut primitive = DiscretePeriodicDmp::new(config, path.omega, path.duration).map_err(failed)?;
        primitive.learn(&differentiate(DT, &shown).map_err(failed)?).map_err(failed)?;
        Ok(Self { space, primitive, home, posture })
    }

    /// The pose of its TCP at the beginning, at rest.
    pub(crate) fn home(&self) -> LinePoint {
        at_rest(self.home)
    }

    /// Lets the arm's null space pull towards the posture of the beginning.
    pub(crate) fn pull_home(&self, arm: &mut LeasedArm) {
        arm.pull_towards(&self.posture);
    }

    /// Where the TCP goes now. In joint space the null space goes to the joints of the motion, too.
    pub(crate) fn point(&self, arm: &mut LeasedArm, sample: &Sensed) -> LinePoint {
        let state = self.primitive.state();
        match self.space {
            Space::Task => {
                let place = Vector3::from_column_slice(state.y);
                let pose = Isometry3::from_parts(place.into(), self.home.rotation);
                LinePoint { linear: Vector3::from_column_slice(state.yd), ..at_rest(pose) }
            }
            Space::Joint => {
                arm.pull_towards(state.y);
                arm.tcp_with(sample, state.y, state.yd)
            }
        }
    }
}
