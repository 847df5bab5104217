//! The interface above the guard: the robot as skills see it, and the leases by which they command it. The guard
//! reads the commands from the [`LeaseTable`](lease::LeaseTable); it is below this interface and does not know
//! skills.

pub(crate) mod lease;
mod robot;

pub use lease::{Commander, GuardedRobot, Lease};
pub use robot::Robot;
