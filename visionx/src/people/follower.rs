//! Joints over time, root frame: a Kalman filter each, whose joint moves on as it did, and which side is which.
//!
//! # Source
//! Bar-Shalom, Li and Kirubarajan 2001, *Estimation with Applications to Tracking and Navigation*, 6.3.2: white noise acceleration.

use nalgebra::{Matrix3, Matrix6, Matrix6x3, Point3, Vector3, Vector6};

use super::{BodyJoint, SeenJoint};

/// Standard deviation of the acceleration of a joint, m/s², and of its first velocity, m/s.
const ACCELERATION: f64 = 6.0;
const VELOCITY: f64 = 0.5;
/// What is seen farther away than this (squared, in standard deviations) is not the joint, unless it is seen there so often.
const GATE: f64 = 16.0;
const INSISTS: u32 = 4;
/// A joint that was not seen for this long is not known any more, s.
const FORGOTTEN: f64 = 0.5;
/// By how much less the joints must be off with sides exchanged, share, and how often before the exchange is believed.
const EXCHANGED: f64 = 0.6;
const EXCHANGES: u32 = 12;

/// Where a joint is and how fast it moves.
#[derive(Clone, Debug)]
struct JointTrack {
    state: Vector6<f64>,
    covariance: Matrix6<f64>,
    /// When it was seen last, ns.
    seen_ns: u64,
    /// The time of the state, ns.
    stamp_ns: u64,
    refused: u32,
}

/// The joints of one person.
#[derive(Clone, Debug, Default)]
pub(super) struct BodyFollower {
    tracks: [Option<JointTrack>; 7],
    /// For how many frames the sides have seemed to be exchanged.
    exchanged: u32,
}

impl BodyFollower {
    /// Takes over what was seen; returns where the joints are.
    pub(super) fn update(&mut self, stamp_ns: u64, seen: [Option<SeenJoint>; 7]) -> [Option<SeenJoint>; 7] {
        let seen = self.sorted(stamp_ns, seen);
        for (track, seen) in self.tracks.iter_mut().zip(seen) {
            match (track.as_mut(), seen) {
                (Some(known), Some(seen)) => {
                    if !known.update(stamp_ns, &seen) {
                        *track = Some(JointTrack::new(stamp_ns, &seen));
                    }
                }
                (None, Some(seen)) => *track = Some(JointTrack::new(stamp_ns, &seen)),
                (_, None) => {}
            }
        }
        self.at(stamp_ns)
    }

    /// Where the joints are at a time.
    pub(super) fn at(&mut self, stamp_ns: u64) -> [Option<SeenJoint>; 7] {
        let forgotten = |track: &mut JointTrack| seconds(track.seen_ns, stamp_ns) > FORGOTTEN;
        self.tracks.iter_mut().for_each(|track| {
            track.take_if(forgotten);
        });
        std::array::from_fn(|i| self.tracks[i].as_ref().map(|track| track.predicted(stamp_ns).joint()))
    }

    /// Whether no joint is known.
    pub(super) fn is_empty(&self) -> bool {
        self.tracks.iter().all(Option::is_none)
    }

    /// What was seen with right and left as they were, unless they have seemed to be exchanged for long.
    fn sorted(&mut self, stamp_ns: u64, seen: [Option<SeenJoint>; 7]) -> [Option<SeenJoint>; 7] {
        let mirrored = BodyJoint::ALL.map(|joint| seen[joint.mirrored() as usize]);
        let predicted = self.tracks.each_ref().map(|track| Some(track.as_ref()?.predicted(stamp_ns).joint()));
        let off = |seen: &[Option<SeenJoint>; 7]| -> f64 {
            let pairs = seen.iter().zip(&predicted);
            pairs.filter_map(|(seen, known)| Some((seen.as_ref()?.at - known.as_ref()?.at).norm())).sum()
        };
        if off(&mirrored) >= EXCHANGED * off(&seen) {
            self.exchanged = 0;
            return seen;
        }
        self.exchanged += 1;
        if self.exchanged > EXCHANGES {
            *self = Self::default();
            return seen;
        }
        mirrored
    }
}

fn seconds(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

impl JointTrack {
    fn new(stamp_ns: u64, seen: &SeenJoint) -> Self {
        let mut state = Vector6::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(&seen.at.coords);
        let mut covariance = Matrix6::identity() * (VELOCITY * VELOCITY);
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&seen.covariance);
        Self { state, covariance, seen_ns: stamp_ns, stamp_ns, refused: 0 }
    }

    fn predicted(&self, stamp_ns: u64) -> Self {
        let dt = seconds(self.stamp_ns, stamp_ns);
        let mut transition = Matrix6::identity();
        transition.fixed_view_mut::<3, 3>(0, 3).copy_from(&(Matrix3::identity() * dt));
        let q = ACCELERATION * ACCELERATION;
        let mut gain = Matrix6x3::zeros();
        gain.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * (dt * dt / 2.0)));
        gain.fixed_view_mut::<3, 3>(3, 0).copy_from(&(Matrix3::identity() * dt));
        let covariance = transition * self.covariance * transition.transpose() + gain * gain.transpose() * q;
        Self { state: transition * self.state, covariance, stamp_ns, ..self.clone() }
    }

    /// Fuses what was seen; `false` if the joint has been seen elsewhere too often.
    fn update(&mut self, stamp_ns: u64, seen: &SeenJoint) -> bool {
        let predicted = self.predicted(stamp_ns);
        let off: Vector3<f64> = seen.at.coords - predicted.state.fixed_rows::<3>(0);
        let spread = predicted.covariance.fixed_view::<3, 3>(0, 0) + seen.covariance;
        let Some(inverse) = spread.try_inverse() else { return false };
        if off.dot(&(inverse * off)) > GATE {
            self.refused += 1;
            return self.refused < INSISTS;
        }
        let gain = predicted.covariance.fixed_view::<6, 3>(0, 0) * inverse;
        let covariance = predicted.covariance - gain * predicted.covariance.fixed_view::<3, 6>(0, 0);
        self.state = predicted.state + gain * off;
        self.covariance = (covariance + covariance.transpose()) / 2.0;
        (self.stamp_ns, self.seen_ns, self.refused) = (stamp_ns, stamp_ns, 0);
        true
    }

    fn joint(&self) -> SeenJoint {
        let at: Vector3<f64> = self.state.fixed_rows::<3>(0).into();
        SeenJoint { at: Point3::from(at), covariance: self.covariance.fixed_view::<3, 3>(0, 0).into() }
    }
}
