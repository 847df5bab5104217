//! The way that a hand was led, learned as a motion: from its start to its goal, or periodic where it repeats.

use std::f64::consts::TAU;

use armarium_motion::{Imitation, Motion, Movement, PeriodicDmp, PeriodicDmpConfig, PeriodicOrientationDmp};
use armarium_runtime::skill::Failure;
use nalgebra::{Isometry3, UnitQuaternion};

use crate::motions::{StoredMotion, failed};

/// Time between two poses that are learned, s.
const EVERY: f64 = 0.02;
/// Longest way that is learned, s.
const LONGEST: f64 = 300.0;
/// A way that has repeated so often is periodic.
const REPEATED: f64 = 3.0;
/// Where the motion was learned.
const SOURCE: &str = "a hand that was led";

/// The way so far.
pub(crate) struct LedWay {
    poses: Vec<Isometry3<f64>>,
    /// Time since the last pose, s.
    since: f64,
    rhythm: Imitation,
}

impl LedWay {
    pub(crate) fn new() -> Result<Self, Failure> {
        Ok(Self { poses: Vec::new(), since: EVERY, rhythm: Imitation::with_dofs(3).map_err(failed)? })
    }

    /// Takes a pose of the hand into account, `dt` s after the last one, root frame.
    pub(crate) fn add(&mut self, dt: f64, pose: &Isometry3<f64>) -> Result<(), Failure> {
        self.since += dt;
        if self.since < EVERY - 1e-9 {
            return Ok(());
        }
        self.since -= EVERY;
        if self.poses.len() as f64 * EVERY > LONGEST {
            return Err(Failure::new(format!(
                "the hand is led for more than {LONGEST:.0} s, which cannot be kept"
            )));
        }
        self.poses.push(*pose);
        self.rhythm.observe(EVERY, pose.translation.vector.as_slice()).map_err(failed)
    }

    /// What was learned.
    pub(crate) fn learned(&self, name: &str) -> Result<StoredMotion, Failure> {
        let periodic = self.rhythm.result().filter(|_| self.rhythm.periods() >= REPEATED);
        match periodic {
            Some((position, hz)) => Ok(StoredMotion::Motion(Box::new(self.periodic(name, position, hz)?))),
            None => {
                let learned = Movement::learn(name, "root", EVERY, &self.poses, SOURCE);
                Ok(StoredMotion::Movement(Box::new(learned.map_err(failed)?)))
            }
        }
    }

    fn periodic(&self, name: &str, position: &PeriodicDmp, hz: f64) -> Result<Motion, Failure> {
        let mut orientation = PeriodicOrientationDmp::new(PeriodicDmpConfig::default()).map_err(failed)?;
        orientation.learn_period(&self.last_period(hz)).map_err(failed)?;
        let motion = Motion::in_space(name, "root", hz, position.clone()).map_err(failed)?;
        Ok(motion.with_learned_from(SOURCE).with_orientation(Some(orientation)))
    }

    /// The orientations of the last period, from the phase 0 on.
    fn last_period(&self, hz: f64) -> Vec<UnitQuaternion<f64>> {
        let count = (1.0 / (hz * EVERY)).round().max(1.0) as usize;
        let end = self.rhythm.oscillator().phase() / TAU;
        let at = |k: usize| {
            // How long ago this phase was, in periods.
            let ago = (end - k as f64 / count as f64).rem_euclid(1.0);
            let back = (ago * count as f64).round() as usize;
            self.poses[(self.poses.len() - 1).saturating_sub(back)].rotation
        };
        (0..count).map(at).collect()
    }
}
