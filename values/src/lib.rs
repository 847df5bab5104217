//! What flows between skills, memory and agents: self-describing typed values with units and frames,
//! their schemas, and CEL expressions over them.
//!
//! This room knows no robot, no clock and no network. Start with [`Value`] and [`Type`].

mod geometry;
mod value;

pub use geometry::{Frame, Pose, Vector, Wrench};
pub use value::{Reference, Value};
