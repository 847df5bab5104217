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
/// A hand that has moved on by less than this rests, m.
const RESTS: f64 = 0.01;
/// A rest of at most so long, s, is a part of the way, as at a corner; a longer one is not.
const SHORT_REST: f64 = 0.5;
/// Where the motion was learned.
const SOURCE: &str = "a hand that was led";

/// The way so far.
pub(crate) struct LedWay {
    poses: Vec<Isometry3<f64>>,
    /// Time since the last pose, s.
    since: f64,
    rhythm: Imitation,
    /// The poses since the hand rests, and whether it was led there. They belong to the way once it moves on; of a long rest only those in
    /// which it was led.
    resting: Vec<(Isometry3<f64>, bool)>,
}

impl LedWay {
    pub(crate) fn new() -> Result<Self, Failure> {
        let rhythm = Imitation::with_dofs(3).map_err(failed)?;
        Ok(Self { poses: Vec::new(), since: EVERY, rhythm, resting: Vec::new() })
    }

    /// Takes a pose of the hand into account, `dt` s after the last one, root frame, and whether the hand is led now. The way begins where it is
    /// first.
    pub(crate) fn add(&mut self, dt: f64, pose: &Isometry3<f64>, led: bool) -> Result<(), Failure> {
        self.since += dt;
        if self.since < EVERY - 1e-9 {
            return Ok(());
        }
        self.since -= EVERY;
        let long = self.rests_long();
        if !led && (self.poses.is_empty() || long) {
            return Ok(());
        }
        if (self.poses.len() + self.resting.len()) as f64 * EVERY > LONGEST {
            return Err(Failure::new(format!(
                "the hand is led for more than {LONGEST:.0} s, which cannot be kept"
            )));
        }
        self.resting.push((*pose, led));
        let place = |pose: &Isometry3<f64>| pose.translation.vector;
        if self.poses.last().is_some_and(|last| (place(pose) - place(last)).norm() < RESTS) {
            return Ok(());
        }
        for (pose, _) in self.resting.drain(..).filter(|(_, led)| *led || !long) {
            self.rhythm.observe(EVERY, place(&pose).as_slice()).map_err(failed)?;
            self.poses.push(pose);
        }
        Ok(())
    }

    /// Whether the hand has rested for long without being led.
    fn rests_long(&self) -> bool {
        self.resting.iter().filter(|(_, led)| !led).count() as f64 * EVERY > SHORT_REST
    }

    /// What was learned. As the hand is let go at the end, a rhythm is learned without the last rest.
    pub(crate) fn learned(&self, name: &str) -> Result<StoredMotion, Failure> {
        let periodic = self.rhythm.result().filter(|_| self.rhythm.periods() >= REPEATED);
        match periodic {
            Some((position, hz)) => Ok(StoredMotion::Motion(Box::new(self.periodic(name, position, hz)?))),
            None => {
                let last = self.resting.iter().filter(|(_, led)| *led).map(|(pose, _)| *pose);
                let all: Vec<_> = self.poses.iter().copied().chain(last).collect();
                let learned = Movement::learn(name, "root", EVERY, &all, SOURCE);
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
            self.poses[self.poses.len().saturating_sub(1 + back)].rotation
        };
        (0..count).map(at).collect()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn a_way_that_has_repeated_is_periodic_however_long_the_hand_rests_then() {
        for rest_s in [0.0, 1.0, 10.0] {
            let mut way = LedWay::new().unwrap();
            let (period_s, times) = (2.0, 8.0);
            for k in 0..((period_s * times + rest_s) / EVERY) as u32 {
                let (sin, cos) = libm::sincos(TAU * (f64::from(k) * EVERY / period_s).min(times));
                let turned = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.2 * cos);
                let pose = Isometry3::from_parts([0.06 * cos, 0.5 + 0.05 * sin, 1.0].into(), turned);
                way.add(EVERY, &pose, true).unwrap();
            }
            let StoredMotion::Motion(motion) = way.learned("led").unwrap() else { panic!("{rest_s} s") };
            assert!((motion.frequency_hz() - 0.5).abs() < 0.005, "{rest_s} s: {}", motion.frequency_hz());
            // Where the hand is at the side at which it was turned most, the motion turns it so, too.
            let turn = |phase: f64| way.last_period(0.5)[(phase * 100.0) as usize].euler_angles().2;
            let most = (0..100).map(|k| f64::from(k) / 100.0).max_by(|a, b| turn(*a).total_cmp(&turn(*b)));
            let at = motion.primitive().steady_path(100).unwrap();
            let side = (0..100).max_by(|a, b| at.y[*a][0].total_cmp(&at.y[*b][0])).unwrap();
            let apart = (most.unwrap() - side as f64 / 100.0 + 1.5).rem_euclid(1.0) - 0.5;
            assert!(apart.abs() < 0.06, "{rest_s} s: {apart} of a period");
        }
    }

    #[test]
    fn short_rests_at_corners_are_a_part_of_the_rhythm_and_long_ones_are_not() {
        let corners =
            [[0.0, 0.0], [0.08, 0.0], [0.08, 0.08], [0.0, 0.08]].map(|[x, y]| Vector3::new(x, y, 1.0));
        let (moves, side_s) = (15, 0.3);
        for (rests, rest_s) in [(10, 0.2), (50, 0.0)] {
            let mut way = LedWay::new().unwrap();
            for side in 0..32 {
                let (from, to) = (corners[side % 4], corners[(side + 1) % 4]);
                for k in 0..moves + rests {
                    let at = from + (to - from) * (f64::from(k) / f64::from(moves)).min(1.0);
                    let pose = Isometry3::from_parts(at.into(), UnitQuaternion::identity());
                    way.add(EVERY, &pose, k < moves).unwrap();
                }
            }
            let StoredMotion::Motion(motion) = way.learned("led").unwrap() else { panic!("{rests} rests") };
            let hz = 0.25 / (side_s + rest_s);
            assert!((motion.frequency_hz() - hz).abs() < 0.02 * hz, "{rests}: {}", motion.frequency_hz());
        }
    }
}
