//! The seam above the guard: the robot as skills see it, and the leases through which they command it. The guard reads the
//! commands out of the [`LeaseTable`](lease::LeaseTable); it lies below and knows no skill.

pub(crate) mod lease;
mod robot;

pub use lease::{Commander, GuardedRobot, Lease};
pub use robot::Robot;
