//! What a robot is: its description, its kinematics, and the interface by which skills sense and command it.
//!
//! - [`Model`]: joints, links, limbs, hands, postures, read from a robot file and its URDF. [`Kinematics`]: poses,
//!   Jacobians.
//! - [`DifferentialIk`], [`solve_pose`]: from a twist or a pose of a link to joint velocities or positions.
//! - [`planning`]: paths of joints around the robot's own bodies and known boxes.
//! - [`Robot`]: the interface for skills. [`Lease`]: the exclusive right to command one limb.
//! - [`Guard`]: the safety layer between leases and joints: limits, watchdog, force limit. Pure and stepped.
//! - [`driver`]: what is below the guard, in this process or in another one.
//! - [`DummyRobot`], [`conformance`]: ideal joints for tests, and the checks that every driver's test calls.
//!
//! This room does not know skills, charts or a physics engine, and names no robot: those that the program carries are
//! in `robots/`.

mod bodies;
mod boundary;
pub mod conformance;
pub mod description;
pub mod driver;
mod dummy;
mod error;
mod gaze;
mod grasp;
mod guard;
mod history;
mod ik;
mod kinematics;
mod mesh;
mod message;
mod model;
pub mod newest;
pub mod planning;
mod pose_ik;
mod seam;
mod throttled;
mod wrist;

pub use boundary::{Fault, ForceTorque, LeaseError, LeaseLimits, Load, LoadShape, Sensed, SensedWrench};
pub use dummy::{DummyRobot, ServoDriver, ServoJoints};
pub use error::RobotError;
pub use gaze::Gaze;
pub use guard::{Guard, GuardConfig, JointTargets, Sample};
pub use history::JointHistory;
pub use ik::{DifferentialIk, IkConfig, IkStep};
pub use kinematics::{Jacobian, Kinematics, Twist};
pub use mesh::Mesh;
pub use model::{
    Collision, GRAVITY, Geometry, Hand, Inertial, Joint, JointKind, JointMotion, Limb, Link, LinkId, Marker,
    Model, Platform, PlatformKind, RobotLimits, StereoCamera, Visual, WrenchSensor,
};
pub use pose_ik::{IkError, PoseOptions, pose_error, solve_pose};
pub use seam::{Commander, GuardedRobot, Lease, RemoteRobot, Robot, RobotServer};
pub use throttled::Throttled;
pub use wrist::load_mass;

#[cfg(test)]
mod ik_tests;
#[cfg(test)]
mod kinematics_tests;
#[cfg(test)]
mod workspace_tests;
