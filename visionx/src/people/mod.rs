//! People in space: head, shoulders, elbows and wrists of the person before the robot, from depth or from both eyes.
//!
//! - [`BodyObserver`]: finds the body in the left image by trained networks
//!   ([`LearnedBodyDetector`](crate::tracking::LearnedBodyDetector)) and follows its joints in the root frame.
//! - `own_body`: the pixels that the robot's own body fills. The networks never see them, so that its arm is not taken for a person's.
//! - `lifting`: from landmarks in an image to joints in space, each with its covariance.
//! - `follower`: joints over time, and which side is which.
//! - [`PeopleStep`]: the processing step, which gives `HumanPoses`.
//!
//! It finds one person, who shows both shoulders. It does not know what the person wants.

mod follower;
mod lifting;
mod observer;
mod own_body;
mod step;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Point3};

pub use observer::BodyObserver;
pub use step::PeopleStep;

/// A joint of a person's upper body; right and left are the person's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BodyJoint {
    /// The middle of the head, between the ears.
    Head,
    /// The right shoulder.
    RightShoulder,
    /// The right elbow.
    RightElbow,
    /// The right wrist.
    RightWrist,
    /// The left shoulder.
    LeftShoulder,
    /// The left elbow.
    LeftElbow,
    /// The left wrist.
    LeftWrist,
}

impl BodyJoint {
    /// All joints.
    pub const ALL: [Self; 7] = [
        Self::Head,
        Self::RightShoulder,
        Self::RightElbow,
        Self::RightWrist,
        Self::LeftShoulder,
        Self::LeftElbow,
        Self::LeftWrist,
    ];

    /// Its name in memory.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Head => "head",
            Self::RightShoulder => "right_shoulder",
            Self::RightElbow => "right_elbow",
            Self::RightWrist => "right_wrist",
            Self::LeftShoulder => "left_shoulder",
            Self::LeftElbow => "left_elbow",
            Self::LeftWrist => "left_wrist",
        }
    }

    /// The same joint of the other side.
    #[must_use]
    pub fn mirrored(self) -> Self {
        match self {
            Self::Head => Self::Head,
            Self::RightShoulder => Self::LeftShoulder,
            Self::RightElbow => Self::LeftElbow,
            Self::RightWrist => Self::LeftWrist,
            Self::LeftShoulder => Self::RightShoulder,
            Self::LeftElbow => Self::RightElbow,
            Self::LeftWrist => Self::RightWrist,
        }
    }

    /// The landmarks whose middle it is.
    fn landmarks(self) -> [usize; 2] {
        match self {
            Self::Head => [7, 8],
            Self::RightShoulder => [12; 2],
            Self::RightElbow => [14; 2],
            Self::RightWrist => [16; 2],
            Self::LeftShoulder => [11; 2],
            Self::LeftElbow => [13; 2],
            Self::LeftWrist => [15; 2],
        }
    }

    /// How far it lies behind the surface that is seen there, m.
    fn under_surface(self) -> f64 {
        match self {
            Self::Head => 0.09,
            Self::RightShoulder | Self::LeftShoulder => 0.05,
            Self::RightElbow | Self::LeftElbow => 0.04,
            Self::RightWrist | Self::LeftWrist => 0.025,
        }
    }
}

/// Where a joint is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenJoint {
    /// Its place, m.
    pub at: Point3<f64>,
    /// The covariance of that, m².
    pub covariance: Matrix3<f64>,
}

/// A person's body in one frame, root frame.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyObservation {
    /// The joints in the order of [`BodyJoint::ALL`]; `None` for one that has not been seen for a while.
    pub joints: [Option<SeenJoint>; 7],
    /// Probability that it is a person, 0 to 1.
    pub confidence: f64,
}

impl BodyObservation {
    /// A joint, if it is known where it is.
    #[must_use]
    pub fn joint(&self, joint: BodyJoint) -> Option<&SeenJoint> {
        self.joints[joint as usize].as_ref()
    }
}
