//! The interface above the guard: the robot as skills see it, and the leases by which they command it. The guard
//! reads the commands from the [`LeaseTable`](lease::LeaseTable); it is below this interface and does not know
//! skills.

//!
//! The same interface over the network: [`RobotServer`] shares a robot, [`RemoteRobot`] is one in another process.

pub(crate) mod lease;
mod remote;
mod robot;
mod served;
#[cfg(test)]
mod tests;
mod wire;

pub use lease::{Commander, GuardedRobot, Lease};
pub use remote::RemoteRobot;
pub use robot::Robot;
pub use served::RobotServer;
