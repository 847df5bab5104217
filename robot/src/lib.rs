//! What a robot is: its description, kinematics and dynamics, and the boundary across which it is sensed and
//! commanded.
//!
//! - [`Model`]: joints, links, limbs, forward kinematics, Jacobian, dynamics; read from URDF.
//! - [`Robot`]: what skills hold. [`Lease`]: the exclusive right to command one limb.
//! - [`Guard`]: stands between leases and the joints; limits, watchdog, force limit. Pure and stepped.
//!
//! This room knows no skill, no chart and no physics engine.

mod boundary;

pub use boundary::{Fault, LeaseError, LeaseLimits, Robot, RobotError, Sensed, Wrist};
