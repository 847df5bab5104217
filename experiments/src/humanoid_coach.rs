//! The simulated coach of the humanoid: the positions of wrists and elbows in each modification, and their measurement
//! by a camera that was calibrated to the robot with a few point pairs.

use armarium_motion::{CoachArm, CoachingCommand, nearer_hand, rigid_fit};
use armarium_values::random::StandardNormal;
use nalgebra::{Isometry3, Point3, Vector3};
use rand::distr::Distribution as _;
use rand_chacha::ChaCha8Rng;

use super::error::ExperimentError;

/// One of the four modifications of Fig. 9.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Modification {
    PushXy,
    PullXy,
    PushYz,
    PullYz,
}

impl Modification {
    pub(crate) const ALL: [Self; 4] = [Self::PushXy, Self::PullXy, Self::PushYz, Self::PullYz];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::PushXy => "push_xy",
            Self::PullXy => "pull_xy",
            Self::PushYz => "push_yz",
            Self::PullYz => "pull_yz",
        }
    }

    /// The two axes of the plane of the motion: 0, 1, 2 for x, y, z of the root frame.
    pub(crate) fn plane(self) -> [usize; 2] {
        match self {
            Self::PushXy | Self::PullXy => [0, 1],
            Self::PushYz | Self::PullYz => [1, 2],
        }
    }

    pub(crate) fn pushes(self) -> bool {
        matches!(self, Self::PushXy | Self::PushYz)
    }

    /// Direction from the motion's centre to the coach's hand: forward over the table, or up.
    pub(crate) fn outward(self) -> Vector3<f64> {
        Vector3::ith(self.plane()[1], 1.0)
    }

    /// The direction in which the motion should shift.
    pub(crate) fn way(self) -> Vector3<f64> {
        if self.pushes() { -self.outward() } else { self.outward() }
    }
}

/// Right and left arm of the coach, root frame, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arms {
    pub(crate) right: CoachArm,
    pub(crate) left: CoachArm,
}

/// Length of a forearm, m.
const FOREARM: f64 = 0.26;

impl Arms {
    /// The modification's hand points at `o` from a distance of `xi` m; the other hand is held back.
    pub(crate) fn pointing(modification: Modification, o: Vector3<f64>, xi: f64) -> Self {
        let outward = modification.outward();
        let arm = |wrist: Vector3<f64>| CoachArm { wrist, elbow: wrist + FOREARM * outward };
        let active = arm(o + xi * outward);
        let passive = arm(o + xi * outward + 0.3 * outward + 0.35 * Vector3::x());
        let (right, left) = if modification.pushes() { (active, passive) } else { (passive, active) };
        Self { right, left }
    }
}

/// A body tracker on a camera.
pub(crate) struct Tracker {
    camera_from_root: Isometry3<f64>,
    root_from_camera: Isometry3<f64>,
    /// Standard deviation of each coordinate, m.
    noise: f64,
    rng: ChaCha8Rng,
    /// Root mean square distance of the point pairs after the calibration, m.
    pub(crate) calibration_rms: f64,
}

impl Tracker {
    /// Calibrates: the coach puts a hand at the position of the robot's hand, for all `places` (root frame, m);
    /// camera and robot both measure it.
    pub(crate) fn calibrated(
        places: &[Vector3<f64>],
        noise: f64,
        mut rng: ChaCha8Rng,
    ) -> Result<Self, ExperimentError> {
        // In front of the table, facing the robot and looking down.
        let camera_from_root = Isometry3::new(Vector3::new(0.4, -0.7, 2.1), Vector3::new(-1.9, 0.5, 0.3));
        let seen: Vec<Point3<f64>> =
            places.iter().map(|p| camera_from_root * Point3::from(*p) + error(noise, &mut rng)).collect();
        let known: Vec<Point3<f64>> = places.iter().map(|p| Point3::from(*p)).collect();
        let fit = rigid_fit(&seen, &known)?;
        Ok(Self {
            camera_from_root,
            root_from_camera: fit.target_from_source,
            noise,
            rng,
            calibration_rms: fit.rms,
        })
    }

    /// The robot's interpretation of the coach's gesture, with its end effector at `x`, m.
    pub(crate) fn command(&mut self, arms: &Arms, x: &Vector3<f64>, xi: f64) -> Option<CoachingCommand> {
        let right = self.seen(&arms.right);
        let left = self.seen(&arms.left);
        nearer_hand(&right, &left, x, xi)
    }

    fn seen(&mut self, arm: &CoachArm) -> CoachArm {
        let mut see = |p: &Vector3<f64>| {
            let measured = self.camera_from_root * Point3::from(*p) + error(self.noise, &mut self.rng);
            (self.root_from_camera * measured).coords
        };
        CoachArm { wrist: see(&arm.wrist), elbow: see(&arm.elbow) }
    }
}

fn error(noise: f64, rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| {
        let normal: f64 = StandardNormal.sample(&mut *rng);
        noise * normal
    })
}
